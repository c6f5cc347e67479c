//! Removal of items from simulated robots: a person who resolves a mission states that its robots are empty.
//!
//! The coordinator sends each removal before it proposes the resolution. A host that faults hide then does not receive
//! it, and the robot stays full. So the coordinator of the time repeats the removals of the missions that were resolved
//! lately, by the audit trail, until a host confirms them. Each removal has the same id whenever it is made, so a copy
//! takes nothing that a robot receives later.

use super::simulated::goal_id;
use crate::robot_driver::PersonCommand;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::ledger::{AuditAction, AuditEntry, HeldItem, Ledger, MissionEntry, MissionState};
use consort_protocol::units::NodeTime;
use consort_skills::actions::{GoalId, PersonRequest};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Time after the resolution of a mission for which its removals are repeated. Raised: a robot is emptied after longer
/// faults, and a fleet without such a host gets more queries. A guess.
const REPEATED_FOR_MS: u64 = 10 * 60 * 1000;

/// Interval of the repetitions. Raised: a robot whose host is back is full for longer. A guess: much shorter than the way
/// to the next item.
const REPEAT_INTERVAL: Duration = Duration::from_secs(1);

/// Maximum number of removals that are sent at once; further ones are sent when these are confirmed. A guess.
const REPEATED_MAX: usize = 64;

/// Removals that were repeated in this session.
#[derive(Debug, Default)]
pub(super) struct Removals {
    confirmed: BTreeSet<GoalId>,
    /// Time of the latest repetition.
    sent_at: Option<NodeTime>,
}

impl Removals {
    /// Returns the removals to be repeated now. `confirmed_ms` is the time of day that a majority of the voters confirms. A
    /// robot that may have an item of another mission is left alone. Without a host, as far as is known, a single removal
    /// is repeated.
    pub(super) fn due(
        &mut self,
        ledger: &Ledger,
        has_host: bool,
        now: NodeTime,
        confirmed_ms: Option<u64>,
    ) -> Vec<PersonCommand> {
        let Some(now_ms) = confirmed_ms else { return vec![] };
        if self.sent_at.is_some_and(|at| now.since(at) < REPEAT_INTERVAL) {
            return vec![];
        }
        self.sent_at = Some(now);
        let late = late_removals(ledger, now_ms);
        self.confirmed.retain(|id| late.contains_key(id));
        let is_due =
            |(id, (robot, _)): &(GoalId, (RobotId, _))| !self.confirmed.contains(id) && !may_have_item(ledger, robot);
        let due = late.into_iter().filter(is_due).map(|(_, (_, command))| command);
        due.take(if has_host { REPEATED_MAX } else { 1 }).collect()
    }

    /// A host has done what was requested with this id.
    pub(super) fn confirm(&mut self, id: GoalId) {
        self.confirmed.insert(id);
    }
}

/// Returns the commands to take the items off the robots of a mission that needs intervention; none for another mission.
pub(in crate::coordinator) fn removals(ledger: &Ledger, mission: &MissionId) -> Vec<PersonCommand> {
    let Some(MissionState::NeedsIntervention { items, .. }) = ledger.mission_state(mission) else { return vec![] };
    items.iter().map(|HeldItem { role, robot, .. }| removal(ledger, mission, role, robot)).collect()
}

fn removal(ledger: &Ledger, mission: &MissionId, role: &RoleId, robot: &RobotId) -> PersonCommand {
    PersonCommand {
        id: goal_id(&(ledger.cluster(), mission, role, robot)),
        request: Some(PersonRequest::taking_items(role.clone(), robot.clone())),
    }
}

/// Returns the removals of the missions that were resolved lately, with their robots.
fn late_removals(ledger: &Ledger, now_ms: u64) -> BTreeMap<GoalId, (RobotId, PersonCommand)> {
    let repeated_until = |entry: &AuditEntry| entry.at_ms.saturating_add(REPEATED_FOR_MS);
    let is_late = |entry: &&AuditEntry| entry.action == AuditAction::Resolve && repeated_until(entry) > now_ms;
    let mission = |entry: &AuditEntry| ledger.mission(&entry.subject.parse().ok()?);
    let resolved = ledger.audit_trail().filter(is_late).filter_map(mission);
    let of_mission = |entry: &MissionEntry| {
        let command = |held: HeldItem| {
            let command = removal(ledger, &entry.id, &held.role, &held.robot);
            (command.id, (held.robot, command))
        };
        entry.custody().into_iter().map(command).collect::<Vec<_>>()
    };
    resolved.flat_map(of_mission).collect()
}

/// Checks whether a robot has or may have an item of a mission that is active, or waits for a person.
fn may_have_item(ledger: &Ledger, robot: &RobotId) -> bool {
    let in_role = ledger.held_by(robot).map(|(entry, ..)| entry.custody()).unwrap_or_default();
    let kept = ledger.held_items().map(|(_, held)| held);
    in_role.into_iter().chain(kept).any(|held| held.robot == *robot)
}

#[cfg(test)]
mod tests {
    use super::super::test_ledger::{award, ledger, put_parcel_in};
    use super::*;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Command, Submission};

    const RESOLVED_MS: u64 = 1_700_000_000_000;

    /// Returns the removals that are due this number of seconds after the resolution.
    fn due(removals: &mut Removals, ledger: &Ledger, seconds: u64) -> Vec<PersonCommand> {
        let now_ms = RESOLVED_MS + seconds * 1000;
        removals.due(ledger, true, NodeTime::at(Duration::from_secs(seconds)), Some(now_ms))
    }

    /// Returns a ledger with a mission that was lost with its parcel and resolved, and its removals before that.
    fn resolved() -> (Ledger, MissionId, Vec<PersonCommand>) {
        let (mut ledger, mission) = ledger(true);
        let at = |index| Epoch { term: 1, index };
        ledger.apply(at(5), Command::first_wire_version(3));
        let (by, places) = ("Nia".to_owned(), BTreeMap::new());
        ledger.apply(at(6), Command::Cancel { mission: mission.clone(), by: by.clone(), places, at_ms: RESOLVED_MS });
        let before = removals(&ledger, &mission);
        assert_eq!(before.len(), 1, "{:?}", ledger.mission_state(&mission));
        assert_eq!(due(&mut Removals::default(), &ledger, 0), [], "it waits for a person");
        ledger.apply(at(7), Command::Resolve { mission: mission.clone(), by, at_ms: RESOLVED_MS });
        (ledger, mission, before)
    }

    #[test]
    fn a_removal_is_repeated_until_a_host_confirms_it() {
        let (ledger, _, expected) = resolved();
        let mut session = Removals::default();
        let mut at = |seconds| due(&mut session, &ledger, seconds);
        assert_eq!((at(0), at(0), at(1)), (expected.clone(), vec![], expected.clone()));
        session.confirm(expected[0].id);
        assert_eq!(due(&mut session, &ledger, 2), []);
        let mut next = Removals::default();
        assert_eq!(due(&mut next, &ledger, 599), expected, "the next coordinator cannot know that");
        assert_eq!(due(&mut next, &ledger, 600), []);
    }

    #[test]
    fn nothing_is_taken_off_a_robot_with_an_item_of_its_next_mission() {
        let (mut ledger, mission, expected) = resolved();
        let submission = ledger.mission(&mission).unwrap().submission.clone();
        let next = Submission { request: "b".parse().unwrap(), ..submission };
        ledger.apply(Epoch { term: 1, index: 8 }, Command::Submit(Box::new(next)));
        let next = ledger.missions().find(|entry| entry.id != mission).unwrap().id.clone();
        award(&mut ledger, &next, 9);
        assert_eq!(due(&mut Removals::default(), &ledger, 1), expected, "it has no item yet");
        put_parcel_in(&mut ledger, &next, 9);
        assert_eq!(due(&mut Removals::default(), &ledger, 1), []);
    }
}
