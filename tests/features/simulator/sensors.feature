Feature: Sensors
  A range sensor measures the distance to the first wall or body. A camera sees the bodies in its field of view that no wall
  hides. A proximity sensor detects near bodies, also through walls.

  Background:
    Given this map:
      """
      name: rooms
      walls: [[[-2, 2], [2, 2]], [[8, -1], [8, 1]]]
      places:
        - { name: A, kind: other, x_m: 0, y_m: 0 }
        - { name: B, kind: other, x_m: 4, y_m: 0 }
        - { name: C, kind: other, x_m: 0, y_m: 4 }
        - { name: D, kind: other, x_m: 0, y_m: -2 }
      lanes:
        - { between: [A, B] }
        - { between: [B, C] }
        - { between: [A, D] }
      """
    And these robots:
      | name  | place | sensors                                         |
      | amber | A     | range 10 m, camera 360 degrees 10 m, proximity 3.5 m |
      | east  | B     |                                                 |
      | north | C     |                                                 |
    And these people:
      | name | role  | place |
      | Nia  | nurse | D     |

  Scenario: A ray ends at the nearest body, and at the wall after the body has left
    When 1 s pass
    Then amber measures 3.75 m ahead
    When east is told to drive to "C"
    And the fleet runs until the goal of east has succeeded
    Then amber measures 8 m ahead

  Scenario: A camera does not see through a wall
    When 1 s pass
    Then amber sees Nia and east
    And it is not true that amber sees north

  Scenario: A proximity sensor detects a near robot through a wall
    When 1 s pass
    Then amber feels Nia, east and north nearby

  Scenario: A camera with a narrow field of view sees only ahead
    Given these robots:
      | name  | place | sensors                |
      | birch | D     | camera 60 degrees 10 m |
    When 1 s pass
    Then it is not true that birch sees amber
    When birch is told to turn by 90 degrees
    And the fleet runs until the goal of birch has succeeded
    Then birch sees amber
