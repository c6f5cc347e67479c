//! Who may stand for election, and when a leader must fall silent: what openraft 0.9 leaves out.
//!
//! Without these two, measured on the virtual bus, a voter that was out of reach for five seconds unseats the leader
//! each time it returns, for by then it has raised its term in vain some ten times; and a leader that is heard by all
//! and hears nobody stays leader for ever, of a fleet that commits nothing.
//!
//! - *Canvass* (Ongaro's pre-vote, dissertation 9.6): a node that has not heard a leader for `election_min` asks the
//!   other voters whether they hear one. openraft's own elections are enabled only while a majority does not. This
//!   takes a round trip in a time in which nobody could be elected yet, so it delays no takeover.
//! - *Muting* (etcd's check quorum): a leader that no majority acknowledges sends no appends, so that those who hear
//!   it become free to elect another. It tries again now and then, in case they only were away.

use super::network::Switchboard;
use super::settings::ReplicaSettings;
use super::types::{Raft, RaftId, StateMachine};
use futures::StreamExt as _;
use futures::stream::FuturesUnordered;
use openraft::ServerState;
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::time::{Instant, sleep, sleep_until};

/// When this node last accepted a leader's message.
#[derive(Debug)]
pub(super) struct Ear(Mutex<Instant>);

impl Ear {
    /// As if a leader had been heard just now: a node that starts gives it time to speak.
    pub(super) fn new() -> Self {
        Ear(Mutex::new(Instant::now()))
    }

    pub(super) fn note(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
    }

    pub(super) fn last(&self) -> Instant {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Enables openraft's elections while a majority of the voters hears no leader, and disables them otherwise.
pub(super) async fn canvass<S: StateMachine>(
    raft: Raft<S>,
    board: Switchboard,
    ear: std::sync::Arc<Ear>,
    settings: ReplicaSettings,
) {
    let metrics = raft.metrics();
    loop {
        raft.runtime_config().elect(false);
        sleep_until(ear.last() + settings.election_min).await;
        while ear.last().elapsed() >= settings.election_min {
            let (voters, leads) = {
                let now = metrics.borrow();
                let voters = now.membership_config.membership().get_joint_config().clone();
                (voters, now.state == ServerState::Leader)
            };
            let may = !leads && voters.iter().any(|half| half.contains(&board.me)) && {
                let willing = willing(&board, &voters, settings.heartbeat).await;
                voters.iter().all(|half| half.intersection(&willing).count() * 2 > half.len())
            };
            raft.runtime_config().elect(may);
            sleep(settings.heartbeat / 2).await;
        }
    }
}

/// Which voters hear no leader, this node included.
async fn willing(board: &Switchboard, voters: &[BTreeSet<RaftId>], limit: Duration) -> BTreeSet<RaftId> {
    let all: BTreeSet<RaftId> = voters.iter().flatten().copied().collect();
    let others = all.into_iter().filter(|voter| *voter != board.me);
    let mut asked: FuturesUnordered<_> = others
        .map(|voter| {
            let line = board.line(voter);
            async move { line.canvass(limit).await.then_some(voter) }
        })
        .collect();
    let mut willing = BTreeSet::from([board.me]);
    while let Some(answer) = asked.next().await {
        willing.extend(answer);
    }
    willing
}
