//! Automatic doors: opening for waiting robots, capacity, closing.

use super::*;
use consort_protocol::units::Metres;
use consort_skills::actions::Feedback;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// A – B – C in a line, 10 m each; a door of 3 s in the middle of each lane, the second with a
/// capacity of two.
pub(super) fn passage() -> WorldSetup {
    let text = "{name: passage, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}, \
        {name: C, kind: other, x_m: 20, y_m: 0}], lanes: [{between: [A, B]}, {between: [B, C]}], \
        doors: [{name: Narrow, on: [[A, B]], opening_s: 3}, {name: Wide, on: [[B, C]], opening_s: 3}]}";
    let mut setup = WorldSetup::new(map::read(text, "passage.yaml").unwrap(), 1);
    setup.doors.push(DoorSetup { capacity: 2, ..DoorSetup::named("Wide".to_owned()) });
    setup
}

pub(super) fn doors_only(what: &WorldEvent) -> Option<String> {
    match what {
        WorldEvent::DoorRequested { robot, .. } => Some(format!("{robot} waits")),
        WorldEvent::DoorEntered { robot, .. } => Some(format!("{robot} enters")),
        WorldEvent::DoorLeft { robot, .. } => Some(format!("{robot} leaves")),
        WorldEvent::DoorMoved { open: true, .. } => Some("open".to_owned()),
        WorldEvent::DoorMoved { open: false, .. } => Some("closed".to_owned()),
        _ => None,
    }
}

fn told(lines: &[(f64, &str)]) -> Vec<(f64, String)> {
    lines.iter().map(|(time, line)| (*time, (*line).to_owned())).collect()
}

/// Starts drives of several robots to a place at the same instant, in this order.
fn all_go(world: &mut World, names: &[&str], id: u64, to: &str) {
    for name in names {
        let goal = drive_goal(world, to);
        world.start(&robot(name), GoalId(id), goal);
    }
}

/// Advances time to `until`; returns the completed goals with their times.
fn arrivals(world: &mut World, until: f64) -> Vec<(f64, String)> {
    let mut arrived = Vec::new();
    while let Some(due) = world.next_due().filter(|due| due.as_secs() <= until) {
        for event in world.advance(due) {
            if let BackendEvent::GoalEnded { robot, status: GoalStatus::Succeeded(_), .. } = event {
                arrived.push((due.as_secs(), robot.to_string()));
            }
        }
    }
    world.advance(at(until));
    arrived
}

#[test]
fn a_robot_waits_for_the_door_which_closes_behind_it() {
    let mut world = World::new(passage().robot(carrier("r1", "A"))).unwrap();
    all_go(&mut world, &["r1"], 1, "B");
    world.advance(at(10.0));
    let pose = world.telemetry(&robot("r1")).unwrap().pose;
    assert_eq!((pose.x, pose.y, pose.yaw), (4.5, 0.0, 0.0), "half a metre before the door");
    let feedback = Feedback::remaining(Metres::new(5.5).unwrap(), Seconds::new(11.0).unwrap());
    assert_eq!(world.status(&robot("r1"), GoalId(1)), Some(GoalStatus::Executing(feedback)));
    let shown = |world: &World| world.report()["doors"].clone();
    let doors = |narrow: &str| serde_json::json!([{ "name": "Narrow", "state": narrow }, { "name": "Wide", "state": "closed" }]);
    assert_eq!(shown(&world), doors("opening"));
    assert_eq!(arrivals(&mut world, 60.0), [(23.0, "r1".to_owned())]);
    assert_eq!(shown(&world), doors("closed"));
    let lines = [(9.0, "r1 waits"), (12.0, "open"), (12.0, "r1 enters"), (14.0, "r1 leaves"), (19.0, "closed")];
    assert_eq!(logged(&mut world, doors_only), told(&lines));
}

#[test]
fn a_narrow_door_admits_robots_singly_in_order_of_arrival() {
    let setup = passage().robot(carrier("r1", "A")).robot(carrier("r2", "B")).robot(carrier("r3", "A"));
    let mut world = World::new(setup).unwrap();
    all_go(&mut world, &["r3", "r1"], 1, "B");
    all_go(&mut world, &["r2"], 1, "A");
    let named = |(time, name): (f64, &str)| (time, name.to_owned());
    assert_eq!(arrivals(&mut world, 60.0), [(23.0, "r3"), (25.0, "r1"), (27.0, "r2")].map(named));
}

#[test]
fn a_wide_door_admits_robots_up_to_its_capacity() {
    let setup = passage().robot(carrier("r1", "B")).robot(carrier("r2", "C")).robot(carrier("r3", "B"));
    let mut world = World::new(setup).unwrap();
    all_go(&mut world, &["r1", "r3"], 1, "C");
    all_go(&mut world, &["r2"], 1, "B");
    let named = |(time, name): (f64, &str)| (time, name.to_owned());
    assert_eq!(arrivals(&mut world, 60.0), [(23.0, "r1"), (23.0, "r3"), (25.0, "r2")].map(named));
}

#[test]
fn a_closing_door_opens_again_from_its_position() {
    let mut slow = carrier("r2", "A");
    slow.speed = MetresPerSecond::new(0.25).unwrap();
    let mut world = World::new(passage().robot(carrier("r1", "A")).robot(slow)).unwrap();
    all_go(&mut world, &["r1", "r2"], 1, "B");
    assert_eq!(arrivals(&mut world, 60.0), [(23.0, "r1".to_owned()), (42.0, "r2".to_owned())]);
    let lines = logged(&mut world, doors_only);
    let again = [(18.0, "r2 waits"), (20.0, "open"), (20.0, "r2 enters"), (24.0, "r2 leaves"), (29.0, "closed")];
    assert_eq!(lines[4..], told(&again), "it had been closing for 2 s");
}

#[test]
fn a_canceled_robot_leaves_the_queue_of_a_door() {
    let mut world = World::new(passage().robot(carrier("r1", "A")).robot(carrier("r2", "A"))).unwrap();
    all_go(&mut world, &["r1", "r2"], 1, "B");
    world.advance(at(10.0));
    world.cancel(&robot("r1"), GoalId(1));
    assert_eq!(arrivals(&mut world, 60.0), [(23.0, "r2".to_owned())]);
    all_go(&mut world, &["r1"], 2, "A");
    assert_eq!(arrivals(&mut world, 90.0), [(69.0, "r1".to_owned())], "back from before the door");
}

#[test]
fn a_robot_in_a_doorway_keeps_its_slot_until_it_leaves() {
    let mut world = World::new(passage().robot(carrier("r1", "A")).robot(carrier("r2", "A"))).unwrap();
    all_go(&mut world, &["r1", "r2"], 1, "B");
    world.advance(at(13.0));
    world.cancel(&robot("r1"), GoalId(1));
    assert_eq!(arrivals(&mut world, 50.0), []);
    all_go(&mut world, &["r1"], 2, "A");
    let named = |(time, name): (f64, &str)| (time, name.to_owned());
    assert_eq!(arrivals(&mut world, 90.0), [(60.0, "r1"), (62.0, "r2")].map(named));
}

#[test]
fn a_robot_gives_up_at_a_permanently_occupied_doorway() {
    let mut world = World::new(passage().robot(carrier("r1", "A")).robot(carrier("r2", "A"))).unwrap();
    all_go(&mut world, &["r1", "r2"], 1, "B");
    world.advance(at(13.0));
    world.cancel(&robot("r1"), GoalId(1));
    let message = "the lane from A to B is blocked: Narrow admitted no robot for 120 s";
    let events = world.advance(at(500.0));
    let blocked = ended("r2", 1, aborted(ErrorCode::Blocked, message));
    assert_eq!(events, [ended("r1", 1, GoalStatus::Canceled), blocked]);
    let ends: Vec<_> = logged(&mut world, |what| matches!(what, WorldEvent::GoalEnded { .. }).then_some(()));
    assert_eq!(ends[1].0, 132.0, "120 s after it last let somebody in");
}

#[test]
fn a_robot_keeps_lane_limits_and_drives_backward() {
    let text = "{name: two, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}], \
        lanes: [{between: [A, B], speed_limit_mps: 0.2, facing: backward}]}";
    let mut world =
        World::new(WorldSetup::new(map::read(text, "two.yaml").unwrap(), 1).robot(carrier("r1", "A"))).unwrap();
    all_go(&mut world, &["r1"], 1, "B");
    world.advance(at(25.0));
    let pose = world.telemetry(&robot("r1")).unwrap().pose;
    assert_eq!((pose.x, pose.y, pose.yaw.abs()), (5.0, 0.0, std::f64::consts::PI));
    assert_eq!(arrivals(&mut world, 100.0), [(50.0, "r1".to_owned())]);
    all_go(&mut world, &["r1"], 2, "A");
    world.advance(at(125.0));
    assert_eq!(
        world.telemetry(&robot("r1")).unwrap().pose.yaw.abs(),
        std::f64::consts::PI,
        "the same heading, now in front"
    );
}

#[test]
fn a_setup_with_an_unknown_door_is_rejected() {
    let mut setup = passage();
    setup.doors.push(DoorSetup { capacity: 0, ..DoorSetup::named("Narow".to_owned()) });
    setup.doors.push(DoorSetup { open_for_s: -1.0, ..DoorSetup::named("Narow".to_owned()) });
    let errors = World::new(setup).unwrap_err().to_string();
    let unknown = "there is no door \"Narow\" on map passage; did you mean \"Narrow\"?";
    assert_eq!(
        errors.lines().collect::<Vec<_>>(),
        [
            unknown,
            "door Narow: capacity is 0, allowed is 1 or more",
            unknown,
            "door Narow: open_for_s is -1, allowed is a number of seconds from 0 to 86400",
            "door Narow is defined more than once",
        ]
    );
}

/// Drives of robots that start at random times and are canceled at random times.
fn errands() -> impl Strategy<Value = Vec<(usize, f64, bool, Option<f64>)>> {
    prop::collection::vec((0..6usize, 0.0..40.0f64, any::<bool>(), prop::option::weighted(0.2, 0.0..30.0f64)), 1..12)
}

/// Runs drives: each has a robot, a start time, whether it uses the narrow door, and the delay of
/// its cancelation.
fn play(errands: &[(usize, f64, bool, Option<f64>)]) -> (World, BTreeSet<GoalId>, BTreeMap<GoalId, GoalStatus>) {
    let names = ["a", "b", "c", "d", "e", "f"];
    let start = |name: &&str| carrier(name, if *name < "d" { "A" } else { "C" });
    let mut setup = passage();
    setup.robots = names.iter().map(start).collect();
    let mut world = World::new(setup).unwrap();
    let mut actions: Vec<(f64, u64, bool)> = Vec::new();
    for (id, (_, from, _, stopped)) in (1..).zip(errands) {
        actions.push((*from, id, true));
        actions.extend(stopped.map(|after| (from + after, id, false)));
    }
    actions.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut stopped, mut ends) = (BTreeSet::new(), BTreeMap::new());
    let mut keep = |events: Vec<BackendEvent>| {
        for event in events {
            if let BackendEvent::GoalEnded { goal, status, .. } = event {
                ends.insert(goal, status);
            }
        }
    };
    for (time, id, begins) in actions {
        keep(world.advance(at(time)));
        let (who, _, narrow, _) = errands[id as usize - 1];
        let name = robot(names[who]);
        if begins {
            let here = world.telemetry(&name).unwrap();
            let stands = world.map().place(&here.place).unwrap().pose.distance(here.pose) == Metres::ZERO;
            let to = match (here.place.as_str(), narrow) {
                ("B", true) if stands => "A",
                ("B", false) if stands => "C",
                _ => "B",
            };
            let goal = drive_goal(&world, to);
            world.start(&name, GoalId(id), goal);
        } else {
            stopped.insert(GoalId(id));
            world.cancel(&name, GoalId(id));
        }
    }
    keep(world.advance(at(2_000.0)));
    (world, stopped, ends)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// A doorway never contains more robots than its capacity. Every robot that is not canceled
    /// gets through, as long as no robot stands in a doorway.
    #[test]
    fn doorways_respect_capacity_and_all_robots_get_through(errands in errands()) {
        let (mut world, stopped, ends) = play(&errands);
        let mut inside: BTreeMap<String, BTreeSet<RobotId>> = BTreeMap::new();
        for entry in world.drain_event_log() {
            match entry.event {
                WorldEvent::DoorEntered { robot, door } => {
                    let room = if door == "Narrow" { 1 } else { 2 };
                    let there = inside.entry(door).or_default();
                    there.insert(robot);
                    prop_assert!(there.len() <= room, "{:?} at {:?}", there, entry.time);
                }
                WorldEvent::DoorLeft { robot, door } => {
                    inside.entry(door).or_default().remove(&robot);
                }
                _ => {}
            }
        }
        if inside.values().all(BTreeSet::is_empty) {
            for (id, status) in ends {
                let excused = stopped.contains(&id) || matches!(&status, GoalStatus::Aborted(why) if why.code == ErrorCode::Busy);
                prop_assert!(excused || status == GoalStatus::succeeded(), "{:?}: {:?}", id, status);
            }
        }
    }

    /// The same drives give the same run.
    #[test]
    fn doors_are_fair_in_the_same_way_each_time(errands in errands()) {
        let ((mut first, ..), (mut again, ..)) = (play(&errands), play(&errands));
        prop_assert_eq!(first.drain_event_log(), again.drain_event_log());
    }
}
