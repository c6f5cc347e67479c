Feature: Lifts
  A robot calls a lift, waits for it and rides in it. A lift has a capacity.

  Background:
    Given the map "../maps/tower.yaml"

  Scenario: A robot rides from the lowest floor to the highest
    Given a robot amber at "Lobby 0"
    When amber is told to drive to "Lobby 2"
    Then within 5 s amber is within "Lift"
    And within 60 s the goal of amber has succeeded
    And the goal of amber took 17 s to 17 s
    And amber is at "Lobby 2"

  Scenario: Two robots ride in sequence
    Given a robot amber at "Lobby 0"
    And a robot birch at "Lobby 0"
    When amber is told to drive to "Lobby 2"
    And birch is told to drive to "Lobby 2"
    And the fleet runs until the goal of birch has succeeded
    Then at most 1 robot was ever within "Lift"
    And amber passed "Lift" before birch
    And amber has passed "Lift"

  Scenario: A robot drives to a room on another floor
    Given these robots:
      | name  | place | speed |
      | amber | Ward  | 0.5   |
    When amber is told to drive to "Laboratory"
    And the fleet runs until the goal of amber has succeeded
    Then amber is at "Laboratory"
    And amber has passed "Lift"
    And amber has passed "Laboratory Door"
