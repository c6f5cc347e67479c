Feature: Collisions
  Robots with a chassis have bodies: they pass neither through walls nor through other robots.

  Scenario: Two robots that drive towards each other collide
    Given a room of 20 by 10 metres
    And these robots:
      | name  | place | speed | chassis      |
      | amber | 2, 5  | 0.5   | differential |
      | birch | 18, 5 | 0.5   | differential |
    When amber is told to go to position "18, 5"
    And birch is told to go to position "2, 5"
    And 60 s pass
    Then amber has run into birch
    And it is not true that the goal of amber has succeeded

  Scenario: A robot collides with a wall in its path
    Given this map:
      """
      name: walled
      walls: [[[5, -3], [5, 3]]]
      places:
        - { name: A, kind: other, x_m: 0, y_m: 0 }
        - { name: B, kind: other, x_m: 10, y_m: 0 }
      lanes:
        - { between: [A, B] }
      """
    And these robots:
      | name  | place | speed | chassis      |
      | amber | A     | 0.5   | differential |
    When amber is told to drive to "B"
    And 60 s pass
    Then amber has run into a wall
    And it is not true that amber is at "B"

  Scenario: Robots that pass at a distance do not collide
    Given a room of 20 by 10 metres
    And these robots:
      | name  | place | speed | chassis      |
      | amber | 2, 4  | 0.5   | differential |
      | birch | 18, 6 | 0.5   | differential |
    When amber is told to go to position "18, 4"
    And birch is told to go to position "2, 6"
    And the fleet runs until the goal of amber has succeeded
    Then no robot has run into anything
    And within 10 s the goal of birch has succeeded

  Scenario: Drones avoid each other
    Given a room of 20 by 20 metres
    And these robots:
      | name  | place | speed | chassis |
      | amber | 2, 10 | 1     | aerial  |
      | birch | 18, 10 | 1    | aerial  |
    When amber is told to go to position "18, 10"
    And birch is told to go to position "2, 10"
    And the fleet runs until the goal of amber has succeeded
    Then within 30 s the goal of birch has succeeded
    And no robot has run into anything
