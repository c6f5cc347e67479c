Feature: Goals of Nav2
  A goal has feedback and an outcome, with a reason if it is aborted.

  Background:
    Given the map "../maps/passage.yaml"

  Scenario: Waypoints are followed in order
    Given these robots:
      | name  | place | speed |
      | amber | A     | 0.5   |
    When amber is told to drive through "B, C, B"
    And the fleet runs until the goal of amber has succeeded
    Then amber is at "B"
    And amber has passed "Wide"

  Scenario: A missing lane aborts the goal where the robot is
    Given a robot amber at "A"
    When amber is told to drive through "B, A, C"
    And 200 s pass
    Then the goal of amber was aborted because "no lane from A to C"
    And amber is at "A"

  Scenario: A robot detects a closed corridor when it arrives there
    Given these robots:
      | name  | place | speed |
      | amber | A     | 0.5   |
    And the corridor between "A" and "B" is closed
    When amber is told to drive to "B"
    And 60 s pass
    Then the goal of amber was aborted because "barrier between A and B is in the way"

  Scenario: A corridor closes while a robot is under way, and opens again
    Given these robots:
      | name  | place | speed |
      | amber | A     | 0.5   |
    And the corridor between "B" and "C" closes after 5 s
    When amber is told to drive through "B, C"
    And 120 s pass
    Then the goal of amber was aborted because "is in the way"
    When the corridor between "B" and "C" opens
    And amber is told to drive to "B"
    And the fleet runs until the goal of amber has succeeded
    And amber is told to drive to "C"
    Then within 60 s amber is at "C"

  Scenario: A robot waits for a given time
    Given a robot amber at "A"
    When amber is told to wait for 10 s
    And the fleet runs until the goal of amber has succeeded
    Then the goal of amber took 10 s to 10 s
