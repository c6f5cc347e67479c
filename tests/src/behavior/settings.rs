//! Settings: the initial state of a scenario.

use super::robot_table;
use super::scenario_setup::{ScenarioMap, ScenarioRobot, ScenarioSetup};
use super::step_arguments::{name, split_list};
use super::step_pattern::{SettingStep, setting};
use super::step_result::{StepFailure, StepResult};
use crate::RobotSpec;
use crate::fleet::nurse_in;
use consort_protocol::ensemble::{Ensemble, EnsembleSpec};
use consort_protocol::ids::PlaceId;
use consort_protocol::yaml;
use consort_skills::domain_file::{DomainFile, DomainForm};
use consort_world::map;
use consort_world::world::{
    DoorSetup, ObjectSetup, Obstacle, PersonAction, PersonSetup, PersonTrigger, SpontaneousAction,
};
use std::collections::BTreeSet;
use std::fmt::Display;
use std::path::Path;

/// Returns the steps of this file, in the order of their documentation.
pub(super) fn steps() -> Vec<SettingStep> {
    vec![
        seed(),
        world_speed(),
        shipped_or_read_map(),
        map_text(),
        empty_room(),
        domain_file(),
        robot_at(),
        robot_with_skills(),
        arm_at(),
        robot_table(),
        stations(),
        ensemble(),
        nurse_in_room(),
        people_table(),
        nurse_acts_once(),
        nurse_walks_away_for(),
        object_table(),
        door_capacity(),
        corridor_is_closed(),
        corridor_closes_after(),
        corridor_is_closed_from_to(),
        world_step(),
    ]
}

fn seed() -> SettingStep {
    setting("seed {number}", "seed 7", |setup, arguments| {
        let seed = arguments.value(0).parse::<u64>();
        setup.seed = seed.map_err(|_| StepFailure::invalid("a seed is a whole number, 0 or more"))?;
        Ok(())
    })
}

fn world_speed() -> SettingStep {
    setting(
        "the world runs {number} times as fast as the nodes",
        "the world runs 10 times as fast as the nodes",
        |setup, arguments| {
            let speed = arguments.number(0);
            if !(0.1..=100.0).contains(&speed) {
                return Err(StepFailure::invalid("allowed are 0.1 to 100 times"));
            }
            setup.speed = speed;
            Ok(())
        },
    )
}

fn shipped_or_read_map() -> SettingStep {
    setting("the map {text}", r#"the map "hospital""#, |setup, arguments| {
        let wanted = arguments.value(0);
        let read = if map::SHIPPED.contains(&wanted) {
            map::shipped(wanted).map_err(StepFailure::invalid)?
        } else {
            let file = setup.folder.join(wanted);
            let text = std::fs::read_to_string(&file).map_err(|problem| {
                let shipped = map::SHIPPED.join(", ");
                StepFailure::Invalid(format!(
                    "{}: {problem}; maps that come with the program: {shipped}",
                    file.display()
                ))
            })?;
            consort_map_import::read(&text, wanted).map_err(StepFailure::invalid)?
        };
        setup.map = ScenarioMap::Map(Box::new(read));
        Ok(())
    })
}

fn map_text() -> SettingStep {
    setting("this map:", "this map:", |setup, arguments| {
        let text = arguments
            .docstring
            .as_deref()
            .ok_or_else(|| StepFailure::invalid("the map follows between lines of \"\"\""))?;
        setup.map = ScenarioMap::Map(Box::new(map::read(text, "map.yaml").map_err(StepFailure::invalid)?));
        Ok(())
    })
}

fn empty_room() -> SettingStep {
    setting("a room of {number} by {number} metres", "a room of 50 by 50 metres", |setup, arguments| {
        setup.map = ScenarioMap::Room { width_m: arguments.number(0), depth_m: arguments.number(1) };
        Ok(())
    })
}

fn domain_file() -> SettingStep {
    setting("the domain {text}", r#"the domain "plants/domain.yaml""#, |setup, arguments| {
        let file = setup.folder.join(arguments.value(0));
        let invalid = |problem: &dyn Display| StepFailure::Invalid(format!("{}: {problem}", file.display()));
        let read = |path: &Path| std::fs::read_to_string(path).map_err(|problem| invalid(&problem));
        let form: DomainForm = yaml::parse(&read(&file)?).map_err(|problem| invalid(&problem))?;
        let tree = |name: &str| Ok((name.to_owned(), read(&file.with_file_name(name))?));
        let trees = form.tree_files().map(tree).collect::<Result<_, StepFailure>>()?;
        let known: Vec<&DomainFile> = setup.extensions.files().collect();
        let checked = DomainFile::check(form, &trees, &known);
        let domain = checked
            .map_err(|problems| invalid(&problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")))?;
        setup.extensions = setup.extensions.with_domain(file, domain);
        Ok(())
    })
}

fn robot_at() -> SettingStep {
    setting("a robot {name} at {text}", r#"a robot amber at "Dock""#, |setup, arguments| {
        setup.robots.push(ScenarioRobot::of(RobotSpec::carrier(arguments.value(0), arguments.value(1))));
        Ok(())
    })
}

fn robot_with_skills() -> SettingStep {
    setting(
        "a robot {name} at {text} with skills {names}",
        r#"a robot amber at "Dock" with skills navigation, operate_drawer"#,
        |setup, arguments| {
            let skills = arguments.names(2);
            let skills: Vec<&str> = skills.iter().map(String::as_str).collect();
            setup.robots.push(ScenarioRobot::of(
                RobotSpec::carrier(arguments.value(0), arguments.value(1)).with_skills(&skills),
            ));
            Ok(())
        },
    )
}

fn arm_at() -> SettingStep {
    setting("an arm {name} at {text}", r#"an arm lab-arm at "Laboratory""#, |setup, arguments| {
        setup.robots.push(ScenarioRobot::of(RobotSpec::arm(arguments.value(0), arguments.value(1))));
        Ok(())
    })
}

fn robot_table() -> SettingStep {
    setting("these robots:", "these robots:", |setup, arguments| {
        for row in arguments.rows(&robot_table::COLUMNS)? {
            setup.robots.push(robot_table::parse_robot(&row, setup.extensions)?);
        }
        Ok(())
    })
}

fn stations() -> SettingStep {
    setting("(a )station(s) {names}", "stations aster, basil and clove", |setup, arguments| {
        setup.stations.extend(arguments.names(0));
        Ok(())
    })
}

fn ensemble() -> SettingStep {
    setting(
        "an ensemble {name} of robots with {text}",
        r#"an ensemble icu of robots with "member.attributes.section == 'icu'""#,
        |setup, arguments| {
            let spec = EnsembleSpec {
                membership: vec!["member.robot".to_owned(), arguments.value(1).to_owned()],
                ..EnsembleSpec::with_any_skill_of(name(arguments.value(0))?, BTreeSet::new())
            };
            Ensemble::compile(spec.clone()).map_err(StepFailure::invalid)?;
            setup.ensembles.push(spec);
            Ok(())
        },
    )
}

fn nurse_in_room() -> SettingStep {
    setting("a nurse in {text}", r#"a nurse in "IC Room 6""#, |setup, arguments| {
        name::<PlaceId>(arguments.value(0))?;
        setup.people.push(nurse_in(arguments.value(0)));
        Ok(())
    })
}

fn people_table() -> SettingStep {
    setting("these people:", "these people:", |setup, arguments| {
        for row in arguments.rows(&["name", "role", "place", "samples"])? {
            let (role, place) = (name(row.cell("role").unwrap_or("nurse"))?, name(row.required("place")?)?);
            let samples = row.cell("samples").map(split_list).unwrap_or_default();
            setup.people.push(PersonSetup {
                samples: samples.iter().map(|sample| sample.as_str().into()).collect(),
                ..PersonSetup::new(row.required("name")?, role, place)
            });
        }
        Ok(())
    })
}

fn nurse_acts_once() -> SettingStep {
    setting(
        "the nurse in {text} {person_action} once {moment}",
        r#"the nurse in "IC Room 6" cancels once handing over"#,
        |setup, arguments| {
            let action = SpontaneousAction::certain(moment(arguments.value(2)), person_action(arguments.value(1)));
            setup.person_at(arguments.value(0))?.spontaneous_actions.push(action);
            Ok(())
        },
    )
}

fn nurse_walks_away_for() -> SettingStep {
    setting(
        "the nurse in {text} walks away once {moment} for {time}",
        r#"the nurse in "IC Room 6" walks away once approached for 5 minutes"#,
        |setup, arguments| {
            let back_after_s = Some(arguments.seconds(2));
            let action = SpontaneousAction {
                back_after_s,
                ..SpontaneousAction::certain(moment(arguments.value(1)), PersonAction::WalksAway)
            };
            setup.person_at(arguments.value(0))?.spontaneous_actions.push(action);
            Ok(())
        },
    )
}

fn object_table() -> SettingStep {
    setting("these things:", "these things:", |setup, arguments| {
        for row in arguments.rows(&["name", "place", "weight", "distance"])? {
            setup.objects.push(ObjectSetup {
                name: row.required("name")?.into(),
                place: name(row.required("place")?)?,
                weight_kg: row.number("weight")?.unwrap_or(0.1),
                distance_m: row.number("distance")?.unwrap_or(0.0),
            });
        }
        Ok(())
    })
}

fn door_capacity() -> SettingStep {
    setting("the door {text} lets in {number} at once", r#"the door "Gate" lets in 2 at once"#, |setup, arguments| {
        let capacity = arguments.number(1) as usize;
        setup.doors.push(DoorSetup { capacity, ..DoorSetup::named(arguments.value(0).to_owned()) });
        Ok(())
    })
}

fn corridor_is_closed() -> SettingStep {
    setting(
        "the corridor between {text} and {text} is closed",
        r#"the corridor between "IC Corridor 3" and "IC Corridor 6" is closed"#,
        |setup, arguments| close_corridor(setup, arguments.value(0), arguments.value(1), 0.0, None),
    )
}

fn corridor_closes_after() -> SettingStep {
    setting(
        "the corridor between {text} and {text} closes after {time}",
        r#"the corridor between "IC Corridor 3" and "IC Corridor 6" closes after 30 s"#,
        |setup, arguments| close_corridor(setup, arguments.value(0), arguments.value(1), arguments.seconds(2), None),
    )
}

fn corridor_is_closed_from_to() -> SettingStep {
    setting(
        "the corridor between {text} and {text} is closed from {time} to {time}",
        r#"the corridor between "IC Corridor 3" and "IC Corridor 6" is closed from 30 s to 5 min"#,
        |setup, arguments| {
            close_corridor(
                setup,
                arguments.value(0),
                arguments.value(1),
                arguments.seconds(2),
                Some(arguments.seconds(3)),
            )
        },
    )
}

fn world_step() -> SettingStep {
    setting("steps of {time}", "steps of 50 ms", |setup, arguments| {
        setup.step_s = Some(arguments.seconds(0));
        Ok(())
    })
}

fn close_corridor(setup: &mut ScenarioSetup, a: &str, b: &str, from_s: f64, until_s: Option<f64>) -> StepResult {
    let obstacle = Obstacle::between(&obstacle_name(a, b), name(a)?, name(b)?);
    setup.obstacles.push(Obstacle { from_s, until_s, ..obstacle });
    Ok(())
}

/// Returns the name of the obstacle that closes a corridor.
pub(super) fn obstacle_name(a: &str, b: &str) -> String {
    let (a, b) = if a <= b { (a, b) } else { (b, a) };
    format!("barrier between {a} and {b}")
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
