//! What others send and parts of this crate read that nobody else sees: so that they can be tried with any bytes whatever,
//! through the very functions that actors read with. `tests/untrusted/` does; nothing else uses this.
//!
//! Each gives again, written anew, what was read.

use crate::api_types::{self, MissionChangeRequest, MissionQuery, SubmitRequest, UpgradeRequest};
use crate::raft::{StateMachine, fuzz_api};
use consort_protocol::codec::CodecError;
use consort_protocol::keys::{ApiCall, RaftCall};
use consort_protocol::mission::{Format, MissionFileError, MissionTemplate, shipped};
use serde_json::Value;
use std::io;

/// What one voter asks another.
///
/// # Errors
/// [`CodecError`], as the voter refuses it.
pub fn raft_request<S: StateMachine>(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fuzz_api::request::<S>(call, bytes)
}

/// What a voter answers.
///
/// # Errors
/// [`CodecError`], as whoever asked refuses it.
pub fn raft_response(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fuzz_api::reply(call, bytes)
}

/// An entry of the ledger's log, from a disk.
///
/// # Errors
/// As a node that starts refuses it.
pub fn log_entry<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    fuzz_api::entry::<S>(bytes)
}

/// A snapshot of the ledger, from a disk or from a leader.
///
/// # Errors
/// As a node refuses it that starts, or is to install it.
pub fn snapshot<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    fuzz_api::snapshot::<S>(bytes)
}

/// What a request of a client holds.
#[derive(Debug)]
pub enum ApiRequest {
    /// It asks for a mission, of this file.
    Submit(Box<MissionTemplate>),
    /// It says something of a mission, asks about one, or takes nothing.
    Other,
}

/// A request of a client in any language.
///
/// # Errors
/// What the client is answered.
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
