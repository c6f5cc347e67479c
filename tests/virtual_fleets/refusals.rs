//! Reasons why a robot does not win a role are published for people and programs.

use consort_fleet::node::NodeSettings;
use consort_protocol::auction::{AuctionRecord, BidVerdict, RefusalReason, ViabilityError};
use consort_protocol::event::EventKind;
use consort_protocol::keys::ApiCall;
use consort_skills::domain::hospital;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::sync::Arc;
use std::time::Duration;

const SEEDS: [u64; 2] = [111, 112];
const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

fn called(what: &EventKind) -> bool {
    matches!(what, EventKind::BidsRequested { .. })
}

/// Returns the records of all closed auctions in order.
fn records(fleet: &Fleet) -> Vec<AuctionRecord> {
    let closed = |what| match what {
        EventKind::Closed { record, .. } => Some(record),
        _ => None,
    };
    fleet.events().into_iter().filter_map(closed).collect()
}

/// Returns the verdict on the bid of a robot for the role of the carrier.
fn verdict(record: &AuctionRecord, robot: &str) -> BidVerdict {
    let is = |robot_is: &str, role: &str| robot_is == robot && role == "r1";
    let entry = record.entries.iter().find(|entry| is(entry.robot.as_str(), entry.role.as_str()));
    entry.unwrap_or_else(|| panic!("nothing of {robot} in {record:?}")).verdict.clone()
}

#[test]
fn every_refusal_reason_is_in_the_events_and_the_view() {
    for_each_seed(SEEDS, async |seed| {
        let able = ["navigation", "operate_drawer", "approach_robot"];
        let robots = vec![
            RobotSpec::carrier("amber", "IC Room 4"),
            RobotSpec::carrier("birch", "Dock").with_charge(0.1),
            RobotSpec::carrier("cedar", "Dock").with_skills(&able),
            RobotSpec::carrier("dogwood", "Dock"),
            RobotSpec::carrier("elm", "Dock"),
        ];
        // Without promises, the bid of a busy robot does not count.
        let adjust = Box::new(|node: &mut NodeSettings| node.fleet.promises.promises_max = 0);
        let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aba", "abb"], &[ROOM, "PC Room 8"], adjust).await;
        assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aba", "seed {seed}: the coordinator");
        fleet.submit("a", ROOM).await;
        fleet.wait_until("the first award", SOON, |fleet| records(fleet).len() == 1).await;
        fleet.network.block_outgoing(slug("elm"));
        fleet.submit("b", "PC Room 8").await;
        fleet.wait_until("the second auction", SOON, |fleet| records(fleet).len() == 2).await;

        let record = records(&fleet).remove(1);
        let lacks = ["approach_person", "authenticate_person"].into_iter().map(slug).collect();
        assert_eq!(
            verdict(&record, "amber"),
            BidVerdict::Refused { reason: RefusalReason::Busy { mission: slug("lab-samples-1"), role: slug("r1") } },
            "seed {seed}"
        );
        assert!(
            matches!(verdict(&record, "birch"), BidVerdict::Unviable { why: ViabilityError::LowCharge { .. }, .. }),
            "seed {seed}: {record:?}"
        );
        assert_eq!(
            verdict(&record, "cedar"),
            BidVerdict::Refused { reason: RefusalReason::MissingSkills { skills: lacks } },
            "seed {seed}"
        );
        assert!(matches!(verdict(&record, "dogwood"), BidVerdict::Viable { .. }), "seed {seed}: {record:?}");
        assert_eq!(
            verdict(&record, "elm"),
            BidVerdict::Refused { reason: RefusalReason::Silent { window_ms: 200 } },
            "seed {seed}"
        );
        // The view contains the same record, and the record of the first auction.
        let newest =
            |fleet: &Fleet| fleet.ledger(|ledger| ledger.mission(&slug("lab-samples-2"))?.auction.clone()).flatten();
        fleet.wait_until("the record in the ledger", SOON, |fleet| newest(fleet).is_some()).await;
        let view = fleet.view("auctions").await.remove("auctions").expect("a view");
        let mut shown = view["auctions"].as_array().expect("a list").iter();
        let mut shown = shown.find(|shown| shown["auction"]["mission"] == "lab-samples-2").expect("the second").clone();
        // The view also contains the record as text.
        let explanation = shown.as_object_mut().and_then(|shown| shown.remove("explanation")).expect("it is explained");
        let silent = explanation.to_string().contains("did not reply within 200 ms");
        assert!(silent, "seed {seed}: {explanation}");
        let expected = serde_json::to_value(newest(&fleet)).expect("JSON");
        assert_eq!(shown, expected, "seed {seed}");
        assert_eq!(shown["auction"], serde_json::to_value(&record.auction).expect("JSON"), "seed {seed}");
    });
}

#[test]
fn an_unreachable_place_leads_to_a_refusal_with_the_task() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![RobotSpec::carrier("amber", "IC Room 4")];
        // The node that admits the mission knows an attic, as with a newer map or without a map;
        // the robot does not.
        let adjust = Box::new(|node: &mut NodeSettings| node.fleet.domain = Arc::new(hospital()));
        let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aba"], &[ROOM], adjust).await;
        fleet.wait_for_coordinator().await;
        let request = json!({ "mission": "lab-samples", "parameters": { "room": "Attic" } });
        fleet.request_answered(ApiCall::Submit, &request).await;
        fleet.wait_until("an auction", SOON, |fleet| !records(fleet).is_empty()).await;
        let verdict = verdict(&records(&fleet)[0], "amber");
        let BidVerdict::Refused { reason: RefusalReason::NotFeasible { task, problem } } = verdict else {
            panic!("seed {seed}: {verdict:?}")
        };
        assert_eq!(task.as_str(), "navto_room", "seed {seed}");
        assert!(problem.contains("Attic"), "seed {seed}: {problem}");
        assert!(
            !fleet.has_event(|what| matches!(what, EventKind::Bid { bid, .. } if bid.role.as_str() == "r1")),
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
    });
}

#[test]
fn auctions_of_an_impossible_mission_back_off_until_a_robot_joins() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![
            RobotSpec::carrier("amber", "IC Room 4").with_charge(0.1),
            RobotSpec::carrier("birch", "Dock").starting_later(),
        ];
        let mut fleet = Fleet::hospital(seed, robots, &["aba"], &[ROOM]).await;
        fleet.wait_for_coordinator().await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("seven rounds", SOON, |fleet| fleet.event_log.count(called) == 7).await;
        let calls = fleet.event_log.times(called);
        let pauses: Vec<Duration> = calls.windows(2).map(|pair| pair[1] - pair[0]).collect();
        for (pause, least_ms) in pauses.iter().zip([250, 500, 1000, 2000, 4000, 5000]) {
            let least = Duration::from_millis(least_ms);
            // The coordinator reconciles every 200 ms.
            assert!(*pause >= least && *pause < least + Duration::from_millis(300), "seed {seed}: {pauses:?}");
        }
        let views = fleet.view("missions").await;
        let brief = &views["missions"]["missions"][0];
        assert_eq!(brief["state"], "pending", "seed {seed}");
        assert_eq!(brief["pending_reason"], "no viable bid for r1", "seed {seed}");
        let deferred = fleet.has_event(|what| matches!(what, EventKind::Awarded { .. }));
        assert!(!deferred, "seed {seed}\n{}", fleet.event_log_text());

        fleet.start_robot("birch").await;
        let joined = fleet.elapsed();
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.holder(&mission, "r1").expect("the holder").as_str(), "birch", "seed {seed}");
        let [awarded] = fleet.event_log.times(|what| matches!(what, EventKind::Awarded { .. }))[..] else {
            panic!("seed {seed}: expected a single award\n{}", fleet.event_log_text())
        };
        assert!(awarded - joined < Duration::from_secs(6), "seed {seed}: {:?}", awarded - joined);
        fleet.assert_each_task_once(&mission);
    });
}
