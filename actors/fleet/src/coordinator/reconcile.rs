//! Reconciliation: computes the pending actions of a coordinator from the ledger and the session,
//! as values.
//!
//! After a commit only the missions that it has changed are examined, and the promises of their robots. Everything else
//! becomes due by time or by the records of robots, so each tick examines all active missions.

use super::actions::{CoordinatorAction, SessionState};
use super::circular_waits::{roles_to_give_up, waits_with_robots};
use super::message::AwardedRole;
use super::promises::promises_due;
use super::rounds::RoundPhase;
use super::scope::Scope;
use consort_protocol::cause::CauseClass;
use consort_protocol::lease::{Epoch, LeaseMonitor};
use consort_protocol::ledger::{Ledger, MissionEntry, RolePhase};
use consort_protocol::units::{NodeTime, Seconds};
use std::collections::BTreeSet;
use std::time::Duration;

/// Returns the backoff after `rounds` consecutive rounds without result: 0.25 s, doubled each time,
/// 5 s at most. Raised: fewer calls to a busy fleet, later starts when a robot becomes free
/// unnoticed.
pub(super) fn backoff(rounds: u32) -> Duration {
    Duration::from_millis(250 << rounds.saturating_sub(1).min(5)).min(Duration::from_secs(5))
}

/// Interval for repeating a notice to the holder of a role that has not followed it.
const NOTICE_REPEAT_INTERVAL: Duration = Duration::from_millis(500);

/// Returns the pending actions of a scope, in the order in which missions are served. `confirmed_ms` is the time
/// of day that a majority of the voters confirms, in milliseconds since 1970.
pub(super) fn pending_actions(
    ledger: &Ledger,
    state: &SessionState<'_>,
    scope: Scope<'_>,
    now: NodeTime,
    confirmed_ms: Option<u64>,
) -> Vec<CoordinatorAction> {
    let SessionState { lease_monitor, rounds, notified, promises_max, .. } = state;
    // Without promises no auction before the earliest start has a result.
    let ahead = if *promises_max > 0 { state.ahead } else { Seconds::ZERO };
    let is_notice_due = |awarded: &AwardedRole| {
        let notified = notified.get(&(awarded.epoch, awarded.role.clone()));
        notified.is_none_or(|at| now.since(*at) >= NOTICE_REPEAT_INTERVAL)
    };
    let mut actions = vec![];
    let missions = scope.missions(ledger);
    for entry in &missions {
        if entry.submission.deadline_ms.zip(confirmed_ms).is_some_and(|(deadline, now_ms)| deadline <= now_ms) {
            let (mission, cause, class) = (entry.id.clone(), past_deadline(entry), CauseClass::Transient);
            actions.push(CoordinatorAction::FailMission { mission, cause, class });
            continue;
        }
        let due = match rounds.get(&entry.id).map(|round| &round.phase) {
            None => true,
            Some(RoundPhase::BackingOff { until, .. }) => *until <= now,
            Some(RoundPhase::Bidding | RoundPhase::BiddingClosed(_) | RoundPhase::Proposing(_)) => false,
            Some(RoundPhase::HeldBack) => false, // it is called when others have ended
        };
        if due && entry.submission.may_start_within(confirmed_ms, ahead) && can_be_auctioned(entry, lease_monitor, now)
        {
            actions.push(CoordinatorAction::CallForBids(entry.id.clone()));
        }
        for (role, held, holder) in entry.held_roles() {
            let (robot, epoch) = (&holder.robot, holder.epoch);
            let awarded = AwardedRole::of(entry, role, holder);
            if lease_monitor.has_expired(epoch, robot, now) {
                let silent = lease_monitor.since_contact(epoch, robot, now).as_secs_f64();
                actions.push(CoordinatorAction::ReleaseRole(awarded, format!("{robot} silent for {silent:.1} s")));
            } else if held.phase == RolePhase::Awarded && is_notice_due(&awarded) {
                actions.push(CoordinatorAction::NotifyAward(awarded));
            }
        }
    }
    let reassigned = missions.iter().flat_map(|entry| {
        let returned = entry.roles_to_return();
        returned.map(move |(role, holder, order)| (AwardedRole::of(entry, role, holder), order.clone()))
    });
    let reassigned = reassigned.filter(|(awarded, _)| is_notice_due(awarded));
    actions.extend(reassigned.map(|(awarded, order)| CoordinatorAction::AskToReturn { awarded, order }));
    actions.extend(promises_due(ledger, scope, state, confirmed_ms, is_notice_due));
    // Robots keep their roles during an alarm, since they would get no others.
    if ledger.has_alarm() {
        return actions;
    }
    let give_way = |(awarded, to)| CoordinatorAction::AskToGiveWay { awarded, to, for_now: false };
    // Only a mission with robots that has begun to wait closes a circle.
    if matches!(scope, Scope::All) || missions.iter().any(|entry| waits_with_robots(entry)) {
        let circular = roles_to_give_up(ledger).into_iter().filter(|(awarded, _)| is_notice_due(awarded));
        actions.extend(circular.map(give_way));
    }
    // Only a mission that holds robots can return one.
    let holding = missions.iter().filter(|entry| entry.held_roles().next().is_some());
    let returned = holding.filter_map(|entry| {
        let (role, holder) = ledger.iteration_to_return(entry)?;
        Some((AwardedRole::of(entry, role, holder), entry.id.clone()))
    });
    actions.extend(returned.filter(|(awarded, _)| is_notice_due(awarded)).map(give_way));
    actions
}

/// Checks whether a mission has open roles and no former holder that may still act. Holders from
/// before the change to the recovery branch may act until their leases have expired.
pub(super) fn can_be_auctioned(entry: &MissionEntry, lease_monitor: &LeaseMonitor, now: NodeTime) -> bool {
    let former_expired =
        entry.former_holders.iter().all(|held| lease_monitor.has_expired(held.epoch, &held.robot, now));
    former_expired && !entry.roles_to_auction().is_empty()
}

fn past_deadline(entry: &MissionEntry) -> String {
    let reason = entry.auction.as_ref().and_then(|auction| auction.failure.as_ref());
    match (entry.open_roles().is_empty(), reason) {
        (true, _) => {
            let (done, steps) = entry.progress();
            format!("its deadline passed after {done} of {steps} steps")
        }
        (false, Some(reason)) => format!("its deadline passed while it waited: {reason}"),
        (false, None) => "its deadline passed before an auction was held".to_owned(),
    }
}

/// Tracks the leases of the awards of these missions that are in force or may still be acted on. Returns their epochs.
fn track_awards_of(missions: &[&MissionEntry], lease_monitor: &mut LeaseMonitor, now: NodeTime) -> BTreeSet<Epoch> {
    let mut awards = BTreeSet::new();
    for entry in missions {
        awards.extend(entry.role_holders().into_values().map(|held| (held.epoch, held.robot)));
        awards.extend(entry.former_holders.iter().map(|held| (held.epoch, held.robot.clone())));
    }
    for (epoch, robot) in &awards {
        lease_monitor.track(*epoch, robot, now);
    }
    awards.into_iter().map(|(epoch, _)| epoch).collect()
}

/// Tracks the leases of all awards in force and forgets the others. Returns the epochs in force.
pub(super) fn track_awards(ledger: &Ledger, lease_monitor: &mut LeaseMonitor, now: NodeTime) -> BTreeSet<Epoch> {
    let epochs = track_awards_of(&ledger.missions_with_robots(), lease_monitor, now);
    lease_monitor.retain(&epochs, now);
    epochs
}

/// Tracks the leases of the awards of a scope.
pub(super) fn track_new_awards(scope: Scope<'_>, ledger: &Ledger, lease_monitor: &mut LeaseMonitor, now: NodeTime) {
    track_awards_of(&scope.missions(ledger), lease_monitor, now);
}

/// Ends the renewal of the roles that these actions release.
pub(super) fn stop_renewing_released(actions: &[CoordinatorAction], lease_monitor: &mut LeaseMonitor, now: NodeTime) {
    for action in actions {
        if let CoordinatorAction::ReleaseRole(awarded, _) = action {
            lease_monitor.stop_renewing(awarded.epoch, &awarded.robot, now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::rounds::Rounds;
    use super::super::test_ledger::Log;
    use super::*;
    use consort_protocol::ids::RobotId;
    use consort_protocol::lease::LeaseTerms;
    use consort_protocol::ledger::{ChangeCursor, Command, MissionChanges, Submission};
    use std::collections::BTreeMap;

    fn actions(ledger: &Ledger, scope: Scope<'_>) -> Vec<CoordinatorAction> {
        actions_ahead(ledger, scope, (16, Seconds::ZERO), None)
    }

    fn actions_ahead(
        ledger: &Ledger,
        scope: Scope<'_>,
        (promises_max, ahead): (u32, Seconds),
        confirmed_ms: Option<u64>,
    ) -> Vec<CoordinatorAction> {
        let (rounds, notified, unfit) = (&Rounds::default(), &BTreeMap::new(), &BTreeMap::new());
        let (lease_monitor, charges) = (&LeaseMonitor::new(LeaseTerms::default()), &BTreeMap::new());
        let state = SessionState { lease_monitor, rounds, notified, unfit, charges, promises_max, ahead };
        pending_actions(ledger, &state, scope, NodeTime::ZERO, confirmed_ms)
    }

    #[test]
    fn a_mission_is_called_ahead_of_its_start_only_to_be_promised() {
        let mut log = Log::default();
        let known = log.add_mission("ada");
        let submission = log.0.mission(&known).unwrap().submission.clone();
        let later = Submission { request: "later".parse().unwrap(), not_before_ms: Some(60_000), ..submission };
        log.apply(Command::Submit(Box::new(later)));
        let is_called = |(promises_max, now_ms)| {
            let terms = (promises_max, Seconds::new(30.0).unwrap());
            let actions = actions_ahead(&log.0, Scope::All, terms, Some(now_ms));
            actions.iter().any(|action| matches!(action, CoordinatorAction::CallForBids(_)))
        };
        let cases = [(16, 29_999), (16, 30_000), (0, 30_000), (0, 60_000)];
        assert_eq!(cases.map(is_called), [false, true, false, true]);
    }

    #[test]
    fn after_a_commit_the_actions_of_changed_missions_and_of_their_robots_are_computed() {
        let (mut log, mut cursor) = (Log::default(), ChangeCursor::default());
        let (first, second) = (log.add_mission("ada"), log.add_mission("bob"));
        log.0.changes_since(&mut cursor);
        log.end_cart(&second);
        let MissionChanges::These(missions) = log.0.changes_since(&mut cursor) else { panic!("they are known") };
        assert_eq!(missions, [second.clone()].into());
        let robots = BTreeSet::from(["bob", "lab-arm"].map(|name| RobotId::new(name).unwrap()));
        let changed = actions(&log.0, Scope::Changed { missions: &missions, robots: &robots });
        let [CoordinatorAction::AwardPromised(awarded)] = &changed[..] else { panic!("{changed:?}") };
        assert_eq!(awarded.mission, second);
        // The cart of the first mission has not confirmed its role.
        let all = actions(&log.0, Scope::All);
        let is_of_first = |action: &&CoordinatorAction| match action {
            CoordinatorAction::NotifyAward(awarded) => awarded.mission == first,
            _ => false,
        };
        assert_eq!(all.iter().filter(is_of_first).count(), 1);
        assert_eq!(
            all.iter().filter(|action| !is_of_first(action)).collect::<Vec<_>>(),
            changed.iter().collect::<Vec<_>>()
        );
        let none = Scope::Changed { missions: &BTreeSet::new(), robots: &BTreeSet::new() };
        assert_eq!(actions(&log.0, none), []);
    }
}
