//! The next step of an unmanaged role or of an open question, as a value.

use crate::robot::{Sequencer, SequencerAction, StepRef};
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Branch, Command, MissionEntry, PersonRequestEntry, PersonRequestId, RolePhase};
use consort_protocol::plan::StepIndex;
use tracing::warn;

/// Next step of an unmanaged role, or of an open question.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum PersonStep {
    /// Steps have ended that need no person.
    Progress(Command),
    /// The task of this step is to be requested.
    Ask { branch: Branch, step: StepIndex },
    /// People with another role are to be asked, too.
    Escalate(PersonRequestId),
    /// The request has expired.
    Expire(PersonRequestId),
    /// The mission cannot continue.
    Fail { cause: String, branch: Branch },
}

/// Returns the next step of an unmanaged role of an active mission; `None` while it waits. `now_ms` is
/// the confirmed time of day; without it no person is asked.
pub(super) fn next_step(entry: &MissionEntry, role: &RoleId, now_ms: Option<u64>) -> Option<PersonStep> {
    if entry.roles.get(role)?.phase == RolePhase::Ended {
        return None;
    }
    if let Some(open) = entry.open_request_to(role) {
        return request_step(entry, open, now_ms);
    }
    let (mission, branch, ended) = (entry.id.clone(), entry.branch, &entry.roles.get(role)?.ended);
    let mut sequencer = match Sequencer::new(entry.plan(role)?.clone(), ended, entry.role_holders()) {
        Ok(sequencer) => sequencer,
        Err(problem) => {
            warn!(%mission, %role, %problem, "plan cannot be continued");
            return None;
        }
    };
    sequencer.set_vacant_roles(&entry.open_roles());
    sequencer.receive_recorded(&entry.signals_to(role));
    sequencer.set_recorded_outcomes(entry.outcomes_for(role));
    let task = loop {
        match sequencer.next_action() {
            Some(SequencerAction::StartTask { step: StepRef::Step(step), .. }) => break Some(Ok(step)),
            Some(SequencerAction::ResultUnknown { task, cause }) => {
                break Some(Err(format!("{role} could not do {task}: {cause}")));
            }
            Some(SequencerAction::StartTask { .. }) | None => break None,
            Some(
                SequencerAction::SendSignal(_) | SequencerAction::SignalReceived(_) | SequencerAction::TaskSkipped(_),
            ) => {}
        }
    };
    let role = role.clone();
    if sequencer.ended() != ended {
        let (ended, outcomes) = (sequencer.ended().clone(), sequencer.own_outcomes().clone());
        let epoch = Epoch::default();
        return Some(PersonStep::Progress(Command::Progress { mission, role, epoch, branch, ended, outcomes }));
    }
    match task? {
        Ok(step) => now_ms.map(|_| PersonStep::Ask { branch, step }),
        Err(cause) => Some(PersonStep::Fail { cause, branch }),
    }
}

/// Returns the next steps of the open questions of a mission, with the roles of the asking robots.
pub(super) fn question_steps(
    entry: &MissionEntry,
    now_ms: Option<u64>,
) -> impl Iterator<Item = ((MissionId, RoleId), PersonStep)> {
    entry.open_questions().filter_map(move |(asking, question)| {
        Some(((entry.id.clone(), asking.clone()), request_step(entry, question, now_ms)?))
    })
}

/// Returns the next step of an open request; `None` while it waits.
fn request_step(entry: &MissionEntry, open: &PersonRequestEntry, now_ms: Option<u64>) -> Option<PersonStep> {
    let request = PersonRequestId { mission: entry.id.clone(), number: open.number };
    match (open.is_due(now_ms), open.is_escalation_due(now_ms)) {
        (true, _) => Some(PersonStep::Expire(request)),
        (false, true) => Some(PersonStep::Escalate(request)),
        (false, false) => None,
    }
}

#[cfg(test)]
mod tests;
