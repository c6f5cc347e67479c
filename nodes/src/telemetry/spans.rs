//! Spans of missions, made of what a node tells on the event stream.
//!
//! A mission is a trace. Its root is told by the coordinator that sees it end, whoever saw it begin; below it stand the
//! auctions that this coordinator held, and what each robot's node did in a role, with its tasks. Each node tells its own
//! spans, and those of a process that died are missing.

use super::ids::{SpanId, TraceId};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{ClusterId, MissionId, RoleId, TaskId};
use consort_protocol::ledger::MissionState;
use std::collections::BTreeMap;

/// Most marks of a span; later ones are left out.
const MARKS_MAX: usize = 128;

/// Something that took time and is over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Span {
    /// The mission that it is part of.
    pub trace: TraceId,
    /// Which it is.
    pub id: SpanId,
    /// What it is part of; nothing for a mission itself.
    pub parent: Option<SpanId>,
    /// What it is: `mission`, `auction`, `role` or `task`, and of what.
    pub name: String,
    /// When it began, in milliseconds of the teller's wall clock.
    pub begin_ms: u64,
    /// When it ended.
    pub end_ms: u64,
    /// Why it failed, if it did.
    pub failure: Option<String>,
    /// More of it.
    pub attributes: Vec<(&'static str, String)>,
    /// What happened meanwhile, and when.
    pub events: Vec<(u64, String)>,
}

impl Span {
    /// One that begins now, below `parent`.
    fn begin(trace: TraceId, id: SpanId, parent: Option<SpanId>, name: String, event: &Event) -> Span {
        let attributes = vec![("node", event.node.to_string())];
        let (begin_ms, end_ms) = (event.at_ms, event.at_ms);
        Span { trace, id, parent, name, begin_ms, end_ms, failure: None, attributes, events: vec![] }
    }

    fn with(mut self, attribute: &'static str, value: impl ToString) -> Span {
        self.attributes.push((attribute, value.to_string()));
        self
    }

    /// Ended; a clock that was put back makes nothing end before it began.
    fn end(self, at_ms: u64, failure: Option<String>) -> Span {
        Span { end_ms: at_ms.max(self.begin_ms), failure, ..self }
    }
}

/// Spans that have begun on this node.
#[derive(Default)]
pub struct SpanTracker {
    auctions: BTreeMap<MissionId, Span>,
    roles: BTreeMap<(MissionId, RoleId), Span>,
    /// Of roles of robots and of people.
    tasks: BTreeMap<(MissionId, RoleId), BTreeMap<TaskId, Span>>,
}

fn root(mission: &MissionId) -> SpanId {
    SpanId::of(&["mission", mission.as_str()])
}

impl SpanTracker {
    /// Takes in what the node told; returns what has ended by it.
    pub fn on_event(&mut self, cluster: Option<ClusterId>, event: &Event) -> Vec<Span> {
        let at = event.at_ms;
        match &event.kind {
            EventKind::SteppedDown { .. } => self.auctions.clear(), // whoever follows holds them anew
            EventKind::Called { mission, round, .. } => {
                let id = SpanId::of(&["auction", mission.as_str(), &round.to_string(), event.node.as_str()]);
                let (trace, name) = (TraceId::of(cluster, mission), format!("auction {mission}"));
                let span = Span::begin(trace, id, Some(root(mission)), name, event).with("round", round);
                self.auctions.insert(mission.clone(), span);
            }
            EventKind::Closed { mission, record } => {
                let Some(span) = self.auctions.remove(mission) else { return vec![] };
                let chosen: Vec<String> =
                    record.chosen.iter().map(|(role, robot)| format!("{role}: {robot}")).collect();
                let span = span.with("answers", record.entries.len()).with("chosen", chosen.join(", "));
                return vec![span.end(at, record.failure.clone())];
            }
            EventKind::Mission { mission, state, submitted_at_ms } if state.is_final() => {
                let trace = TraceId::of(cluster, mission);
                let span = Span::begin(trace, root(mission), None, format!("mission {mission}"), event);
                let span = Span { begin_ms: (*submitted_at_ms).min(at), ..span }.with("state", state.as_str());
                let failure = match state {
                    MissionState::Completed => None,
                    MissionState::Failed { cause } => Some(cause.clone()),
                    other => Some(other.as_str().to_owned()),
                };
                return vec![span.end(at, failure)];
            }
            EventKind::Started { mission, role, epoch } => {
                let id = SpanId::of(&["role", mission.as_str(), role.as_str(), &epoch.to_string()]);
                let (trace, name) = (TraceId::of(cluster, mission), format!("role {role}"));
                let span = Span::begin(trace, id, Some(root(mission)), name, event).with("epoch", epoch);
                self.roles.insert((mission.clone(), role.clone()), span);
            }
            EventKind::Halted { mission, role, reason } => {
                let reason = format!("{reason:?}").to_lowercase();
                return self.role_ended((mission.clone(), role.clone()), at, None, &reason);
            }
            EventKind::GaveUp { mission, role, cause, .. } => {
                return self.role_ended((mission.clone(), role.clone()), at, Some(cause.clone()), "gave up");
            }
            EventKind::TaskBegan { mission, role, task } => {
                let key = (mission.clone(), role.clone());
                // People's tasks have no role of the fleet's: they stand below the mission.
                let parent = self.roles.get(&key).map_or(root(mission), |role| role.id);
                let words = ["task", mission.as_str(), role.as_str(), task.as_str(), &parent.to_string()];
                let (trace, name) = (TraceId::of(cluster, mission), format!("task {task}"));
                let span = Span::begin(trace, SpanId::of(&words), Some(parent), name, event).with("role", role);
                self.tasks.entry(key).or_default().insert(task.clone(), span);
            }
            EventKind::TaskEnded { mission, role, task } => {
                return self.task_ended((mission.clone(), role.clone()), task, at, None).into_iter().collect();
            }
            EventKind::TaskFailed { mission, role, task, cause } => {
                let failure = Some(cause.clone());
                return self.task_ended((mission.clone(), role.clone()), task, at, failure).into_iter().collect();
            }
            other => self.mark(other, at),
        }
        vec![]
    }

    /// A node's robot has one role at a time: what happens in a mission happens to that.
    fn mark(&mut self, what: &EventKind, at: u64) {
        let Some((mission, text)) = marked(what) else { return };
        let role = self.roles.iter_mut().find(|((of, _), _)| of == mission);
        if let Some((_, span)) = role.filter(|(_, span)| span.events.len() < MARKS_MAX) {
            span.events.push((at, text));
        }
    }

    /// The tasks that were under way are left off with it.
    fn role_ended(&mut self, key: (MissionId, RoleId), at: u64, failure: Option<String>, why: &str) -> Vec<Span> {
        let tasks = self.tasks.remove(&key).unwrap_or_default().into_values();
        let tasks = tasks.map(|span| span.end(at, Some(format!("left off: {why}"))));
        let role = self.roles.remove(&key).map(|span| span.with("ended", why).end(at, failure));
        tasks.chain(role).collect()
    }

    fn task_ended(
        &mut self,
        key: (MissionId, RoleId),
        task: &TaskId,
        at: u64,
        failure: Option<String>,
    ) -> Option<Span> {
        let tasks = self.tasks.get_mut(&key)?;
        let span = tasks.remove(task)?;
        if tasks.is_empty() {
            self.tasks.remove(&key);
        }
        Some(span.end(at, failure))
    }
}

/// What is told in a role's span rather than in one of its own.
fn marked(what: &EventKind) -> Option<(&MissionId, String)> {
    Some(match what {
        EventKind::Sent { mission, signal } => (mission, format!("sent {signal}")),
        EventKind::Heard { mission, signal } => (mission, format!("heard {signal}")),
        EventKind::Suspended { mission, .. } => (mission, "suspended: its lease has run out".to_owned()),
        EventKind::Resumed { mission, .. } => (mission, "resumed".to_owned()),
        EventKind::TaskRetried { mission, task, attempt, cause, .. } => {
            (mission, format!("{task} failed for the {attempt}. time and is tried again: {cause}"))
        }
        EventKind::Alternative { mission, task, cause, .. } => (mission, format!("another way than {task}: {cause}")),
        EventKind::ChargeShort { mission, cause, .. } => (mission, format!("goes on with little charge: {cause}")),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ids::NodeId;
    use consort_protocol::lease::{EndReason, Epoch};

    /// A node that tells of mission m-1, and what became spans of it.
    struct Teller {
        node: NodeId,
        spans: SpanTracker,
        at_ms: u64,
    }

    fn teller(node: &str) -> Teller {
        Teller { node: node.parse().unwrap(), spans: SpanTracker::default(), at_ms: 1_000 }
    }

    impl Teller {
        /// It tells so a second later.
        fn tells(&mut self, what: EventKind) -> Vec<Span> {
            self.at_ms += 1_000;
            let event = Event { node: self.node.clone(), sequence: 1, at_ms: self.at_ms, kind: what };
            self.spans.on_event(Some(ClusterId(7)), &event)
        }
    }

    fn mission() -> MissionId {
        "m-1".parse().unwrap()
    }

    fn role() -> RoleId {
        "carrier".parse().unwrap()
    }

    fn task(name: &str) -> TaskId {
        name.parse().unwrap()
    }

    fn started() -> EventKind {
        EventKind::Started { mission: mission(), role: role(), epoch: Epoch { term: 1, index: 3 } }
    }

    fn began(name: &str) -> EventKind {
        EventKind::TaskBegan { mission: mission(), role: role(), task: task(name) }
    }

    fn done(name: &str) -> EventKind {
        EventKind::TaskEnded { mission: mission(), role: role(), task: task(name) }
    }

    fn halted(reason: EndReason) -> EventKind {
        EventKind::Halted { mission: mission(), role: role(), reason }
    }

    fn told(spans: &[Span]) -> Vec<(&str, u64, u64, Option<&str>)> {
        spans.iter().map(|span| (span.name.as_str(), span.begin_ms, span.end_ms, span.failure.as_deref())).collect()
    }

    #[test]
    fn spans_of_several_processes_hang_together() {
        let mut robot = teller("ada");
        assert_eq!(robot.tells(started()), []);
        robot.tells(began("go"));
        let first = robot.tells(done("go"));
        assert_eq!(told(&first), [("task go", 3_000, 4_000, None)]);
        let over = robot.tells(halted(EndReason::Over));
        assert_eq!(told(&over), [("role carrier", 2_000, 5_000, None)]);

        // Another node saw it end; it was elected after the request.
        let mut coordinator = teller("station-1");
        let end = EventKind::Mission { mission: mission(), state: MissionState::Completed, submitted_at_ms: 500 };
        let whole = coordinator.tells(end);
        assert_eq!(told(&whole), [("mission m-1", 500, 2_000, None)]);
        assert_eq!(whole[0].parent, None);
        assert_eq!((over[0].parent, first[0].parent), (Some(whole[0].id), Some(over[0].id)));
        let traces = [first[0].trace, over[0].trace, whole[0].trace];
        assert!(traces.iter().all(|trace| *trace == TraceId::of(Some(ClusterId(7)), &mission())));
    }

    #[test]
    fn what_is_left_off_has_failed_and_says_by_what() {
        let mut robot = teller("ada");
        robot.tells(started());
        robot.tells(began("go"));
        let signal = EventKind::Suspended { mission: mission(), role: role() };
        assert_eq!(robot.tells(signal), []);
        let spans = robot.tells(halted(EndReason::Canceled));
        let expected = [("task go", 3_000, 5_000, Some("left off: canceled")), ("role carrier", 2_000, 5_000, None)];
        assert_eq!(told(&spans), expected);
        assert_eq!(spans[1].events, [(4_000, "suspended: its lease has run out".to_owned())]);
        assert_eq!(robot.tells(halted(EndReason::Canceled)), [], "told twice, it ends once");

        robot.tells(started());
        robot.tells(began("go"));
        let cause = "the way is closed".to_owned();
        let failed = EventKind::TaskFailed { mission: mission(), role: role(), task: task("go"), cause: cause.clone() };
        assert_eq!(told(&robot.tells(failed)), [("task go", 8_000, 9_000, Some("the way is closed"))]);
    }

    #[test]
    fn another_award_of_a_role_is_another_span() {
        let mut robot = teller("ada");
        robot.tells(started());
        let first = robot.tells(halted(EndReason::Released));
        let epoch = Epoch { term: 2, index: 9 };
        robot.tells(EventKind::Started { mission: mission(), role: role(), epoch });
        let second = robot.tells(halted(EndReason::Over));
        assert_ne!(first[0].id, second[0].id);
    }

    #[test]
    fn tasks_of_people_stand_below_the_mission_and_take_up_no_room_afterwards() {
        let mut host = teller("world");
        host.tells(began("deposit"));
        let spans = host.tells(done("deposit"));
        assert_eq!(spans[0].parent, Some(root(&mission())));
        assert!(host.spans.tasks.is_empty());
    }
}
