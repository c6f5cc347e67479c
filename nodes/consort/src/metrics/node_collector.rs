//! Metrics sampled from a node's state: the fleet as seen by this node.

use super::sampled_metric::SampledMetric;
use consort_bus::clock::Clock;
use consort_bus::trust::SigningBus;
use consort_gossip::SharedKnowledge;
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::ledger::Ledger;
use consort_raft::Replica;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::DescriptorEncoder;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, OnceLock};

/// Sources of a node's metrics.
pub(crate) struct MetricSources {
    /// Its copy of the ledger, if it keeps a copy.
    pub replica: Option<Replica<Ledger>>,
    /// Its knowledge of other nodes.
    pub knowledge: SharedKnowledge,
    /// Its bus, if it has certificates.
    pub signing: Option<Arc<SigningBus>>,
    /// Its clock.
    pub clock: Clock,
    /// Start of the node: milliseconds since 1970.
    pub since_ms: u64,
}

impl MetricSources {
    /// Sources without data.
    #[cfg(test)]
    pub(super) fn empty() -> MetricSources {
        let clock = Clock::virtual_at(0);
        MetricSources { replica: None, knowledge: SharedKnowledge::default(), signing: None, clock, since_ms: 0 }
    }
}

/// Samples the sources, after they have been set.
#[derive(Clone, Default)]
pub(super) struct NodeCollector(Arc<OnceLock<MetricSources>>);

impl fmt::Debug for NodeCollector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Levels").field("watching", &self.0.get().is_some()).finish()
    }
}

impl NodeCollector {
    /// Sets the sources. Later calls have no effect: a process runs a single node.
    pub(super) fn set_sources(&self, watched: MetricSources) {
        let _ = self.0.set(watched);
    }
}

impl Collector for NodeCollector {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let Some(watched) = self.0.get() else { return Ok(()) };
        for level in watched.levels() {
            level.encode(&mut encoder)?;
        }
        Ok(())
    }
}

impl MetricSources {
    fn levels(&self) -> Vec<SampledMetric> {
        let mut levels = self.ledger_metrics();
        levels.extend(self.knowledge_metrics());
        levels.push(SampledMetric::counter(
            "messages_rejected",
            "Messages without a valid signature, or without permission",
            self.signing.as_ref().map_or(0, |signing| signing.rejection_count()) as f64,
        ));
        levels.push(SampledMetric::gauge(
            "started_at_seconds",
            "Start of the node, since 1970",
            self.since_ms as f64 / 1e3,
        ));
        levels
    }

    /// A node without a copy reports zeros, so that sums and alerts work for all nodes.
    fn ledger_metrics(&self) -> Vec<SampledMetric> {
        let leadership = self.replica.as_ref().map(|replica| replica.leadership().borrow().clone());
        let (mut is_leader, mut term, mut voters, mut learners) = (false, 0, 0, 0);
        if let Some(leadership) = leadership {
            (is_leader, term) = (leadership.is_leader, leadership.term);
            (voters, learners) = (leadership.voters.len(), leadership.learners.len());
        }
        let replica = self.replica.as_ref();
        let age = replica.filter(|_| is_leader).and_then(Replica::quorum_ack_age);
        let index = replica.map_or(0, |replica| replica.applied().borrow().index);
        let mut missions: BTreeMap<&'static str, u32> = BTreeMap::new();
        if let Some(replica) = replica {
            replica.read(|ledger| {
                ledger.missions().for_each(|entry| *missions.entry(entry.state.as_str()).or_default() += 1);
            });
        }
        let missions = missions.into_iter().map(|(state, count)| (vec![("state", state.to_owned())], f64::from(count)));
        let age = age.map(|age| (vec![], age.as_secs_f64())).into_iter().collect();
        vec![
            SampledMetric::gauge("is_leader", "1 if this node is the coordinator", f64::from(u8::from(is_leader))),
            SampledMetric::gauge("term", "This node's term", term as f64),
            SampledMetric::gauge("voters", "Voters, as seen by this node", voters as f64),
            SampledMetric::gauge("learners", "Learners of the ledger, as seen by this node", learners as f64),
            SampledMetric::labelled_gauge(
                "quorum_age_seconds",
                "On the coordinator: time since the last reply of a majority",
                age,
            ),
            SampledMetric::gauge("ledger_index", "Last entry of the ledger applied by this copy", index as f64),
            SampledMetric::labelled_gauge("missions", "Missions in this copy of the ledger", missions.collect()),
        ]
    }

    fn knowledge_metrics(&self) -> Vec<SampledMetric> {
        let mut nodes: BTreeMap<&'static str, u32> = BTreeMap::new();
        self.knowledge.statuses().values().for_each(|status| *nodes.entry(status.as_str()).or_default() += 1);
        let nodes = nodes.into_iter().map(|(status, count)| (vec![("status", status.to_owned())], f64::from(count)));
        let now = self.clock.now();
        let (mut batteries, mut ages, mut states) = (vec![], vec![], vec![]);
        // Without the motion of robots, charges and ages are those of the latest changes of records.
        let receives_motion = self.knowledge.receives_motion();
        self.knowledge.read(|base| {
            for (node, heard) in base.iter() {
                let Some(worker) = &heard.knowledge().robot else { continue };
                let robot = || ("robot", node.to_string());
                if receives_motion {
                    batteries.push((vec![robot()], worker.battery.get()));
                    ages.push((vec![robot()], heard.age(now).as_secs_f64()));
                }
                states.push((vec![robot(), ("state", state(worker).to_owned())], 1.0));
            }
        });
        let counters = self.knowledge.counters();
        vec![
            SampledMetric::labelled_gauge("nodes", "Nodes of the fleet, by their status at this node", nodes.collect()),
            SampledMetric::labelled_gauge("robot_battery_ratio", "Charge left; 1 is full", batteries),
            SampledMetric::labelled_gauge("robot_age_seconds", "Age of this node's knowledge of the robot", ages),
            SampledMetric::labelled_gauge("robot_state", "1 for the robot's state", states),
            SampledMetric::counter(
                "gossip_malformed",
                "Gossip messages that could not be parsed",
                counters.malformed as f64,
            ),
            SampledMetric::counter(
                "gossip_refutations",
                "Refutations of suspicions against this node",
                counters.refutations as f64,
            ),
        ]
    }
}

fn state(worker: &RobotKnowledge) -> &'static str {
    match &worker.availability {
        Availability::Free if worker.is_charging() => "charging",
        Availability::Free => "free",
        Availability::Holding { suspended: false, .. } => "holding",
        Availability::Holding { suspended: true, .. } => "suspended",
        Availability::OutOfService { .. } => "out_of_service",
    }
}
