//! Health of a fleet: findings with a severity and a text.

use consort_protocol::auction::{BidVerdict, RefusalReason};
use consort_protocol::ids::{AlarmId, ClusterId, DeviceId, DomainId, MissionId, NodeId, RobotId, RoleId};
use consort_protocol::ledger::{Ledger, MissionState, PersonRequestId};
use consort_protocol::mission::DomainHash;
use consort_protocol::view::{HealthFinding, HealthLevel, HealthView};
use consort_text::count;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

/// Inputs of the health check, as seen by a single node.
#[derive(Debug, Clone, Default)]
pub(super) struct HealthInputs {
    /// Coordinator and its term.
    pub(super) coordinator: Option<(NodeId, u64)>,
    /// Age of the last beacon in milliseconds; `None` if there never was any.
    pub(super) coordinator_age_ms: Option<u64>,
    /// Voters of the ledger, each with its reachability.
    pub(super) voters: Vec<(NodeId, bool)>,
    /// Other clusters with the name of this fleet, each with a node of it.
    pub(super) foreign: Vec<(ClusterId, NodeId)>,
    /// Alarms in force, as text.
    pub(super) alarms: Vec<(AlarmId, String)>,
    /// Nodes that are down or suspected, with the status and the age of their last record in
    /// milliseconds.
    pub(super) unreachable: Vec<(NodeId, &'static str, u64)>,
    /// Number of live nodes.
    pub(super) alive: usize,
    /// Robots that cannot take a role, with the reason.
    pub(super) out_of_service: Vec<(NodeId, String)>,
    /// Robots with roles that people hold, with the order.
    pub(super) held: Vec<(RobotId, String)>,
    /// Devices of the building that no robot can use, with the problem.
    pub(super) devices: Vec<(DeviceId, String)>,
    /// Contents of domain files that live nodes use, each with these nodes, by the name of the domain.
    pub(super) domains: BTreeMap<DomainId, DomainContents>,
    /// Robots suspended by an expired lease, with role and mission.
    pub(super) suspended: Vec<(NodeId, String)>,
    /// Missions that need intervention by a person, with the cause.
    pub(super) needs_intervention: Vec<(String, String)>,
    /// Missions that wait for robots, with the reason.
    pub(super) pending: Vec<(String, String)>,
    /// Missions that hold robots for which others wait.
    pub(super) blocking: BTreeMap<MissionId, Blocking>,
    /// The missions are known.
    pub(super) knows_missions: bool,
}

/// Contents of the files of a domain, each with the nodes that use it.
pub(super) type DomainContents = BTreeMap<DomainHash, BTreeSet<NodeId>>;

/// Maximum number of nodes that a finding names for each content of a domain.
const NODES_NAMED_MAX: usize = 8;

/// A mission holds robots for which other missions wait.
#[derive(Debug, Clone, Default)]
pub(super) struct Blocking {
    /// The robots.
    pub(super) robots: BTreeSet<RobotId>,
    /// The missions that wait.
    pub(super) waiting: BTreeSet<MissionId>,
    /// Open requests of the mission to people, each with the role of the person.
    pub(super) requests: Vec<(PersonRequestId, RoleId)>,
}

impl Blocking {
    /// Returns the missions that hold robots for which others wait: those that have the only robots for a role. A record may be
    /// older than the roles: then a robot counts for the mission that holds it now.
    pub(super) fn of(ledger: &Ledger) -> BTreeMap<MissionId, Blocking> {
        let mut blocking: BTreeMap<MissionId, Blocking> = BTreeMap::new();
        let held = ledger
            .missions_with_robots()
            .into_iter()
            .flat_map(|entry| entry.held_roles().map(move |(.., holder)| (&holder.robot, &entry.id)));
        let holders: BTreeMap<&RobotId, &MissionId> = held.collect();
        let has = |mission: &MissionId, robot: &RobotId| {
            let entry = ledger.mission(mission).filter(|entry| !entry.state.is_final());
            entry.is_some_and(|entry| entry.assigned_roles().any(|(.., holder)| holder.robot == *robot))
        };
        for entry in ledger.missions().filter(|entry| entry.state == MissionState::Pending) {
            let Some(auction) = entry.auction.as_ref().filter(|auction| auction.failure.is_some()) else { continue };
            let offered: BTreeSet<&RoleId> = auction
                .entries
                .iter()
                .filter(|entry| matches!(entry.verdict, BidVerdict::Viable { .. }))
                .map(|entry| &entry.role)
                .collect();
            let refusals = auction.entries.iter().filter(|entry| !offered.contains(&entry.role));
            let busy = refusals.filter(|refusal| refusal.is_busy());
            for (robot, verdict) in
                busy.flat_map(|refusal| refusal.robots().map(move |robot| (robot, &refusal.verdict)))
            {
                let mission = match verdict {
                    BidVerdict::Refused { reason: RefusalReason::Busy { mission, .. } } if has(mission, robot) => {
                        Some(mission)
                    }
                    _ => holders.get(robot).copied(),
                };
                let Some(mission) = mission else { continue };
                let holder = blocking.entry(mission.clone()).or_default();
                holder.robots.insert(robot.clone());
                holder.waiting.insert(entry.id.clone());
            }
        }
        for (mission, request) in ledger.open_person_requests() {
            if let Some(holder) = blocking.get_mut(&mission.id) {
                let id = PersonRequestId { mission: mission.id.clone(), number: request.number };
                holder.requests.push((id, request.role.clone()));
            }
        }
        blocking
    }

    fn text(&self, mission: &MissionId) -> String {
        let robots = self.robots.iter().map(RobotId::as_str).collect::<Vec<_>>().join(", ");
        let waiting = match (self.waiting.first(), self.waiting.len()) {
            (Some(only), 1) => format!("{only} waits"),
            (_, more) => format!("{more} missions wait"),
        };
        let requests = self.requests.iter().map(|(id, role)| format!("; it waits for the answer of {role} to {id}"));
        format!("{mission} holds {robots}, for which {waiting}{}", requests.collect::<String>())
    }
}

/// Returns the health with all findings, the most severe first. Without a problem, a single finding
/// confirms this.
pub(super) fn health(inputs: &HealthInputs) -> HealthView {
    let mut all = vec![];
    let mut add = |level, about: &str, name: Option<&str>, text: String| {
        all.push(HealthFinding { level, about: about.to_owned(), name: name.map(str::to_owned), text });
    };
    let (alive, voters) = (inputs.voters.iter().filter(|(_, alive)| *alive).count(), inputs.voters.len());
    let has_quorum = voters == 0 || alive > voters / 2;
    match (&inputs.coordinator, inputs.coordinator_age_ms) {
        (Some(_), _) => {}
        (None, None) => {
            add(HealthLevel::Error, "coordinator", None, "no beacon of a coordinator has arrived yet".to_owned());
        }
        (None, Some(age)) => {
            let text = format!("no coordinator; the last beacon is {:.1} s old", age as f64 / 1e3);
            add(HealthLevel::Error, "coordinator", None, text);
        }
    }
    let lost = inputs.voters.iter().filter(|(_, alive)| !alive).map(|(node, _)| node.as_str()).collect::<Vec<_>>();
    if !has_quorum {
        let text = format!("no quorum: {alive} of {voters} voters reachable; lost are {}", lost.join(", "));
        add(HealthLevel::Error, "quorum", None, text);
    } else if !lost.is_empty() {
        let more = alive - voters / 2 - 1;
        let text =
            format!("{alive} of {voters} voters reachable, without {}; {more} more may be lost", lost.join(", "));
        add(HealthLevel::Warning, "quorum", None, text);
    }
    for (cluster, node) in &inputs.foreign {
        let text = format!(
            "{node} belongs to another cluster with this fleet's name, {cluster}, founded separately: they do not merge. \
             Stop the nodes of either cluster and restart them with empty stores"
        );
        add(HealthLevel::Error, "cluster", Some(node.as_str()), text);
    }
    for (alarm, text) in &inputs.alarms {
        add(HealthLevel::Error, "alarm", Some(alarm.as_str()), format!("the fleet is {text}"));
    }
    for (mission, reason) in &inputs.needs_intervention {
        add(HealthLevel::Error, "mission", Some(mission), format!("{mission} needs intervention: {reason}"));
    }
    for (node, status, age_ms) in &inputs.unreachable {
        let text = format!("{node} is {status}; last contact {:.1} s ago", *age_ms as f64 / 1e3);
        add(HealthLevel::Warning, "node", Some(node.as_str()), text);
    }
    for (robot, problem) in &inputs.out_of_service {
        add(HealthLevel::Warning, "robot", Some(robot.as_str()), format!("{robot} is out of service: {problem}"));
    }
    for (robot, order) in &inputs.held {
        add(HealthLevel::Warning, "robot", Some(robot.as_str()), format!("{robot} is {order}"));
    }
    for (robot, role) in &inputs.suspended {
        let text = format!("{robot} is suspended as {role}: its lease was not renewed");
        add(HealthLevel::Warning, "robot", Some(robot.as_str()), text);
    }
    for (domain, contents) in inputs.domains.iter().filter(|(_, contents)| contents.len() > 1) {
        add(HealthLevel::Warning, "domain", Some(domain.as_str()), differing_domain(domain, contents));
    }
    for (device, problem) in &inputs.devices {
        let text = format!("{device} is unavailable: {problem}");
        add(HealthLevel::Warning, "device", Some(device.as_str()), text);
    }
    for (mission, blocking) in &inputs.blocking {
        add(HealthLevel::Warning, "mission", Some(mission.as_str()), blocking.text(mission));
    }
    for (mission, reason) in &inputs.pending {
        add(HealthLevel::Warning, "mission", Some(mission), format!("{mission} waits: {reason}"));
    }
    if !inputs.knows_missions {
        let text = "no voter of the ledger replies: missions are unknown".to_owned();
        add(HealthLevel::Warning, "ledger", None, text);
    }
    if all.is_empty() {
        let coordinator = inputs.coordinator.as_ref().map(|(node, term)| format!("{node} coordinates in term {term}"));
        let nodes = count(inputs.alive, "node is alive", "nodes are alive");
        let text = format!("{}; {voters} of {voters} voters reachable; {nodes}", coordinator.unwrap_or_default());
        all.push(HealthFinding { level: HealthLevel::Ok, about: "fleet".to_owned(), name: None, text });
    }
    all.sort_by_key(|finding| Reverse(finding.level));
    HealthView { level: all.first().map_or(HealthLevel::Ok, |worst| worst.level), findings: all }
}

/// Describes the nodes with each content of a domain, that of most nodes first.
fn differing_domain(domain: &DomainId, contents: &DomainContents) -> String {
    let mut groups: Vec<_> = contents.iter().collect();
    groups.sort_by_key(|(_, nodes)| Reverse(nodes.len()));
    let group = |(hash, nodes): (&DomainHash, &BTreeSet<NodeId>)| {
        let named: Vec<&str> = nodes.iter().map(NodeId::as_str).take(NODES_NAMED_MAX).collect();
        let more = nodes.len() - named.len();
        let more = if more > 0 { format!(" and {}", count(more, "other", "others")) } else { String::new() };
        format!("{hash} at {}{more}", named.join(", "))
    };
    let groups: Vec<String> = groups.into_iter().map(group).collect();
    format!(
        "the files of the domain {domain} differ: {}. Robots refuse tasks that were made with another content. Give all \
         nodes the same file, whose content `consort check FILE` prints, and restart them",
        groups.join("; ")
    )
}

#[cfg(test)]
mod tests;
