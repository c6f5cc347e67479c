Feature: Lab samples
  A nurse has a sample for the laboratory. A robot with a drawer fetches it, and an arm in the laboratory takes it out.

  Background:
    Given these robots:
      | name  | place     | speed |
      | amber | PC Room 8 | 0.6   |
      | birch | IC Room 4 | 0.6   |
    And an arm lab-arm at "Laboratory"
    And a nurse in "IC Room 6"

  Scenario: The nearest robot delivers the sample
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And birch did task navto_lab
    And the sample of "IC Room 6" was delivered to lab-arm
    And every task of the mission was done once
    And every active role had its own robot

  Scenario: The steps of a delivery
    When a sample is requested from "IC Room 6"
    And the fleet runs until the mission is running
    Then birch is r1 of the mission
    And lab-arm is lab_arm of the mission
    When the fleet runs until birch is at "IC Room 6"
    Then "sample of IC Room 6" is still with "nurse of IC Room 6"
    When the fleet runs until task open_drawer_for_nurse has ended
    Then the drawer of birch is open
    When the fleet runs until task close_drawer_nurse has ended
    Then the drawer of birch is closed
    And "sample of IC Room 6" is in the drawer of birch
    When the fleet runs until the mission is completed
    Then lab-arm holds "sample of IC Room 6"
    And birch is at "Laboratory"

  Scenario: A distant fast robot is cheaper than a near slow robot
    Given these robots:
      | name  | place | speed |
      | cedar | Dock  | 2.0   |
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And cedar did task navto_lab

  Scenario: A robot without a skill is rejected with the name of the skill
    Given a robot cedar at "IC Room 6" with skills navigation, approach_person, operate_drawer, approach_robot
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And cedar did not get r1 because "lacks authenticate_person"
    And cedar never had a role in the mission

  Scenario: The mission waits until a robot has all required skills
    Given stations aster and basil
    When the fleet runs until there is a coordinator
    And node amber is killed
    And node birch is killed
    And a sample is requested from "IC Room 6"
    Then for 60 s the mission is pending
    When node birch starts again
    Then within 10 minutes the mission is completed

  Scenario Outline: A sample is fetched from any room (<room>)
    Given a nurse in "<room>"
    When a sample is requested from "<room>"
    Then within 10 minutes the mission is completed
    And the sample of "<room>" was delivered to lab-arm

    Examples:
      | room      |
      | IC Room 1 |
      | PC Room 3 |
      | PC Room 7 |
