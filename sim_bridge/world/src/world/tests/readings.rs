//! Readings that domain files declare.

use super::*;
use consort_protocol::scalar::Scalar;
use consort_protocol::yaml;
use consort_skills::domain_file::DomainFile;
use std::collections::BTreeMap;

const BAG: &str = r#"
domain: cleaning
actions:
  sweep:
    simulate: { duration_s: [1, 1], effects: { bag_g: { add: 20 }, free_g: { add: -20 }, passes: [1, 3], mode: [a, b] } }
  empty_bag: { simulate: { duration_s: [1, 1], effects: { bag_g: 0, lid: true } } }
  count:
    results: { passes: { type: integer, minimum: 0 }, share: { type: number } }
    simulate: { duration_s: [1, 1], results: { passes: [0, 9], share: [0, 1] } }
  spill: { simulate: { duration_s: [1, 1], failure_rate: 1, effects: { bag_g: 7 } } }
readings:
  bag_g: { type: number, minimum: 0, maximum: 50, simulate: { value: 5 } }
  free_g: { type: integer, minimum: 0, maximum: 50, simulate: { value: 45 } }
  lid: { type: bool, simulate: { value: false } }
  passes: { type: integer, minimum: 0, maximum: 3 }
  mode: { type: text, one_of: [a, b, c], simulate: { value: c } }
  level: { type: number, minimum: 2, maximum: 4 }
"#;

fn world(seed: u64) -> World {
    let domain = DomainFile::check(yaml::parse(BAG).unwrap(), &BTreeMap::new(), &[]).unwrap();
    let setup = hospital(seed).domain(&domain);
    World::new(setup.robot(carrier("r1", "Dock")).robot(carrier("r2", "Laboratory"))).unwrap()
}

fn readings(world: &World, name: &str) -> BTreeMap<String, Scalar> {
    world.telemetry(&robot(name)).unwrap().readings
}

/// Executes an action, and returns the readings after it.
fn after(world: &mut World, id: u64, action: &str) -> BTreeMap<String, Scalar> {
    let goal = Goal {
        action: action.parse().unwrap(),
        parameters: Default::default(),
        repeatable: false,
        hands_over: None,
        since: None,
    };
    world.start(&robot("r1"), GoalId(id), goal);
    let before = readings(world, "r1");
    world.advance(at(world.now().as_secs() + 0.9));
    assert_eq!(readings(world, "r1"), before, "the effects come at the end of the goal");
    world.advance(at(world.now().as_secs() + 0.2));
    assert!(world.status(&robot("r1"), GoalId(id)).unwrap().is_final());
    readings(world, "r1")
}

#[test]
fn robots_begin_with_the_declared_readings() {
    for seed in 0..20 {
        let world = world(seed);
        for name in ["r1", "r2"] {
            let readings = readings(&world, name);
            let fixed = [
                ("bag_g", Scalar::Number(5.0)),
                ("free_g", Scalar::Integer(45)),
                ("lid", Scalar::Bool(false)),
                ("mode", Scalar::Text("c".to_owned())),
            ];
            for (name, value) in fixed {
                assert_eq!(readings[name], value, "{name}");
            }
            assert!(matches!(readings["passes"], Scalar::Integer(0..=3)), "{readings:?}");
            assert!(matches!(readings["level"], Scalar::Number(2.0..=4.0)), "{readings:?}");
            assert_eq!(readings.len(), 6);
        }
    }
    assert_eq!(readings(&World::new(hospital(1).robot(carrier("r1", "Dock"))).unwrap(), "r1"), BTreeMap::new());
}

#[test]
fn successful_goals_change_the_readings_of_their_robot() {
    for seed in 0..20 {
        let mut world = world(seed);
        let other = readings(&world, "r2");
        let levels = |readings: &BTreeMap<String, Scalar>| (readings["bag_g"].clone(), readings["free_g"].clone());
        for (id, bag, free) in [(1, 25.0, 25), (2, 45.0, 5), (3, 50.0, 0)] {
            let swept = after(&mut world, id, "sweep");
            assert_eq!(levels(&swept), (Scalar::Number(bag), Scalar::Integer(free)), "clamped to the range");
            assert!(matches!(swept["passes"], Scalar::Integer(1..=3)), "{swept:?}");
            assert!(matches!(&swept["mode"], Scalar::Text(mode) if mode == "a" || mode == "b"), "{swept:?}");
        }
        let failed = after(&mut world, 4, "spill");
        assert_eq!(failed["bag_g"], Scalar::Number(50.0), "a failed goal changes nothing");
        let emptied = after(&mut world, 5, "empty_bag");
        assert_eq!((&emptied["bag_g"], &emptied["lid"]), (&Scalar::Number(0.0), &Scalar::Bool(true)));
        assert_eq!(readings(&world, "r2"), other, "the other robot has its own readings");
    }
}

/// Whole numbers of a range are results of integers.
#[test]
fn results_have_their_declared_types() {
    for seed in 0..20 {
        let mut world = world(seed);
        after(&mut world, 1, "count");
        let Some(GoalStatus::Succeeded(results)) = world.status(&robot("r1"), GoalId(1)) else { panic!("seed {seed}") };
        assert!(results.0["passes"].as_i64().is_some_and(|passes| (0..=9).contains(&passes)), "{results:?}");
        assert!(results.0["share"].is_f64(), "{results:?}");
    }
}
