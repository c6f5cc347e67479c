//! Changes of unmanaged roles and of requests to people in the ledger, as events and signals to be
//! published.

use consort_protocol::cause::CauseClass;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RoleId, TaskId};
use consort_protocol::ledger::{
    Branch, FinalAnswer, Ledger, MissionChanges, MissionEntry, PersonRequestEntry, PersonRequestPhase, RequestSubject,
};
use consort_protocol::mission::{RoleKind, TaskOutcome};
use consort_protocol::plan::{Signal, StepAction, StepIndex};
use std::collections::{BTreeMap, BTreeSet};

/// State of the unmanaged roles and of the requests of a mission when it was last compared.
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

/// Unmanaged roles and requests of all missions when they were last compared.
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

    /// Returns what has changed since the last comparison. `changes` names the missions.
    pub(super) fn follow(&mut self, ledger: &Ledger, changes: &MissionChanges) -> Published {
        let examined: Vec<&MissionEntry> = match changes {
            MissionChanges::All => {
                self.0.retain(|mission, _| ledger.mission(mission).is_some());
                ledger.missions().collect()
            }
            MissionChanges::These(missions) => {
                let is_gone = |mission: &&MissionId| ledger.mission(mission).is_none();
                missions.iter().filter(is_gone).for_each(|mission| drop(self.0.remove(mission)));
                missions.iter().filter_map(|mission| ledger.mission(mission)).collect()
            }
        };
        let mut published = Published::default();
        for entry in examined.into_iter().filter(|entry| has_people(entry)) {
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

/// Checks whether a mission has roles of people, or has or had requests to people.
pub(super) fn has_people(entry: &MissionEntry) -> bool {
    entry.unmanaged_roles().next().is_some() || entry.person_requests().next().is_some()
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
    let names = || (entry.id.clone(), request.role.clone(), request.task.clone());
    if known.is_none() {
        published.events.push(begin_event(request, names()));
    }
    if let Some(to) = request.escalated_to()
        && known.is_none_or(|known| !known.is_escalated)
    {
        let (mission, role, task) = names();
        published.events.push(EventKind::Escalated { mission, role, task, to: to.clone() });
    }
    if known.is_none_or(|known| !known.is_closed) {
        published.events.extend(end_event(request, names()));
    }
}

/// Mission, role of the people, and task of a request.
type RequestNames = (MissionId, RoleId, TaskId);

fn begin_event(request: &PersonRequestEntry, (mission, role, task): RequestNames) -> EventKind {
    match &request.subject {
        RequestSubject::Step(_) => EventKind::TaskBegan { mission, role, task },
        RequestSubject::Question { question, .. } => {
            EventKind::QuestionAsked { mission, role, task, message: question.message.clone() }
        }
    }
}

/// Returns the event of a closed request; `None` for an open request, and for a task that was
/// withdrawn.
fn end_event(request: &PersonRequestEntry, (mission, role, task): RequestNames) -> Option<EventKind> {
    let is_done = matches!(request.phase, PersonRequestPhase::Answered { answer: FinalAnswer::Done, .. });
    Some(match (&request.subject, &request.phase) {
        // The task of a question is the robot's, which publishes its beginning and its end.
        (RequestSubject::Question { .. }, _) if is_done => EventKind::QuestionAnswered { mission, role, task },
        (RequestSubject::Question { .. }, phase) => {
            EventKind::QuestionClosed { mission, role, task, cause: phase.failure()? }
        }
        (RequestSubject::Step(_), PersonRequestPhase::Open { .. } | PersonRequestPhase::Withdrawn { .. }) => {
            return None;
        }
        (RequestSubject::Step(_), _) if is_done => EventKind::TaskEnded { mission, role, task },
        (RequestSubject::Step(_), phase) => {
            let note = match phase {
                PersonRequestPhase::Answered { note, .. } => note.as_str(),
                _ => "",
            };
            let cause = if note.is_empty() { phase.to_string() } else { note.to_owned() };
            let class = match phase {
                PersonRequestPhase::Expired => CauseClass::Transient,
                _ => CauseClass::Task,
            };
            EventKind::TaskFailed { mission, role, task, cause, class }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::super::test_ledger::{asking, clerk, ledger};
    use super::*;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{AnswerContent, Command, CommandOutcome, PersonAnswer, PersonRequestId};

    const ASKED_MS: u64 = 1_700_000_000_000;

    /// A robot has asked the clerk. Returns the request and the events as well.
    fn asked() -> (Ledger, PeopleChanges, PersonRequestId, Vec<EventKind>) {
        let (mut ledger, mission) = ledger(false);
        let mut changes = PeopleChanges::of(&ledger);
        let command = asking(&ledger, true, ASKED_MS);
        let events = publish(&mut ledger, &mut changes, command);
        (ledger, changes, PersonRequestId { mission, number: 1 }, events)
    }

    fn publish(ledger: &mut Ledger, changes: &mut PeopleChanges, command: Command) -> Vec<EventKind> {
        assert_eq!(ledger.apply(Epoch { term: 2, index: 9 }, command), CommandOutcome::Done);
        let events = changes.follow(ledger, &MissionChanges::All).events;
        assert_eq!(changes.follow(ledger, &MissionChanges::All), Published::default(), "an event is published once");
        events
    }

    fn names(request: &PersonRequestId) -> RequestNames {
        (request.mission.clone(), clerk(), "open".parse().unwrap())
    }

    fn closed(request: &PersonRequestId, cause: &str) -> Vec<EventKind> {
        let (mission, role, task) = names(request);
        vec![EventKind::QuestionClosed { mission, role, task, cause: cause.to_owned() }]
    }

    #[test]
    fn a_question_is_published_when_it_is_asked_escalated_and_answered() {
        let (mut ledger, mut changes, request, events) = asked();
        let (mission, role, task) = names(&request);
        let message = "may I enter?".to_owned();
        assert_eq!(events, [EventKind::QuestionAsked { mission, role, task, message }]);
        let escalate = Command::EscalatePersonRequest { request: request.clone(), now_ms: ASKED_MS + 30_000 };
        let (mission, role, task) = names(&request);
        let to = RoleId::new("head").unwrap();
        assert_eq!(publish(&mut ledger, &mut changes, escalate), [EventKind::Escalated { mission, role, task, to }]);
        let done = answered(&request, AnswerContent::Done(BTreeMap::new()), "");
        let (mission, role, task) = names(&request);
        assert_eq!(publish(&mut ledger, &mut changes, done), [EventKind::QuestionAnswered { mission, role, task }]);
    }

    fn answered(request: &PersonRequestId, content: AnswerContent, note: &str) -> Command {
        let answer = PersonAnswer { by: "Nia".to_owned(), content, note: note.to_owned(), at_ms: ASKED_MS };
        Command::AnswerPerson { request: request.clone(), answer, places: BTreeMap::new() }
    }

    #[test]
    fn a_question_without_an_answer_is_published_with_the_cause() {
        for (content, note, cause) in [
            (AnswerContent::Declined, "", "answered by Nia: declined"),
            (AnswerContent::Cannot, "no key", "answered by Nia: cannot: no key"),
        ] {
            let (mut ledger, mut changes, request, _) = asked();
            let command = answered(&request, content, note);
            assert_eq!(publish(&mut ledger, &mut changes, command), closed(&request, cause));
        }
        let (mut ledger, mut changes, request, _) = asked();
        let (now_ms, places) = (ASKED_MS + 60_000, BTreeMap::new());
        let expire = Command::ExpirePersonRequest { request: request.clone(), now_ms, places };
        assert_eq!(publish(&mut ledger, &mut changes, expire), closed(&request, "expired"));
        let (mut ledger, mut changes, request, _) = asked();
        let withdraw = asking(&ledger, false, ASKED_MS);
        assert_eq!(publish(&mut ledger, &mut changes, withdraw), closed(&request, "withdrawn: amber no longer asks"));
    }
}
