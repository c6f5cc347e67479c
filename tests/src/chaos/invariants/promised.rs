//! A promised role is neither lost nor doubled.
//!
//! A promise lasts until its robot gets the role, an auction gives it to another robot, it is released, a person reassigns
//! or pins the role, or the mission ends or changes to its recovery branch. It is released only if its robot could not
//! take a role, had too little charge or returned this role shortly before, if it has promised a role of a higher
//! priority, or if a person changed a priority shortly before. A robot begins a promised role only under the award that
//! follows the promise.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::chaos::generate::FIRST_MS;
use crate::{Fleet, Observation};
use consort_gossip::MemberStatus;
use consort_protocol::auction::BidLimits;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::knowledge::Availability;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Branch, Command, Ledger, MissionChange, RolePhase};
use consort_skills::actions::RobotBackend as _;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Longest time from the instant at which a robot could not take a role, or returned it for now, until a promise is
/// released for that reason: a coordinator may learn it, or commit the release, only when the longest partition has
/// ended.
const RELEASED_WITHIN: Duration = Duration::from_secs(60);

/// Interval at which the robots are examined.
const INTERVAL: Duration = Duration::from_millis(50);

type Part = (MissionId, RoleId);

/// A promise in the ledger.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Promise {
    robot: RobotId,
    epoch: Epoch,
    branch: Branch,
}

#[derive(Default)]
pub(super) struct Promised {
    reference: ReferenceLedger,
    promises: BTreeMap<Part, Promise>,
    /// Epochs of promises that auctions have made. A returned role keeps the epoch under which it was begun.
    unawarded: BTreeSet<(Part, Epoch)>,
    /// Latest times at which robots returned roles for now.
    returned_at: BTreeMap<Part, Duration>,
    /// Latest times at which robots could not take a role.
    unfit_at: BTreeMap<RobotId, Duration>,
    /// Latest time at which a person changed the priority of a mission.
    reprioritized_at: Option<Duration>,
    /// Time of the next examination.
    due: Duration,
}

impl Promised {
    fn apply(&mut self, now: Duration, at: Epoch, commands: &[Command]) -> Result<(), InvariantViolation> {
        if !self.reference.is_new(at) {
            return Ok(());
        }
        for command in commands {
            self.reference.apply_command(at, command);
            if let Command::ChangeMission { order, .. } = command
                && let MissionChange::SetPriority(_) = order.change
            {
                self.reprioritized_at = Some(now);
            }
            if let Command::Postpone { mission, role, .. } = command {
                self.returned_at.insert((mission.clone(), role.clone()), now);
            }
            let promises = promises(&self.reference.ledger);
            for (part, promise) in self.promises.iter().filter(|(part, promise)| promises.get(*part) != Some(*promise))
            {
                self.check_ended(now, part, promise, command)?;
            }
            if matches!(command, Command::Award { .. } | Command::MovePromise(_)) {
                let new = promises.iter().filter(|(part, promise)| self.promises.get(*part) != Some(*promise));
                self.unawarded.extend(new.map(|(part, promise)| (part.clone(), promise.epoch)));
            }
            self.promises = promises;
        }
        self.reference.index = at.index;
        Ok(())
    }

    /// Checks that `command` may have ended a promise.
    fn check_ended(
        &self,
        now: Duration,
        part: &Part,
        promise: &Promise,
        command: &Command,
    ) -> Result<(), InvariantViolation> {
        let (Promise { robot, epoch, branch }, (mission, role)) = (promise, part);
        let ledger = &self.reference.ledger;
        let Some(entry) = ledger.mission(mission).filter(|entry| !entry.state.is_final() && entry.branch == *branch)
        else {
            return Ok(());
        };
        let of_role = format!("the promise of {role} of {mission} to {robot}");
        let state = entry.roles.get(role);
        let has_robot = |robot: &RobotId| {
            state.and_then(|state| state.holder.as_ref()).is_some_and(|holder| holder.robot == *robot)
        };
        match command {
            Command::AwardPromised { mission: of, role: awarded, .. } if (of, awarded) == (mission, role) => {
                match state.is_some_and(|state| state.phase == RolePhase::Awarded) && has_robot(robot) {
                    true => Ok(()),
                    false => Err(format!("{of_role} was not kept: another robot got the role").into()),
                }
            }
            Command::MovePromise(change) if (&change.mission, &change.role) == (mission, role) => {
                match has_robot(&change.robot) {
                    true => Ok(()),
                    false => Err(format!("{of_role} was not passed to {}", change.robot).into()),
                }
            }
            Command::ChangeMission { mission: of, order } if of == mission && concerns(&order.change, role) => Ok(()),
            Command::Release { mission: of, role: released, epoch: under, cause, .. }
                if (of, released, under) == (mission, role, epoch) =>
            {
                let is_recent = |at: Option<&Duration>| at.is_some_and(|at| now <= *at + RELEASED_WITHIN);
                // A returned role may have been about to be released because of its lease.
                let was_returned = is_recent(self.returned_at.get(part));
                let was_unfit = is_recent(self.unfit_at.get(robot));
                let is_displaced = ledger.promises_in_order().into_iter().any(|(other, _, promised)| {
                    promised.robot == *robot && other.submission.priority > entry.submission.priority
                });
                let was_displaced = self.reprioritized_at.is_some_and(|at| now <= at + RELEASED_WITHIN);
                match was_returned || was_unfit || is_displaced || was_displaced || ledger.is_under_orders(robot) {
                    true => Ok(()),
                    false => Err(format!("{of_role} was released, although the robot could take it: {cause}").into()),
                }
            }
            _ => Err(format!("{of_role} is lost without a release").into()),
        }
    }

    fn begins(&self, node: &NodeId, part: Part, epoch: Epoch) -> Result<(), InvariantViolation> {
        let (mission, role) = &part;
        let begins = format!("{node} begins {role} of {mission} under {epoch}, which was a promise");
        match self.unawarded.contains(&(part, epoch)) {
            true => Err(begins.into()),
            false => Ok(()),
        }
    }
}

/// Checks whether a person reassigns or pins a role.
fn concerns(change: &MissionChange, role: &RoleId) -> bool {
    match change {
        MissionChange::Reassign { role: of, .. } | MissionChange::Pin { role: of, .. } => of == role,
        MissionChange::SetPriority(_) => false,
    }
}

/// Returns the promises of active missions.
fn promises(ledger: &Ledger) -> BTreeMap<Part, Promise> {
    let active = ledger.missions().filter(|entry| !entry.state.is_final());
    let promises = active.flat_map(|entry| {
        entry.promised_roles().map(move |(role, promise)| {
            let (robot, epoch, branch) = (promise.robot.clone(), promise.epoch, entry.branch);
            ((entry.id.clone(), role.clone()), Promise { robot, epoch, branch })
        })
    });
    promises.collect()
}

/// Checks whether a robot is in service by its own record, and alive for all running nodes.
fn can_take_role(fleet: &Fleet, robot: &RobotId) -> bool {
    let node = NodeId::from(robot.clone());
    let is_in_service = fleet
        .knowledge_of(robot.as_str(), &node)
        .is_some_and(|record| !matches!(record.availability, Availability::OutOfService { .. }));
    let is_alive = |status: MemberStatus| matches!(status, MemberStatus::Alive { .. });
    is_in_service && fleet.nodes.values().all(|other| is_alive(other.knowledge.status(&node)))
}

/// Checks whether the charge of a robot, by its own record, is too low for a role that it has promised.
fn lacks_charge(fleet: &Fleet, ledger: &Ledger, robot: &RobotId) -> bool {
    let Some(record) = fleet.knowledge_of(robot.as_str(), &NodeId::from(robot.clone())) else { return false };
    let spare = record.battery.get() - BidLimits::default().charge_floor(record.useful_charge).get();
    let mut promises = ledger.promises_in_order().into_iter();
    promises.any(|(.., promise)| promise.robot == *robot && promise.energy.get() > spare)
}

impl Invariant for Promised {
    fn name(&self) -> &'static str {
        "promised"
    }

    fn observe(&mut self, now: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match (entry, entry.event_kind()) {
            (Observation::EntryApplied { at, commands, .. }, _) => self.apply(now, *at, commands),
            (_, Some(EventKind::Started { mission, role, epoch })) => {
                self.begins(entry.node(), (mission.clone(), role.clone()), *epoch)
            }
            // The coordinator may have judged a robot dead for an instant.
            (Observation::TestAction { node, .. }, _) | (_, Some(EventKind::Left { member: node, .. })) => {
                self.unfit_at.insert(RobotId::from(node.clone()), now);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn check_state(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        // Before, the fleet forms, and without faults the coordinator has no outdated records.
        if at < self.due.max(Duration::from_millis(FIRST_MS)) {
            return Ok(());
        }
        self.due = at + INTERVAL;
        // The hostile node bids, too, and has no body in the world.
        let promised = self.promises.values().map(|promise| promise.robot.clone());
        for robot in fleet.world.robots().into_iter().chain(promised) {
            if !can_take_role(fleet, &robot) || lacks_charge(fleet, &self.reference.ledger, &robot) {
                self.unfit_at.insert(robot, at);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;
    use consort_protocol::auction::{AuctionId, AuctionRecord};
    use consort_protocol::ledger::{OrderRequest, Priority, PromiseMove, Submission};
    use consort_protocol::mission::{Format, MissionTemplate};
    use consort_protocol::plan::divide_and_check;
    use consort_protocol::units::Seconds;
    use consort_skills::domain::hospital;

    const MISSION: &str = r#"{"mission": "bring", "roles": {"arm": {"kind": "managed"}, "cart": {"kind": "managed"}},
        "root": {"task": "take", "type": "wait", "roles": ["arm", "cart"], "parameters": {"seconds": "5"}}}"#;

    fn epoch(index: u64) -> Epoch {
        Epoch { term: 1, index }
    }

    fn secs(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    fn part(number: u32) -> Part {
        (slug(&format!("bring-{number}")), slug("arm"))
    }

    fn submit(request: &str) -> Command {
        let mission = MissionTemplate::parse(MISSION, Format::Json).unwrap();
        let mission = mission.instantiate(&BTreeMap::new(), &hospital()).unwrap();
        let division = divide_and_check(&mission).unwrap();
        Command::Submit(Box::new(Submission::of(slug(request), mission, division)))
    }

    /// Returns the award of a mission to the only arm and a cart.
    fn award(number: u32, cart: &str, is_promised: bool) -> Command {
        let (mission, arm) = part(number);
        let holders = BTreeMap::from([(arm.clone(), slug("lab-arm")), (slug("cart"), slug(cart))]);
        let promised = BTreeMap::from_iter(is_promised.then_some((arm, Seconds::ZERO)));
        let empty = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
        Command::Award { mission, branch: Branch::Main, holders, auction: AuctionRecord { promised, ..empty } }
    }

    /// Returns the command that passes a promise of this epoch to another robot as a promise.
    fn move_promise(number: u32, index: u64, robot: &str) -> Command {
        let (mission, role) = part(number);
        let promised = BTreeMap::from([(role.clone(), Seconds::ZERO)]);
        let empty = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 2 });
        let (robot, cause, auction) = (slug(robot), "it is late".to_owned(), AuctionRecord { promised, ..empty });
        Command::MovePromise(Box::new(PromiseMove { mission, role, epoch: epoch(index), robot, cause, auction }))
    }

    fn release(number: u32, index: u64) -> Command {
        let (mission, role) = part(number);
        Command::Release {
            mission,
            role,
            epoch: epoch(index),
            cause: "out of service".to_owned(),
            class: None,
            moved_nothing: true,
            place: None,
            gave_way: false,
        }
    }

    /// Returns the state in which the arm has a role of the first mission, and the promise of one of the second.
    fn promised() -> Promised {
        let mut state = Promised::default();
        let commands = [submit("a"), award(1, "ada", false), submit("b"), award(2, "bob", true)];
        for (command, index) in commands.into_iter().zip(1..) {
            assert_eq!(state.apply(secs(100), epoch(index), &[command]), Ok(()), "{index}");
        }
        assert_eq!(state.promises.keys().cloned().collect::<Vec<_>>(), [part(2)]);
        state
    }

    #[test]
    fn a_promise_to_a_robot_in_service_that_is_released_is_found() {
        let violation = promised().apply(secs(200), epoch(5), &[release(2, 4)]).unwrap_err().0;
        let expected = "the promise of arm of bring-2 to lab-arm was released, although the robot could take it: ";
        assert!(violation.starts_with(expected), "{violation}");
        let mut state = promised();
        state.unfit_at.insert(slug("lab-arm"), secs(140));
        assert_eq!(state.apply(secs(200), epoch(5), &[release(2, 4)]), Ok(()));
        let mut state = promised();
        state.unfit_at.insert(slug("lab-arm"), secs(139));
        assert!(state.apply(secs(200), epoch(5), &[release(2, 4)]).is_err());
    }

    #[test]
    fn a_promise_that_the_order_of_a_person_releases_is_no_violation() {
        let change = |number: u32, change: MissionChange| {
            let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 9, request: None };
            Command::ChangeMission { mission: part(number).0, order }
        };
        let (wire, (_, role)) = (Command::first_wire_version(3), part(2));
        let reassign = change(2, MissionChange::Reassign { role, to: None, repeat: false });
        let mut state = promised();
        assert_eq!(state.apply(secs(200), epoch(5), &[wire.clone(), reassign]), Ok(()));
        assert!(state.promises.is_empty(), "{:?}", state.promises);

        let lower = change(1, MissionChange::SetPriority(Priority::new(-1).unwrap()));
        let mut state = promised();
        assert_eq!(state.apply(secs(140), epoch(5), &[wire, lower]), Ok(()));
        assert_eq!(state.apply(secs(200), epoch(6), &[release(2, 4)]), Ok(()));
    }

    #[test]
    fn a_promise_of_another_robot_is_checked_like_the_first() {
        let mut state = promised();
        assert_eq!(state.apply(secs(200), epoch(5), &[move_promise(2, 4, "spare-arm")]), Ok(()));
        assert_eq!(state.promises[&part(2)].robot.as_str(), "spare-arm");
        let violation = state.begins(&slug("spare-arm"), part(2), epoch(5)).unwrap_err().0;
        assert_eq!(violation, "spare-arm begins arm of bring-2 under 1.5, which was a promise");
        let violation = state.apply(secs(200), epoch(6), &[release(2, 5)]).unwrap_err().0;
        let expected = "the promise of arm of bring-2 to spare-arm was released, although the robot could take it: ";
        assert!(violation.starts_with(expected), "{violation}");
    }

    #[test]
    fn a_returned_role_may_be_released_for_a_while() {
        let (mission, role) = part(2);
        let postpone = Command::Postpone { mission, role, epoch: epoch(4) };
        for (at_s, is_permitted) in [(200, true), (201, false)] {
            let mut state = promised();
            assert_eq!(state.apply(secs(140), epoch(5), std::slice::from_ref(&postpone)), Ok(()));
            assert_eq!(state.apply(secs(at_s), epoch(6), &[release(2, 4)]).is_ok(), is_permitted, "{at_s}");
        }
    }

    #[test]
    fn a_promise_that_vanishes_is_found() {
        let mut state = promised();
        let promise = Promise { robot: slug("zoe"), epoch: epoch(2), branch: Branch::Main };
        state.promises.insert(part(1), promise);
        let violation = state.apply(secs(200), epoch(5), &[Command::ExpireOrders { now_ms: 0 }]).unwrap_err().0;
        assert_eq!(violation, "the promise of arm of bring-1 to zoe is lost without a release");
    }

    #[test]
    fn a_promised_role_that_is_begun_before_its_award_is_found() {
        let mut state = promised();
        let (mission, role) = part(2);
        let award = Command::AwardPromised { mission, role, epoch: epoch(4) };
        assert_eq!(state.apply(secs(200), epoch(5), &[release(1, 2), award]), Ok(()));
        assert!(state.promises.is_empty());
        let violation = state.begins(&slug("lab-arm"), part(2), epoch(4)).unwrap_err().0;
        assert_eq!(violation, "lab-arm begins arm of bring-2 under 1.4, which was a promise");
        assert_eq!(state.begins(&slug("lab-arm"), part(2), epoch(5)), Ok(()));
    }
}
