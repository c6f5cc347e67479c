//! What happens, in words for people: the demo's timeline and every log that people read say the same of it.
//!
//! Two ways of telling are not these words, on purpose. The timeline lays out in columns what it tells of tasks, lists every answer
//! of an auction, and draws progress as a bar. A node's own log ([`telemetry`](crate::telemetry)) has the fields of an event and
//! not a sentence, since programs sort it; how loud it is of something is decided here all the same.

use consort_protocol::count::count;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ledger::MissionState;
use consort_protocol::plan::{Signal, SignalKind};
use std::fmt::Display;

/// An event for people.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EventText {
    /// What kind of thing it is, in a word or two.
    pub label: &'static str,
    /// What happened.
    pub text: String,
    /// Whether somebody should look at it.
    pub alarm: bool,
}

/// An event in words.
pub fn describe_event(event: &Event) -> EventText {
    let node = &event.node;
    let calm = |word, text| EventText { label: word, text, alarm: false };
    let alarm = |word, text| EventText { label: word, text, alarm: true };
    match &event.kind {
        EventKind::Elected { term, voters } => {
            calm("elected", format!("{node} coordinates in term {term}; the ledger is kept by {}", joined(voters)))
        }
        EventKind::SteppedDown { term } => alarm("steps down", format!("{node} no longer coordinates (term {term})")),
        EventKind::Foreign { foreign, member, .. } => {
            alarm("foreign", format!("{member} belongs to cluster {foreign}, which was founded apart"))
        }
        EventKind::Voters { voters, reason } => {
            calm("voters", format!("{reason}; the ledger is kept by {}", joined(voters)))
        }
        EventKind::Joined { ensemble, member } => calm("member", format!("{member} is a member of {ensemble}")),
        EventKind::Left { ensemble, member, reason } => {
            calm("member", format!("{member} is no member of {ensemble}: {reason}"))
        }
        EventKind::Submitted { mission, parameters } => {
            let given: Vec<String> = parameters.iter().map(|(name, value)| format!("{name} = {value}")).collect();
            let with = if given.is_empty() { String::new() } else { format!("; {}", given.join(", ")) };
            calm("mission", format!("{mission} acknowledged{with}"))
        }
        EventKind::Called { mission, roles, round, asked } => {
            let roles = joined(roles);
            let asked = count(*asked, "member", "members");
            calm("auction", format!("{mission}: bids for {roles} asked of {asked} (round {round})"))
        }
        EventKind::Bid { mission, bid } => {
            let (energy, left) = (bid.energy * 100.0, bid.remaining * 100.0);
            let (robot, role, time) = (&bid.robot, &bid.role, bid.time);
            calm(
                "bid",
                format!("{robot} as {role} of {mission}: {time:.1}, {energy:.1} % of its charge, {left:.1} % left"),
            )
        }
        EventKind::Closed { mission, record } => match &record.failure {
            None => {
                let chosen: Vec<String> =
                    record.chosen.iter().map(|(role, robot)| format!("{role}: {robot}")).collect();
                calm("auction", format!("{mission}: {}", chosen.join(", ")))
            }
            Some(failure) => alarm("no award", format!("{mission}: {failure}")),
        },
        EventKind::Awarded { mission, holders, epoch, after_ms } => {
            let given: Vec<String> = holders.iter().map(|(role, robot)| format!("{role} to {robot}")).collect();
            let after = after_ms.map_or_else(String::new, |ms| format!(", {ms:.1} ms after the request"));
            calm("award", format!("{mission}: {} (epoch {epoch}){after}", given.join(", ")))
        }
        EventKind::Released { mission, role, cause } => alarm("released", format!("{role} of {mission}: {cause}")),
        EventKind::Mission { mission, state, .. } => match state {
            MissionState::Failed { cause } => alarm("mission", format!("{mission} failed: {cause}")),
            MissionState::Canceled { by } => alarm("mission", format!("{mission} canceled by {by}")),
            MissionState::NeedsRescue { cause, .. } => alarm("mission", format!("{mission} needs rescue: {cause}")),
            MissionState::Pending | MissionState::Running | MissionState::Completed => {
                calm("mission", format!("{mission} is {}", state.as_str()))
            }
        },
        EventKind::Progress { mission, done, steps } => calm("progress", format!("{mission}: {done} of {steps} steps")),
        EventKind::Started { mission, role, epoch } => {
            calm("begins", format!("{node} as {role} of {mission} (epoch {epoch})"))
        }
        EventKind::TaskBegan { mission, role, task } => {
            calm("task begins", format!("{task}: {node} as {role} of {mission}"))
        }
        EventKind::TaskEnded { mission, role, task } => {
            calm("task done", format!("{task}: {node} as {role} of {mission}"))
        }
        EventKind::TaskFailed { mission, role, task, cause } => {
            alarm("task failed", format!("{task}: {node} as {role} of {mission}: {cause}"))
        }
        EventKind::Sent { signal, .. } => calm("sync", said(signal)),
        EventKind::Heard { signal, .. } => calm("sync", format!("{} (heard)", said(signal))),
        EventKind::Suspended { mission, role } => {
            alarm("suspends", format!("{node} as {role} of {mission}: its lease ran out"))
        }
        EventKind::Resumed { mission, role } => calm("resumes", format!("{node} as {role} of {mission}")),
        EventKind::Halted { mission, role, reason } => {
            calm("ends", format!("{node} as {role} of {mission}: {}", format!("{reason:?}").to_lowercase()))
        }
        EventKind::TaskRetried { role, task, attempt, cause, .. } => {
            let attempts = count(*attempt, "attempt", "attempts");
            calm("task again", format!("{task}: {node} as {role} after {attempts}: {cause}"))
        }
        EventKind::Alternative { role, task, tasks, cause, .. } => {
            calm("another way", format!("{node} as {role}: {} instead of {task}: {cause}", joined(tasks)))
        }
        EventKind::GaveUp { mission, role, cause, .. } => {
            alarm("gives up", format!("{node} as {role} of {mission}: {cause}"))
        }
        EventKind::ChargeShort { mission, role, cause } => {
            alarm("charge", format!("{node} goes on as {role} of {mission} all the same: {cause}"))
        }
        EventKind::Outdated { signal, epoch, known, .. } => {
            calm("sync", format!("{node} does not listen to {} of epoch {epoch}: now it is {known}", said(signal)))
        }
    }
}

fn joined<T: Display>(names: &[T]) -> String {
    names.iter().map(T::to_string).collect::<Vec<_>>().join(", ")
}

fn said(signal: &Signal) -> String {
    let Signal { kind, task, from, to } = signal;
    match kind {
        SignalKind::Done => format!("{from} -> {to}: {task} is done"),
        SignalKind::Ready => format!("{from} -> {to}: ready for {task}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn told(what: Value) -> (&'static str, String, bool) {
        let mut event = json!({ "node": "ada", "sequence": 1, "at_ms": 0 });
        event.as_object_mut().unwrap().extend(what.as_object().unwrap().clone());
        let EventText { label: word, text, alarm } = describe_event(&serde_json::from_value(event).unwrap());
        (word, text, alarm)
    }

    #[test]
    fn a_mission_is_told_with_what_it_was_given_and_why_it_ended() {
        let submitted = json!({ "event": "submitted", "mission": "m-1", "parameters": { "room": "IC Room 6" } });
        assert_eq!(told(submitted), ("mission", "m-1 acknowledged; room = IC Room 6".to_owned(), false));
        let plain = json!({ "event": "submitted", "mission": "m-1", "parameters": {} });
        assert_eq!(told(plain), ("mission", "m-1 acknowledged".to_owned(), false));
        let state =
            |state: Value| told(json!({ "event": "mission", "mission": "m-1", "state": state, "submitted_at_ms": 0 }));
        assert_eq!(state(json!("completed")), ("mission", "m-1 is completed".to_owned(), false));
        assert_eq!(state(json!({ "canceled": { "by": "Nia" } })), ("mission", "m-1 canceled by Nia".to_owned(), true));
        let rescue = json!({ "needs_rescue": { "cause": "lost", "items": [] } });
        assert_eq!(state(rescue), ("mission", "m-1 needs rescue: lost".to_owned(), true));
    }

    #[test]
    fn who_said_what_to_whom_is_told_of_signals() {
        let signal = json!({ "kind": "done", "task": "open", "from": "r1", "to": "nurse" });
        let sent = json!({ "event": "sent", "mission": "m-1", "signal": signal });
        assert_eq!(told(sent), ("sync", "r1 -> nurse: open is done".to_owned(), false));
        let heard = json!({ "event": "heard", "mission": "m-1", "signal": signal });
        assert_eq!(told(heard).1, "r1 -> nurse: open is done (heard)");
    }
}
