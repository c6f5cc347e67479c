//! Describes events as text for people: shared by the demo's timeline and the logs for people.
//!
//! Two outputs differ on purpose. The timeline shows tasks in columns, lists every answer of an
//! auction, and draws progress as a bar. A node's own log (`telemetry` of the program) has the
//! fields of an event instead of a sentence, since programs sort it; its level is decided here all
//! the same.

use consort_fleet::recurrence::time_in_zone;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ledger::MissionState;
use consort_protocol::plan::{Signal, SignalKind};
use consort_text::count;
use std::fmt::Display;

/// Text of an event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EventText {
    /// Label of the kind, a word or two.
    pub label: &'static str,
    /// Description.
    pub text: String,
    /// True if the event needs attention.
    pub alarm: bool,
}

/// Describes an event.
pub fn describe_event(event: &Event) -> EventText {
    let node = &event.node;
    let normal = |label, text| EventText { label, text, alarm: false };
    let alarm = |label, text| EventText { label, text, alarm: true };
    match &event.kind {
        EventKind::Elected { term, voters } => {
            normal("elected", format!("{node} is the coordinator of term {term}; voters: {}", joined(voters)))
        }
        EventKind::SteppedDown { term } => {
            alarm("steps down", format!("{node} is no longer the coordinator (term {term})"))
        }
        EventKind::Foreign { foreign, member, .. } => {
            alarm("foreign", format!("{member} belongs to another cluster, {foreign}"))
        }
        EventKind::Voters { voters, reason } => normal("voters", format!("{reason}; voters: {}", joined(voters))),
        EventKind::Joined { ensemble, member } => normal("member", format!("{member} is a member of {ensemble}")),
        EventKind::Left { ensemble, member, reason } => {
            normal("member", format!("{member} is not a member of {ensemble}: {reason}"))
        }
        EventKind::Submitted { mission, parameters } => {
            let given: Vec<String> = parameters.iter().map(|(name, value)| format!("{name} = {value}")).collect();
            let with = if given.is_empty() { String::new() } else { format!("; {}", given.join(", ")) };
            normal("mission", format!("{mission} acknowledged{with}"))
        }
        EventKind::ScheduleChanged { schedule, change, by } => {
            normal("schedule", format!("{schedule} {} by {by}", change.as_str()))
        }
        EventKind::PriorityChanged { mission, priority } => {
            normal("priority", format!("{mission} has priority {}", priority.get()))
        }
        EventKind::RoleOrdered { mission, role, order } => {
            let order = order.as_deref().unwrap_or("without an order");
            normal("role", format!("{role} of {mission} is {order}"))
        }
        EventKind::RobotOrders { robot, orders } => normal("orders", format!("{robot} is {}", orders.state_text())),
        EventKind::AlarmChanged { raised: Some(raised), .. } => {
            alarm("alarm", format!("the fleet is {}; {}", raised.text(), raised.plan.text()))
        }
        EventKind::AlarmChanged { alarm, raised: None } => normal("alarm", format!("alarm {alarm} is cleared")),
        EventKind::ClosureChanged { part, order } => normal("closure", part.state_text(order.as_ref())),
        EventKind::ChargerLeased { charger, robot } => normal("charger", format!("{charger} is leased to {robot}")),
        EventKind::ChargerFreed { charger, robot, cause } => {
            normal("charger", format!("{charger} is no longer leased to {robot}: {cause}"))
        }
        EventKind::DeviceLeased { device, robot } => normal("device", format!("{device} is leased to {robot}")),
        EventKind::DeviceFreed { device, robot, cause } => {
            normal("device", format!("{device} is no longer leased to {robot}: {cause}"))
        }
        EventKind::OccurrenceSubmitted { schedule, due_ms, mission } => {
            normal("schedule", format!("{schedule} submitted {mission}, due {}", time_in_zone(*due_ms, "UTC")))
        }
        EventKind::BidsRequested { mission, roles, round, asked } => {
            let roles = joined(roles);
            let asked = count(*asked, "member", "members");
            normal("auction", format!("{mission}: call for bids for {roles} to {asked} (round {round})"))
        }
        EventKind::Bid { mission, bid } => {
            let (energy, left) = (bid.energy * 100.0, bid.remaining * 100.0);
            let (robot, role, time) = (&bid.robot, &bid.role, bid.time);
            normal(
                "bid",
                format!("{robot} as {role} of {mission}: {time:.1}, {energy:.1} % of its charge, {left:.1} % left"),
            )
        }
        EventKind::Closed { mission, record } => match &record.failure {
            None => {
                let chosen: Vec<String> =
                    record.chosen.iter().map(|(role, robot)| format!("{role}: {robot}")).collect();
                normal("auction", format!("{mission}: {}", chosen.join(", ")))
            }
            Some(failure) => alarm("no award", format!("{mission}: {failure}")),
        },
        EventKind::Awarded { mission, holders, promised, epoch, after_ms } => {
            let promised = promised.iter().map(|(role, robot)| format!("{role} promised to {robot}"));
            let given = holders.iter().map(|(role, robot)| format!("{role} to {robot}"));
            let given: Vec<String> = given.chain(promised).collect();
            let after = after_ms.map_or_else(String::new, |ms| format!(", {ms:.1} ms after the request"));
            normal("award", format!("{mission}: {} (epoch {epoch}){after}", given.join(", ")))
        }
        EventKind::Released { mission, role, cause } => alarm("released", format!("{role} of {mission}: {cause}")),
        EventKind::Mission { mission, state, .. } => match state {
            MissionState::Failed { cause, class } => {
                alarm("mission", format!("{mission} failed: {cause}; class {class}"))
            }
            MissionState::Canceled { by } => alarm("mission", format!("{mission} canceled by {by}")),
            MissionState::NeedsIntervention { cause, class, .. } => {
                alarm("mission", format!("{mission} needs intervention: {cause}; class {class}"))
            }
            MissionState::Pending | MissionState::Running | MissionState::Completed => {
                normal("mission", format!("{mission} is {}", state.as_str()))
            }
        },
        EventKind::Progress { mission, done, steps } => {
            normal("progress", format!("{mission}: {done} of {steps} steps"))
        }
        EventKind::Started { mission, role, epoch } => {
            normal("begins", format!("{node} as {role} of {mission} (epoch {epoch})"))
        }
        EventKind::TaskBegan { mission, role, task } => {
            normal("task begins", format!("{task}: {node} as {role} of {mission}"))
        }
        EventKind::TaskEnded { mission, role, task } => {
            normal("task done", format!("{task}: {node} as {role} of {mission}"))
        }
        EventKind::TaskSkipped { mission, role, task } => {
            normal("task skipped", format!("{task}: {node} as {role} of {mission}"))
        }
        EventKind::Escalated { mission, role, task, to } => {
            alarm("escalated", format!("{task} of {mission}: no answer as {role}; {to} is asked, too"))
        }
        EventKind::QuestionAsked { mission, role, task, message } => {
            normal("question", format!("{task} of {mission}: {role} is asked: {message}"))
        }
        EventKind::QuestionAnswered { mission, role, task } => {
            normal("question", format!("{task} of {mission}: the question to {role} is answered"))
        }
        EventKind::QuestionClosed { mission, role, task, cause } => {
            normal("question", format!("{task} of {mission}: the question to {role} is closed: {cause}"))
        }
        EventKind::TaskFailed { mission, role, task, cause, class } => {
            alarm("task failed", format!("{task}: {node} as {role} of {mission}: {cause}; class {class}"))
        }
        EventKind::Sent { signal, .. } => normal("sync", signal_text(signal)),
        EventKind::Received { signal, .. } => normal("sync", format!("{} (received)", signal_text(signal))),
        EventKind::Suspended { mission, role, lease_left_ms: 0 } => {
            alarm("suspends", format!("{node} as {role} of {mission}: its lease expired"))
        }
        EventKind::Suspended { mission, role, lease_left_ms } => {
            let left_s = *lease_left_ms as f64 / 1e3;
            let why = format!("its lease ends in {left_s:.1} s, and its goal may stop slowly");
            alarm("suspends", format!("{node} as {role} of {mission}: {why}"))
        }
        EventKind::Resumed { mission, role } => normal("resumes", format!("{node} as {role} of {mission}")),
        EventKind::Halted { mission, role, reason } => {
            normal("ends", format!("{node} as {role} of {mission}: {}", format!("{reason:?}").to_lowercase()))
        }
        EventKind::TaskRetried { role, task, attempt, cause, .. } => {
            let attempts = count(*attempt, "attempt", "attempts");
            normal("retry", format!("{task}: {node} as {role} after {attempts}: {cause}"))
        }
        EventKind::Alternative { role, task, tasks, cause, .. } => {
            normal("alternative", format!("{node} as {role}: {} instead of {task}: {cause}", joined(tasks)))
        }
        EventKind::GaveUp { mission, role, cause, .. } => {
            alarm("gives up", format!("{node} as {role} of {mission}: {cause}"))
        }
        EventKind::LowCharge { mission, role, cause } => {
            alarm("charge", format!("{node} continues as {role} of {mission} with low charge: {cause}"))
        }
        EventKind::StaleSignal { signal, epoch, known, .. } => normal(
            "sync",
            format!("{node} ignores {} of epoch {epoch}: the current epoch is {known}", signal_text(signal)),
        ),
    }
}

fn joined<T: Display>(names: &[T]) -> String {
    names.iter().map(T::to_string).collect::<Vec<_>>().join(", ")
}

fn signal_text(signal: &Signal) -> String {
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

    fn text_of(what: Value) -> (&'static str, String, bool) {
        let mut event = json!({ "node": "ada", "sequence": 1, "at_ms": 0 });
        event.as_object_mut().unwrap().extend(what.as_object().unwrap().clone());
        let EventText { label, text, alarm } = describe_event(&serde_json::from_value(event).unwrap());
        (label, text, alarm)
    }

    #[test]
    fn mission_events_contain_parameters_and_the_cause_of_the_end() {
        let submitted = json!({ "event": "submitted", "mission": "m-1", "parameters": { "room": "IC Room 6" } });
        assert_eq!(text_of(submitted), ("mission", "m-1 acknowledged; room = IC Room 6".to_owned(), false));
        let plain = json!({ "event": "submitted", "mission": "m-1", "parameters": {} });
        assert_eq!(text_of(plain), ("mission", "m-1 acknowledged".to_owned(), false));
        let state = |state: Value| {
            text_of(json!({ "event": "mission", "mission": "m-1", "state": state, "submitted_at_ms": 0 }))
        };
        assert_eq!(state(json!("completed")), ("mission", "m-1 is completed".to_owned(), false));
        assert_eq!(state(json!({ "canceled": { "by": "Nia" } })), ("mission", "m-1 canceled by Nia".to_owned(), true));
        let rescue = json!({ "needs_intervention": { "cause": "lost", "items": [], "class": "task" } });
        // An event of an earlier release has no class.
        let failed = json!({ "failed": { "cause": "lost" } });
        assert_eq!(state(failed), ("mission", "m-1 failed: lost; class robot".to_owned(), true));
        assert_eq!(state(rescue), ("mission", "m-1 needs intervention: lost; class task".to_owned(), true));
    }

    #[test]
    fn schedule_events_name_the_person_the_mission_and_the_time() {
        let paused = json!({ "event": "schedule_changed", "schedule": "rounds", "change": "paused", "by": "Nia" });
        assert_eq!(text_of(paused), ("schedule", "rounds paused by Nia".to_owned(), false));
        let submitted =
            json!({ "event": "occurrence_submitted", "schedule": "rounds", "due_ms": 60_000, "mission": "m-1" });
        let expected = "rounds submitted m-1, due 1970-01-01 00:01 UTC".to_owned();
        assert_eq!(text_of(submitted), ("schedule", expected, false));
    }

    #[test]
    fn closure_events_name_the_part_and_the_reason() {
        let order = json!({ "by": "Nia", "reason": "wet floor", "since_ms": 1, "until_ms": null });
        let closed = json!({ "event": "closure_changed", "part": { "lane": ["A", "B"] }, "order": order });
        assert_eq!(text_of(closed), ("closure", "A – B is closed by Nia: wet floor".to_owned(), false));
        let open = json!({ "event": "closure_changed", "part": { "zone": { "name": "icu", "places": ["Ward"] } }, "order": null });
        assert_eq!(text_of(open), ("closure", "zone icu is open".to_owned(), false));
    }

    #[test]
    fn an_escalation_names_the_other_role_and_is_an_alarm() {
        let escalated =
            json!({ "event": "escalated", "mission": "m-1", "role": "clerk", "task": "sign", "to": "head" });
        let expected = "sign of m-1: no answer as clerk; head is asked, too".to_owned();
        assert_eq!(text_of(escalated), ("escalated", expected, true));
    }

    #[test]
    fn a_suspension_states_whether_the_lease_has_expired() {
        let expired = json!({ "event": "suspended", "mission": "m-1", "role": "r1" });
        assert_eq!(text_of(expired), ("suspends", "ada as r1 of m-1: its lease expired".to_owned(), true));
        let early = json!({ "event": "suspended", "mission": "m-1", "role": "r1", "lease_left_ms": 1490 });
        let expected = "ada as r1 of m-1: its lease ends in 1.5 s, and its goal may stop slowly".to_owned();
        assert_eq!(text_of(early), ("suspends", expected, true));
    }

    #[test]
    fn question_events_name_the_people_and_the_cause() {
        let question = |event: &str, more: Value| {
            let mut what = json!({ "event": event, "mission": "m-1", "role": "clerk", "task": "visit" });
            what.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
            text_of(what)
        };
        let normal = |text: &str| ("question", format!("visit of m-1: {text}"), false);
        let asked = question("question_asked", json!({ "message": "may I enter?" }));
        assert_eq!(asked, normal("clerk is asked: may I enter?"));
        assert_eq!(question("question_answered", json!({})), normal("the question to clerk is answered"));
        let closed = question("question_closed", json!({ "cause": "expired" }));
        assert_eq!(closed, normal("the question to clerk is closed: expired"));
    }

    #[test]
    fn signal_events_contain_sender_receiver_and_task() {
        let signal = json!({ "kind": "done", "task": "open", "from": "r1", "to": "nurse" });
        let sent = json!({ "event": "sent", "mission": "m-1", "signal": signal });
        assert_eq!(text_of(sent), ("sync", "r1 -> nurse: open is done".to_owned(), false));
        let heard = json!({ "event": "received", "mission": "m-1", "signal": signal });
        assert_eq!(text_of(heard).1, "r1 -> nurse: open is done (received)");
    }
}
