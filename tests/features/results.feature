Feature: Results
  A mission returns values that are computed from the results of its tasks.

  Scenario: A mission returns the results of a task
    Given the domain "domains/box.yaml"
    And these robots:
      | name  | place | skills    |
      | amber | Dock  | weigh_box |
    And stations aster, basil and clove
    When this mission is requested:
      """
      mission: weighing
      title: Weigh the box
      roles:
        carrier: { kind: managed, description: has a box }
      root: { task: weigh, type: weigh_box, roles: [carrier], parameters: { scale: "1" } }
      result: { mass_kg: weigh.mass_kg, label: weigh.label, heavy: weigh.mass_kg > 10 }
      """
    Then within 10 minutes the mission is completed
    And the result "mass_kg" of the mission is 2.5
    And the result "label" of the mission is "linen"
    And the result "heavy" of the mission is false
    And it is not true that the result "label" of the mission is "wool"
