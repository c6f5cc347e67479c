//! Requests between voters that openraft lacks, and the frames of all requests and replies.

use super::storage::Block;
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

/// Maximum number of blocks in a request.
pub(super) const BLOCKS_MAX: usize = 1024;

/// Request of a leader that sends a snapshot: which of these blocks does the target lack?
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct BlocksRequest {
    /// Vote that made it leader.
    pub(super) vote: Vote,
    /// Id of the snapshot.
    pub(super) id: String,
    /// Offset of the first block in the encoded state, in bytes.
    pub(super) offset: u64,
    /// Consecutive blocks, [`BLOCKS_MAX`] at most.
    pub(super) blocks: Vec<Block>,
}

impl BlocksRequest {
    /// Returns the length of all blocks together, in bytes; `None` if there are too many, or if one is too long or empty.
    pub(super) fn length(&self) -> Option<usize> {
        let is_valid = self.blocks.len() <= BLOCKS_MAX && self.blocks.iter().all(Block::is_valid);
        is_valid.then(|| self.blocks.iter().map(Block::length).sum())
    }
}

/// Reply to a [`BlocksRequest`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct BlocksReply {
    /// Vote of the target. If it is greater than the vote of the leader, the target has ignored the request.
    pub(super) vote: Vote,
    /// For each block, whether the target lacks it.
    pub(super) missing: Vec<bool>,
}

/// Reply of a voter to a request that it could decode.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum RaftReply<A> {
    Done(A),
    /// Reply to a part of a snapshot only: it is not the expected part, or the snapshot is damaged.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_with_too_many_blocks_or_impossible_blocks_are_malformed() {
        let block = |length: u32| codec::decode::<Block>(&codec::encode(&(length, 7_u128)).unwrap()).unwrap();
        let length = |blocks| {
            BlocksRequest { vote: Vote::default(), id: "T1-N2-3".to_owned(), offset: u64::MAX, blocks }.length()
        };
        assert_eq!(length(vec![]), Some(0));
        assert_eq!(length(vec![block(65_536); BLOCKS_MAX]), Some(64 << 20));
        assert_eq!(length(vec![block(1); BLOCKS_MAX + 1]), None);
        for impossible in [0, 65_537, u32::MAX] {
            assert_eq!(length(vec![block(4096), block(impossible)]), None, "{impossible} bytes");
        }
        let largest = BlocksRequest {
            vote: Vote::default(),
            id: "x".repeat(200),
            offset: u64::MAX,
            blocks: vec![codec::decode(&codec::encode(&(u32::MAX, u128::MAX)).unwrap()).unwrap(); BLOCKS_MAX],
        };
        assert!(codec::encode(&(Some(ClusterId(1)), largest)).is_ok(), "it fits in a message");
    }
}
