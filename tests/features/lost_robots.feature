Feature: Robots that are lost
  A robot's node may fail during its work. Before the robot has the sample, another robot takes the role; afterwards the
  mission needs intervention and names the robot with the sample.

  Background:
    Given these robots:
      | name  | place     |
      | amber | IC Room 4 |
      | birch | Dock      |
    And an arm lab-arm at "Laboratory"
    And stations aster and basil
    And a nurse in "IC Room 6"

  Scenario: The carrier fails on its way to the nurse and another carrier takes the role
    Given node amber is killed when task navto_room has begun
    When a sample is requested from "IC Room 6"
    Then within 20 minutes the mission is completed
    And birch did task navto_lab
    And task navto_room has begun 2 times
    And every active role had its own robot

  Scenario: The carrier fails with the sample: the mission names the robot that has it
    Given node amber is killed when task navto_lab has begun
    When a sample is requested from "IC Room 6"
    Then within 20 minutes the mission is in need of intervention
    And "sample of IC Room 6" is in the drawer of amber
    And birch never had a role in the mission

  Scenario: The carrier restarts and continues its role
    Given node amber is killed when task navto_lab has begun
    When a sample is requested from "IC Room 6"
    And the fleet runs until task navto_lab has begun
    And the fleet runs for 2 s
    And node amber starts again
    Then within 20 minutes the mission is completed
    And the sample of "IC Room 6" was delivered to lab-arm
    And birch never had a role in the mission

  Scenario: If the carrier of a watched sample is lost, another robot stands by it
    Given these robots:
      | name  | place | skills                                                                            |
      | watch | Dock  | navigation, wait                                                                  |
    And node amber is killed when task navto_lab has begun
    When the mission "lab-samples-watched" is requested
      | room      |
      | IC Room 6 |
    Then within 20 minutes watch did task stand_by
    And within 20 minutes the mission is in need of intervention

  Scenario: The node of the arm fails and restarts
    Given node lab-arm is killed when task navto_room has begun
    When a sample is requested from "IC Room 6"
    And the fleet runs until task navto_lab has begun
    And node lab-arm starts again
    Then within 20 minutes the mission is completed
    And the sample of "IC Room 6" was delivered to lab-arm
