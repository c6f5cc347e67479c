//! When to stand for election, when to beat, and when a leader must fall silent: what openraft 0.9 leaves out.
//!
//! openraft's own elections are switched off. A follower of it waits `election_max` *and* its timeout, which it draws
//! once in its life; on the virtual bus that made takeovers of 504 ms (median, heartbeat 50 ms, election 150 to 300 ms)
//! where this file takes 176. Also measured with openraft alone: a voter that was out of reach for five seconds
//! unseats the leader each time it returns, for by then it has raised its term in vain some ten times; and a leader
//! that is heard by all and hears nobody stays leader for ever, of a fleet that commits nothing. None of what is here
//! touches Raft's safety, which rests on openraft's handling of terms, votes and logs alone.
//!
//! - *Canvass* (pre-vote; Ongaro's dissertation, 9.6): a node that has not heard a leader for a time drawn anew from
//!   `election_min..election_max` asks the other voters whether they hear one, and whether its log is as long as
//!   theirs. It stands for election only if a majority would have it.
//! - *Patience with slow disks*: a voter that is about to bring its vote to disk, or has just done so, neither stands nor
//!   would have anybody else, for [`SYNCS_TO_LEAD`] times as long as that took it. Else a candidate that waits for votes
//!   would be overtaken by the next one, in the next term, for ever.
//! - *Refusal*: a voter grants no vote within `election_min` of its leader's last word (openraft's leader lease, set
//!   to that), unless that leader has resigned ([`super::succession`]). So a leader that a majority acknowledged more
//!   recently is the only one.
//! - *Muting* (etcd's check quorum): a leader that no majority acknowledges sends no appends, so that those who hear
//!   it become free to elect another. It tries again now and then, in case they only were away.
//! - *Beat*: openraft looks at its own heartbeat every 1.5 intervals only, so it is driven from here. A voter that has
//!   not answered the last one is asked beside openraft, whose core may be waiting for a disk, here or there. Its answer
//!   counts as an acknowledgement, so it binds as openraft's does: see [`Ear::heeds`].

use super::network::{HeartbeatReply, RaftClient};
use super::settings::{APPEND_TIMEOUT, RaftSettings};
use super::types::{LogId, Peer, Raft, RaftId, StateMachine, Vote};
use futures::FutureExt as _;
use openraft::ServerState;
use openraft::metrics::RaftServerMetrics;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, sleep_until};

/// How many syncs one after another it takes from a vote that is given until its leader is heard, and one to spare: the
/// winner brings its reign to disk and then the reign's first entry, while it is asked for by others.
const SYNCS_TO_LEAD: u32 = 4;

/// A question before standing: may I?
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct PreVoteRequest {
    /// The last entry of the asker's log.
    pub(super) last_log_id: Option<LogId>,
}

/// Whom this node has heard, and when.
#[derive(Debug)]
pub(super) struct LeaderContact(Mutex<Heard>);

#[derive(Debug, Clone, Copy)]
struct Heard {
    leader: Instant,
    voted: Option<Instant>,
    /// When this node last heard a leader to which it is still bound: it votes for nobody else for a while.
    bound: Option<Instant>,
    /// Votes that openraft may be about to give, this node's own candidacy included, and when the first of them began.
    deciding: u32,
    began: Instant,
    /// Until when those that were given are waited for.
    patient_until: Instant,
    /// The latest vote known to be given.
    ballot: Vote,
    /// Appends that openraft has in hand, and when the last one began or ended.
    appends: u32,
    moved: Instant,
    resigned: Option<Instant>,
}

impl LeaderContact {
    /// As if a leader had been heard just now: a node that starts gives it time to speak.
    pub(super) fn new() -> Self {
        let now = Instant::now();
        LeaderContact(Mutex::new(Heard {
            leader: now,
            voted: None,
            // Whom its former life was bound to, nobody knows.
            bound: Some(now),
            deciding: 0,
            began: now,
            patient_until: now,
            ballot: Vote::default(),
            appends: 0,
            moved: now,
            resigned: None,
        }))
    }

    fn lock(&self) -> MutexGuard<'_, Heard> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A leader speaks, by whose vote `known` is prevailed over or met: whether its reign is not over.
    pub(super) fn record_leader(&self, vote: &Vote, known: &Vote) -> bool {
        self.lock().note_leader(vote, known)
    }

    /// A leader asks whether this node is there. If so, it is bound by its answer as by an append: so it must not be about
    /// to vote, and not be stuck.
    pub(super) fn answer_heartbeat(&self, vote: &Vote, known: &Vote) -> HeartbeatReply {
        let mut heard = self.lock();
        let busy = heard.appends > 0;
        let stuck = busy && heard.moved.elapsed() >= APPEND_TIMEOUT;
        let follows = heard.deciding == 0 && !stuck && heard.note_leader(vote, known);
        HeartbeatReply { follows, busy }
    }

    /// openraft is given an append; it has it in hand until the answer is dropped.
    pub(super) fn begin_append(&self) -> PendingAppend<'_> {
        let mut heard = self.lock();
        if heard.appends == 0 {
            heard.moved = Instant::now();
        }
        heard.appends += 1;
        PendingAppend(self)
    }

    /// Whether openraft may be asked for a vote: this node is bound to no leader. Until [`Ear::decided`], it binds itself to
    /// none.
    pub(super) fn try_begin_vote(&self, election_min: Duration) -> bool {
        let mut heard = self.lock();
        let free = heard.bound.is_none_or(|at| at.elapsed() >= election_min);
        if free && heard.deciding == 0 {
            heard.began = Instant::now();
        }
        heard.deciding += u32::from(free);
        free
    }

    /// What came of it.
    pub(super) fn end_vote(&self, given: Option<Vote>) {
        let mut heard = self.lock();
        heard.deciding -= 1;
        heard.patient_until =
            heard.patient_until.max(Instant::now() + heard.began.elapsed().min(APPEND_TIMEOUT) * SYNCS_TO_LEAD);
        heard.ballot = given.map_or(heard.ballot, |given| if given > heard.ballot { given } else { heard.ballot });
    }

    /// A leader that goes has freed this node, and given its vote to another.
    pub(super) fn record_release(&self, given: Vote) {
        let mut heard = self.lock();
        heard.bound = None;
        if given > heard.ballot {
            heard.ballot = given;
        }
    }

    /// The leader has resigned: nobody needs to wait for its word any more.
    pub(super) fn record_leader_resigned(&self) {
        let mut heard = self.lock();
        heard.bound = None;
        heard.leader = heard.leader.checked_sub(Duration::from_secs(60)).unwrap_or(heard.leader);
    }

    /// A candidate was given this node's vote: it needs a few round trips to make itself heard.
    pub(super) fn record_vote_granted(&self) {
        self.lock().voted = Some(Instant::now());
    }

    /// This node gives up the lead, and its vote to its successor. Another is to be elected, be it the successor or not.
    pub(super) fn record_own_resignation(&self) {
        let now = Some(Instant::now());
        let mut heard = self.lock();
        (heard.voted, heard.resigned) = (now, now);
    }

    /// Whether others have had as long as `patience` to be elected, if this node gave up the lead.
    fn gave_way(&self, patience: Duration) -> bool {
        self.lock().resigned.is_none_or(|at| at.elapsed() >= patience)
    }

    fn leader(&self) -> Instant {
        self.lock().leader
    }

    /// Whether no leader has been heard for `patience`, and no candidate is waited for.
    pub(super) fn no_leader_for(&self, patience: Duration, heartbeat: Duration) -> bool {
        let heard = self.lock();
        let waits = heard.deciding > 0 || heard.patient_until > Instant::now();
        heard.leader.elapsed() >= patience && !waits && heard.voted.is_none_or(|at| at.elapsed() >= heartbeat)
    }
}

impl Heard {
    fn note_leader(&mut self, vote: &Vote, known: &Vote) -> bool {
        // A leader's vote is committed: it prevails over candidates of its own term, and over all earlier ones.
        let rank = |vote: &Vote| (vote.leader_id().term, vote.is_committed());
        let reigns = rank(vote) >= rank(known).max(rank(&self.ballot));
        if reigns {
            self.leader = Instant::now();
            self.bound = Some(self.leader);
        }
        reigns
    }
}

/// An append that openraft has in hand.
pub(super) struct PendingAppend<'a>(&'a LeaderContact);

impl Drop for PendingAppend<'_> {
    fn drop(&mut self) {
        let mut heard = self.0.lock();
        heard.appends -= 1;
        heard.moved = Instant::now();
    }
}

/// Stands for election when no leader is heard and a majority would have this node.
pub(super) async fn run_elections<S: StateMachine>(
    raft: Raft<S>,
    board: RaftClient,
    ear: Arc<LeaderContact>,
    settings: RaftSettings,
    seed: u64,
) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let beat = settings.heartbeat;
    let mut metrics = raft.server_metrics();
    loop {
        if !may_stand(&metrics.borrow(), board.me) {
            // Who leads hears no leader, and who has no vote is told of none: they would ask for ever. Whoever has just got
            // a vote leaves the founder of the ledger a moment to lead.
            if metrics.wait_for(|now| may_stand(now, board.me)).await.is_err() {
                return;
            }
            sleep(chance.random_range(beat / 8..beat / 4)).await;
        }
        let patience = chance.random_range(settings.election_min..settings.election_max);
        sleep_until(ear.leader() + patience).await;
        let since = Instant::now();
        while ear.leader().elapsed() >= patience && may_stand(&metrics.borrow(), board.me) {
            // The question takes time: a leader may have spoken, or a candidate got our vote, while it was answered.
            let stands = ear.gave_way(settings.election_max)
                && ear.no_leader_for(patience, beat)
                && would_be_elected(&raft, &board, beat).await
                && ear.no_leader_for(patience, beat);
            let stands = stands && ear.try_begin_vote(settings.election_min);
            if stands {
                if raft.trigger().elect().await.is_err() {
                    return;
                }
                // openraft takes what it is asked in order: after this it has voted for itself.
                let vote = raft.with_raft_state(|state| *state.vote_ref()).await;
                ear.end_vote(vote.ok());
            }
            // An election takes a few round trips; those whose elections failed together part by chance. Whoever has asked
            // for longer than an election may take waits for links or nodes, and asks less often.
            let long = since.elapsed() >= settings.election_max;
            let pause = match (stands, long) {
                (true, _) => beat..beat * 2,
                (false, false) => beat / 8..beat / 4,
                (false, true) => beat / 2..beat,
            };
            sleep(chance.random_range(pause)).await;
        }
    }
}

/// Whether a node votes and does not lead.
fn may_stand(metrics: &RaftServerMetrics<RaftId, Peer>, me: RaftId) -> bool {
    let votes = metrics.membership_config.membership().get_joint_config().iter().any(|half| half.contains(&me));
    votes && metrics.state != ServerState::Leader
}

async fn would_be_elected<S: StateMachine>(raft: &Raft<S>, board: &RaftClient, limit: Duration) -> bool {
    let voters = raft.server_metrics().borrow().membership_config.membership().get_joint_config().clone();
    let question = PreVoteRequest { last_log_id: raft.data_metrics().borrow().last_log };
    let mut willing = BTreeSet::from([board.me]);
    let others: BTreeSet<RaftId> = voters.iter().flatten().copied().filter(|voter| *voter != board.me).collect();
    let question = &question;
    board
        .query_until_majority(
            &voters,
            &mut willing,
            &others,
            |line| async move { line.pre_vote(question, limit).await },
        )
        .await
}

/// Has openraft send a heartbeat at the rate that the settings say, and asks those beside it that have not answered.
/// A leader whose own core hangs for longer than an append may take says nothing more: another does better.
pub(super) async fn send_heartbeats<S: StateMachine>(raft: Raft<S>, board: RaftClient, heartbeat: Duration) {
    let metrics = raft.server_metrics();
    let mut beats = interval(heartbeat);
    beats.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut pulse = None;
    loop {
        beats.tick().await;
        let (vote, voters) = {
            let now = metrics.borrow();
            if now.state != ServerState::Leader {
                continue;
            }
            (now.vote, now.membership_config.membership().voter_ids().collect::<BTreeSet<_>>())
        };
        if raft.trigger().heartbeat().await.is_err() {
            return;
        }
        let (asked_at, answer) = pulse.get_or_insert_with(|| {
            let raft = raft.clone();
            (Instant::now(), async move { raft.with_raft_state(|_| ()).await.is_ok() }.boxed())
        });
        let hangs = asked_at.elapsed() >= APPEND_TIMEOUT;
        if answer.now_or_never().is_some() {
            pulse = None;
        } else if hangs {
            continue;
        }
        let late =
            |voter: &RaftId| board.last_contacts.of(*voter).is_none_or(|at| at.elapsed() >= heartbeat.mul_f64(1.5));
        for voter in voters.into_iter().filter(|voter| *voter != board.me).filter(late) {
            let line = board.peer(voter);
            tokio::spawn(async move { line.heartbeat(vote).await });
        }
    }
}
