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
    Given the coordinator is killed when task <task> has begun
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And another node is the coordinator
    And the sample of "IC Room 6" was delivered to lab-arm
    And every task of the mission was done once
    And every active role had its own robot

    Examples:
      | task           |
      | navto_room     |
      | approach_nurse |
      | deposit        |
      | navto_lab      |
      | pick_up_sample |

  Scenario: A successor is there at once
    When the fleet runs until there is a coordinator
    And the coordinator is killed
    Then there is no coordinator
    And within 2 s another node is the coordinator
    And for 10 s there is a coordinator

  Scenario: A mission asked for while there is no coordinator is done once
    When the fleet runs until there is a coordinator
    And the coordinator is killed
    And a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And another node is the coordinator
    And every task of the mission was done once

  Scenario: A coordinator that is cut off is replaced, and is no second one when it can be heard again
    When the fleet runs until there is a coordinator
    And the coordinator is cut off
    Then within 5 s another node is the coordinator
    When a sample is requested from "IC Room 6"
    And the fleet runs for 10 s
    And the network is healed
    Then within 10 minutes the mission is completed
    And every task of the mission was done once
    And every active role had its own robot

  Scenario: Three of five voters die: nobody can coordinate, and a robot at work finishes what it can
    When a sample is requested from "IC Room 6"
    And the fleet runs until task navto_room has begun
    And node aster is killed
    And node basil is killed
    And node clove is killed
    Then within 60 s there is no coordinator
    And for 60 s there is no coordinator
