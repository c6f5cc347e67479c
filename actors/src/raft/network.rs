//! Raft's questions to other voters, as queries on the bus.
//!
//! A voter whose disk is slow answers an append late, and all else that openraft is asked meanwhile: its core is one task.
//! So a leader that has waited for a heartbeat asks beside openraft whether the voter is still there and has the append in
//! hand ([`Line::beat`]). If so, it waits on, and counts the answer as an acknowledgement of its reign; if not, the append
//! or its answer was lost, and is sent again.

use super::election::PreVoteRequest;
use super::leadership_transfer::TransferRequest;
use super::settings::APPEND_TIMEOUT;
use super::types::{Peer, RaftId, StateMachine, TypeConfig, Vote};
use crate::bus::SharedBus;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::{Key, Keys, RaftCall};
use futures::StreamExt as _;
use futures::stream::FuturesUnordered;
use openraft::error::{
    InstallSnapshotError, NetworkError, RPCError, RaftError, RemoteError, SnapshotMismatch, Timeout, Unreachable,
};
use openraft::network::{Backoff, RPCOption, RPCTypes};
use openraft::raft::{
    AppendEntriesRequest, AppendEntriesResponse, InstallSnapshotRequest, InstallSnapshotResponse, VoteRequest,
    VoteResponse,
};
use openraft::{AnyError, RaftNetwork, RaftNetworkFactory};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::future::Future;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::{Instant, timeout};

/// Bytes of a snapshot that go in one message; with its frame around it, a message stays within [`codec::LIMIT`].
pub(super) const SNAPSHOT_CHUNK: usize = 48 * 1024;

/// Bytes of an append of several entries. A follower brings them to disk by one sync, and a slow link carries them within
/// a second; larger ones save little. One entry alone may fill a message.
pub(super) const APPEND_BYTES: usize = 32 * 1024;

/// A leader's question beside openraft: are you there?
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct HeartbeatRequest {
    /// Its reign.
    pub(super) vote: Vote,
}

/// What a voter answers to it.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct HeartbeatReply {
    /// It follows that leader, and votes for nobody else within `election_min` of the question.
    pub(super) follows: bool,
    /// It has an append in hand.
    pub(super) busy: bool,
}

/// When the last questions were sent by which voters acknowledged a reign.
#[derive(Debug, Clone, Default)]
pub(super) struct LeaderAcks {
    vote: Option<Vote>,
    sent: BTreeMap<RaftId, Instant>,
}

impl LeaderAcks {
    fn note(&mut self, vote: Vote, voter: RaftId, asked_at: Instant) {
        if self.vote != Some(vote) {
            *self = LeaderAcks { vote: Some(vote), sent: BTreeMap::new() };
        }
        let last = self.sent.entry(voter).or_insert(asked_at);
        *last = asked_at.max(*last);
    }

    /// When the newest question was sent that a majority of each of `halves` has acknowledged in the reign of `vote`, `me`
    /// among them.
    pub(super) fn quorum_ack(&self, vote: &Vote, me: RaftId, halves: &[BTreeSet<RaftId>]) -> Option<Instant> {
        if self.vote.as_ref() != Some(vote) {
            return None;
        }
        let now = Instant::now();
        let of_half = |half: &BTreeSet<RaftId>| {
            let sent = |voter: &RaftId| if *voter == me { Some(now) } else { self.sent.get(voter).copied() };
            let mut sent: Vec<Instant> = half.iter().filter_map(sent).collect();
            sent.sort_unstable_by(|one, other| other.cmp(one));
            sent.get(half.len() / 2).copied()
        };
        halves.iter().map(of_half).min().flatten()
    }
}

/// What a voter answers to a question it could read.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum RaftReply<A> {
    Done(A),
    /// To a chunk of a snapshot only: it is not the one expected.
    Mismatch(SnapshotMismatch),
}

/// Reads what a voter answered.
pub(super) fn decode_reply<A: DeserializeOwned>(bytes: &[u8]) -> Result<RaftReply<A>, CodecError> {
    codec::decode(bytes)
}

/// When we sent what each voter answered last: the same measure as the age of the majority's acknowledgement.
#[derive(Debug, Default)]
pub(super) struct LastContacts(Mutex<BTreeMap<RaftId, Instant>>);

impl LastContacts {
    fn note(&self, voter: RaftId, asked_at: Instant) {
        let mut heard = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let last = heard.entry(voter).or_insert(asked_at);
        *last = asked_at.max(*last);
    }

    /// When the last question was sent that `voter` has answered.
    pub(super) fn of(&self, voter: RaftId) -> Option<Instant> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&voter).copied()
    }
}

/// Makes a [`Line`] to each voter.
#[derive(Clone)]
pub(super) struct RaftClient {
    pub(super) bus: SharedBus,
    pub(super) keys: Keys,
    pub(super) me: RaftId,
    /// Which founding this node's ledger belongs to: part of every question.
    pub(super) cluster: watch::Receiver<Option<ClusterId>>,
    pub(super) last_contacts: Arc<LastContacts>,
    /// Who acknowledges this node's reign.
    pub(super) acks: Arc<watch::Sender<LeaderAcks>>,
    /// A heartbeat: the pause before asking again a voter that cannot be reached.
    pub(super) retry_interval: Duration,
    /// Whether this node keeps its leader's messages to itself; see [`super::canvass`].
    pub(super) appends_suspended: Arc<AtomicBool>,
}

impl RaftClient {
    /// The way to one voter.
    pub(super) fn peer(&self, target: RaftId) -> PeerClient {
        PeerClient { board: self.clone(), target }
    }

    /// Asks `others` all at once, adds those that say yes to `willing`, and ends as soon as these are a majority of each
    /// of `halves`: while voters are being changed, of the old and of the new ones. Says whether they are.
    pub(super) async fn query_until_majority<F: Future<Output = bool>>(
        &self,
        halves: &[BTreeSet<RaftId>],
        willing: &mut BTreeSet<RaftId>,
        others: &BTreeSet<RaftId>,
        ask: impl Fn(PeerClient) -> F,
    ) -> bool {
        let majority =
            |willing: &BTreeSet<RaftId>| halves.iter().all(|half| half.intersection(willing).count() * 2 > half.len());
        let asked = others.iter().map(|voter| {
            let answer = ask(self.peer(*voter));
            async move { answer.await.then_some(*voter) }
        });
        let mut asked: FuturesUnordered<_> = asked.collect();
        while !majority(willing) {
            match asked.next().await {
                Some(answer) => willing.extend(answer),
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

/// The way to one voter.
pub(super) struct PeerClient {
    board: RaftClient,
    target: RaftId,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
enum Trouble {
    #[error("no service answers for {0}")]
    Unserved(RaftId),
    #[error("no answer within {0:?}")]
    Silent(Duration),
    #[error("it refused: {0}")]
    Refused(String),
    #[error("its answer cannot be read: {0}")]
    Garbled(CodecError),
    #[error(transparent)]
    Bus(#[from] crate::bus::BusError),
    #[error("no majority has answered for too long: this leader falls silent")]
    Muted,
}

impl PeerClient {
    fn encode<T: Serialize>(&self, question: &T) -> Result<Vec<u8>, CodecError> {
        codec::encode(&(*self.board.cluster.borrow(), question))
    }

    /// Whether `target` would have this node stand for election; no answer is a no.
    pub(super) async fn pre_vote(&self, question: &PreVoteRequest, limit: Duration) -> bool {
        let Ok(question) = self.encode(question) else { return false };
        matches!(self.ask(RaftCall::PreVote, question, limit).await, Ok(RaftReply::Done(true)))
    }

    /// Tells `target` who succeeds this node, and whether it obeyed; no answer is a no.
    pub(super) async fn transfer_leadership(&self, word: &TransferRequest, limit: Duration) -> bool {
        let Ok(question) = self.encode(word) else { return false };
        matches!(self.ask(RaftCall::TransferLeadership, question, limit).await, Ok(RaftReply::Done(true)))
    }

    /// Whether `target` is there and follows this node's reign.
    pub(super) async fn heartbeat(&self, vote: Vote) -> Option<HeartbeatReply> {
        let question = self.encode(&HeartbeatRequest { vote }).ok()?;
        let asked_at = Instant::now();
        let Ok(RaftReply::Done(presence)) =
            self.ask::<HeartbeatReply>(RaftCall::Heartbeat, question, self.board.retry_interval).await
        else {
            return None;
        };
        if presence.follows {
            self.note_ack(vote, asked_at);
        }
        Some(presence)
    }

    fn note_ack(&self, vote: Vote, asked_at: Instant) {
        self.board.acks.send_modify(|acks| acks.note(vote, self.target, asked_at));
    }

    /// Waits for the answer to an append for as long as the voter says that it has it in hand.
    async fn append(
        &self,
        vote: Vote,
        bytes: Vec<u8>,
        limit: Duration,
    ) -> Result<RaftReply<AppendEntriesResponse<RaftId>>, Trouble> {
        let pause = self.board.retry_interval;
        let asking = self.ask(RaftCall::Append, bytes, limit);
        tokio::pin!(asking);
        loop {
            if let Ok(answer) = timeout(pause, &mut asking).await {
                return answer;
            }
            let presence = tokio::select! {
                biased;
                answer = &mut asking => return answer,
                presence = self.heartbeat(vote) => presence,
            };
            if !presence.is_some_and(|presence| presence.busy) {
                // It may have been answered just before.
                return timeout(pause / 4, &mut asking).await.unwrap_or(Err(Trouble::Silent(pause)));
            }
        }
    }

    async fn ask<A: DeserializeOwned>(
        &self,
        call: RaftCall,
        question: Vec<u8>,
        limit: Duration,
    ) -> Result<RaftReply<A>, Trouble> {
        if matches!(call, RaftCall::Append | RaftCall::Heartbeat)
            && self.board.appends_suspended.load(Ordering::Relaxed)
        {
            return Err(Trouble::Muted);
        }
        let asked_at = Instant::now();
        let key = self.board.keys.write(&Key::Raft(self.target.0, call));
        let mut replies = self.board.bus.query(&key, question.into(), limit).await?;
        let Some(reply) = replies.recv().await else {
            let silent = asked_at.elapsed() >= limit;
            return Err(if silent { Trouble::Silent(limit) } else { Trouble::Unserved(self.target) });
        };
        let answer = reply.payload.map_err(Trouble::Refused)?;
        let answer = decode_reply(&answer).map_err(Trouble::Garbled)?;
        self.board.last_contacts.note(self.target, asked_at);
        Ok(answer)
    }

    fn explain<E: std::error::Error>(
        &self,
        what: RPCTypes,
        trouble: &Trouble,
    ) -> RPCError<RaftId, Peer, RaftError<RaftId, E>> {
        match trouble {
            Trouble::Silent(timeout) => {
                Timeout { action: what, id: self.board.me, target: self.target, timeout: *timeout }.into()
            }
            Trouble::Unserved(_) | Trouble::Bus(_) | Trouble::Muted => Unreachable::new(trouble).into(),
            Trouble::Refused(_) | Trouble::Garbled(_) => NetworkError::new(trouble).into(),
        }
    }
}

fn unencodable<E: std::error::Error>(error: &CodecError) -> RPCError<RaftId, Peer, RaftError<RaftId, E>> {
    NetworkError::new(error).into()
}

fn out_of_place<E: std::error::Error>() -> RPCError<RaftId, Peer, RaftError<RaftId, E>> {
    NetworkError::new(&AnyError::error("it answered as to a snapshot")).into()
}

impl<S: StateMachine> RaftNetwork<TypeConfig<S>> for PeerClient {
    async fn append_entries(
        &mut self,
        question: AppendEntriesRequest<TypeConfig<S>>,
        option: RPCOption,
    ) -> Result<AppendEntriesResponse<RaftId>, RPCError<RaftId, Peer, RaftError<RaftId>>> {
        // openraft took as many entries as fit: the log's store gives no more at once.
        let bytes = self.encode(&question).map_err(|error| unencodable(&error))?;
        let asked_at = Instant::now();
        let trouble = match self.append(question.vote, bytes, option.hard_ttl()).await {
            Ok(RaftReply::Done(answer)) => {
                if !matches!(answer, AppendEntriesResponse::HigherVote(_)) {
                    self.note_ack(question.vote, asked_at);
                }
                return Ok(answer);
            }
            Ok(RaftReply::Mismatch(_)) => return Err(out_of_place()),
            Err(trouble) => trouble,
        };
        match trouble {
            Trouble::Silent(_) => Err(self.explain(RPCTypes::AppendEntries, &trouble)),
            Trouble::Unserved(_) | Trouble::Refused(_) | Trouble::Garbled(_) | Trouble::Bus(_) | Trouble::Muted => {
                // openraft would ask again at once; for what it is told is unreachable it waits, but in a `select!`
                // that draws its order by chance, so that runs would no longer repeat. So the wait is here.
                tokio::time::sleep(self.board.retry_interval.min(option.soft_ttl())).await;
                Err(NetworkError::new(&trouble).into())
            }
        }
    }

    async fn install_snapshot(
        &mut self,
        question: InstallSnapshotRequest<TypeConfig<S>>,
        option: RPCOption,
    ) -> Result<InstallSnapshotResponse<RaftId>, RPCError<RaftId, Peer, RaftError<RaftId, InstallSnapshotError>>> {
        let bytes = self.encode(&question).map_err(|error| unencodable(&error))?;
        match self.ask(RaftCall::Snapshot, bytes, option.hard_ttl()).await {
            Ok(RaftReply::Done(answer)) => Ok(answer),
            Ok(RaftReply::Mismatch(mismatch)) => {
                let error = RaftError::APIError(InstallSnapshotError::SnapshotMismatch(mismatch));
                Err(RemoteError::new(self.target, error).into())
            }
            Err(trouble) => Err(self.explain(RPCTypes::InstallSnapshot, &trouble)),
        }
    }

    async fn vote(
        &mut self,
        question: VoteRequest<RaftId>,
        _: RPCOption,
    ) -> Result<VoteResponse<RaftId>, RPCError<RaftId, Peer, RaftError<RaftId>>> {
        let bytes = self.encode(&question).map_err(|error| unencodable(&error))?;
        // openraft would have it before a slow disk has the vote: see `runtime`.
        match self.ask(RaftCall::Vote, bytes, APPEND_TIMEOUT).await {
            Ok(RaftReply::Done(answer)) => Ok(answer),
            Ok(RaftReply::Mismatch(_)) => Err(out_of_place()),
            Err(trouble) => Err(self.explain(RPCTypes::Vote, &trouble)),
        }
    }

    fn backoff(&self) -> Backoff {
        Backoff::new(std::iter::repeat(self.board.retry_interval))
    }
}
