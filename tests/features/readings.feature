Feature: Readings
  A reading is a value that a driver publishes, such as the dust in the bag of a vacuum cleaner. Behavior trees have a condition
  for each reading of a domain.

  Background:
    Given the domain "../../examples/vacuum/domain.yaml"
    And these robots:
      | name  | place | skills                 |
      | amber | Dock  | navigation, clean_room |
    And stations aster, basil and clove

  # Each room adds 2.5 g in the simulator. The tree empties the bag above 5 g.
  Scenario Outline: The tree empties the bag only when it is too full
    When this mission is requested:
      """
      mission: clean-rooms
      title: Clean rooms
      roles:
        cleaner: { kind: managed, description: has a brush }
      root:
        task: cleaning
        for: room
        in: [<rooms>]
        do: { task: clean, type: clean_room, roles: [cleaner], parameters: { room: "${room}", passes: "1" } }
      """
    Then within 30 minutes the mission is completed
    And the reading "bag_g" of amber is <bag>

    Examples:
      | rooms                                      | bag |
      | IC Room 6                                  | 2.5 |
      | IC Room 6, PC Room 3, PC Room 7            | 7.5 |
      | IC Room 6, PC Room 3, PC Room 7, IC Room 1 | 2.5 |
