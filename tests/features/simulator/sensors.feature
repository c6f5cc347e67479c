Feature: What robots perceive
  A range sensor measures to the first wall or body; a camera sees what is in its cone and not behind a wall; a feeler notices
  who is near whatever is between.

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

  Scenario: A ray ends at the first body, and at the wall behind it once that has gone
    When 1 s pass
    Then amber measures 3.75 m ahead
    When east is told to drive to "C"
    And the fleet runs until the goal of east has succeeded
    Then amber measures 8 m ahead

  Scenario: A camera sees nobody behind a wall
    When 1 s pass
    Then amber sees Nia and east
    And it is not true that amber sees north

  Scenario: A feeler notices who is near through walls
    When 1 s pass
    Then amber feels Nia, east and north nearby

  Scenario: A camera with a narrow cone sees what is ahead alone
    Given these robots:
      | name  | place | sensors                |
      | birch | D     | camera 60 degrees 10 m |
    When 1 s pass
    Then it is not true that birch sees amber
    When birch is told to turn by 90 degrees
    And the fleet runs until the goal of birch has succeeded
    Then birch sees amber
