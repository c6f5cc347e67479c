//! Raft's answers to other voters' questions. One task holds them all; a slow one delays no other.

use super::codec::{self, FRAME_MAX};
use super::network::{Answer, Verb, verb_of};
use super::types::{Raft, StateMachine};
use crate::bus::{BusError, Encoding, Query, Stream};
use futures::StreamExt as _;
use futures::stream::FuturesUnordered;
use openraft::error::{InstallSnapshotError, RaftError};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Display;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tracing::{debug, warn};

/// Questions in hand at once; a voter has one open per peer, so more is a fault or an attack. A guess.
const IN_HAND_MAX: usize = 256;

/// Answers until the bus closes.
pub(super) async fn serve<S: StateMachine>(mut queries: Stream<Query>, raft: Raft<S>, refused: Arc<AtomicU64>) {
    let mut in_hand = FuturesUnordered::new();
    loop {
        tokio::select! {
            biased;
            Some(()) = in_hand.next() => {}
            query = queries.recv(), if in_hand.len() < IN_HAND_MAX => match query {
                Some(query) => in_hand.push(answer::<S>(query, &raft, &refused)),
                None => return,
            },
        }
    }
}

async fn answer<S: StateMachine>(query: Query, raft: &Raft<S>, refused: &AtomicU64) {
    let outcome = match verb_of(&query.key) {
        Some(Verb::Vote) => vote::<S>(&query, raft).await,
        Some(Verb::Append) => append::<S>(&query, raft).await,
        Some(Verb::Snapshot) => snapshot::<S>(&query, raft).await,
        None => Err("no such question".to_owned()),
    };
    let sent = match outcome {
        Ok(bytes) => query.replier.reply(&query.key, bytes.into(), Encoding::Wire).await,
        Err(reason) => refuse(&query, &reason, refused).await,
    };
    if let Err(error) = sent {
        debug!(key = query.key, %error, "a raft answer was not sent");
    }
}

async fn refuse(query: &Query, reason: &str, refused: &AtomicU64) -> Result<(), BusError> {
    let count = refused.fetch_add(1, Ordering::Relaxed) + 1;
    warn!(key = query.key, bytes = query.payload.len(), count, reason, "refused a raft question");
    query.replier.refuse(reason).await
}

async fn vote<S: StateMachine>(query: &Query, raft: &Raft<S>) -> Result<Vec<u8>, String> {
    let answer = raft.vote(read(query)?).await.map_err(in_words)?;
    written(&Answer::Done(answer))
}

async fn append<S: StateMachine>(query: &Query, raft: &Raft<S>) -> Result<Vec<u8>, String> {
    let answer = raft.append_entries(read(query)?).await.map_err(in_words)?;
    written(&Answer::Done(answer))
}

async fn snapshot<S: StateMachine>(query: &Query, raft: &Raft<S>) -> Result<Vec<u8>, String> {
    match raft.install_snapshot(read(query)?).await {
        Ok(answer) => written(&Answer::Done(answer)),
        Err(RaftError::APIError(InstallSnapshotError::SnapshotMismatch(mismatch))) => {
            written(&Answer::<()>::Mismatch(mismatch))
        }
        Err(RaftError::Fatal(fatal)) => Err(in_words(fatal)),
    }
}

fn read<T: DeserializeOwned>(query: &Query) -> Result<T, String> {
    codec::decode(&query.payload, FRAME_MAX).map_err(in_words)
}

fn written<T: Serialize>(answer: &T) -> Result<Vec<u8>, String> {
    codec::encode(answer, FRAME_MAX).map_err(in_words)
}

fn in_words(error: impl Display) -> String {
    error.to_string()
}
