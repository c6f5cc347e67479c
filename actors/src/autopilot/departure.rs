//! How a node leaves: for a while, keeping its vote, or for good.
//!
//! | | for a while (SIGTERM) | for good (`consort leave`) |
//! |---|---|---|
//! | the robot's role | stays in its store, for its next life | is given back |
//! | the lead | is handed over | is handed over |
//! | the vote | is kept: a restart costs the fleet no voter | is taken over by another, or removed |

use crate::bus::SharedBus;
use crate::gossip::{GossipHandle, SharedKnowledge};
use crate::replica::{HandOverError, Replica};
use crate::robot::RobotMessage;
use crate::timing::Times;
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
use tokio::time::{Instant, timeout, timeout_at};
use tracing::{info, warn};

/// How a node left for good.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Farewell {
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

/// Why a node stays. Nothing was changed, but that its robot has put down its role.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LeaveError {
    /// With it, the ledger would go.
    #[error(
        "{node} is the only voter, and there is no other node that may vote: with it the ledger would go. Start another \
         node that may vote, or stop this one (SIGTERM) and keep its data"
    )]
    OnlyVoter {
        /// Which node.
        node: NodeId,
    },
}

/// What it takes to leave. Clones belong to the same node.
#[derive(Clone)]
pub struct Leaver {
    pub(crate) node: NodeId,
    pub(crate) keys: Keys,
    /// Within the node's cluster.
    pub(crate) bus: SharedBus,
    pub(crate) replica: Option<Replica<Ledger>>,
    pub(crate) gossip: GossipHandle,
    pub(crate) knowledge: SharedKnowledge,
    pub(crate) robot: Option<ActorRef<RobotMessage>>,
    pub(crate) terms: LeaseTerms,
    pub(crate) times: Times,
}

impl Leaver {
    /// Hands over the lead, if this node has it, and waits until somebody else leads. The node may be stopped then: its vote
    /// and its robot's role wait for its next life.
    pub async fn step_down(&self) -> Option<NodeId> {
        let replica = self.replica.as_ref()?;
        let successor = self.hand_over(replica).await.ok()?;
        // Until it leads, this node's vote may be needed.
        let mut leadership = replica.leadership();
        let led = leadership.wait_for(|now| now.leader.is_some());
        if timeout(self.times.election_max, led).await.is_err() {
            warn!(node = %self.node, %successor, "stops before its successor leads");
        }
        Some(successor)
    }

    async fn hand_over(&self, replica: &Replica<Ledger>) -> Result<NodeId, HandOverError> {
        let shunned: BTreeSet<NodeId> = self.knowledge.read(|base| {
            let leaving = base.iter().filter(|(_, heard)| heard.record.knowledge.leaving);
            leaving.map(|(node, _)| node.clone()).collect()
        });
        let handed = replica.hand_over(&shunned, self.times.election_min).await;
        match &handed {
            Ok(successor) => info!(node = %self.node, %successor, "handed over the coordination"),
            Err(HandOverError::NotLeader) => {}
            Err(problem) => warn!(node = %self.node, %problem, "goes without handing over"),
        }
        handed
    }

    /// Leaves for good: gives back its robot's role, hands over the lead, and waits, for some seconds at most, until its
    /// vote is another's or is removed. The node is to be stopped then.
    ///
    /// # Errors
    /// [`LeaveError`]: it stays.
    pub async fn for_good(&self) -> Result<Farewell, LeaveError> {
        let deadline = Instant::now() + self.times.election_max * 8;
        info!(node = %self.node, "leaves for good");
        // The beacons are heard from before anything changes.
        let beacons = self.bus.subscribe(&self.keys.write(&Key::Beacon)).await;
        let role = self.give_back_role();
        let vote = async {
            // A gossip that has stopped cannot tell; then the autopilot finds out by itself.
            let _ = self.gossip.update_with(|knowledge| knowledge.leaving = true);
            let Some(replica) = &self.replica else { return Ok((false, None, true)) };
            let member = |replica: &Replica<Ledger>| {
                let now = replica.leadership().borrow().clone();
                now.voters.contains_key(&replica.id()) || now.observers.contains_key(&replica.id())
            };
            if !member(replica) {
                return Ok((false, None, true));
            }
            let mut successor = None;
            loop {
                match self.hand_over(replica).await {
                    Ok(node) => successor = Some(node),
                    // The autopilot, which is this node's own, looks for somebody to join it.
                    Err(HandOverError::Alone) if Instant::now() < deadline => {
                        tokio::time::sleep(self.times.beacon).await;
                        continue;
                    }
                    Err(HandOverError::Alone) => {
                        let _ = self.gossip.update_with(|knowledge| knowledge.leaving = false);
                        return Err(LeaveError::OnlyVoter { node: self.node.clone() });
                    }
                    Err(_) => {}
                }
                break;
            }
            let Ok(mut beacons) = beacons else { return Ok((true, successor, false)) };
            let mut leadership = replica.leadership();
            let released = timeout_at(deadline, async {
                loop {
                    let leads_again = async { leadership.wait_for(|now| now.is_me).await.map(drop) };
                    tokio::select! {
                        sample = beacons.recv() => {
                            let Some(sample) = sample else { return false };
                            let beacon = codec::decode::<Beacon>(&sample.payload);
                            if beacon.is_ok_and(|beacon| beacon.node != self.node && !beacon.voters.contains(&self.node)) {
                                return true;
                            }
                        }
                        // Nobody else was elected; a leader cannot take its own vote away.
                        Ok(()) = leads_again => match self.hand_over(replica).await {
                            Ok(node) => successor = Some(node),
                            Err(_) => tokio::time::sleep(self.times.beacon).await,
                        },
                    }
                }
            });
            let released = released.await.unwrap_or(false);
            Ok((true, successor, released))
        };
        let (role_given_back, vote) = tokio::join!(role, vote);
        let (kept_ledger, successor, released) = vote?;
        Ok(Farewell { node: self.node.clone(), successor, kept_ledger, released, role_given_back })
    }

    async fn give_back_role(&self) -> bool {
        let Some(robot) = &self.robot else { return true };
        let within = self.terms.lease + self.terms.grace;
        let (done, answered) = ractor::concurrency::oneshot();
        if robot.cast(RobotMessage::Leave { within, done: done.into() }).is_err() {
            return false;
        }
        timeout(within + Duration::from_secs(1), answered).await.is_ok_and(|said| said.unwrap_or(false))
    }
}
