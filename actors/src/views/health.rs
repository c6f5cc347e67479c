//! What is the matter with a fleet, in words, each with how bad it is.

use consort_protocol::count::count;
use consort_protocol::ids::NodeId;
use serde::Serialize;

/// How bad something is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum HealthLevel {
    /// As it should be.
    Ok,
    /// The fleet goes on; somebody should look.
    Warning,
    /// Something does not go on until somebody does.
    Error,
}

/// Something that was found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct Finding {
    /// How bad it is.
    pub(super) level: HealthLevel,
    /// What it is about: `coordinator`, `quorum`, `cluster`, `node`, `robot`, `mission` or `ledger`.
    pub(super) about: &'static str,
    /// The node, robot or mission, if it is about one.
    pub(super) name: Option<String>,
    /// What, in words.
    pub(super) says: String,
}

/// What a node knows that health is judged by.
#[derive(Debug, Clone, Default)]
pub(super) struct HealthInputs {
    /// Who coordinates, and in which term.
    pub(super) coordinator: Option<(NodeId, u64)>,
    /// How long ago there was word from a coordinator, in milliseconds; `None` for never.
    pub(super) coordinator_age_ms: Option<u64>,
    /// Who keeps the ledger, and whether that one is alive as far as is known.
    pub(super) voters: Vec<(NodeId, bool)>,
    /// Other clusters of this fleet's name, and a node of each.
    pub(super) foreign: Vec<(String, NodeId)>,
    /// Nodes that are judged down or suspected, with the word for it and how long ago they were heard, in milliseconds.
    pub(super) unreachable: Vec<(NodeId, &'static str, u64)>,
    /// How many nodes are alive.
    pub(super) alive: usize,
    /// Robots that cannot take a role, and why.
    pub(super) out_of_service: Vec<(NodeId, String)>,
    /// Robots that stand still because their lease ran out, with role and mission.
    pub(super) suspended: Vec<(NodeId, String)>,
    /// Missions that wait for a person, and why.
    pub(super) needs_intervention: Vec<(String, String)>,
    /// Missions that wait for robots, and why.
    pub(super) pending: Vec<(String, String)>,
    /// Whether missions are known.
    pub(super) knows_missions: bool,
}

/// Judges. What is worst comes first; if nothing is the matter, one finding says so.
pub(super) fn findings(signs: &HealthInputs) -> Vec<Finding> {
    let mut all = vec![];
    let mut find = |level, about, name: Option<&str>, says: String| {
        all.push(Finding { level, about, name: name.map(str::to_owned), says });
    };
    let (alive, voters) = (signs.voters.iter().filter(|(_, alive)| *alive).count(), signs.voters.len());
    let has_quorum = voters == 0 || alive > voters / 2;
    match (&signs.coordinator, signs.coordinator_age_ms) {
        (Some(_), _) => {}
        (None, None) => {
            find(HealthLevel::Error, "coordinator", None, "nobody has been heard to coordinate yet".to_owned())
        }
        (None, Some(silent)) => {
            let says =
                format!("nobody coordinates; the last word of a coordinator is {:.1} s old", silent as f64 / 1e3);
            find(HealthLevel::Error, "coordinator", None, says);
        }
    }
    let lost = signs.voters.iter().filter(|(_, alive)| !alive).map(|(node, _)| node.as_str()).collect::<Vec<_>>();
    if !has_quorum {
        let says = format!("no quorum: {alive} of {voters} voters reachable; lost are {}", lost.join(", "));
        find(HealthLevel::Error, "quorum", None, says);
    } else if !lost.is_empty() {
        let more = alive - voters / 2 - 1;
        let says =
            format!("{alive} of {voters} voters reachable, without {}; {more} more may be lost", lost.join(", "));
        find(HealthLevel::Warning, "quorum", None, says);
    }
    for (cluster, node) in &signs.foreign {
        let says = format!(
            "{node} belongs to another cluster of this fleet's name, {cluster}, founded apart: they do not merge. Stop the \
             nodes of one of them and start them again with empty stores"
        );
        find(HealthLevel::Error, "cluster", Some(node.as_str()), says);
    }
    for (mission, why) in &signs.needs_intervention {
        find(HealthLevel::Error, "mission", Some(mission), format!("{mission} needs rescue: {why}"));
    }
    for (node, word, age_ms) in &signs.unreachable {
        let says = format!("{node} is {word}; it was last heard {:.1} s ago", *age_ms as f64 / 1e3);
        find(HealthLevel::Warning, "node", Some(node.as_str()), says);
    }
    for (robot, problem) in &signs.out_of_service {
        find(HealthLevel::Warning, "robot", Some(robot.as_str()), format!("{robot} is out of service: {problem}"));
    }
    for (robot, role) in &signs.suspended {
        let says = format!("{robot} stands still as {role}: its lease ran out");
        find(HealthLevel::Warning, "robot", Some(robot.as_str()), says);
    }
    for (mission, why) in &signs.pending {
        find(HealthLevel::Warning, "mission", Some(mission), format!("{mission} waits: {why}"));
    }
    if !signs.knows_missions {
        let says = "no keeper of the ledger answers: nothing is known of missions".to_owned();
        find(HealthLevel::Warning, "ledger", None, says);
    }
    if all.is_empty() {
        let coordinator = signs.coordinator.as_ref().map(|(node, term)| format!("{node} coordinates in term {term}"));
        let nodes = count(signs.alive, "node is alive", "nodes are alive");
        let says = format!("{}; {voters} of {voters} voters reachable; {nodes}", coordinator.unwrap_or_default());
        all.push(Finding { level: HealthLevel::Ok, about: "fleet", name: None, says });
    }
    all.sort_by_key(|finding| std::cmp::Reverse(finding.level));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn well() -> HealthInputs {
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

    fn words(signs: &HealthInputs) -> Vec<(HealthLevel, String)> {
        findings(signs).into_iter().map(|finding| (finding.level, finding.says)).collect()
    }

    #[test]
    fn a_fleet_that_is_well_says_so() {
        let says = "a coordinates in term 3; 3 of 3 voters reachable; 7 nodes are alive".to_owned();
        assert_eq!(words(&well()), [(HealthLevel::Ok, says)]);
    }

    #[test]
    fn voters_that_are_lost_are_a_warning_until_too_many_are() {
        let mut signs = well();
        signs.voters[1].1 = false;
        let says = "2 of 3 voters reachable, without b; 0 more may be lost".to_owned();
        assert_eq!(words(&signs), [(HealthLevel::Warning, says)]);
        signs.voters[2].1 = false;
        signs.coordinator = None;
        signs.coordinator_age_ms = Some(2500);
        assert_eq!(
            words(&signs),
            [
                (HealthLevel::Error, "nobody coordinates; the last word of a coordinator is 2.5 s old".to_owned()),
                (HealthLevel::Error, "no quorum: 1 of 3 voters reachable; lost are b, c".to_owned()),
            ]
        );
    }

    #[test]
    fn what_is_worst_comes_first() {
        let mut signs = well();
        signs.unreachable = vec![(node("d"), "down", 9000)];
        signs.out_of_service = vec![(node("e"), "its battery is empty".to_owned())];
        signs.suspended = vec![(node("f"), "r1 of m-1".to_owned())];
        signs.pending = vec![("m-2".to_owned(), "no viable bid for r1".to_owned())];
        signs.needs_intervention = vec![("m-3".to_owned(), "g was lost with the sample".to_owned())];
        signs.foreign = vec![("00ff".to_owned(), node("z"))];
        let levels: Vec<(HealthLevel, &str)> =
            findings(&signs).iter().map(|finding| (finding.level, finding.about)).collect();
        use HealthLevel::{Error, Warning};
        let expected = [
            (Error, "cluster"),
            (Error, "mission"),
            (Warning, "node"),
            (Warning, "robot"),
            (Warning, "robot"),
            (Warning, "mission"),
        ];
        assert_eq!(levels, expected);
        let says: Vec<String> = words(&signs).into_iter().map(|(_, says)| says).skip(1).take(4).collect();
        assert_eq!(
            says,
            [
                "m-3 needs rescue: g was lost with the sample",
                "d is down; it was last heard 9.0 s ago",
                "e is out of service: its battery is empty",
                "f stands still as r1 of m-1: its lease ran out",
            ]
        );
    }
}
