//! Properties of every run.

use super::*;
use crate::world::actions::{ApproachPerson, ApproachRobot, AuthenticatePerson, Deposit, OperateDrawer, PickUp};
use consort_skills::actions::{NavigateToPose, Wait};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// An input to the world from outside.
#[derive(Debug, Clone)]
enum Deed {
    Start(usize, Goal),
    Cancel(usize),
    Ask(usize),
    Dismiss,
}

const ROBOTS: [&str; 3] = ["r1", "r2", "lab_arm"];

fn stage(seed: u64) -> World {
    let mut weak = carrier("r2", "PC Room 1");
    weak.battery = BatteryShare::new(0.075).unwrap();
    let mut mia = nurse("Mia", "PC Room 1", "s1");
    mia.samples.push("s2".into());
    let setup = hospital(seed)
        .robot(carrier("r1", "PC Corridor 1"))
        .robot(weak)
        .robot(RobotSetup::arm(robot("lab_arm"), place("Laboratory")))
        .person(mia);
    World::new(setup).unwrap()
}

fn goals() -> impl Strategy<Value = Goal> {
    let map = map::shipped("hospital").unwrap();
    let near = ["PC Room 1", "PC Corridor 1", "Laboratory Corridor", "Laboratory"];
    let near =
        near.map(|name| Goal::from(NavigateToPose::to(map.place(&place(name)).unwrap().pose, Some(place(name)))));
    let other = prop::sample::select(ROBOTS.to_vec());
    prop_oneof![
        4 => prop::sample::select(near.to_vec()),
        2 => Just(Goal::from(ApproachPerson { role: role("nurse") })),
        1 => Just(Goal::from(AuthenticatePerson { role: role("nurse") })),
        3 => any::<bool>().prop_map(|open| Goal::from(OperateDrawer { open })),
        1 => other.clone().prop_map(|other| Goal::from(ApproachRobot { robot: robot(other) })),
        1 => other.prop_map(|other| Goal::from(PickUp { from: robot(other) })),
        1 => Just(Goal::from(Deposit { into: None })),
        1 => (0.0..5.0f64).prop_map(|time| Goal::from(Wait { time: Seconds::new(time).unwrap() })),
    ]
}

/// Inputs, each after a pause of some seconds.
fn actions() -> impl Strategy<Value = Vec<(f64, Deed)>> {
    let action = prop_oneof![
        6 => (0..ROBOTS.len(), goals()).prop_map(|(who, goal)| Deed::Start(who, goal)),
        1 => (0..ROBOTS.len()).prop_map(Deed::Cancel),
        2 => (0..2usize).prop_map(Deed::Ask),
        1 => Just(Deed::Dismiss),
    ];
    let pause = prop_oneof![Just(0.0), Just(2.0), 0.0..12.0f64];
    prop::collection::vec((pause, action), 1..40)
}

/// Applies the inputs, with each pause cut into a number of steps. Returns the events, and every
/// robot's telemetry at each input and at the end.
fn play(
    seed: u64,
    actions: &[(f64, Deed)],
    mut steps: impl FnMut() -> u32,
) -> (Vec<BackendEvent>, Vec<[f64; 4]>, World) {
    let mut world = stage(seed);
    let (mut events, mut telemetry) = (Vec::new(), Vec::new());
    let rest = [(120.0, Deed::Dismiss)];
    for (id, (pause, action)) in (1..).zip(actions.iter().chain(&rest)) {
        let (from, parts) = (world.now().as_secs(), steps());
        for part in 1..=parts {
            let to = if part == parts { from + pause } else { from + pause * f64::from(part) / f64::from(parts) };
            events.extend(world.advance(at(to)));
            for name in ROBOTS {
                assert!((0.0..=1.0).contains(&world.telemetry(&robot(name)).unwrap().battery.get()));
            }
        }
        for name in ROBOTS {
            let now = world.telemetry(&robot(name)).unwrap();
            telemetry.push([now.pose.x, now.pose.y, now.pose.yaw, now.battery.get()]);
        }
        match action {
            Deed::Start(who, goal) => world.start(&robot(ROBOTS[*who]), GoalId(id), goal.clone()),
            Deed::Cancel(who) => (1..id).for_each(|id| world.cancel(&robot(ROBOTS[*who]), GoalId(id))),
            Deed::Ask(who) => world.request_person(GoalId(id), deposit(ROBOTS[*who])),
            Deed::Dismiss => (1..id).for_each(|id| world.cancel_person_request(GoalId(id))),
        }
    }
    (events, telemetry, world)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// The division of time into steps makes no difference.
    #[test]
    fn the_size_of_time_steps_makes_no_difference(seed in any::<u64>(), actions in actions(), cuts in prop::collection::vec(1u32..9, 41)) {
        let (events, telemetry, mut whole) = play(seed, &actions, || 1);
        let mut cuts = cuts.into_iter();
        let (events_cut, telemetry_cut, mut cut) = play(seed, &actions, || cuts.next().unwrap_or(1));
        prop_assert_eq!(events, events_cut);
        for (a, b) in telemetry.iter().flatten().zip(telemetry_cut.iter().flatten()) {
            prop_assert!((a - b).abs() <= 1e-9, "{} and {}", a, b);
        }
        prop_assert_eq!(whole.samples(), cut.samples());
        prop_assert_eq!(whole.drain_event_log(), cut.drain_event_log());
    }

    /// A seed gives the same run again, even after another world has run.
    #[test]
    fn worlds_share_nothing(seed in any::<u64>(), actions in actions(), others in actions()) {
        let (events, telemetry, mut first) = play(seed, &actions, || 1);
        let _ = play(seed.wrapping_add(1), &others, || 1);
        let (events_again, telemetry_again, mut again) = play(seed, &actions, || 1);
        prop_assert_eq!(events, events_again);
        prop_assert_eq!(telemetry, telemetry_again);
        prop_assert_eq!(first.drain_event_log(), again.drain_event_log());
    }

    /// Every goal that was accepted or rejected ends exactly once, or is still active.
    #[test]
    fn each_goal_ends_once(seed in any::<u64>(), actions in actions()) {
        let (events, _, world) = play(seed, &actions, || 1);
        let mut ends = BTreeMap::new();
        for event in &events {
            if let BackendEvent::GoalEnded { robot, goal, status } = event {
                prop_assert!(status.is_final());
                prop_assert!(ends.insert((robot.clone(), *goal), status.clone()).is_none(), "{:?}", event);
            }
        }
        for (id, (_, action)) in (1..).zip(&actions) {
            if let Deed::Start(who, _) = action {
                let (robot, goal) = (robot(ROBOTS[*who]), GoalId(id));
                prop_assert_eq!(world.status(&robot, goal), ends.get(&(robot.clone(), goal)).cloned());
            }
        }
    }
}

proptest! {
    /// The arrival time is length over speed in every direction.
    #[test]
    fn arrival_is_length_over_speed(dx in -50.0..50.0f64, dy in -50.0..50.0f64, speed in 0.05..3.0f64) {
        prop_assume!(dx.hypot(dy) > 0.01);
        let file = serde_json::json!({
            "name": "two",
            "places": [{"name": "A", "kind": "other", "x_m": 0, "y_m": 0}, {"name": "B", "kind": "other", "x_m": dx, "y_m": dy}],
            "lanes": [{"between": ["A", "B"]}],
        });
        let map = map::read(&file.to_string(), "two.json").unwrap();
        let mut body = carrier("r1", "A");
        body.speed = MetresPerSecond::new(speed).unwrap();
        body.discharge = SharePerSecond::new(0.0).unwrap();
        let mut world = World::new(WorldSetup::new(map, 1).robot(body)).unwrap();
        let goal = drive_goal(&world, "B");
        world.start(&robot("r1"), GoalId(1), goal);
        let due = world.next_due().unwrap().as_secs();
        prop_assert!((due - dx.hypot(dy) / speed).abs() < 1e-9);
    }
}

#[test]
fn another_seed_gives_other_handover_times() {
    let walk = |seed| {
        let mut world = stage(seed);
        run_to_success(&mut world, "r2", 1, Goal::from(ApproachPerson { role: role("nurse") }));
        run_to_success(&mut world, "r2", 2, Goal::from(OperateDrawer { open: true }));
        world.request_person(GoalId(1), deposit("r2"));
        world.next_due().unwrap().as_secs()
    };
    assert_eq!(walk(1), walk(1));
    assert_ne!(walk(1), walk(2));
}

#[test]
fn each_person_has_their_own_handover_times() {
    let walk = |people: &[PersonSetup]| {
        let mut setup = hospital(5).robot(carrier("r1", "PC Room 1"));
        setup.people = people.to_vec();
        let mut world = World::new(setup).unwrap();
        run_to_success(&mut world, "r1", 1, Goal::from(ApproachPerson { role: role("nurse") }));
        run_to_success(&mut world, "r1", 2, Goal::from(OperateDrawer { open: true }));
        world.request_person(GoalId(1), deposit("r1"));
        world.next_due().unwrap().as_secs()
    };
    let (ana, bea) = (nurse("Ana", "PC Room 1", "s1"), nurse("Bea", "PC Room 2", "s2"));
    assert_eq!(walk(std::slice::from_ref(&ana)), walk(&[ana.clone(), bea.clone()]), "who comes later changes nothing");
    assert_ne!(walk(std::slice::from_ref(&ana)), walk(&[bea, ana]));
}

/// The random runs are useful only if samples are transferred and robots strand in them.
#[test]
fn random_runs_reach_the_interesting_cases() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    let (mut moved, mut stranded, mut refused) = (0, 0, 0);
    for seed in 0..200 {
        let actions = actions().new_tree(&mut runner).unwrap().current();
        let (_, _, mut world) = play(seed, &actions, || 1);
        for entry in world.drain_event_log() {
            match entry.event {
                WorldEvent::SampleMoved { .. } => moved += 1,
                WorldEvent::Stranded { .. } => stranded += 1,
                WorldEvent::GoalEnded { status: GoalStatus::Aborted(_), .. } => refused += 1,
                _ => {}
            }
        }
    }
    assert!(moved >= 10 && stranded >= 10 && refused >= 100, "{moved} moved, {stranded} stranded, {refused} refused");
}
