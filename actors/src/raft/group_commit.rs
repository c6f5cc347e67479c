//! Commands that arrive while an entry of the log is being written go into the next entry together.
//!
//! openraft 0.9 writes each entry to disk by itself and does nothing else meanwhile, so that a leader commits no more
//! entries in a second than its disk syncs. Bernstein et al., *Concurrency Control and Recovery in Database Systems*,
//! 1987, 6.4, call this group commit. A command that comes alone goes at once: nothing waits for company.

use super::errors::ProposeError;
use super::types::{Batch, Raft, StateMachine};
use futures::StreamExt as _;
use futures::future::BoxFuture;
use futures::stream::FuturesUnordered;
use tokio::sync::{mpsc, oneshot, watch};

/// A command, and who waits for its outcome.
pub(super) struct Proposal<S: StateMachine> {
    pub(super) command: S::Command,
    /// Its encoded size in bytes.
    pub(super) size: usize,
    pub(super) reply: Answer<S>,
}

type Answer<S> = oneshot::Sender<Result<<S as StateMachine>::Outcome, ProposeError>>;

/// Makes entries of commands.
pub(super) struct GroupCommitter<S: StateMachine> {
    pub(super) raft: Raft<S>,
    pub(super) proposals: mpsc::UnboundedReceiver<Proposal<S>>,
    /// Changes whenever entries have been written to this node's journal.
    pub(super) appended: watch::Receiver<u64>,
    /// How many bytes the commands of one entry may have together.
    pub(super) size_max: usize,
}

/// The commands of one entry, who waits for each, and the first command that found no room.
struct Filled<S: StateMachine> {
    batch: Batch<S::Command>,
    answers: Vec<Answer<S>>,
    rest: Option<Proposal<S>>,
}

/// An entry that is on its way, by its number.
type OnItsWay = BoxFuture<'static, u64>;

impl<S: StateMachine> GroupCommitter<S> {
    /// Proposes until nobody can ask any more.
    pub(super) async fn run(mut self) {
        let mut on_their_way = FuturesUnordered::<OnItsWay>::new();
        let mut left_over = None;
        for number in 0.. {
            let first = match left_over.take() {
                Some(first) => first,
                None => tokio::select! {
                    biased;
                    Some(_) = on_their_way.next() => continue,
                    proposal = self.proposals.recv() => match proposal {
                        Some(proposal) => proposal,
                        None => return,
                    },
                },
            };
            let Filled { batch, answers, rest } = self.fill(first);
            left_over = rest;
            if answers.is_empty() {
                continue;
            }
            self.appended.mark_unchanged();
            let on_its_way = self.propose(number, batch, answers).await;
            on_their_way.push(on_its_way);
            // Until it is written, company may come. One that is refused is never written.
            loop {
                tokio::select! {
                    biased;
                    Some(ended) = on_their_way.next() => if ended == number { break },
                    _ = self.appended.changed() => break,
                }
            }
        }
    }

    /// The commands of one entry: those that wait, as long as they fit and at most one of them needs a place of its own.
    /// Those whose callers have gone are left out.
    fn fill(&mut self, first: Proposal<S>) -> Filled<S> {
        let (mut commands, mut answers) = (vec![], vec![]);
        let (mut size, mut places) = (0, 0);
        let mut next = Some(first);
        while let Some(proposal) = next {
            if !proposal.reply.is_closed() {
                size += proposal.size;
                places += usize::from(S::grants_epoch(&proposal.command));
                if !commands.is_empty() && (size > self.size_max || places > 1) {
                    return Filled { batch: Batch(commands), answers, rest: Some(proposal) };
                }
                commands.push(proposal.command);
                answers.push(proposal.reply);
            }
            next = self.proposals.try_recv().ok();
        }
        Filled { batch: Batch(commands), answers, rest: None }
    }

    /// Hands an entry to openraft, and gives what tells its outcome to those who wait.
    async fn propose(&self, number: u64, batch: Batch<S::Command>, answers: Vec<Answer<S>>) -> OnItsWay {
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
                    for (answer, outcome) in answers.into_iter().zip(outcomes) {
                        // Whoever asked may have gone.
                        let _ = answer.send(Ok(outcome));
                    }
                }
                Err(problem) => {
                    for answer in answers {
                        let _ = answer.send(Err(problem.clone())); // see above
                    }
                }
            }
            number
        })
    }
}
