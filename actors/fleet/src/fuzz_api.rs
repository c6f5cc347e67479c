//! Decoders of this crate for bytes from outside the process, exported for fuzzing.
//!
//! `tests/untrusted/` feeds arbitrary bytes to these functions; nothing else uses them. Each
//! function calls the decoder that the actors use, and returns the decoded value encoded again.

use crate::api_types::{self, MissionChangeRequest, MissionQuery, SubmitRequest, UpgradeRequest};
use consort_protocol::codec::CodecError;
use consort_protocol::keys::{ApiCall, RaftCall};
use consort_protocol::mission::{Format, MissionFileError, MissionTemplate, shipped};
use consort_raft::{StateMachine, fuzz_api};
use serde_json::Value;
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
    /// Submits a mission, with this file.
    Submit(Box<MissionTemplate>),
    /// Any other request.
    Other,
}

/// Decodes a client's JSON request.
///
/// # Errors
/// The text that the client receives as the refusal.
pub fn request(call: ApiCall, payload: &[u8]) -> Result<ApiRequest, String> {
    match call {
        ApiCall::Submit => {
            let SubmitRequest { mission, .. } = api_types::parse_request(call, payload)?;
            let template = match &mission {
                Value::String(name) => shipped().get(name).cloned().ok_or_else(|| format!("no mission {name:?}"))?,
                file => MissionTemplate::parse(&file.to_string(), Format::Json)
                    .map_err(|problem: MissionFileError| problem.to_string())?,
            };
            Ok(ApiRequest::Submit(Box::new(template)))
        }
        ApiCall::Cancel | ApiCall::Resolve => {
            api_types::parse_request::<MissionChangeRequest>(call, payload).map(|_| ApiRequest::Other)
        }
        ApiCall::Get | ApiCall::Explain => {
            api_types::parse_request::<MissionQuery>(call, payload).map(|_| ApiRequest::Other)
        }
        ApiCall::Upgrade => api_types::parse_request::<UpgradeRequest>(call, payload).map(|_| ApiRequest::Other),
        ApiCall::List | ApiCall::Help | ApiCall::Backup => Ok(ApiRequest::Other),
    }
}
