//! Decoding of Raft messages and records for fuzz tests, exactly as a voter decodes them.

use super::messages::{
    BlocksReply, BlocksRequest, HeartbeatReply, HeartbeatRequest, PreVoteRequest, RaftReply, TransferRequest,
    decode_reply, decode_request,
};
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

/// Decodes a request as the receiving voter does, and encodes it again.
pub fn request<S: StateMachine>(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fn reencode<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
        decode_request::<T>(bytes).and_then(|request| codec::encode(&request))
    }
    match call {
        RaftCall::Vote => reencode::<VoteRequest<RaftId>>(bytes),
        RaftCall::Append => reencode::<AppendEntriesRequest<TypeConfig<S>>>(bytes),
        RaftCall::Snapshot => reencode::<InstallSnapshotRequest<TypeConfig<S>>>(bytes),
        RaftCall::PreVote => reencode::<PreVoteRequest>(bytes),
        RaftCall::TransferLeadership => {
            let (cluster, request) = decode_request::<TransferRequest>(bytes)?;
            // The receiver computes the vote from the request at once.
            let _ = request.target_vote();
            codec::encode(&(cluster, request))
        }
        RaftCall::Heartbeat => reencode::<HeartbeatRequest>(bytes),
        RaftCall::SnapshotBlocks => {
            let (cluster, request) = decode_request::<BlocksRequest>(bytes)?;
            // The receiver checks the length at once.
            let _ = request.length();
            codec::encode(&(cluster, request))
        }
    }
}

/// Decodes a reply as the requesting voter does, and encodes it again.
pub fn reply(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fn reencode<A: Serialize + DeserializeOwned>(bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
        decode_reply::<A>(bytes).and_then(|reply: RaftReply<A>| codec::encode(&reply))
    }
    match call {
        RaftCall::Vote => reencode::<VoteResponse<RaftId>>(bytes),
        RaftCall::Append => reencode::<AppendEntriesResponse<RaftId>>(bytes),
        RaftCall::Snapshot => reencode::<InstallSnapshotResponse<RaftId>>(bytes),
        RaftCall::PreVote | RaftCall::TransferLeadership => reencode::<bool>(bytes),
        RaftCall::Heartbeat => reencode::<HeartbeatReply>(bytes),
        RaftCall::SnapshotBlocks => reencode::<BlocksReply>(bytes),
    }
}

/// Decodes a log entry as stored on disk, and encodes it again.
pub fn entry<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    encode_record(&decode_record::<Entry<TypeConfig<S>>>(bytes)?)
}

/// Decodes a snapshot, and the state in it, as stored on disk or received in chunks from a leader,
/// and encodes it again.
pub fn snapshot<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let kept: StoredSnapshot = decode_record(bytes)?;
    let state: S = decode_record(&kept.state)?;
    encode_record(&StoredSnapshot { state: encode_record(&state)?, ..kept })
}
