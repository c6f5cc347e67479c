//! News in the record of an auction without a result: whether the ledger stores it.

use consort_protocol::auction::{AuctionEntry, AuctionRecord, BidVerdict, NotAskedReason, RefusalReason};
use consort_protocol::ids::RobotId;
use std::mem::discriminant;

/// Minimum time between two records of auctions without a result of a mission that holds no robots, in milliseconds.
/// Raised: fewer entries of the log, and people read older reasons. In a fleet with a backlog each robot that becomes free
/// bids for all waiting missions.
const RECORD_INTERVAL_MS: u64 = 5 * 60 * 1000;

/// Checks whether the record of an auction without a result replaces the record in the ledger: it differs in more than times,
/// counters and details. A mission that holds no robots is in no circle of [`circular_waits`](super::circular_waits), and waits
/// for its next record, unless people have changed the orders of its roles or a permanent refusal has changed.
pub(super) fn is_news(known: &AuctionRecord, record: &AuctionRecord, holds_robots: bool, has_orders: bool) -> bool {
    let is_old = known.at_ms.abs_diff(record.at_ms) >= RECORD_INTERVAL_MS;
    let refuses = refusals_changed(known, record);
    let may_replace = holds_robots || has_orders || known.failure.is_none() || is_old || refuses;
    may_replace && differs(known, record, holds_robots)
}

/// Checks whether a robot of both records refuses a role permanently for another reason, or in one of them only. A robot that is
/// busy or silent in one of them may refuse as before: with a backlog each auction meets other busy robots.
fn refusals_changed(known: &AuctionRecord, record: &AuctionRecord) -> bool {
    record.entries.iter().any(|entry| {
        let is_same = |other: &&AuctionEntry| other.role == entry.role && other.robots().any(|it| *it == entry.robot);
        match known.entries.iter().find(is_same) {
            Some(before) => refusal_changed(&before.verdict, &entry.verdict),
            // The robot is new, unless the ledger has omitted its reply.
            None => known.omitted == 0 && is_permanent_refusal(&entry.verdict),
        }
    })
}

fn is_permanent_refusal(verdict: &BidVerdict) -> bool {
    matches!(verdict, BidVerdict::Refused { reason } if reason.is_permanent())
}

fn refusal_changed(before: &BidVerdict, now: &BidVerdict) -> bool {
    match (before, now) {
        (BidVerdict::Refused { reason: before }, BidVerdict::Refused { reason: now }) => {
            let is_busy = matches!(before, RefusalReason::Busy { .. } | RefusalReason::CarriesItem { .. });
            now.is_permanent() && !is_busy && discriminant(before) != discriminant(now)
        }
        (BidVerdict::NotAsked { reason: before, .. }, BidVerdict::Refused { reason: now }) => {
            *before == NotAskedReason::OutOfService && now.is_permanent()
        }
        (BidVerdict::Refused { reason }, BidVerdict::Viable { .. } | BidVerdict::Unviable { .. })
        | (BidVerdict::Viable { .. } | BidVerdict::Unviable { .. }, BidVerdict::Refused { reason }) => {
            reason.is_permanent()
        }
        _ => false,
    }
}

/// Checks whether a record differs from the previous record in more than times, counters and details.
/// The kinds of refusals count, because [`circular_waits`](super::circular_waits) reads them in the ledger. So do busy robots
/// that were not asked, if the mission holds robots: others may wait for it.
fn differs(known: &AuctionRecord, record: &AuctionRecord, holds_robots: bool) -> bool {
    let essence = |record: &AuctionRecord| {
        let verdicts = record.entries.iter().map(|entry| {
            let (reason, not_asked, counts) = match &entry.verdict {
                BidVerdict::Refused { reason } => (Some(discriminant(reason)), None, true),
                BidVerdict::NotAsked { reason, .. } => {
                    (None, Some(reason.clone()), holds_robots && *reason == NotAskedReason::Busy)
                }
                BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } => (None, None, true),
            };
            let robots: Vec<RobotId> = entry.robots().filter(|_| counts).cloned().collect();
            (entry.role.clone(), robots, discriminant(&entry.verdict), reason, not_asked)
        });
        (record.failure.clone(), verdicts.collect::<Vec<_>>())
    };
    essence(known) != essence(record)
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::auction::AuctionId;
    use consort_protocol::ids::{MissionId, RoleId};
    use consort_protocol::units::Seconds;
    use std::collections::BTreeSet;

    /// Returns the record of an auction without a result, whose only robot is busy or does not reply.
    fn failed(at_ms: u64, is_busy: bool) -> AuctionRecord {
        let (mission, role): (MissionId, RoleId) = ("m-1".parse().unwrap(), "r1".parse().unwrap());
        let reason = match is_busy {
            true => RefusalReason::Busy { mission: "m-7".parse().unwrap(), role: role.clone() },
            false => RefusalReason::Silent { window_ms: 200 },
        };
        let (robot, verdict, parts) = ("amber".parse().unwrap(), BidVerdict::Refused { reason }, vec![]);
        AuctionRecord {
            at_ms,
            entries: vec![AuctionEntry { role, robot, verdict, parts }],
            failure: Some("no viable bid for r1".to_owned()),
            ..AuctionRecord::empty(AuctionId { mission, term: 1, round: 1 })
        }
    }

    #[test]
    fn a_permanent_refusal_is_recorded_at_once() {
        let known = failed(0, false);
        let mut lacks = failed(1, false);
        lacks.entries[0].verdict = BidVerdict::Refused { reason: RefusalReason::MissingSkills { skills: vec![] } };
        assert!(is_news(&known, &lacks, false, false), "the robot has replied since");
        assert!(!is_news(&lacks, &lacks.clone(), false, false));
        let mut bids = failed(2, false);
        let (time, energy, remaining) = (Seconds::ZERO, 0.0, 1.0);
        bids.entries[0].verdict = BidVerdict::Viable { time, energy, remaining };
        assert!(is_news(&lacks, &bids, false, false), "and offers the skill now");
        assert!(is_news(&bids, &lacks, false, false), "and no longer");
    }

    #[test]
    fn a_robot_that_is_busy_or_silent_meanwhile_refuses_as_before() {
        let mut lacks = failed(0, false);
        lacks.entries[0].verdict = BidVerdict::Refused { reason: RefusalReason::MissingSkills { skills: vec![] } };
        let mut not_asked = failed(0, false);
        let (reason, cost_min, others) = (NotAskedReason::Busy, 0.0, BTreeSet::new());
        not_asked.entries[0].verdict = BidVerdict::NotAsked { reason, cost_min, others };
        for busy in [failed(0, true), not_asked] {
            assert!(!is_news(&lacks, &busy, false, false), "the robot is busy");
            assert!(!is_news(&busy, &lacks, false, false), "the robot is free again");
        }
        assert!(!is_news(&lacks, &failed(0, false), false, false), "a reply is lost");
        let none = |omitted| AuctionRecord { entries: vec![], omitted, ..lacks.clone() };
        assert!(!is_news(&none(1), &lacks, false, false), "its refusal was omitted");
        assert!(is_news(&none(0), &lacks, false, false), "the robot is new");
    }

    #[test]
    fn a_waiting_mission_without_robots_records_another_outcome_after_an_interval() {
        let known = failed(0, true);
        for holds_robots in [false, true] {
            let same = failed(RECORD_INTERVAL_MS, true);
            assert!(!is_news(&known, &same, holds_robots, true), "the outcome is the same");
            assert!(is_news(&known, &failed(RECORD_INTERVAL_MS, false), holds_robots, false));
            assert_eq!(is_news(&known, &failed(RECORD_INTERVAL_MS - 1, false), holds_robots, false), holds_robots);
            assert!(is_news(&known, &failed(1, false), holds_robots, true), "a person has given an order");
            let award = AuctionRecord { failure: None, ..known.clone() };
            assert!(is_news(&award, &failed(1, true), holds_robots, false), "the mission waits again");
        }
    }
}
