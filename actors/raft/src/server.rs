//! Server for the Raft requests of other voters. A single task serves them concurrently; a slow
//! request delays no other.

use super::leader_contact::LeaderContact;
use super::leadership_transfer;
use super::leadership_view::LeadershipView;
use super::messages::{
    BlocksReply, BlocksRequest, HeartbeatRequest, PreVoteRequest, RaftReply, TransferRequest, decode_request,
};
use super::staleness::AnnouncedCommits;
use super::storage::{PartError, ReceivedSnapshot, StateMachineStore, compute_apart};
use super::types::{LogId, Raft, RaftId, StateMachine, TypeConfig, Vote, epoch_of, leader_id_of};
use consort_bus::{BootInstant, BusError, Encoding, Query, Stream};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::{Key, Keys, RaftCall};
use futures::StreamExt as _;
use futures::stream::FuturesUnordered;
use openraft::error::{Fatal, RaftError, SnapshotMismatch};
use openraft::raft::{
    AppendEntriesRequest, AppendEntriesResponse, InstallSnapshotRequest, InstallSnapshotResponse, VoteRequest,
    VoteResponse,
};
use openraft::{Snapshot, SnapshotSegmentId};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::Cursor;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};
use tracing::{debug, warn};

/// Limit of concurrent requests. A voter has a single open request per peer, so more indicates a
/// fault or an attack. A guess.
const REQUESTS_MAX: usize = 256;

/// Error: a request was rejected. Its text is sent to the requester.
#[derive(Debug, thiserror::Error)]
enum RequestError {
    /// The key names no request.
    #[error("unknown request")]
    Unknown,
    /// The request cannot be decoded, or the reply cannot be encoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// The sender belongs to another cluster.
    #[error("the request comes from cluster {sender}, but this node belongs to cluster {own}: clusters do not merge")]
    OtherCluster {
        /// Cluster of the sender.
        sender: ClusterId,
        /// Cluster of this node.
        own: ClusterId,
    },
    /// A list of blocks is too long, or contains a block of an impossible length.
    #[error("the list of blocks is malformed")]
    Blocks,
    /// The snapshot would not fit in memory.
    #[error("a snapshot of at least {end} bytes exceeds the limit of {} bytes", codec::RECORD_BYTES_MAX)]
    SnapshotTooLarge {
        /// Least size of the snapshot, in bytes.
        end: u64,
    },
    /// openraft has rejected the request, or has stopped.
    #[error(transparent)]
    Raft(#[from] Box<RaftError<RaftId>>),
    /// openraft has stopped.
    #[error(transparent)]
    Stopped(#[from] Box<Fatal<RaftId>>),
}

/// State needed to serve requests.
pub(super) struct RaftServer<S: StateMachine> {
    pub(super) me: RaftId,
    pub(super) raft: Raft<S>,
    pub(super) leader_contact: Arc<LeaderContact>,
    pub(super) leadership: watch::Receiver<LeadershipView>,
    pub(super) election_min: Duration,
    pub(super) heartbeat: Duration,
    pub(super) announced_commits: Arc<AnnouncedCommits>,
    /// Number of requests rejected so far.
    pub(super) rejected: Arc<AtomicU64>,
    pub(super) keys: Keys,
    /// Cluster of this node's ledger.
    pub(super) cluster: watch::Receiver<Option<ClusterId>>,
    /// Cluster of the first leader that this node followed. Until its own ledger records a cluster,
    /// it follows no other.
    pub(super) followed: OnceLock<ClusterId>,
    /// State machine of this node, with its latest snapshot.
    pub(super) machine: StateMachineStore<S>,
    /// Snapshot that is being received.
    pub(super) received_snapshot: Mutex<ReceivedSnapshot>,
    /// Held while this node's snapshot is cut: a repeated request waits for its blocks, and does not cut it as well.
    pub(super) cutting: tokio::sync::Mutex<()>,
}

impl<S: StateMachine> RaftServer<S> {
    /// Serves requests until the bus closes, and discards a snapshot that is abandoned.
    pub(super) async fn run(self, mut queries: Stream<Query>) {
        let mut requests = FuturesUnordered::new();
        loop {
            // A part that arrives ends a request, so the next pass reads the time anew.
            let abandoned_at = self.received_snapshot().abandoned_at();
            tokio::select! {
                biased;
                Some(()) = requests.next() => {}
                () = sleep_until(abandoned_at.unwrap_or_else(Instant::now)), if abandoned_at.is_some() => {
                    self.received_snapshot().discard_abandoned(Instant::now());
                }
                query = queries.recv(), if requests.len() < REQUESTS_MAX => match query {
                    Some(query) => requests.push(self.handle(query)),
                    None => return,
                },
            }
        }
    }

    async fn handle(&self, query: Query) {
        let outcome = match self.keys.read(&query.key) {
            Some(Key::Raft(_, RaftCall::Vote)) => self.vote(&query).await,
            Some(Key::Raft(_, RaftCall::Append)) => self.append(&query).await,
            Some(Key::Raft(_, RaftCall::Snapshot)) => self.snapshot(&query).await,
            Some(Key::Raft(_, RaftCall::SnapshotBlocks)) => self.snapshot_blocks(&query).await,
            Some(Key::Raft(_, RaftCall::PreVote)) => self.pre_vote(&query),
            Some(Key::Raft(_, RaftCall::TransferLeadership)) => self.transfer_leadership(&query).await,
            Some(Key::Raft(_, RaftCall::Heartbeat)) => self.heartbeat(&query),
            _ => Err(RequestError::Unknown),
        };
        let sent = match outcome {
            Ok(bytes) => query.replier.reply(&query.key, bytes.into(), Encoding::Wire).await,
            Err(reason) => reject(&query, &reason.to_string(), &self.rejected).await,
        };
        if let Err(error) = sent {
            debug!(key = query.key, %error, "raft reply not sent");
        }
    }

    async fn vote(&self, query: &Query) -> Result<Vec<u8>, RequestError> {
        let request: VoteRequest<RaftId> = self.decode(query)?;
        if !self.leader_contact.try_begin_vote(self.election_min) {
            let vote = self.raft.server_metrics().borrow().vote;
            let last = self.raft.data_metrics().borrow().last_log;
            return encode_reply(&RaftReply::Done(VoteResponse { vote, vote_granted: false, last_log_id: last }));
        }
        self.leave_lost_leader(&request).await;
        let reply = self.raft.vote(request).await;
        self.leader_contact.end_vote(reply.as_ref().ok().map(|reply| reply.vote));
        let reply = reply.map_err(Box::new)?;
        if reply.vote_granted {
            self.leader_contact.record_vote_granted();
        }
        encode_reply(&RaftReply::Done(reply))
    }

    /// Makes openraft follow a leader no longer that this node has lost, in favor of a candidate with a
    /// sufficient log: openraft would reject each candidate until `election_min` after the leader's
    /// last message.
    async fn leave_lost_leader(&self, request: &VoteRequest<RaftId>) {
        let vote = self.raft.server_metrics().borrow().vote;
        let has_lost_leader = leader_id_of(&vote).is_some_and(|now| self.leader_contact.has_lost(now.leader));
        if vote.is_committed() && has_lost_leader && self.has_current_log(request.last_log_id) {
            // If openraft has stopped, so has the vote.
            let _ = leadership_transfer::vote_for(&self.raft, request.vote, vote.leader_id().term).await;
        }
    }

    /// Checks whether a log with this last entry is as long as the log of this node.
    fn has_current_log(&self, last: Option<LogId>) -> bool {
        last >= self.raft.data_metrics().borrow().last_log
    }

    async fn append(&self, query: &Query) -> Result<Vec<u8>, RequestError> {
        let request: AppendEntriesRequest<TypeConfig<S>> = self.decode_and_follow(query)?;
        self.record_leader(&request.vote);
        let (arrived_at, term) = (BootInstant::now(), request.vote.leader_id().term);
        let committed = request.leader_commit.as_ref().map(epoch_of).filter(|committed| committed.term == term);
        let _pending = self.leader_contact.begin_append();
        let reply = self.raft.append_entries(request).await.map_err(Box::new)?;
        if let (Some(committed), AppendEntriesResponse::Success) = (committed, &reply) {
            self.announced_commits.record(committed, arrived_at);
        }
        encode_reply(&RaftReply::Done(reply))
    }

    async fn snapshot(&self, query: &Query) -> Result<Vec<u8>, RequestError> {
        let request: InstallSnapshotRequest<TypeConfig<S>> = self.decode_and_follow(query)?;
        let InstallSnapshotRequest { vote, meta, offset, data, done } = request;
        check_chunk_size(offset, data.len())?;
        self.record_leader(&vote);
        let known = self.core_vote().await?;
        if vote < known {
            return encode_reply(&RaftReply::Done(InstallSnapshotResponse { vote: known }));
        }
        let added = self.add_part(|received| received.add(&meta.snapshot_id, offset, &data, done));
        let checked = match added {
            Ok(None) => return encode_reply(&RaftReply::Done(InstallSnapshotResponse { vote: known })),
            // A task that does not end has found no intact snapshot.
            Ok(Some(complete)) => compute_apart(|| complete.check()).await.unwrap_or(Err(PartError::Damaged)),
            Err(error) => Err(error),
        };
        match checked {
            Ok(state) => {
                let snapshot = Snapshot { meta, snapshot: Box::new(Cursor::new(state)) };
                let reply = self.raft.install_full_snapshot(vote, snapshot).await.map_err(Box::new)?;
                encode_reply(&RaftReply::Done(InstallSnapshotResponse::from(reply)))
            }
            Err(error) => self.reject_part(&meta.snapshot_id, offset, &error),
        }
    }

    /// Copies the blocks of a snapshot that this node's own snapshot contains, and replies which blocks are missing.
    async fn snapshot_blocks(&self, query: &Query) -> Result<Vec<u8>, RequestError> {
        let request: BlocksRequest = self.decode_and_follow(query)?;
        check_chunk_size(request.offset, request.length().ok_or(RequestError::Blocks)?)?;
        let BlocksRequest { vote, id, offset, blocks } = request;
        self.record_leader(&vote);
        let known = self.core_vote().await?;
        if vote < known {
            return encode_reply(&RaftReply::Done(BlocksReply { vote: known, missing: vec![] }));
        }
        if offset == 0 {
            let _cutting = self.cutting.lock().await;
            let needs_own_blocks = self.received_snapshot().needs_own_blocks(&id);
            if needs_own_blocks {
                let own = self.machine.own_blocks().await;
                self.received_snapshot().begin(&id, own);
            }
        }
        let added = self.add_part(|received| received.add_blocks(&id, offset, &blocks));
        match added {
            Ok(missing) => encode_reply(&RaftReply::Done(BlocksReply { vote: known, missing })),
            Err(error) => self.reject_part(&id, offset, &error),
        }
    }

    /// Returns the vote of this node after all requests that openraft has received. A reply with the vote of the leader
    /// acknowledges it, so this node must not have voted for another candidate.
    async fn core_vote(&self) -> Result<Vote, RequestError> {
        Ok(self.raft.with_raft_state(|state| *state.vote_ref()).await.map_err(Box::new)?)
    }

    /// Adds a part to the snapshot that is being received.
    fn add_part<T>(&self, add: impl FnOnce(&mut ReceivedSnapshot) -> T) -> T {
        let mut received = self.received_snapshot();
        let added = add(&mut received);
        received.note_part(Instant::now());
        added
    }

    fn received_snapshot(&self) -> MutexGuard<'_, ReceivedSnapshot> {
        self.received_snapshot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Replies that a part of a snapshot was rejected: the leader sends the snapshot again from its start.
    fn reject_part(&self, id: &str, offset: u64, error: &PartError) -> Result<Vec<u8>, RequestError> {
        warn!(node = %self.me, id, offset, %error, "a part of a snapshot is rejected; the snapshot is requested again");
        let segment = |offset| SnapshotSegmentId { id: id.to_owned(), offset };
        let mismatch = SnapshotMismatch { expect: segment(0), got: segment(offset) };
        encode_reply(&RaftReply::<()>::Mismatch(mismatch))
    }

    /// Records contact from the leader, unless its term is over. This happens before openraft
    /// receives the request. So a campaign that is about to start sees the contact first, and the
    /// leader gets no misleading acknowledgement.
    fn record_leader(&self, vote: &Vote) {
        let known = self.raft.server_metrics().borrow().vote;
        self.leader_contact.record_leader(vote, &known);
    }

    /// Replies outside openraft: its core may be waiting for the disk.
    fn heartbeat(&self, query: &Query) -> Result<Vec<u8>, RequestError> {
        let request: HeartbeatRequest = self.decode_and_follow(query)?;
        let known = self.raft.server_metrics().borrow().vote;
        encode_reply(&RaftReply::Done(self.leader_contact.answer_heartbeat(&request.vote, &known)))
    }

    async fn transfer_leadership(&self, query: &Query) -> Result<Vec<u8>, RequestError> {
        let request: TransferRequest = self.decode(query)?;
        let is_current = self.raft.server_metrics().borrow().vote == request.leader_vote;
        let accepted = if request.target != self.me {
            self.leader_contact.record_vote_granted();
            let released = leadership_transfer::release_vote(&self.raft, &request).await;
            if released && is_current {
                self.leader_contact.record_release(request.target_vote());
            }
            released
        } else if is_current {
            self.leader_contact.record_leader_resigned();
            // Its own vote: it waits for no other candidate during its campaign.
            self.leader_contact.record_vote_granted();
            self.raft.trigger().elect().await.map_err(Box::new)?;
            true
        } else {
            // A duplicate, or too late: the election is in progress or over.
            true
        };
        encode_reply(&RaftReply::Done(accepted))
    }

    /// Decodes a request, unless it comes from another cluster.
    fn decode<T: DeserializeOwned>(&self, query: &Query) -> Result<T, RequestError> {
        self.decode_with_cluster(query).map(|(_, request)| request)
    }

    /// Decodes a request of a leader. A node without a cluster stays with the cluster of the first
    /// leader it follows.
    fn decode_and_follow<T: DeserializeOwned>(&self, query: &Query) -> Result<T, RequestError> {
        let (sender, request) = self.decode_with_cluster(query)?;
        if let Some(sender) = sender {
            self.followed.get_or_init(|| sender);
        }
        Ok(request)
    }

    fn decode_with_cluster<T: DeserializeOwned>(&self, query: &Query) -> Result<(Option<ClusterId>, T), RequestError> {
        let (sender, request) = decode_request(&query.payload)?;
        let own_cluster = self.cluster.borrow().or_else(|| self.followed.get().copied());
        match (sender, own_cluster) {
            (Some(sender), Some(own)) if sender != own => Err(RequestError::OtherCluster { sender, own }),
            _ => Ok((sender, request)),
        }
    }

    fn pre_vote(&self, query: &Query) -> Result<Vec<u8>, RequestError> {
        let request: PreVoteRequest = self.decode(query)?;
        let no_leader =
            self.leader_contact.no_leader_for(self.election_min, self.heartbeat) && !self.leadership.borrow().is_leader;
        let log_is_current = self.has_current_log(request.last_log_id);
        encode_reply(&RaftReply::Done(no_leader && log_is_current))
    }
}

/// Checks the size of a part of a snapshot: memory is allocated for everything up to its end.
fn check_chunk_size(offset: u64, length: usize) -> Result<(), RequestError> {
    let end = offset.saturating_add(length as u64);
    if end > codec::RECORD_BYTES_MAX as u64 { Err(RequestError::SnapshotTooLarge { end }) } else { Ok(()) }
}

async fn reject(query: &Query, reason: &str, rejected: &AtomicU64) -> Result<(), BusError> {
    let count = rejected.fetch_add(1, Ordering::Relaxed) + 1;
    warn!(key = query.key, bytes = query.payload.len(), count, reason, "raft request rejected");
    query.replier.refuse(reason).await
}

fn encode_reply<T: Serialize>(reply: &T) -> Result<Vec<u8>, RequestError> {
    Ok(codec::encode(reply)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_snapshot_chunk_stays_within_the_limit_of_a_snapshot() {
        let limit = codec::RECORD_BYTES_MAX as u64;
        assert!(check_chunk_size(limit - 3, 3).is_ok());
        let rejected = "a snapshot of at least 268435457 bytes exceeds the limit of 268435456 bytes";
        assert_eq!(check_chunk_size(limit - 3, 4).unwrap_err().to_string(), rejected);
        assert!(check_chunk_size(u64::MAX, 1).is_err());
    }
}
