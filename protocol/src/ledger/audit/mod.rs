//! Recording of the requests of people in the audit trail.
//!
//! The entry is made by the command that makes the change, so no change is without its entry: a cancelation of several
//! missions makes an entry for each. A command that changes nothing, such as a repeated request, makes none.

use super::alarm::{Alarm, AlarmChange};
use super::apply::Ledger;
use super::audit_trail::{AuditAction, AuditEntry};
use super::closure::{Closure, ClosureChange};
use super::command::{Command, CommandOutcome};
use super::entry::{MissionEntry, MissionState};
use super::map_part::MapPart;
use super::mission_order::{MissionChange, RoleOrder};
use super::person_request::{AnswerContent, PersonAnswer, PersonRequestEntry, PersonRequestId};
use super::robot_order::{OrderChange, OrderRequest, RobotOrders};
use super::schedule::SchedulePause;
use super::speed_limit::{SpeedLimit, SpeedLimitChange};
use super::submission::Priority;
use crate::ids::{AlarmId, MissionId, RobotId, RoleId, ScheduleId};
use std::collections::{BTreeMap, BTreeSet};

/// Request of a person that is about to be executed.
pub(super) struct AuditedRequest {
    entry: AuditEntry,
    subject: Subject,
    before: SubjectState,
}

/// What a request changes.
enum Subject {
    /// A mission that the request creates.
    NewMission,
    Mission(MissionId),
    MissionTerms(MissionId),
    PersonRequest(PersonRequestId),
    Schedule(ScheduleId),
    Orders,
    WireVersion,
}

/// State of what a request changes, to detect a change.
#[derive(PartialEq)]
enum SubjectState {
    NewMission,
    Mission(Option<MissionState>),
    MissionTerms(Option<(Priority, BTreeMap<RoleId, RoleOrder>)>),
    PersonRequest(Option<Box<PersonRequestEntry>>),
    Schedule {
        exists: bool,
        pause: Option<SchedulePause>,
    },
    /// The orders, not the position of their latest change: an entry of the log may contain two orders.
    Orders {
        robots: BTreeMap<RobotId, RobotOrders>,
        closures: Vec<Closure>,
        speed_limits: Vec<SpeedLimit>,
        alarms: Vec<Alarm>,
    },
    WireVersion(Option<u8>),
}

impl Ledger {
    /// Returns the latest requests of people that have changed the ledger, in their order.
    pub fn audit_trail(&self) -> impl Iterator<Item = &AuditEntry> {
        self.trail().entries()
    }

    /// Returns the request of a person that a command executes, for [`record_request`](Self::record_request).
    pub(super) fn audited_request(&self, command: &Command) -> Option<AuditedRequest> {
        let (subject, entry) = request_of(command)?;
        let before = self.subject_state(&subject);
        Some(AuditedRequest { entry, subject, before })
    }

    /// Adds an executed request to the audit trail, if it has changed anything.
    pub(super) fn record_request(&mut self, request: AuditedRequest, outcome: &CommandOutcome) {
        let AuditedRequest { mut entry, subject, before } = request;
        match outcome {
            CommandOutcome::Submitted { mission, again: false } => entry.subject = mission.to_string(),
            _ if self.subject_state(&subject) == before => return,
            _ => {}
        }
        // The version that introduces the trail is its first entry.
        if self.keeps_history() {
            self.trail_mut().push(entry);
        }
    }

    fn subject_state(&self, subject: &Subject) -> SubjectState {
        match subject {
            Subject::NewMission => SubjectState::NewMission,
            Subject::Mission(mission) => SubjectState::Mission(self.mission_state(mission).cloned()),
            Subject::MissionTerms(mission) => {
                let terms = |entry: &MissionEntry| (entry.submission.priority, entry.role_orders().clone());
                SubjectState::MissionTerms(self.mission(mission).map(terms))
            }
            Subject::PersonRequest(request) => {
                let entry = self.mission(&request.mission);
                let entry = entry.and_then(|entry| entry.person_request(request.number));
                SubjectState::PersonRequest(entry.cloned().map(Box::new))
            }
            Subject::Schedule(id) => {
                let entry = self.schedule(id);
                let pause = entry.and_then(|entry| entry.pause.clone());
                SubjectState::Schedule { exists: entry.is_some(), pause }
            }
            Subject::Orders => {
                let orders = self.robot_orders().map(|(robot, orders)| (robot.clone(), orders.clone()));
                SubjectState::Orders {
                    robots: orders.collect(),
                    closures: self.closures().collect(),
                    speed_limits: self.speed_limits().collect(),
                    alarms: self.alarms().cloned().collect(),
                }
            }
            Subject::WireVersion => SubjectState::WireVersion(self.wire()),
        }
    }
}

/// Returns what the request of a person changes, and its entry; `None` for a command that no person requests.
fn request_of(command: &Command) -> Option<(Subject, AuditEntry)> {
    let entry = |action, by: &str, at_ms, subject: String, details: String| AuditEntry {
        number: 0,
        at_ms,
        by: by.to_owned(),
        action,
        subject,
        details,
    };
    let plain = |action, by: &str, at_ms, subject: String| entry(action, by, at_ms, subject, String::new());
    let of_schedule = |action, by: &str, at_ms, id: &ScheduleId| {
        Some((Subject::Schedule(id.clone()), plain(action, by, at_ms, id.to_string())))
    };
    match command {
        Command::Submit(submission) => {
            // The outcome names the mission.
            let entry = plain(AuditAction::Submit, &submission.by, submission.at_ms, String::new());
            Some((Subject::NewMission, entry))
        }
        Command::Cancel { mission, by, at_ms, .. } => {
            let entry = plain(AuditAction::Cancel, by, *at_ms, mission.to_string());
            Some((Subject::Mission(mission.clone()), entry))
        }
        Command::Resolve { mission, by, at_ms } => {
            let entry = plain(AuditAction::Resolve, by, *at_ms, mission.to_string());
            Some((Subject::Mission(mission.clone()), entry))
        }
        Command::ChangeMission { mission, order: OrderRequest { change, by, at_ms, .. } } => {
            let (action, details) = match change {
                MissionChange::SetPriority(priority) => (AuditAction::SetPriority, priority.get().to_string()),
                MissionChange::Reassign { role, to, .. } => (AuditAction::Reassign, role_text(role, to.as_ref())),
                MissionChange::Pin { role, robot: Some(robot) } => (AuditAction::Pin, role_text(role, Some(robot))),
                MissionChange::Pin { role, robot: None } => (AuditAction::Unpin, role.to_string()),
            };
            Some((Subject::MissionTerms(mission.clone()), entry(action, by, *at_ms, mission.to_string(), details)))
        }
        Command::AnswerPerson { request, answer, .. } => {
            let PersonAnswer { by, at_ms, .. } = answer;
            let entry = entry(AuditAction::Answer, by, *at_ms, request.to_string(), answer_text(answer));
            Some((Subject::PersonRequest(request.clone()), entry))
        }
        Command::AddSchedule { schedule, from_ms } => {
            of_schedule(AuditAction::AddSchedule, &schedule.submission.by, *from_ms, &schedule.id)
        }
        Command::PauseSchedule { schedule, pause } => {
            of_schedule(AuditAction::PauseSchedule, &pause.by, pause.since_ms, schedule)
        }
        Command::ResumeSchedule { schedule, at_ms, by } => {
            of_schedule(AuditAction::ResumeSchedule, by, *at_ms, schedule)
        }
        Command::RemoveSchedule { schedule, by, at_ms } => {
            of_schedule(AuditAction::RemoveSchedule, by, *at_ms, schedule)
        }
        Command::OrderRobots { robots, order: OrderRequest { change, by, at_ms, .. } } => {
            let names = robots.iter().map(RobotId::as_str).collect::<Vec<_>>().join(", ");
            let (action, details) = match change {
                OrderChange::Hold { until_ms, reason } => {
                    (AuditAction::Hold, period_and_reason(Some(*until_ms), *at_ms, reason))
                }
                OrderChange::Release => (AuditAction::Release, String::new()),
                OrderChange::Maintain { until_ms, reason } => {
                    (AuditAction::BeginMaintenance, period_and_reason(*until_ms, *at_ms, reason))
                }
                OrderChange::EndMaintenance => (AuditAction::EndMaintenance, String::new()),
            };
            Some((Subject::Orders, entry(action, by, *at_ms, names, details)))
        }
        Command::ChangeClosures { parts, order: OrderRequest { change, by, at_ms, .. } } => {
            let (action, details) = match change {
                ClosureChange::Close { until_ms, reason } => {
                    (AuditAction::Close, period_and_reason(*until_ms, *at_ms, reason))
                }
                ClosureChange::Open => (AuditAction::Open, String::new()),
            };
            Some((Subject::Orders, entry(action, by, *at_ms, part_names(parts), details)))
        }
        Command::ChangeSpeedLimits { parts, order: OrderRequest { change, by, at_ms, .. } } => {
            let (action, details) = match change {
                SpeedLimitChange::Set { speed, until_ms, reason } => {
                    let terms = period_and_reason(*until_ms, *at_ms, reason);
                    (AuditAction::LimitSpeed, with_reason(format!("{} m/s", speed.get()), &terms))
                }
                SpeedLimitChange::Clear => (AuditAction::ClearSpeedLimit, String::new()),
            };
            Some((Subject::Orders, entry(action, by, *at_ms, part_names(parts), details)))
        }
        Command::ChangeAlarms { order: OrderRequest { change, by, at_ms, .. } } => {
            let entry = match change {
                AlarmChange::Raise { alarm, reason, .. } => {
                    entry(AuditAction::RaiseAlarm, by, *at_ms, alarm.to_string(), reason.clone())
                }
                AlarmChange::Clear { alarm } => {
                    let name = alarm.as_ref().map_or("all", AlarmId::as_str);
                    plain(AuditAction::ClearAlarm, by, *at_ms, name.to_owned())
                }
            };
            Some((Subject::Orders, entry))
        }
        Command::RaiseWireVersion { wire, by, at_ms } => {
            let entry = plain(AuditAction::RaiseWireVersion, by, *at_ms, format!("wire version {wire}"));
            (!by.is_empty()).then_some((Subject::WireVersion, entry))
        }
        Command::Bootstrap { .. }
        | Command::Award { .. }
        | Command::AwardPromised { .. }
        | Command::Postpone { .. }
        | Command::MovePromise(_)
        | Command::Defer { .. }
        | Command::Accept { .. }
        | Command::Progress { .. }
        | Command::Release { .. }
        | Command::Fail { .. }
        | Command::AskPerson { .. }
        | Command::SetQuestion { .. }
        | Command::EscalatePersonRequest { .. }
        | Command::ExpirePersonRequest { .. }
        | Command::SubmitOccurrence { .. }
        | Command::SkipOccurrences { .. }
        | Command::ExpireOrders { .. }
        | Command::EndOrders { .. }
        | Command::CancelMissions { .. }
        | Command::LeaseResource { .. }
        | Command::FreeResource { .. }
        | Command::SetHistoryLimits(_) => None,
    }
}

fn part_names(parts: &BTreeSet<MapPart>) -> String {
    parts.iter().map(MapPart::to_string).collect::<Vec<_>>().join(", ")
}

/// Formats a role and the robot that should get it: `r1 to amber`.
fn role_text(role: &RoleId, to: Option<&RobotId>) -> String {
    to.map_or_else(|| role.to_string(), |robot| format!("{role} to {robot}"))
}

/// Formats an answer: `declined: no time`.
fn answer_text(PersonAnswer { content, note, .. }: &PersonAnswer) -> String {
    let word = match content {
        AnswerContent::Done(_) => "done",
        AnswerContent::Declined => "declined",
        AnswerContent::Cannot => "cannot",
        AnswerContent::Later(_) => "later",
    };
    with_reason(word.to_owned(), note)
}

/// Formats the period and the reason of an order: `for 60 s: a spill`. An order without an end has no period.
fn period_and_reason(until_ms: Option<u64>, at_ms: u64, reason: &str) -> String {
    let Some(until_ms) = until_ms else { return reason.to_owned() };
    with_reason(format!("for {} s", until_ms.saturating_sub(at_ms) / 1000), reason)
}

fn with_reason(text: String, reason: &str) -> String {
    if reason.is_empty() { text } else { format!("{text}: {reason}") }
}

#[cfg(test)]
mod tests;
