//! Changes of unmanaged roles in the ledger, as events and signals to be published.

use consort_protocol::cause::CauseClass;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::ledger::{
    Branch, FinalAnswer, Ledger, MissionEntry, PersonRequestEntry, PersonRequestPhase, RequestSubject,
};
use consort_protocol::mission::{RoleKind, TaskOutcome};
use consort_protocol::plan::{Signal, StepAction, StepIndex};
use std::collections::{BTreeMap, BTreeSet};

/// State of the unmanaged roles of a mission when it was last compared.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Seen {
    branch: Branch,
    ended: BTreeMap<RoleId, BTreeSet<StepIndex>>,
    /// Requests by their numbers.
    requests: BTreeMap<u32, SeenRequest>,
}

/// State of a request when it was last compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct SeenRequest {
    is_escalated: bool,
    is_closed: bool,
}

/// Unmanaged roles of all missions when they were last compared.
#[derive(Debug, Default)]
pub(super) struct PeopleChanges(BTreeMap<MissionId, Seen>);

/// Events and signals to be published.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Published {
    pub(super) events: Vec<EventKind>,
    pub(super) signals: Vec<(MissionId, Signal)>,
}

impl PeopleChanges {
    /// Starts with the present state: it is not reported.
    pub(super) fn of(ledger: &Ledger) -> PeopleChanges {
        PeopleChanges(ledger.missions().map(|entry| (entry.id.clone(), seen(entry))).collect())
    }

    /// Returns what has changed since the last comparison.
    pub(super) fn follow(&mut self, ledger: &Ledger) -> Published {
        self.0.retain(|mission, _| ledger.mission(mission).is_some());
        let mut published = Published::default();
        for entry in ledger.missions().filter(|entry| entry.unmanaged_roles().next().is_some()) {
            let now = seen(entry);
            let before = self.0.get(&entry.id).cloned().unwrap_or_default();
            if before == now {
                continue;
            }
            let nothing = BTreeSet::new();
            for (role, ended) in &now.ended {
                let known = before.ended.get(role).filter(|_| before.branch == now.branch).unwrap_or(&nothing);
                ended.difference(known).for_each(|step| add_step(&mut published, entry, role, *step));
            }
            for (_, request) in entry.person_requests() {
                add_request(&mut published, entry, request, before.requests.get(&request.number).copied());
            }
            self.0.insert(entry.id.clone(), now);
        }
        published
    }
}

fn seen(entry: &MissionEntry) -> Seen {
    let unmanaged = entry.roles.iter().filter(|(_, role)| role.kind == RoleKind::Unmanaged);
    Seen {
        branch: entry.branch,
        ended: unmanaged.map(|(id, role)| (id.clone(), role.ended.clone())).collect(),
        requests: entry.person_requests().map(|(_, request)| (request.number, seen_request(request))).collect(),
    }
}

fn seen_request(request: &PersonRequestEntry) -> SeenRequest {
    SeenRequest { is_escalated: request.escalated_to().is_some(), is_closed: !request.is_open() }
}

fn add_step(published: &mut Published, entry: &MissionEntry, role: &RoleId, step: StepIndex) {
    let planned = entry.plan(role).and_then(|plan| plan.steps.get(step as usize));
    let (mission, role) = (entry.id.clone(), role.clone());
    published.events.push(match planned.map(|step| &step.action) {
        Some(StepAction::Send(signal)) => {
            published.signals.push((mission.clone(), signal.clone()));
            EventKind::Sent { mission, signal: signal.clone() }
        }
        Some(StepAction::Wait(signal)) => EventKind::Received { mission, signal: signal.clone() },
        Some(StepAction::Task { id, .. }) if entry.outcomes.get(id) == Some(&TaskOutcome::Skipped) => {
            EventKind::TaskSkipped { mission, role, task: id.clone() }
        }
        // The end of a request is published with the request.
        Some(StepAction::Task { .. }) | None => return,
    });
}

/// Adds the beginning, the escalation and the end of a request. `known` is its state when it was last
/// compared.
fn add_request(
    published: &mut Published,
    entry: &MissionEntry,
    request: &PersonRequestEntry,
    known: Option<SeenRequest>,
) {
    // The task of a question is the robot's, which publishes its beginning and its end.
    if let RequestSubject::Question { .. } = request.subject {
        return;
    }
    let (mission, role, task) = (entry.id.clone(), request.role.clone(), request.task.clone());
    if known.is_none() {
        let (mission, role, task) = (mission.clone(), role.clone(), task.clone());
        published.events.push(EventKind::TaskBegan { mission, role, task });
    }
    if let Some(to) = request.escalated_to()
        && known.is_none_or(|known| !known.is_escalated)
    {
        let (mission, role, task, to) = (mission.clone(), role.clone(), task.clone(), to.clone());
        published.events.push(EventKind::Escalated { mission, role, task, to });
    }
    if known.is_some_and(|known| known.is_closed) {
        return;
    }
    let cause = match &request.phase {
        PersonRequestPhase::Open { .. } | PersonRequestPhase::Withdrawn { .. } => return,
        PersonRequestPhase::Answered { answer: FinalAnswer::Done, .. } => {
            return published.events.push(EventKind::TaskEnded { mission, role, task });
        }
        PersonRequestPhase::Answered { note, .. } if !note.is_empty() => note.clone(),
        phase => phase.to_string(),
    };
    published.events.push(EventKind::TaskFailed { mission, role, task, cause, class: CauseClass::Task });
}
