Feature: Closed corridors
  A corridor may be closed at any time. A robot that meets a closed corridor takes another route; without a route the mission
  fails with this reason.

  Scenario: The mission fails without a route to the nurse
    Given a robot amber at "Dock"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"
    And the corridor between "IC Corridor 3" and "IC Corridor 6" is closed
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission has failed because "no route"
    And amber retried a task because "is in the way"

  Scenario: Without a route to the laboratory, the robot with the sample needs intervention
    Given a robot amber at "IC Room 4"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"
    And the corridor between "Laboratory Corridor" and "Laboratory" closes when task close_drawer_nurse has ended
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission is in need of intervention
    And "sample of IC Room 6" is in the drawer of amber

  Scenario: The robot waits for a corridor that is closed for a short time
    Given a robot amber at "IC Room 4"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"
    And the corridor between "IC Corridor 5" and "IC Corridor 3" is closed from 0 s to 3 s
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission is completed

  Scenario: An unknown place is rejected at once, with the most similar name
    Given a robot amber at "Dock"
    And an arm lab-arm at "Laboratory"
    And a station post
    When a sample is requested from "IC Rom 6"
    Then the request was refused because "parameters/room: `room` is the place "
    And the request was refused because "which is not on the fleet's map; allowed: "
    And the request was refused because "did you mean `IC Room 6`?"

  Scenario: The robot takes another route if one exists
    Given the map "maps/ring.yaml"
    And a robot amber at "West"
    And a station post
    And the corridor between "West" and "North" is closed
    When the mission "missions/visit.yaml" is requested
      | place |
      | East  |
    Then within 10 minutes the mission is completed
    And amber is at "East"
    And a goal of amber was aborted because "barrier between North and West is in the way"
