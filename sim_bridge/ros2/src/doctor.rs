//! What is on the ROS 2 graph, and what of it does not fit the description of a robot.

use crate::described::check::{problems, unknown_types};
use crate::described::description::{RobotDescription, Via};
use crate::described::execution::lifecycle_state;
use crate::described::reports::Reports;
use crate::dynamic::graph::{Endpoint, EndpointKind, Graph};
use crate::dynamic::types::TypeRegistry;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::sleep;

/// Prefix of the names of bridges of simulated robots, before the fleet.
pub const SERVE_NODE: &str = "consort_serve_";

/// Time to wait for further nodes once the graph has what a description needs.
const OTHERS_WITHIN: Duration = Duration::from_millis(500);

/// A finding about the graph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// True if it fits.
    pub ok: bool,
    /// What was found.
    pub text: String,
}

impl Finding {
    fn ok(text: impl Into<String>) -> Finding {
        Finding { ok: true, text: text.into() }
    }

    fn wrong(text: impl Into<String>) -> Finding {
        Finding { ok: false, text: text.into() }
    }
}

/// An endpoint that a description needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Needed {
    /// What needs it: `actions.dock`.
    pub place: String,
    /// Kind of the other endpoint.
    pub kind: EndpointKind,
    /// Full name.
    pub name: String,
    /// Type.
    pub type_name: String,
}

/// Returns the endpoints that a description needs.
pub fn needed(robot: &RobotDescription, resolve: impl Fn(&str) -> String) -> Vec<Needed> {
    let need = |place: String, kind, name: String, type_name: &str| Needed {
        place,
        kind,
        name,
        type_name: type_name.to_owned(),
    };
    let mut all = vec![];
    if let Ok(reports) = Reports::new(robot) {
        for topic in reports.topics().filter(|topic| topic.name != "/tf_static") {
            all.push(need("reports".to_owned(), EndpointKind::Publisher, resolve(&topic.name), &topic.type_name));
        }
    }
    for (action, mapping) in &robot.actions {
        let place = format!("actions.{action}");
        let type_name = &mapping.type_name;
        match mapping.via() {
            Some(Via::Action(name)) => {
                let service = format!("{}/_action/send_goal", resolve(name));
                all.push(need(place, EndpointKind::Server, service, &format!("{type_name}_SendGoal")));
            }
            Some(Via::Service(name)) => all.push(need(place, EndpointKind::Server, resolve(name), type_name)),
            Some(Via::Topic(name)) => all.push(need(place, EndpointKind::Subscription, resolve(name), type_name)),
            None => {}
        }
        let until = mapping.until.iter().map(|until| ("until", &until.topic, &until.type_name));
        let hold = mapping.hold.iter().map(|hold| ("hold", &hold.topic, &hold.type_name));
        for (key, topic, type_name) in until.chain(hold) {
            all.push(need(format!("actions.{action}.{key}"), EndpointKind::Publisher, resolve(topic), type_name));
        }
    }
    all
}

/// Waits until the graph has what a description needs, for `limit` at most, and then for further nodes
/// with the same names.
pub async fn wait_for_needed(graph: &Graph, robot: &RobotDescription, limit: Duration) {
    let needed = needed(robot, |name| graph.resolve(name));
    let is_complete = |graph: &Graph| {
        let endpoints = graph.endpoints();
        needed.iter().all(|needed| compare(needed, &endpoints).is_ok())
    };
    if graph.wait_for(limit, is_complete).await {
        sleep(limit.min(OTHERS_WITHIN)).await;
    }
}

/// Compares a needed endpoint with the graph.
pub fn compare(needed: &Needed, endpoints: &[Endpoint]) -> Result<Endpoint, String> {
    let Needed { place, kind, name, type_name } = needed;
    let what = match kind {
        EndpointKind::Server => "server",
        EndpointKind::Subscription => "subscriber",
        EndpointKind::Publisher | EndpointKind::Client => "publisher",
    };
    let found: Vec<&Endpoint> =
        endpoints.iter().filter(|endpoint| endpoint.kind == *kind && endpoint.name == *name).collect();
    let Some(first) = found.first() else {
        let last = name.rsplit('/').find(|part| !matches!(*part, "_action" | "send_goal")).unwrap_or_default();
        let similar = endpoints.iter().filter(|other| other.type_name == *type_name && other.name.contains(last));
        let names: Vec<&str> = similar.map(|other| other.name.as_str()).collect();
        let hint = if names.is_empty() { String::new() } else { format!("; the graph has {}", names.join(", ")) };
        return Err(format!("{place}: no {what} of {name}{hint}"));
    };
    if first.type_name != *type_name {
        return Err(format!("{place}: {name} has the type {}; expected {type_name}", first.type_name));
    }
    if *kind == EndpointKind::Server && found.len() > 1 {
        let nodes: Vec<&str> = found.iter().map(|endpoint| endpoint.node.as_str()).collect();
        return Err(format!("{place}: {} servers of {name}: {}", found.len(), nodes.join(", ")));
    }
    Ok((*first).clone())
}

/// Returns the names that several nodes have, with their number.
pub fn repeated(nodes: &[String]) -> Vec<(String, usize)> {
    let mut counts: BTreeMap<&String, usize> = BTreeMap::new();
    for node in nodes {
        *counts.entry(node).or_default() += 1;
    }
    counts.into_iter().filter(|(_, count)| *count > 1).map(|(node, count)| (node.clone(), count)).collect()
}

/// Examines the graph, and how it fits a description.
pub async fn examine(graph: &Graph, robot: Option<&RobotDescription>, types: &TypeRegistry) -> Vec<Finding> {
    let (nodes, endpoints) = (graph.nodes(), graph.endpoints());
    let mut findings = vec![match nodes.is_empty() {
        true => Finding::wrong("no node on the graph: is the router running, and the domain right?"),
        false => Finding::ok(format!("{} nodes: {}", nodes.len(), nodes.join(", "))),
    }];
    for (node, count) in repeated(&nodes) {
        findings.push(match node.trim_start_matches('/').strip_prefix(SERVE_NODE) {
            Some(fleet) => Finding::wrong(format!("{count} `consort-ros2 serve` for the fleet {fleet}")),
            None => Finding::wrong(format!("{count} nodes have the name {node}")),
        });
    }
    match robot {
        None => {
            let shown = endpoints.iter().map(|endpoint| {
                let Endpoint { name, kind, type_name, hash, node } = endpoint;
                Finding::ok(format!("{kind:?} {name} {type_name} {hash} of {node}"))
            });
            findings.extend(shown);
        }
        Some(robot) => {
            findings.extend(problems(robot, types).into_iter().map(Finding::wrong));
            for name in unknown_types(robot, types) {
                findings.push(Finding::ok(format!("{name} is no known type; its definition is requested from nodes")));
            }
            for needed in needed(robot, |name| graph.resolve(name)) {
                findings.push(examine_endpoint(graph, &needed, &endpoints, types).await);
            }
            for node in robot.lifecycle.iter().flat_map(|lifecycle| &lifecycle.nodes) {
                let node = graph.resolve(node);
                findings.push(match lifecycle_state(graph, &node).await {
                    Ok(state) if state == "active" => Finding::ok(format!("lifecycle: {node} is active")),
                    Ok(state) => Finding::wrong(format!("lifecycle: {node} is {state}")),
                    Err(problem) => Finding::wrong(format!("lifecycle: {problem}")),
                });
            }
            let clock = graph.find(EndpointKind::Publisher, "/clock");
            if robot.use_sim_time && clock.is_none() {
                findings.push(Finding::wrong("use_sim_time: no publisher of /clock"));
            }
        }
    }
    findings
}

async fn examine_endpoint(graph: &Graph, needed: &Needed, endpoints: &[Endpoint], types: &TypeRegistry) -> Finding {
    let endpoint = match compare(needed, endpoints) {
        Ok(endpoint) => endpoint,
        Err(problem) => return Finding::wrong(problem),
    };
    let Endpoint { name, type_name, hash, node, .. } = &endpoint;
    let text = format!("{}: {name} {type_name} {hash} of {node}", needed.place);
    match (types.hash(type_name), graph.types_of(type_name, hash).await) {
        (Ok(known), _) if known == *hash => Finding::ok(text),
        (_, Ok(_)) => Finding::ok(format!("{text}, by the definition of the node")),
        (Ok(known), Err(_)) => Finding::wrong(format!("{text}; the known definition has the hash {known}")),
        (Err(_), Err(problem)) => Finding::wrong(format!("{text}; {problem}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::described::description::load;

    fn server(name: &str, type_name: &str, node: &str) -> Endpoint {
        Endpoint {
            name: name.to_owned(),
            kind: EndpointKind::Server,
            type_name: type_name.to_owned(),
            hash: "RIHS01_ab".to_owned(),
            node: node.to_owned(),
        }
    }

    #[test]
    fn a_missing_server_a_wrong_type_and_a_second_server_are_found() {
        let nav2 = load("nav2").unwrap();
        let all = needed(&nav2, |name| format!("/{name}"));
        let spin = all.iter().find(|needed| needed.place == "actions.spin").unwrap();
        let kind = "nav2_msgs/action/Spin_SendGoal";
        let other_namespace = server("/ada/spin/_action/send_goal", kind, "/ada/behavior_server");
        let error = compare(spin, std::slice::from_ref(&other_namespace)).unwrap_err();
        assert_eq!(
            error,
            "actions.spin: no server of /spin/_action/send_goal; the graph has /ada/spin/_action/send_goal"
        );
        let wrong = server("/spin/_action/send_goal", "a/action/Turn_SendGoal", "/x");
        assert!(
            compare(spin, &[wrong]).unwrap_err().contains("has the type a/action/Turn_SendGoal; expected nav2_msgs")
        );
        let right = |node: &str| server("/spin/_action/send_goal", kind, node);
        assert_eq!(compare(spin, &[right("/a")]), Ok(right("/a")));
        assert!(compare(spin, &[right("/a"), right("/b")]).unwrap_err().contains("2 servers of"));
    }

    #[test]
    fn two_nodes_of_a_name_are_found() {
        let nodes = ["/a", "/b", "/b"].map(str::to_owned);
        assert_eq!(repeated(&nodes), [("/b".to_owned(), 2)]);
    }
}
