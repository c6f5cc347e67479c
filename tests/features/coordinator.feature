Feature: Takeover of the coordinator
  The coordinator may fail at any moment. The other voters elect a successor; active missions continue, and no acknowledged
  mission is lost.

  Background:
    # The stations are first by name, so one of them is the first coordinator.
    Given these robots:
      | name  | place     |
      | fern  | PC Room 8 |
      | gorse | IC Room 4 |
    And an arm lab-arm at "Laboratory"
    And stations aster, basil and clove
    And a nurse in "IC Room 6"

  Scenario Outline: The coordinator fails during <task>
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

  Scenario: A successor is elected within seconds
    When the fleet runs until there is a coordinator
    And the coordinator is killed
    Then there is no coordinator
    And within 2 s another node is the coordinator
    And for 10 s there is a coordinator

  Scenario: A mission requested without a coordinator is executed once
    When the fleet runs until there is a coordinator
    And the coordinator is killed
    And a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And another node is the coordinator
    And every task of the mission was done once

  Scenario: A coordinator that was cut off is replaced, and does not coordinate after the network heals
    When the fleet runs until there is a coordinator
    And the coordinator is cut off
    Then within 5 s another node is the coordinator
    When a sample is requested from "IC Room 6"
    And the fleet runs for 10 s
    And the network is healed
    Then within 10 minutes the mission is completed
    And every task of the mission was done once
    And every active role had its own robot

  Scenario: Without three of five voters the fleet has no coordinator
    When a sample is requested from "IC Room 6"
    And the fleet runs until task navto_room has begun
    And node aster is killed
    And node basil is killed
    And node clove is killed
    Then within 60 s there is no coordinator
    And for 60 s there is no coordinator
