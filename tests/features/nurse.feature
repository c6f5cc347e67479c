@nurse
Feature: A nurse changes her mind
  The nurse may cancel the mission, decline, or walk away, at any stage. No sample is lost: the robot stops, and the mission
  states where the sample is.

  Background:
    Given a robot amber at "IC Room 4"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"

  Scenario Outline: She cancels the mission before she hands over the sample (once <moment>)
    Given the nurse in "IC Room 6" cancels once <moment>
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission was canceled by "nurse of IC Room 6"
    And "sample of IC Room 6" is still with "nurse of IC Room 6"

    Examples:
      | moment        |
      | approached    |
      | authenticated |

  Scenario: She cancels while she hands over the sample: the holder of the sample is uncertain
    Given the nurse in "IC Room 6" cancels once handing over
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission needs intervention because "canceled by nurse of IC Room 6"
    And "sample of IC Room 6" is still with "nurse of IC Room 6"

  Scenario: She cancels when the robot has the sample: the mission needs intervention
    Given the nurse in "IC Room 6" cancels once handed over
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission needs intervention because "canceled by nurse of IC Room 6"
    And "sample of IC Room 6" is in the drawer of amber

  Scenario: Another person cancels the mission while the robot is on its way
    When a sample is requested from "IC Room 6"
    And the fleet runs until task navto_room has begun
    And the mission is canceled by "ward 3"
    Then within 5 s the mission was canceled by "ward 3"
    And for 60 s it is never true that amber is at "IC Room 6"

  Scenario: After a canceled mission the robot takes the next mission
    Given a nurse in "PC Room 1"
    And the nurse in "IC Room 6" cancels once approached
    When a sample is requested from "IC Room 6" as first
    And the fleet runs until mission first is canceled
    And a sample is requested from "PC Room 1" as second
    Then within 10 minutes mission second is completed
    And the sample of "PC Room 1" was delivered to lab-arm

  Scenario: She declines: the mission fails with this reason
    Given the nurse in "IC Room 6" declines once handing over
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission has ended
    And "sample of IC Room 6" is still with "nurse of IC Room 6"
    And it is not true that the mission is completed

  Scenario: She walks away from the robot and stays away: the mission fails after a while
    Given the nurse in "IC Room 6" walks away once approached
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the nurse in "IC Room 6" is away
    And for 2 minutes the mission is running
    And within 30 minutes the mission has failed because "amber: nurse of IC Room 6 has walked away; waited for 120 s"
    And "sample of IC Room 6" is still with "nurse of IC Room 6"

  Scenario Outline: She walks away from the robot and returns in time (once <moment>)
    Given the nurse in "IC Room 6" walks away once <moment> for 100 s
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the nurse in "IC Room 6" is away
    And within 10 minutes the mission is completed
    And the sample of "IC Room 6" was delivered to lab-arm
    And every task of the mission was done once

    Examples:
      | moment        |
      | approached    |
      | authenticated |

  Scenario: She walks away when the drawer is open: the mission fails with this reason
    Given the nurse in "IC Room 6" walks away once handing over
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the nurse in "IC Room 6" is away
    And for 100 s the mission is running
    And within 30 minutes the mission has failed because "every nurse has walked away; waited for 120 s"
    And "sample of IC Room 6" is still with "nurse of IC Room 6"

  Scenario: Another nurse who walks away has no effect
    Given a nurse in "PC Room 1"
    When the nurse in "PC Room 1" walks away
    And a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And the nurse in "PC Room 1" is away

  Scenario: She walks away before the robot arrives, and returns in time
    Given the nurse in "IC Room 6" walks away once waiting for 20 s
    When a sample is requested from "IC Room 6"
    Then the nurse in "IC Room 6" is away
    And within 10 minutes the mission is completed

  Scenario: She is never there
    When the nurse in "IC Room 6" walks away
    And a sample is requested from "IC Room 6"
    Then within 30 minutes the mission has ended
    And "sample of IC Room 6" is still with "nurse of IC Room 6"
    And it is not true that the mission is completed
