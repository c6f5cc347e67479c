//! Only people change missions, orders, alarms, schedules and nodes: no command of the log is by the hostile node. Only
//! the holder of a role asks a person. Only a robot states where it is, and no node ever has a record that the hostile
//! node has changed. Only people make a node leave, and only the coordinator holds a robot.

use super::{Invariant, InvariantViolation};
use crate::chaos::hostile::HOSTILE;
use crate::{Fleet, Observation};
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Availability, KnownRecord};
use consort_protocol::ledger::{Command, Ledger, MissionState, PersonRequestEntry, RequestSubject};
use std::collections::BTreeSet;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Authority;

fn only_clients(ledger: &Ledger) -> Result<(), InvariantViolation> {
    for entry in ledger.missions() {
        if entry.submission.request.as_str().starts_with(HOSTILE) {
            return Err(format!("the hostile node has submitted {}", entry.id).into());
        }
        let asks = |request: &PersonRequestEntry| matches!(&request.subject, RequestSubject::Question { question, .. } if question.message.contains(HOSTILE));
        if entry.person_requests().any(|(_, request)| asks(request)) {
            return Err(format!("the hostile node has asked a person in {}", entry.id).into());
        }
        if let MissionState::Canceled { by } = &entry.state
            && by.contains(HOSTILE)
        {
            return Err(format!("the hostile node has canceled {}", entry.id).into());
        }
    }
    Ok(())
}

/// Returns the person who requested a command; `None` for a command that no person requests.
fn person_of(command: &Command) -> Option<&str> {
    let by = match command {
        Command::Submit(submission) => &submission.by,
        Command::AddSchedule { schedule, .. } => &schedule.submission.by,
        Command::PauseSchedule { pause, .. } => &pause.by,
        Command::AnswerPerson { answer, .. } => &answer.by,
        Command::Cancel { by, .. }
        | Command::Resolve { by, .. }
        | Command::RemoveSchedule { by, .. }
        | Command::ResumeSchedule { by, .. }
        | Command::RaiseWireVersion { by, .. } => by,
        Command::OrderRobots { order, .. } => &order.by,
        Command::ChangeClosures { order, .. } => &order.by,
        Command::ChangeSpeedLimits { order, .. } => &order.by,
        Command::ChangeAlarms { order } => &order.by,
        Command::ChangeMission { order, .. } => &order.by,
        Command::CancelMissions { order } => &order.by,
        _ => return None,
    };
    Some(by)
}

fn check_commands(commands: &[Command]) -> Result<(), InvariantViolation> {
    match commands.iter().find(|command| person_of(command).is_some_and(|by| by.contains(HOSTILE))) {
        Some(command) => Err(format!("the hostile node has made a request: {command:?}").into()),
        None => Ok(()),
    }
}

/// Returns what a known record shows of an attack that succeeded.
fn problem_of(node: &NodeId, known: &KnownRecord, asked_to_leave: &BTreeSet<NodeId>) -> Option<String> {
    let content = known.knowledge();
    if content.leaving && !asked_to_leave.contains(node) {
        return Some(format!("{node} leaves, and no person has asked it to"));
    }
    let robot = content.robot.as_ref()?;
    if robot.estimator == HOSTILE {
        return Some(format!("the hostile node has changed the record of {node}"));
    }
    if robot.place.as_str() == HOSTILE {
        return Some(format!("{node} is where only the hostile node has stated that it is"));
    }
    match &robot.availability {
        Availability::OutOfService { problem } if problem.contains(HOSTILE) => {
            Some(format!("{node} obeys the hostile node: {problem}"))
        }
        _ => None,
    }
}

impl Invariant for Authority {
    fn name(&self) -> &'static str {
        "authority"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::LeadershipChanged { leading_as: Some(_), .. } => fleet.ledger(only_clients).unwrap_or(Ok(())),
            Observation::EntryApplied { commands, .. } => check_commands(commands),
            _ => Ok(()),
        }
    }

    fn check_state(&mut self, _: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        for (name, node) in &fleet.nodes {
            let asked = &fleet.asked_to_leave;
            let problem =
                node.knowledge.read(|base| base.iter().find_map(|(owner, known)| problem_of(owner, known, asked)));
            if let Some(problem) = problem {
                return Err(format!("by the records of {name}, {problem}").into());
            }
        }
        Ok(())
    }

    fn check_end(&mut self, fleet: &Fleet) -> Result<(), InvariantViolation> {
        fleet.ledger(only_clients).unwrap_or(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::invariants::test_missions::cancel;
    use crate::{RobotSpec, slug};
    use consort_protocol::knowledge::{Knowledge, KnowledgeBase, Record, RecordStamp};
    use consort_protocol::ledger::{AlarmChange, OrderChange, OrderRequest};
    use consort_protocol::units::NodeTime;
    use consort_world::map;

    fn release(by: &str) -> Command {
        let order = OrderRequest { change: OrderChange::Release, by: by.to_owned(), at_ms: 1, request: None };
        Command::OrderRobots { robots: BTreeSet::from([slug("garnet")]), order }
    }

    #[test]
    fn a_request_of_the_hostile_node_is_found() {
        let change = AlarmChange::Clear { alarm: None };
        let clear = OrderRequest { change, by: "Nia, according to mallory".to_owned(), at_ms: 1, request: None };
        for command in [release("mallory"), cancel("mallory", &["rest-1"]), Command::ChangeAlarms { order: clear }] {
            let violation = check_commands(&[release("Nia"), command]).unwrap_err().0;
            assert!(violation.starts_with("the hostile node has made a request: "), "{violation}");
        }
        assert_eq!(check_commands(&[release("Nia"), cancel("Abe", &["rest-1"])]), Ok(()));
    }

    /// Returns what the record of a node with this content shows.
    fn problem_in(node: &NodeId, knowledge: Knowledge, asked_to_leave: &BTreeSet<NodeId>) -> Option<String> {
        let stamp = RecordStamp { incarnation: 1, version: 1 };
        let mut base = KnowledgeBase::default();
        base.merge(Record { owner: node.clone(), stamp, knowledge, proof: None }, NodeTime::default());
        problem_of(node, base.get(node).unwrap(), asked_to_leave)
    }

    #[test]
    fn a_node_that_leaves_without_a_request_is_found() {
        let knowledge = Knowledge { leaving: true, ..Knowledge::of(None) };
        let node: NodeId = slug("aster");
        let problem = problem_in(&node, knowledge.clone(), &BTreeSet::new());
        assert_eq!(problem.as_deref(), Some("aster leaves, and no person has asked it to"));
        assert_eq!(problem_in(&node, knowledge, &BTreeSet::from([node.clone()])), None);
    }

    #[test]
    fn a_record_that_the_hostile_node_has_changed_is_found() {
        let map = map::shipped("hospital").expect("the shipped map is sound");
        let (node, mut robot) = (slug("garnet"), RobotSpec::carrier("garnet", "Dock").worker(&map));
        assert_eq!(problem_in(&node, Knowledge::of(Some(robot.clone())), &BTreeSet::new()), None);
        robot.estimator = HOSTILE.to_owned();
        let problem = problem_in(&node, Knowledge::of(Some(robot)), &BTreeSet::new());
        assert_eq!(problem.as_deref(), Some("the hostile node has changed the record of garnet"));
    }
}
