//! Sending of a snapshot to a voter that has an earlier one. The leader sends the hashes of all blocks, and the content of the
//! blocks that the voter lacks.
//!
//! ```text
//!   leader                                              voter
//!     │ snapshot_blocks: lengths and hashes, in batches   │
//!     │ ────────────────────────────────────────────────► │ copies the blocks of its own snapshot
//!     │ ◄─────────────────────────── the missing blocks   │
//!     │ snapshot: the missing blocks, in chunks; the end  │
//!     │ ────────────────────────────────────────────────► │ checks the whole, and installs it
//! ```
//!
//! If the voter rejects a part, the whole snapshot is sent in chunks. A voter of an earlier release rejects the first request.

use super::{PeerClient, RequestError};
use crate::messages::{BLOCKS_MAX, BlocksReply, BlocksRequest, RaftReply};
use crate::settings::SNAPSHOT_CHUNK;
use crate::storage::{Block, blocks_of, compute, has_checksum};
use crate::types::{RaftId, StateMachine, TypeConfig, Vote};
use consort_bus::BootInstant;
use consort_protocol::keys::RaftCall;
use openraft::Snapshot;
use openraft::raft::{InstallSnapshotRequest, InstallSnapshotResponse};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ops::Range;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Number of times that a request is sent while there is no reply, as openraft does with chunks.
const ATTEMPTS: usize = 5;

impl PeerClient {
    /// Sends a snapshot by its blocks, each request within `limit`. Returns the vote of the target, which has installed the
    /// snapshot unless that vote is greater. `None` if the snapshot must be sent in chunks; an error if the target does not
    /// reply.
    pub(super) async fn send_blocks<S: StateMachine>(
        &self,
        vote: Vote,
        snapshot: &Snapshot<TypeConfig<S>>,
        limit: Duration,
    ) -> Result<Option<Vote>, RequestError> {
        let (meta, state) = (&snapshot.meta, snapshot.snapshot.get_ref());
        // A snapshot of an earlier release: a block that does not arrive would not be noticed.
        if !has_checksum(&meta.snapshot_id) {
            return Ok(None);
        }
        // No blocks at first: a target that is away, or of an earlier release, costs no computation.
        let Some(reply) = self.offer_blocks(vote, &meta.snapshot_id, 0, &[], limit).await? else { return Ok(None) };
        if reply.vote > vote {
            return Ok(Some(reply.vote));
        }
        let mut missing = vec![];
        let mut offset = 0;
        for blocks in compute(|| blocks_of(state)).chunks(BLOCKS_MAX) {
            let offered = self.offer_blocks(vote, &meta.snapshot_id, offset, blocks, limit).await?;
            let Some(reply) = offered else { return Ok(None) };
            if reply.vote > vote {
                return Ok(Some(reply.vote));
            }
            for (block, is_missing) in blocks.iter().zip(reply.missing) {
                let end = offset + block.length();
                if is_missing {
                    missing.push(offset..end);
                }
                offset = end;
            }
        }
        let chunk = |range: Range<usize>, done| {
            let (meta, offset, data) = (meta.clone(), range.start as u64, state[range].to_vec());
            InstallSnapshotRequest::<TypeConfig<S>> { vote, meta, offset, data, done }
        };
        for range in chunks_of(missing) {
            let request = chunk(range, false);
            let sent_at = BootInstant::now();
            let reply: Option<InstallSnapshotResponse<RaftId>> =
                self.send_part(RaftCall::Snapshot, vote, &request, limit).await?;
            let Some(reply) = reply else { return Ok(None) };
            self.record_snapshot_reply(vote, reply.vote, sent_at);
            if reply.vote > vote {
                return Ok(Some(reply.vote));
            }
        }
        // The end is not repeated: the target may be installing the snapshot. openraft begins anew, and the target replies
        // once it has installed the snapshot. Then it has all blocks.
        let Ok(end) = self.encode(&chunk(state.len()..state.len(), true)) else { return Ok(None) };
        let sent_at = BootInstant::now();
        match self.send::<InstallSnapshotResponse<RaftId>>(RaftCall::Snapshot, end, limit).await? {
            RaftReply::Done(reply) => {
                self.record_snapshot_reply(vote, reply.vote, sent_at);
                Ok(Some(reply.vote))
            }
            RaftReply::Mismatch(_) => Ok(None),
        }
    }

    /// Sends the hashes of blocks. `None` if the target rejects them, or if its reply does not match them.
    async fn offer_blocks(
        &self,
        vote: Vote,
        id: &str,
        offset: usize,
        blocks: &[Block],
        limit: Duration,
    ) -> Result<Option<BlocksReply>, RequestError> {
        let request = BlocksRequest { vote, id: id.to_owned(), offset: offset as u64, blocks: blocks.to_vec() };
        let sent_at = BootInstant::now();
        let reply: Option<BlocksReply> = self.send_part(RaftCall::SnapshotBlocks, vote, &request, limit).await?;
        let Some(reply) = reply else { return Ok(None) };
        self.knows_blocks.store(true, Ordering::Relaxed);
        self.record_snapshot_reply(vote, reply.vote, sent_at);
        let is_usable = reply.vote > vote || reply.missing.len() == blocks.len();
        Ok(is_usable.then_some(reply))
    }

    /// Sends a part of a snapshot, again if there is no reply. `None` if the target rejects the part, or replies to
    /// heartbeats only and may not know blocks; an error if it does not reply at all. A target that knows blocks is
    /// busy: its core waits while it installs a snapshot, and the whole in chunks would wait as well.
    async fn send_part<A: DeserializeOwned>(
        &self,
        call: RaftCall,
        vote: Vote,
        request: &impl Serialize,
        limit: Duration,
    ) -> Result<Option<A>, RequestError> {
        let Ok(bytes) = self.encode(request) else { return Ok(None) };
        let mut attempts = 0;
        let error = loop {
            let error = match self.send(call, bytes.clone(), limit).await {
                Ok(RaftReply::Done(reply)) => return Ok(Some(reply)),
                Ok(RaftReply::Mismatch(_)) | Err(RequestError::Rejected(_) | RequestError::Undecodable(_)) => {
                    return Ok(None);
                }
                Err(error) => error,
            };
            attempts += 1;
            if attempts == ATTEMPTS {
                break error;
            }
            tokio::time::sleep(self.client.retry_interval).await;
        };
        if self.knows_blocks.load(Ordering::Relaxed) {
            return Err(error);
        }
        match self.heartbeat(vote, self.client.retry_interval).await {
            Some(_) => Ok(None),
            None => Err(error),
        }
    }
}

/// Joins adjacent ranges, and cuts them into chunks.
fn chunks_of(ranges: Vec<Range<usize>>) -> impl Iterator<Item = Range<usize>> {
    let mut joined: Vec<Range<usize>> = vec![];
    for range in ranges {
        match joined.last_mut() {
            Some(last) if last.end == range.start => last.end = range.end,
            _ => joined.push(range),
        }
    }
    joined.into_iter().flat_map(|Range { start, end }| {
        (start..end).step_by(SNAPSHOT_CHUNK).map(move |from| from..end.min(from + SNAPSHOT_CHUNK))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adjacent_blocks_share_chunks() {
        let chunks: Vec<_> = chunks_of(vec![0..10, 10..100_000, 200_000..200_001]).collect();
        assert_eq!(chunks, [0..49_152, 49_152..98_304, 98_304..100_000, 200_000..200_001]);
    }
}
