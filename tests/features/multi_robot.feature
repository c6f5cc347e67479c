Feature: Missions of several robots
  Robots send signals to each other directly: a robot that awaits a signal continues when it arrives, independently of the
  coordinator.

  Scenario: Two robots visit rooms in any order, and meet
    Given these robots:
      | name  | place     | skills           |
      | amber | Dock      | navigation, wait |
      | birch | PC Room 3 | navigation, wait |
    And a station post
    When the mission "missions/rounds.yaml" is requested
    Then within 10 minutes the mission is completed
    And amber is at "Crossing"
    And birch is at "Crossing"
    And task left_goes has begun 1 times
    And task rest has begun 2 times
    And amber did task rest
    And birch did task rest
    And every active role had its own robot

  Scenario: The coordinator is killed while two robots are at work
    Given these robots:
      | name  | place     | skills           |
      | amber | Dock      | navigation, wait |
      | birch | PC Room 3 | navigation, wait |
    And stations aster, basil and clove
    And the coordinator is killed when task right_goes has begun
    When the mission "missions/rounds.yaml" is requested
    Then within 10 minutes the mission is completed
    And another node is the coordinator
    And every active role had its own robot

  Scenario: A mission for two robots waits until two are available
    Given these robots:
      | name  | place     | skills           |
      | amber | Dock      | navigation, wait |
      | birch | PC Room 3 | navigation, wait |
    And stations aster and basil
    When the fleet runs until there is a coordinator
    And node birch is killed
    And the mission "missions/rounds.yaml" is requested
    Then for 60 s the mission is pending
    And for 10 s amber is at "Dock"
    When node birch starts again
    Then within 10 minutes the mission is completed

  Scenario: A sample is handed over halfway, from a drawer to a mobile arm
    Given these robots:
      | name  | place     | skills                                                                                | arm | drawer |
      | amber | IC Room 4 | navigation, approach_person, authenticate_person, operate_drawer, approach_robot      | no  | yes    |
      | porter | Dock     | navigation, approach_robot, pick_up, deposit                                          | yes | no     |
    And a station post
    And a nurse in "IC Room 6"
    When the mission "missions/hand_over.yaml" is requested
    Then within 20 minutes the mission is completed
    And "sample of IC Room 6" lies at "Laboratory"
    And every task of the mission was done once

  Scenario: Two carriers and an arm deliver three samples
    Given these robots:
      | name  | place     |
      | amber | IC Room 4 |
      | birch | PC Room 8 |
    And an arm lab-arm at "Laboratory"
    And a nurse in "IC Room 6"
    And a nurse in "PC Room 3"
    And a nurse in "PC Room 7"
    When a sample is requested from "IC Room 6" as first
    And a sample is requested from "PC Room 3" as second
    And a sample is requested from "PC Room 7" as third
    Then within 60 minutes all missions are completed
    And the sample of "IC Room 6" was delivered to lab-arm
    And the sample of "PC Room 3" was delivered to lab-arm
    And the sample of "PC Room 7" was delivered to lab-arm
    And every active role had its own robot

  Scenario: The mission with the highest priority starts first
    Given a robot amber at "Dock"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"
    And a nurse in "PC Room 3"
    And a nurse in "PC Room 7"
    When the mission "lab-samples" is requested as first
      | room      |
      | IC Room 6 |
    And the fleet runs until mission first is running
    And the mission "lab-samples" is requested as later
      | room      |
      | PC Room 3 |
    And the mission "lab-samples" is requested as urgent
      | room      | priority |
      | PC Room 7 | 50       |
    And the fleet runs until mission urgent is completed
    Then it is not true that mission later is completed
    And within 30 minutes all missions are completed

  Scenario: A mission that exceeds its deadline fails
    Given these robots:
      | name  | place | speed |
      | amber | Dock  | 0.1   |
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "IC Room 6"
    When the mission "lab-samples" is requested
      | room      | deadline |
      | IC Room 6 | 60       |
    Then within 2 minutes the mission has failed because "deadline"

  Scenario: A carrier passes a door and a lift to an arm upstairs
    Given the map "maps/tower.yaml"
    And a robot amber at "Lobby 0"
    And an arm lab-arm at "Laboratory"
    And a station post
    And a nurse in "Ward"
    When a sample is requested from "Ward"
    Then within 10 minutes the mission is completed
    And the sample of "Ward" was delivered to lab-arm
    And amber has passed "Lift"
    And amber has passed "Laboratory Door"
