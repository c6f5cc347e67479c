//! Validation of a request to submit a mission, up to the command for the ledger.

use super::rate_limit::RequestLimits;
use crate::recurrence::{Recurrence, RecurrenceError};
use consort_protocol::api::{MissionSource, RequestError, ScheduleRequest, StartTime, SubmitRequest};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::{NameError, RequestId, TaskType};
use consort_protocol::ledger::{
    DeadlineError, Priority, PriorityError, RecoveryBranch, Schedule, ScheduleRule, Submission, TIME_AHEAD_MAX,
    time_until_deadline,
};
use consort_protocol::mission::{
    Domain, Format, Mission, MissionDocument, MissionErrors, MissionFileError, RoleKind, ValueKind,
};
use consort_protocol::plan::{DivisionError, divide_and_check};
use consort_skills::missions::{NamedMissionError, NamedMissions};
use std::collections::BTreeMap;
use std::time::Duration;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Reason for which a request to submit a mission is rejected.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SubmitError {
    /// The payload is not a request.
    #[error(transparent)]
    Request(#[from] RequestError),
    /// The name of the mission is unknown, or a field would change the mission.
    #[error(transparent)]
    Named(#[from] NamedMissionError),
    /// The file of the mission is invalid.
    #[error(transparent)]
    File(#[from] MissionFileError),
    /// The JSON of the mission cannot be written as text.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// Parameters or tasks do not match the domain.
    #[error(transparent)]
    Mission(#[from] MissionErrors),
    /// The mission cannot be divided among its roles.
    #[error(transparent)]
    Division(#[from] DivisionError),
    /// The recovery of the mission cannot be divided.
    #[error("recovery: {0}")]
    Recovery(DivisionError),
    /// The priority is outside its range.
    #[error(transparent)]
    Priority(#[from] PriorityError),
    /// The deadline is outside its range.
    #[error("deadline_s is {seconds}; {error}")]
    Deadline {
        /// Requested time until the deadline.
        seconds: f64,
        /// Allowed range.
        error: DeadlineError,
    },
    /// The earliest start is invalid.
    #[error("not_before is {given}; {allowed}", allowed = NOT_BEFORE_ALLOWED)]
    NotBefore {
        /// The time as given.
        given: String,
    },
    /// The mission would be late before it may start.
    #[error("deadline_s is {deadline_s}, but not_before is {starts_s:.0} s from now")]
    DeadlineBeforeStart {
        /// Requested time until the deadline.
        deadline_s: f64,
        /// Time until the earliest start.
        starts_s: f64,
    },
    /// The generated id of the request is invalid.
    #[error(transparent)]
    RequestId(#[from] NameError),
    /// The divided mission exceeds the size limit.
    #[error("the mission takes {bytes} bytes; the limit is {max}", max = Submission::BYTES_MAX)]
    TooLarge {
        /// Encoded size.
        bytes: usize,
    },
    /// The divided mission exceeds the size limit of a message.
    #[error("the mission is too large: {0}")]
    Encoding(#[from] CodecError),
}

/// Reason for which a schedule is rejected.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ScheduleError {
    /// The name is too long.
    #[error("the name of the schedule has {chars} characters; at most {max} are allowed", max = Schedule::ID_CHARS_MAX)]
    Name {
        /// Number of characters.
        chars: usize,
    },
    /// A field is missing.
    #[error("`{field}` is missing; {meaning}")]
    Missing {
        /// The field.
        field: &'static str,
        /// Its meaning.
        meaning: &'static str,
    },
    /// A field of the mission belongs to the occurrences.
    #[error("`{field}` of `submit` is not allowed in a schedule: each occurrence has its own")]
    OfOccurrence {
        /// The field.
        field: &'static str,
    },
    /// The end is not a time.
    #[error("until is {given:?}; allowed is a date and time in RFC 3339, such as 2026-12-31T18:00:00+01:00")]
    Until {
        /// The time as given.
        given: String,
    },
    /// The times are invalid.
    #[error(transparent)]
    Times(#[from] RecurrenceError),
    /// The mission is invalid.
    #[error(transparent)]
    Mission(#[from] SubmitError),
    /// The id of the request cannot be formed.
    #[error(transparent)]
    Id(#[from] NameError),
}

/// Definitions that a request refers to, and the bounds of missions that state none.
#[derive(Clone, Copy)]
pub(super) struct Definitions<'a> {
    /// The missions, by name.
    pub(super) missions: &'a NamedMissions,
    /// The task types.
    pub(super) domain: &'a Domain,
    /// The bounds.
    pub(super) limits: RequestLimits,
}

/// Checks a request for a schedule, with its mission. `by` is the person that asks.
///
/// # Errors
/// The request is invalid in itself, or its mission does not match the domain.
pub(super) fn prepare_schedule(
    request: ScheduleRequest,
    definitions: Definitions<'_>,
    by: String,
) -> Result<Schedule, ScheduleError> {
    let ScheduleRequest { schedule: id, cron, zone, until, missed, submit, .. } = request;
    let chars = id.as_str().chars().count();
    if chars > Schedule::ID_CHARS_MAX {
        return Err(ScheduleError::Name { chars });
    }
    let missing = |field, meaning| ScheduleError::Missing { field, meaning };
    let until_ms = until.map(|given| rfc3339_ms(&given).ok_or(ScheduleError::Until { given })).transpose()?;
    let rule = ScheduleRule {
        cron: cron.ok_or_else(|| missing("cron", "the times, such as \"0 8 * * 1-5\""))?,
        zone: zone.unwrap_or_else(|| "UTC".to_owned()),
        until_ms,
        missed: missed.unwrap_or_default(),
    };
    Recurrence::parse(&rule)?;
    let submit = *submit.ok_or_else(|| missing("submit", "the mission, as for api/submit"))?;
    if let Some(field) = [("request", submit.request.is_some()), ("not_before", submit.not_before.is_some())]
        .into_iter()
        .find(|(_, is)| *is)
    {
        return Err(ScheduleError::OfOccurrence { field: field.0 });
    }
    // Times count from 0, which stands for the time of the occurrence.
    let mut submission = prepare(submit, definitions, 0, id.to_string(), by)?;
    let deadline_after_ms = submission.deadline_ms.take();
    Ok(Schedule { id, rule, submission, deadline_after_ms })
}

/// Returns the requested mission: as defined here if the request names it, or else as given.
///
/// # Errors
/// The mission is unknown, or its file is invalid.
pub(crate) fn document(request: &SubmitRequest, missions: &NamedMissions) -> Result<MissionDocument, SubmitError> {
    let fields = request.ihtn_fields();
    match &request.mission {
        MissionSource::Named(name) => Ok(missions.document(name, &fields)?),
        MissionSource::File(file) => Ok(MissionDocument::parse(&serde_json::to_string(file)?, Format::Json, fields)?),
    }
}

/// Instantiates and divides the requested mission. A request without an id gets `default_id`;
/// `at_ms` is the time of the request in milliseconds since 1970, and `by` the person that asks.
///
/// # Errors
/// The request is invalid in itself or does not match the domain.
pub(super) fn prepare(
    request_fields: SubmitRequest,
    Definitions { missions, domain, limits }: Definitions<'_>,
    at_ms: u64,
    default_id: String,
    by: String,
) -> Result<Submission, SubmitError> {
    let document = document(&request_fields, missions)?;
    let (mut mission, mut recovery) = document.instantiate_with_recovery(&request_fields.parameters, domain)?;
    if let Some(patience_s) = limits.patience_s {
        let branches = std::iter::once(&mut mission).chain(&mut recovery);
        branches.for_each(|branch| branch.set_default_patience(patience_s));
    }
    let division = divide_and_check(&mission)?;
    let recovery = match recovery {
        None => None,
        Some(mission) => {
            let division = divide_and_check(&mission).map_err(SubmitError::Recovery)?;
            Some(RecoveryBranch { mission, division })
        }
    };
    let priority = Priority::new(request_fields.priority)?;
    let not_before_ms = request_fields.not_before.as_ref().map(|start| start_ms(start, at_ms)).transpose()?;
    let requested_ms = match request_fields.deadline_s {
        None => None,
        Some(seconds) => {
            let time = time_until_deadline(seconds).map_err(|error| SubmitError::Deadline { seconds, error })?;
            Some(later_ms(at_ms, time))
        }
    };
    if let (Some(start_ms), Some(requested_ms), Some(deadline_s)) =
        (not_before_ms, requested_ms, request_fields.deadline_s)
        && requested_ms <= start_ms
    {
        let starts_s = Duration::from_millis(start_ms.saturating_sub(at_ms)).as_secs_f64();
        return Err(SubmitError::DeadlineBeforeStart { deadline_s, starts_s });
    }
    let starts_ms = not_before_ms.unwrap_or_default().max(at_ms);
    let limit_ms = document.time_limit().or(limits.time_limit).map(|limit| later_ms(starts_ms, limit));
    let deadline_ms = [requested_ms, limit_ms].into_iter().flatten().min();
    let request = match request_fields.request {
        Some(request) => request,
        None => RequestId::new(default_id)?,
    };
    let parameters = request_fields.parameters;
    let forms = forms(std::iter::once(&mission).chain(recovery.as_ref().map(|recovery| &recovery.mission)), domain);
    let submission = Submission {
        request,
        mission,
        division,
        parameters,
        recovery,
        forms,
        by,
        priority,
        not_before_ms,
        deadline_ms,
        at_ms,
    };
    let bytes = codec::encode(&submission)?.len();
    if bytes > Submission::BYTES_MAX {
        return Err(SubmitError::TooLarge { bytes });
    }
    Ok(submission)
}

fn later_ms(at_ms: u64, time: Duration) -> u64 {
    at_ms.saturating_add(u64::try_from(time.as_millis()).unwrap_or(u64::MAX))
}

const NOT_BEFORE_ALLOWED: &str = "allowed is a date and time in the next ten years, as 2026-11-27T08:00:00+01:00, or a number \
     of seconds from now, 0 or more";

/// Returns the earliest start in milliseconds since 1970, for a request at `at_ms`. A time that has passed
/// is allowed: the mission may start at once.
fn start_ms(start: &StartTime, at_ms: u64) -> Result<u64, SubmitError> {
    let latest_ms = later_ms(at_ms, TIME_AHEAD_MAX);
    let (ms, given) = match start {
        StartTime::At(text) => (rfc3339_ms(text), format!("{text:?}")),
        StartTime::In(seconds) => {
            let time = Duration::try_from_secs_f64(*seconds).ok();
            (time.and_then(|time| at_ms.checked_add(time.as_millis().try_into().ok()?)), seconds.to_string())
        }
    };
    ms.filter(|ms| *ms <= latest_ms).ok_or(SubmitError::NotBefore { given })
}

/// Returns the time of a text in RFC 3339, in milliseconds since 1970.
pub(super) fn rfc3339_ms(text: &str) -> Option<u64> {
    let date = OffsetDateTime::parse(text, &Rfc3339).ok()?;
    u64::try_from(date.unix_timestamp_nanos() / 1_000_000).ok()
}

/// Returns the results of the tasks of people, by the types of the tasks.
fn forms<'a>(
    missions: impl Iterator<Item = &'a Mission>,
    domain: &Domain,
) -> BTreeMap<TaskType, BTreeMap<String, ValueKind>> {
    let mut forms = BTreeMap::new();
    for mission in missions {
        // A robot that takes part returns the results itself.
        let is_person = |role| mission.roles.get(role).is_some_and(|role| role.kind == RoleKind::Unmanaged);
        for (_, spec) in mission.elementary() {
            let results = domain.get(&spec.task_type).map(|schema| &schema.results);
            if let Some(results) = results.filter(|results| !results.is_empty() && spec.roles.iter().all(is_person)) {
                forms.insert(spec.task_type.clone(), results.clone());
            }
        }
    }
    forms
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_skills::domain::hospital;
    use serde_json::{Value, json};

    /// Returns the `patience_s` of all tasks and the deadline of a mission that is requested at 1000 ms. Each branch begins with a
    /// task of a robot; its other tasks are those of a clerk.
    fn bounds(limits: RequestLimits, time_limit_s: Option<u32>) -> (Vec<Option<u32>>, Option<u64>) {
        let wait = |task: &str, role: &str| {
            let parameters = json!({ "seconds": "1" });
            json!({ "task": task, "type": "wait", "roles": [role], "parameters": parameters })
        };
        let patient = json!({ "task": "patient", "type": "deposit", "roles": ["clerk"], "patience_s": 60,
            "parameters": { "into_role": "r1" }, "acquires": { "parcel": "r1" } });
        let tasks = json!([wait("stay", "r1"), patient, wait("other", "clerk")]);
        let after_loss = json!([wait("come", "r1"), wait("late", "clerk")]);
        let mut mission = json!({
            "mission": "meet",
            "roles": { "r1": { "kind": "managed" }, "clerk": { "kind": "unmanaged" } },
            "root": { "task": "all", "method": "sequential", "tasks": tasks },
            "recovery": { "task": "again", "method": "sequential", "tasks": after_loss },
        });
        if let Some(seconds) = time_limit_s {
            mission["time_limit_s"] = json!(seconds);
        }
        let Value::Object(file) = mission else { panic!("an object") };
        let (missions, domain) = (NamedMissions::default(), hospital());
        let definitions = Definitions { missions: &missions, domain: &domain, limits };
        let request = SubmitRequest::of(MissionSource::File(file));
        let submission = prepare(request, definitions, 1000, "one".to_owned(), "Nia".to_owned()).unwrap();
        let branches = [&submission.mission, &submission.recovery.as_ref().unwrap().mission];
        let specs = branches.into_iter().flat_map(Mission::elementary);
        (specs.map(|(_, spec)| spec.patience_s).collect(), submission.deadline_ms)
    }

    #[test]
    fn missions_get_the_bounds_of_the_fleet_that_they_do_not_state() {
        let none = RequestLimits { patience_s: None, time_limit: None, ..RequestLimits::default() };
        assert_eq!(bounds(none, None), (vec![None, Some(60), None, None, None], None));
        let (patience_s, time_limit) = (Some(900), Some(Duration::from_secs(10)));
        let limits = RequestLimits { patience_s, time_limit, ..none };
        let patience = vec![None, Some(60), Some(900), None, Some(900)];
        assert_eq!(bounds(limits, None), (patience.clone(), Some(11_000)));
        assert_eq!(bounds(limits, Some(5)), (patience, Some(6_000)));
    }
}
