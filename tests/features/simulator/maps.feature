Feature: Maps from elsewhere
  Buildings drawn in the traffic editor of Open-RMF and drawings in the conventions of HMR Sim are driven as well as our own.

  Scenario: A building of two floors from Open-RMF
    Given the map "../../../sim_bridge/world/maps/office.building.yaml"
    And a robot amber at "reception"
    When amber is told to drive to "meeting"
    And the fleet runs until the goal of amber has succeeded
    Then amber is at "meeting"
    And amber has passed "lift_1"

  Scenario: A drawing
    Given the map "../../../sim_bridge/world/maps/clinic.drawio"
    And a robot amber at "Robot Home"
    When amber is told to drive to "Ward 2"
    And the fleet runs until the goal of amber has succeeded
    Then amber is at "Ward 2"
