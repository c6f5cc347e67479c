//! Builds spans of missions from a node's events.
//!
//! A mission is a trace. Its root span is published by the coordinator that observes its end, even
//! if another node observed its beginning. Below it are the auctions of this coordinator, and the
//! roles and tasks of each robot's node. Each node publishes its own spans; the spans of a failed
//! process are missing.

use super::ids::{SpanId, TraceId};
use consort_protocol::auction::{AuctionEntry, BidVerdict};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{ClusterId, MissionId, RoleId, TaskId};
use consort_protocol::ledger::MissionState;
use std::collections::BTreeMap;

/// Maximum number of events of a span; later events are dropped.
const EVENTS_MAX: usize = 128;

/// A finished span.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Span {
    /// The trace of the mission.
    pub trace: TraceId,
    /// The id.
    pub id: SpanId,
    /// The parent span; `None` for a mission itself.
    pub parent: Option<SpanId>,
    /// Name: `mission`, `auction`, `role` or `task`, with its id.
    pub name: String,
    /// Start, in milliseconds of the node's wall clock.
    pub begin_ms: u64,
    /// End.
    pub end_ms: u64,
    /// Cause of a failure, if any.
    pub failure: Option<String>,
    /// Attributes.
    pub attributes: Vec<(&'static str, String)>,
    /// Events within the span, with their times.
    pub events: Vec<(u64, String)>,
}

impl Span {
    /// Creates a span that begins now, below `parent`.
    fn begin(trace: TraceId, id: SpanId, parent: Option<SpanId>, name: String, event: &Event) -> Span {
        let attributes = vec![("node", event.node.to_string())];
        let (begin_ms, end_ms) = (event.at_ms, event.at_ms);
        Span { trace, id, parent, name, begin_ms, end_ms, failure: None, attributes, events: vec![] }
    }

    fn with(mut self, attribute: &'static str, value: impl ToString) -> Span {
        self.attributes.push((attribute, value.to_string()));
        self
    }

    /// Ends the span; after a clock was set back, the end is not before the beginning.
    fn end(self, at_ms: u64, failure: Option<String>) -> Span {
        Span { end_ms: at_ms.max(self.begin_ms), failure, ..self }
    }
}

/// Unfinished spans of this node.
#[derive(Default)]
pub(crate) struct SpanTracker {
    auctions: BTreeMap<MissionId, Span>,
    roles: BTreeMap<(MissionId, RoleId), Span>,
    /// Tasks in roles of robots and of people.
    tasks: BTreeMap<(MissionId, RoleId), BTreeMap<TaskId, Span>>,
}

fn root(mission: &MissionId) -> SpanId {
    SpanId::of(&["mission", mission.as_str()])
}

impl SpanTracker {
    /// Applies an event of the node, and returns the finished spans.
    pub(crate) fn on_event(&mut self, cluster: Option<ClusterId>, event: &Event) -> Vec<Span> {
        let at = event.at_ms;
        match &event.kind {
            EventKind::SteppedDown { .. } => self.auctions.clear(), // the next coordinator repeats them
            EventKind::BidsRequested { mission, round, .. } => {
                let id = SpanId::of(&["auction", mission.as_str(), &round.to_string(), event.node.as_str()]);
                let (trace, name) = (TraceId::of(cluster, mission), format!("auction {mission}"));
                let span = Span::begin(trace, id, Some(root(mission)), name, event).with("round", round);
                self.auctions.insert(mission.clone(), span);
            }
            EventKind::Closed { mission, record } => {
                let Some(span) = self.auctions.remove(mission) else { return vec![] };
                let chosen: Vec<String> =
                    record.chosen.iter().map(|(role, robot)| format!("{role}: {robot}")).collect();
                let is_answer = |entry: &&AuctionEntry| !matches!(entry.verdict, BidVerdict::NotAsked { .. });
                let answers = record.entries.iter().filter(is_answer).count();
                let span = span.with("answers", answers).with("chosen", chosen.join(", "));
                return vec![span.end(at, record.failure.clone())];
            }
            EventKind::Mission { mission, state, submitted_at_ms } if state.is_final() => {
                let trace = TraceId::of(cluster, mission);
                let span = Span::begin(trace, root(mission), None, format!("mission {mission}"), event);
                let span = Span { begin_ms: (*submitted_at_ms).min(at), ..span }.with("state", state.as_str());
                let failure = match state {
                    MissionState::Completed => None,
                    MissionState::Failed { cause, .. } => Some(cause.clone()),
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
                return self.end_role((mission.clone(), role.clone()), at, None, &reason);
            }
            EventKind::GaveUp { mission, role, cause, .. } => {
                return self.end_role((mission.clone(), role.clone()), at, Some(cause.clone()), "gave up");
            }
            EventKind::TaskBegan { mission, role, task } => {
                let key = (mission.clone(), role.clone());
                // Tasks of people have no role span: they stand below the mission.
                let parent = self.roles.get(&key).map_or(root(mission), |role| role.id);
                let words = ["task", mission.as_str(), role.as_str(), task.as_str(), &parent.to_string()];
                let (trace, name) = (TraceId::of(cluster, mission), format!("task {task}"));
                let span = Span::begin(trace, SpanId::of(&words), Some(parent), name, event).with("role", role);
                self.tasks.entry(key).or_default().insert(task.clone(), span);
            }
            EventKind::TaskEnded { mission, role, task } => {
                return self.end_task((mission.clone(), role.clone()), task, at, None).into_iter().collect();
            }
            EventKind::TaskFailed { mission, role, task, cause, .. } => {
                let failure = Some(cause.clone());
                return self.end_task((mission.clone(), role.clone()), task, at, failure).into_iter().collect();
            }
            other => self.add_event(other, at),
        }
        vec![]
    }

    /// A robot has a single role at a time: the events of a mission belong to that role.
    fn add_event(&mut self, kind: &EventKind, at: u64) {
        let Some((mission, text)) = role_event(kind) else { return };
        let role = self.roles.iter_mut().find(|((of, _), _)| of == mission);
        if let Some((_, span)) = role.filter(|(_, span)| span.events.len() < EVENTS_MAX) {
            span.events.push((at, text));
        }
    }

    /// The unfinished tasks are aborted with it.
    fn end_role(&mut self, key: (MissionId, RoleId), at: u64, failure: Option<String>, why: &str) -> Vec<Span> {
        let tasks = self.tasks.remove(&key).unwrap_or_default().into_values();
        let tasks = tasks.map(|span| span.end(at, Some(format!("aborted: {why}"))));
        let role = self.roles.remove(&key).map(|span| span.with("ended", why).end(at, failure));
        tasks.chain(role).collect()
    }

    fn end_task(&mut self, key: (MissionId, RoleId), task: &TaskId, at: u64, failure: Option<String>) -> Option<Span> {
        let tasks = self.tasks.get_mut(&key)?;
        let span = tasks.remove(task)?;
        if tasks.is_empty() {
            self.tasks.remove(&key);
        }
        Some(span.end(at, failure))
    }
}

/// Returns the events that are part of a role's span.
fn role_event(kind: &EventKind) -> Option<(&MissionId, String)> {
    Some(match kind {
        EventKind::Sent { mission, signal } => (mission, format!("sent {signal}")),
        EventKind::Received { mission, signal } => (mission, format!("received {signal}")),
        EventKind::Suspended { mission, .. } => (mission, "suspended: its lease was not renewed".to_owned()),
        EventKind::Resumed { mission, .. } => (mission, "resumed".to_owned()),
        EventKind::TaskRetried { mission, task, attempt, cause, .. } => {
            (mission, format!("{task} failed at attempt {attempt} and is retried: {cause}"))
        }
        EventKind::Alternative { mission, task, cause, .. } => (mission, format!("alternative to {task}: {cause}")),
        EventKind::LowCharge { mission, cause, .. } => (mission, format!("continues with low charge: {cause}")),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::cause::CauseClass;
    use consort_protocol::ids::NodeId;
    use consort_protocol::lease::{EndReason, Epoch};

    /// A node that publishes events of mission m-1, and its spans.
    struct Publisher {
        node: NodeId,
        spans: SpanTracker,
        at_ms: u64,
    }

    fn publisher(node: &str) -> Publisher {
        Publisher { node: node.parse().unwrap(), spans: SpanTracker::default(), at_ms: 1_000 }
    }

    impl Publisher {
        /// Publishes an event a second later.
        fn publish(&mut self, kind: EventKind) -> Vec<Span> {
            self.at_ms += 1_000;
            let event = Event { node: self.node.clone(), sequence: 1, at_ms: self.at_ms, kind };
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

    fn summary(spans: &[Span]) -> Vec<(&str, u64, u64, Option<&str>)> {
        spans.iter().map(|span| (span.name.as_str(), span.begin_ms, span.end_ms, span.failure.as_deref())).collect()
    }

    #[test]
    fn spans_of_several_processes_form_a_single_trace() {
        let mut robot = publisher("ada");
        assert_eq!(robot.publish(started()), []);
        robot.publish(began("go"));
        let first = robot.publish(done("go"));
        assert_eq!(summary(&first), [("task go", 3_000, 4_000, None)]);
        let over = robot.publish(halted(EndReason::Over));
        assert_eq!(summary(&over), [("role carrier", 2_000, 5_000, None)]);

        // Another node observed the end; it was elected after the request.
        let mut coordinator = publisher("station-1");
        let end = EventKind::Mission { mission: mission(), state: MissionState::Completed, submitted_at_ms: 500 };
        let whole = coordinator.publish(end);
        assert_eq!(summary(&whole), [("mission m-1", 500, 2_000, None)]);
        assert_eq!(whole[0].parent, None);
        assert_eq!((over[0].parent, first[0].parent), (Some(whole[0].id), Some(over[0].id)));
        let traces = [first[0].trace, over[0].trace, whole[0].trace];
        assert!(traces.iter().all(|trace| *trace == TraceId::of(Some(ClusterId(7)), &mission())));
    }

    #[test]
    fn an_aborted_task_has_failed_with_its_reason() {
        let mut robot = publisher("ada");
        robot.publish(started());
        robot.publish(began("go"));
        let signal = EventKind::Suspended { mission: mission(), role: role(), lease_left_ms: 0 };
        assert_eq!(robot.publish(signal), []);
        let spans = robot.publish(halted(EndReason::Canceled));
        let expected = [("task go", 3_000, 5_000, Some("aborted: canceled")), ("role carrier", 2_000, 5_000, None)];
        assert_eq!(summary(&spans), expected);
        assert_eq!(spans[1].events, [(4_000, "suspended: its lease was not renewed".to_owned())]);
        assert_eq!(robot.publish(halted(EndReason::Canceled)), [], "a repeated event has no effect");

        robot.publish(started());
        robot.publish(began("go"));
        let cause = "the way is closed".to_owned();
        let failed = EventKind::TaskFailed {
            mission: mission(),
            role: role(),
            task: task("go"),
            cause: cause.clone(),
            class: CauseClass::Robot,
        };
        assert_eq!(summary(&robot.publish(failed)), [("task go", 8_000, 9_000, Some("the way is closed"))]);
    }

    #[test]
    fn another_award_of_a_role_is_another_span() {
        let mut robot = publisher("ada");
        robot.publish(started());
        let first = robot.publish(halted(EndReason::Released));
        let epoch = Epoch { term: 2, index: 9 };
        robot.publish(EventKind::Started { mission: mission(), role: role(), epoch });
        let second = robot.publish(halted(EndReason::Over));
        assert_ne!(first[0].id, second[0].id);
    }

    #[test]
    fn tasks_of_people_are_below_the_mission_and_are_freed() {
        let mut host = publisher("world");
        host.publish(began("deposit"));
        let spans = host.publish(done("deposit"));
        assert_eq!(spans[0].parent, Some(root(&mission())));
        assert!(host.spans.tasks.is_empty());
    }
}
