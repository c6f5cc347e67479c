//! Scenarios and maps in the format of the published evaluation (replication package of the JSS
//! 2022 article).

use super::design::{Design, FactorLevels, Scenario, ScenarioRobot};
use consort_protocol::ids::{PlaceId, RobotId, TaskType};
use consort_skills::environment::{ReferenceMapError, TopologicalMap};
use consort_world::map::{LaneEntry, Map, MapError, MapFile, PlaceEntry, PlaceKind};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// The published scenarios could not be read.
#[derive(Debug, thiserror::Error)]
pub enum PublishedScenarioError {
    /// The text is not JSON, or has another form; the message contains line and column.
    #[error("these are not scenarios of the published format: {0}")]
    Json(#[from] serde_json::Error),
    /// The list is empty.
    #[error("the file contains no scenarios")]
    Empty,
    /// Two scenarios have the same code.
    #[error("scenario {0} occurs more than once")]
    Duplicate(String),
    /// A number is out of range.
    #[error("scenario {code}, {robot}: {field} is {value}, allowed: {allowed}")]
    Number {
        /// Code of the scenario.
        code: String,
        /// Name of the robot.
        robot: RobotId,
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
        /// Allowed range, in words.
        allowed: &'static str,
    },
    /// The design has more or less than a single site. A scenario of this format places a single
    /// site: that of its nurse.
    #[error("scenario {code} places a single nurse, but the design has the sites {sites}; allowed: a single site")]
    Sites {
        /// Code of the scenario.
        code: String,
        /// The sites of the design, in words.
        sites: String,
    },
    /// The scenario has no nurse.
    #[error("scenario {0} has no nurse")]
    NoNurse(String),
}

#[derive(Deserialize)]
struct ScenarioEntry {
    code: String,
    #[serde(default)]
    factors: FactorsEntry,
    nurses: Vec<NurseEntry>,
    robots: Vec<RobotEntry>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct FactorsEntry {
    avg_speed: String,
    battery_charge: String,
    battery_discharge_rate: String,
    location: String,
    skills: String,
}

#[derive(Deserialize)]
struct NurseEntry {
    location: PlaceId,
}

#[derive(Deserialize)]
struct RobotEntry {
    name: RobotId,
    avg_speed: f64,
    battery_charge: f64,
    battery_discharge_rate: f64,
    location: PlaceId,
    skills: BTreeSet<TaskType>,
}

/// Reads scenarios for a design: the place of the nurse is the single site, and the robots belong
/// to the first group of the design.
///
/// # Errors
/// [`PublishedScenarioError`] of the first error.
pub fn scenarios(text: &str, design: &Design) -> Result<Vec<Scenario>, PublishedScenarioError> {
    let read: Vec<ScenarioEntry> = serde_json::from_str(text)?;
    let mut seen = BTreeSet::new();
    let scenarios = read.into_iter().map(|entry| {
        if !seen.insert(entry.code.clone()) {
            return Err(PublishedScenarioError::Duplicate(entry.code));
        }
        scenario(entry, design)
    });
    let scenarios: Vec<Scenario> = scenarios.collect::<Result<_, _>>()?;
    if scenarios.is_empty() { Err(PublishedScenarioError::Empty) } else { Ok(scenarios) }
}

fn scenario(entry: ScenarioEntry, design: &Design) -> Result<Scenario, PublishedScenarioError> {
    let ScenarioEntry { code, factors, nurses, robots } = entry;
    let Some(nurse) = nurses.into_iter().next() else { return Err(PublishedScenarioError::NoNurse(code)) };
    let sites = &design.factors.location.sites;
    let site = match sites.keys().next() {
        Some(site) if sites.len() == 1 => site.clone(),
        _ => {
            let sites = sites.keys().map(|site| format!("@{site}")).collect::<Vec<_>>().join(", ");
            return Err(PublishedScenarioError::Sites { code, sites });
        }
    };
    let kind = design.robots.first();
    let robot = |entry: RobotEntry| {
        let RobotEntry { name, avg_speed, battery_charge, battery_discharge_rate, location, skills } = entry;
        for (field, value, least, most, allowed) in [
            ("avg_speed", avg_speed, 0.001, 100.0, "0.001 to 100 m/s"),
            ("battery_charge", battery_charge, 0.0, 1.0, "0 to 1"),
            ("battery_discharge_rate", battery_discharge_rate, 0.0, 1.0, "0 to 1 per second"),
        ] {
            if !(least..=most).contains(&value) {
                let code = code.clone();
                return Err(PublishedScenarioError::Number { code, robot: name.clone(), field, value, allowed });
            }
        }
        Ok(ScenarioRobot {
            name,
            speed_mps: avg_speed,
            charge: battery_charge,
            discharge: battery_discharge_rate,
            place: location,
            skills,
            drawer: kind.is_none_or(|kind| kind.drawer),
            arm: kind.is_some_and(|kind| kind.arm),
            roles: kind.map(|kind| kind.roles.clone()).unwrap_or_default(),
        })
    };
    let robots = robots.into_iter().map(robot).collect::<Result<Vec<_>, _>>()?;
    let FactorsEntry { avg_speed, battery_charge, battery_discharge_rate, location, skills } = factors;
    let levels =
        FactorLevels { speed: avg_speed, charge: battery_charge, discharge: battery_discharge_rate, location, skills };
    Ok(Scenario { code, levels, sites: BTreeMap::from([(site, nurse.location)]), robots })
}

/// The published map could not be read.
#[derive(Debug, thiserror::Error)]
pub enum PublishedMapError {
    /// The text has another form.
    #[error(transparent)]
    Form(#[from] ReferenceMapError),
    /// The map is invalid.
    #[error(transparent)]
    Map(#[from] MapError),
}

/// Reads a map of the published format, which has no walls. `file` names the file in errors.
///
/// # Errors
/// [`PublishedMapError`] with all errors.
pub fn published_map(text: &str, file: &str) -> Result<Map, PublishedMapError> {
    let topology = TopologicalMap::from_reference_json(text)?;
    let kind = |place: &PlaceId| match place.as_str() {
        name if name.contains("Corridor") || name.contains("Corner") => PlaceKind::Corridor,
        name if name.contains("Room") => PlaceKind::Room,
        name if name.contains("Laboratory") => PlaceKind::Lab,
        _ => PlaceKind::Other,
    };
    let places = topology.places.iter().map(|(place, pose)| PlaceEntry {
        name: place.to_string(),
        kind: kind(place),
        x_m: pose.x,
        y_m: pose.y,
        yaw_rad: pose.yaw,
        ..PlaceEntry::default()
    });
    let straight = |a: &PlaceId, b: &PlaceId| topology.places[a].distance(topology.places[b]).get();
    let lanes = topology.edges.iter().map(|edge| LaneEntry {
        between: (edge.a.to_string(), edge.b.to_string()),
        // The published lengths are rounded to centimetres, and a lane is never shorter than the
        // straight line.
        length_m: Some(edge.length_m).filter(|length| *length >= straight(&edge.a, &edge.b)),
        one_way: edge.one_way,
        ..LaneEntry::default()
    });
    let map = MapFile {
        name: "published".to_owned(),
        places: places.collect(),
        lanes: lanes.collect(),
        ..MapFile::default()
    };
    Ok(map.check(file)?)
}

#[cfg(test)]
mod tests {
    use super::super::design::shipped;
    use super::*;

    fn design() -> Design {
        shipped("published").unwrap().unwrap()
    }

    fn scenario_json(robot: &str) -> String {
        format!(
            r#"[{{"code": "aaaaap", "factors": {{"location": "a"}}, "nurses": [{{"location": "IC Room 6"}}],
                "robots": [{{"name": "r1", "avg_speed": 0.15, "battery_charge": 0.5, "battery_discharge_rate": 0.0004,
                "location": "PC Room 8", "skills": ["navigation"]{robot}}}]}}]"#
        )
    }

    #[test]
    fn a_published_scenario_is_read() {
        let read = scenarios(&scenario_json(r#", "id": 1"#), &design()).unwrap();
        assert_eq!((read.len(), read[0].code.as_str(), read[0].levels.location.as_str()), (1, "aaaaap", "a"));
        assert_eq!(read[0].sites["room"].as_str(), "IC Room 6");
        let robot = &read[0].robots[0];
        assert_eq!((robot.name.as_str(), robot.speed_mps, robot.charge, robot.drawer), ("r1", 0.15, 0.5, true));
    }

    #[test]
    fn errors_are_reported_with_scenario_and_field() {
        let error_of = |text: &str| scenarios(text, &design()).unwrap_err().to_string();
        assert_eq!(error_of("[]"), "the file contains no scenarios");
        assert_eq!(
            error_of(&scenario_json("").replace("0.5", "1.5")),
            "scenario aaaaap, r1: battery_charge is 1.5, allowed: 0 to 1"
        );
        assert_eq!(
            error_of(&scenario_json("").replace(r#"{"location": "IC Room 6"}"#, "")),
            "scenario aaaaap has no nurse"
        );
        assert!(error_of("{}").starts_with("these are not scenarios of the published format: "));
        let twice = scenario_json("").trim().trim_start_matches('[').trim_end_matches(']').to_owned();
        assert_eq!(error_of(&format!("[{twice}, {twice}]")), "scenario aaaaap occurs more than once");
    }

    #[test]
    fn a_published_map_is_read() {
        let text = r#"{"nodes": [{"label": "IC Room 1", "x": 0, "y": 0, "yaw": null}, {"label": "IC Corridor 1", "x": 3, "y": 4.001, "yaw": 1}],
            "edges": [{"a": "IC Room 1", "b": "IC Corridor 1", "length_m": 5.0}]}"#;
        let map = published_map(text, "m.json").unwrap();
        assert_eq!((map.places().len(), map.places()[1].kind), (2, PlaceKind::Room));
        assert!((map.lanes()[0].length.get() - 5.0).abs() < 0.01);
        assert!(
            published_map("{}", "m.json")
                .unwrap_err()
                .to_string()
                .starts_with("this is not a map of the published form")
        );
    }
}
