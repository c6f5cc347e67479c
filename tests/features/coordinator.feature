Feature: Nobody is indispensable
  Whoever coordinates may die at any moment. Others elect a successor among themselves; missions under way go on, and none that
  was acknowledged is lost.

  Background:
    # The stations come first by name, and so one of them coordinates first.
    Given these robots:
      | name  | place     |
      | fern  | PC Room 8 |
      | gorse | IC Room 4 |
    And an arm lab-arm at "Laboratory"
    And stations aster, basil and clove
    And a nurse in "IC Room 6"

  Scenario Outline: The coordinator dies while <task> is under way
    Given the coordinator dies when task <task> has begun
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And somebody else coordinates
    And the sample of "IC Room 6" was delivered to lab-arm
    And every task of the mission was done once
    And nobody acted for another

    Examples:
      | task           |
      | navto_room     |
      | approach_nurse |
      | deposit        |
      | navto_lab      |
      | pick_up_sample |

  Scenario: A successor is there at once
    When the fleet runs until somebody coordinates
    And the coordinator dies
    Then nobody coordinates
    And within 2 s somebody else coordinates
    And for 10 s somebody coordinates

  Scenario: A mission asked for while nobody coordinates is done once
    When the fleet runs until somebody coordinates
    And the coordinator dies
    And a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And somebody else coordinates
    And every task of the mission was done once

  Scenario: A coordinator that is cut off is replaced, and is no second one when it can be heard again
    When the fleet runs until somebody coordinates
    And the coordinator is cut off
    Then within 5 s somebody else coordinates
    When a sample is requested from "IC Room 6"
    And the fleet runs for 10 s
    And all can hear each other again
    Then within 10 minutes the mission is completed
    And every task of the mission was done once
    And nobody acted for another

  Scenario: Three of five voters die: nobody can coordinate, and a robot at work finishes what it can
    When a sample is requested from "IC Room 6"
    And the fleet runs until task navto_room has begun
    And node aster dies
    And node basil dies
    And node clove dies
    Then within 60 s nobody coordinates
    And for 60 s nobody coordinates
