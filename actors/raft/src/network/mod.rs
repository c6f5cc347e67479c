//! Raft requests to other voters, as queries on the bus.
//!
//! A voter with a slow disk replies late to an append, and to every other request to its openraft:
//! the core is a single task. So a leader that has waited for a heartbeat interval asks outside
//! openraft whether the voter is still alive and has the append pending
//! ([`PeerClient::heartbeat`]). If so, the leader keeps waiting, and counts the reply as an
//! acknowledgement of its leadership. If not, the append or its reply was lost, and the append is
//! sent again.

mod snapshot_blocks;

use super::acknowledgements::{LastContacts, LeaderAcks};
use super::leadership_view::LeadershipView;
use super::messages::{HeartbeatReply, HeartbeatRequest, PreVoteRequest, RaftReply, TransferRequest, decode_reply};
use super::settings::APPEND_TIMEOUT;
use super::types::{Peer, RaftId, StateMachine, TypeConfig, Vote};
use consort_bus::{BootInstant, Reply, SharedBus};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::{Key, Keys, RaftCall};
use futures::StreamExt as _;
use futures::stream::FuturesUnordered;
use openraft::error::{
    Fatal, InstallSnapshotError, NetworkError, RPCError, RaftError, RemoteError, ReplicationClosed, StreamingError,
    Timeout, Unreachable,
};
use openraft::network::snapshot_transport::{Chunked, SnapshotTransport as _};
use openraft::network::{Backoff, RPCOption, RPCTypes};
use openraft::raft::{
    AppendEntriesRequest, AppendEntriesResponse, InstallSnapshotRequest, InstallSnapshotResponse, SnapshotResponse,
    VoteRequest, VoteResponse,
};
use openraft::{AnyError, OptionalSend, RaftNetwork, RaftNetworkFactory, Snapshot};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;
use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::timeout;

/// Client of the other voters; creates a [`PeerClient`] for each.
#[derive(Clone)]
pub(super) struct RaftClient {
    pub(super) bus: SharedBus,
    pub(super) keys: Keys,
    pub(super) me: RaftId,
    /// Cluster of this node's ledger; part of every request.
    pub(super) cluster: watch::Receiver<Option<ClusterId>>,
    /// Leadership view of this node, which names the members.
    pub(super) leadership: watch::Receiver<LeadershipView>,
    pub(super) last_contacts: Arc<LastContacts>,
    /// Acknowledgements of this node as leader.
    pub(super) acks: Arc<watch::Sender<LeaderAcks>>,
    /// Heartbeat interval: the pause before an unreachable voter is contacted again.
    pub(super) retry_interval: Duration,
    /// This node does not send its appends and heartbeats (check-quorum); see `election`.
    pub(super) appends_suspended: Arc<AtomicBool>,
    /// A majority has replied to this node as leader within the check-quorum timeout. Otherwise its
    /// appends announce no commit: another leader may have committed more, and a follower would count
    /// its state as recent. A leader that restarts continues in its old term without such a reply.
    pub(super) quorum_confirmed: Arc<AtomicBool>,
}

impl RaftClient {
    /// Returns the client for `target`.
    pub(super) fn peer(&self, target: RaftId) -> PeerClient {
        PeerClient { client: self.clone(), target, knows_blocks: AtomicBool::default() }
    }

    /// Sends a request to all `targets` concurrently, adds those with a positive reply to
    /// `granted_by`, and ends as soon as `granted_by` has a majority of each of `halves` (during a
    /// membership change, of the old and of the new voters). Returns whether it has.
    pub(super) async fn query_until_majority<F: Future<Output = bool>>(
        &self,
        halves: &[BTreeSet<RaftId>],
        granted_by: &mut BTreeSet<RaftId>,
        targets: &BTreeSet<RaftId>,
        send: impl Fn(PeerClient) -> F,
    ) -> bool {
        let majority = |granted_by: &BTreeSet<RaftId>| {
            halves.iter().all(|half| half.intersection(granted_by).count() * 2 > half.len())
        };
        let requests = targets.iter().map(|voter| {
            let reply = send(self.peer(*voter));
            async move { reply.await.then_some(*voter) }
        });
        let mut requests: FuturesUnordered<_> = requests.collect();
        while !majority(granted_by) {
            match requests.next().await {
                Some(reply) => granted_by.extend(reply),
                None => return false,
            }
        }
        true
    }
}

impl<S: StateMachine> RaftNetworkFactory<TypeConfig<S>> for RaftClient {
    type Network = PeerClient;

    async fn new_client(&mut self, target: RaftId, _node: &Peer) -> PeerClient {
        self.peer(target)
    }
}

/// Client of a single voter.
pub(super) struct PeerClient {
    client: RaftClient,
    target: RaftId,
    /// The target has replied to a request with blocks of a snapshot.
    knows_blocks: AtomicBool,
}

/// Reply of a leader whose presence is in doubt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LeaderReply {
    /// The leader has replied, if only by a rejection.
    Received,
    /// No node serves its requests.
    NoService,
    /// There was no reply in time.
    Missing,
}

/// There is no usable reply.
#[derive(Debug, thiserror::Error)]
enum RequestError {
    #[error("no node serves the requests for {0}")]
    NoService(RaftId),
    #[error("no reply within {0:?}")]
    TimedOut(Duration),
    #[error("the voter rejected the request: {0}")]
    Rejected(String),
    #[error("its reply cannot be decoded: {0}")]
    Undecodable(CodecError),
    #[error(transparent)]
    Bus(#[from] consort_bus::BusError),
    #[error("appends are suspended: no majority has replied within the check-quorum timeout")]
    Suspended,
}

impl PeerClient {
    fn encode<T: Serialize>(&self, request: &T) -> Result<Vec<u8>, CodecError> {
        codec::encode(&(*self.client.cluster.borrow(), request))
    }

    /// Sends a pre-vote request and returns whether it was granted; a missing reply counts as a
    /// rejection.
    pub(super) async fn pre_vote(&self, request: &PreVoteRequest, limit: Duration) -> bool {
        let Ok(request) = self.encode(request) else { return false };
        matches!(self.send(RaftCall::PreVote, request, limit).await, Ok(RaftReply::Done(true)))
    }

    /// Queries a leader whether it is alive, by a pre-vote request with an empty log, which changes
    /// nothing.
    pub(super) async fn query_as_leader(&self, limit: Duration) -> LeaderReply {
        let Ok(request) = self.encode(&PreVoteRequest { last_log_id: None }) else { return LeaderReply::Missing };
        match self.send::<bool>(RaftCall::PreVote, request, limit).await {
            Ok(_) | Err(RequestError::Rejected(_) | RequestError::Undecodable(_)) => LeaderReply::Received,
            Err(RequestError::NoService(_)) => LeaderReply::NoService,
            Err(RequestError::TimedOut(_) | RequestError::Bus(_) | RequestError::Suspended) => LeaderReply::Missing,
        }
    }

    /// Sends a leadership transfer and returns whether `target` accepted it; a missing reply counts
    /// as a rejection.
    pub(super) async fn transfer_leadership(&self, request: &TransferRequest, limit: Duration) -> bool {
        let Ok(request) = self.encode(request) else { return false };
        matches!(self.send(RaftCall::TransferLeadership, request, limit).await, Ok(RaftReply::Done(true)))
    }

    /// Sends a heartbeat request. An acknowledgement is recorded. `None` without a reply within `limit`.
    pub(super) async fn heartbeat(&self, vote: Vote, limit: Duration) -> Option<HeartbeatReply> {
        let request = self.encode(&HeartbeatRequest { vote }).ok()?;
        let sent_at = BootInstant::now();
        let reply = self.send::<HeartbeatReply>(RaftCall::Heartbeat, request, limit).await;
        let Ok(RaftReply::Done(heartbeat)) = reply else { return None };
        if heartbeat.follows {
            self.record_ack(vote, sent_at);
        }
        Some(heartbeat)
    }

    fn record_ack(&self, vote: Vote, sent_at: BootInstant) {
        self.client.acks.send_modify(|acks| acks.record(vote, self.target, sent_at));
    }

    /// Records the reply to a part of a snapshot. It acknowledges the leader if the voter has its vote.
    fn record_snapshot_reply(&self, vote: Vote, reply: Vote, sent_at: BootInstant) {
        if reply == vote {
            self.record_ack(vote, sent_at);
        }
    }

    /// Sends an append, and waits for the reply as long as the voter reports that the append is
    /// pending.
    async fn append(
        &self,
        vote: Vote,
        bytes: Vec<u8>,
        limit: Duration,
    ) -> Result<RaftReply<AppendEntriesResponse<RaftId>>, RequestError> {
        let retry_interval = self.client.retry_interval;
        let pending = self.send(RaftCall::Append, bytes, limit);
        tokio::pin!(pending);
        loop {
            if let Ok(reply) = timeout(retry_interval, &mut pending).await {
                return reply;
            }
            let heartbeat = tokio::select! {
                biased;
                reply = &mut pending => return reply,
                heartbeat = self.heartbeat(vote, retry_interval) => heartbeat,
            };
            if !heartbeat.is_some_and(|heartbeat| heartbeat.busy) {
                // The reply may have been sent just before.
                return timeout(retry_interval / 4, &mut pending)
                    .await
                    .unwrap_or(Err(RequestError::TimedOut(retry_interval)));
            }
        }
    }

    async fn send<A: DeserializeOwned>(
        &self,
        call: RaftCall,
        request: Vec<u8>,
        limit: Duration,
    ) -> Result<RaftReply<A>, RequestError> {
        if matches!(call, RaftCall::Append | RaftCall::Heartbeat)
            && self.client.appends_suspended.load(Ordering::Relaxed)
        {
            return Err(RequestError::Suspended);
        }
        let sent_at = BootInstant::now();
        let key = self.client.keys.write(&Key::Raft(self.target.0, call));
        let mut replies = self.client.bus.query(&key, request.into(), limit).await?;
        let reply = loop {
            let Some(reply) = replies.recv().await else {
                let timed_out = sent_at.elapsed() >= limit;
                let error =
                    if timed_out { RequestError::TimedOut(limit) } else { RequestError::NoService(self.target) };
                return Err(error);
            };
            if self.is_by_target(&reply) {
                break reply;
            }
        };
        let reply = reply.payload.map_err(|refused| RequestError::Rejected(refused.0))?;
        let reply = decode_reply(&reply).map_err(RequestError::Undecodable)?;
        self.client.last_contacts.record(self.target, sent_at);
        Ok(reply)
    }

    /// Checks whether the target sent a reply. Another voter may not reply in its place: its key permits
    /// replies to every request of consensus. The author of a reply by a node that is not a known member is
    /// not checked.
    fn is_by_target(&self, reply: &Reply) -> bool {
        self.client.leadership.borrow().name_of(self.target).is_none_or(|name| reply.author.may_be(name.as_str()))
    }

    fn to_rpc_error<E: std::error::Error>(
        &self,
        action: RPCTypes,
        error: &RequestError,
    ) -> RPCError<RaftId, Peer, RaftError<RaftId, E>> {
        match error {
            RequestError::TimedOut(timeout) => {
                Timeout { action, id: self.client.me, target: self.target, timeout: *timeout }.into()
            }
            RequestError::NoService(_) | RequestError::Bus(_) | RequestError::Suspended => {
                Unreachable::new(error).into()
            }
            RequestError::Rejected(_) | RequestError::Undecodable(_) => NetworkError::new(error).into(),
        }
    }
}

fn unencodable<E: std::error::Error>(error: &CodecError) -> RPCError<RaftId, Peer, RaftError<RaftId, E>> {
    NetworkError::new(error).into()
}

fn unexpected_mismatch<E: std::error::Error>() -> RPCError<RaftId, Peer, RaftError<RaftId, E>> {
    NetworkError::new(&AnyError::error("the reply belongs to a snapshot request")).into()
}

impl<S: StateMachine> RaftNetwork<TypeConfig<S>> for PeerClient {
    async fn append_entries(
        &mut self,
        mut request: AppendEntriesRequest<TypeConfig<S>>,
        option: RPCOption,
    ) -> Result<AppendEntriesResponse<RaftId>, RPCError<RaftId, Peer, RaftError<RaftId>>> {
        if !self.client.quorum_confirmed.load(Ordering::Relaxed) {
            request.leader_commit = None;
        }
        // openraft read as many entries as fit: the log storage returns no more at once.
        let bytes = self.encode(&request).map_err(|error| unencodable(&error))?;
        let sent_at = BootInstant::now();
        let error = match self.append(request.vote, bytes, option.hard_ttl()).await {
            Ok(RaftReply::Done(reply)) => {
                if !matches!(reply, AppendEntriesResponse::HigherVote(_)) {
                    self.record_ack(request.vote, sent_at);
                }
                return Ok(reply);
            }
            Ok(RaftReply::Mismatch(_)) => return Err(unexpected_mismatch()),
            Err(error) => error,
        };
        match error {
            RequestError::TimedOut(_) => Err(self.to_rpc_error(RPCTypes::AppendEntries, &error)),
            RequestError::NoService(_)
            | RequestError::Rejected(_)
            | RequestError::Undecodable(_)
            | RequestError::Bus(_)
            | RequestError::Suspended => {
                // openraft would retry at once. It does pause for an unreachable peer, but in a
                // `select!` with random order, so that runs would not be reproducible. So the pause
                // is here.
                tokio::time::sleep(self.client.retry_interval.min(option.soft_ttl())).await;
                Err(NetworkError::new(&error).into())
            }
        }
    }

    async fn install_snapshot(
        &mut self,
        request: InstallSnapshotRequest<TypeConfig<S>>,
        option: RPCOption,
    ) -> Result<InstallSnapshotResponse<RaftId>, RPCError<RaftId, Peer, RaftError<RaftId, InstallSnapshotError>>> {
        let bytes = self.encode(&request).map_err(|error| unencodable(&error))?;
        let sent_at = BootInstant::now();
        match self.send::<InstallSnapshotResponse<RaftId>>(RaftCall::Snapshot, bytes, option.hard_ttl()).await {
            Ok(RaftReply::Done(reply)) => {
                self.record_snapshot_reply(request.vote, reply.vote, sent_at);
                Ok(reply)
            }
            Ok(RaftReply::Mismatch(mismatch)) => {
                let error = RaftError::APIError(InstallSnapshotError::SnapshotMismatch(mismatch));
                Err(RemoteError::new(self.target, error).into())
            }
            Err(error) => Err(self.to_rpc_error(RPCTypes::InstallSnapshot, &error)),
        }
    }

    async fn full_snapshot(
        &mut self,
        vote: Vote,
        snapshot: Snapshot<TypeConfig<S>>,
        cancel: impl Future<Output = ReplicationClosed> + OptionalSend + 'static,
        option: RPCOption,
    ) -> Result<SnapshotResponse<RaftId>, StreamingError<TypeConfig<S>, Fatal<RaftId>>> {
        let mut cancel = Box::pin(cancel);
        let sent = tokio::select! {
            biased;
            closed = &mut cancel => return Err(closed.into()),
            sent = self.send_blocks(vote, &snapshot, option.hard_ttl()) => sent,
        };
        match sent {
            Ok(Some(vote)) => Ok(SnapshotResponse::new(vote)),
            Ok(None) => Chunked::send_snapshot(self, vote, snapshot, cancel, option).await,
            Err(error) => Err(NetworkError::new(&error).into()),
        }
    }

    async fn vote(
        &mut self,
        request: VoteRequest<RaftId>,
        _: RPCOption,
    ) -> Result<VoteResponse<RaftId>, RPCError<RaftId, Peer, RaftError<RaftId>>> {
        let bytes = self.encode(&request).map_err(|error| unencodable(&error))?;
        // openraft's own limit is too short for a slow disk that writes the vote: see `runtime`.
        match self.send(RaftCall::Vote, bytes, APPEND_TIMEOUT).await {
            Ok(RaftReply::Done(reply)) => Ok(reply),
            Ok(RaftReply::Mismatch(_)) => Err(unexpected_mismatch()),
            Err(error) => Err(self.to_rpc_error(RPCTypes::Vote, &error)),
        }
    }

    fn backoff(&self) -> Backoff {
        Backoff::new(std::iter::repeat(self.client.retry_interval))
    }
}
