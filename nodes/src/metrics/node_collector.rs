//! What is measured when it is asked for: the fleet as this node knows it.

use super::sampled_metric::SampledMetric;
use consort_actors::clock::Clock;
use consort_actors::gossip::SharedKnowledge;
use consort_actors::raft::Replica;
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::ledger::Ledger;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::DescriptorEncoder;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, OnceLock};

/// Where a node's knowledge is read.
pub struct MetricSources {
    /// Its copy of the ledger, if it keeps one.
    pub replica: Option<Replica<Ledger>>,
    /// What it has heard of others.
    pub knowledge: SharedKnowledge,
    /// Its clock.
    pub clock: Clock,
    /// When it began: milliseconds since 1970.
    pub since_ms: u64,
}

impl MetricSources {
    /// Of a node that knows nothing.
    #[cfg(test)]
    pub(super) fn empty() -> MetricSources {
        let clock = Clock::virtual_at(0);
        MetricSources { replica: None, knowledge: SharedKnowledge::default(), clock, since_ms: 0 }
    }
}

/// Measures what is watched, once there is something.
#[derive(Clone, Default)]
pub(super) struct NodeCollector(Arc<OnceLock<MetricSources>>);

impl fmt::Debug for NodeCollector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Levels").field("watching", &self.0.get().is_some()).finish()
    }
}

impl NodeCollector {
    /// The first that is given is watched for good: a node lives once.
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
        let mut levels = self.of_ledger();
        levels.extend(self.of_knowledge());
        levels.push(SampledMetric::gauge(
            "started_at_seconds",
            "When the node began, since 1970",
            self.since_ms as f64 / 1e3,
        ));
        levels
    }

    /// A node without a copy tells zeros, so that sums and alarms need not know which nodes keep one.
    fn of_ledger(&self) -> Vec<SampledMetric> {
        let leadership = self.replica.as_ref().map(|replica| replica.leadership().borrow().clone());
        let (mut coordinates, mut term, mut voters, mut observers) = (false, 0, 0, 0);
        if let Some(leadership) = leadership {
            (coordinates, term) = (leadership.is_leader, leadership.term);
            (voters, observers) = (leadership.voters.len(), leadership.learners.len());
        }
        let replica = self.replica.as_ref();
        let age = replica.filter(|_| coordinates).and_then(Replica::quorum_ack_age);
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
            SampledMetric::gauge("coordinates", "Whether this node coordinates", f64::from(u8::from(coordinates))),
            SampledMetric::gauge("term", "This node's term", term as f64),
            SampledMetric::gauge("voters", "Nodes that vote, as this one knows", voters as f64),
            SampledMetric::gauge(
                "observers",
                "Nodes that keep the ledger without a vote, as this one knows",
                observers as f64,
            ),
            SampledMetric::labelled_gauge(
                "quorum_age_seconds",
                "Of a coordinator: how long ago a majority answered",
                age,
            ),
            SampledMetric::gauge("ledger_index", "The last entry of the ledger that this copy took in", index as f64),
            SampledMetric::labelled_gauge("missions", "Missions in this copy of the ledger", missions.collect()),
        ]
    }

    fn of_knowledge(&self) -> Vec<SampledMetric> {
        let mut nodes: BTreeMap<&'static str, u32> = BTreeMap::new();
        self.knowledge.statuses().values().for_each(|status| *nodes.entry(status.as_str()).or_default() += 1);
        let nodes = nodes.into_iter().map(|(status, count)| (vec![("status", status.to_owned())], f64::from(count)));
        let now = self.clock.now();
        let (mut batteries, mut ages, mut states) = (vec![], vec![], vec![]);
        self.knowledge.read(|base| {
            for (node, heard) in base.iter() {
                let Some(worker) = &heard.record.knowledge.robot else { continue };
                let robot = || ("robot", node.to_string());
                batteries.push((vec![robot()], worker.battery.get()));
                ages.push((vec![robot()], heard.age(now).as_secs_f64()));
                states.push((vec![robot(), ("state", state(worker).to_owned())], 1.0));
            }
        });
        let counters = self.knowledge.counters();
        vec![
            SampledMetric::labelled_gauge("nodes", "Nodes of the fleet, as this one judges them", nodes.collect()),
            SampledMetric::labelled_gauge("robot_battery_ratio", "Charge left; 1 is full", batteries),
            SampledMetric::labelled_gauge("robot_age_seconds", "How old this node's knowledge of the robot is", ages),
            SampledMetric::labelled_gauge("robot_state", "1 for what the robot is", states),
            SampledMetric::counter(
                "gossip_malformed",
                "Messages of gossip that could not be read",
                counters.malformed as f64,
            ),
            SampledMetric::counter(
                "gossip_returns",
                "Times that others wrongly judged this node down",
                counters.refutations as f64,
            ),
        ]
    }
}

fn state(worker: &RobotKnowledge) -> &'static str {
    match &worker.availability {
        Availability::Free => "free",
        Availability::Holding { suspended: false, .. } => "holding",
        Availability::Holding { suspended: true, .. } => "suspended",
        Availability::OutOfService { .. } => "out_of_service",
    }
}
