//! Prometheus metrics of a node, and of the fleet as seen by it.
//!
//! Every metric has the labels `fleet` and `node`: the node that measured it. Names begin with
//! `consort_`, except the process metrics, which have the names of Prometheus' own libraries. Each
//! node counts its own actions, so sums over nodes are right. The state of the fleet (missions,
//! robots) is reported by every node, so take the coordinator's value
//! (`… and on (node) consort_is_leader == 1`), or the maximum.
//!
//! | name | what |
//! |---|---|
//! | `consort_events_total{event}` | events that the node published on the event stream, by kind |
//! | `consort_elections_total` | times that the node was elected coordinator |
//! | `consort_missions_submitted_total` | missions that it acknowledged as coordinator |
//! | `consort_missions_ended_total{state}` | missions that ended while it was the coordinator |
//! | `consort_auctions_total{result}` | auctions that it closed: `awarded` or `no_award` |
//! | `consort_bids_total{verdict}` | answers in them: `viable`, `unviable`, `refused` |
//! | `consort_award_seconds` | histogram: from the commit of a request to the commit of its award |
//! | `consort_tasks_total{result}` | tasks of its robot: `done`, `failed`, `retried`, `alternative` |
//! | `consort_ledger_commands_total` | commands of the ledger that its copy applied |
//! | `consort_bus_messages_total{kind,direction}` | messages that it sent and received itself |
//! | `consort_bus_bytes_total{kind,direction}` | their payloads |
//! | `consort_is_leader` | 1 if it is the coordinator, else 0 |
//! | `consort_term` | its term |
//! | `consort_voters`, `consort_learners` | voters and learners of the ledger, as seen by it |
//! | `consort_quorum_age_seconds` | on the coordinator: time since the last reply of a majority |
//! | `consort_ledger_index` | last entry of the ledger that its copy applied |
//! | `consort_missions{state}` | missions in its copy of the ledger, ended missions included while they are kept |
//! | `consort_nodes{status}` | nodes of the fleet, by their status at this node |
//! | `consort_robot_battery_ratio{robot}` | charge left, 1 is full; in a large fleet from stations, voters and nodes on mains power only |
//! | `consort_robot_age_seconds{robot}` | age of its knowledge of the robot, from the same nodes |
//! | `consort_robot_state{robot,state}` | 1 for the robot's state: `free`, `charging`, `holding`, `suspended`, `out_of_service` |
//! | `consort_gossip_malformed_total` | gossip messages that could not be parsed |
//! | `consort_messages_rejected_total` | messages without a valid signature, or without permission: 0 without certificates |
//! | `consort_gossip_refutations_total` | refutations of suspicions against the node |
//! | `consort_started_at_seconds` | start of the node, in seconds since 1970 |
//! | `process_cpu_seconds_total` | processor time of the process; this and the following on Linux only |
//! | `process_resident_memory_bytes`, `process_virtual_memory_bytes` | memory in use, and reserved |
//! | `process_open_fds`, `process_max_fds` | open files and connections, and their maximum |
//! | `process_start_time_seconds` | start of the process, in seconds since 1970 |

mod counters;
mod node_collector;
mod process;
mod sampled_metric;
mod serve;

pub(crate) use node_collector::MetricSources;
pub(crate) use serve::serve;

use consort_bus::{Direction, Meter};
use consort_fleet::observe::Observer;
use consort_protocol::event::Event;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::KeyKind;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Command;
use counters::EventCounters;
use node_collector::NodeCollector;
use process::ProcessCollector;
use prometheus_client::encoding::text::{encode_eof, encode_registry};
use prometheus_client::registry::Registry;
use std::borrow::Cow;
use std::sync::Arc;

/// The metrics of a node.
pub(crate) struct Metrics {
    registry: Registry,
    process: Registry,
    counts: EventCounters,
    levels: NodeCollector,
}

impl Metrics {
    /// Creates metrics with all counters at zero.
    pub(crate) fn new(fleet: &FleetId, node: &NodeId) -> Arc<Metrics> {
        let by = |name: &'static str, value: String| (Cow::Borrowed(name), Cow::Owned(value));
        let labels = [by("fleet", fleet.to_string()), by("node", node.to_string())];
        let mut registry = Registry::with_prefix_and_labels("consort", labels.clone().into_iter());
        let counts = EventCounters::new(&mut registry);
        let levels = NodeCollector::default();
        registry.register_collector(Box::new(levels.clone()));
        let mut process = Registry::with_labels(labels.into_iter());
        process.register_collector(Box::new(ProcessCollector));
        Arc::new(Metrics { registry, process, counts, levels })
    }

    /// Sets the sources of the node's sampled metrics.
    pub(crate) fn set_sources(&self, watched: MetricSources) {
        self.levels.set_sources(watched);
    }

    /// Returns all metrics as OpenMetrics text.
    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        let encoded = [&self.registry, &self.process].into_iter().try_for_each(|part| encode_registry(&mut text, part));
        encoded.and_then(|()| encode_eof(&mut text)).expect("writing to a string cannot fail");
        text
    }
}

impl Observer for Metrics {
    fn on_event(&self, event: &Event) {
        self.counts.count_event(&event.kind);
    }

    fn on_applied(&self, _: &NodeId, _: Epoch, commands: &[Command]) {
        self.counts.count_commands(commands.len());
    }
}

impl Meter for Metrics {
    fn count(&self, kind: KeyKind, direction: Direction, bytes: usize) {
        self.counts.count_message(kind, direction, bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::event::EventKind;
    use consort_protocol::ledger::MissionState;

    fn publish(metrics: &Metrics, kind: EventKind) {
        metrics.on_event(&Event { node: "ada".parse().unwrap(), sequence: 1, at_ms: 0, kind });
    }

    fn metrics() -> Arc<Metrics> {
        Metrics::new(&"ward".parse().unwrap(), &"ada".parse().unwrap())
    }

    fn line<'a>(text: &'a str, start: &str) -> &'a str {
        let lines: Vec<&str> = text.lines().filter(|line| line.starts_with(start)).collect();
        match lines.as_slice() {
            [line] => line,
            _ => panic!("{start}: {lines:?} in\n{text}"),
        }
    }

    #[test]
    fn events_are_counted_by_kind_with_fleet_and_node() {
        let metrics = metrics();
        publish(&metrics, EventKind::Elected { term: 2, voters: vec![] });
        let mission = || "lab-samples-1".parse().unwrap();
        for state in [MissionState::Running, MissionState::Completed] {
            publish(&metrics, EventKind::Mission { mission: mission(), state, submitted_at_ms: 0 });
        }
        publish(
            &metrics,
            EventKind::TaskEnded { mission: mission(), role: "r1".parse().unwrap(), task: "t".parse().unwrap() },
        );
        let holders = std::collections::BTreeMap::new();
        let epoch = Epoch { term: 1, index: 3 };
        publish(
            &metrics,
            EventKind::Awarded {
                mission: mission(),
                holders,
                promised: std::collections::BTreeMap::new(),
                epoch,
                after_ms: Some(7.0),
            },
        );
        let text = metrics.text();
        let labels = r#"fleet="ward",node="ada""#;
        assert_eq!(line(&text, "consort_elections_total"), format!("consort_elections_total{{{labels}}} 1"));
        let ended = format!(r#"consort_missions_ended_total{{{labels},state="completed"}} 1"#);
        assert!(text.contains(&ended), "{text}");
        assert!(!text.contains(r#"state="running""#), "running is not an end state: {text}");
        assert!(text.contains(&format!(r#"consort_tasks_total{{{labels},result="done"}} 1"#)), "{text}");
        assert!(text.contains(&format!(r#"consort_events_total{{{labels},event="mission"}} 2"#)), "{text}");
        assert_eq!(line(&text, "consort_award_seconds_sum"), format!("consort_award_seconds_sum{{{labels}}} 0.007"));
        assert!(text.ends_with("# EOF\n"), "{text}");
    }

    #[test]
    fn messages_are_counted_by_kind_and_direction_with_their_bytes() {
        let metrics = metrics();
        metrics.count(KeyKind::Gossip, Direction::Sent, 40);
        metrics.count(KeyKind::Gossip, Direction::Sent, 2);
        metrics.count(KeyKind::Gossip, Direction::Received, 5);
        let text = metrics.text();
        let of = |name: &str, direction: &str| {
            format!(r#"consort_bus_{name}_total{{fleet="ward",node="ada",kind="gossip",direction="{direction}"}} "#)
        };
        for expected in [of("messages", "sent") + "2", of("bytes", "sent") + "42", of("bytes", "received") + "5"] {
            assert!(text.contains(&expected), "{expected} in {text}");
        }
    }

    #[tokio::test]
    async fn every_metric_is_documented_and_every_documented_name_exists() {
        let metrics = metrics();
        metrics.levels.set_sources(MetricSources::empty());
        metrics.count(KeyKind::Gossip, Direction::Sent, 1);
        publish(&metrics, EventKind::SteppedDown { term: 1 });
        let text = metrics.text();
        let publish = text.lines().filter_map(|line| line.strip_prefix("# TYPE "));
        let publish: std::collections::BTreeSet<String> = publish
            .map(|line| match line.rsplit_once(' ') {
                Some((name, "counter")) => format!("{name}_total"),
                Some((name, _)) => name.to_owned(),
                None => panic!("{line}"),
            })
            .collect();
        let rows = include_str!("mod.rs").lines().filter(|line| line.starts_with("//! | `"));
        let cells = rows.map(|row| row.split('|').nth(1).unwrap_or_default());
        let names = cells.flat_map(|cell| cell.split('`').skip(1).step_by(2));
        let documented = names.map(|name| name.split('{').next().unwrap_or_default().to_owned()).collect();
        assert_eq!(publish, documented);
    }
}
