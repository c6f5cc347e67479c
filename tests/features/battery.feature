Feature: Batteries
  A robot takes a mission only if its charge will do. If the battery runs down all the same, the mission goes to another, or
  waits for somebody who comes for the sample.

  Background:
    Given an arm lab-arm at "Laboratory"
    And stations aster and basil
    And a nurse in "IC Room 6"

  Scenario: Who has too little charge for the whole way is not chosen
    Given these robots:
      | name  | place     | charge | uses   |
      | amber | IC Room 5 | 9 %    | 0.04 % |
      | birch | Dock      | 90 %   | 0.04 % |
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And amber did not get r1 because "charge"
    And birch did task navto_lab

  Scenario: A battery that drops on the way to the nurse: another robot takes over
    Given these robots:
      | name  | place     |
      | amber | IC Room 4 |
      | birch | Dock      |
    And the battery of amber drops to 6 % when task navto_room has begun
    When a sample is requested from "IC Room 6"
    Then within 20 minutes the mission is completed
    And birch did task navto_lab
    And r1 was taken from a robot because "of the battery, less than 8.0 %"
    And every active role had its own robot

  Scenario: A battery that runs down with the sample in the drawer: the robot stands, and a person has to come
    Given a robot amber at "IC Room 4"
    And the battery of amber drops to 4 % when task navto_lab has begun
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission is in need of intervention
    And amber cannot move
    And "sample of IC Room 6" is in the drawer of amber

  Scenario: A robot that uses more than it thinks gives up in time and another goes on
    Given these robots:
      | name  | place     | charge | uses   | really uses |
      | amber | IC Room 4 | 30 %   | 0.04 % | 0.6 %       |
      | birch | Dock      | 90 %   | 0.04 % |             |
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission is completed
    And birch did task navto_lab

  Scenario: A robot whose battery was exchanged works again
    Given a robot amber at "IC Room 4"
    When the battery of amber drops to 4 %
    And the fleet runs for 5 s
    Then amber cannot move
    When the battery of amber is exchanged
    And a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
