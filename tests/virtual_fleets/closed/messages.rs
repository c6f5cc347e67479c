//! Messages between nodes: those of the fleet are accepted, and those of an attacker with the key of a robot change no
//! mission.

use super::attacker::Compromised;
use super::{ROOM, SEEDS, SOON, closed, refused, stolen, wire};
use crate::support::released;
use consort_bus::{Delivery, Encoding, SharedBus};
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::Key;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Ledger;
use consort_protocol::message::{ReportReply, SignalHistory};
use consort_protocol::trust::NodeRole;
use consort_tests::{Fleet, RobotSpec, StolenKey, for_each_seed, report_of_all_steps, signals_sent};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

#[test]
fn a_closed_fleet_completes_a_mission_after_a_takeover() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock")).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet
            .wait_until("the first task", SOON, |fleet| {
                fleet.has_event(|what| matches!(what, EventKind::TaskBegan { .. }))
            })
            .await;
        fleet.kill("aster").await;
        fleet.wait_for_coordinator().await;
        fleet.start_station("aster").await;
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        assert_eq!(refused(&fleet), BTreeSet::new(), "seed {seed}: friends are taken for foes");
    });
}

#[test]
fn the_key_of_a_robot_gives_no_power_over_other_nodes() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let StolenKey { signing, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let fern = Arc::new(Compromised { signing, plain, keys: fleet.keys().clone(), did: Default::default() });
        let mut tasks = tokio::task::JoinSet::new();
        tasks.spawn(Arc::clone(&fern).repeats());
        tasks.spawn(Arc::clone(&fern).claims());
        for key in ["wire/bid/*", "wire/award/*", "wire/report/*", "wire/raft/*/*", "wire/driver/*/command"] {
            tasks.spawn(Arc::clone(&fern).answers(key, false));
            tasks.spawn(Arc::clone(&fern).answers(key, true));
            tasks.spawn(Arc::clone(&fern).refuses(key, false));
            tasks.spawn(Arc::clone(&fern).refuses(key, true));
        }
        let elected = |what: &EventKind| matches!(what, EventKind::Elected { .. });
        let before = fleet.event_log.count(elected);
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        assert_eq!(
            fleet.holder(&mission, "r1").map(|robot| robot.to_string()),
            Some("gorse".to_owned()),
            "seed {seed}"
        );
        assert_eq!(
            fleet.event_log.count(elected),
            before,
            "seed {seed}: the coordinator is unchanged\n{}",
            fleet.event_log_text()
        );
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
        assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}");
        let did = fern.did.each_ref().map(|count| count.load(Ordering::Relaxed));
        assert!(
            did.iter().all(|count| *count > 10),
            "seed {seed}: repeated, moved, claimed, answered, refused: {did:?}"
        );
        let refusals = refused(&fleet);
        for reason in [
            "node fern (robot) may not publish on wire/beacon",
            "node fern (robot) may not publish on wire/knowledge/gorse",
            "node fern (robot) may not publish on wire/driver/gorse/state",
            "node fern (robot) may not reply on wire/report/aster",
            "node fern (robot) may not reply on wire/driver/gorse/command",
        ] {
            assert!(refusals.contains(reason), "seed {seed}: {reason}: {refusals:#?}");
        }
        let raft = refusals.iter().any(|refusal| refusal.starts_with("node fern (robot) may not reply on wire/raft/"));
        assert!(raft, "seed {seed}: {refusals:#?}");
        tasks.shutdown().await;
    });
}

/// Attacks the roles of other robots and people in a mission: ends their steps and sends their
/// signals, under their award and under later ones. Returns the number of accepted reports.
async fn take_part_in(fleet: &Fleet, bus: &SharedBus, mission: &MissionId) -> usize {
    let (keys, mut accepted) = (fleet.keys(), 0);
    let Some(entry) = fleet.ledger(|ledger| ledger.mission(mission).cloned()).flatten() else { return accepted };
    for role in entry.roles.keys() {
        let Some(plan) = entry.plan(role) else { continue };
        let report = report_of_all_steps("fern".parse().expect("a name"), &entry, role).expect("it has a plan");
        for to in ["aster", "basil", "clove"] {
            let key = keys.write(&Key::Report(to.parse().expect("a name")));
            let mut replies = bus.query(&key, wire(&report), Duration::from_millis(100)).await.expect("a network");
            while let Some(reply) = replies.recv().await {
                let reply = reply.payload.ok().and_then(|bytes| codec::decode::<ReportReply>(&bytes).ok());
                accepted += usize::from(matches!(reply, Some(ReportReply::Renewed { .. })));
            }
        }
        let award = report.epoch;
        for signal in signals_sent(plan) {
            for epoch in [award, Epoch { index: award.index + 1, ..award }, Epoch { term: u64::MAX, index: u64::MAX }] {
                let to = keys.write(&Key::Signal(mission.clone(), signal.to.clone()));
                let history = SignalHistory { mission: mission.clone(), epoch, signals: [signal.clone()].into() };
                bus.publish(&to, wire(&history), Encoding::Wire, Delivery::Block).await.expect("a network");
            }
        }
    }
    accepted
}

#[test]
fn the_key_of_a_robot_takes_no_part_in_missions_of_others() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let mission = fleet.submit("a", ROOM).await;
        let bus = stolen(&fleet, "fern", NodeRole::Robot).await.in_cluster(&fleet);
        let is_final = |ledger: &Ledger| ledger.mission(&mission).is_some_and(|entry| entry.state.is_final());
        while !fleet.ledger(is_final).unwrap_or(false) {
            let accepted = take_part_in(&fleet, &bus, &mission).await;
            assert_eq!(accepted, 0, "seed {seed}: a report for a role of others was accepted");
            let asked = fleet.ledger(|ledger| {
                ledger.missions().flat_map(|entry| entry.open_questions()).map(|(_, asked)| asked.number).max()
            });
            assert_eq!(asked.flatten(), None, "seed {seed}: a question in the name of the holder was asked");
            tokio::time::sleep(Duration::from_millis(500)).await; // virtual time
        }
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        // Signals under older awards are reported; those of the holder are not among them.
        let stale = |what: &EventKind| matches!(what, EventKind::StaleSignal { epoch, .. } if epoch.term > 0);
        assert_eq!(fleet.event_log.count(stale), 0, "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
    });
}
