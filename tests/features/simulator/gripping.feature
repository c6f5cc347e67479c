Feature: Arms, drawers and items
  An arm takes what lies within its reach and is not too heavy for it. A held item moves with the arm, and can be put down.

  Background:
    Given these robots:
      | name  | place      | arm | lifts | reach | speed |
      | amber | Laboratory | yes | 2     | 1     | 0.5   |
      | birch | Laboratory | no  |       |       | 0.5   |
    And these things:
      | name  | place      | weight | distance |
      | tray  | Laboratory | 1.5    | 0.5      |
      | crate | Laboratory | 2.5    | 0.5      |
      | box   | Laboratory | 0.5    | 1.5      |

  Scenario: An item is grasped, carried and put down
    When amber is told to grasp "tray"
    And the fleet runs until the goal of amber has succeeded
    Then amber holds "tray"
    When amber is told to drive to "Laboratory Corridor"
    And the fleet runs until the goal of amber has succeeded
    And amber is told to put down what it holds
    And the fleet runs until the goal of amber has succeeded
    Then "tray" lies at "Laboratory Corridor"

  Scenario Outline: An item is not grasped, with the reason: <thing>
    When <robot> is told to grasp "<thing>"
    Then the goal of <robot> was aborted because "<why>"
    And it is not true that the goal of <robot> has succeeded

    Examples:
      | robot | thing | why                              |
      | amber | crate | crate weighs 2.5 kg, amber lifts         |
      | amber | box   | box is 1.5 m away                |
      | amber | cup   | is on the table at Laboratory; objects there |
      | birch | tray  | birch has no arm                 |

  Scenario: A drawer opens and closes
    When birch is told to open its drawer
    And the fleet runs until the goal of birch has succeeded
    Then the drawer of birch is open
    When birch is told to close its drawer
    And the fleet runs until the goal of birch has succeeded
    Then the drawer of birch is closed

  Scenario: A closed drawer cannot be emptied
    When amber is told to approach robot birch
    And the fleet runs until the goal of amber has succeeded
    And amber is told to take from birch
    Then the goal of amber was aborted because "the drawer of birch is closed"
