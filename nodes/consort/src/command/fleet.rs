//! `consort fleet`: shows the nodes of a fleet, the feedback and the readings of its robots, and its coordinator.

use super::alarm::alarms_text;
use super::close::closures_text;
use super::limit::limits_text;
use crate::client::{Client, QueryFlags};
use crate::exit::Failure;
use crate::output;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use consort_protocol::scalar::Scalar;
use consort_protocol::view::{
    ChargerView, CoordinatorView, FleetView, NodeStatus, NodeView, RobotView, WithProvenance,
};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Show the nodes of a fleet, the feedback and the readings of its robots, and its coordinator
///
/// The data comes from the nearest node; each row has the age of its last contact. Robots that people
/// hold or maintain are shown with these orders. Alarms, closures and speed limits follow, which a node
/// without a ledger does not know, and the chargers that are leased or for which robots wait. The nearest
/// node queries the nodes of the robots for the readings, and for the feedback of the goals in progress.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort fleet
  consort fleet --json --connect tcp/192.0.2.7:7447")]
pub struct Args {
    #[command(flatten)]
    ask: QueryFlags,
}

/// The views that the command shows. With `--json`, fields that a newer node has added are printed
/// as well, so the views are passed on as they are.
#[derive(Serialize, Deserialize)]
struct FleetStatus<Fleet = FleetView, Coordinator = WithProvenance<CoordinatorView>> {
    fleet: Fleet,
    coordinator: Coordinator,
    /// Readings of the robots that have any.
    readings: ValuesByNode,
    /// Feedback of the goals in progress, of the robots that have any.
    feedback: ValuesByNode,
}

/// Values of the drivers of robots, by the robot's node and name.
type ValuesByNode = BTreeMap<NodeId, BTreeMap<String, Scalar>>;

/// Runs the command.
///
/// # Errors
/// See `Client::query_view`.
pub fn run(args: Args) -> Result<(), Failure> {
    let look = async |client: &mut Client| {
        let fleet = client.query_view(&Key::ViewFleet).await?;
        let coordinator = client.query_view(&Key::ViewCoordinator).await?;
        let robots = client.query_views(&client.keys().any_robot_view()).await;
        let (readings, feedback) = driver_values(robots);
        Ok(output::to_value(&FleetStatus::<Value, Value> { fleet, coordinator, readings, feedback }))
    };
    args.ask.print(look, format_fleet)
}

/// Returns the readings and the feedback in views of robots.
fn driver_values(robots: Vec<Value>) -> (ValuesByNode, ValuesByNode) {
    let (mut readings, mut feedback) = (ValuesByNode::new(), ValuesByNode::new());
    for view in robots.into_iter().filter_map(|view| RobotView::deserialize(view).ok()) {
        let node = view.node.node;
        for (all, own) in [(&mut readings, view.readings), (&mut feedback, view.feedback)] {
            let own = own.filter(|values| !values.is_empty());
            all.extend(own.map(|values| (node.clone(), values)));
        }
    }
    (readings, feedback)
}

fn format_fleet(FleetStatus { fleet, coordinator, readings, feedback }: &FleetStatus) -> String {
    let mut heads = vec![
        "NODE",
        "ALIVE",
        "VOTES",
        "PLACE",
        "BATTERY",
        "SPEED",
        "HOLDS",
        "ENSEMBLES",
        "CONTACT",
        "SKILLS",
        "ATTRIBUTES",
    ];
    let has_orders = fleet.nodes.iter().any(|node| !node.orders.is_empty());
    heads.extend(has_orders.then_some("ORDERS"));
    let columns = [("FEEDBACK", feedback), ("READINGS", readings)].into_iter().filter(|(_, values)| !values.is_empty());
    let columns: Vec<(&str, &ValuesByNode)> = columns.collect();
    heads.extend(columns.iter().map(|(head, _)| *head));
    let cell = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    let rows = fleet.nodes.iter().map(|node| {
        let orders = has_orders.then(|| cell(node.orders.problem()));
        let values = columns.iter().map(|(_, values)| cell(values.get(&node.node).map(format_values)));
        row(node, fleet, &coordinator.content).into_iter().chain(orders).chain(values).collect::<Vec<String>>()
    });
    let rows: Vec<Vec<String>> = std::iter::once(heads.into_iter().map(str::to_owned).collect()).chain(rows).collect();
    let lines = [format_coordinator(coordinator), output::table(&rows)];
    let rest = [orders_text(fleet), chargers_text(&fleet.chargers)].into_iter().filter(|text| !text.is_empty());
    lines.into_iter().chain(rest).collect::<Vec<_>>().join("\n")
}

/// Formats the alarms, closures and speed limits, a line for each.
fn orders_text(FleetView { alarms, closures, speed_limits, .. }: &FleetView) -> String {
    let known = [
        ("alarms", alarms.as_deref().map(alarms_text)),
        ("closures", closures.as_deref().map(closures_text)),
        ("speed limits", speed_limits.as_deref().map(limits_text)),
    ];
    let unknown: Vec<&str> = known.iter().filter(|(_, text)| text.is_none()).map(|(what, _)| *what).collect();
    let unknown = (!unknown.is_empty()).then(|| format!("{}: unknown to this node", unknown.join(", ")));
    let lines = known.into_iter().filter_map(|(_, text)| text.filter(|text| !text.is_empty()));
    lines.chain(unknown).collect::<Vec<_>>().join("\n")
}

/// Formats chargers, a line for each: `Dock is leased to ada; waiting: bob, cyd`.
fn chargers_text(chargers: &[ChargerView]) -> String {
    let line = |ChargerView { charger, lease, waiting }: &ChargerView| {
        let leased = lease.as_ref().map_or("is not leased".to_owned(), |lease| format!("is leased to {}", lease.robot));
        let names: Vec<&str> = waiting.iter().map(|robot| robot.as_str()).collect();
        let waiting = if names.is_empty() { String::new() } else { format!("; waiting: {}", names.join(", ")) };
        format!("{charger} {leased}{waiting}")
    };
    chargers.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// Formats values: `dust_g 12.5, door open`.
fn format_values(values: &BTreeMap<String, Scalar>) -> String {
    values.iter().map(|(name, value)| format!("{name} {value}")).collect::<Vec<_>>().join(", ")
}

fn format_coordinator(WithProvenance { provenance, content: view }: &WithProvenance<CoordinatorView>) -> String {
    let term = provenance.term;
    let voters: Vec<&str> = view.voters.iter().map(|voter| voter.as_str()).collect();
    let voters = if voters.is_empty() { "none".to_owned() } else { voters.join(", ") };
    let Some(node) = &view.node else {
        let seen_by = &provenance.seen_by;
        return format!("no coordinator, as seen by {seen_by}; the last term was {term}; voters: {voters}");
    };
    let since = view.since_ms.unwrap_or(0) as f64 / 1000.0;
    format!("{node} is the coordinator for {since:.1} s, term {term}; voters: {voters}")
}

fn row(view: &NodeView, fleet: &FleetView, coordinator: &CoordinatorView) -> Vec<String> {
    let NodeView { node, contact, record, holds, .. } = view;
    let yes_no = |is: bool| if is { "yes" } else { "no" };
    let dash = || "-".to_owned();
    let robot = record.robot.as_ref();
    let joined = fleet.ensembles.iter().filter(|ensemble| ensemble.members.contains(node));
    let joined: Vec<&str> = joined.map(|ensemble| ensemble.name.as_str()).collect();
    let skills = robot.map(|robot| robot.skills.iter().map(|skill| skill.as_str()).collect::<Vec<_>>().join(", "));
    let attributes = robot.filter(|robot| !robot.attributes.is_empty()).map(|robot| {
        robot.attributes.iter().map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join(", ")
    });
    vec![
        node.to_string(),
        match contact.status {
            NodeStatus::Suspect => "suspect",
            NodeStatus::Unknown | NodeStatus::Alive | NodeStatus::Down => yes_no(contact.alive),
        }
        .to_owned(),
        if coordinator.node.as_ref() == Some(node) {
            "coordinates"
        } else if coordinator.voters_lost.contains(node) {
            "lost"
        } else if coordinator.voters.contains(node) {
            "votes"
        } else {
            "-"
        }
        .to_owned(),
        robot.map_or_else(dash, |robot| robot.place.to_string()),
        robot.map_or_else(dash, |robot| format!("{:.1} %", robot.battery.get() * 100.0)),
        robot.and_then(|robot| robot.speed).map_or_else(dash, |speed| format!("{:.2} m/s", speed.get())),
        holds.as_ref().map_or_else(dash, |held| format!("{} of {}", held.role, held.mission)),
        if joined.is_empty() { dash() } else { joined.join(", ") },
        format!("{:.1} s ago", contact.age_ms as f64 / 1000.0),
        skills.unwrap_or_else(dash),
        attributes.unwrap_or_else(dash),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_that_the_replying_node_does_not_know_are_not_shown_as_none() {
        let shown = |view: &str| {
            let coordinator =
                r#"{ "seen_by": "s-1", "age_ms": 5, "coordinator": null, "term": 1, "at_ms": 0, "version": "0" }"#;
            let status =
                format!(r#"{{ "fleet": {view}, "coordinator": {coordinator}, "readings": {{}}, "feedback": {{}} }}"#);
            format_fleet(&serde_json::from_str(&status).unwrap())
        };
        assert!(shown(r#"{ "closures": null }"#).ends_with("\nalarms, closures, speed limits: unknown to this node"));
        assert!(!shown(r#"{ "closures": [], "speed_limits": [], "alarms": [] }"#).contains("unknown"));
    }
}
