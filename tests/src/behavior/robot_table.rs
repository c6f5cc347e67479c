//! Table of robots: a row per robot with its skills, body, battery and sensors.

use super::scenario_setup::ScenarioRobot;
use super::step_arguments::{TableRow, split_list};
use super::step_result::StepFailure;
use crate::RobotSpec;
use consort_protocol::knowledge::Attributes;
use consort_protocol::scalar::Scalar;
use consort_skills::extensions::Extensions;
use consort_world::extend::SimulatorExtension;
use consort_world::kinematics::{
    AckermannSettings, AerialSettings, DifferentialSettings, Kinematics, OmnidirectionalSettings, OwnSettings,
};
use consort_world::space::Sensor;
use std::collections::BTreeMap;

/// Columns of a table of robots.
pub(super) const COLUMNS: [&str; 16] = [
    "name",
    "place",
    "skills",
    "attributes",
    "speed",
    "charge",
    "uses",
    "really uses",
    "charges",
    "chassis",
    "arm",
    "drawer",
    "lifts",
    "reach",
    "sensors",
    "clock",
];

/// Parses a row of the table of robots.
pub(super) fn parse_robot(row: &TableRow, extensions: Extensions) -> Result<ScenarioRobot, StepFailure> {
    let (name, place) = (row.required("name")?, row.required("place")?);
    let mut member = RobotSpec::carrier(name, place);
    if let Some(skills) = row.cell("skills") {
        member.skills = if skills == "none" { vec![] } else { split_list(skills) };
    }
    if let Some(cell) = row.cell("attributes") {
        member.attributes = attributes(cell)?;
    }
    member.speed = row.number("speed")?.or(member.speed);
    let percent =
        |column: &str| -> Result<Option<f64>, StepFailure> { Ok(row.number(column)?.map(|percent| percent / 100.0)) };
    member.battery = percent("charge")?.unwrap_or(member.battery);
    member.discharge = percent("uses")?.unwrap_or(member.discharge);
    if let Some(really) = percent("really uses")? {
        member.discharge_factor = really / member.discharge;
    }
    member.clock_rate = row.number("clock")?.unwrap_or(member.clock_rate);
    let mut robot = ScenarioRobot::of(member);
    let yes = |column: &str| match row.cell(column) {
        None => Ok(None),
        Some("yes") => Ok(Some(true)),
        Some("no") => Ok(Some(false)),
        Some(other) => Err(StepFailure::Invalid(format!("{column}: {other:?} is neither yes nor no"))),
    };
    robot.chassis = row.cell("chassis").map(|kind| chassis(kind, extensions)).transpose()?;
    (robot.arm, robot.drawer) = (yes("arm")?, yes("drawer")?);
    (robot.payload_max_kg, robot.reach_m) = (row.number("lifts")?, row.number("reach")?);
    robot.charges_per_s = percent("charges")?;
    let sensors =
        row.cell("sensors").map(|cell| cell.split(',').map(|text| sensor(text.trim())).collect::<Result<Vec<_>, _>>());
    robot.sensors = sensors.transpose()?.unwrap_or_default();
    Ok(robot)
}

/// Parses attributes: `section=icu, floor=3, sterile=true`.
fn attributes(text: &str) -> Result<Attributes, StepFailure> {
    let mut values = BTreeMap::new();
    for part in text.split(',') {
        let wrong = || StepFailure::Invalid(format!("{part:?} is no attribute, as `section=icu`"));
        let (name, value) = part.split_once('=').ok_or_else(wrong)?;
        let value = value.trim();
        let typed = serde_json::from_str(value).ok().and_then(|json| Scalar::from_json(&json));
        values.insert(name.trim().to_owned(), typed.unwrap_or_else(|| Scalar::Text(value.to_owned())));
    }
    Attributes::try_from(values).map_err(StepFailure::invalid)
}

fn chassis(kind: &str, extensions: Extensions) -> Result<Kinematics, StepFailure> {
    let own = SimulatorExtension::of(extensions).map_or(&[][..], |own| own.chassis);
    Ok(match kind {
        name if own.iter().any(|(known, _)| *known == name) => Kinematics::Own(OwnSettings::named(name)),
        "differential" => Kinematics::Differential(DifferentialSettings::default()),
        "omnidirectional" => Kinematics::Omnidirectional(OmnidirectionalSettings::default()),
        "ackermann" => Kinematics::Ackermann(AckermannSettings::default()),
        "aerial" => Kinematics::Aerial(AerialSettings::default()),
        other => {
            let own: String = own.iter().map(|(name, _)| format!(", {name}")).collect();
            let known = "differential, omnidirectional, ackermann, aerial";
            return Err(StepFailure::Invalid(format!("{other:?} is no chassis; there are {known}{own}")));
        }
    })
}

/// Parses a sensor: `range 10 m`, `camera 60 degrees 8 m`, `proximity 2 m`.
fn sensor(text: &str) -> Result<Sensor, StepFailure> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let known = "`range 10 m`, `camera 60 degrees 8 m`, `proximity 2 m`";
    let wrong = || StepFailure::Invalid(format!("{text:?} is no sensor; there are {known}"));
    let number = |word: &str| word.parse::<f64>().map_err(|_| wrong());
    match words[..] {
        ["range", reach, "m"] => Ok(Sensor::Range { bearing_rad: 0.0, reach_m: number(reach)? }),
        ["camera", opening, "degrees", reach, "m"] => Ok(Sensor::Camera {
            bearing_rad: 0.0,
            field_of_view_rad: number(opening)?.to_radians(),
            reach_m: number(reach)?,
        }),
        ["proximity", reach, "m"] => Ok(Sensor::Proximity { reach_m: number(reach)? }),
        _ => Err(wrong()),
    }
}
