//! What a node believes of who leads, and how it comes to believe it.

use super::leadership_transfer::ResignedTerm;
use super::network::LeaderAcks;
use super::types::{LeaderId, LogId, Peer, RaftId, leader_id_of};
use consort_protocol::ids::NodeId;
use consort_protocol::mutants::{self, Mutant};
use openraft::metrics::RaftServerMetrics;
use openraft::{ServerState, StoredMembership};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

pub(super) type Metrics = openraft::RaftMetrics<RaftId, Peer>;

/// What openraft tells of itself: everything at every event, and apart from it, only when it changes, who votes and leads.
pub(super) struct MetricsFeed {
    pub(super) metrics: watch::Receiver<Metrics>,
    pub(super) server_metrics: watch::Receiver<RaftServerMetrics<RaftId, Peer>>,
}

impl MetricsFeed {
    /// Waits for what may change the belief that followed from `latest`. What a follower has in its log changes none, and
    /// comes with every message.
    async fn changed(&mut self, latest: &Metrics) -> Result<(), watch::error::RecvError> {
        let agrees = |all: &Metrics, now: &RaftServerMetrics<RaftId, Peer>| {
            (all.vote, all.state, &all.membership_config) == (now.vote, now.state, &now.membership_config)
        };
        if latest.state == ServerState::Leader {
            return self.metrics.changed().await;
        }
        self.server_metrics.wait_for(|now| !agrees(latest, now)).await?;
        // What tells everything is sent last.
        let standing = &mut self.server_metrics;
        self.metrics.wait_for(|all| agrees(all, &standing.borrow_and_update())).await.map(drop)
    }
}

/// Who leads, as this node believes. A watch shows the latest belief; a reign that came and went in between is seen
/// by the next one's being greater.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LeadershipView {
    /// This node's term. It also grows by candidacies that fail.
    pub term: u64,
    /// The reign this node accepts at present, its own included; `None` while it knows of none, or has lost its
    /// majority. A node that is cut off as an observer goes on believing in the last it heard of.
    pub leader_id: Option<LeaderId>,
    /// The name of the reign's leader, if this node knows its membership yet.
    pub leader: Option<NodeId>,
    /// Whether this node leads, holds all that was committed before its reign, and has been acknowledged by a majority
    /// not longer ago than `quorum_silence_max` of the settings.
    pub is_leader: bool,
    /// Whether this node was elected but hears no majority: it must not act, and a proposal is refused at once.
    pub lost_quorum: bool,
    /// Who votes.
    pub voters: BTreeMap<RaftId, NodeId>,
    /// While voters are being changed: those that vote in the end. Until then, a majority of the former ones counts too.
    pub pending_voters: Option<BTreeSet<RaftId>>,
    /// Who is replicated to without a vote.
    pub learners: BTreeMap<RaftId, NodeId>,
}

impl LeadershipView {
    pub(super) fn without_leader(self) -> LeadershipView {
        LeadershipView { leader_id: None, leader: None, is_leader: false, lost_quorum: false, ..self }
    }
}

/// Turns openraft's metrics into [`Leadership`], doubts it when the majority falls silent, and then mutes the node.
pub(super) struct LeadershipMonitor {
    pub(super) check_quorum_timeout: Duration,
    pub(super) election_max: Duration,
    pub(super) leadership: watch::Sender<LeadershipView>,
    pub(super) resigned_term: Arc<ResignedTerm>,
    pub(super) quorum_ack: watch::Sender<Option<Instant>>,
    pub(super) appends_suspended: Arc<AtomicBool>,
    /// The last entry that this node found in its log when it was started.
    pub(super) last_at_start: Option<LogId>,
    /// The reign in which this node was elected, if it leads, and since when it knows.
    pub(super) election: Option<(LeaderId, Instant)>,
    /// Whether the metrics are new: the ages in them count from when they came.
    pub(super) metrics_are_new: bool,
    pub(super) quorum_ack_by_metrics: Option<Instant>,
    pub(super) me: RaftId,
    pub(super) acks: watch::Receiver<LeaderAcks>,
    /// On what grounds the present belief was told.
    pub(super) published_inputs: Option<ViewInputs>,
}

impl LeadershipMonitor {
    pub(super) async fn run(mut self, mut feed: MetricsFeed) {
        loop {
            self.metrics_are_new |= feed.metrics.has_changed().unwrap_or(false);
            let latest = feed.metrics.borrow_and_update().clone();
            if std::mem::take(&mut self.metrics_are_new) {
                // Metrics are sent at the instant they are taken, and openraft takes them at every event. Its whole
                // milliseconds round the age down, so one is added.
                let age = latest.millis_since_quorum_ack.map(|ms| Duration::from_millis(ms + 1));
                self.quorum_ack_by_metrics = age.and_then(|age| Instant::now().checked_sub(age));
            }
            let mut acked = self.quorum_ack_by_metrics;
            if latest.state == ServerState::Leader {
                let halves = latest.membership_config.membership().get_joint_config();
                acked = acked.max(self.acks.borrow_and_update().quorum_ack(&latest.vote, self.me, halves));
            }
            self.quorum_ack.send_if_modified(|known| std::mem::replace(known, acked) != acked);
            let elected_at = self.note_election(&latest);
            if self.believe_until_changed(&latest, acked, elected_at, &mut feed).await.is_err() {
                break;
            }
        }
        self.quorum_ack.send_replace(None);
        self.leadership.send_modify(|now| {
            *now = LeadershipView { term: now.term, ..LeadershipView::default() };
        });
    }

    /// Since when this node leads, if it does.
    fn note_election(&mut self, latest: &Metrics) -> Option<Instant> {
        let reign = leader_id_of(&latest.vote).filter(|_| latest.state == ServerState::Leader);
        if self.election.map(|(reign, _)| reign) != reign {
            self.election = reign.map(|reign| (reign, Instant::now()));
        }
        self.election.map(|(_, at)| at)
    }

    /// Tells what follows from `latest`, and what no longer does once the majority has been silent for too long.
    async fn believe_until_changed(
        &mut self,
        latest: &Metrics,
        acked: Option<Instant>,
        elected_at: Option<Instant>,
        feed: &mut MetricsFeed,
    ) -> Result<(), watch::error::RecvError> {
        // A fresh leader has not been acknowledged yet; that is no silence to complain of, for a while.
        let Some(doubt_at) = acked.or(elected_at).map(|at| at + self.check_quorum_timeout) else {
            self.appends_suspended.store(false, Ordering::Relaxed);
            self.tell(latest, Quorum::Unknown);
            return self.news(latest, feed).await;
        };
        if doubt_at > Instant::now() {
            self.appends_suspended.store(false, Ordering::Relaxed);
            self.tell(latest, if acked.is_some() { Quorum::Hears } else { Quorum::Unknown });
            tokio::select! {
                biased;
                changed = self.news(latest, feed) => return changed,
                () = tokio::time::sleep_until(doubt_at) => {}
            }
        }
        if mutants::is_active(Mutant::NoCheckQuorum) {
            self.tell(latest, Quorum::Hears);
            return self.news(latest, feed).await;
        }
        // Metrics come with each beat, so this is looked at often enough.
        self.appends_suspended.store(self.falls_silent(doubt_at.elapsed()), Ordering::Relaxed);
        self.tell(latest, Quorum::Silent);
        self.news(latest, feed).await
    }

    /// Waits for openraft's metrics, or for an answer beside it.
    async fn news(&mut self, latest: &Metrics, feed: &mut MetricsFeed) -> Result<(), watch::error::RecvError> {
        tokio::select! {
            biased;
            changed = feed.changed(latest) => {
                self.metrics_are_new = true;
                changed
            }
            answered = self.acks.changed() => answered,
        }
    }

    /// Whether a leader says nothing at `doubted` after it began to doubt its majority: four times the longest
    /// election timeout, in which any other majority finds a leader, then once that time aloud, and so on.
    fn falls_silent(&self, doubted: Duration) -> bool {
        let round = self.election_max * 5;
        doubted.as_nanos() % round.as_nanos().max(1) < (self.election_max * 4).as_nanos()
    }

    fn tell(&mut self, metrics: &Metrics, quorum: Quorum) {
        let resigned = self.resigned_term.covers(metrics.current_term);
        let grounds = ViewInputs::of(metrics, quorum, self.last_at_start, resigned);
        // Metrics come with every message, and seldom change what is believed.
        if self.published_inputs.as_ref() == Some(&grounds) {
            return;
        }
        let mut next = grounds.belief();
        self.published_inputs = Some(grounds);
        self.leadership.send_if_modified(|now| {
            // Asked here, under the watch's lock: whoever resigns does so first and then takes that lock.
            if self.resigned_term.covers(next.term) {
                next = std::mem::take(&mut next).without_leader();
            }
            let changed = *now != next;
            if changed {
                *now = next;
            }
            changed
        });
    }
}

/// What an elected leader knows of its majority.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quorum {
    /// Not acknowledged yet, or not elected.
    Unknown,
    Hears,
    Silent,
}

/// All that a belief depends on.
#[derive(Debug, PartialEq)]
pub(super) struct ViewInputs {
    term: u64,
    reign: Option<LeaderId>,
    elected: bool,
    caught_up: bool,
    quorum: Quorum,
    resigned: bool,
    membership: Arc<StoredMembership<RaftId, Peer>>,
}

impl ViewInputs {
    /// What openraft's metrics say, and what is known of the majority. A node that has resigned only counts as changed: who
    /// tells of a belief asks for that again.
    fn of(metrics: &Metrics, quorum: Quorum, found: Option<LogId>, resigned: bool) -> ViewInputs {
        let running = metrics.running_state.is_ok() && metrics.state != ServerState::Shutdown;
        let reign = leader_id_of(&metrics.vote).filter(|_| running && metrics.vote.is_committed());
        // The first entry of a reign is openraft's blank one: once it is applied, so is all that was committed before.
        let begun = reign.is_some() && metrics.last_applied.map(|at| at.leader_id.term) == reign.map(|now| now.term);
        // A leader that was started anew leads on in its old reign, where that entry says nothing: what it had in its log
        // may have been committed and acknowledged before, and is applied anew only after a majority has confirmed it.
        let resumed = found.filter(|last| reign.is_some_and(|now| now.term == last.leader_id.term));
        ViewInputs {
            term: metrics.current_term,
            reign,
            elected: running && metrics.state == ServerState::Leader,
            caught_up: begun && resumed.is_none_or(|last| metrics.last_applied >= Some(last)),
            quorum,
            resigned,
            membership: Arc::clone(&metrics.membership_config),
        }
    }

    /// What a node believes on these grounds.
    fn belief(&self) -> LeadershipView {
        let cut_off = self.elected && self.quorum == Quorum::Silent;
        let reign = self.reign.filter(|_| !cut_off);
        let membership = self.membership.membership();
        let name = |id: RaftId| membership.get_node(&id).map(|peer| peer.name.clone());
        let named = |ids: Vec<RaftId>| ids.into_iter().filter_map(|id| Some((id, name(id)?))).collect();
        LeadershipView {
            term: self.term,
            leader_id: reign,
            leader: reign.and_then(|reign| name(reign.leader)),
            is_leader: self.elected && self.caught_up && self.quorum == Quorum::Hears,
            lost_quorum: cut_off,
            voters: named(membership.voter_ids().collect()),
            pending_voters: membership.get_joint_config().get(1).cloned(),
            learners: named(membership.learner_ids().collect()),
        }
    }
}
