//! Raft's answers to other voters' questions. One task holds them all; a slow one delays no other.

use super::election::{LeaderContact, PreVoteRequest};
use super::leadership_transfer::{self, TransferRequest};
use super::leadership_view::LeadershipView;
use super::network::{HeartbeatRequest, RaftReply};
use super::types::{Raft, RaftId, StateMachine, TypeConfig, Vote};
use crate::bus::{BusError, Encoding, Query, Stream};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::{Key, Keys, RaftCall};
use futures::StreamExt as _;
use futures::stream::FuturesUnordered;
use openraft::error::{InstallSnapshotError, RaftError};
use openraft::raft::{AppendEntriesRequest, InstallSnapshotRequest, VoteRequest, VoteResponse};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Display;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::watch;
use tracing::{debug, warn};

/// Questions in hand at once; a voter has one open per peer, so more is a fault or an attack. A guess.
const IN_HAND_MAX: usize = 256;

/// What is needed to answer.
pub(super) struct RaftServer<S: StateMachine> {
    pub(super) me: RaftId,
    pub(super) raft: Raft<S>,
    pub(super) leader_contact: Arc<LeaderContact>,
    pub(super) leadership: watch::Receiver<LeadershipView>,
    pub(super) election_min: Duration,
    pub(super) heartbeat: Duration,
    /// Questions refused so far.
    pub(super) refused: Arc<AtomicU64>,
    pub(super) keys: Keys,
    /// Which founding this node's ledger belongs to.
    pub(super) cluster: watch::Receiver<Option<ClusterId>>,
    /// That of the first leader this node has followed: until its own ledger says so, it follows no other.
    pub(super) followed: OnceLock<ClusterId>,
}

impl<S: StateMachine> RaftServer<S> {
    /// Answers until the bus closes.
    pub(super) async fn run(self, mut queries: Stream<Query>) {
        let mut in_hand = FuturesUnordered::new();
        loop {
            tokio::select! {
                biased;
                Some(()) = in_hand.next() => {}
                query = queries.recv(), if in_hand.len() < IN_HAND_MAX => match query {
                    Some(query) => in_hand.push(self.answer(query)),
                    None => return,
                },
            }
        }
    }

    async fn answer(&self, query: Query) {
        let outcome = match self.keys.read(&query.key) {
            Some(Key::Raft(_, RaftCall::Vote)) => self.vote(&query).await,
            Some(Key::Raft(_, RaftCall::Append)) => self.append(&query).await,
            Some(Key::Raft(_, RaftCall::Snapshot)) => self.snapshot(&query).await,
            Some(Key::Raft(_, RaftCall::PreVote)) => self.canvass(&query),
            Some(Key::Raft(_, RaftCall::TransferLeadership)) => self.succeed(&query).await,
            Some(Key::Raft(_, RaftCall::Heartbeat)) => self.beat(&query),
            _ => Err("no such question".to_owned()),
        };
        let sent = match outcome {
            Ok(bytes) => query.replier.reply(&query.key, bytes.into(), Encoding::Wire).await,
            Err(reason) => refuse(&query, &reason, &self.refused).await,
        };
        if let Err(error) = sent {
            debug!(key = query.key, %error, "a raft answer was not sent");
        }
    }

    async fn vote(&self, query: &Query) -> Result<Vec<u8>, String> {
        let question: VoteRequest<RaftId> = self.read(query)?;
        if !self.leader_contact.try_begin_vote(self.election_min) {
            let vote = self.raft.server_metrics().borrow().vote;
            let last = self.raft.data_metrics().borrow().last_log;
            return written(&RaftReply::Done(VoteResponse { vote, vote_granted: false, last_log_id: last }));
        }
        let answer = self.raft.vote(question).await;
        self.leader_contact.end_vote(answer.as_ref().ok().map(|answer| answer.vote));
        let answer = answer.map_err(in_words)?;
        if answer.vote_granted {
            self.leader_contact.record_vote_granted();
        }
        written(&RaftReply::Done(answer))
    }

    async fn append(&self, query: &Query) -> Result<Vec<u8>, String> {
        let question: AppendEntriesRequest<TypeConfig<S>> = self.read_and_follow(query)?;
        self.note_leader(&question.vote);
        let _in_hand = self.leader_contact.begin_append();
        let answer = self.raft.append_entries(question).await.map_err(in_words)?;
        written(&RaftReply::Done(answer))
    }

    async fn snapshot(&self, query: &Query) -> Result<Vec<u8>, String> {
        let question: InstallSnapshotRequest<TypeConfig<S>> = self.read_and_follow(query)?;
        fits(question.offset, question.data.len())?;
        self.note_leader(&question.vote);
        match self.raft.install_snapshot(question).await {
            Ok(answer) => written(&RaftReply::Done(answer)),
            Err(RaftError::APIError(InstallSnapshotError::SnapshotMismatch(mismatch))) => {
                written(&RaftReply::<()>::Mismatch(mismatch))
            }
            Err(RaftError::Fatal(fatal)) => Err(in_words(fatal)),
        }
    }

    /// Notes that the leader speaks, unless its reign is over. This comes before openraft is told, so that whoever has
    /// just looked and is about to stand is told of first, and the leader gets no acknowledgement that would mislead it.
    fn note_leader(&self, vote: &Vote) {
        let known = self.raft.server_metrics().borrow().vote;
        self.leader_contact.record_leader(vote, &known);
    }

    /// Answers beside openraft, whose core may be waiting for the disk.
    fn beat(&self, query: &Query) -> Result<Vec<u8>, String> {
        let question: HeartbeatRequest = self.read_and_follow(query)?;
        let known = self.raft.server_metrics().borrow().vote;
        written(&RaftReply::Done(self.leader_contact.answer_heartbeat(&question.vote, &known)))
    }

    async fn succeed(&self, query: &Query) -> Result<Vec<u8>, String> {
        let word: TransferRequest = self.read(query)?;
        let current = self.raft.server_metrics().borrow().vote == word.leader_vote;
        let obeyed = if word.target != self.me {
            self.leader_contact.record_vote_granted();
            let free = leadership_transfer::release_vote(&self.raft, &word).await;
            if free && current {
                self.leader_contact.record_release(word.target_vote());
            }
            free
        } else if current {
            self.leader_contact.record_leader_resigned();
            // Its own: it would have nobody else while it stands.
            self.leader_contact.record_vote_granted();
            self.raft.trigger().elect().await.map_err(in_words)?;
            true
        } else {
            // Said twice, or too late: the election is under way or over.
            true
        };
        written(&RaftReply::Done(obeyed))
    }

    /// Reads a question, unless it comes from another cluster.
    fn read<T: DeserializeOwned>(&self, query: &Query) -> Result<T, String> {
        self.read_from(query).map(|(_, question)| question)
    }

    /// The same for a leader's question: a node that belongs nowhere yet stays with the first leader it follows.
    fn read_and_follow<T: DeserializeOwned>(&self, query: &Query) -> Result<T, String> {
        let (asker, question) = self.read_from(query)?;
        if let Some(asker) = asker {
            self.followed.get_or_init(|| asker);
        }
        Ok(question)
    }

    fn read_from<T: DeserializeOwned>(&self, query: &Query) -> Result<(Option<ClusterId>, T), String> {
        let (asker, question) = decode_request(&query.payload).map_err(in_words)?;
        let own = self.cluster.borrow().or_else(|| self.followed.get().copied());
        match (asker, own) {
            (Some(asker), Some(own)) if asker != own => {
                Err(format!("a question of cluster {asker}, where this node belongs to {own}: they do not merge"))
            }
            _ => Ok((asker, question)),
        }
    }

    fn canvass(&self, query: &Query) -> Result<Vec<u8>, String> {
        let asker: PreVoteRequest = self.read(query)?;
        let hears_none =
            self.leader_contact.no_leader_for(self.election_min, self.heartbeat) && !self.leadership.borrow().is_leader;
        let knows_enough = asker.last_log_id >= self.raft.data_metrics().borrow().last_log;
        written(&RaftReply::Done(hears_none && knows_enough))
    }
}

/// Whether a piece of a snapshot may be taken in: openraft makes room for all that would stand before it.
fn fits(offset: u64, length: usize) -> Result<(), String> {
    let end = offset.saturating_add(length as u64);
    match end > codec::RECORD_BYTES_MAX as u64 {
        true => Err(format!("a snapshot of {end} bytes or more, where {} are allowed", codec::RECORD_BYTES_MAX)),
        false => Ok(()),
    }
}

/// Reads what a voter asks, and to which founding of the ledger it belongs.
pub(super) fn decode_request<T: DeserializeOwned>(bytes: &[u8]) -> Result<(Option<ClusterId>, T), CodecError> {
    codec::decode(bytes)
}

async fn refuse(query: &Query, reason: &str, refused: &AtomicU64) -> Result<(), BusError> {
    let count = refused.fetch_add(1, Ordering::Relaxed) + 1;
    warn!(key = query.key, bytes = query.payload.len(), count, reason, "refused a raft question");
    query.replier.refuse(reason).await
}

fn written<T: Serialize>(answer: &T) -> Result<Vec<u8>, String> {
    codec::encode(answer).map_err(in_words)
}

fn in_words(error: impl Display) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_of_a_snapshot_stands_within_what_a_snapshot_may_be() {
        let limit = codec::RECORD_BYTES_MAX as u64;
        assert_eq!(fits(limit - 3, 3), Ok(()));
        let refused = "a snapshot of 268435457 bytes or more, where 268435456 are allowed";
        assert_eq!(fits(limit - 3, 4), Err(refused.to_owned()));
        assert!(fits(u64::MAX, 1).is_err());
    }
}
