//! Settings: the initial state of a scenario.

use super::scenario_setup::{ScenarioMap, ScenarioRobot, ScenarioSetup};
use super::step_arguments::{TableRow, name, split_list};
use super::step_pattern::{SettingFn, StepFailure, StepPattern};
use crate::RobotSpec;
use crate::fleet::nurse_in;
use consort_world::kinematics::{
    AckermannSettings, AerialSettings, DifferentialSettings, Kinematics, OmnidirectionalSettings,
};
use consort_world::map;
use consort_world::space::Sensor;
use consort_world::world::{
    DoorSetup, ObjectSetup, Obstacle, PersonAction, PersonSetup, PersonTrigger, SpontaneousAction,
};

/// Columns of a table of robots.
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

/// Returns the patterns of all settings.
pub(super) fn patterns() -> Vec<StepPattern<SettingFn>> {
    let setting = |pattern, example, does: SettingFn| StepPattern::new(pattern, example, does);
    vec![
        setting("seed {number}", "seed 7", |cast, arguments| {
            let seed = arguments.value(0).parse::<u64>();
            cast.seed = seed.map_err(|_| StepFailure::invalid("a seed is a whole number, 0 or more"))?;
            Ok(())
        }),
        setting(
            "the world runs {number} times as fast as the nodes",
            "the world runs 10 times as fast as the nodes",
            |cast, arguments| {
                let speed = arguments.number(0);
                if !(0.1..=100.0).contains(&speed) {
                    return Err(StepFailure::invalid("allowed are 0.1 to 100 times"));
                }
                cast.speed = speed;
                Ok(())
            },
        ),
        setting("the map {text}", r#"the map "hospital""#, |cast, arguments| {
            let wanted = arguments.value(0);
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
        setting("this map:", "this map:", |cast, arguments| {
            let text = arguments
                .docstring
                .as_deref()
                .ok_or_else(|| StepFailure::invalid("the map follows between lines of \"\"\""))?;
            cast.map = ScenarioMap::Map(Box::new(map::read(text, "map.yaml").map_err(StepFailure::invalid)?));
            Ok(())
        }),
        setting("a room of {number} by {number} metres", "a room of 50 by 50 metres", |cast, arguments| {
            cast.map = ScenarioMap::Room { width_m: arguments.number(0), depth_m: arguments.number(1) };
            Ok(())
        }),
        setting("a robot {name} at {text}", r#"a robot amber at "Dock""#, |cast, arguments| {
            cast.robots.push(ScenarioRobot::of(RobotSpec::carrier(arguments.value(0), arguments.value(1))));
            Ok(())
        }),
        setting(
            "a robot {name} at {text} with skills {names}",
            r#"a robot amber at "Dock" with skills navigation, operate_drawer"#,
            |cast, arguments| {
                let skills = arguments.names(2);
                let skills: Vec<&str> = skills.iter().map(String::as_str).collect();
                cast.robots.push(ScenarioRobot::of(
                    RobotSpec::carrier(arguments.value(0), arguments.value(1)).with_skills(&skills),
                ));
                Ok(())
            },
        ),
        setting("an arm {name} at {text}", r#"an arm lab-arm at "Laboratory""#, |cast, arguments| {
            cast.robots.push(ScenarioRobot::of(RobotSpec::arm(arguments.value(0), arguments.value(1))));
            Ok(())
        }),
        setting("these robots:", "these robots:", |cast, arguments| {
            for row in arguments.rows(&ROBOT)? {
                cast.robots.push(parse_robot(&row)?);
            }
            Ok(())
        }),
        setting("(a )station(s) {names}", "stations aster, basil and clove", |cast, arguments| {
            cast.stations.extend(arguments.names(0));
            Ok(())
        }),
        setting("a nurse in {text}", r#"a nurse in "IC Room 6""#, |cast, arguments| {
            name::<consort_protocol::ids::PlaceId>(arguments.value(0))?;
            cast.people.push(nurse_in(arguments.value(0)));
            Ok(())
        }),
        setting("these people:", "these people:", |cast, arguments| {
            for row in arguments.rows(&["name", "role", "place", "samples"])? {
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
                    spontaneous_actions: vec![],
                });
            }
            Ok(())
        }),
        setting(
            "the nurse in {text} {person_action} once {moment}",
            r#"the nurse in "IC Room 6" cancels once handing over"#,
            |cast, arguments| {
                let action = SpontaneousAction::certain(moment(arguments.value(2)), person_action(arguments.value(1)));
                cast.person_at(arguments.value(0))?.spontaneous_actions.push(action);
                Ok(())
            },
        ),
        setting(
            "the nurse in {text} walks away once {moment} for {time}",
            r#"the nurse in "IC Room 6" walks away once approached for 5 minutes"#,
            |cast, arguments| {
                let back_after_s = Some(arguments.seconds(2));
                let action = SpontaneousAction {
                    back_after_s,
                    ..SpontaneousAction::certain(moment(arguments.value(1)), PersonAction::WalksAway)
                };
                cast.person_at(arguments.value(0))?.spontaneous_actions.push(action);
                Ok(())
            },
        ),
        setting("these things:", "these things:", |cast, arguments| {
            for row in arguments.rows(&["name", "place", "weight", "distance"])? {
                cast.objects.push(ObjectSetup {
                    name: row.required("name")?.into(),
                    place: name(row.required("place")?)?,
                    weight_kg: row.number("weight")?.unwrap_or(0.1),
                    distance_m: row.number("distance")?.unwrap_or(0.0),
                });
            }
            Ok(())
        }),
        setting(
            "the door {text} lets in {number} at once",
            r#"the door "Gate" lets in 2 at once"#,
            |cast, arguments| {
                let capacity = arguments.number(1) as usize;
                cast.doors.push(DoorSetup { capacity, ..DoorSetup::named(arguments.value(0).to_owned()) });
                Ok(())
            },
        ),
        setting(
            "the corridor between {text} and {text} is closed",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" is closed"#,
            |cast, arguments| close_corridor(cast, arguments.value(0), arguments.value(1), 0.0, None),
        ),
        setting(
            "the corridor between {text} and {text} closes after {time}",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" closes after 30 s"#,
            |cast, arguments| close_corridor(cast, arguments.value(0), arguments.value(1), arguments.seconds(2), None),
        ),
        setting(
            "the corridor between {text} and {text} is closed from {time} to {time}",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" is closed from 30 s to 5 min"#,
            |cast, arguments| {
                close_corridor(
                    cast,
                    arguments.value(0),
                    arguments.value(1),
                    arguments.seconds(2),
                    Some(arguments.seconds(3)),
                )
            },
        ),
        setting("steps of {time}", "steps of 50 ms", |cast, arguments| {
            cast.step_s = Some(arguments.seconds(0));
            Ok(())
        }),
    ]
}

fn close_corridor(
    cast: &mut ScenarioSetup,
    a: &str,
    b: &str,
    from_s: f64,
    until_s: Option<f64>,
) -> Result<(), StepFailure> {
    let obstacle = Obstacle::between(&obstacle_name(a, b), name(a)?, name(b)?);
    cast.obstacles.push(Obstacle { from_s, until_s, ..obstacle });
    Ok(())
}

/// Returns the name of the obstacle that closes a corridor.
pub(super) fn obstacle_name(a: &str, b: &str) -> String {
    let (a, b) = if a <= b { (a, b) } else { (b, a) };
    format!("barrier between {a} and {b}")
}

fn parse_robot(row: &TableRow) -> Result<ScenarioRobot, StepFailure> {
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
    let mut parse_robot = ScenarioRobot::of(member);
    let yes = |column: &str| match row.cell(column) {
        None => Ok(None),
        Some("yes") => Ok(Some(true)),
        Some("no") => Ok(Some(false)),
        Some(other) => Err(StepFailure::Invalid(format!("{column}: {other:?} is neither yes nor no"))),
    };
    parse_robot.chassis = row.cell("chassis").map(chassis).transpose()?;
    (parse_robot.arm, parse_robot.drawer) = (yes("arm")?, yes("drawer")?);
    (parse_robot.payload_max_kg, parse_robot.reach_m) = (row.number("lifts")?, row.number("reach")?);
    parse_robot.charges_per_s = percent("charges")?;
    let sensors =
        row.cell("sensors").map(|cell| cell.split(',').map(|text| sensor(text.trim())).collect::<Result<Vec<_>, _>>());
    parse_robot.sensors = sensors.transpose()?.unwrap_or_default();
    Ok(parse_robot)
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

/// Parses an action of a person.
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
