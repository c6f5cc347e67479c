//! There is at most a single leader at a time, and leader ids only increase.
//!
//! A leader id consists of a term and a leader; openraft orders leaders within a term too. A leader
//! was elected later than all previous leaders. So a node never leads again after another leader
//! has begun: not even for an instant, and not after a restart that made voters forget their votes.
//!
//! Raft itself allows a leader that is lost to a majority to count itself leader until its check-quorum
//! timeout, while another is elected (`actors/raft/src/leader_loss.rs`). The virtual network ends the
//! presence of a live node only after the link lease, which is longer than that timeout.

use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::ids::NodeId;
use consort_raft::LeaderId;
use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Default)]
pub(super) struct OneLeader {
    /// Nodes that currently count themselves leader.
    leading: BTreeMap<NodeId, LeaderId>,
    latest: Option<(LeaderId, NodeId)>,
}

impl Invariant for OneLeader {
    fn name(&self) -> &'static str {
        "one_leader"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::TestAction { node, action: "killed" } => {
                self.leading.remove(node);
            }
            Observation::LeadershipChanged { node, leading_as: None, .. } => {
                self.leading.remove(node);
            }
            Observation::LeadershipChanged { node, leading_as: Some(leader_id), .. } => {
                self.leading.insert(node.clone(), *leader_id);
                if let Some((other, since)) = self.leading.iter().find(|(other, _)| *other != node) {
                    return Err(format!("{node} leads as {leader_id} while {other} leads as {since}").into());
                }
                match &self.latest {
                    Some((latest, previous)) if latest > leader_id || (latest == leader_id && previous != node) => {
                        return Err(format!("{node} leads as {leader_id} after {previous} has led as {latest}").into());
                    }
                    _ => self.latest = Some((*leader_id, node.clone())),
                }
            }
            _ => {}
        }
        Ok(())
    }
}
