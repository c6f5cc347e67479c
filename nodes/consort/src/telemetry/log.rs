//! The log of a node's own events: each line within the span of its mission, with the mission's
//! trace id, so that the lines of many nodes can be joined.

use super::ClusterCell;
use super::ids::TraceId;
use consort_dashboard::event_text::describe_event;
use consort_fleet::observe::Observer;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::NodeId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Command;
use serde_json::Value;
use tracing::{Level, debug, info, info_span, warn};

/// Target for log filters, as in `consort::events=debug`.
const TARGET: &str = "consort::events";

/// Writes a node's events to its log.
pub(crate) struct EventLogger(pub(super) ClusterCell);

impl Observer for EventLogger {
    fn on_event(&self, event: &Event) {
        let write = || {
            let kind = &event.kind;
            match level(event) {
                Level::WARN => warn!(target: TARGET, event = kind.as_str(), "{}", fields(kind)),
                Level::INFO => info!(target: TARGET, event = kind.as_str(), "{}", fields(kind)),
                _ => debug!(target: TARGET, event = kind.as_str(), "{}", fields(kind)),
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

/// Formats the fields except the kind and the mission, which the line has already:
/// `role="carrier" task="go"`.
fn fields(kind: &EventKind) -> String {
    let Ok(Value::Object(all)) = serde_json::to_value(kind) else { return String::new() };
    let is_in_line = |key: &str| matches!(key, "event" | "mission");
    let fields = all.iter().filter(|(key, _)| !is_in_line(key)).map(|(key, value)| format!("{key}={value}"));
    fields.collect::<Vec<_>>().join(" ")
}

/// Returns the level of an event: few lines per mission at info, warnings for problems, the rest at
/// debug.
fn level(event: &Event) -> Level {
    match &event.kind {
        EventKind::Joined { .. }
        | EventKind::Left { .. }
        | EventKind::BidsRequested { .. }
        | EventKind::Bid { .. }
        // A mission that waits for robots has many of these.
        | EventKind::Closed { .. }
        | EventKind::Progress { .. }
        | EventKind::TaskBegan { .. }
        | EventKind::TaskEnded { .. }
        | EventKind::TaskSkipped { .. }
        | EventKind::ChargerLeased { .. }
        | EventKind::ChargerFreed { .. }
        | EventKind::DeviceLeased { .. }
        | EventKind::DeviceFreed { .. }
        | EventKind::Sent { .. }
        | EventKind::Received { .. }
        | EventKind::StaleSignal { .. } => Level::DEBUG,
        EventKind::Elected { .. }
        | EventKind::SteppedDown { .. }
        | EventKind::Foreign { .. }
        | EventKind::Voters { .. }
        | EventKind::Submitted { .. }
        | EventKind::ScheduleChanged { .. }
        | EventKind::PriorityChanged { .. }
        | EventKind::RoleOrdered { .. }
        | EventKind::RobotOrders { .. }
        | EventKind::AlarmChanged { .. }
        | EventKind::ClosureChanged { .. }
        | EventKind::OccurrenceSubmitted { .. }
        | EventKind::Awarded { .. }
        | EventKind::Released { .. }
        | EventKind::Mission { .. }
        | EventKind::Started { .. }
        | EventKind::Suspended { .. }
        | EventKind::Resumed { .. }
        | EventKind::Halted { .. }
        | EventKind::Escalated { .. }
        | EventKind::QuestionAsked { .. }
        | EventKind::QuestionAnswered { .. }
        | EventKind::QuestionClosed { .. }
        | EventKind::TaskFailed { .. }
        | EventKind::TaskRetried { .. }
        | EventKind::Alternative { .. }
        | EventKind::GaveUp { .. }
        | EventKind::LowCharge { .. } => if describe_event(event).alarm { Level::WARN } else { Level::INFO },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::cause::CauseClass;
    use consort_protocol::ledger::MissionState;

    #[test]
    fn a_log_line_repeats_neither_the_kind_nor_the_span() {
        let mission = "lab-samples-1".parse().unwrap();
        let (role, task) = ("r1".parse().unwrap(), "go".parse().unwrap());
        let kind = EventKind::TaskFailed {
            mission,
            role,
            task,
            class: CauseClass::Robot,
            cause: "the door is \"shut\"".to_owned(),
        };
        assert_eq!(fields(&kind), r#"cause="the door is \"shut\"" class="robot" role="r1" task="go""#);
        let level_of = |kind| level(&Event { node: "ada".parse().unwrap(), sequence: 1, at_ms: 0, kind });
        assert_eq!(level_of(kind), Level::WARN);
        let state = |state| EventKind::Mission { mission: "m-1".parse().unwrap(), state, submitted_at_ms: 0 };
        assert_eq!(level_of(state(MissionState::Completed)), Level::INFO);
        let failed = MissionState::Failed { cause: "no robots".to_owned(), class: CauseClass::Robot };
        assert_eq!(level_of(state(failed)), Level::WARN);
    }
}
