//! The ledger while missions wait.

use crate::support::fleet;
use consort_protocol::auction::BidVerdict;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::{Command, Ledger, MissionEntry};
use consort_tests::{Fleet, Observation, for_each_seed};
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// Matches an auction of the mission with a viable bid of gorse, or without one.
fn auction_with_gorse(of: &MissionId, bids: bool) -> impl Fn(&EventKind) -> bool {
    move |what| {
        let EventKind::Closed { mission, record } = what else { return false };
        let is_bid = |verdict: &BidVerdict| matches!(verdict, BidVerdict::Viable { .. });
        let mut entries = record.entries.iter();
        mission == of && entries.any(|entry| entry.robot.as_str() == "gorse" && is_bid(&entry.verdict)) == bids
    }
}

/// Counts the records of auctions without a result in the log.
fn deferred(fleet: &Fleet) -> usize {
    let entries = fleet.event_log.entries();
    let applied = entries.iter().filter(|(_, entry)| entry.node().as_str() == "aster");
    let commands = applied.flat_map(|(_, entry)| match entry {
        Observation::EntryApplied { commands, .. } => &commands[..],
        _ => &[],
    });
    commands.filter(|command| matches!(command, Command::Defer { .. })).count()
}

#[test]
fn a_waiting_mission_writes_a_record_for_many_auctions() {
    for_each_seed([151, 152], async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        fleet.kill("lab-arm").await;
        let mut missions = vec![];
        for number in 0..10 {
            missions.push(fleet.submit(&format!("request-{number}"), ROOM).await);
        }
        let last = &missions[9];
        let waits = |entry: &MissionEntry| entry.auction.as_ref().is_some_and(|auction| auction.failure.is_some());
        let all_wait =
            |ledger: &Ledger| ledger.active_missions().into_iter().filter(|entry| waits(entry)).count() == 10;
        fleet.wait_until("the records of all", SOON, |fleet| fleet.ledger(all_wait) == Some(true)).await;
        let began = fleet.elapsed();
        for _ in 0..4 {
            fleet.kill("gorse").await;
            fleet.wait_for_next("an auction without gorse", SOON, auction_with_gorse(last, false)).await;
            fleet.restart("gorse").await;
            fleet.wait_for_next("an auction with gorse", SOON, auction_with_gorse(last, true)).await;
        }
        // A waiting mission is recorded at most once in five minutes.
        let intervals = (fleet.elapsed() - began).as_secs() / 300;
        let records_max = missions.len() * usize::try_from(1 + intervals).expect("a short test");
        let records = deferred(&fleet);
        assert!(records <= records_max, "seed {seed}: {records} records\n{}", fleet.event_log_text());
        let bytes = |ledger: &Ledger| ledger.active_missions().into_iter().map(MissionEntry::encoded_bytes).max();
        let bytes = fleet.ledger(bytes).flatten().expect("missions wait");
        assert!(bytes < 8 * 1024, "seed {seed}: {bytes} bytes");
    });
}
