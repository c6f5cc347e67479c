//! In a large fleet the motion of robots goes to the nodes that use it.

use crate::support::{drive_to_room, fleet_of, slow_carriers};
use consort_bus::Bus as _;
use consort_fleet::node::NodeSettings;
use consort_protocol::codec;
use consort_protocol::keys::{Key, KeyKind};
use consort_protocol::knowledge::MotionUpdate;
use consort_protocol::pose::Pose;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::Value;
use std::time::Duration;

const SEEDS: [u64; 2] = [821, 822];
const ROOM: &str = "IC Room 4";
const SOON: Duration = Duration::from_secs(60);

/// Longest time until a node that begins to receive motion, or has become coordinator, has received it of each robot.
const STALENESS_MAX: Duration = Duration::from_secs(8);

/// Starts three carriers and three stations, with the settings of a large fleet. Voters are the fixed nodes and `fern`.
async fn large_fleet(seed: u64) -> Fleet {
    let mut robots = slow_carriers();
    robots.push(RobotSpec::carrier("hazel", "Dock").with_speed(0.5));
    let adjust = |settings: &mut NodeSettings| settings.fleet.scoped_knowledge = true;
    let mut fleet = fleet_of(seed, robots, &[ROOM], adjust).await;
    let nodes = fleet.running();
    let know_all =
        |fleet: &Fleet| nodes.iter().all(|node| fleet.knowledge(node).read(|base| base.iter().count()) >= nodes.len());
    fleet.wait_until("that all know each other", SOON, know_all).await;
    fleet.wait_until("that fern votes", SOON, |fleet| fleet.knowledge("fern").receives_motion()).await;
    fleet
}

/// Returns the pose of a robot in the view of a node.
fn pose(fleet: &Fleet, node: &str, robot: &str) -> Pose {
    let known = fleet.knowledge_of(node, &slug(robot));
    known.unwrap_or_else(|| panic!("seed {}: {node} has no record of {robot}", fleet.seed)).pose
}

fn has_left(pose: Pose, start: Pose) -> bool {
    pose.distance(start).get() > 3.0
}

/// Returns the number of received messages about motion.
fn motion_messages(fleet: &Fleet, node: &str) -> u64 {
    let traffic = fleet.network.traffic(&slug(node));
    traffic.iter().filter(|(kind, _)| *kind == KeyKind::Motion).map(|(_, traffic)| traffic.messages_received).sum()
}

#[test]
fn motion_reaches_stations_voters_and_watchers_and_no_other_robot() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = large_fleet(seed).await;
        let watcher = fleet.network.bus(slug("watcher"));
        let mut motion = watcher.subscribe(&fleet.keys().any_motion()).await.expect("a virtual bus");
        let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
        let idle = if carrier == "gorse" { "hazel" } else { "gorse" };
        let start = pose(&fleet, idle, &carrier);
        let interested = ["aster", "basil", "lab-arm", "fern"];
        let follow = |fleet: &Fleet| interested.iter().all(|node| has_left(pose(fleet, node, &carrier), start));
        fleet.wait_until("that interested nodes follow the carrier", SOON, follow).await;
        assert_eq!(pose(&fleet, idle, &carrier), start, "seed {seed}");
        assert_eq!(motion_messages(&fleet, idle), 0, "seed {seed}");
        assert!(motion_messages(&fleet, "basil") > 0, "seed {seed}");

        let key = fleet.keys().write(&Key::Motion(slug(&carrier)));
        loop {
            let sample = motion.recv().await.expect("the bus is open");
            let update = codec::decode::<MotionUpdate>(&sample.payload).expect("an update");
            if sample.key == key && update.motion.is_some() {
                break;
            }
        }

        // A robot that receives no motion passes on what a voter shows.
        let view = fleet.keys().write(&Key::ViewFleet);
        let asked = fleet.network.bus(slug(idle));
        let mut replies =
            asked.query_nearest(&view, vec![].into(), Duration::from_secs(2)).await.expect("a virtual bus");
        let reply = replies.recv().await.expect("a reply").payload.expect("a view");
        let shown: Value = serde_json::from_slice(&reply).expect("JSON");
        let nodes = shown["nodes"].as_array().expect("nodes");
        let node = nodes.iter().find(|node| node["node"] == carrier.as_str()).expect("the carrier");
        let at = |axis: &str| node["robot"]["pose"][axis].as_f64().expect("a number");
        assert!(has_left(Pose::new(at("x_m"), at("y_m"), 0.0), start), "seed {seed}: {node}");
        fleet.assert_completes(&mission).await;
    });
}

#[test]
fn a_new_coordinator_receives_the_motion_of_robots() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = large_fleet(seed).await;
        let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
        let killed = fleet.kill_coordinator().await;
        let next = fleet.wait_for_coordinator().await.to_string();
        assert_ne!(next, killed.as_str(), "seed {seed}");
        let at_takeover = pose(&fleet, &next, &carrier);
        let moved = |fleet: &Fleet| pose(fleet, &next, &carrier) != at_takeover;
        fleet.wait_until("that the next coordinator receives motion", STALENESS_MAX, moved).await;
        fleet.assert_completes(&mission).await;
    });
}
