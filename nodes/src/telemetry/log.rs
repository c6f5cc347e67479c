//! The log of a node's own doings: what it tells on the event stream, each line within the span of its mission, with the
//! mission's trace id, so that the lines of many nodes can be put together.

use super::ClusterCell;
use super::ids::TraceId;
use crate::event_text::describe_event;
use consort_actors::observe::Observer;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::NodeId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Command;
use serde_json::Value;
use tracing::{Level, debug, info, info_span, warn};

/// By which these lines are chosen in a filter, as `consort::told=debug`.
const TARGET: &str = "consort::told";

/// Writes what a node tells to its log.
pub struct EventLogger(pub(super) ClusterCell);

impl Observer for EventLogger {
    fn on_event(&self, event: &Event) {
        let write = || {
            let what = &event.kind;
            match level(event) {
                Level::WARN => warn!(target: TARGET, event = what.as_str(), "{}", fields(what)),
                Level::INFO => info!(target: TARGET, event = what.as_str(), "{}", fields(what)),
                _ => debug!(target: TARGET, event = what.as_str(), "{}", fields(what)),
            }
        };
        match event.kind.mission() {
            Some(mission) => {
                let trace = TraceId::of(self.0.cluster(), mission);
                info_span!(target: TARGET, "mission", id = %mission, %trace).in_scope(write);
            }
            None => write(),
        }
    }

    fn on_applied(&self, _: &NodeId, _: Epoch, _: &[Command]) {}
}

/// What is told but for the kind and the mission, which the line has already: `role="carrier" task="go"`.
fn fields(what: &EventKind) -> String {
    let Ok(Value::Object(all)) = serde_json::to_value(what) else { return String::new() };
    let said = |key: &str| matches!(key, "event" | "mission");
    let fields = all.iter().filter(|(key, _)| !said(key)).map(|(key, value)| format!("{key}={value}"));
    fields.collect::<Vec<_>>().join(" ")
}

/// Few lines a mission for whoever only looks whether all is well; troubles stand out; the rest is there if asked for.
fn level(event: &Event) -> Level {
    match &event.kind {
        EventKind::Joined { .. }
        | EventKind::Left { .. }
        | EventKind::Called { .. }
        | EventKind::Bid { .. }
        // Whoever waits for robots has one of these after the other.
        | EventKind::Closed { .. }
        | EventKind::Progress { .. }
        | EventKind::TaskBegan { .. }
        | EventKind::TaskEnded { .. }
        | EventKind::Sent { .. }
        | EventKind::Heard { .. }
        | EventKind::Outdated { .. } => Level::DEBUG,
        EventKind::Elected { .. }
        | EventKind::SteppedDown { .. }
        | EventKind::Foreign { .. }
        | EventKind::Voters { .. }
        | EventKind::Submitted { .. }
        | EventKind::Awarded { .. }
        | EventKind::Released { .. }
        | EventKind::Mission { .. }
        | EventKind::Started { .. }
        | EventKind::Suspended { .. }
        | EventKind::Resumed { .. }
        | EventKind::Halted { .. }
        | EventKind::TaskFailed { .. }
        | EventKind::TaskRetried { .. }
        | EventKind::Alternative { .. }
        | EventKind::GaveUp { .. }
        | EventKind::ChargeShort { .. } => if describe_event(event).alarm { Level::WARN } else { Level::INFO },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ledger::MissionState;

    #[test]
    fn a_line_has_what_its_kind_and_its_span_do_not_say() {
        let mission = "lab-samples-1".parse().unwrap();
        let (role, task) = ("r1".parse().unwrap(), "go".parse().unwrap());
        let what = EventKind::TaskFailed { mission, role, task, cause: "the door is \"shut\"".to_owned() };
        assert_eq!(fields(&what), r#"cause="the door is \"shut\"" role="r1" task="go""#);
        let told = |what| level(&Event { node: "ada".parse().unwrap(), sequence: 1, at_ms: 0, kind: what });
        assert_eq!(told(what), Level::WARN);
        let state = |state| EventKind::Mission { mission: "m-1".parse().unwrap(), state, submitted_at_ms: 0 };
        assert_eq!(told(state(MissionState::Completed)), Level::INFO);
        assert_eq!(told(state(MissionState::Failed { cause: "no robots".to_owned() })), Level::WARN);
    }
}
