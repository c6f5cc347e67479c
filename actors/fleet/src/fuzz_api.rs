//! Decoders of this crate for bytes from outside the process, exported for fuzzing.
//!
//! `tests/fuzz_targets/` feeds arbitrary bytes to these functions; nothing else uses them. Each
//! function calls the decoder that the actors use, and returns the decoded value encoded again.

use crate::coordinator::submission::{SubmitError, document};
use consort_protocol::api::{
    AlarmRequest, AnswerRequest, CancelMissionsRequest, CloseRequest, HoldRequest, LimitRequest, MaintenanceRequest,
    MissionChangeRequest, MissionQuery, OpenRequest, PriorityRequest, ReassignRequest, ReleaseRequest, ScheduleRequest,
    SubmitRequest, UpgradeRequest, parse_read_options, parse_request,
};
use consort_protocol::codec::CodecError;
use consort_protocol::keys::{ApiCall, RaftCall};
use consort_protocol::mission::MissionDocument;
use consort_raft::{StateMachine, fuzz_api};
use consort_skills::missions::NamedMissions;
use std::io;

/// Decodes a Raft request and encodes it again.
///
/// # Errors
/// [`CodecError`], with which a voter refuses the request.
pub fn raft_request<S: StateMachine>(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fuzz_api::request::<S>(call, bytes)
}

/// Decodes a voter's reply and encodes it again.
///
/// # Errors
/// [`CodecError`], with which the requesting voter rejects the reply.
pub fn raft_response(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fuzz_api::reply(call, bytes)
}

/// Decodes an entry of the ledger's log, as stored on disk, and encodes it again.
///
/// # Errors
/// The I/O error with which a starting node rejects the entry.
pub fn log_entry<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    fuzz_api::entry::<S>(bytes)
}

/// Decodes a snapshot of the ledger, from disk or from a leader, and encodes it again.
///
/// # Errors
/// The I/O error with which a node rejects the snapshot, at its start or at the installation.
pub fn snapshot<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    fuzz_api::snapshot::<S>(bytes)
}

/// A decoded client request.
#[derive(Debug)]
pub enum ApiRequest {
    /// Submits this mission.
    Submit(Box<MissionDocument>),
    /// Any other request.
    Other,
}

/// Decodes a client's JSON request.
///
/// # Errors
/// The refusal that the client receives.
pub fn request(call: ApiCall, payload: &[u8]) -> Result<ApiRequest, impl std::error::Error + use<>> {
    match call {
        ApiCall::Submit => {
            let request: SubmitRequest = parse_request(call, payload)?;
            return Ok::<_, SubmitError>(ApiRequest::Submit(Box::new(document(&request, &NamedMissions::default())?)));
        }
        ApiCall::Cancel | ApiCall::Resolve => drop(parse_request::<MissionChangeRequest>(call, payload)?),
        ApiCall::CancelMissions => drop(parse_request::<CancelMissionsRequest>(call, payload)?),
        ApiCall::Priority => drop(parse_request::<PriorityRequest>(call, payload)?),
        ApiCall::Reassign => drop(parse_request::<ReassignRequest>(call, payload)?),
        ApiCall::Get | ApiCall::Explain => drop(parse_request::<MissionQuery>(call, payload)?),
        ApiCall::Upgrade => drop(parse_request::<UpgradeRequest>(call, payload)?),
        ApiCall::Answer => drop(parse_request::<AnswerRequest>(call, payload)?),
        ApiCall::Schedule => drop(parse_request::<ScheduleRequest>(call, payload)?),
        ApiCall::Hold => drop(parse_request::<HoldRequest>(call, payload)?),
        ApiCall::Release => drop(parse_request::<ReleaseRequest>(call, payload)?),
        ApiCall::Maintenance => drop(parse_request::<MaintenanceRequest>(call, payload)?),
        ApiCall::Close => drop(parse_request::<CloseRequest>(call, payload)?),
        ApiCall::Open => drop(parse_request::<OpenRequest>(call, payload)?),
        ApiCall::Limit => drop(parse_request::<LimitRequest>(call, payload)?),
        ApiCall::Alarm => drop(parse_request::<AlarmRequest>(call, payload)?),
        ApiCall::List | ApiCall::Requests | ApiCall::Schedules | ApiCall::Audit => {
            parse_read_options(call, payload)?;
        }
        ApiCall::Help | ApiCall::Backup => {}
    }
    Ok(ApiRequest::Other)
}
