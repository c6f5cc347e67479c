//! Leaving of a node: temporarily, with its vote kept, or for good (decommission).
//!
//! | | temporarily (SIGTERM) | for good (`consort leave`) |
//! |---|---|---|
//! | role of the robot | stays in its store, for the next start | is released |
//! | leadership | is transferred | is transferred |
//! | vote | is kept: a restart costs the fleet no voter | is given to another node, or removed |

use crate::robot::RobotMessage;
use consort_bus::{BusError, Sample, SharedBus, Stream};
use consort_gossip::{GossipHandle, SharedKnowledge};
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::Ledger;
use consort_protocol::message::Beacon;
use consort_protocol::timing::TimingParameters;
use consort_raft::{Replica, TransferError};
use ractor::ActorRef;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::{Instant, timeout};
use tracing::{debug, info, warn};

/// Report on the decommission of a node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DecommissionReport {
    /// Node that left.
    pub node: NodeId,
    /// New coordinator, if the node was the coordinator.
    pub successor: Option<NodeId>,
    /// The node was a voter or learner when it began to leave.
    pub was_member: bool,
    /// The node is no longer a voter. If `false`, the autopilot removes it after a while.
    pub vote_released: bool,
    /// The robot of the node holds no role any more.
    pub role_released: bool,
}

/// The node stays. It continues as before; its robot was not notified.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecommissionError {
    /// Without the node, the ledger would be lost.
    #[error(
        "{node} is the only voter, and there is no other node that may vote: without {node} the ledger would be lost. Start \
         another node that may vote, or stop {node} (SIGTERM) and keep its data"
    )]
    OnlyVoter {
        /// Node that stays.
        node: NodeId,
    },
    /// Neither of two voters has a quorum without the other. Expected while the other voter is
    /// down.
    #[error(
        "{node} and {other} are the only voters, and {other} has not relieved {node} in time: without the vote of {node} the \
         ledger would have no quorum. Check that {other} runs and try again, or stop {node} (SIGTERM) and keep its data"
    )]
    QuorumNeeded {
        /// Node that stays.
        node: NodeId,
        /// The other voter.
        other: NodeId,
    },
}

/// Result of giving up the vote.
struct Vote {
    /// The node was a voter or learner.
    was_member: bool,
    successor: Option<NodeId>,
    vote_released: bool,
}

/// Performs the leaving of a node. Clones belong to the same node.
#[derive(Clone)]
pub struct Decommission {
    pub(crate) node: NodeId,
    pub(crate) keys: Keys,
    /// Bus within the node's cluster.
    pub(crate) bus: SharedBus,
    pub(crate) replica: Option<Replica<Ledger>>,
    pub(crate) gossip: GossipHandle,
    pub(crate) knowledge: SharedKnowledge,
    pub(crate) robot: Option<ActorRef<RobotMessage>>,
    pub(crate) terms: LeaseTerms,
    pub(crate) timing: TimingParameters,
}

impl Decommission {
    /// Transfers leadership, if this node is the leader, and waits until another node leads. The
    /// node may be stopped then: its vote and the role of its robot are kept for the next start.
    pub(crate) async fn step_down(&self) -> Option<NodeId> {
        let replica = self.replica.as_ref()?;
        let successor = match self.transfer_leadership(replica).await {
            Ok(successor) => successor,
            Err(TransferError::NotLeader) => return None,
            Err(error) => {
                warn!(node = %self.node, %error, "stopping without a leadership transfer");
                return None;
            }
        };
        // This node's vote may be needed until the successor leads.
        let mut leadership = replica.leadership();
        let has_leader = leadership.wait_for(|now| now.leader.is_some());
        if timeout(self.timing.election_max, has_leader).await.is_err() {
            warn!(node = %self.node, %successor, "stopping before the successor is the leader");
        }
        Some(successor)
    }

    async fn transfer_leadership(&self, replica: &Replica<Ledger>) -> Result<NodeId, TransferError> {
        let avoid: BTreeSet<NodeId> = self.knowledge.read(|base| {
            let leaving = base.iter().filter(|(_, entry)| entry.record.knowledge.leaving);
            leaving.map(|(node, _)| node.clone()).collect()
        });
        let successor = replica.transfer_leadership(&avoid, self.timing.election_min).await?;
        info!(node = %self.node, %successor, "leadership transferred");
        Ok(successor)
    }

    /// Decommissions the node: transfers leadership, waits, for some seconds at most, until its
    /// vote is given to another node or removed, and then makes its robot release its role. The
    /// node is to be stopped then.
    ///
    /// # Errors
    /// [`DecommissionError`]: the node stays.
    pub async fn run(&self) -> Result<DecommissionReport, DecommissionError> {
        info!(node = %self.node, "decommissioning started");
        let Vote { was_member, successor, vote_released } = self.give_up_vote().await?;
        // Not earlier: the robot of a node that must stay keeps working and bidding.
        let role_released = self.release_role().await;
        Ok(DecommissionReport { node: self.node.clone(), successor, was_member, vote_released, role_released })
    }

    async fn give_up_vote(&self) -> Result<Vote, DecommissionError> {
        // Subscribes to the beacons before anything changes.
        let beacons = self.bus.subscribe(&self.keys.write(&Key::Beacon)).await;
        self.publish_leaving(true);
        let is_member = |replica: &&Replica<Ledger>| {
            let now = replica.leadership().borrow().clone();
            now.voters.contains_key(&replica.id()) || now.learners.contains_key(&replica.id())
        };
        let Some(replica) = self.replica.as_ref().filter(is_member) else {
            return Ok(Vote { was_member: false, successor: None, vote_released: true });
        };
        let mut successor = None;
        let deadline = Instant::now() + self.timing.election_max * 8;
        let vote_released = self.wait_vote_released(replica, beacons, deadline, &mut successor).await;
        if !vote_released && let Err(error) = self.check_quorum_without_self(replica) {
            self.publish_leaving(false);
            return Err(error);
        }
        Ok(Vote { was_member: true, successor, vote_released })
    }

    /// Transfers leadership whenever this node is the leader, and waits until the leader no longer
    /// lists this node as a voter.
    async fn wait_vote_released(
        &self,
        replica: &Replica<Ledger>,
        beacons: Result<Stream<Sample>, BusError>,
        deadline: Instant,
        successor: &mut Option<NodeId>,
    ) -> bool {
        let Ok(mut beacons) = beacons else { return false };
        let mut leadership = replica.leadership();
        loop {
            let is_leader = async { leadership.wait_for(|now| now.is_leader).await.map(drop) };
            tokio::select! {
                biased;
                () = tokio::time::sleep_until(deadline) => return false,
                sample = beacons.recv() => {
                    let Some(sample) = sample else { return false };
                    let beacon = codec::decode::<Beacon>(&sample.payload);
                    if beacon.is_ok_and(|beacon| beacon.node != self.node && !beacon.voters.contains(&self.node)) {
                        return true;
                    }
                }
                // At the start, or because no other node was elected: a leader cannot remove its
                // own vote. The deadline does not cancel a transfer: that would leave a leader that
                // has resigned, and stays.
                Ok(()) = is_leader => match self.transfer_leadership(replica).await {
                    Ok(node) => *successor = Some(node),
                    Err(error) => {
                        // While it is the only voter, its autopilot looks for a node to add.
                        debug!(node = %self.node, %error, "leadership transfer not possible yet");
                        tokio::time::sleep(self.timing.beacon_interval).await;
                    }
                },
            }
        }
    }

    /// Checks whether the other voters have a quorum without this node, which is still a voter.
    fn check_quorum_without_self(&self, replica: &Replica<Ledger>) -> Result<(), DecommissionError> {
        let mut others = replica.leadership().borrow().voters.clone();
        if others.remove(&replica.id()).is_none() {
            return Ok(());
        }
        let node = self.node.clone();
        let mut others = others.into_values();
        match (others.next(), others.next()) {
            (None, _) => Err(DecommissionError::OnlyVoter { node }),
            (Some(other), None) => Err(DecommissionError::QuorumNeeded { node, other }),
            (Some(_), Some(_)) => Ok(()),
        }
    }

    fn publish_leaving(&self, leaving: bool) {
        // A stopped gossiper cannot publish it; then the autopilot detects the absence by itself.
        let _ = self.gossip.update_with(move |knowledge| knowledge.leaving = leaving);
    }

    async fn release_role(&self) -> bool {
        let Some(robot) = &self.robot else { return true };
        let release_timeout = self.terms.lease + self.terms.grace;
        let (done, result) = ractor::concurrency::oneshot();
        if robot.cast(RobotMessage::Decommission { timeout: release_timeout, done: done.into() }).is_err() {
            return false;
        }
        timeout(release_timeout + Duration::from_secs(1), result).await.is_ok_and(|released| released.unwrap_or(false))
    }
}
