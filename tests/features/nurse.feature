@nurse
Feature: A nurse changes her mind
  The nurse takes no orders: she may call the mission off, decline, or walk away, at any stage. Nothing is lost by it: the
  robot comes to rest, and it is known where the sample is.

  Background:
    Given a robot amber at "IC Room 4"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"

  Scenario Outline: She calls the mission off before she hands anything over (once <moment>)
    Given the nurse in "IC Room 6" cancels once <moment>
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission was canceled by "nurse of IC Room 6"
    And "sample of IC Room 6" is still with "nurse of IC Room 6"

    Examples:
      | moment        |
      | approached    |
      | authenticated |

  Scenario: She calls it off as she is about to hand the sample over: nobody can be sure that she has not
    Given the nurse in "IC Room 6" cancels once handing over
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission needs intervention because "canceled by nurse of IC Room 6"
    And "sample of IC Room 6" is still with "nurse of IC Room 6"

  Scenario: She calls it off when the robot has the sample: somebody has to come for it
    Given the nurse in "IC Room 6" cancels once handed over
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission needs intervention because "canceled by nurse of IC Room 6"
    And "sample of IC Room 6" is in the drawer of amber

  Scenario: Somebody else withdraws the mission while the robot is on its way
    When a sample is requested from "IC Room 6"
    And the fleet runs until task navto_room has begun
    And the mission is canceled by "ward 3"
    Then within 5 s the mission was canceled by "ward 3"
    And for 60 s it is never true that amber is at "IC Room 6"

  Scenario: After a mission was called off the robot takes the next one
    Given a nurse in "PC Room 1"
    And the nurse in "IC Room 6" cancels once approached
    When a sample is requested from "IC Room 6" as first
    And the fleet runs until mission first is canceled
    And a sample is requested from "PC Room 1" as second
    Then within 10 minutes mission second is completed
    And the sample of "PC Room 1" was delivered to lab-arm

  Scenario: She declines: the mission fails and says so
    Given the nurse in "IC Room 6" declines once handing over
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission has ended
    And "sample of IC Room 6" is still with "nurse of IC Room 6"
    And it is not true that the mission is completed

  Scenario: She walks away from the robot for good: it waits a while, then the mission fails and says so
    Given the nurse in "IC Room 6" walks away once approached
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the nurse in "IC Room 6" is away
    And for 2 minutes the mission is running
    And within 30 minutes the mission has failed because "amber: nurse of IC Room 6 has walked away; waited for 120 s"
    And "sample of IC Room 6" is still with "nurse of IC Room 6"

  Scenario Outline: She is called away from the robot and is back in time (once <moment>)
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

  Scenario: She walks away when the drawer is open for her: the mission fails and says so
    Given the nurse in "IC Room 6" walks away once handing over
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the nurse in "IC Room 6" is away
    And for 100 s the mission is running
    And within 30 minutes the mission needs intervention because "every nurse has walked away; waited for 120 s"
    And "sample of IC Room 6" is still with "nurse of IC Room 6"

  Scenario: Another nurse who walks away is of no concern
    Given a nurse in "PC Room 1"
    When the nurse in "PC Room 1" walks away
    And a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And the nurse in "PC Room 1" is away

  Scenario: She walks away before the robot is there, and is back in time
    Given the nurse in "IC Room 6" walks away once waiting for 20 s
    When a sample is requested from "IC Room 6"
    Then the nurse in "IC Room 6" is away
    And within 10 minutes the mission is completed

  Scenario: She is not there at all
    When the nurse in "IC Room 6" walks away
    And a sample is requested from "IC Room 6"
    Then within 30 minutes the mission has ended
    And "sample of IC Room 6" is still with "nurse of IC Room 6"
    And it is not true that the mission is completed
