//! One leads at a time, and reigns only grow.
//!
//! A reign is a term and its leader; openraft orders leaders within a term too. Whoever leads was elected later than all
//! who led before, so nobody leads again after another has begun: not even for an instant, and not after a restart that
//! made voters forget whom they had voted for.

use super::Invariant;
use crate::{Fleet, Observation};
use consort_actors::raft::LeaderId;
use consort_protocol::ids::NodeId;
use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Default)]
pub(super) struct OneLeader {
    /// Who believes at this instant that it leads.
    leading: BTreeMap<NodeId, LeaderId>,
    latest: Option<(LeaderId, NodeId)>,
}

impl Invariant for OneLeader {
    fn name(&self) -> &'static str {
        "one_leader"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), String> {
        match entry {
            Observation::TestAction { node, action: "killed" } => {
                self.leading.remove(node);
            }
            Observation::LeadershipChanged { node, leading_as: None, .. } => {
                self.leading.remove(node);
            }
            Observation::LeadershipChanged { node, leading_as: Some(reign), .. } => {
                self.leading.insert(node.clone(), *reign);
                if let Some((other, since)) = self.leading.iter().find(|(other, _)| *other != node) {
                    return Err(format!("{node} leads in reign {reign} while {other} leads in {since}"));
                }
                match &self.latest {
                    Some((latest, who)) if latest > reign || (latest == reign && who != node) => {
                        return Err(format!("{node} leads in reign {reign} after {who} has led in {latest}"));
                    }
                    _ => self.latest = Some((*reign, node.clone())),
                }
            }
            _ => {}
        }
        Ok(())
    }
}
