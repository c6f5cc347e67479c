Feature: Maps of other formats
  Robots drive in buildings of the traffic editor of Open-RMF and in drawings of HMR Sim.

  Scenario: A robot drives in a building of Open-RMF with two floors
    Given the map "../../../sim_bridge/map_import/maps/office.building.yaml"
    And a robot amber at "reception"
    When amber is told to drive to "meeting"
    And the fleet runs until the goal of amber has succeeded
    Then amber is at "meeting"
    And amber has passed "lift_1"

  Scenario: A robot drives in a drawing
    Given the map "../../../sim_bridge/map_import/maps/clinic.drawio"
    And a robot amber at "Robot Home"
    When amber is told to drive to "Ward 2"
    And the fleet runs until the goal of amber has succeeded
    Then amber is at "Ward 2"
