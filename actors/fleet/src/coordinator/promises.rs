//! Promises that are due: the award of a promised role, or the end of a promise that cannot be kept.

use super::actions::{CoordinatorAction, RecordedCharge, SessionState};
use super::message::AwardedRole;
use super::queues::may_return;
use super::rounds::RoundPhase;
use super::scope::Scope;
use consort_gossip::{MemberStatus, SharedKnowledge};
use consort_protocol::auction::{BidLimits, CHARGE_TOLERANCE, ChargingStop};
use consort_protocol::ids::{NodeId, RobotId};
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::ledger::{Alarm, Ledger, Priority};
use std::collections::{BTreeMap, BTreeSet};

/// Time after the planned start of a role before which its robot charges, in milliseconds. Until then the robot gets no role that
/// follows; then the charge that it has decides. Raised: a robot that finds no charger does nothing for longer. A guess: a few
/// minutes.
const CHARGING_LATE_MS: u64 = 5 * 60 * 1000;

/// Returns the awards of promised roles to free robots, in the order of the promises, and the
/// releases of promises that cannot be kept, or that those of a higher priority have displaced. A robot
/// that only waits for others in its role is asked to return the role for a promised role that can start. A robot whose charge
/// is too low by now would give up the role, and would get it no more: its promise is released, so that it can charge. A robot
/// that has planned to charge before a role gets it when it has charged, and no later one before. A robot that does not charge
/// in time (it may have restarted, or have lost charge since) gets the role if its charge suffices, and loses it otherwise.
/// `now_ms` is the time of day that a majority of the voters confirms.
pub(super) fn promises_due(
    ledger: &Ledger,
    scope: Scope<'_>,
    SessionState { rounds, unfit, charges, promises_max, .. }: &SessionState<'_>,
    now_ms: Option<u64>,
    is_due: impl Fn(&AwardedRole) -> bool,
) -> Vec<CoordinatorAction> {
    let promises = scope.promises(ledger);
    if promises.is_empty() {
        return vec![];
    }
    let (mut taken, mut waiting) = (BTreeSet::new(), BTreeMap::new());
    for robot in promises.iter().map(|(.., promise)| &promise.robot).collect::<BTreeSet<_>>() {
        let Some((entry, role, _)) = ledger.held_by(robot) else { continue };
        taken.insert(robot);
        let holder = entry.roles.get(role).and_then(|held| held.holder.as_deref());
        if let Some(holder) = holder.filter(|holder| may_return(ledger, entry, role, holder)) {
            waiting.insert(robot, AwardedRole::of(entry, role, holder));
        }
    }
    for (_, round) in rounds.under_way() {
        if let RoundPhase::Proposing(record) = &round.phase {
            taken.extend(record.chosen.values());
        }
    }
    let mut actions = vec![];
    let mut queues: BTreeMap<&RobotId, (u32, Priority)> = BTreeMap::new();
    for (entry, role, robot) in promises {
        let promised = AwardedRole::of(entry, role, robot);
        let (before, highest) = queues.entry(&robot.robot).or_insert((0, entry.submission.priority));
        // A role that a robot has returned for now exceeds the limit by one.
        let is_displaced = *before > *promises_max && entry.submission.priority < *highest;
        *before += 1;
        let can_start = entry.can_proceed(role) && entry.submission.may_start(now_ms);
        let is_free = !taken.contains(&robot.robot);
        let is_idle = is_free || waiting.contains_key(&robot.robot);
        let charge = charges.get(&robot.robot);
        let late_ms = robot.planned_ms.saturating_add(CHARGING_LATE_MS);
        let may_charge = robot.charging.as_ref().filter(|_| now_ms.is_none_or(|now_ms| now_ms < late_ms));
        let charges_first = may_charge.is_some_and(|stop| has_to_charge(stop, charge));
        // A robot that only waits in another role cannot charge before it has returned that.
        let is_checked = is_free || is_idle && robot.charging.is_none();
        let lacks_charge = |charge: &RecordedCharge| robot.energy.get() > charge.spare + CHARGE_TOLERANCE;
        let is_too_low = can_start && is_checked && !charges_first && charge.is_some_and(lacks_charge);
        let displaced = || format!("{} has promised enough roles of a higher priority", robot.robot);
        let too_low = || format!("the charge of {} is too low for it", robot.robot);
        let reason = unfit.get(&robot.robot).cloned();
        let reason = reason.or_else(|| is_displaced.then(displaced)).or_else(|| is_too_low.then(too_low));
        if let Some(reason) = reason {
            actions.extend(is_due(&promised).then_some(CoordinatorAction::ReleaseRole(promised, reason)));
        } else if !can_start {
            continue;
        } else if charges_first && is_free {
            taken.insert(&robot.robot);
        } else if is_free {
            if ledger.check_promise(&entry.id, role, robot.epoch).is_ok() {
                taken.insert(&robot.robot);
                actions.extend(is_due(&promised).then_some(CoordinatorAction::AwardPromised(promised)));
            }
        } else {
            // The robot gets the returned role again once that role can start. A robot that holds no role can charge.
            let held = waiting.remove(&robot.robot).filter(&is_due);
            let give_way = |awarded| CoordinatorAction::AskToGiveWay { awarded, to: entry.id.clone(), for_now: true };
            actions.extend(held.map(give_way));
        }
    }
    actions
}

/// Checks whether a robot has not charged yet as it has planned.
fn has_to_charge(stop: &ChargingStop, recorded: Option<&RecordedCharge>) -> bool {
    recorded.is_none_or(|recorded| recorded.charge < stop.until.get() - CHARGE_TOLERANCE)
}

/// Returns the robots of a scope with promises that cannot take a role, with the reasons, as far as this node knows.
///
/// With `has_all_records`, a robot without a record or without contact is unknown to the whole fleet.
pub(super) fn unfit_robots(
    ledger: &Ledger,
    scope: Scope<'_>,
    knowledge: &SharedKnowledge,
    has_all_records: bool,
) -> BTreeMap<RobotId, String> {
    let unfit = |robot: &RobotId| {
        if let Some(maintenance) = ledger.orders_of(robot).and_then(|orders| orders.maintenance.as_ref()) {
            return Some(format!("{robot} is {}", maintenance.maintenance_text()));
        }
        let availability = read_record(knowledge, robot, |worker| worker.availability.clone());
        match (availability, knowledge.status(&NodeId::from(robot.clone()))) {
            (None, _) => has_all_records.then(|| format!("{robot} is unknown")),
            // A node that has just started may have the record from another node before it has contact.
            (Some(_), MemberStatus::Unknown) => has_all_records.then(|| format!("{robot} is not in contact")),
            (Some(_), MemberStatus::Down { .. }) => Some(format!("{robot} was judged dead")),
            (Some(availability), _) => problem_of(&availability).map(|problem| format!("{robot} is {problem}")),
        }
    };
    promised_robots(ledger, scope).into_iter().filter_map(|robot| Some((robot.clone(), unfit(robot)?))).collect()
}

/// Returns the charge of the robots of a scope with promises, as far as this node knows.
pub(super) fn recorded_charges(
    ledger: &Ledger,
    scope: Scope<'_>,
    knowledge: &SharedKnowledge,
    limits: &BidLimits,
) -> BTreeMap<RobotId, RecordedCharge> {
    let recorded = |worker: &RobotKnowledge| {
        let charge = worker.battery.get();
        RecordedCharge { charge, spare: charge - limits.charge_floor(worker.useful_charge).get() }
    };
    let robots = promised_robots(ledger, scope).into_iter();
    robots.filter_map(|robot| Some((robot.clone(), read_record(knowledge, robot, recorded)?))).collect()
}

fn promised_robots<'l>(ledger: &'l Ledger, scope: Scope<'_>) -> BTreeSet<&'l RobotId> {
    scope.promises(ledger).into_iter().map(|(.., promise)| &promise.robot).collect()
}

fn read_record<T>(knowledge: &SharedKnowledge, robot: &RobotId, read: impl Fn(&RobotKnowledge) -> T) -> Option<T> {
    let node = NodeId::from(robot.clone());
    knowledge.read(|base| Some(read(base.get(&node)?.knowledge().robot.as_ref()?)))
}

/// Returns the problem for which a robot cannot keep its promises. During an alarm it keeps them, since no other robot could
/// take the roles.
fn problem_of(availability: &Availability) -> Option<String> {
    match availability {
        Availability::OutOfService { problem } if !Alarm::is_problem(problem) => {
            Some(format!("out of service: {problem}"))
        }
        Availability::OutOfService { .. } | Availability::Free | Availability::Holding { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::rounds::Rounds;
    use super::super::test_ledger::Log;
    use super::*;
    use consort_protocol::ids::{MissionId, RoleId};
    use consort_protocol::lease::{LeaseMonitor, LeaseTerms};
    use consort_protocol::ledger::Command;
    use consort_protocol::units::Seconds;

    #[derive(Clone, Copy)]
    struct Case {
        promises_max: u32,
        unfit: &'static [&'static str],
        /// Charge of the arm, all of which is above the minimum.
        spare: Option<f64>,
        /// No role was proposed a short time ago.
        is_due: bool,
    }

    const NOW_MS: u64 = 1_000;
    const USUAL: Case = Case { promises_max: 16, unfit: &[], spare: None, is_due: true };

    fn due(ledger: &Ledger, case: Case) -> Vec<CoordinatorAction> {
        due_at(ledger, case, NOW_MS)
    }

    fn due_at(
        ledger: &Ledger,
        Case { promises_max, unfit, spare, is_due }: Case,
        now_ms: u64,
    ) -> Vec<CoordinatorAction> {
        let (rounds, notified) = (&Rounds::default(), &BTreeMap::new());
        let unfit = &unfit.iter().map(|robot| (robot.parse().unwrap(), "judged dead".to_owned())).collect();
        let recorded = spare.map(|spare| ("lab-arm".parse().unwrap(), RecordedCharge { charge: spare, spare }));
        let charges = &recorded.into_iter().collect();
        let lease_monitor = &LeaseMonitor::new(LeaseTerms::default());
        let ahead = Seconds::ZERO;
        let state = SessionState { lease_monitor, rounds, notified, unfit, charges, promises_max, ahead };
        promises_due(ledger, Scope::All, &state, Some(now_ms), |_| is_due)
    }

    /// Returns the missions whose promised roles are awarded.
    fn awarded(ledger: &Ledger) -> Vec<MissionId> {
        let awarded = due(ledger, USUAL).into_iter().map(|action| match action {
            CoordinatorAction::AwardPromised(role) => role.mission,
            other => panic!("{other:?}"),
        });
        awarded.collect()
    }

    #[test]
    fn an_alarm_is_no_problem_for_promises() {
        let problem = |text: &str| problem_of(&Availability::out_of_service(text.to_owned()));
        assert_eq!(problem("held by Nia").as_deref(), Some("out of service: held by Nia"));
        assert_eq!(problem("under alarm fire by Nia: smoke"), None);
        assert_eq!(problem_of(&Availability::Free), None);
    }

    #[test]
    fn promises_of_a_higher_priority_displace_the_last() {
        let mut log = Log::default();
        let (_, last) = (log.add_mission("ada"), log.add_mission("bob"));
        assert_eq!(
            due(&log.0, Case { promises_max: 0, ..USUAL }),
            [],
            "a lower limit displaces none of the same priority"
        );
        log.add_mission_of("cyd", 1);
        let released = |promises_max| -> Vec<MissionId> {
            let due = due(&log.0, Case { promises_max, ..USUAL }).into_iter().map(|action| match action {
                CoordinatorAction::ReleaseRole(role, _) => role.mission,
                other => panic!("{other:?}"),
            });
            due.collect()
        };
        assert_eq!(released(2), []);
        assert_eq!(released(1), [last]);
    }

    #[test]
    fn the_release_of_a_promise_is_not_proposed_with_each_change() {
        let mut log = Log::default();
        log.add_mission("ada");
        let released = |is_due| due(&log.0, Case { unfit: &["lab-arm"], is_due, ..USUAL }).len();
        assert_eq!((released(true), released(false)), (1, 0));
    }

    #[test]
    fn a_role_that_can_start_is_released_if_the_charge_is_too_low() {
        let mut log = Log::default();
        let mission = log.add_mission("ada");
        let with_spare = |log: &Log, spare| due(&log.0, Case { spare, ..USUAL });
        assert_eq!(with_spare(&log, Some(0.0)), [], "it may charge until then");
        log.end_cart(&mission);
        let released = with_spare(&log, Some(0.07));
        assert!(matches!(released[..], [CoordinatorAction::ReleaseRole(..)]), "{released:?}");
        for spare in [Some(0.09), None] {
            let awarded = with_spare(&log, spare);
            assert!(matches!(awarded[..], [CoordinatorAction::AwardPromised(_)]), "{awarded:?}");
        }
    }

    #[test]
    fn a_robot_gets_a_role_before_which_it_charges_once_it_has_charged() {
        let mut log = Log::default();
        let (charged, next) = (log.add_mission_after_charging("ada", 0.8), log.add_mission("bob"));
        let with_spare = |log: &Log, spare| due(&log.0, Case { spare: Some(spare), ..USUAL });
        log.end_cart(&next);
        assert!(matches!(&with_spare(&log, 0.3)[..], [CoordinatorAction::AwardPromised(role)] if role.mission == next));
        log.end_cart(&charged);
        assert_eq!(with_spare(&log, 0.3), [], "it charges before the role, and before those that follow");
        let awarded = with_spare(&log, 0.79);
        assert!(matches!(&awarded[..], [CoordinatorAction::AwardPromised(role)] if role.mission == charged));
        let late = |spare| due_at(&log.0, Case { spare: Some(spare), ..USUAL }, CHARGING_LATE_MS);
        let by_charge = late(0.3);
        let gets_it = matches!(&by_charge[..], [CoordinatorAction::AwardPromised(role)] if role.mission == charged);
        assert!(gets_it, "its charge suffices, although it has not charged: {by_charge:?}");
        let too_low = late(0.07);
        let released = too_low.iter().filter_map(|action| match action {
            CoordinatorAction::ReleaseRole(role, _) => Some(&role.mission),
            _ => None,
        });
        assert!(released.eq([&charged, &next]), "{too_low:?}");
    }

    #[test]
    fn a_robot_that_only_waits_is_asked_to_return_its_role_if_its_charge_suffices() {
        let mut log = Log::default();
        let (held, mission) = (log.add_mission("ada"), log.add_mission("bob"));
        let role: RoleId = "arm".parse().unwrap();
        let epoch = log.0.mission(&held).unwrap().role_robots()[&role].epoch;
        log.apply(Command::AwardPromised { mission: held, role, epoch });
        log.end_cart(&mission);
        let with_spare = |spare| due(&log.0, Case { spare: Some(spare), ..USUAL });
        let (asked, released) = (with_spare(0.2), with_spare(0.0));
        assert!(matches!(asked[..], [CoordinatorAction::AskToGiveWay { for_now: true, .. }]), "{asked:?}");
        assert!(matches!(released[..], [CoordinatorAction::ReleaseRole(..)]), "{released:?}");
    }

    #[test]
    fn a_free_robot_gets_the_first_promise_that_can_start() {
        let mut log = Log::default();
        let (first, second) = (log.add_mission("ada"), log.add_mission("bob"));
        assert!(awarded(&log.0).is_empty());
        log.end_cart(&second);
        assert_eq!(awarded(&log.0), [second], "the robot does not wait for the first");
        log.end_cart(&first);
        assert_eq!(awarded(&log.0), [first]);
    }
}
