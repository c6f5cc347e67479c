//! Further auctions of promised roles.
//!
//! A promise holds by estimates that become wrong: robots are slower than estimated or are held, and other robots become
//! free. So the coordinator auctions promised roles again, one by one, those that are late first. The promise stays as it is
//! until the ledger passes it to another robot, so no mission loses a robot by it. A robot keeps its promise unless the
//! other costs clearly less: estimates vary, and each change costs messages. A role that a person has given to a robot stays with
//! it.

use super::actions::{AuctionRound, CoordinatorAction};
use super::auctioneer::{call_for_roles, send_call};
use super::clearing::AuctionInputs;
use super::message::{AwardedRole, CollectedBids, Reauction};
use super::session_context::SessionContext;
use consort_protocol::auction::{AuctionId, AuctionOutcome, PromiseTerms};
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger, PromiseMove};
use consort_protocol::units::{NodeTime, Seconds};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Minimum time between two calls for promised roles, whatever their number. Raised: fewer messages, later changes.
const CALL_INTERVAL: Duration = Duration::from_secs(1);

/// Time from a promise to the first call for it; doubled after each call, unless the promise is late. A guess: tasks take about as
/// long.
const REPEAT_INTERVAL: Duration = Duration::from_secs(30);

/// Maximum number of doublings: the longest interval is 16 minutes.
const DOUBLINGS_MAX: u32 = 5;

/// Promises of a session, as far as they are auctioned again. The next coordinator starts without them.
#[derive(Default)]
pub(super) struct Reauctions {
    promises: BTreeMap<(Epoch, RoleId), PromiseTimes>,
    /// Time of the latest call.
    called_at: Option<NodeTime>,
}

/// Times of a promise.
struct PromiseTimes {
    /// Time from which the role could have started.
    startable_since: Option<NodeTime>,
    /// Time of the latest call for the role, or of the promise.
    called_at: NodeTime,
    /// Number of calls.
    calls: u32,
}

impl PromiseTimes {
    fn is_call_due(&self, is_late: bool, now: NodeTime) -> bool {
        let doublings = if is_late { 0 } else { self.calls.min(DOUBLINGS_MAX) };
        now.since(self.called_at) >= REPEAT_INTERVAL * 2_u32.pow(doublings)
    }
}

impl Reauctions {
    /// Returns the call for a promised role that is due, if any. `confirmed_ms` is the time of day that a majority of the voters
    /// confirms, in milliseconds since 1970.
    pub(super) fn due(
        &mut self,
        ledger: &Ledger,
        rounds: &BTreeMap<MissionId, AuctionRound>,
        terms: &PromiseTerms,
        now: NodeTime,
        confirmed_ms: Option<u64>,
    ) -> Option<CoordinatorAction> {
        let late_max = Duration::try_from_secs_f64(terms.late_max.get()).unwrap_or(Duration::MAX);
        let late_max_ms = u64::try_from(late_max.as_millis()).unwrap_or(u64::MAX);
        let may_call = self.called_at.is_none_or(|at| now.since(at) >= CALL_INTERVAL);
        let (mut known, mut candidates) = (BTreeSet::new(), vec![]);
        for (entry, role, promise) in ledger.promises_in_order() {
            let can_proceed = entry.can_proceed(role);
            let key = (promise.epoch, role.clone());
            let first = PromiseTimes { startable_since: None, called_at: now, calls: 0 };
            let times = self.promises.entry(key.clone()).or_insert(first);
            times.startable_since = can_proceed.then(|| times.startable_since.unwrap_or(now));
            let could_start = times.startable_since.is_some_and(|since| now.since(since) >= late_max);
            let is_after_plan =
                confirmed_ms.is_some_and(|now_ms| now_ms >= promise.planned_ms.saturating_add(late_max_ms));
            let is_late = could_start && is_after_plan;
            // A free robot is about to get the role.
            let is_free = || can_proceed && ledger.check_promise(&entry.id, role, promise.epoch).is_ok();
            let is_for_robot =
                || entry.role_orders().get(role).is_some_and(|order| order.restriction.permits_only_one());
            let is_auctioned = || rounds.contains_key(&entry.id) || !entry.open_roles().is_empty();
            if may_call && times.is_call_due(is_late, now) && !is_auctioned() && !is_free() && !is_for_robot() {
                let reauction = Reauction { promised: AwardedRole::of(entry, role, promise), is_late };
                candidates.push(((!is_late, !can_proceed, times.called_at), reauction));
            }
            known.insert(key);
        }
        self.promises.retain(|key, _| known.contains(key));
        let (_, reauction) = candidates.into_iter().min_by_key(|(order, _)| *order)?;
        let AwardedRole { role, epoch, .. } = &reauction.promised;
        if let Some(times) = self.promises.get_mut(&(*epoch, role.clone())) {
            (times.called_at, times.calls) = (now, times.calls.saturating_add(1));
        }
        self.called_at = Some(now);
        Some(CoordinatorAction::AuctionAgain(reauction))
    }
}

/// Calls for bids for a promised role.
pub(super) fn call_again(reauction: Reauction, context: &mut SessionContext, now: NodeTime) {
    let AwardedRole { mission, role, .. } = &reauction.promised;
    let latest = |ledger: &Ledger| Some(ledger.mission(mission)?.auction.as_ref()?.auction.round);
    let round = context.read_ledger(latest).unwrap_or(0).saturating_add(1);
    let auction = AuctionId { mission: mission.clone(), term: context.term, round };
    if let Some((call, invitation)) = call_for_roles(&BTreeSet::from([role.clone()]), auction, context, now) {
        send_call(call, invitation, Some(reauction), context);
    }
}

/// Passes a promised role to the winner of its auction, if the winner costs clearly less than the robot of the promise, or if
/// that is late and the winner would not be.
pub(super) fn conclude(
    bids: &CollectedBids,
    reauction: Reauction,
    rounds: &BTreeMap<MissionId, AuctionRound>,
    context: &mut SessionContext,
) {
    let Reauction { promised: AwardedRole { mission, role, robot: former, epoch }, is_late } = reauction;
    let terms = context.settings.auctions.promises;
    let inputs = AuctionInputs::read(bids, rounds, context);
    let AuctionOutcome { holders, record: mut auction, .. } = inputs.clear(bids, context);
    let winner = holders.and_then(|mut holders| holders.remove(&role));
    let Some(robot) = winner.filter(|winner| *winner != former) else { return };
    let start = auction.promised.get(&role).copied().unwrap_or(Seconds::ZERO);
    let gain_s = inputs.promises(terms).gain(&inputs.responses, &role, &former, &robot);
    let cause = match gain_s.filter(|gain_s| *gain_s >= terms.gain_min.get()) {
        Some(gain_s) => format!("{robot} costs {gain_s:.0} s less than {former}"),
        None if is_late && start <= terms.late_max => format!("{former} is late, and {robot} is free in {start:.0}"),
        None => return,
    };
    // A robot holds a role only while its tasks can run.
    if !inputs.startable.contains(&role) {
        auction.promised.insert(role.clone(), start);
    }
    let is_promised = auction.promised.contains_key(&role);
    let to = (mission.clone(), role.clone(), robot.clone());
    let change = PromiseMove { mission, role, epoch, robot, cause, auction };
    context.propose_award(Command::MovePromise(Box::new(change)), to, is_promised);
}

#[cfg(test)]
mod tests {
    use super::super::test_ledger::Log;
    use super::*;
    use consort_protocol::ledger::{MissionChange, OrderRequest};

    /// A session with promises, at a time.
    #[derive(Default)]
    struct Session {
        reauctions: Reauctions,
        now: NodeTime,
    }

    impl Session {
        /// Returns the mission of the call that is due after this number of seconds, and whether its promise is late. The time
        /// of day is the time of the session.
        fn due_after(&mut self, seconds: u64, ledger: &Ledger) -> Option<(MissionId, bool)> {
            self.now = self.now + Duration::from_secs(seconds);
            let terms = PromiseTerms { late_max: Seconds::new(100.0).unwrap(), ..PromiseTerms::default() };
            let confirmed_ms = Some(self.now.as_millis());
            match self.reauctions.due(ledger, &BTreeMap::new(), &terms, self.now, confirmed_ms)? {
                CoordinatorAction::AuctionAgain(Reauction { promised, is_late }) => Some((promised.mission, is_late)),
                other => panic!("{other:?}"),
            }
        }
    }

    /// Promises the arm of two missions. The arm holds a role of a third.
    fn promises() -> (Log, MissionId, MissionId) {
        let mut log = Log::default();
        let held = log.add_mission("cyd");
        log.end_cart(&held);
        let role: RoleId = "arm".parse().unwrap();
        let epoch = log.0.mission(&held).unwrap().role_robots()[&role].epoch;
        log.apply(Command::AwardPromised { mission: held, role, epoch });
        let (first, second) = (log.add_mission("ada"), log.add_mission("bob"));
        (log, first, second)
    }

    #[test]
    fn promises_are_auctioned_again_one_by_one() {
        let (log, first, second) = promises();
        let mut session = Session::default();
        assert_eq!(session.due_after(0, &log.0), None);
        assert_eq!(session.due_after(29, &log.0), None);
        assert_eq!(session.due_after(1, &log.0), Some((first.clone(), false)));
        assert_eq!(session.due_after(0, &log.0), None, "one call a second");
        assert_eq!(session.due_after(1, &log.0), Some((second, false)));
        assert_eq!(session.due_after(1, &log.0), None);
        assert_eq!(session.due_after(28, &log.0), None, "the interval doubles");
        assert_eq!(session.due_after(30, &log.0), Some((first, false)));
    }

    #[test]
    fn a_role_that_could_have_started_for_too_long_is_late_and_comes_first() {
        let (mut log, first, second) = promises();
        let mut session = Session::default();
        assert_eq!(session.due_after(0, &log.0), None);
        log.end_cart(&second);
        assert_eq!(session.due_after(60, &log.0), Some((second.clone(), false)), "it can start");
        assert_eq!(session.due_after(1, &log.0), Some((first, false)));
        assert_eq!(session.due_after(98, &log.0).map(|(_, is_late)| is_late), Some(false));
        assert_eq!(session.due_after(31, &log.0), Some((second, true)));
    }

    #[test]
    fn the_promise_of_a_free_robot_that_can_start_is_not_auctioned() {
        let mut log = Log::default();
        let mission = log.add_mission("ada");
        log.end_cart(&mission);
        let mut session = Session::default();
        assert_eq!([0, 60].map(|seconds| session.due_after(seconds, &log.0)), [None, None]);
    }

    #[test]
    fn the_promise_of_a_pinned_role_is_not_auctioned() {
        let (mut log, first, second) = promises();
        log.apply(Command::first_wire_version(3));
        let change = MissionChange::Pin { role: "arm".parse().unwrap(), robot: Some("lab-arm".parse().unwrap()) };
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 1, request: None };
        log.apply(Command::ChangeMission { mission: first, order });
        let mut session = Session::default();
        assert_eq!(session.due_after(0, &log.0), None);
        assert_eq!(session.due_after(30, &log.0), Some((second, false)));
        assert_eq!(session.due_after(1, &log.0), None);
    }
}
