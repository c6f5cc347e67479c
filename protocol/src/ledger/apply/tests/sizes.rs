//! Sizes of what the ledger stores.

use super::{Log, epoch, record, robot, role};
use crate::auction::{AuctionEntry, AuctionRecord, BidVerdict, RefusalReason};
use crate::cause::CauseClass;
use crate::codec;
use crate::ids::{MissionId, RobotId, RoleId, TaskId};
use crate::ledger::branch::Branch;
use crate::ledger::command::{Command, CommandOutcome};
use crate::ledger::entry::{MissionEntry, MissionState, RELEASES_KEPT};
use crate::ledger::history_limits::HistoryLimits;
use crate::ledger::limits::UNENDED_MAX;
use crate::mission::TaskOutcome;
use crate::scalar::Scalar;
use std::collections::{BTreeMap, BTreeSet};

impl Log {
    /// Awards these roles of a mission, and releases `r1`.
    fn award_and_release(
        &mut self,
        mission: &MissionId,
        holders: BTreeMap<RoleId, RobotId>,
        auction: AuctionRecord,
        cause: String,
    ) {
        let award = Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction };
        let CommandOutcome::Awarded { epoch } = self.apply(award) else { panic!("not awarded") };
        self.apply(Command::Release {
            mission: mission.clone(),
            role: role("r1"),
            epoch,
            cause,
            class: Some(CauseClass::Robot),
            moved_nothing: false,
            place: None,
            gave_way: false,
        });
    }

    /// Awards the roles of a mission, and releases `r1` more often than the ledger keeps releases, each time with a long
    /// cause. The last award follows many long refusals.
    fn release_at_length(&mut self, mission: &MissionId, number: usize) {
        let reason = RefusalReason::OutOfService { problem: "no route; ".repeat(200) };
        let verdict = BidVerdict::Refused { reason };
        let refusal = AuctionEntry { role: role("r1"), robot: robot("bob"), verdict, parts: vec![] };
        let (arm, cart) = (robot(&format!("arm{number}")), robot(&format!("cart{number}")));
        let mut holders = BTreeMap::from([(role("lab_arm"), arm), (role("r1"), cart.clone())]);
        for round in 0..=RELEASES_KEPT {
            let refusals = if round == RELEASES_KEPT { 100 } else { 0 };
            let auction = AuctionRecord { entries: vec![refusal.clone(); refusals], ..record() };
            self.award_and_release(mission, holders, auction, "no route; ".repeat(2_000));
            holders = BTreeMap::from([(role("r1"), cart.clone())]);
        }
    }
}

/// The names of results count, too: a hostile holder chooses them.
#[test]
fn the_outcomes_of_a_mission_have_a_bounded_size() {
    let mut log = Log::new();
    let mission = log.submit("a");
    log.award(&mission, "arm", "ada");
    let results = (0..16).map(|number| (format!("{number}{}", "x".repeat(3_000)), Scalar::Bool(true)));
    let outcomes = BTreeMap::from([(TaskId::new("pick_up_parcel").unwrap(), TaskOutcome::Done(results.collect()))]);
    let (role, branch, ended) = (role("lab_arm"), Branch::Main, BTreeSet::from([0]));
    log.apply(Command::Progress { mission: mission.clone(), role, epoch: epoch(2), branch, ended, outcomes });
    let recorded = &log.0.mission(&mission).unwrap().outcomes;
    assert!(codec::encoded_size(recorded) < 16 * 1024, "{} bytes", codec::encoded_size(recorded));
}

#[test]
fn long_texts_do_not_exceed_the_limit_of_a_mission() {
    let mut log = Log::with_history();
    let mission = log.submit("a");
    let long = "no route; ".repeat(6000);
    let reason = RefusalReason::OutOfService { problem: long.clone() };
    let verdict = BidVerdict::Refused { reason };
    let entry = AuctionEntry { role: role("r1"), robot: robot("bob"), verdict, parts: vec![] };
    let auction = AuctionRecord { entries: vec![entry; 300], failure: Some(long.clone()), ..record() };
    for _ in 0..20 {
        let holders = BTreeMap::from([(role("lab_arm"), robot("arm")), (role("r1"), robot("ada"))]);
        let holders = if log.1 == 3 { holders } else { BTreeMap::from([(role("r1"), robot("ada"))]) };
        log.award_and_release(&mission, holders, auction.clone(), long.clone());
    }
    let (places, cause, class) = (BTreeMap::new(), long.clone(), CauseClass::Task);
    log.apply(Command::Fail { mission: mission.clone(), cause, branch: None, places, class });
    let entry = log.0.mission(&mission).unwrap();
    assert!(
        matches!(&entry.state, MissionState::Failed { cause, .. } if cause.starts_with("no route; no") && cause.len() <= 1024)
    );
    assert!(codec::encoded_size(entry) < 64 * 1024);
}

/// What robots send at length, mission after mission, is stored within the limits, so that each other replica can install a
/// snapshot of a ledger that is full of such missions.
#[test]
fn a_snapshot_of_many_missions_with_long_texts_can_be_installed() {
    let (unended, ended) = (40, 100);
    let mut log = Log::with_history();
    let limits = HistoryLimits { missions_max: 20, outcome_bytes_max: 16 * 1024, ..HistoryLimits::default() };
    log.apply(Command::SetHistoryLimits(limits));
    for number in 0..unended + ended {
        let mission = log.submit(&format!("request{number}"));
        log.release_at_length(&mission, number);
        if number >= unended {
            let (cause, places, class) = ("no route; ".repeat(6_000), BTreeMap::new(), CauseClass::Task);
            log.apply(Command::Fail { mission, cause, branch: None, places, class });
        }
    }
    let sizes: Vec<usize> = log.0.missions().map(MissionEntry::encoded_bytes).collect();
    assert_eq!(sizes.len(), 60, "unended missions, and the ended ones that are kept whole");
    for bytes in &sizes {
        assert!((32 * 1024..64 * 1024).contains(bytes), "{bytes} bytes of a mission");
    }
    let outcomes = codec::encoded_size(&log.0.versioned.history);
    assert!(outcomes < 17 * 1024, "{outcomes} bytes of outcomes");
    assert!((20..ended).contains(&log.0.latest_ended().count()), "the earliest outcomes are forgotten");

    let snapshot = codec::encode_record(&log.0).unwrap();
    let missions_max = UNENDED_MAX + HistoryLimits::LARGEST.missions_max as usize;
    let largest = snapshot.len() / sizes.len() * missions_max;
    assert!(largest < codec::RECORD_BYTES_MAX, "{largest} bytes of a full ledger");
    let mut copy = Log(codec::decode_record(&snapshot).unwrap(), log.1);
    assert!(copy.0 == log.0);
    let (first, again) = (log.submit("next"), copy.submit("next"));
    assert_eq!((&first, copy.cancel(&first)), (&again, log.cancel(&first)));
    assert!(copy.0 == log.0);
}
