//! What voters say to one another, read as they read it, for those who try that with bytes of their own.

use super::election::PreVoteRequest;
use super::leadership_transfer::TransferRequest;
use super::network::{HeartbeatReply, HeartbeatRequest, RaftReply, decode_reply};
use super::server::decode_request;
use super::storage::{StoredSnapshot, decode_record, encode_record};
use super::types::{RaftId, StateMachine, TypeConfig};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::keys::RaftCall;
use openraft::Entry;
use openraft::raft::{
    AppendEntriesRequest, AppendEntriesResponse, InstallSnapshotRequest, InstallSnapshotResponse, VoteRequest,
    VoteResponse,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io;

/// Reads a question as the voter does that is asked, and writes it again.
pub(crate) fn request<S: StateMachine>(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fn again<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
        decode_request::<T>(bytes).and_then(|question| codec::encode(&question))
    }
    match call {
        RaftCall::Vote => again::<VoteRequest<RaftId>>(bytes),
        RaftCall::Append => again::<AppendEntriesRequest<TypeConfig<S>>>(bytes),
        RaftCall::Snapshot => again::<InstallSnapshotRequest<TypeConfig<S>>>(bytes),
        RaftCall::PreVote => again::<PreVoteRequest>(bytes),
        RaftCall::TransferLeadership => {
            let (asker, word) = decode_request::<TransferRequest>(bytes)?;
            // What it would have the voter do is reckoned from it at once.
            let _ = word.target_vote();
            codec::encode(&(asker, word))
        }
        RaftCall::Heartbeat => again::<HeartbeatRequest>(bytes),
    }
}

/// Reads an answer as the voter does that has asked, and writes it again.
pub(crate) fn reply(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fn again<A: Serialize + DeserializeOwned>(bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
        decode_reply::<A>(bytes).and_then(|answer: RaftReply<A>| codec::encode(&answer))
    }
    match call {
        RaftCall::Vote => again::<VoteResponse<RaftId>>(bytes),
        RaftCall::Append => again::<AppendEntriesResponse<RaftId>>(bytes),
        RaftCall::Snapshot => again::<InstallSnapshotResponse<RaftId>>(bytes),
        RaftCall::PreVote | RaftCall::TransferLeadership => again::<bool>(bytes),
        RaftCall::Heartbeat => again::<HeartbeatReply>(bytes),
    }
}

/// Reads an entry of the log as it is on the disk, and writes it again.
pub(crate) fn entry<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    encode_record(&decode_record::<Entry<TypeConfig<S>>>(bytes)?)
}

/// Reads a snapshot as it is on the disk, or as its pieces came from a leader, with the state in it, and writes it again.
pub(crate) fn snapshot<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let kept: StoredSnapshot = decode_record(bytes)?;
    let state: S = decode_record(&kept.state)?;
    encode_record(&StoredSnapshot { state: encode_record(&state)?, ..kept })
}
