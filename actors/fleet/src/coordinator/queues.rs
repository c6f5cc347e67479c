//! Robots that cannot get a role now: what each holds, has promised and carries.

use super::message::AwardedRole;
use super::rounds::{RoundPhase, Rounds};
use consort_protocol::auction::{RefusalReason, RobotQueue, RoleEstimate};
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::ledger::{Ledger, MissionEntry, RoleAssignment, RolePhase};
use consort_protocol::units::{Energy, Seconds};
use std::collections::BTreeMap;

/// Returns what each robot holds and has promised, as it counts for a mission, except for a promise that is auctioned again.
/// Proposed awards and promises count, too.
pub(super) fn robot_queues(
    ledger: &Ledger,
    rounds: &Rounds,
    of: &MissionId,
    auctioned: Option<&AwardedRole>,
) -> Queues {
    let mut queues = Queues::new();
    let priority = ledger.mission(of).map(|entry| entry.submission.priority).unwrap_or_default();
    for entry in ledger.missions_with_robots() {
        let is_lower = entry.submission.priority < priority;
        for (role, held, robot) in entry.assigned_roles() {
            if auctioned.is_some_and(|auctioned| *auctioned == AwardedRole::of(entry, role, robot)) {
                continue;
            }
            let reason = RefusalReason::Busy { mission: entry.id.clone(), role: role.clone() };
            let estimate = RoleEstimate { time: robot.time, energy: robot.energy };
            if held.phase == RolePhase::Promised {
                add_promise(queue_of(&mut queues, &robot.robot, reason), estimate, is_lower);
            } else {
                let queue = reserve(&mut queues, &robot.robot, reason, estimate);
                queue.yields = is_lower && may_return(ledger, entry, role, robot);
            }
        }
    }
    for (mission, round) in rounds.under_way() {
        let RoundPhase::Proposing(record) = &round.phase else { continue };
        let Some(entry) = ledger.mission(mission) else { continue };
        let (is_lower, open) = (entry.submission.priority < priority, entry.open_roles());
        // A role that is not open has been committed.
        for (role, robot) in record.chosen.iter().filter(|(role, _)| open.contains(*role)) {
            let reason = RefusalReason::Busy { mission: mission.clone(), role: role.clone() };
            let estimate = record.estimate_of(role, robot);
            if record.promised.contains_key(role) {
                add_promise(queue_of(&mut queues, robot, reason), estimate, is_lower);
            } else {
                reserve(&mut queues, robot, reason, estimate);
            }
        }
    }
    queues
}

fn add_promise(queue: &mut RobotQueue, estimate: RoleEstimate, is_lower: bool) {
    queue.promised += 1;
    if !is_lower {
        queue.preceding += 1;
        queue.time += estimate.time;
        queue.energy += estimate.energy;
    }
}

/// Checks whether a robot may return the role that it holds for now. A robot under orders keeps its role, since it would get no
/// other.
pub(super) fn may_return(ledger: &Ledger, entry: &MissionEntry, role: &RoleId, holder: &RoleAssignment) -> bool {
    entry.only_waits(role) && !ledger.is_under_orders(&holder.robot)
}

/// Queues of robots.
pub(super) type Queues = BTreeMap<RobotId, RobotQueue>;

/// Counts a role as held by a robot.
pub(super) fn reserve<'q>(
    queues: &'q mut Queues,
    robot: &RobotId,
    reason: RefusalReason,
    estimate: RoleEstimate,
) -> &'q mut RobotQueue {
    let queue = queue_of(queues, robot, reason.clone());
    (queue.held, queue.yields, queue.reason) = (Some(estimate), false, reason);
    queue
}

fn queue_of<'q>(queues: &'q mut Queues, robot: &RobotId, reason: RefusalReason) -> &'q mut RobotQueue {
    let (promised, preceding, time, energy) = (0, 0, Seconds::ZERO, Energy::ZERO);
    let empty = RobotQueue { held: None, promised, preceding, time, energy, yields: false, reason };
    queues.entry(robot.clone()).or_insert(empty)
}

/// Returns the robots that can be promised no role of the mission, with the reason: they carry an item of
/// another mission, or have a role of this mission.
pub(super) fn unpromisable_robots(ledger: &Ledger, of: &MissionId) -> BTreeMap<RobotId, RefusalReason> {
    let own = ledger.mission(of).into_iter().flat_map(|entry| {
        entry.assigned_roles().map(|(role, _, robot)| {
            let reason = RefusalReason::Busy { mission: entry.id.clone(), role: role.clone() };
            (robot.robot.clone(), reason)
        })
    });
    carrying_robots(ledger, of).chain(own).collect()
}

/// Returns the robots with an item of another mission.
fn carrying_robots(ledger: &Ledger, of: &MissionId) -> impl Iterator<Item = (RobotId, RefusalReason)> {
    ledger.held_items().filter(|(entry, _)| entry.id != *of).map(|(entry, held_item)| {
        let (item, mission) = (held_item.item, entry.id.clone());
        (held_item.robot, RefusalReason::CarriesItem { item, mission })
    })
}

/// Returns the robots that cannot get a role of the mission, with the reason: they hold a role, are
/// about to get a role, have a promise, or carry an item of another mission.
pub(super) fn unavailable_robots(
    ledger: &Ledger,
    queues: &BTreeMap<RobotId, RobotQueue>,
    of: &MissionId,
) -> BTreeMap<RobotId, RefusalReason> {
    let queues = queues.iter().map(|(robot, queue)| (robot.clone(), queue.reason.clone()));
    carrying_robots(ledger, of).chain(queues).collect()
}

#[cfg(test)]
mod tests {
    use super::super::rounds::AuctionRound;
    use super::super::test_ledger::Log;
    use super::*;
    use consort_protocol::auction::{AuctionId, AuctionRecord};
    use consort_protocol::ledger::Command;

    #[test]
    fn a_queue_counts_by_the_priority_of_the_mission() {
        let mut log = Log::default();
        let held = log.add_mission("ada");
        log.add_mission("bob");
        log.add_mission_of("cyd", 5);
        let (low, high) = (log.add_mission("dan"), log.add_mission_of("eve", 1));
        let role: RoleId = "arm".parse().unwrap();
        let epoch = log.0.mission(&held).unwrap().role_robots()[&role].epoch;
        log.apply(Command::AwardPromised { mission: held, role, epoch });
        let arm: RobotId = "lab-arm".parse().unwrap();
        let queue = |of: &MissionId| robot_queues(&log.0, &Rounds::default(), of, None).remove(&arm).unwrap();
        let counts = |queue: &RobotQueue| {
            let tenths = (queue.energy.get() * 10.0).round();
            (queue.held.is_some(), queue.promised, queue.preceding, tenths, queue.yields)
        };
        assert_eq!(counts(&queue(&low)), (true, 4, 4, 4.0, false));
        assert_eq!(counts(&queue(&high)), (true, 4, 2, 2.0, true), "it waits in a role of a lower priority");
    }

    #[test]
    fn a_proposed_promise_counts_until_it_is_committed() {
        let mut log = Log::default();
        let (proposed, called) = (log.add_mission("ada"), log.add_mission("bob"));
        let (role, arm): (RoleId, RobotId) = ("arm".parse().unwrap(), "lab-arm".parse().unwrap());
        let auction = AuctionId { mission: proposed.clone(), term: 1, round: 1 };
        let record = AuctionRecord {
            chosen: [(role.clone(), arm.clone())].into(),
            promised: [(role.clone(), Seconds::ZERO)].into(),
            ..AuctionRecord::empty(auction)
        };
        let round = AuctionRound::first(RoundPhase::Proposing(Box::new(record)));
        let rounds = Rounds::from_iter([(proposed.clone(), round)]);
        let counts = |log: &Log| {
            let queue = robot_queues(&log.0, &rounds, &called, None).remove(&arm).unwrap();
            (queue.held, queue.promised, queue.preceding)
        };
        assert_eq!(counts(&log), (None, 2, 2), "it is committed");
        let epoch = log.0.mission(&proposed).unwrap().role_robots()[&role].epoch;
        let (mission, cause) = (proposed, "lost".to_owned());
        let (class, moved_nothing, place, gave_way) = (None, true, None, false);
        log.apply(Command::Release { mission, role, epoch, cause, class, moved_nothing, place, gave_way });
        assert_eq!(counts(&log), (None, 2, 2), "it is proposed");
    }
}
