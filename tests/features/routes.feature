Feature: Corridors that are closed
  Cleaning, a bed, a barrier: a corridor may be closed at any time. A robot that meets it looks for another way; if there is
  none, the mission says so.

  Scenario: No way to the nurse
    Given a robot amber at "Dock"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"
    And the corridor between "IC Corridor 3" and "IC Corridor 6" is closed
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission has failed because "no route"
    And amber retried a task because "is in the way"

  Scenario: No way to the laboratory once the robot has the sample: somebody has to come for it
    Given a robot amber at "IC Room 4"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"
    And the corridor between "Laboratory Corridor" and "Laboratory" closes when task close_drawer_nurse has ended
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission is in need of intervention
    And "sample of IC Room 6" is in the drawer of amber

  Scenario: A corridor that is closed for a while is waited for
    Given a robot amber at "IC Room 4"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"
    And the corridor between "IC Corridor 5" and "IC Corridor 3" is closed from 0 s to 3 s
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission is completed

  Scenario: A place that is on no map is refused at once, with what was probably meant
    Given a robot amber at "Dock"
    And an arm lab-arm at "Laboratory"
    And a station post
    When a sample is requested from "IC Rom 6"
    Then the request was refused because "parameters/room: `room` is the place "
    And the request was refused because "which is not on the fleet's map; allowed: "
    And the request was refused because "did you mean `IC Room 6`?"

  Scenario: Another way is taken where there is one
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
