//! From answers to a decision.

use super::allocator::{Allocator, AllocatorInput, OptimalAssignment};
use super::bid::{Bid, BidLimits, BidPart, BidResponse, CallForBids, RefusalReason, RoleReply};
use super::record::{AuctionEntry, AuctionRecord, BidVerdict};
use crate::ids::{RobotId, RoleId};
use crate::units::Seconds;
use std::collections::{BTreeMap, BTreeSet};

/// What an auction came to.
#[derive(Debug, Clone, PartialEq)]
pub struct AuctionOutcome {
    /// Who gets which role: every role of the call, or `None`.
    pub holders: Option<BTreeMap<RoleId, RobotId>>,
    /// How it came about.
    pub record: AuctionRecord,
    /// Roles at which somebody has failed, and which all others refuse for good.
    pub unfillable: BTreeSet<RoleId>,
}

/// What the coordinator knows beside the answers.
#[derive(Debug, Clone)]
pub struct AuctionContext<'a> {
    /// Who should have answered.
    pub invited: &'a BTreeSet<RobotId>,
    /// Robots whose bids do not count, and why: they hold a role, or are about to, and may have bid before they heard of
    /// that; or they still carry something of another mission.
    pub unavailable: &'a BTreeMap<RobotId, RefusalReason>,
    /// Robots that failed at a role in this mission, and why.
    pub excluded: &'a BTreeMap<RoleId, BTreeMap<RobotId, String>>,
    /// What bids must keep to.
    pub limits: &'a BidLimits,
    /// How long was waited for answers, in milliseconds.
    pub window_ms: u64,
    /// The time to write into the record.
    pub at_ms: u64,
}

/// Judges all answers to a call and chooses. Robots that were expected and said nothing are recorded as silent; so every
/// robot that could have had a role, and why it did not get it, is in the record.
pub fn clear_auction(
    call: &CallForBids,
    tenders: &[BidResponse],
    circumstances: &AuctionContext<'_>,
) -> AuctionOutcome {
    clear_auction_with(call, tenders, circumstances, &OptimalAssignment)
}

/// The same by another rule.
pub fn clear_auction_with(
    call: &CallForBids,
    tenders: &[BidResponse],
    circumstances: &AuctionContext<'_>,
    choice: &dyn Allocator,
) -> AuctionOutcome {
    let answers = answers_to(call, tenders);
    let mut entries = judged(call, &answers, circumstances);
    let hopeless = hopeless(call, &entries, circumstances);
    let (holders, failure) = match chosen_by(choice, call, &answers, &entries, circumstances.limits) {
        Ok(holders) => (Some(holders), None),
        Err(problem) => (None, Some(problem)),
    };
    let omitted = entries.len().saturating_sub(AuctionRecord::ENTRIES_MAX);
    if omitted > 0 {
        // Those who could do the work are the ones people ask about first.
        entries.sort_by_key(|entry| matches!(entry.verdict, BidVerdict::Refused { .. }));
        entries.truncate(AuctionRecord::ENTRIES_MAX);
    }
    let chosen = holders.clone().unwrap_or_default();
    keep_parts(&mut entries, &chosen, |role, robot| bid_of(&answers, role, robot).map_or(&[], |bid| &bid.parts));
    let record = AuctionRecord {
        auction: call.auction.clone(),
        at_ms: circumstances.at_ms,
        entries,
        omitted: u32::try_from(omitted).unwrap_or(u32::MAX),
        chosen,
        failure,
    };
    AuctionOutcome { holders, record, unfillable: hopeless }
}

/// What each robot answered for each role; its first answer counts.
type Answers<'a> = BTreeMap<(&'a RoleId, &'a RobotId), &'a RoleReply>;

/// What was answered to this call; nobody answers for another.
fn answers_to<'a>(call: &CallForBids, tenders: &'a [BidResponse]) -> Answers<'a> {
    let mut answers = Answers::new();
    for tender in tenders.iter().filter(|tender| tender.auction == call.auction) {
        for answer in &tender.replies {
            let (role, robot) = match answer {
                RoleReply::Bid(bid) => (&bid.role, &bid.robot),
                RoleReply::Refusal(refusal) => (&refusal.role, &refusal.robot),
            };
            if *robot == tender.robot {
                answers.entry((role, robot)).or_insert(answer);
            }
        }
    }
    answers
}

fn bid_of<'a>(answers: &Answers<'a>, role: &RoleId, robot: &RobotId) -> Option<&'a Bid> {
    match answers.get(&(role, robot)) {
        Some(RoleReply::Bid(bid)) => Some(bid),
        Some(RoleReply::Refusal(_)) | None => None,
    }
}

/// A verdict on every robot for every role: on those that answered, and on those that should have.
fn judged(call: &CallForBids, answers: &Answers<'_>, circumstances: &AuctionContext<'_>) -> Vec<AuctionEntry> {
    let robots: BTreeSet<&RobotId> =
        circumstances.invited.iter().chain(answers.keys().map(|(_, robot)| *robot)).collect();
    let mut entries = vec![];
    for role in call.roles.keys() {
        for &robot in &robots {
            let excluded = circumstances.excluded.get(role).and_then(|excluded| excluded.get(robot));
            let verdict = match answers.get(&(role, robot)) {
                _ if let Some(cause) = excluded => {
                    BidVerdict::Refused { reason: RefusalReason::Excluded { cause: cause.clone() } }
                }
                Some(RoleReply::Bid(bid)) => judge(bid, circumstances),
                Some(RoleReply::Refusal(refusal)) => BidVerdict::Refused { reason: refusal.reason.clone() },
                None => BidVerdict::Refused { reason: RefusalReason::Silent { window_ms: circumstances.window_ms } },
            };
            entries.push(AuctionEntry { role: role.clone(), robot: robot.clone(), verdict, parts: vec![] });
        }
    }
    entries
}

/// Roles of the call at which somebody has failed, and which all others refuse for good.
fn hopeless(call: &CallForBids, entries: &[AuctionEntry], circumstances: &AuctionContext<'_>) -> BTreeSet<RoleId> {
    let for_good = |entry: &AuctionEntry| match &entry.verdict {
        // Whoever is at work for this very mission will not be free before it ends.
        BidVerdict::Refused { reason: RefusalReason::Busy { mission, .. } } => *mission == call.auction.mission,
        BidVerdict::Refused { reason } => reason.is_permanent(),
        BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } => false,
    };
    let failed_at = circumstances.excluded.iter().filter(|(_, excluded)| !excluded.is_empty()).map(|(role, _)| role);
    let called = failed_at.filter(|role| call.roles.contains_key(*role));
    called.filter(|role| entries.iter().filter(|entry| entry.role == **role).all(for_good)).cloned().collect()
}

/// Who gets which role by the rule, of those whom the verdicts leave to it; or why nobody does.
fn chosen_by(
    choice: &dyn Allocator,
    call: &CallForBids,
    answers: &Answers<'_>,
    entries: &[AuctionEntry],
    limits: &BidLimits,
) -> Result<BTreeMap<RoleId, RobotId>, String> {
    let mut open: BTreeMap<RoleId, BTreeSet<RobotId>> =
        call.roles.keys().map(|role| (role.clone(), BTreeSet::new())).collect();
    for entry in entries.iter().filter(|entry| may_be_given(&entry.verdict)) {
        open.entry(entry.role.clone()).or_default().insert(entry.robot.clone());
    }
    let viable = entries.iter().filter(|entry| matches!(entry.verdict, BidVerdict::Viable { .. }));
    let viable: Vec<&Bid> = viable.filter_map(|entry| bid_of(answers, &entry.role, &entry.robot)).collect();
    let bids: Vec<&Bid> = answers
        .iter()
        .filter(|((role, robot), _)| open.get(*role).is_some_and(|robots| robots.contains(*robot)))
        .filter_map(|(_, answer)| if let RoleReply::Bid(bid) = answer { Some(bid) } else { None })
        .collect();
    choice.allocate(&AllocatorInput { call, candidates: &open, bids: &bids, viable: &viable, limits })
}

/// Writes the parts of bids into a record for as long as there is room: first the winners', then by time, and those that
/// could not be taken at last.
fn keep_parts<'a>(
    entries: &mut [AuctionEntry],
    chosen: &BTreeMap<RoleId, RobotId>,
    parts_of: impl Fn(&RoleId, &RobotId) -> &'a [BidPart],
) {
    let mut order: Vec<(bool, bool, Seconds, &mut AuctionEntry)> = entries
        .iter_mut()
        .filter_map(|entry| match entry.verdict {
            BidVerdict::Viable { time, .. } => {
                Some((chosen.get(&entry.role) != Some(&entry.robot), false, time, entry))
            }
            BidVerdict::Unviable { time, .. } => Some((true, true, time, entry)),
            BidVerdict::Refused { .. } => None,
        })
        .collect();
    order.sort_by(|one, other| (one.0, one.1).cmp(&(other.0, other.1)).then(one.2.get().total_cmp(&other.2.get())));
    let mut room = AuctionRecord::PARTS_BYTES_MAX;
    for (_, _, _, entry) in order {
        let parts = parts_of(&entry.role, &entry.robot);
        let bytes: usize = parts.iter().map(|part| part.label.len() + part.skill.as_str().len() + 24).sum();
        let Some(left) = room.checked_sub(bytes) else { return };
        room = left;
        entry.parts = parts.to_vec();
    }
}

/// Whether a robot may be given a role as far as the others are concerned: a rule other than ours may try its luck.
fn may_be_given(verdict: &BidVerdict) -> bool {
    match verdict {
        BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } => true,
        BidVerdict::Refused { reason } => {
            matches!(reason, RefusalReason::MissingSkills { .. } | RefusalReason::NotFeasible { .. })
        }
    }
}

fn judge(bid: &Bid, circumstances: &AuctionContext<'_>) -> BidVerdict {
    let Bid { time, energy, remaining, .. } = *bid;
    if let Some(reason) = circumstances.unavailable.get(&bid.robot) {
        return BidVerdict::Refused { reason: reason.clone() };
    }
    match bid.check_viable(circumstances.limits) {
        Ok(()) => BidVerdict::Viable { time, energy, remaining },
        Err(why) => BidVerdict::Unviable { time, energy, remaining, why },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::auction::{AuctionId, BidRefusal};
    use crate::ids::{EnsembleId, MissionId, PlaceId};
    use crate::plan::LocalPlan;
    use crate::units::BatteryShare;

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    fn role() -> RoleId {
        RoleId::new("r1").unwrap()
    }

    fn call() -> CallForBids {
        CallForBids {
            auction: AuctionId { mission: MissionId::new("m-1").unwrap(), term: 3, round: 1 },
            ensemble: EnsembleId::new("all").unwrap(),
            roles: BTreeMap::from([(role(), LocalPlan::of(role(), vec![]))]),
        }
    }

    static NOBODY: BTreeMap<RoleId, BTreeMap<RobotId, String>> = BTreeMap::new();

    fn circumstances<'a>(
        expected: &'a BTreeSet<RobotId>,
        taken: &'a BTreeMap<RobotId, RefusalReason>,
        excluded: &'a BTreeMap<RoleId, BTreeMap<RobotId, String>>,
    ) -> AuctionContext<'a> {
        static LIMITS: std::sync::LazyLock<BidLimits> = std::sync::LazyLock::new(BidLimits::default);
        AuctionContext { invited: expected, unavailable: taken, excluded, limits: &LIMITS, window_ms: 200, at_ms: 0 }
    }

    fn bids(name: &str, time: f64, remaining: f64) -> BidResponse {
        let bid = Bid {
            robot: robot(name),
            role: role(),
            time: Seconds::new(time).unwrap(),
            energy: 0.1,
            remaining,
            useful_charge: BatteryShare::new(0.08).unwrap(),
            from: PlaceId::new("dock").unwrap(),
            age_ms: 0,
            parts: vec![],
        };
        BidResponse { robot: robot(name), auction: call().auction, replies: vec![RoleReply::Bid(bid)] }
    }

    #[test]
    fn every_robot_and_why_it_did_not_get_the_role_is_in_the_record() {
        let expected = ["ada", "bob", "cyd", "dan", "eve", "fay"].map(robot).into_iter().collect();
        let taken_by = RefusalReason::Busy { mission: MissionId::new("m-0").unwrap(), role: role() };
        let taken = BTreeMap::from([(robot("bob"), taken_by)]);
        let circumstances = circumstances(&expected, &taken, &NOBODY);
        let busy = RefusalReason::Busy { mission: MissionId::new("m-7").unwrap(), role: role() };
        let refusal = BidRefusal { robot: robot("dan"), role: role(), reason: busy.clone() };
        let refuses =
            BidResponse { robot: robot("dan"), auction: call().auction, replies: vec![RoleReply::Refusal(refusal)] };
        let tenders =
            [bids("ada", 9.0, 0.5), bids("bob", 1.0, 0.5), bids("cyd", 2.0, 0.06), refuses, bids("eve", 8.0, 0.5)];
        let conclusion = clear_auction(&call(), &tenders, &circumstances);

        assert_eq!(conclusion.holders, Some(BTreeMap::from([(role(), robot("eve"))])));
        let said: Vec<String> = conclusion
            .record
            .entries
            .iter()
            .map(|entry| match &entry.verdict {
                BidVerdict::Viable { time, .. } => format!("{}: {time:.0}", entry.robot),
                BidVerdict::Unviable { why, .. } => format!("{}: {why}", entry.robot),
                BidVerdict::Refused { reason } => format!("{}: {reason}", entry.robot),
            })
            .collect();
        assert_eq!(
            said,
            [
                "ada: 9 s",
                "bob: busy as r1 of m-0",
                "cyd: 6.0 % charge left is not above 8.0 %",
                "dan: busy as r1 of m-7",
                "eve: 8 s",
                "fay: no answer within 200 ms",
            ]
        );
    }

    /// Gives each role to the last of those who may have it.
    #[derive(Debug)]
    struct Last;

    impl Allocator for Last {
        fn allocate(&self, ballot: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, String> {
            let bidders: Vec<&str> = ballot.bids.iter().map(|bid| bid.robot.as_str()).collect();
            assert_eq!((bidders, ballot.viable.len()), (vec!["cyd", "eve"], 1));
            let last = |robots: &BTreeSet<RobotId>| robots.last().cloned().ok_or("nobody may".to_owned());
            ballot.candidates.iter().map(|(role, robots)| Ok((role.clone(), last(robots)?))).collect()
        }
    }

    #[test]
    fn another_rule_may_choose_whoever_lacks_skills_or_charge_but_nobody_who_is_taken_or_has_failed() {
        let expected = ["bob", "cyd", "dan", "eve", "fay", "gil"].map(robot).into_iter().collect();
        let busy = RefusalReason::Busy { mission: MissionId::new("m-0").unwrap(), role: role() };
        let taken = BTreeMap::from([(robot("fay"), busy)]);
        let excluded = BTreeMap::from([(role(), BTreeMap::from([(robot("gil"), "lost its way".to_owned())]))]);
        let reason = RefusalReason::MissingSkills { skills: vec![] };
        let refusal = RoleReply::Refusal(BidRefusal { robot: robot("dan"), role: role(), reason });
        let lacks = BidResponse { robot: robot("dan"), auction: call().auction, replies: vec![refusal] };
        let tenders =
            [bids("eve", 9.0, 0.5), bids("cyd", 2.0, 0.01), lacks, bids("fay", 1.0, 0.5), bids("gil", 1.0, 0.5)];
        let circumstances = circumstances(&expected, &taken, &excluded);
        let by_last = clear_auction_with(&call(), &tenders, &circumstances, &Last);
        assert_eq!(by_last.holders, Some(BTreeMap::from([(role(), robot("eve"))])));
        let alone = clear_auction_with(&call(), &tenders[1..3], &circumstances, &AnyLast);
        assert_eq!(alone.holders, Some(BTreeMap::from([(role(), robot("dan"))])));
    }

    #[derive(Debug)]
    struct AnyLast;

    impl Allocator for AnyLast {
        fn allocate(&self, ballot: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, String> {
            Ok(ballot
                .candidates
                .iter()
                .filter_map(|(role, robots)| Some((role.clone(), robots.last()?.clone())))
                .collect())
        }
    }

    #[test]
    fn whoever_failed_at_a_role_does_not_get_it_and_when_nobody_else_can_it_is_hopeless() {
        let (expected, taken) = (["ada", "bob"].map(robot).into_iter().collect(), BTreeMap::new());
        let excluded = BTreeMap::from([(role(), BTreeMap::from([(robot("ada"), "lost its way".to_owned())]))]);
        let circumstances = circumstances(&expected, &taken, &excluded);
        let conclusion = clear_auction(&call(), &[bids("ada", 1.0, 0.5), bids("bob", 9.0, 0.5)], &circumstances);
        assert_eq!(conclusion.holders, Some(BTreeMap::from([(role(), robot("bob"))])));
        let said = |verdict: &BidVerdict| match verdict {
            BidVerdict::Refused { reason } => reason.to_string(),
            other => format!("{other:?}"),
        };
        assert_eq!(said(&conclusion.record.entries[0].verdict), "failed at it before: lost its way");
        assert!(conclusion.unfillable.is_empty());

        let silent = clear_auction(&call(), &[bids("ada", 1.0, 0.5)], &circumstances);
        assert_eq!((silent.holders, silent.unfillable), (None, BTreeSet::new()), "bob may yet answer");
        let lacks = RefusalReason::MissingSkills { skills: vec![] };
        let refusal = BidRefusal { robot: robot("bob"), role: role(), reason: lacks };
        let refuses =
            BidResponse { robot: robot("bob"), auction: call().auction, replies: vec![RoleReply::Refusal(refusal)] };
        let conclusion = clear_auction(&call(), &[bids("ada", 1.0, 0.5), refuses], &circumstances);
        assert_eq!((conclusion.holders, conclusion.unfillable), (None, [role()].into()));
    }

    #[test]
    fn the_parts_of_the_winner_and_of_its_closest_rivals_are_kept_while_there_is_room() {
        let part = |step: u32| BidPart {
            step,
            label: "x".repeat(40),
            skill: crate::ids::TaskType::new("navigation").unwrap(),
            time: Seconds::new(1.0).unwrap(),
            energy: 0.001,
        };
        let tenders: Vec<BidResponse> = (0..20)
            .map(|number| {
                // Who bids last is the quickest of those that can be taken; the first of all would run out of charge.
                let remaining = if number == 0 { 0.01 } else { 0.5 };
                let mut tender = bids(&format!("robot-{number:02}"), 100.0 - f64::from(number), remaining);
                let RoleReply::Bid(bid) = &mut tender.replies[0] else { panic!("it bids") };
                bid.parts = (0..12).map(part).collect();
                tender
            })
            .collect();
        let expected = tenders.iter().map(|tender| tender.robot.clone()).collect();
        let taken = BTreeMap::new();
        let record = clear_auction(&call(), &tenders, &circumstances(&expected, &taken, &NOBODY)).record;
        let kept: Vec<&str> =
            record.entries.iter().filter(|entry| !entry.parts.is_empty()).map(|entry| entry.robot.as_str()).collect();
        // 12 parts of 74 bytes: nine bids fit into 8 KiB.
        let closest: Vec<String> = (11..20).map(|number| format!("robot-{number}")).collect();
        assert_eq!(kept, closest);
        assert!(record.entries.iter().all(|entry| [0, 12].contains(&entry.parts.len())), "whole or not at all");
    }

    #[test]
    fn an_answer_to_another_call_or_in_anothers_name_does_not_count() {
        let expected = BTreeSet::new();
        let taken = BTreeMap::new();
        let circumstances = circumstances(&expected, &taken, &NOBODY);
        let mut old = bids("ada", 1.0, 0.5);
        old.auction.round = 9;
        let mut forged = bids("bob", 1.0, 0.5);
        forged.robot = robot("mal");
        let conclusion = clear_auction(&call(), &[old, forged], &circumstances);
        assert_eq!(conclusion.holders, None);
        assert_eq!(conclusion.record.failure.as_deref(), Some("no viable bid for r1"));
    }
}
