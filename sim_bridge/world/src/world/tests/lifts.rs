//! Lifts: calls, waiting, rides.

use super::*;
use crate::world::actions::OperateDrawer;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Three levels, 4 m apart, a lobby on each, a room on the highest; the lift takes 3 s to open.
pub(super) fn tower(capacity: u32) -> WorldSetup {
    let text = format!(
        "{{name: tower, levels: [{{name: low}}, {{name: mid, elevation_m: 4}}, {{name: top, elevation_m: 8}}], \
         places: [{{name: L0, kind: corridor, x_m: 0, y_m: 0}}, {{name: L1, kind: corridor, x_m: 0, y_m: 0, level: mid}}, \
         {{name: L2, kind: corridor, x_m: 0, y_m: 0, level: top}}, {{name: Room, kind: room, x_m: 5, y_m: 0, level: top}}], \
         lanes: [{{between: [L2, Room]}}], \
         lifts: [{{name: Lift, stops: [L0, L1, L2], capacity: {capacity}, opening_s: 3, speed_mps: 1}}]}}"
    );
    WorldSetup::new(map::read(&text, "tower.yaml").unwrap(), 1)
}

fn rides(world: &mut World, name: &str, id: u64, to: &str) {
    let goal = drive_goal(world, to);
    world.start(&robot(name), GoalId(id), goal);
}

fn ends(world: &mut World, until: f64) -> Vec<(f64, String, GoalStatus)> {
    let mut ends = Vec::new();
    while let Some(due) = world.next_due().filter(|due| due.as_secs() <= until) {
        for event in world.advance(due) {
            if let BackendEvent::GoalEnded { robot, status, .. } = event {
                ends.push((due.as_secs(), robot.to_string(), status));
            }
        }
    }
    world.advance(at(until));
    ends
}

fn arrived(list: &[(f64, &str)]) -> Vec<(f64, String, GoalStatus)> {
    list.iter().map(|(time, name)| (*time, (*name).to_owned(), GoalStatus::succeeded())).collect()
}

#[test]
fn a_lift_opens_closes_goes_and_opens() {
    let mut world = World::new(tower(1).robot(carrier("r1", "L0"))).unwrap();
    rides(&mut world, "r1", 1, "L2");
    world.advance(at(5.0));
    let riding = world.telemetry(&robot("r1")).unwrap();
    assert_eq!(riding.place, place("L2"), "it gets out there whatever happens");
    let status = rejected_status(&mut world, "r1", 9, Goal::from(OperateDrawer { open: true }));
    assert!(matches!(status, GoalStatus::Aborted(why) if why.code == ErrorCode::Busy));
    assert_eq!(ends(&mut world, 60.0), arrived(&[(3.0 + 3.0 + 8.0 + 3.0, "r1")]));
    rides(&mut world, "r1", 2, "Room");
    assert_eq!(ends(&mut world, 90.0), arrived(&[(70.0, "r1")]));
}

#[test]
fn a_lift_starts_from_its_current_stop() {
    let mut world = World::new(tower(1).robot(carrier("r1", "L2"))).unwrap();
    rides(&mut world, "r1", 1, "L1");
    assert_eq!(ends(&mut world, 60.0), arrived(&[(8.0 + 3.0 + 3.0 + 4.0 + 3.0, "r1")]));
}

#[test]
fn the_oldest_call_is_served_first_and_others_share_the_ride() {
    let both = |capacity| {
        let mut world = World::new(tower(capacity).robot(carrier("a", "L0")).robot(carrier("b", "L0"))).unwrap();
        rides(&mut world, "b", 1, "L1");
        rides(&mut world, "a", 1, "L1");
        ends(&mut world, 100.0)
    };
    assert_eq!(both(2), arrived(&[(13.0, "b"), (13.0, "a")]));
    assert_eq!(both(1), arrived(&[(13.0, "b"), (33.0, "a")]));
}

#[test]
fn a_drive_canceled_in_a_lift_ends_at_its_stop() {
    let mut world = World::new(tower(1).robot(carrier("r1", "L0"))).unwrap();
    rides(&mut world, "r1", 1, "L2");
    world.advance(at(5.0));
    world.cancel(&robot("r1"), GoalId(1));
    rides(&mut world, "r1", 2, "Room");
    let canceled = (5.0, "r1".to_owned(), GoalStatus::Canceled);
    assert_eq!(ends(&mut world, 60.0), [vec![canceled], arrived(&[(27.0, "r1")])].concat());
}

#[test]
fn a_lift_drops_the_call_of_a_canceled_drive() {
    let mut world = World::new(tower(1).robot(carrier("r1", "L2")).robot(carrier("r2", "L0"))).unwrap();
    rides(&mut world, "r1", 1, "L0");
    rides(&mut world, "r2", 1, "L1");
    world.advance(at(2.0));
    world.cancel(&robot("r1"), GoalId(1));
    world.advance(at(2.0));
    let there = world.telemetry(&robot("r1")).unwrap();
    assert_eq!(there.place, place("L2"));
    // Up to L2 for a canceled call, down again, and up.
    assert_eq!(ends(&mut world, 100.0), arrived(&[(8.0 + 3.0 + 3.0 + 8.0 + 3.0 + 3.0 + 4.0 + 3.0, "r2")]));
}

#[test]
fn without_the_lifts_system_levels_are_not_connected() {
    let mut setup = tower(1).robot(carrier("r1", "L0"));
    setup.systems.retain(|name| name != "lifts");
    let mut world = World::new(setup).unwrap();
    let goal = drive_goal(&world, "L1");
    let status = rejected_status(&mut world, "r1", 1, goal);
    assert_eq!(status, aborted(ErrorCode::NoRoute, "no lane from L0 to L1"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Every caller arrives, whatever the other calls are, and the lift never exceeds its capacity.
    #[test]
    fn every_caller_arrives_and_the_lift_respects_its_capacity(
        capacity in 1u32..4,
        calls in prop::collection::vec((0..3usize, 0..3usize, 0.0..100.0f64), 1..20),
    ) {
        let lobbies = ["L0", "L1", "L2"];
        let mut setup = tower(capacity);
        let name = |index: usize| format!("r{index}");
        for (index, (from, ..)) in calls.iter().enumerate() {
            setup = setup.robot(carrier(&name(index), lobbies[*from]));
        }
        let mut world = World::new(setup).unwrap();
        let mut order: Vec<usize> = (0..calls.len()).collect();
        order.sort_by(|a, b| calls[*a].2.total_cmp(&calls[*b].2));
        let mut got_there = BTreeSet::new();
        let mut keep = |events: Vec<BackendEvent>| {
            for event in events {
                if let BackendEvent::GoalEnded { robot, status: GoalStatus::Succeeded(_), .. } = event {
                    got_there.insert(robot.to_string());
                }
            }
        };
        for index in order {
            let (_, to, time) = calls[index];
            keep(world.advance(at(time)));
            rides(&mut world, &name(index), 1, lobbies[to]);
        }
        keep(world.advance(at(3_000.0)));
        prop_assert_eq!(got_there.len(), calls.len());
        let mut riding = BTreeMap::new();
        for entry in world.drain_event_log() {
            match entry.event {
                WorldEvent::LiftEntered { robot, .. } => drop(riding.insert(robot, ())),
                WorldEvent::LiftLeft { robot, .. } => drop(riding.remove(&robot)),
                _ => {}
            }
            prop_assert!(riding.len() <= capacity as usize, "{:?}", riding);
        }
    }
}
