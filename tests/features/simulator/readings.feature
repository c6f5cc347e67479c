Feature: Readings of simulated robots
  Background:
    Given the domain "../../../examples/vacuum/domain.yaml"
    And a robot amber at "Dock"
    And a robot birch at "Laboratory"

  Scenario: Goals change the readings of their robot
    Then the reading "bag_g" of amber is 0
    When amber is told to perform the action vacuum with:
      | passes |
      | 1      |
    Then for 1.9 s the reading "bag_g" of amber is 0
    And within 3 s the reading "bag_g" of amber is 2.5
    And the reading "bag_g" of amber is at least 2.5
    And it is not true that the reading "bag_g" of amber is at least 2.6
    And the reading "bag_g" of amber is at most 2.5
    And it is not true that the reading "bag_g" of amber is at most 2.4
    And the reading "bag_g" of birch is 0
    When amber is told to perform the action empty_bag
    Then within 2 s the reading "bag_g" of amber is 0
