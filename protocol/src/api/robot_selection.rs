//! The robots that a request selects, by their records. The coordinator selects the robots of an order, and programs for
//! people show before which robots it would affect.

use super::request::{RobotSelection, RobotZone, SelectionCondition};
use crate::ensemble::Eligibility;
use crate::ids::{PlaceId, RobotId, ZoneId};
use crate::knowledge::RobotKnowledge;
use consort_text::AllowedNames;
use std::collections::{BTreeMap, BTreeSet};

/// Reason why no robots can be selected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SelectionError {
    /// The condition cannot be compiled.
    #[error("where: {0}")]
    InvalidCondition(String),
    /// No zone has this name.
    #[error("there is no zone {zone} in the fleet file; {allowed}")]
    UnknownZone {
        /// The name.
        zone: ZoneId,
        /// Names of the zones.
        allowed: AllowedNames,
    },
}

impl RobotSelection {
    /// Returns the robots of the selection among those with a known record. `zones` are those of the fleet file. Records lack
    /// the private attributes of ensembles, so a condition on them says nothing.
    ///
    /// # Errors
    /// [`SelectionError`] for an invalid condition, and for an unknown zone.
    pub fn among(
        &self,
        known: &BTreeMap<RobotId, RobotKnowledge>,
        zones: &BTreeMap<ZoneId, BTreeSet<PlaceId>>,
    ) -> Result<BTreeSet<RobotId>, SelectionError> {
        let meeting = |meets: &dyn Fn(&RobotId, &RobotKnowledge) -> bool| -> BTreeSet<RobotId> {
            known.iter().filter(|&(name, robot)| meets(name, robot)).map(|(name, _)| name.clone()).collect()
        };
        Ok(match self {
            RobotSelection::All(_) => meeting(&|_, _| true),
            RobotSelection::Named(names) => meeting(&|name, _| names.contains(name)),
            RobotSelection::Where(SelectionCondition { condition }) => {
                let compiled = Eligibility::compile(condition).map_err(SelectionError::InvalidCondition)?;
                meeting(&|name, robot| compiled.check(name, robot).is_ok())
            }
            RobotSelection::Zone(RobotZone { zone }) => {
                let Some(places) = zones.get(zone) else {
                    let allowed = AllowedNames::suggest_for(zone.as_str(), zones.keys());
                    return Err(SelectionError::UnknownZone { zone: zone.clone(), allowed });
                };
                meeting(&|_, robot| places.contains(&robot.place))
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ensemble::example_robot;
    use serde_json::{Value, json};

    fn selected(selection: Value) -> Result<Vec<String>, String> {
        let robot = |name: &str, place: &str, section: &str| -> (RobotId, RobotKnowledge) {
            let attributes = serde_json::from_value(json!({ "section": section })).unwrap();
            (name.parse().unwrap(), RobotKnowledge { attributes, place: place.parse().unwrap(), ..example_robot() })
        };
        let known = BTreeMap::from([robot("ada", "IC Room 6", "icu"), robot("bob", "Dock", "er")]);
        let zones = json!({ "icu": ["IC Room 5", "IC Room 6"], "hall": ["Hall"] });
        let selection: RobotSelection = serde_json::from_value(selection).unwrap();
        let robots = selection.among(&known, &serde_json::from_value(zones).unwrap());
        robots.map(|robots| robots.iter().map(RobotId::to_string).collect()).map_err(|problem| problem.to_string())
    }

    #[test]
    fn robots_are_selected_by_a_condition_a_zone_a_name_or_all() {
        for (selection, robots) in [
            (json!({ "where": r#"robot.attributes.section == "er""# }), vec!["bob"]),
            (json!({ "where": "robot.battery < 0.0" }), vec![]),
            (json!({ "where": "robot.attributes.wheels > 3" }), vec![]),
            (json!({ "zone": "icu" }), vec!["ada"]),
            (json!({ "zone": "hall" }), vec![]),
            (json!(["ada", "eve"]), vec!["ada"]),
            (json!("all"), vec!["ada", "bob"]),
        ] {
            assert_eq!(selected(selection.clone()).unwrap(), robots, "{selection}");
        }
    }

    #[test]
    fn an_invalid_condition_and_an_unknown_zone_are_errors() {
        let problem = selected(json!({ "where": "robot.wheels > 3" })).unwrap_err();
        assert!(problem.starts_with("where: ") && problem.contains("`robot` has no field `wheels`"), "{problem}");
        let unknown = "there is no zone hal in the fleet file; allowed: hall, icu; did you mean `hall`?";
        assert_eq!(selected(json!({ "zone": "hal" })).unwrap_err(), unknown);
    }
}
