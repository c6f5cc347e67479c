//! Health of a fleet: findings with a severity and a text.

use consort_protocol::auction::{BidVerdict, RefusalReason};
use consort_protocol::ids::{AlarmId, ClusterId, MissionId, NodeId, RobotId, RoleId};
use consort_protocol::ledger::{Ledger, MissionState, PersonRequestId};
use consort_protocol::view::{HealthFinding, HealthLevel, HealthView};
use consort_text::count;
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
        let text = format!("{robot} is suspended as {role}: its lease expired");
        add(HealthLevel::Warning, "robot", Some(robot.as_str()), text);
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
    all.sort_by_key(|finding| std::cmp::Reverse(finding.level));
    HealthView { level: all.first().map_or(HealthLevel::Ok, |worst| worst.level), findings: all }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::auction::{AuctionEntry, AuctionId, AuctionRecord};
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Branch, Command, CommandOutcome, Submission};
    use consort_protocol::mission::{Format, MissionTemplate};
    use consort_protocol::plan::divide_and_check;
    use consort_skills::domain::hospital;

    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn healthy() -> HealthInputs {
        let voters = ["a", "b", "c"].map(|name| (node(name), true)).to_vec();
        let coordinator = Some((node("a"), 3));
        HealthInputs {
            coordinator,
            coordinator_age_ms: Some(0),
            voters,
            alive: 7,
            knows_missions: true,
            ..HealthInputs::default()
        }
    }

    fn texts(inputs: &HealthInputs) -> Vec<(HealthLevel, String)> {
        health(inputs).findings.into_iter().map(|finding| (finding.level, finding.text)).collect()
    }

    #[test]
    fn a_healthy_fleet_has_a_single_positive_finding() {
        let text = "a coordinates in term 3; 3 of 3 voters reachable; 7 nodes are alive".to_owned();
        assert_eq!(texts(&healthy()), [(HealthLevel::Ok, text)]);
    }

    #[test]
    fn lost_voters_are_a_warning_until_the_quorum_is_lost() {
        let mut inputs = healthy();
        inputs.voters[1].1 = false;
        let text = "2 of 3 voters reachable, without b; 0 more may be lost".to_owned();
        assert_eq!(texts(&inputs), [(HealthLevel::Warning, text)]);
        inputs.voters[2].1 = false;
        inputs.coordinator = None;
        inputs.coordinator_age_ms = Some(2500);
        assert_eq!(
            texts(&inputs),
            [
                (HealthLevel::Error, "no coordinator; the last beacon is 2.5 s old".to_owned()),
                (HealthLevel::Error, "no quorum: 1 of 3 voters reachable; lost are b, c".to_owned()),
            ]
        );
    }

    #[test]
    fn missions_that_keep_others_waiting_are_named() {
        let set = |names: &[&str]| names.iter().map(|name| MissionId::new(*name).unwrap()).collect();
        let robots = BTreeSet::from([RobotId::new("lab-arm").unwrap(), RobotId::new("amber").unwrap()]);
        let request = PersonRequestId { mission: MissionId::new("m-1").unwrap(), number: 2 };
        let requests = vec![(request, RoleId::new("clerk").unwrap())];
        let one = Blocking { robots: robots.clone(), waiting: set(&["m-2"]), requests };
        let many = Blocking { robots, waiting: set(&["m-2", "m-4", "m-5"]), requests: vec![] };
        let blocking = [("m-1", one), ("m-3", many)].map(|(id, blocking)| (MissionId::new(id).unwrap(), blocking));
        let inputs = HealthInputs { blocking: blocking.into(), ..healthy() };
        let expected = [
            "m-1 holds amber, lab-arm, for which m-2 waits; it waits for the answer of clerk to m-1.2",
            "m-3 holds amber, lab-arm, for which 3 missions wait",
        ];
        assert_eq!(texts(&inputs), expected.map(|text| (HealthLevel::Warning, text.to_owned())));
    }

    #[test]
    fn a_busy_robot_counts_for_the_mission_that_holds_it_now() {
        const MISSION: &str = r#"{"mission": "rest", "roles": {"r1": {"kind": "managed"}},
            "root": {"task": "wait", "type": "wait", "roles": ["r1"], "parameters": {"seconds": "5"}}}"#;
        let (mut ledger, mut index) = (Ledger::default(), 0);
        let mut apply = |ledger: &mut Ledger, command| {
            index += 1;
            let outcome = ledger.apply(Epoch { term: 1, index }, command);
            assert!(!matches!(outcome, CommandOutcome::Refused(_)), "{outcome:?}");
        };
        for request in ["a", "b", "c"] {
            let mission = MissionTemplate::parse(MISSION, Format::Json).unwrap();
            let mission = mission.instantiate(&BTreeMap::new(), &hospital()).unwrap();
            let division = divide_and_check(&mission).unwrap();
            let submission = Submission::of(request.parse().unwrap(), mission, division);
            apply(&mut ledger, Command::Submit(Box::new(submission)));
        }
        let [first, second, waiting] = ["rest-1", "rest-2", "rest-3"].map(|id| MissionId::new(id).unwrap());
        let (role, amber): (RoleId, RobotId) = ("r1".parse().unwrap(), "amber".parse().unwrap());
        let record =
            |mission: &MissionId| AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
        let award = |mission: &MissionId| {
            let (mission, auction, holders) =
                (mission.clone(), record(mission), [(role.clone(), amber.clone())].into());
            Command::Award { mission, branch: Branch::Main, holders, auction }
        };
        let cancel = |mission: &MissionId| {
            let (mission, by, places) = (mission.clone(), "Nia".to_owned(), BTreeMap::new());
            Command::Cancel { mission, by, places, at_ms: 1 }
        };
        let blocking = |ledger: &Ledger| {
            let of_mission = |(mission, found): (MissionId, Blocking)| (mission, found.robots, found.waiting);
            Blocking::of(ledger).into_iter().map(of_mission).collect::<Vec<_>>()
        };
        let blocked_by = |mission: &MissionId| {
            vec![(mission.clone(), BTreeSet::from([amber.clone()]), BTreeSet::from([waiting.clone()]))]
        };
        apply(&mut ledger, award(&first));
        let reason = RefusalReason::Busy { mission: first.clone(), role: role.clone() };
        let (robot, verdict, parts) = (amber.clone(), BidVerdict::Refused { reason }, vec![]);
        let entries = vec![AuctionEntry { role: role.clone(), robot, verdict, parts }];
        let failure = Some("no viable bid for r1".to_owned());
        let auction = AuctionRecord { entries, failure, ..record(&waiting) };
        apply(&mut ledger, Command::Defer { mission: waiting.clone(), branch: Branch::Main, auction });
        assert_eq!(blocking(&ledger), blocked_by(&first));
        apply(&mut ledger, cancel(&first));
        assert!(blocking(&ledger).is_empty());
        apply(&mut ledger, award(&second));
        assert_eq!(blocking(&ledger), blocked_by(&second));
    }

    #[test]
    fn the_most_severe_finding_comes_first() {
        let mut inputs = healthy();
        inputs.unreachable = vec![(node("d"), "down", 9000)];
        inputs.alarms = vec![("fire".parse().unwrap(), "under alarm fire by Nia: smoke".to_owned())];
        inputs.out_of_service = vec![(node("e"), "its battery is empty".to_owned())];
        inputs.held = vec![("g".parse().unwrap(), "held by Nia: a spill".to_owned())];
        inputs.suspended = vec![(node("f"), "r1 of m-1".to_owned())];
        inputs.pending = vec![("m-2".to_owned(), "no viable bid for r1".to_owned())];
        inputs.needs_intervention = vec![("m-3".to_owned(), "g was lost with the parcel".to_owned())];
        inputs.foreign = vec![(ClusterId(0xff), node("z"))];
        let health = health(&inputs);
        let levels: Vec<(HealthLevel, &str)> =
            health.findings.iter().map(|finding| (finding.level, finding.about.as_str())).collect();
        use HealthLevel::{Error, Warning};
        let expected = [
            (Error, "cluster"),
            (Error, "alarm"),
            (Error, "mission"),
            (Warning, "node"),
            (Warning, "robot"),
            (Warning, "robot"),
            (Warning, "robot"),
            (Warning, "mission"),
        ];
        assert_eq!(levels, expected);
        let text: Vec<String> = texts(&inputs).into_iter().map(|(_, text)| text).skip(1).take(6).collect();
        assert_eq!(
            text,
            [
                "the fleet is under alarm fire by Nia: smoke",
                "m-3 needs intervention: g was lost with the parcel",
                "d is down; last contact 9.0 s ago",
                "e is out of service: its battery is empty",
                "g is held by Nia: a spill",
                "f is suspended as r1 of m-1: its lease expired",
            ]
        );
    }
}
