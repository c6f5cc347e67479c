Feature: Lifts
  A lift is called, waited for and ridden. It takes as many as fit in.

  Background:
    Given the map "../maps/tower.yaml"

  Scenario: A robot rides from the lowest floor to the highest
    Given a robot amber at "Lobby 0"
    When amber is told to drive to "Lobby 2"
    Then within 5 s amber is within "Lift"
    And within 60 s the goal of amber has succeeded
    And the goal of amber took 17 s to 17 s
    And amber is at "Lobby 2"

  Scenario: Two robots ride one after the other
    Given a robot amber at "Lobby 0"
    And a robot birch at "Lobby 0"
    When amber is told to drive to "Lobby 2"
    And birch is told to drive to "Lobby 2"
    And the fleet runs until the goal of birch has succeeded
    Then at most 1 robot was ever within "Lift"
    And amber passed "Lift" before birch
    And amber has passed "Lift"

  Scenario: From a room on one floor to a room on another
    Given these robots:
      | name  | place | speed |
      | amber | Ward  | 0.5   |
    When amber is told to drive to "Laboratory"
    And the fleet runs until the goal of amber has succeeded
    Then amber is at "Laboratory"
    And amber has passed "Lift"
    And amber has passed "Laboratory Door"
