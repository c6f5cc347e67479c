Feature: Batteries
  A robot takes a mission only if its charge suffices. If the battery drops nevertheless, the mission goes to another robot,
  or needs intervention.

  Background:
    Given an arm lab-arm at "Laboratory"
    And stations aster and basil
    And a nurse in "IC Room 6"

  Scenario: A robot with too little charge for the mission is not chosen
    Given these robots:
      | name  | place     | charge | uses   |
      | amber | IC Room 5 | 9 %    | 0.04 % |
      | birch | Dock      | 90 %   | 0.04 % |
    When a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
    And amber did not get r1 because "charge"
    And birch did task navto_lab

  Scenario: Another robot takes over when the battery drops on the way to the nurse
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

  Scenario: A robot with the sample and an empty battery stops, and the mission needs intervention
    Given a robot amber at "IC Room 4"
    And the battery of amber drops to 4 % when task navto_lab has begun
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission is in need of intervention
    And amber cannot move
    And "sample of IC Room 6" is in the drawer of amber

  Scenario: A robot that uses more charge than estimated releases its role early
    Given these robots:
      | name  | place     | charge | uses   | really uses |
      | amber | IC Room 4 | 30 %   | 0.04 % | 0.6 %       |
      | birch | Dock      | 90 %   | 0.04 % |             |
    When a sample is requested from "IC Room 6"
    Then within 30 minutes the mission is completed
    And birch did task navto_lab

  Scenario: A robot works again after its battery was exchanged
    Given a robot amber at "IC Room 4"
    When the battery of amber drops to 4 %
    And the fleet runs for 5 s
    Then amber cannot move
    When the battery of amber is exchanged
    And a sample is requested from "IC Room 6"
    Then within 10 minutes the mission is completed
