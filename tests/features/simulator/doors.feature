Feature: Automatic doors
  A door opens for waiting robots in the order of arrival, up to its capacity, and closes behind the last robot.

  Background:
    Given the map "../maps/passage.yaml"

  Scenario: A robot waits until the door is open, and the door closes behind it
    Given these robots:
      | name  | place | speed |
      | amber | A     | 0.5   |
    When amber is told to drive to "B"
    Then within 10 s amber waits at "Narrow"
    And door "Narrow" is closed
    And within 5 s door "Narrow" is open
    And within 60 s the goal of amber has succeeded
    And the goal of amber took 23 s to 23 s
    And within 10 s door "Narrow" is closed

  Scenario: A narrow door admits single robots in the order of arrival
    Given these robots:
      | name  | place | speed |
      | amber | A     | 0.5   |
      | birch | B     | 0.5   |
      | cedar | A     | 0.5   |
    When cedar is told to drive to "B"
    And amber is told to drive to "B"
    And birch is told to drive to "A"
    And the fleet runs until the goal of birch has succeeded
    Then at most 1 robot was ever within "Narrow"
    And cedar passed "Narrow" before amber
    And amber passed "Narrow" before birch
    And the goal of amber took 25 s to 25 s
    And the goal of birch took 27 s to 27 s

  Scenario: A wide door admits robots up to its capacity
    Given these robots:
      | name  | place | speed |
      | amber | B     | 0.5   |
      | birch | B     | 0.5   |
      | cedar | C     | 0.5   |
    And the door "Wide" lets in 2 at once
    When amber is told to drive to "C"
    And birch is told to drive to "C"
    And cedar is told to drive to "B"
    And the fleet runs until the goal of cedar has succeeded
    Then at most 2 robots were ever within "Wide"
    And it is not true that at most 1 robot was ever within "Wide"

  Scenario: A canceled robot leaves the queue of the door
    Given these robots:
      | name  | place | speed |
      | amber | A     | 0.5   |
      | birch | A     | 0.5   |
    When amber is told to drive to "B"
    And birch is told to drive to "B"
    And 10 s pass
    And amber is told to stop
    And the fleet runs until the goal of birch has succeeded
    Then the goal of birch took 23 s to 23 s
    And it is not true that amber has passed "Wide"
