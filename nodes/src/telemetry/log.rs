//! The log of a node's own doings: what it tells on the event stream, each line within the span of its mission, with the
//! mission's trace id, so that the lines of many nodes can be put together.

use super::Membership;
use super::ids::TraceId;
use crate::words::words;
use consort_actors::observe::Observer;
use consort_protocol::event::{Event, Happening};
use consort_protocol::ids::NodeId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Command;
use serde_json::Value;
use tracing::{Level, debug, info, info_span, warn};

/// By which these lines are chosen in a filter, as `consort::told=debug`.
const TARGET: &str = "consort::told";

/// Writes what a node tells to its log.
pub struct Log(pub(super) Membership);

impl Observer for Log {
    fn told(&self, event: &Event) {
        let write = || {
            let what = &event.what;
            match level(event) {
                Level::WARN => warn!(target: TARGET, event = what.word(), "{}", fields(what)),
                Level::INFO => info!(target: TARGET, event = what.word(), "{}", fields(what)),
                _ => debug!(target: TARGET, event = what.word(), "{}", fields(what)),
            }
        };
        match event.what.mission() {
            Some(mission) => {
                let trace = TraceId::of(self.0.cluster(), mission);
                info_span!(target: TARGET, "mission", id = %mission, %trace).in_scope(write);
            }
            None => write(),
        }
    }

    fn applied(&self, _: &NodeId, _: Epoch, _: &[Command]) {}
}

/// What is told but for the kind and the mission, which the line has already: `role="carrier" task="go"`.
fn fields(what: &Happening) -> String {
    let Ok(Value::Object(all)) = serde_json::to_value(what) else { return String::new() };
    let said = |key: &str| matches!(key, "event" | "mission");
    let fields = all.iter().filter(|(key, _)| !said(key)).map(|(key, value)| format!("{key}={value}"));
    fields.collect::<Vec<_>>().join(" ")
}

/// Few lines a mission for whoever only looks whether all is well; troubles stand out; the rest is there if asked for.
fn level(event: &Event) -> Level {
    match &event.what {
        Happening::Joined { .. }
        | Happening::Left { .. }
        | Happening::Called { .. }
        | Happening::Bid { .. }
        // Whoever waits for robots has one of these after the other.
        | Happening::Closed { .. }
        | Happening::Progress { .. }
        | Happening::TaskBegan { .. }
        | Happening::TaskEnded { .. }
        | Happening::Sent { .. }
        | Happening::Heard { .. }
        | Happening::Outdated { .. } => Level::DEBUG,
        Happening::Elected { .. }
        | Happening::SteppedDown { .. }
        | Happening::Foreign { .. }
        | Happening::Voters { .. }
        | Happening::Submitted { .. }
        | Happening::Awarded { .. }
        | Happening::Released { .. }
        | Happening::Mission { .. }
        | Happening::Started { .. }
        | Happening::Suspended { .. }
        | Happening::Resumed { .. }
        | Happening::Halted { .. }
        | Happening::TaskFailed { .. }
        | Happening::TaskRetried { .. }
        | Happening::Alternative { .. }
        | Happening::GaveUp { .. }
        | Happening::ChargeShort { .. } => if words(event).alarm { Level::WARN } else { Level::INFO },
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
        let what = Happening::TaskFailed { mission, role, task, cause: "the door is \"shut\"".to_owned() };
        assert_eq!(fields(&what), r#"cause="the door is \"shut\"" role="r1" task="go""#);
        let told = |what| level(&Event { node: "ada".parse().unwrap(), sequence: 1, at_ms: 0, what });
        assert_eq!(told(what), Level::WARN);
        let state = |state| Happening::Mission { mission: "m-1".parse().unwrap(), state, submitted_at_ms: 0 };
        assert_eq!(told(state(MissionState::Completed)), Level::INFO);
        assert_eq!(told(state(MissionState::Failed { cause: "no robots".to_owned() })), Level::WARN);
    }
}
