//! The robots that an order by zone or condition would affect now, for its confirmation. The coordinator selects them
//! again when it gets the order.

use consort_protocol::api::{RobotSelection, RobotZone, SelectionCondition};
use consort_protocol::ensemble::Eligibility;
use consort_protocol::ids::{RobotId, ZoneId};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::view::{FleetView, NodeView};
use std::collections::BTreeSet;

/// Reason why robots cannot be selected.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum SelectionError {
    /// The condition cannot be compiled.
    #[error("where: {0}")]
    InvalidCondition(String),
    /// No zone has this name.
    #[error("there is no zone {0} in the fleet file")]
    UnknownZone(ZoneId),
}

/// Selects robots of a fleet by their records.
///
/// # Errors
/// [`SelectionError`] for a wrong condition, and for a zone that the fleet file of the replying node lacks.
pub(super) fn select(selection: &RobotSelection, view: FleetView) -> Result<BTreeSet<RobotId>, SelectionError> {
    let FleetView { nodes, declared, .. } = view;
    let robots = nodes.into_iter().filter_map(|NodeView { node, record, .. }| {
        let robot = record.robot?;
        Some((RobotId::from(node), robot))
    });
    let meeting = |meets: &dyn Fn(&RobotId, &RobotKnowledge) -> bool| -> BTreeSet<RobotId> {
        robots.filter(|(name, robot)| meets(name, robot)).map(|(name, _)| name).collect()
    };
    Ok(match selection {
        RobotSelection::All(_) => meeting(&|_, _| true),
        RobotSelection::Named(names) => meeting(&|name, _| names.contains(name)),
        RobotSelection::Where(SelectionCondition { condition }) => {
            let compiled = Eligibility::compile(condition).map_err(SelectionError::InvalidCondition)?;
            meeting(&|name, robot| compiled.check(name, robot).is_ok())
        }
        RobotSelection::Zone(RobotZone { zone }) => {
            let places = declared.zones.get(zone).ok_or_else(|| SelectionError::UnknownZone(zone.clone()))?;
            meeting(&|_, robot| places.contains(&robot.place))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn selected(selection: Value) -> Result<Vec<String>, String> {
        let robot = |name: &str, place: &str, section: &str| {
            json!({ "node": name, "seen_by": "s1", "robot": {
                "skills": ["navigation"], "attributes": { "section": section }, "place": place,
                "pose": { "x_m": 6.0, "y_m": 2.5, "yaw_rad": 1.5 }, "battery": 0.8, "discharge": 0.001,
                "useful_charge": 0.08, "speed": 0.7, "availability": "free", "estimator": "e",
            } })
        };
        let view = json!({
            "nodes": [robot("ada", "IC Room 6", "icu"), robot("bob", "Dock", "er"), { "node": "s1", "seen_by": "s1" }],
            "declared": { "alarms": {}, "zones": { "icu": ["IC Room 5", "IC Room 6"], "hall": ["Hall"] }, "hash": "1" },
        });
        let selection: RobotSelection = serde_json::from_value(selection).unwrap();
        let robots = select(&selection, serde_json::from_value(view).unwrap());
        robots.map(|robots| robots.iter().map(RobotId::to_string).collect()).map_err(|problem| problem.to_string())
    }

    #[test]
    fn robots_are_selected_by_a_condition_a_zone_a_name_or_all() {
        for (selection, robots) in [
            (json!({ "where": r#"robot.attributes.section == "er""# }), vec!["bob"]),
            (json!({ "where": "robot.battery < 0.1" }), vec![]),
            (json!({ "zone": "icu" }), vec!["ada"]),
            (json!({ "zone": "hall" }), vec![]),
            (json!(["ada", "eve"]), vec!["ada"]),
            (json!("all"), vec!["ada", "bob"]),
        ] {
            assert_eq!(selected(selection.clone()).unwrap(), robots, "{selection}");
        }
    }

    #[test]
    fn a_wrong_condition_and_an_unknown_zone_are_errors() {
        let problem = selected(json!({ "where": "robot.wheels > 3" })).unwrap_err();
        assert!(problem.starts_with("where: ") && problem.contains("`robot` has no field `wheels`"), "{problem}");
        assert_eq!(selected(json!({ "zone": "er" })).unwrap_err(), "there is no zone er in the fleet file");
    }
}
