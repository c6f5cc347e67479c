//! How a node leaves: for a while, keeping its vote, or for good.
//!
//! | | for a while (SIGTERM) | for good (`consort leave`) |
//! |---|---|---|
//! | the robot's role | stays in its store, for its next life | is given back |
//! | the lead | is handed over | is handed over |
//! | the vote | is kept: a restart costs the fleet no voter | is taken over by another, or removed |

use crate::bus::{BusError, Sample, SharedBus, Stream};
use crate::gossip::{GossipHandle, SharedKnowledge};
use crate::raft::{Replica, TransferError};
use crate::robot::RobotMessage;
use crate::timing::TimingParameters;
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::Ledger;
use consort_protocol::message::Beacon;
use ractor::ActorRef;
use serde::Serialize;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::{Instant, timeout};
use tracing::{debug, info, warn};

/// How a node left for good.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct DecommissionReport {
    /// Which node.
    pub node: NodeId,
    /// Who coordinates in its place, if it did.
    pub successor: Option<NodeId>,
    /// Whether it had a vote, or kept a copy of the ledger, when it began to leave.
    pub kept_ledger: bool,
    /// Whether nobody counts on it any more. If not, the autopilot will see that it is gone after a while.
    pub released: bool,
    /// Whether its robot holds no role any more.
    pub role_given_back: bool,
}

/// Why a node stays. It goes on as if nobody had asked: its robot has not been told.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecommissionError {
    /// With it, the ledger would go.
    #[error(
        "{node} is the only voter, and there is no other node that may vote: with it the ledger would go. Start another \
         node that may vote, or stop this one (SIGTERM) and keep its data"
    )]
    OnlyVoter {
        /// Which node.
        node: NodeId,
    },
    /// Of two voters neither can do without the other. Ordinary while the other is down.
    #[error(
        "{node} and {other} are the only voters, and {other} has not relieved {node} in time: without its vote the ledger \
         would stand still. See that {other} runs and ask again, or stop this one (SIGTERM) and keep its data"
    )]
    QuorumNeeded {
        /// Which node.
        node: NodeId,
        /// The other voter.
        other: NodeId,
    },
}

/// What became of a leaver's vote.
struct Vote {
    /// Whether there was one, or a copy of the ledger.
    kept_ledger: bool,
    successor: Option<NodeId>,
    released: bool,
}

/// What it takes to leave. Clones belong to the same node.
#[derive(Clone)]
pub struct Decommission {
    pub(crate) node: NodeId,
    pub(crate) keys: Keys,
    /// Within the node's cluster.
    pub(crate) bus: SharedBus,
    pub(crate) replica: Option<Replica<Ledger>>,
    pub(crate) gossip: GossipHandle,
    pub(crate) knowledge: SharedKnowledge,
    pub(crate) robot: Option<ActorRef<RobotMessage>>,
    pub(crate) terms: LeaseTerms,
    pub(crate) times: TimingParameters,
}

impl Decommission {
    /// Hands over the lead, if this node has it, and waits until somebody else leads. The node may be stopped then: its vote
    /// and its robot's role wait for its next life.
    pub async fn step_down(&self) -> Option<NodeId> {
        let replica = self.replica.as_ref()?;
        let successor = match self.hand_over(replica).await {
            Ok(successor) => successor,
            Err(TransferError::NotLeader) => return None,
            Err(problem) => {
                warn!(node = %self.node, %problem, "goes without handing over");
                return None;
            }
        };
        // Until it leads, this node's vote may be needed.
        let mut leadership = replica.leadership();
        let led = leadership.wait_for(|now| now.leader.is_some());
        if timeout(self.times.election_max, led).await.is_err() {
            warn!(node = %self.node, %successor, "stops before its successor leads");
        }
        Some(successor)
    }

    async fn hand_over(&self, replica: &Replica<Ledger>) -> Result<NodeId, TransferError> {
        let shunned: BTreeSet<NodeId> = self.knowledge.read(|base| {
            let leaving = base.iter().filter(|(_, heard)| heard.record.knowledge.leaving);
            leaving.map(|(node, _)| node.clone()).collect()
        });
        let successor = replica.transfer_leadership(&shunned, self.times.election_min).await?;
        info!(node = %self.node, %successor, "handed over the coordination");
        Ok(successor)
    }

    /// Leaves for good: hands over the lead, waits, for some seconds at most, until its vote is another's or is removed, and
    /// then has its robot give its role back. The node is to be stopped then.
    ///
    /// # Errors
    /// [`LeaveError`]: it stays.
    pub async fn run(&self) -> Result<DecommissionReport, DecommissionError> {
        info!(node = %self.node, "leaves for good");
        let Vote { kept_ledger, successor, released } = self.give_up_vote().await?;
        // Not before: the robot of a node that must stay works and bids as if nobody had asked.
        let role_given_back = self.give_back_role().await;
        Ok(DecommissionReport { node: self.node.clone(), successor, kept_ledger, released, role_given_back })
    }

    async fn give_up_vote(&self) -> Result<Vote, DecommissionError> {
        // The beacons are heard from before anything changes.
        let beacons = self.bus.subscribe(&self.keys.write(&Key::Beacon)).await;
        self.tell_leaving(true);
        let member = |replica: &&Replica<Ledger>| {
            let now = replica.leadership().borrow().clone();
            now.voters.contains_key(&replica.id()) || now.learners.contains_key(&replica.id())
        };
        let Some(replica) = self.replica.as_ref().filter(member) else {
            return Ok(Vote { kept_ledger: false, successor: None, released: true });
        };
        let mut successor = None;
        let deadline = Instant::now() + self.times.election_max * 8;
        let released = self.until_released(replica, beacons, deadline, &mut successor).await;
        if !released && let Err(needed) = self.can_be_spared(replica) {
            self.tell_leaving(false);
            return Err(needed);
        }
        Ok(Vote { kept_ledger: true, successor, released })
    }

    /// Hands over the lead whenever this node has it, and waits until whoever leads counts on this node's vote no more.
    async fn until_released(
        &self,
        replica: &Replica<Ledger>,
        beacons: Result<Stream<Sample>, BusError>,
        deadline: Instant,
        successor: &mut Option<NodeId>,
    ) -> bool {
        let Ok(mut beacons) = beacons else { return false };
        let mut leadership = replica.leadership();
        loop {
            let leads = async { leadership.wait_for(|now| now.is_leader).await.map(drop) };
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
                // At first, or because nobody else was elected: a leader cannot take its own vote away. No deadline breaks off
                // a handing over: it would leave a leader that has resigned, and stays.
                Ok(()) = leads => match self.hand_over(replica).await {
                    Ok(node) => *successor = Some(node),
                    Err(problem) => {
                        // While it is alone, its autopilot looks for somebody to join it.
                        debug!(node = %self.node, %problem, "cannot hand over yet");
                        tokio::time::sleep(self.times.beacon_interval).await;
                    }
                },
            }
        }
    }

    /// Whether the voters are a majority without this one, which is still one of them.
    fn can_be_spared(&self, replica: &Replica<Ledger>) -> Result<(), DecommissionError> {
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

    fn tell_leaving(&self, leaving: bool) {
        // A gossip that has stopped cannot tell; then the autopilot finds out by itself.
        let _ = self.gossip.update_with(move |knowledge| knowledge.leaving = leaving);
    }

    async fn give_back_role(&self) -> bool {
        let Some(robot) = &self.robot else { return true };
        let within = self.terms.lease + self.terms.grace;
        let (done, answered) = ractor::concurrency::oneshot();
        if robot.cast(RobotMessage::Decommission { timeout: within, done: done.into() }).is_err() {
            return false;
        }
        timeout(within + Duration::from_secs(1), answered).await.is_ok_and(|said| said.unwrap_or(false))
    }
}
