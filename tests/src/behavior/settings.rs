//! Settings: what there is before anything happens.

use super::scenario_setup::{ScenarioMap, ScenarioRobot, ScenarioSetup};
use super::step_arguments::{TableRow, name, split_list};
use super::step_pattern::{SettingFn, StepFailure, StepPattern};
use crate::RobotSpec;
use crate::fleet::nurse_in;
use consort_sim::kinematics::{
    AckermannSettings, AerialSettings, DifferentialSettings, Kinematics, OmnidirectionalSettings,
};
use consort_sim::map;
use consort_sim::space::Sensor;
use consort_sim::world::{
    DoorSetup, ObjectSetup, Obstacle, PersonAction, PersonSetup, PersonTrigger, SpontaneousAction,
};

/// What a table of robots may have.
const ROBOT: [&str; 15] = [
    "name",
    "place",
    "skills",
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

/// All settings.
pub(super) fn phrases() -> Vec<StepPattern<SettingFn>> {
    let says = |pattern, example, does: SettingFn| StepPattern::new(pattern, example, does);
    vec![
        says("seed {number}", "seed 7", |cast, said| {
            let seed = said.value(0).parse::<u64>();
            cast.seed = seed.map_err(|_| StepFailure::invalid("a seed is a whole number, 0 or more"))?;
            Ok(())
        }),
        says(
            "the world runs {number} times as fast as the nodes",
            "the world runs 10 times as fast as the nodes",
            |cast, said| {
                let speed = said.number(0);
                if !(0.1..=100.0).contains(&speed) {
                    return Err(StepFailure::invalid("allowed are 0.1 to 100 times"));
                }
                cast.speed = speed;
                Ok(())
            },
        ),
        says("the map {text}", r#"the map "hospital""#, |cast, said| {
            let wanted = said.value(0);
            let read = if map::SHIPPED.contains(&wanted) {
                map::shipped(wanted).map_err(StepFailure::invalid)?
            } else {
                let file = cast.folder.join(wanted);
                let text = std::fs::read_to_string(&file).map_err(|problem| {
                    let shipped = map::SHIPPED.join(", ");
                    StepFailure::Invalid(format!(
                        "{}: {problem}; maps that come with the program: {shipped}",
                        file.display()
                    ))
                })?;
                map::read(&text, wanted).map_err(StepFailure::invalid)?
            };
            cast.map = ScenarioMap::Map(Box::new(read));
            Ok(())
        }),
        says("this map:", "this map:", |cast, said| {
            let text = said
                .docstring
                .as_deref()
                .ok_or_else(|| StepFailure::invalid("the map follows between lines of \"\"\""))?;
            cast.map = ScenarioMap::Map(Box::new(map::read(text, "map.yaml").map_err(StepFailure::invalid)?));
            Ok(())
        }),
        says("a room of {number} by {number} metres", "a room of 50 by 50 metres", |cast, said| {
            cast.map = ScenarioMap::Room { width_m: said.number(0), depth_m: said.number(1) };
            Ok(())
        }),
        says("a robot {name} at {text}", r#"a robot amber at "Dock""#, |cast, said| {
            cast.robots.push(ScenarioRobot::of(RobotSpec::carrier(said.value(0), said.value(1))));
            Ok(())
        }),
        says(
            "a robot {name} at {text} with skills {names}",
            r#"a robot amber at "Dock" with skills navigation, operate_drawer"#,
            |cast, said| {
                let skills = said.names(2);
                let skills: Vec<&str> = skills.iter().map(String::as_str).collect();
                cast.robots
                    .push(ScenarioRobot::of(RobotSpec::carrier(said.value(0), said.value(1)).with_skills(&skills)));
                Ok(())
            },
        ),
        says("an arm {name} at {text}", r#"an arm lab-arm at "Laboratory""#, |cast, said| {
            cast.robots.push(ScenarioRobot::of(RobotSpec::arm(said.value(0), said.value(1))));
            Ok(())
        }),
        says("these robots:", "these robots:", |cast, said| {
            for row in said.rows(&ROBOT)? {
                cast.robots.push(part(&row)?);
            }
            Ok(())
        }),
        says("(a )station(s) {names}", "stations aster, basil and clove", |cast, said| {
            cast.stations.extend(said.names(0));
            Ok(())
        }),
        says("a nurse in {text}", r#"a nurse in "IC Room 6""#, |cast, said| {
            name::<consort_protocol::ids::PlaceId>(said.value(0))?;
            cast.people.push(nurse_in(said.value(0)));
            Ok(())
        }),
        says("these people:", "these people:", |cast, said| {
            for row in said.rows(&["name", "role", "place", "samples"])? {
                cast.people.push(PersonSetup {
                    name: row.required("name")?.into(),
                    role: name(row.cell("role").unwrap_or("nurse"))?,
                    place: name(row.required("place")?)?,
                    samples: row
                        .cell("samples")
                        .map(split_list)
                        .unwrap_or_default()
                        .iter()
                        .map(|s| s.as_str().into())
                        .collect(),
                    mood: vec![],
                });
            }
            Ok(())
        }),
        says(
            "the nurse in {text} {deed} once {moment}",
            r#"the nurse in "IC Room 6" cancels once handing over"#,
            |cast, said| {
                let mood = SpontaneousAction::certain(moment(said.value(2)), person_action(said.value(1)));
                cast.person_at(said.value(0))?.mood.push(mood);
                Ok(())
            },
        ),
        says(
            "the nurse in {text} walks away once {moment} for {time}",
            r#"the nurse in "IC Room 6" walks away once approached for 5 minutes"#,
            |cast, said| {
                let back_after_s = Some(said.seconds(2));
                let mood = SpontaneousAction {
                    back_after_s,
                    ..SpontaneousAction::certain(moment(said.value(1)), PersonAction::WalksAway)
                };
                cast.person_at(said.value(0))?.mood.push(mood);
                Ok(())
            },
        ),
        says("these things:", "these things:", |cast, said| {
            for row in said.rows(&["name", "place", "weight", "distance"])? {
                cast.objects.push(ObjectSetup {
                    name: row.required("name")?.into(),
                    place: name(row.required("place")?)?,
                    weight_kg: row.number("weight")?.unwrap_or(0.1),
                    distance_m: row.number("distance")?.unwrap_or(0.0),
                });
            }
            Ok(())
        }),
        says("the door {text} lets in {number} at once", r#"the door "Gate" lets in 2 at once"#, |cast, said| {
            let capacity = said.number(1) as usize;
            cast.doors.push(DoorSetup { capacity, ..DoorSetup::named(said.value(0).to_owned()) });
            Ok(())
        }),
        says(
            "the corridor between {text} and {text} is closed",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" is closed"#,
            |cast, said| closes(cast, said.value(0), said.value(1), 0.0, None),
        ),
        says(
            "the corridor between {text} and {text} closes after {time}",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" closes after 30 s"#,
            |cast, said| closes(cast, said.value(0), said.value(1), said.seconds(2), None),
        ),
        says(
            "the corridor between {text} and {text} is closed from {time} to {time}",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" is closed from 30 s to 5 min"#,
            |cast, said| closes(cast, said.value(0), said.value(1), said.seconds(2), Some(said.seconds(3))),
        ),
        says("steps of {time}", "steps of 50 ms", |cast, said| {
            cast.step_s = Some(said.seconds(0));
            Ok(())
        }),
    ]
}

fn closes(cast: &mut ScenarioSetup, a: &str, b: &str, from_s: f64, until_s: Option<f64>) -> Result<(), StepFailure> {
    let obstacle = Obstacle::between(&obstacle_name(a, b), name(a)?, name(b)?);
    cast.obstacles.push(Obstacle { from_s, until_s, ..obstacle });
    Ok(())
}

/// What stands in a corridor that a scenario closes.
pub(super) fn obstacle_name(a: &str, b: &str) -> String {
    let (a, b) = if a <= b { (a, b) } else { (b, a) };
    format!("barrier between {a} and {b}")
}

fn part(row: &TableRow) -> Result<ScenarioRobot, StepFailure> {
    let (robot, place) = (row.required("name")?, row.required("place")?);
    let mut member = RobotSpec::carrier(robot, place);
    if let Some(skills) = row.cell("skills") {
        member.skills = if skills == "none" { vec![] } else { split_list(skills) };
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
    let mut part = ScenarioRobot::of(member);
    let yes = |column: &str| match row.cell(column) {
        None => Ok(None),
        Some("yes") => Ok(Some(true)),
        Some("no") => Ok(Some(false)),
        Some(other) => Err(StepFailure::Invalid(format!("{column}: {other:?} is neither yes nor no"))),
    };
    part.chassis = row.cell("chassis").map(chassis).transpose()?;
    (part.arm, part.drawer) = (yes("arm")?, yes("drawer")?);
    (part.payload_max_kg, part.reach_m) = (row.number("lifts")?, row.number("reach")?);
    part.charges_per_s = percent("charges")?;
    let sensors =
        row.cell("sensors").map(|cell| cell.split(',').map(|text| sensor(text.trim())).collect::<Result<Vec<_>, _>>());
    part.sensors = sensors.transpose()?.unwrap_or_default();
    Ok(part)
}

fn chassis(kind: &str) -> Result<Kinematics, StepFailure> {
    Ok(match kind {
        "differential" => Kinematics::Differential(DifferentialSettings::default()),
        "omnidirectional" => Kinematics::Omnidirectional(OmnidirectionalSettings::default()),
        "ackermann" => Kinematics::Ackermann(AckermannSettings::default()),
        "aerial" => Kinematics::Aerial(AerialSettings::default()),
        other => {
            let known = "differential, omnidirectional, ackermann and aerial";
            return Err(StepFailure::Invalid(format!("{other:?} is no chassis; there are {known}")));
        }
    })
}

/// `range 10 m`, `camera 60 degrees 8 m`, `proximity 2 m`.
fn sensor(text: &str) -> Result<Sensor, StepFailure> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let known = "`range 10 m`, `camera 60 degrees 8 m`, `proximity 2 m`";
    let wrong = || StepFailure::Invalid(format!("{text:?} is no sensor; there are {known}"));
    let number = |word: &str| word.parse::<f64>().map_err(|_| wrong());
    match words[..] {
        ["range", reach, "m"] => Ok(Sensor::Range { bearing_rad: 0.0, reach_m: number(reach)? }),
        ["camera", opening, "degrees", reach, "m"] => {
            Ok(Sensor::Camera { bearing_rad: 0.0, opening_rad: number(opening)?.to_radians(), reach_m: number(reach)? })
        }
        ["proximity", reach, "m"] => Ok(Sensor::Proximity { reach_m: number(reach)? }),
        _ => Err(wrong()),
    }
}

/// What a person does.
pub(super) fn person_action(text: &str) -> PersonAction {
    match text {
        "cancels" => PersonAction::Cancels,
        "declines" => PersonAction::Declines,
        _ => PersonAction::WalksAway,
    }
}

fn moment(text: &str) -> PersonTrigger {
    match text {
        "waiting" => PersonTrigger::Waiting,
        "approached" => PersonTrigger::Approached,
        "authenticated" => PersonTrigger::Authenticated,
        "handing over" => PersonTrigger::HandingOver,
        _ => PersonTrigger::HandedOver,
    }
}
