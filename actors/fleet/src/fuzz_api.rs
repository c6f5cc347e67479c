//! Decoders of this crate for bytes from outside the process, exported for fuzzing.
//!
//! `tests/fuzz_targets/` feeds arbitrary bytes to these functions; nothing else uses them. Each
//! function calls the decoder that the actors use, and returns the decoded value encoded again.

use consort_protocol::api::{
    MissionChangeRequest, MissionQuery, MissionSource, SubmitRequest, UpgradeRequest, parse_request,
};
use consort_protocol::codec::CodecError;
use consort_protocol::keys::{ApiCall, RaftCall};
use consort_protocol::mission::{Format, MissionFileError, MissionTemplate};
use consort_raft::{StateMachine, fuzz_api};
use consort_skills::missions::shipped;
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
            let SubmitRequest { mission, .. } = read(call, payload)?;
            let template = match &mission {
                MissionSource::Shipped(name) => {
                    shipped().get(name).cloned().ok_or_else(|| format!("no mission {name:?}"))?
                }
                MissionSource::File(file) => {
                    let text = serde_json::to_string(file).map_err(|problem| problem.to_string())?;
                    MissionTemplate::parse(&text, Format::Json)
                        .map_err(|problem: MissionFileError| problem.to_string())?
                }
            };
            Ok(ApiRequest::Submit(Box::new(template)))
        }
        ApiCall::Cancel | ApiCall::Resolve => read::<MissionChangeRequest>(call, payload).map(|_| ApiRequest::Other),
        ApiCall::Get | ApiCall::Explain => read::<MissionQuery>(call, payload).map(|_| ApiRequest::Other),
        ApiCall::Upgrade => read::<UpgradeRequest>(call, payload).map(|_| ApiRequest::Other),
        ApiCall::List | ApiCall::Help | ApiCall::Backup => Ok(ApiRequest::Other),
    }
}

fn read<T: serde::de::DeserializeOwned>(call: ApiCall, payload: &[u8]) -> Result<T, String> {
    parse_request(call, payload).map_err(|problem| problem.to_string())
}
