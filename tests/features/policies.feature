Feature: Policies of an organization
  A hospital keeps the robots of its sections apart to limit infections. Robots have attributes, ensembles select robots by
  them, and missions say which robots they prefer or accept.

  Background:
    Given these robots:
      | name   | place     | skills     | attributes             |
      | amber  | Dock      | navigation | section=icu, floor=3   |
      | birch  | IC Room 5 | navigation | section=er             |
      | cedar  | IC Room 4 | navigation |                        |
    And stations aster, basil and clove
    And an ensemble icu of robots with "member.attributes.section == 'icu'"
    And an ensemble hospital of robots with "has(member.attributes.section)"

  Scenario: Robots of the section come first, although others are nearer
    When the mission "missions/icu_visit.yaml" is requested
    Then within 10 minutes the mission is completed
    And amber did task visit
    And birch did not get r1 because "members of icu come first"

  Scenario: A robot of another section helps out while those of the section are busy
    When the mission "missions/icu_visit.yaml" is requested as first
    And the mission "missions/icu_visit.yaml" is requested as second
    Then within 10 minutes all missions are completed
    And amber is r1 of mission first
    And birch is r1 of mission second
    And cedar never had a role in mission second

  Scenario: The next coordinator follows the policy
    Given the coordinator is killed when task visit has begun
    When the mission "missions/icu_visit.yaml" is requested as first
    Then within 10 minutes mission first is completed
    And another node is the coordinator
    When node amber starts again
    And 30 s pass
    And the mission "missions/icu_visit.yaml" is requested as second
      | room |
      | Dock |
    Then within 10 minutes mission second is completed
    And amber is r1 of mission second

  Scenario: The members of the section are lost
    When the fleet runs until there is a coordinator
    And node amber is killed
    And the mission "missions/icu_visit.yaml" is requested
    Then within 10 minutes the mission is completed
    And birch did task visit

  Scenario: A role accepts robots of one section only
    When the mission "missions/section_visit.yaml" is requested
      | section |
      | er      |
    Then within 10 minutes the mission is completed
    And birch did task visit
    And amber did not get r1 because "robot.battery > 0.3` is false"

  Scenario: A mission without an eligible robot waits and says why
    When the mission "missions/section_visit.yaml" is requested
      | section   |
      | radiology |
    Then for 60 s the mission is pending
    And birch did not get r1 because "robot.battery > 0.3` is false"

  Scenario: A role names its robot
    When this mission is requested:
      """
      mission: by-name
      roles: { r1: { kind: managed, eligible: 'robot.name == "birch"' } }
      root: { task: visit, type: navigation, roles: [r1], parameters: { to: Dock } }
      """
    Then within 10 minutes the mission is completed
    And birch did task visit

  Scenario: A mission of an unknown ensemble is refused
    When this mission is requested:
      """
      mission: elsewhere
      ensembles: [icuu]
      roles: { r1: { kind: managed } }
      root: { task: visit, type: navigation, roles: [r1], parameters: { to: Dock } }
      """
    Then the request was refused because "the fleet has no ensemble `icuu`; allowed: hospital, icu; did you mean `icu`?"
