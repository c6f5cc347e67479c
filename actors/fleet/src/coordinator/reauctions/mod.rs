//! Further auctions of promised roles.
//!
//! A promise holds by estimates that become wrong: robots are slower than estimated or are held, and other robots become
//! free. So the coordinator auctions promised roles again, one by one, those that are late and others in turn. The promise
//! stays as it is until the ledger passes it to another robot, so no mission loses a robot by it. A robot keeps its promise
//! unless the other costs clearly less: estimates vary, and each change costs messages. Each change makes the next harder: the
//! gain and the lateness that it requires, and the time to the next call, rise with the number of changes. So a role does not
//! pass back and forth between robots with the same work. A role that a person has given to a robot stays with it.

use super::auctioneer::{call_for_roles, send_call};
use super::candidates::first_call;
use super::clearing::AuctionInputs;
use super::message::{AwardedRole, CollectedBids, Reauction};
use super::rounds::Rounds;
use super::session_context::SessionContext;
use consort_protocol::auction::{AuctionId, AuctionOutcome, PromiseTerms, RefusalReason, RoleReply};
use consort_protocol::ids::{RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger, PromiseMove};
use consort_protocol::units::{NodeTime, Seconds};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Minimum time between two calls for promised roles, whatever their number. Raised: fewer messages, later changes.
const CALL_INTERVAL: Duration = Duration::from_secs(1);

/// Time from a promise to the first call for it; doubled after each call, unless the promise is late, or a robot has become free
/// and another robot could do the role. A guess: tasks take about as long.
const REPEAT_INTERVAL: Duration = Duration::from_secs(30);

/// Maximum number of doublings: the longest interval is 16 minutes.
const DOUBLINGS_MAX: u32 = 5;

/// Promises of a session, as far as they are auctioned again. The next coordinator starts without them.
#[derive(Default)]
pub(super) struct Reauctions {
    promises: BTreeMap<(Epoch, RoleId), PromiseTimes>,
    /// Time of the latest call.
    called_at: Option<NodeTime>,
    /// The latest call was for a late promise. The next is for another one, so that robots that are held up for long do not
    /// take all calls.
    was_late: bool,
}

/// Times of a promise.
struct PromiseTimes {
    /// Time from which the role could have started.
    startable_since: Option<NodeTime>,
    /// Time of the latest call for the role, or of the promise.
    called_at: NodeTime,
    /// Number of calls.
    calls: u32,
    /// Another robot could have got the role in the latest auction.
    has_rival: bool,
}

impl PromiseTimes {
    /// Checks whether a call is due after this number of changes of the role.
    fn is_call_due(&self, is_late: bool, changes: u32, now: NodeTime) -> bool {
        let doublings = if is_late { 0 } else { self.calls.saturating_add(changes).min(DOUBLINGS_MAX) };
        now.since(self.called_at) >= REPEAT_INTERVAL * 2_u32.pow(doublings)
    }
}

impl Reauctions {
    /// Returns the call for a promised role that is due, if any. `confirmed_ms` is the time of day that a majority of the voters
    /// confirms, in milliseconds since 1970.
    pub(super) fn due(
        &mut self,
        ledger: &Ledger,
        rounds: &Rounds,
        terms: &PromiseTerms,
        now: NodeTime,
        confirmed_ms: Option<u64>,
    ) -> Option<Reauction> {
        let late_max = Duration::try_from_secs_f64(terms.late_max.get()).unwrap_or(Duration::MAX);
        let may_call = self.called_at.is_none_or(|at| now.since(at) >= CALL_INTERVAL);
        let (mut known, mut candidates) = (BTreeSet::new(), vec![]);
        for (entry, role, promise) in ledger.promises_in_order() {
            let can_proceed = entry.can_proceed(role) && entry.submission.may_start(confirmed_ms);
            let key = (promise.epoch, role.clone());
            let first = PromiseTimes { startable_since: None, called_at: now, calls: 0, has_rival: false };
            let changes = entry.unconfirmed_releases(role);
            let late_max = late_max.saturating_mul(changes.saturating_add(1));
            let late_max_ms = u64::try_from(late_max.as_millis()).unwrap_or(u64::MAX);
            let times = self.promises.entry(key.clone()).or_insert(first);
            times.startable_since = can_proceed.then(|| times.startable_since.unwrap_or(now));
            let could_start = times.startable_since.is_some_and(|since| now.since(since) >= late_max);
            let is_after_plan =
                confirmed_ms.is_some_and(|now_ms| now_ms >= promise.planned_ms.saturating_add(late_max_ms));
            let is_late = could_start && is_after_plan;
            // A free robot is about to get the role, unless it charges first.
            let charges = || ledger.promises_of(&promise.robot).iter().any(|(.., other)| other.charging.is_some());
            let is_free = || can_proceed && !charges() && ledger.check_promise(&entry.id, role, promise.epoch).is_ok();
            let is_for_robot =
                || entry.role_orders().get(role).is_some_and(|order| order.restriction.permits_only_one());
            // Other roles of the mission may stay open for long, but a late promise has waited enough.
            let is_auctioned = || rounds.contains(&entry.id) || !entry.open_roles().is_empty();
            let may_be_called = || (is_late || !is_auctioned()) && !is_free() && !is_for_robot();
            if may_call && times.is_call_due(is_late, changes, now) && may_be_called() {
                let reauction = Reauction { promised: AwardedRole::of(entry, role, promise), is_late, changes };
                candidates.push(((is_late == self.was_late, !can_proceed, times.called_at), reauction));
            }
            known.insert(key);
        }
        self.promises.retain(|key, _| known.contains(key));
        let (_, reauction) = candidates.into_iter().min_by_key(|(order, _)| *order)?;
        let AwardedRole { role, epoch, .. } = &reauction.promised;
        if let Some(times) = self.promises.get_mut(&(*epoch, role.clone())) {
            (times.called_at, times.calls) = (now, times.calls.saturating_add(1));
        }
        (self.called_at, self.was_late) = (Some(now), reauction.is_late);
        Some(reauction)
    }

    /// Notes whether another robot could have got the role in its latest auction.
    fn note_rival(&mut self, promised: &AwardedRole, has_rival: bool) {
        if let Some(times) = self.promises.get_mut(&(promised.epoch, promised.role.clone())) {
            times.has_rival = has_rival;
        }
    }

    /// Shortens the intervals of roles that other robots could get, because a robot has become free.
    pub(super) fn shorten_intervals(&mut self) {
        for times in self.promises.values_mut().filter(|times| times.has_rival) {
            times.calls = 0;
        }
    }
}

/// Calls for bids for a promised role.
pub(super) fn call_again(reauction: Reauction, rounds: &Rounds, context: &mut SessionContext, now: NodeTime) {
    let AwardedRole { mission, role, .. } = &reauction.promised;
    let latest = |ledger: &Ledger| Some(ledger.mission(mission)?.auction.as_ref()?.auction.round);
    let round = context.read_ledger(latest).unwrap_or(0).saturating_add(1);
    let auction = AuctionId { mission: mission.clone(), term: context.term, round };
    if let Some((call, invitation)) = call_for_roles(&BTreeSet::from([role.clone()]), auction, context, now) {
        let bids = first_call(CollectedBids::of_all(call, invitation, Some(reauction)), rounds, context);
        send_call(bids, context);
    }
}

/// Passes a promised role to the winner of its auction, if the winner costs clearly less than the robot of the promise, if that
/// does not suit the role any more, or if it is late and the winner would not be. Asks further robots first, unless the result
/// is proven.
pub(super) fn conclude(
    mut bids: CollectedBids,
    reauction: &Reauction,
    rounds: &Rounds,
    reauctions: &mut Reauctions,
    context: &mut SessionContext,
) {
    let terms = context.settings.auctions.promises;
    let AwardedRole { mission, role, robot: former, epoch } = reauction.promised.clone();
    let inputs = AuctionInputs::read(&bids, rounds, context);
    let AuctionOutcome { holders, record: mut auction, .. } = match inputs.clear(&bids, context) {
        Ok(outcome) => outcome,
        Err(to_ask) => {
            drop(inputs);
            bids.invite(to_ask);
            return send_call(bids, context);
        }
    };
    let winner = holders.and_then(|mut holders| holders.remove(&role)).filter(|winner| *winner != former);
    reauctions.note_rival(&reauction.promised, winner.is_some());
    let Some(robot) = winner else { return };
    let start = auction.promised.get(&role).copied().unwrap_or(Seconds::ZERO);
    let standing = match (bids.reply_of(&role, &former), bids.bid_of(&role, &robot)) {
        (Some(RoleReply::Bid(from)), Some(to)) => {
            FormerStanding::Costs { gain_s: inputs.promises(terms).gain(from, to) }
        }
        (Some(RoleReply::Refusal(refusal)), _) if refusal.reason.is_unsuited() => {
            FormerStanding::Unsuited(&refusal.reason)
        }
        _ => FormerStanding::Unknown,
    };
    let Some(cause) = cause_of_change(reauction, &robot, standing, start, &terms) else { return };
    // A robot holds a role only while its tasks can run.
    if !inputs.startable.contains(&role) {
        auction.promised.insert(role.clone(), start);
    }
    let is_promised = auction.promised.contains_key(&role);
    let to = (mission.clone(), role.clone(), robot.clone());
    let auction = auction.for_ledger(false);
    let change = PromiseMove { mission, role, epoch, robot, cause, auction };
    context.propose_award(Command::MovePromise(Box::new(change)), to, is_promised);
}

/// What the robot of a promise replies when the role is auctioned again.
#[derive(Clone, Copy)]
enum FormerStanding<'a> {
    /// It costs more than the winner by this time; less, if it is negative.
    Costs { gain_s: f64 },
    /// It does not suit the role any more.
    Unsuited(&'a RefusalReason),
    /// It does not reply, or cannot bid now.
    Unknown,
}

/// Returns the cause for which a role passes to a robot that is free in `start`; `None` if it does not pass.
fn cause_of_change(
    Reauction { promised, is_late, changes }: &Reauction,
    robot: &RobotId,
    standing: FormerStanding<'_>,
    start: Seconds,
    terms: &PromiseTerms,
) -> Option<String> {
    let former = &promised.robot;
    let gain_min_s = terms.gain_min.get() * (f64::from(*changes) + 1.0);
    match standing {
        FormerStanding::Costs { gain_s } if gain_s >= gain_min_s => {
            Some(format!("{robot} costs {gain_s:.0} s less than {former}"))
        }
        FormerStanding::Unsuited(reason) => Some(format!("{former}: {reason}")),
        FormerStanding::Costs { .. } | FormerStanding::Unknown if *is_late && start <= terms.late_max => {
            Some(format!("{former} is late, and {robot} is free in {start:.0}"))
        }
        FormerStanding::Costs { .. } | FormerStanding::Unknown => None,
    }
}

#[cfg(test)]
mod tests;
