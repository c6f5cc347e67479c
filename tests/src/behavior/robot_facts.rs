//! Facts about robots: place, charge, goals, collisions and sensors.

use super::fixture::Fixture;
use super::scenario_setup::coordinates;
use super::step_arguments::{StepArguments, name};
use super::step_pattern::{FactStep, fact};
use super::step_result::{StepFailure, StepResult, expect_that};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::scalar::Scalar;
use consort_skills::actions::{GoalResult, GoalStatus, RobotBackend, Telemetry};
use consort_world::world::{DetectedObject, RobotReport, SensorReading, WorldEvent};

/// Returns the steps of this file, in the order of their documentation.
pub(super) fn steps() -> Vec<FactStep> {
    vec![
        is_at(),
        looks_in_direction(),
        has_less_charge(),
        has_more_charge(),
        cannot_move(),
        goal_has_succeeded(),
        goal_result_is(),
        goal_took(),
        goal_was_aborted(),
        any_goal_was_aborted(),
        goal_was_canceled(),
        is_docked(),
        drawer_is_open(),
        drawer_is_closed(),
        has_run_into_robot(),
        has_run_into_wall(),
        no_collision_happened(),
        sees(),
        feels_nearby(),
        measures_ahead(),
        reading_is(),
        reading_is_at_least(),
        reading_is_at_most(),
    ]
}

fn is_at() -> FactStep {
    fact("{name} is at {text}", r#"amber is at "Laboratory""#, |fixture, arguments| {
        let here = telemetry(fixture, arguments)?;
        if let Ok((x, y)) = coordinates(arguments.value(1)) {
            let off = (here.pose.x - x).hypot(here.pose.y - y);
            return expect_that(off < 0.1, || position(&here));
        }
        let there = fixture.with_world(|world| {
            let place = name::<PlaceId>(arguments.value(1)).ok()?;
            world.map().place(&place).map(|place| place.pose)
        });
        let Some(there) = there else {
            return Err(StepFailure::Invalid(format!("there is no place {:?} on this map", arguments.value(1))));
        };
        let near = here.pose.distance(there).get() < 0.1;
        expect_that(near && here.place.as_str() == arguments.value(1), || position(&here))
    })
}

fn looks_in_direction() -> FactStep {
    fact("{name} looks {number} degrees", "amber looks 90 degrees", |fixture, arguments| {
        let here = telemetry(fixture, arguments)?;
        let off = (here.pose.yaw.to_degrees() - arguments.number(1)).rem_euclid(360.0);
        expect_that(off.min(360.0 - off) < 2.0, || format!("it looks {:.1} degrees", here.pose.yaw.to_degrees()))
    })
}

fn has_less_charge() -> FactStep {
    fact(
        "{name} has less than {percent} of its charge",
        "amber has less than 20 % of its charge",
        |fixture, arguments| {
            let charge = telemetry(fixture, arguments)?.battery.get();
            expect_that(charge < arguments.share(1), || format!("it has {:.1} %", charge * 100.0))
        },
    )
}

fn has_more_charge() -> FactStep {
    fact(
        "{name} has more than {percent} of its charge",
        "amber has more than 20 % of its charge",
        |fixture, arguments| {
            let charge = telemetry(fixture, arguments)?.battery.get();
            expect_that(charge > arguments.share(1), || format!("it has {:.1} %", charge * 100.0))
        },
    )
}

fn cannot_move() -> FactStep {
    fact("{name} cannot move", "amber cannot move", |fixture, arguments| {
        let here = telemetry(fixture, arguments)?;
        expect_that(!here.able, || format!("it can, with {:.1} % of its charge", here.battery.get() * 100.0))
    })
}

fn goal_has_succeeded() -> FactStep {
    fact("the goal of {name} has succeeded", "the goal of amber has succeeded", |fixture, arguments| {
        let status = status(fixture, &fixture.robot(arguments.value(0))?)?;
        expect_that(matches!(status, GoalStatus::Succeeded(_)), || status_text(&status))
    })
}

fn goal_result_is() -> FactStep {
    let (pattern, example) =
        ("the result {text} of the goal of {name} is {value}", r#"the result "dust_g" of the goal of amber is 2.5"#);
    fact(pattern, example, |fixture, arguments| {
        let status = status(fixture, &fixture.robot(arguments.value(1))?)?;
        let GoalStatus::Succeeded(GoalResult(results)) = &status else {
            return Err(StepFailure::NotMet(status_text(&status)));
        };
        let (name, expected) = (arguments.value(0), arguments.value(2));
        match results.get(name).and_then(Scalar::from_json) {
            Some(result) => expect_value(&result, expected),
            None => {
                let known: Vec<&str> = results.keys().map(String::as_str).collect();
                Err(StepFailure::Invalid(format!("the goal has no result {name:?}; it has: {}", known.join(", "))))
            }
        }
    })
}

fn goal_took() -> FactStep {
    fact("the goal of {name} took {time} to {time}", "the goal of amber took 20 s to 25 s", |fixture, arguments| {
        let robot = fixture.robot(arguments.value(0))?;
        let status = status(fixture, &robot)?;
        expect_that(matches!(status, GoalStatus::Succeeded(_)), || status_text(&status))?;
        let (id, since) = fixture.goals[&robot];
        let ended = fixture.journal().find_map(|entry| match &entry.event {
            WorldEvent::GoalEnded { robot: whose, id: which, .. } if *whose == robot && *which == id => {
                Some(entry.time.as_secs())
            }
            _ => None,
        });
        let took = ended.expect("it has ended") - since;
        // Results computed from decimals may differ in the last digit.
        let slack = 1e-6;
        expect_that((arguments.seconds(1) - slack..=arguments.seconds(2) + slack).contains(&took), || {
            format!("it took {took:.2} s")
        })
    })
}

fn goal_was_aborted() -> FactStep {
    fact(
        "the goal of {name} was aborted because {text}",
        r#"the goal of amber was aborted because "no lane""#,
        |fixture, arguments| {
            let status = status(fixture, &fixture.robot(arguments.value(0))?)?;
            let because = matches!(&status, GoalStatus::Aborted(why) if why.message.contains(arguments.value(1)));
            expect_that(because, || status_text(&status))
        },
    )
}

fn any_goal_was_aborted() -> FactStep {
    fact(
        "a goal of {name} was aborted because {text}",
        r#"a goal of amber was aborted because "is in the way""#,
        |fixture, arguments| {
            let robot = fixture.robot(arguments.value(0))?;
            let causes = fixture.journal().filter_map(|entry| match &entry.event {
                WorldEvent::GoalEnded { robot: whose, status: GoalStatus::Aborted(why), .. } if *whose == robot => {
                    Some(why.message.as_str())
                }
                _ => None,
            });
            let causes: Vec<&str> = causes.collect();
            expect_that(causes.iter().any(|cause| cause.contains(arguments.value(1))), || {
                if causes.is_empty() {
                    "nothing held it up".to_owned()
                } else {
                    format!("it was because {}", causes.join("; "))
                }
            })
        },
    )
}

fn goal_was_canceled() -> FactStep {
    fact("the goal of {name} was canceled", "the goal of amber was canceled", |fixture, arguments| {
        let status = status(fixture, &fixture.robot(arguments.value(0))?)?;
        expect_that(status == GoalStatus::Canceled, || status_text(&status))
    })
}

fn is_docked() -> FactStep {
    fact("{name} is docked", "amber is docked", |fixture, arguments| {
        let robot = fixture.robot(arguments.value(0))?;
        let latest = fixture.journal().filter_map(|entry| match &entry.event {
            WorldEvent::Docked { robot: whose, docked } if *whose == robot => Some(*docked),
            _ => None,
        });
        expect_that(latest.last() == Some(true), || "it is not".to_owned())
    })
}

fn drawer_is_open() -> FactStep {
    fact("the drawer of {name} is open", "the drawer of amber is open", |fixture, arguments| {
        expect_that(body(fixture, arguments)?.drawer_open, || "it is closed".to_owned())
    })
}

fn drawer_is_closed() -> FactStep {
    fact("the drawer of {name} is closed", "the drawer of amber is closed", |fixture, arguments| {
        expect_that(!body(fixture, arguments)?.drawer_open, || "it is open".to_owned())
    })
}

fn has_run_into_robot() -> FactStep {
    fact("{name} has run into {name}", "amber has run into birch", |fixture, arguments| {
        let collisions = collisions(fixture);
        let pair = [arguments.value(0), arguments.value(1)];
        let ran = collisions.iter().any(|(first, second)| {
            let second = second.as_deref().unwrap_or("a wall");
            (pair == [first, second]) || (pair == [second, first])
        });
        expect_that(ran, || collisions_text(&collisions))
    })
}

fn has_run_into_wall() -> FactStep {
    fact("{name} has run into a wall", "amber has run into a wall", |fixture, arguments| {
        let collisions = collisions(fixture);
        expect_that(collisions.iter().any(|(first, second)| first == arguments.value(0) && second.is_none()), || {
            collisions_text(&collisions)
        })
    })
}

fn no_collision_happened() -> FactStep {
    fact("no robot has run into anything", "no robot has run into anything", |fixture, _| {
        let collisions = collisions(fixture);
        expect_that(collisions.is_empty(), || collisions_text(&collisions))
    })
}

fn sees() -> FactStep {
    fact("{name} sees {names}", "amber sees birch", |fixture, arguments| {
        let detected = detected(fixture, arguments, |reading| match reading {
            SensorReading::Camera(detected) => {
                Some(detected.iter().map(|sighting| &sighting.object).cloned().collect())
            }
            _ => None,
        })?;
        expect_that(arguments.names(1).iter().all(|who| detected.contains(who)), || {
            format!("it sees {}", names_text(&detected))
        })
    })
}

fn feels_nearby() -> FactStep {
    fact("{name} feels {names} nearby", "amber feels birch nearby", |fixture, arguments| {
        let detected = detected(fixture, arguments, |reading| match reading {
            SensorReading::Proximity(detected) => {
                Some(detected.iter().map(|sighting| &sighting.object).cloned().collect())
            }
            _ => None,
        })?;
        expect_that(arguments.names(1).iter().all(|who| detected.contains(who)), || {
            format!("it feels {}", names_text(&detected))
        })
    })
}

fn measures_ahead() -> FactStep {
    fact("{name} measures {number} m ahead", "amber measures 3.75 m ahead", |fixture, arguments| {
        let robot = fixture.robot(arguments.value(0))?;
        let readings = fixture.with_world(|world| world.read_sensors(&robot)).unwrap_or_default();
        let range = readings.iter().find_map(|reading| match reading {
            SensorReading::Range(range) => Some(*range),
            _ => None,
        });
        match range {
            None => Err(StepFailure::Invalid(format!("{robot} has no range sensor"))),
            Some(None) => Err(StepFailure::NotMet("nothing is within its reach".to_owned())),
            Some(Some(range)) => {
                expect_that((range - arguments.number(1)).abs() < 0.01, || format!("it measures {range:.2} m"))
            }
        }
    })
}

fn reading_is() -> FactStep {
    fact("the reading {text} of {name} is {value}", r#"the reading "bag_g" of amber is 0"#, |fixture, arguments| {
        expect_value(&reading(fixture, arguments)?, arguments.value(2))
    })
}

fn reading_is_at_least() -> FactStep {
    let (pattern, example) =
        ("the reading {text} of {name} is at least {number}", r#"the reading "bag_g" of amber is at least 5"#);
    fact(pattern, example, |fixture, arguments| compare_reading(fixture, arguments, f64::ge))
}

fn reading_is_at_most() -> FactStep {
    let (pattern, example) =
        ("the reading {text} of {name} is at most {number}", r#"the reading "bag_g" of amber is at most 5"#);
    fact(pattern, example, |fixture, arguments| compare_reading(fixture, arguments, f64::le))
}

/// Checks that a reading or a result is the value of a step.
pub(super) fn expect_value(value: &Scalar, expected: &str) -> StepResult {
    let is_same = match value {
        Scalar::Number(number) => expected.parse() == Ok(*number),
        Scalar::Bool(_) | Scalar::Integer(_) | Scalar::Text(_) => value.to_string() == expected,
    };
    expect_that(is_same, || format!("it is {value}"))
}

/// Compares the number of a reading with the third argument.
fn compare_reading(fixture: &Fixture, arguments: &StepArguments, holds: fn(&f64, &f64) -> bool) -> StepResult {
    let reading = number_of_reading(fixture, arguments)?;
    expect_that(holds(&reading, &arguments.number(2)), || format!("it is {reading}"))
}

/// Returns a reading; its name is the first argument, its robot the second.
fn reading(fixture: &Fixture, arguments: &StepArguments) -> Result<Scalar, StepFailure> {
    let robot = fixture.robot(arguments.value(1))?;
    let readings = fixture.running().world.telemetry(&robot).expect("a robot of this world").readings;
    let name = arguments.value(0);
    readings.get(name).cloned().ok_or_else(|| {
        let known: Vec<&str> = readings.keys().map(String::as_str).collect();
        StepFailure::Invalid(format!("{robot} has no reading {name:?}; it has: {}", known.join(", ")))
    })
}

fn number_of_reading(fixture: &Fixture, arguments: &StepArguments) -> Result<f64, StepFailure> {
    match reading(fixture, arguments)? {
        Scalar::Number(number) => Ok(number),
        Scalar::Integer(number) => Ok(number as f64),
        other => Err(StepFailure::Invalid(format!("the reading is {other}, which is no number"))),
    }
}

fn telemetry(fixture: &Fixture, arguments: &StepArguments) -> Result<Telemetry, StepFailure> {
    let robot = fixture.robot(arguments.value(0))?;
    Ok(fixture.running().world.telemetry(&robot).expect("a robot of this world"))
}

fn body(fixture: &Fixture, arguments: &StepArguments) -> Result<RobotReport, StepFailure> {
    let robot = fixture.robot(arguments.value(0))?;
    Ok(fixture.with_world(|world| world.robot_report(&robot)).expect("a robot of this world"))
}

fn position(here: &Telemetry) -> String {
    format!("it is at {:.2}, {:.2} (the last place it passed is {})", here.pose.x, here.pose.y, here.place)
}

/// Returns the status of the latest goal that the scenario sent to a robot.
fn status(fixture: &Fixture, robot: &RobotId) -> Result<GoalStatus, StepFailure> {
    let Some((goal, _)) = fixture.goals.get(robot) else {
        return Err(StepFailure::Invalid(format!("this scenario sent no goal to {robot}")));
    };
    Ok(fixture.running().world.status(robot, *goal).expect("a goal that was given"))
}

fn status_text(status: &GoalStatus) -> String {
    match status {
        GoalStatus::Sent => "it has not begun".to_owned(),
        GoalStatus::Executing(feedback) => format!("it is at it; {:.1} m are left", feedback.distance_remaining.get()),
        GoalStatus::Succeeded(_) => "it has done it".to_owned(),
        GoalStatus::Canceled => "it was canceled".to_owned(),
        GoalStatus::Aborted(why) => format!("it could not: {}", why.message),
    }
}

fn collisions(fixture: &Fixture) -> Vec<(String, Option<String>)> {
    let collisions = fixture.journal().filter_map(|entry| match &entry.event {
        WorldEvent::Collided { robot, with } => Some((robot.to_string(), with.as_ref().map(ToString::to_string))),
        _ => None,
    });
    collisions.collect()
}

fn collisions_text(collisions: &[(String, Option<String>)]) -> String {
    if collisions.is_empty() {
        return "there was no collision".to_owned();
    }
    let line = |(first, second): &(String, Option<String>)| {
        format!("{first} has run into {}", second.as_deref().unwrap_or("a wall"))
    };
    collisions.iter().map(line).collect::<Vec<_>>().join("; ")
}

fn detected(
    fixture: &Fixture,
    arguments: &StepArguments,
    of: fn(&SensorReading) -> Option<Vec<DetectedObject>>,
) -> Result<Vec<String>, StepFailure> {
    let robot = fixture.robot(arguments.value(0))?;
    let readings = fixture.with_world(|world| world.read_sensors(&robot)).unwrap_or_default();
    let all: Vec<Vec<DetectedObject>> = readings.iter().filter_map(of).collect();
    if all.is_empty() {
        return Err(StepFailure::Invalid(format!("{robot} has no such sensor")));
    }
    let name = |detected: DetectedObject| match detected {
        DetectedObject::Robot(robot) => robot.to_string(),
        DetectedObject::Person(person) => person.as_str().to_owned(),
    };
    Ok(all.into_iter().flatten().map(name).collect())
}

/// Lists names.
pub(super) fn names_text(names: &[String]) -> String {
    if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
}
