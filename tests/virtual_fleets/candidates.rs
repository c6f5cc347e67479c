//! A large fleet asks the robots that may get a role, with the result of an auction that asks all.

use consort_fleet::node::NodeSettings;
use consort_protocol::auction::{AuctionRecord, BidVerdict, NotAskedReason, RobotOutcome, explain};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::lease::LeaseTerms;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

const SEEDS: [u64; 2] = [311, 312];
const SOON: Duration = Duration::from_secs(60);

/// Starts robots and two stations, with a new coordinator. Auctions of more than `count` robots ask that number of candidates first,
/// and promise no roles.
async fn new_fleet(seed: u64, robots: Vec<RobotSpec>, count: usize) -> Fleet {
    let adjust = Box::new(move |node: &mut NodeSettings| {
        node.fleet.promises.promises_max = 0;
        node.fleet.candidates.as_mut().expect("the fleet has candidates").count = count;
    });
    let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aba", "abb"], &[], adjust).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aba", "seed {seed}: the coordinator");
    let members = fleet.running().len();
    fleet
        .wait_until("that the coordinator knows all nodes", SOON, |fleet| {
            fleet.knowledge("aba").read(|base| base.iter().count()) >= members
        })
        .await;
    fleet
}

/// Does the same, and waits until the coordinator is no longer new.
async fn fleet(seed: u64, robots: Vec<RobotSpec>, count: usize) -> Fleet {
    let mut fleet = new_fleet(seed, robots, count).await;
    wait_for_records(&mut fleet).await;
    fleet
}

/// Waits for as long as a new coordinator may lack records.
async fn wait_for_records(fleet: &mut Fleet) {
    let LeaseTerms { lease, grace } = LeaseTerms::default();
    let complete = fleet.elapsed() + lease + grace;
    fleet.wait_until("that the coordinator has all records", SOON, |fleet| fleet.elapsed() > complete).await;
}

/// Requests a mission with a single task for a single robot.
async fn request(fleet: &Fleet, name: &str, task: &str, parameters: Value) -> MissionId {
    request_for(fleet, name, json!({ "kind": "managed" }), task, parameters).await
}

/// Does the same for a robot that suits this role.
async fn request_for(fleet: &Fleet, name: &str, visitor: Value, task: &str, parameters: Value) -> MissionId {
    let mission = json!({
        "request": name,
        "mission": {
            "mission": name,
            "roles": { "visitor": visitor },
            "root": { "task": "do", "type": task, "roles": ["visitor"], "parameters": parameters },
        },
    });
    let reply = fleet.request_answered(ApiCall::Submit, &mission).await;
    slug(reply["mission"].as_str().unwrap_or_else(|| panic!("seed {}: {reply}", fleet.seed)))
}

/// Requests a visit of a room.
async fn visit(fleet: &Fleet, name: &str, room: &str) -> MissionId {
    request(fleet, name, "navigation", json!({ "to": room })).await
}

/// Returns the robot of a mission, once it is awarded.
async fn award(fleet: &mut Fleet, mission: &MissionId) -> RobotId {
    let holder = |fleet: &Fleet| {
        let holders = fleet.events().into_iter().find_map(|event| match event {
            EventKind::Awarded { mission: awarded, holders, .. } if awarded == *mission => Some(holders),
            _ => None,
        });
        holders?.into_values().next()
    };
    fleet.wait_until("the award", SOON, |fleet| holder(fleet).is_some()).await;
    holder(fleet).expect("awarded")
}

/// Returns the numbers of robots that the first calls of all rounds of a mission asked.
fn asked(fleet: &Fleet, mission: &MissionId) -> Vec<usize> {
    let asked = |event| match event {
        EventKind::BidsRequested { mission: of, asked, .. } if of == *mission => Some(asked),
        _ => None,
    };
    fleet.events().into_iter().filter_map(asked).collect()
}

/// Returns the record of the latest auction of a mission.
fn record(fleet: &Fleet, mission: &MissionId) -> AuctionRecord {
    let closed = |event| match event {
        EventKind::Closed { mission: of, record } if of == *mission => Some(record),
        _ => None,
    };
    fleet.events().into_iter().filter_map(closed).next_back().expect("an auction was closed")
}

/// Returns the robots that were not asked for a reason.
fn not_asked(record: &AuctionRecord, reason: &NotAskedReason) -> Vec<String> {
    let of_reason = record
        .entries
        .iter()
        .filter(|entry| matches!(&entry.verdict, BidVerdict::NotAsked { reason: found, .. } if found == reason));
    of_reason.flat_map(|entry| entry.robots()).map(RobotId::to_string).collect()
}

fn carriers() -> Vec<RobotSpec> {
    let at = [
        ("amber", "IC Room 6"),
        ("birch", "IC Room 4"),
        ("cedar", "Dock"),
        ("dogwood", "PC Room 2"),
        ("elm", "PC Room 8"),
        ("fern", "PC Room 6"),
    ];
    at.map(|(name, place)| RobotSpec::carrier(name, place)).to_vec()
}

#[test]
fn candidates_give_the_awards_of_auctions_among_all() {
    for_each_seed(SEEDS, async |seed| {
        let mut awards = vec![];
        for count in [2, 16] {
            let mut fleet = fleet(seed, carriers(), count).await;
            let mut robots = vec![];
            for (name, room) in [("a", "IC Room 2"), ("b", "PC Room 3"), ("c", "PC Room 8"), ("d", "IC Room 5")] {
                let mission = visit(&fleet, name, room).await;
                robots.push(award(&mut fleet, &mission).await.to_string());
                let expected = if count == 2 { 2 } else { 7 };
                assert_eq!(asked(&fleet, &mission), [expected], "seed {seed}, {name}: robots that were asked");
            }
            awards.push(robots);
        }
        assert_eq!(awards[0], awards[1], "seed {seed}");
        assert_eq!(awards[0][..3], ["birch", "fern", "elm"], "seed {seed}");
    });
}

#[test]
fn a_new_coordinator_asks_all_robots_until_it_has_their_records() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = new_fleet(seed, carriers(), 2).await;
        let first = visit(&fleet, "a", "IC Room 2").await;
        award(&mut fleet, &first).await;
        assert_eq!(asked(&fleet, &first), [7], "seed {seed}");
        wait_for_records(&mut fleet).await;
        let second = visit(&fleet, "b", "PC Room 3").await;
        award(&mut fleet, &second).await;
        assert_eq!(asked(&fleet, &second), [2], "seed {seed}");
    });
}

#[test]
fn a_condition_on_the_charge_is_checked_by_the_robots() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, carriers(), 2).await;
        let visitor = json!({ "kind": "managed", "eligible": "robot.battery > 2.0" });
        let mission = request_for(&fleet, "a", visitor, "navigation", json!({ "to": "IC Room 2" })).await;
        let closed = |event: &EventKind| matches!(event, EventKind::Closed { mission: of, .. } if *of == mission);
        fleet.wait_until("an auction", SOON, |fleet| fleet.events().iter().any(closed)).await;
        let record = record(&fleet, &mission);
        let refused = record.entries.iter().filter(|entry| matches!(entry.verdict, BidVerdict::Refused { .. }));
        assert_eq!(refused.count(), 6, "seed {seed}: {record:?}");
        let skills = vec![slug("navigation")];
        assert_eq!(not_asked(&record, &NotAskedReason::MissingSkills { skills }), ["lab-arm"], "seed {seed}");
    });
}

#[test]
fn robots_that_were_not_asked_are_explained() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, carriers(), 2).await;
        let mission = visit(&fleet, "a", "IC Room 2").await;
        assert_eq!(award(&mut fleet, &mission).await.as_str(), "birch", "seed {seed}");
        let record = record(&fleet, &mission);
        let skills = vec![slug("navigation")];
        assert_eq!(not_asked(&record, &NotAskedReason::NotNeeded), ["cedar", "dogwood", "elm", "fern"], "seed {seed}");
        assert_eq!(not_asked(&record, &NotAskedReason::MissingSkills { skills }), ["lab-arm"], "seed {seed}");
        let explanation = explain(&record);
        let outcomes = explanation.roles[0].robots.iter().map(|robot| (robot.robot.as_str(), robot.outcome));
        let outcomes: Vec<(&str, RobotOutcome)> = outcomes.collect();
        let not_asked = |robot| (robot, RobotOutcome::NotAsked);
        let others = ["cedar", "dogwood", "elm", "fern", "lab-arm"].map(not_asked);
        assert_eq!(outcomes[..2], [("birch", RobotOutcome::Won), ("amber", RobotOutcome::Outbid)], "seed {seed}");
        assert_eq!(outcomes[2..], others, "seed {seed}");
        let explained = fleet.request_answered(ApiCall::Explain, &json!({ "mission": mission })).await.to_string();
        assert!(explained.contains("elm was not asked: by its record its bid could not"), "seed {seed}: {explained}");
        assert!(!explained.contains("a member of"), "seed {seed}: each robot has one reason: {explained}");
    });
}

#[test]
fn a_mission_without_a_free_robot_asks_none_until_one_is_free() {
    for_each_seed(SEEDS, async |seed| {
        let able = ["navigation", "operate_drawer", "wait"];
        let robots = ["amber", "birch", "cedar", "dogwood"];
        let specs = robots.map(|name| RobotSpec::carrier(name, "Dock").with_skills(&able)).to_vec();
        let mut fleet = fleet(seed, specs, 2).await;
        let mut busy = vec![];
        for name in ["a", "b", "c", "d"] {
            let mission = request(&fleet, name, "wait", json!({ "seconds": "1200" })).await;
            let robot = award(&mut fleet, &mission).await;
            busy.push((mission, robot));
        }
        let waiting = visit(&fleet, "e", "IC Room 2").await;
        fleet.wait_until("a second round", SOON, |fleet| asked(fleet, &waiting).len() > 1).await;
        assert!(asked(&fleet, &waiting).iter().all(|asked| *asked == 0), "seed {seed}: {:?}", asked(&fleet, &waiting));
        assert_eq!(not_asked(&record(&fleet, &waiting), &NotAskedReason::Busy), robots, "seed {seed}");
        let (ended, freed) = busy.remove(1);
        fleet.request_answered(ApiCall::Cancel, &json!({ "mission": ended })).await;
        assert_eq!(award(&mut fleet, &waiting).await, freed, "seed {seed}");
        assert_eq!(asked(&fleet, &waiting).last(), Some(&1), "seed {seed}");
    });
}

#[test]
fn a_robot_that_starts_later_gets_a_waiting_mission() {
    for_each_seed(SEEDS, async |seed| {
        let able = ["navigation", "operate_drawer", "wait"];
        let robot = |name| RobotSpec::carrier(name, "Dock").with_skills(&able);
        let mut specs = ["amber", "birch", "cedar"].map(robot).to_vec();
        specs.push(robot("dogwood").starting_later());
        let mut fleet = fleet(seed, specs, 2).await;
        for name in ["a", "b", "c"] {
            let mission = request(&fleet, name, "wait", json!({ "seconds": "1200" })).await;
            award(&mut fleet, &mission).await;
        }
        let waiting = visit(&fleet, "e", "IC Room 2").await;
        fleet.wait_until("an auction", SOON, |fleet| !asked(fleet, &waiting).is_empty()).await;
        fleet.start_robot("dogwood").await;
        assert_eq!(award(&mut fleet, &waiting).await.as_str(), "dogwood", "seed {seed}");
    });
}

/// Returns the times of the first calls of all rounds of a mission.
fn rounds(fleet: &Fleet, mission: &MissionId) -> Vec<Duration> {
    let entries = fleet.event_log.entries();
    let called = entries.iter().filter_map(|(at, entry)| match entry.event_kind()? {
        EventKind::BidsRequested { mission: of, .. } if of == mission => Some(*at),
        _ => None,
    });
    called.collect()
}

#[test]
fn a_freed_robot_wakes_only_missions_that_it_may_serve() {
    for_each_seed(SEEDS, async |seed| {
        let able = ["navigation", "operate_drawer", "wait"];
        let mut specs = vec![RobotSpec::carrier("dogwood", "Dock").with_skills(&able[1..])];
        specs.extend(["amber", "birch", "cedar"].map(|name| RobotSpec::carrier(name, "Dock").with_skills(&able)));
        let mut fleet = fleet(seed, specs, 2).await;
        let mut missions = BTreeMap::new();
        for name in ["a", "b", "c", "d"] {
            let mission = request(&fleet, name, "wait", json!({ "seconds": "1200" })).await;
            missions.insert(award(&mut fleet, &mission).await.to_string(), mission);
        }
        let waiting = visit(&fleet, "e", "IC Room 2").await;
        // After six rounds without a robot the next follows 5 s later.
        fleet.wait_until("six rounds", SOON, |fleet| rounds(fleet, &waiting).len() == 6).await;
        fleet.request_answered(ApiCall::Cancel, &json!({ "mission": missions["dogwood"] })).await;
        fleet.wait_until("the seventh round", SOON, |fleet| rounds(fleet, &waiting).len() == 7).await;
        fleet.request_answered(ApiCall::Cancel, &json!({ "mission": missions["amber"] })).await;
        assert_eq!(award(&mut fleet, &waiting).await.as_str(), "amber", "seed {seed}");
        let times = rounds(&fleet, &waiting);
        let pause = |round: usize| times[round] - times[round - 1];
        assert!(pause(6) > Duration::from_millis(4900), "seed {seed}: dogwood cannot serve it: {times:?}");
        assert!(pause(7) < Duration::from_secs(4), "seed {seed}: amber can: {times:?}");
    });
}

/// Returns the largest number of missions whose first auctions were open at the same time after a time, and the number of missions
/// with such auctions.
fn first_auctions(fleet: &Fleet, after: Duration) -> (usize, usize) {
    let (mut open, mut called, mut most) = (BTreeSet::new(), BTreeSet::new(), 0);
    for (at, entry) in fleet.event_log.entries() {
        match entry.event_kind() {
            Some(EventKind::BidsRequested { mission, round: 1, .. }) if at > after => {
                open.insert(mission.clone());
                called.insert(mission.clone());
                most = most.max(open.len());
            }
            Some(EventKind::Closed { mission, .. }) => {
                open.remove(mission);
            }
            _ => {}
        }
    }
    (most, called.len())
}

#[test]
fn a_new_coordinator_calls_few_waiting_missions_at_a_time() {
    for_each_seed([SEEDS[0]], async |seed| {
        let mut fleet = new_fleet(seed, carriers(), 2).await;
        let visitor = json!({ "kind": "managed", "eligible": "robot.battery > 2.0" });
        for number in 0..40 {
            let (name, to) = (format!("m-{number}"), json!({ "to": "IC Room 2" }));
            request_for(&fleet, &name, visitor.clone(), "navigation", to).await;
        }
        let killed_at = fleet.elapsed();
        fleet.kill("aba").await;
        fleet.wait_until("all auctions", SOON, |fleet| first_auctions(fleet, killed_at).1 == 40).await;
        let (most, _) = first_auctions(&fleet, killed_at);
        assert!(most <= 32, "seed {seed}: {most} at the same time");
    });
}

#[test]
fn the_number_of_calls_does_not_grow_with_the_fleet() {
    for_each_seed(SEEDS, async |seed| {
        let places = ["Dock", "IC Room 6", "PC Room 8", "Crossing"].iter().cycle();
        let robots =
            (0..24).zip(places).map(|(number, place)| RobotSpec::carrier(&format!("robot-{number:02}"), place));
        let mut fleet = fleet(seed, robots.collect(), 16).await;
        let mission = visit(&fleet, "a", "Dock").await;
        assert_eq!(award(&mut fleet, &mission).await.as_str(), "robot-00", "seed {seed}: the first of the nearest");
        assert_eq!(asked(&fleet, &mission), [16], "seed {seed}");
        let bids = fleet.events().into_iter().filter(|event| matches!(event, EventKind::Bid { .. })).count();
        assert_eq!(bids, 16, "seed {seed}");
    });
}
