Feature: Robots without goals
  After Listing 5.1 of the thesis: a robot without a goal stays where it is.

  Scenario: A single robot does not move
    Given a room of 50 by 50 metres
    And a robot robot at "1, 1"
    When 60 s pass
    Then robot is at "1, 1"

  Scenario: Several robots do not move
    Given a room of 50 by 50 metres
    And a robot robot at "1, 1"
    And a robot robot2 at "25, 25"
    And a robot robot3 at "42, 42"
    When 60 s pass
    Then robot is at "1, 1"
    And robot2 is at "25, 25"
    And robot3 is at "42, 42"

  Scenario: Robots with nodes but without missions do not move
    Given a robot amber at "Dock"
    And stations aster and basil
    When the fleet runs for 60 s
    Then amber is at "Dock"
    And there is a coordinator
