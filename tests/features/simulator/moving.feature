Feature: Robots that drive
  After Listing 2.1 of the thesis, with every chassis: a robot with a goal reaches the position, in the time that its speed
  allows.

  Scenario: A robot without a goal does not move
    Given a room of 20 by 20 metres
    And a robot amber at "0, 0"
    When 60 s pass
    Then amber is at "0, 0"

  Scenario Outline: A robot drives from <initial position> to <position>
    Given a room of 20 by 20 metres
    And a robot amber at "<initial position>"
    When amber is told to go to position "<position>"
    And the fleet runs until the goal of amber has succeeded
    Then amber is at "<position>"

    Examples:
      | initial position | position   |
      | 0.0, 0.0         | 1.5, 1.5   |
      | 5.0, 5.0         | 12.5, 10.0 |

  Scenario Outline: The duration follows from the speed (<speed>)
    Given a room of 20 by 20 metres
    And these robots:
      | name  | place | speed   |
      | amber | 2, 2  | <speed> |
    When amber is told to go to position "12, 2"
    And the fleet runs until the goal of amber has succeeded
    Then the goal of amber took <time> to <time>

    Examples:
      | speed   | time |
      | 0.5 m/s | 20 s |
      | 1 m/s   | 10 s |
      | 2 m/s   | 5 s  |

  Scenario Outline: Each chassis arrives, and loses time only by acceleration (<chassis>, steps of <step>)
    Given a room of 30 by 20 metres
    And steps of <step>
    And these robots:
      | name  | place | speed | chassis   |
      | amber | 2, 10 | 1     | <chassis> |
    When amber is told to go to position "22, 10"
    And the fleet runs until the goal of amber has succeeded
    Then amber is at "22, 10"
    And the goal of amber took 20 s to 23 s
    And no robot has run into anything

    Examples:
      | chassis         | step   |
      | differential    | 100 ms |
      | differential    | 17 ms  |
      | omnidirectional | 100 ms |
      | omnidirectional | 17 ms  |
      | ackermann       | 100 ms |
      | ackermann       | 17 ms  |
      | aerial          | 100 ms |
      | aerial          | 17 ms  |

  Scenario: A robot turns on the spot
    Given a room of 20 by 20 metres
    And a robot amber at "10, 10"
    When amber is told to turn by 90 degrees
    And the fleet runs until the goal of amber has succeeded
    Then amber looks 90 degrees
    And amber is at "10, 10"

  Scenario: A stopped robot stays where it is
    Given a room of 20 by 20 metres
    And these robots:
      | name  | place | speed |
      | amber | 2, 2  | 0.5   |
    When amber is told to go to position "12, 2"
    And 8 s pass
    And amber is told to stop
    Then the goal of amber was canceled
    And for 60 s amber is at "6, 2"
