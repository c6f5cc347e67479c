Feature: Declared actions
  A domain declares the parameters and the results of an action. It may name a system of the simulator that executes the goals.

  Background:
    Given the domain "../domains/box.yaml"
    And a robot amber at "Dock"

  Scenario: A system executes the action that names it
    When amber is told to perform the action move_lid with:
      | action |
      | open   |
    Then within 10 s the drawer of amber is open
    When amber is told to perform the action move_lid with:
      | action |
      | close  |
    Then within 10 s the drawer of amber is closed

  Scenario: A goal has parameters and returns results
    When amber is told to perform the action weigh with:
      | scale |
      | 2     |
    Then it is not true that the result "items" of the goal of amber is 4
    And within 4 s the goal of amber has succeeded
    And the goal of amber took 3 s to 3 s
    And the result "mass_kg" of the goal of amber is 2.5
    And the result "items" of the goal of amber is 4
    And the result "full" of the goal of amber is false
    And the result "label" of the goal of amber is "linen"
    And it is not true that the result "items" of the goal of amber is 5

  Scenario: Standard actions are declared as well
    When amber is told to perform the action spin with:
      | angle_rad |
      | 1.5708    |
    Then within 3 s amber looks 180 degrees
    When amber is told to perform the action wait with:
      | time |
      | 7.5  |
    And 10 s pass
    Then the goal of amber took 7.5 s to 7.5 s
