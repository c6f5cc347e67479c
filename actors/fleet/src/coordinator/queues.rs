//! Robots that cannot get a role now: what each holds, has promised and carries.

use super::actions::{AuctionRound, RoundPhase};
use super::message::AwardedRole;
use consort_protocol::auction::{RefusalReason, RobotQueue};
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::ledger::{Ledger, RoleAssignment, RolePhase};
use consort_protocol::units::{Energy, Seconds};
use std::collections::BTreeMap;

/// Returns what each robot holds and has promised, except for a promise that is auctioned again. A proposed award counts as a
/// held role.
pub(super) fn robot_queues(
    ledger: &Ledger,
    rounds: &BTreeMap<MissionId, AuctionRound>,
    auctioned: Option<&AwardedRole>,
) -> BTreeMap<RobotId, RobotQueue> {
    let mut queues: BTreeMap<RobotId, RobotQueue> = BTreeMap::new();
    let mut queue_of = |robot: &RobotId, mission: &MissionId, role: &RoleId, promise: Option<&RoleAssignment>| {
        let reason = RefusalReason::Busy { mission: mission.clone(), role: role.clone() };
        let empty = RobotQueue {
            is_held: false,
            promised: 0,
            time: Seconds::ZERO,
            energy: Energy::ZERO,
            reason: reason.clone(),
        };
        let queue = queues.entry(robot.clone()).or_insert(empty);
        match promise {
            None => (queue.is_held, queue.reason) = (true, reason),
            Some(promise) => {
                queue.promised += 1;
                queue.time += promise.time;
                queue.energy += promise.energy;
            }
        }
    };
    for entry in ledger.active_missions() {
        for (role, held, robot) in entry.assigned_roles() {
            if auctioned.is_some_and(|auctioned| *auctioned == AwardedRole::of(entry, role, robot)) {
                continue;
            }
            let is_promised = held.phase == RolePhase::Promised;
            queue_of(&robot.robot, &entry.id, role, is_promised.then_some(robot));
        }
    }
    for (mission, round) in rounds {
        if let RoundPhase::Proposing { holders, .. } = &round.phase {
            holders.iter().for_each(|(role, robot)| queue_of(robot, mission, role, None));
        }
    }
    queues
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
