//! Group commit: commands that arrive while an entry is being written share the next entry.
//!
//! openraft 0.9 writes each entry to disk separately and does nothing else meanwhile, so a leader
//! commits at most as many entries per second as its disk syncs. Bernstein et al., *Concurrency
//! Control and Recovery in Database Systems*, 1987, 6.4, call this group commit. A command that
//! arrives alone is proposed at once, without a delay.

use super::errors::ProposeError;
use super::types::{Batch, Raft, StateMachine};
use futures::StreamExt as _;
use futures::future::BoxFuture;
use futures::stream::FuturesUnordered;
use tokio::sync::{mpsc, oneshot, watch};

/// A proposed command, and the channel for its outcome.
pub(super) struct Proposal<S: StateMachine> {
    pub(super) command: S::Command,
    /// Encoded size in bytes.
    pub(super) size: usize,
    pub(super) reply: ReplySender<S>,
}

type ReplySender<S> = oneshot::Sender<Result<<S as StateMachine>::Outcome, ProposeError>>;

/// Combines commands into log entries.
pub(super) struct GroupCommitter<S: StateMachine> {
    pub(super) raft: Raft<S>,
    pub(super) proposals: mpsc::UnboundedReceiver<Proposal<S>>,
    /// Changes whenever entries have been written to this node's log store.
    pub(super) appended: watch::Receiver<u64>,
    /// Limit of the total size of the commands of an entry, in bytes.
    pub(super) size_max: usize,
}

/// Commands of an entry, their reply channels, and the first command that did not fit.
struct FilledEntry<S: StateMachine> {
    batch: Batch<S::Command>,
    replies: Vec<ReplySender<S>>,
    overflow: Option<Proposal<S>>,
}

/// A proposed entry that is not decided yet; the future returns its number.
type InFlightEntry = BoxFuture<'static, u64>;

impl<S: StateMachine> GroupCommitter<S> {
    /// Proposes commands until all senders are dropped.
    pub(super) async fn run(mut self) {
        let mut in_flight = FuturesUnordered::<InFlightEntry>::new();
        let mut postponed = None;
        for number in 0.. {
            let first = match postponed.take() {
                Some(first) => first,
                None => tokio::select! {
                    biased;
                    Some(_) = in_flight.next() => continue,
                    proposal = self.proposals.recv() => match proposal {
                        Some(proposal) => proposal,
                        None => return,
                    },
                },
            };
            let FilledEntry { batch, replies, overflow } = self.fill(first);
            postponed = overflow;
            if replies.is_empty() {
                continue;
            }
            self.appended.mark_unchanged();
            let entry = self.propose(number, batch, replies).await;
            in_flight.push(entry);
            // More commands may arrive until this entry is written. A rejected entry is never
            // written.
            loop {
                tokio::select! {
                    biased;
                    Some(decided) = in_flight.next() => if decided == number { break },
                    _ = self.appended.changed() => break,
                }
            }
        }
    }

    /// Collects the commands of an entry from the queue, as long as they fit and at most one of
    /// them needs a position of its own. Commands of callers that have gone away are left out.
    fn fill(&mut self, first: Proposal<S>) -> FilledEntry<S> {
        let (mut commands, mut replies) = (vec![], vec![]);
        let (mut size, mut epoch_grants) = (0, 0);
        let mut next = Some(first);
        while let Some(proposal) = next {
            if !proposal.reply.is_closed() {
                size += proposal.size;
                epoch_grants += usize::from(S::grants_epoch(&proposal.command));
                if !commands.is_empty() && (size > self.size_max || epoch_grants > 1) {
                    return FilledEntry { batch: Batch(commands), replies, overflow: Some(proposal) };
                }
                commands.push(proposal.command);
                replies.push(proposal.reply);
            }
            next = self.proposals.try_recv().ok();
        }
        FilledEntry { batch: Batch(commands), replies, overflow: None }
    }

    /// Passes an entry to openraft, and returns a future that sends the outcomes to the callers.
    async fn propose(&self, number: u64, batch: Batch<S::Command>, replies: Vec<ReplySender<S>>) -> InFlightEntry {
        let written = self.raft.client_write_ff(batch).await;
        Box::pin(async move {
            let outcomes = match written {
                Err(_) => Err(ProposeError::Closed),
                Ok(written) => match written.await {
                    Err(_) => Err(ProposeError::Closed),
                    Ok(Err(error)) => Err(ProposeError::from_write(error)),
                    Ok(Ok(written)) => Ok(written.data.expect("an entry of commands has outcomes")),
                },
            };
            match outcomes {
                Ok(outcomes) => {
                    for (reply, outcome) in replies.into_iter().zip(outcomes) {
                        // The caller may have gone away.
                        let _ = reply.send(Ok(outcome));
                    }
                }
                Err(error) => {
                    for reply in replies {
                        let _ = reply.send(Err(error.clone())); // see above
                    }
                }
            }
            number
        })
    }
}
