//! View of the leadership at a node, derived from openraft's metrics and from acknowledgements.

use super::acknowledgements::LeaderAcks;
use super::types::{LeaderId, LogId, Metrics, Peer, RaftId, leader_id_of};
use consort_bus::BootInstant;
use consort_protocol::ids::NodeId;
use openraft::metrics::RaftServerMetrics;
use openraft::{ServerState, StoredMembership};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::watch;

/// Metrics of openraft: all metrics, sent at every event, and the server metrics (voters and
/// leader), sent only on a change.
pub(super) struct MetricsFeed {
    pub(super) metrics: watch::Receiver<Metrics>,
    pub(super) server_metrics: watch::Receiver<RaftServerMetrics<RaftId, Peer>>,
}

impl MetricsFeed {
    /// Waits for a change that may affect the view derived from `latest`. The log of a follower
    /// does not affect it, and changes with every message.
    async fn changed(&mut self, latest: &Metrics) -> Result<(), watch::error::RecvError> {
        let agrees = |metrics: &Metrics, now: &RaftServerMetrics<RaftId, Peer>| {
            (metrics.vote, metrics.state, &metrics.membership_config) == (now.vote, now.state, &now.membership_config)
        };
        if latest.state == ServerState::Leader {
            return self.metrics.changed().await;
        }
        self.server_metrics.wait_for(|now| !agrees(latest, now)).await?;
        // The full metrics are sent last.
        let server_metrics = &mut self.server_metrics;
        self.metrics.wait_for(|metrics| agrees(metrics, &server_metrics.borrow_and_update())).await.map(drop)
    }
}

/// This node's view of the leadership. A watch shows the latest view. A leadership that began and
/// ended in between is detected by the greater leader id of the next.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LeadershipView {
    /// Term of this node. It also grows by failed campaigns.
    pub term: u64,
    /// Leader that this node currently accepts, possibly itself; `None` while the leader is
    /// unknown, or while this leader has lost its quorum. A learner that is cut off keeps the last
    /// known leader.
    pub leader_id: Option<LeaderId>,
    /// Name of the leader, if this node has its membership entry yet.
    pub leader: Option<NodeId>,
    /// This node is the leader, has applied all entries committed before its term, and was
    /// acknowledged by a majority within `check_quorum_timeout` of the settings.
    pub is_leader: bool,
    /// This node was elected, but no majority replies: it must not act, and a proposal is rejected
    /// at once.
    pub lost_quorum: bool,
    /// Voters.
    pub voters: BTreeMap<RaftId, NodeId>,
    /// While the voters are being changed: the voters after the change. Until then, a majority of
    /// the former voters is needed as well.
    pub pending_voters: Option<BTreeSet<RaftId>>,
    /// Learners: members without a vote.
    pub learners: BTreeMap<RaftId, NodeId>,
}

impl LeadershipView {
    /// Checks whether a node is a voter or a learner, or will be a voter.
    pub fn is_member(&self, id: RaftId) -> bool {
        let is_pending = self.pending_voters.as_ref().is_some_and(|pending| pending.contains(&id));
        is_pending || self.name_of(id).is_some()
    }

    /// Returns the name of a voter or learner.
    pub(super) fn name_of(&self, id: RaftId) -> Option<&NodeId> {
        self.voters.get(&id).or_else(|| self.learners.get(&id))
    }

    pub(super) fn without_leader(self) -> LeadershipView {
        LeadershipView { leader_id: None, leader: None, is_leader: false, lost_quorum: false, ..self }
    }
}

/// Term in which this node resigned as leader; 0 for none.
#[derive(Debug, Default)]
pub(super) struct ResignedTerm(AtomicU64);

impl ResignedTerm {
    /// Records that this node no longer leads in `term`, regardless of openraft's state.
    pub(super) fn resign(&self, term: u64) {
        self.0.store(term, Ordering::SeqCst);
    }

    /// Withdraws the resignation: no target was found, and this node stays the leader.
    pub(super) fn withdraw(&self) {
        self.0.store(0, Ordering::SeqCst);
    }

    /// Checks whether this node has resigned in `term`.
    pub(super) fn covers(&self, term: u64) -> bool {
        let resigned = self.0.load(Ordering::SeqCst);
        resigned != 0 && resigned == term
    }
}

/// Derives the [`LeadershipView`] from openraft's metrics. When a majority stops replying, it
/// withdraws the leadership in the view, and then suspends the appends of the node (check-quorum).
pub(super) struct LeadershipMonitor {
    pub(super) check_quorum_timeout: Duration,
    pub(super) election_max: Duration,
    pub(super) leadership: watch::Sender<LeadershipView>,
    pub(super) resigned_term: Arc<ResignedTerm>,
    pub(super) quorum_ack: watch::Sender<Option<BootInstant>>,
    pub(super) appends_suspended: Arc<AtomicBool>,
    pub(super) quorum_confirmed: Arc<AtomicBool>,
    /// Last entry in the log of this node when it was started.
    pub(super) last_at_start: Option<LogId>,
    /// Term in which this node was elected and the time at which this was noticed, while it is the
    /// leader.
    pub(super) election: Option<(LeaderId, BootInstant)>,
    pub(super) me: RaftId,
    pub(super) acks: watch::Receiver<LeaderAcks>,
    /// Inputs of the view published last.
    pub(super) published_inputs: Option<ViewInputs>,
}

impl LeadershipMonitor {
    pub(super) async fn run(mut self, mut feed: MetricsFeed) {
        loop {
            let latest = feed.metrics.borrow_and_update().clone();
            let mut ack_at = None;
            if latest.state == ServerState::Leader {
                let halves = latest.membership_config.membership().get_joint_config();
                ack_at = self.acks.borrow_and_update().quorum_ack(&latest.vote, self.me, halves);
            }
            self.quorum_ack.send_if_modified(|known| std::mem::replace(known, ack_at) != ack_at);
            let elected_at = self.record_election(&latest);
            if self.publish_until_changed(&latest, ack_at, elected_at, &mut feed).await.is_err() {
                break;
            }
        }
        self.quorum_ack.send_replace(None);
        self.leadership.send_modify(|now| {
            *now = LeadershipView { term: now.term, ..LeadershipView::default() };
        });
    }

    /// Returns the time at which this node became leader, if it is the leader.
    fn record_election(&mut self, latest: &Metrics) -> Option<BootInstant> {
        let leader_id = leader_id_of(&latest.vote).filter(|_| latest.state == ServerState::Leader);
        if self.election.map(|(leader_id, _)| leader_id) != leader_id {
            self.election = leader_id.map(|leader_id| (leader_id, BootInstant::now()));
        }
        self.election.map(|(_, at)| at)
    }

    /// Publishes the view that follows from `latest`, and the reduced view once no majority has
    /// replied for too long.
    async fn publish_until_changed(
        &mut self,
        latest: &Metrics,
        ack_at: Option<BootInstant>,
        elected_at: Option<BootInstant>,
        feed: &mut MetricsFeed,
    ) -> Result<(), watch::error::RecvError> {
        // A new leader has not been acknowledged yet. For the duration of the timeout this does not
        // count as a lost quorum.
        let Some(timeout_at) = ack_at.or(elected_at).map(|at| at + self.check_quorum_timeout) else {
            self.appends_suspended.store(false, Ordering::Relaxed);
            self.publish(latest, Quorum::Unknown);
            return self.next_change(latest, feed).await;
        };
        if timeout_at > BootInstant::now() {
            self.appends_suspended.store(false, Ordering::Relaxed);
            self.publish(latest, if ack_at.is_some() { Quorum::Confirmed } else { Quorum::Unknown });
            tokio::select! {
                biased;
                changed = self.next_change(latest, feed) => return changed,
                () = tokio::time::sleep_until(timeout_at.to_tokio()) => {}
            }
        }
        // Metrics are sent with each heartbeat, so this is evaluated often enough.
        self.appends_suspended.store(self.suspends_appends(timeout_at.elapsed()), Ordering::Relaxed);
        self.publish(latest, Quorum::Lost);
        self.next_change(latest, feed).await
    }

    /// Waits for new metrics of openraft, or for an acknowledgement outside openraft.
    async fn next_change(&mut self, latest: &Metrics, feed: &mut MetricsFeed) -> Result<(), watch::error::RecvError> {
        tokio::select! {
            biased;
            changed = feed.changed(latest) => changed,
            acked = self.acks.changed() => acked,
        }
    }

    /// Checks whether a leader suspends its appends at `elapsed` after it lost its quorum. It
    /// suspends them for four times the longest election timeout, in which any other majority
    /// elects a leader. Then it sends for that time once, and so on.
    fn suspends_appends(&self, elapsed: Duration) -> bool {
        let round = self.election_max * 5;
        elapsed.as_nanos() % round.as_nanos().max(1) < (self.election_max * 4).as_nanos()
    }

    fn publish(&mut self, metrics: &Metrics, quorum: Quorum) {
        self.quorum_confirmed.store(quorum == Quorum::Confirmed, Ordering::Relaxed);
        let resigned = self.resigned_term.covers(metrics.current_term);
        let inputs = ViewInputs::of(metrics, quorum, self.last_at_start, resigned);
        // Metrics are sent with every message, and rarely change the view.
        if self.published_inputs.as_ref() == Some(&inputs) {
            return;
        }
        let mut next = inputs.view();
        self.published_inputs = Some(inputs);
        self.leadership.send_if_modified(|now| {
            // Checked here, under the lock of the watch: a resignation is recorded first, and then
            // takes that lock.
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

/// Contact of an elected leader with its majority.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quorum {
    /// Not acknowledged yet, or not elected.
    Unknown,
    Confirmed,
    Lost,
}

/// Everything that the view depends on.
#[derive(Debug, PartialEq)]
pub(super) struct ViewInputs {
    term: u64,
    leader_id: Option<LeaderId>,
    elected: bool,
    caught_up: bool,
    quorum: Quorum,
    resigned: bool,
    membership: Arc<StoredMembership<RaftId, Peer>>,
}

impl ViewInputs {
    /// Collects the inputs from openraft's metrics and from the state of the quorum. A resignation
    /// is only included so that it counts as a change: the publisher of the view checks it again.
    fn of(metrics: &Metrics, quorum: Quorum, last_at_start: Option<LogId>, resigned: bool) -> ViewInputs {
        let running = metrics.running_state.is_ok() && metrics.state != ServerState::Shutdown;
        let leader_id = leader_id_of(&metrics.vote).filter(|_| running && metrics.vote.is_committed());
        // The first entry of a term is openraft's blank entry: once it is applied, all entries
        // committed before are applied.
        let term_has_begun =
            leader_id.is_some() && metrics.last_applied.map(|at| at.leader_id.term) == leader_id.map(|now| now.term);
        // A restarted leader continues in its old term, where that entry proves nothing: the
        // entries in its log may have been committed and acknowledged before, and are applied again
        // only after a majority has confirmed them.
        let resumed = last_at_start.filter(|last| leader_id.is_some_and(|now| now.term == last.leader_id.term));
        ViewInputs {
            term: metrics.current_term,
            leader_id,
            elected: running && metrics.state == ServerState::Leader,
            caught_up: term_has_begun && resumed.is_none_or(|last| metrics.last_applied >= Some(last)),
            quorum,
            resigned,
            membership: Arc::clone(&metrics.membership_config),
        }
    }

    /// Returns the view that follows from these inputs.
    fn view(&self) -> LeadershipView {
        let lost_quorum = self.elected && self.quorum == Quorum::Lost;
        let leader_id = self.leader_id.filter(|_| !lost_quorum);
        let membership = self.membership.membership();
        let name = |id: RaftId| membership.get_node(&id).map(|peer| peer.name.clone());
        let named = |ids: Vec<RaftId>| ids.into_iter().filter_map(|id| Some((id, name(id)?))).collect();
        LeadershipView {
            term: self.term,
            leader_id,
            leader: leader_id.and_then(|leader_id| name(leader_id.leader)),
            is_leader: self.elected && self.caught_up && self.quorum == Quorum::Confirmed,
            lost_quorum,
            voters: named(membership.voter_ids().collect()),
            pending_voters: membership.get_joint_config().get(1).cloned(),
            learners: named(membership.learner_ids().collect()),
        }
    }
}
