//! Requests between voters that openraft lacks, and the frames of all requests and replies.

use super::types::{LogId, RaftId, Vote};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::ClusterId;
use openraft::error::SnapshotMismatch;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Pre-vote request: would the target vote for this node?
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct PreVoteRequest {
    /// Last entry of the requesting node's log.
    pub(super) last_log_id: Option<LogId>,
}

/// Heartbeat request of a leader, handled outside openraft.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct HeartbeatRequest {
    /// Vote that made it leader.
    pub(super) vote: Vote,
}

/// Reply of a voter to a heartbeat request.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct HeartbeatReply {
    /// The voter follows that leader, and grants no other vote within `election_min` of the
    /// request, unless it loses the leader or the leader resigns.
    pub(super) follows: bool,
    /// The voter has an append pending.
    pub(super) busy: bool,
}

/// Request of a resigning leader to a voter.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct TransferRequest {
    /// Vote that made the resigning leader.
    pub(super) leader_vote: Vote,
    /// Voter that is to campaign.
    pub(super) target: RaftId,
}

impl TransferRequest {
    /// Returns the vote that the request grants to the target.
    pub(super) fn target_vote(&self) -> Vote {
        Vote::new(self.leader_vote.leader_id().term.saturating_add(1), self.target)
    }
}

/// Reply of a voter to a request that it could decode.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum RaftReply<A> {
    Done(A),
    /// Reply to a snapshot chunk only: it is not the expected chunk.
    Mismatch(SnapshotMismatch),
}

/// Decodes the reply of a voter.
pub(super) fn decode_reply<A: DeserializeOwned>(bytes: &[u8]) -> Result<RaftReply<A>, CodecError> {
    codec::decode(bytes)
}

/// Decodes a request of a voter, and the cluster of the voter.
pub(super) fn decode_request<T: DeserializeOwned>(bytes: &[u8]) -> Result<(Option<ClusterId>, T), CodecError> {
    codec::decode(bytes)
}
