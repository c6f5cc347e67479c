Feature: Batteries and chargers of the simulator
  A goal uses charge in proportion to its duration; idling uses a tenth of that. At 5 % a robot stops; a charger fills its battery.

  Background:
    Given this map:
      """
      name: yard
      places:
        - { name: Charger, kind: charger, x_m: 0, y_m: 0 }
        - { name: Gate, kind: other, x_m: 10, y_m: 0 }
      lanes:
        - { between: [Charger, Gate] }
      """

  Scenario: Driving uses charge in proportion to its duration
    Given these robots:
      | name  | place   | speed | charge | uses  |
      | amber | Charger | 0.5   | 100 %  | 0.1 % |
    When amber is told to drive to "Gate"
    And the fleet runs until the goal of amber has succeeded
    Then amber has less than 98.1 % of its charge
    And amber has more than 97.9 % of its charge

  Scenario: Idling uses a tenth
    Given these robots:
      | name  | place   | charge | uses  |
      | amber | Charger | 100 %  | 0.1 % |
    When 100 s pass
    Then amber has less than 99.1 % of its charge
    And amber has more than 98.9 % of its charge

  Scenario: A docked robot charges until its battery is full
    Given these robots:
      | name  | place   | charge | uses  | charges |
      | amber | Charger | 50 %   | 0.1 % | 0.4 %   |
    When amber is told to dock
    And the fleet runs until the goal of amber has succeeded
    Then amber is docked
    And within 200 s amber has more than 99.9 % of its charge

  Scenario: A robot cannot dock without a charger
    Given a robot amber at "Gate"
    When amber is told to dock
    Then the goal of amber was aborted because "Gate is not a charger"

  Scenario: An empty battery stops the robot on its way
    Given these robots:
      | name  | place   | speed | charge | uses |
      | amber | Charger | 0.5   | 10 %   | 1 %  |
    When amber is told to drive to "Gate"
    And 60 s pass
    Then amber cannot move
    And amber is at "2.5, 0"
