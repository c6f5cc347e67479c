//! Comparison of estimated and simulated drive times.

use consort_protocol::ids::{PlaceId, RobotId, TaskType};
use consort_protocol::knowledge::Attributes;
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_skills::actions::{Goal, GoalId, GoalStatus, NavigateToPose, RobotBackend};
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext};
use consort_skills::environment::{Environment, Routes, SpeedLimits};
use consort_world::map::{self, Map};
use consort_world::world::{RobotSetup, World, WorldSetup};

/// Two levels: a corridor with a door and a slow lane, a lift, and a room.
const TOWER: &str = "{name: tower, levels: [{name: low}, {name: top, elevation_m: 8}], \
    places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 6, y_m: 0}, \
    {name: C, kind: other, x_m: 10, y_m: 0}, {name: L0, kind: other, x_m: 12, y_m: 0}, \
    {name: L1, kind: other, x_m: 12, y_m: 0, level: top}, {name: D, kind: room, x_m: 18, y_m: 0, level: top}], \
    lanes: [{between: [A, B]}, {between: [B, C], speed_limit_mps: 0.25}, {between: [C, L0]}, {between: [L1, D]}], \
    doors: [{name: Door, on: [[A, B]], opening_s: 6}], \
    lifts: [{name: Lift, stops: [L0, L1], opening_s: 3, speed_mps: 1}]}";

const SPEEDS: [f64; 3] = [0.2, 0.5, 1.5];

fn place(name: &str) -> PlaceId {
    PlaceId::new(name).unwrap()
}

fn ada() -> RobotId {
    RobotId::new("ada").unwrap()
}

fn estimate_s(environment: Environment, from: &str, to: &str, speed: f64) -> f64 {
    let estimator = DescriptorRegistry::standard().resolve(environment).unwrap();
    let mut task = TaskSpec::of(TaskType::new("navigation").unwrap(), vec!["r1".parse().unwrap()]);
    task.parameters.insert("to".to_owned(), to.to_owned());
    let context = EstimateContext {
        pose: None,
        place: place(from),
        speed: MetresPerSecond::new(speed).unwrap(),
        discharge: SharePerSecond::new(0.0).unwrap(),
        closed: vec![],
        limits: SpeedLimits::default(),
        attributes: Attributes::default(),
        readings: None,
    };
    estimator.estimate(&task, &context).unwrap().time.get()
}

/// Simulated duration of a drive, leg by leg as the skill drives it.
fn drive_s(map: &Map, from: &str, to: &str, speed: f64) -> f64 {
    let body = RobotSetup::carrier(
        ada(),
        place(from),
        MetresPerSecond::new(speed).unwrap(),
        BatteryShare::FULL,
        SharePerSecond::new(0.0).unwrap(),
    );
    let mut world = World::new(WorldSetup::new(map.clone(), 1).robot(body)).unwrap();
    let routes = Routes::new(&map.topology()).unwrap();
    for (number, leg) in (1..).zip(routes.route(&place(from), &place(to)).unwrap().places.split_off(1)) {
        let pose = map.place(&leg).unwrap().pose;
        world.start(&ada(), GoalId(number), Goal::from(NavigateToPose::to(pose, Some(leg))));
        while !world.status(&ada(), GoalId(number)).unwrap().is_final() {
            let due = world.next_due().expect("something is under way");
            world.advance(due);
        }
        assert_eq!(world.status(&ada(), GoalId(number)), Some(GoalStatus::succeeded()));
    }
    world.now().as_secs()
}

#[test]
fn estimates_include_doors_lifts_and_limits() {
    let map = map::read(TOWER, "tower.yaml").unwrap();
    for speed in SPEEDS {
        for (from, to) in [("A", "B"), ("A", "C"), ("C", "A"), ("A", "D"), ("D", "A")] {
            let (told, took) =
                (estimate_s(map.environment().unwrap(), from, to, speed), drive_s(&map, from, to, speed));
            // The lift may be at either stop: the estimate uses half of its travel time.
            let lift_s = if from == "D" || to == "D" { 4.0 + 1e-6 } else { 1e-6 };
            assert!((told - took).abs() <= lift_s, "{from} to {to} at {speed} m/s: {told} s told, {took} s taken");
        }
    }
}

#[test]
fn without_passages_a_drive_takes_length_over_speed() {
    let map = map::read(TOWER, "tower.yaml").unwrap();
    let routes = Environment::new().with(Routes::new(&map.topology()).unwrap());
    assert_eq!(estimate_s(routes, "A", "C", 0.5), 20.0);
    // The same holds for a map without passages.
    let hospital = map::shipped("hospital").unwrap();
    assert!(hospital.passages().is_empty());
}

#[test]
fn a_robot_between_two_places_is_priced_from_there() {
    let map = map::read(TOWER, "tower.yaml").unwrap();
    let routes = Routes::new(&map.topology()).unwrap();
    let speed = MetresPerSecond::new(0.5).unwrap();
    let at = |x| consort_protocol::pose::Pose::new(x, 0.0, 0.0);
    let left_s = |x| routes.time_left(&place("B"), at(x), &place("L0"), speed, &map.passages()).unwrap().get();
    assert_eq!(left_s(6.0), 4.0 / 0.25 + 2.0 / 0.5, "at B");
    assert_eq!(left_s(8.0), 2.0 / 0.5 + 2.0 / 0.5, "half way, where nothing is known of what is left of it");
}
