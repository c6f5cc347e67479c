//! Facts of robots, people, things and the building.

use super::fixture::Fixture;
use super::scenario_setup::coordinates;
use super::step_arguments::{StepArguments, name};
use super::step_pattern::{FactFn, StepFailure, StepPattern, StepResult, expect_that};
use consort_protocol::ids::RobotId;
use consort_sim::world::{DetectedObject, RobotReport, SampleHolder, SampleReport, SensorReading, WorldEvent};
use consort_skills::actions::{GoalStatus, RobotBackend, Telemetry};

/// All of them.
pub(super) fn phrases() -> Vec<StepPattern<FactFn>> {
    let is = |pattern, example, fact: FactFn| StepPattern::new(pattern, example, fact);
    vec![
        is("{name} is at {text}", r#"amber is at "Laboratory""#, |stage, said| {
            let here = telemetry(stage, said)?;
            if let Ok((x, y)) = coordinates(said.value(1)) {
                let off = (here.pose.x - x).hypot(here.pose.y - y);
                return expect_that(off < 0.1, || position(&here));
            }
            let there = stage.with_world(|world| {
                let place = name::<consort_protocol::ids::PlaceId>(said.value(1)).ok()?;
                world.map().place(&place).map(|place| place.pose)
            });
            let Some(there) = there else {
                return Err(StepFailure::Invalid(format!("there is no place {:?} on this map", said.value(1))));
            };
            let near = here.pose.distance(there).get() < 0.1;
            expect_that(near && here.place.as_str() == said.value(1), || position(&here))
        }),
        is("{name} looks {number} degrees", "amber looks 90 degrees", |stage, said| {
            let here = telemetry(stage, said)?;
            let off = (here.pose.yaw.to_degrees() - said.number(1)).rem_euclid(360.0);
            expect_that(off.min(360.0 - off) < 2.0, || format!("it looks {:.1} degrees", here.pose.yaw.to_degrees()))
        }),
        is("{name} has less than {percent} of its charge", "amber has less than 20 % of its charge", |stage, said| {
            let charge = telemetry(stage, said)?.battery.get();
            expect_that(charge < said.share(1), || format!("it has {:.1} %", charge * 100.0))
        }),
        is("{name} has more than {percent} of its charge", "amber has more than 20 % of its charge", |stage, said| {
            let charge = telemetry(stage, said)?.battery.get();
            expect_that(charge > said.share(1), || format!("it has {:.1} %", charge * 100.0))
        }),
        is("{name} cannot move", "amber cannot move", |stage, said| {
            let here = telemetry(stage, said)?;
            expect_that(!here.able, || format!("it can, with {:.1} % of its charge", here.battery.get() * 100.0))
        }),
        is("{name} has done what it was told", "amber has done what it was told", |stage, said| {
            let status = status(stage, said)?;
            expect_that(status == GoalStatus::Succeeded, || in_words(&status))
        }),
        is("{name} did it in {time} to {time}", "amber did it in 20 s to 25 s", |stage, said| {
            let (status, robot) = (status(stage, said)?, stage.robot(said.value(0))?);
            expect_that(status == GoalStatus::Succeeded, || in_words(&status))?;
            let (id, since) = stage.goals[&robot];
            let ended = stage.journal().find_map(|entry| match &entry.event {
                WorldEvent::GoalEnded { robot: whose, id: which, .. } if *whose == robot && *which == id => {
                    Some(entry.time.as_secs())
                }
                _ => None,
            });
            let took = ended.expect("it has ended") - since;
            // What is computed from decimals may be off in the last place.
            let slack = 1e-6;
            expect_that((said.seconds(1) - slack..=said.seconds(2) + slack).contains(&took), || {
                format!("it took {took:.2} s")
            })
        }),
        is("{name} could not because {text}", r#"amber could not because "no lane""#, |stage, said| {
            let status = status(stage, said)?;
            let because = matches!(&status, GoalStatus::Aborted(why) if why.message.contains(said.value(1)));
            expect_that(because, || in_words(&status))
        }),
        is("{name} was held up because {text}", r#"amber was held up because "stands in it""#, |stage, said| {
            let robot = stage.robot(said.value(0))?;
            let causes = stage.journal().filter_map(|entry| match &entry.event {
                WorldEvent::GoalEnded { robot: whose, status: GoalStatus::Aborted(why), .. } if *whose == robot => {
                    Some(why.message.as_str())
                }
                _ => None,
            });
            let causes: Vec<&str> = causes.collect();
            expect_that(causes.iter().any(|cause| cause.contains(said.value(1))), || {
                if causes.is_empty() {
                    "nothing held it up".to_owned()
                } else {
                    format!("it was because {}", causes.join("; "))
                }
            })
        }),
        is("{name} was stopped", "amber was stopped", |stage, said| {
            let status = status(stage, said)?;
            expect_that(status == GoalStatus::Canceled, || in_words(&status))
        }),
        is("{name} is docked", "amber is docked", |stage, said| {
            let robot = stage.robot(said.value(0))?;
            let latest = stage.journal().filter_map(|entry| match &entry.event {
                WorldEvent::Docked { robot: whose, docked } if *whose == robot => Some(*docked),
                _ => None,
            });
            expect_that(latest.last() == Some(true), || "it is not".to_owned())
        }),
        is("the drawer of {name} is open", "the drawer of amber is open", |stage, said| {
            expect_that(body(stage, said)?.drawer_open, || "it is closed".to_owned())
        }),
        is("the drawer of {name} is closed", "the drawer of amber is closed", |stage, said| {
            expect_that(!body(stage, said)?.drawer_open, || "it is open".to_owned())
        }),
        is("{name} has run into {name}", "amber has run into birch", |stage, said| {
            let collisions = collisions(stage);
            let pair = [said.value(0), said.value(1)];
            let ran = collisions.iter().any(|(one, other)| {
                let other = other.as_deref().unwrap_or("a wall");
                (pair == [one, other]) || (pair == [other, one])
            });
            expect_that(ran, || collided(&collisions))
        }),
        is("{name} has run into a wall", "amber has run into a wall", |stage, said| {
            let collisions = collisions(stage);
            expect_that(collisions.iter().any(|(one, other)| one == said.value(0) && other.is_none()), || {
                collided(&collisions)
            })
        }),
        is("no robot has run into anything", "no robot has run into anything", |stage, _| {
            let collisions = collisions(stage);
            expect_that(collisions.is_empty(), || collided(&collisions))
        }),
        is("{name} sees {names}", "amber sees birch", |stage, said| {
            let seen = seen(stage, said, |reading| match reading {
                SensorReading::Camera(seen) => Some(seen.iter().map(|sighting| &sighting.object).cloned().collect()),
                _ => None,
            })?;
            expect_that(said.names(1).iter().all(|who| seen.contains(who)), || format!("it sees {}", list(&seen)))
        }),
        is("{name} feels {names} nearby", "amber feels birch nearby", |stage, said| {
            let seen = seen(stage, said, |reading| match reading {
                SensorReading::Proximity(seen) => Some(seen.iter().map(|sighting| &sighting.object).cloned().collect()),
                _ => None,
            })?;
            expect_that(said.names(1).iter().all(|who| seen.contains(who)), || format!("it feels {}", list(&seen)))
        }),
        is("{name} measures {number} m ahead", "amber measures 3.75 m ahead", |stage, said| {
            let robot = stage.robot(said.value(0))?;
            let readings = stage.with_world(|world| world.read_sensors(&robot)).unwrap_or_default();
            let range = readings.iter().find_map(|reading| match reading {
                SensorReading::Range(range) => Some(*range),
                _ => None,
            });
            match range {
                None => Err(StepFailure::Invalid(format!("{robot} has no range sensor"))),
                Some(None) => Err(StepFailure::NotMet("nothing is within its reach".to_owned())),
                Some(Some(range)) => {
                    expect_that((range - said.number(1)).abs() < 0.01, || format!("it measures {range:.2} m"))
                }
            }
        }),
        is("{name} holds {text}", r#"lab-arm holds "sample of IC Room 6""#, |stage, said| {
            let robot = stage.robot(said.value(0))?;
            keeper(stage, said.value(1), &SampleHolder::Arm(robot))
        }),
        is("{text} is in the drawer of {name}", r#""sample of IC Room 6" is in the drawer of amber"#, |stage, said| {
            let robot = stage.robot(said.value(1))?;
            keeper(stage, said.value(0), &SampleHolder::Drawer(robot))
        }),
        is("{text} lies at {text}", r#""tray" lies at "Laboratory""#, |stage, said| {
            keeper(stage, said.value(0), &SampleHolder::Table(name(said.value(1))?))
        }),
        is(
            "{text} is still with {text}",
            r#""sample of IC Room 6" is still with "nurse of IC Room 6""#,
            |stage, said| keeper(stage, said.value(0), &SampleHolder::Person(said.value(1).into())),
        ),
        is(
            "the sample of {text} was delivered to {name}",
            r#"the sample of "IC Room 6" was delivered to lab-arm"#,
            |stage, said| {
                let (robot, id) = (stage.robot(said.value(1))?, format!("sample of {}", said.value(0)));
                let report = sample(stage, &id)?;
                let mut keepers: Vec<&SampleHolder> = report.history.iter().map(|(_, keeper)| keeper).collect();
                keepers.push(&report.keeper);
                // An arm lays down what it holds when the next sample comes.
                keepers.pop_if(|last| matches!(last, SampleHolder::Table(_)));
                let delivered = matches!(keepers[..], [SampleHolder::Person(_), SampleHolder::Drawer(_), SampleHolder::Arm(arm)] if *arm == robot);
                expect_that(delivered, || {
                    let hands: Vec<String> = keepers.into_iter().map(with).collect();
                    format!("it was {}", hands.join(", then "))
                })
            },
        ),
        is("the nurse in {text} is away", r#"the nurse in "IC Room 6" is away"#, |stage, said| {
            let people = stage.with_world(|world| world.people());
            let person = people.iter().find(|person| person.place.as_str() == said.value(0));
            let person =
                person.ok_or_else(|| StepFailure::Invalid(format!("nobody belongs at {:?}", said.value(0))))?;
            expect_that(person.away, || "she is there".to_owned())
        }),
        is("door {text} is open", r#"door "Gate" is open"#, |stage, said| {
            expect_that(is_open(stage, said)?, || "it is closed".to_owned())
        }),
        is("door {text} is closed", r#"door "Gate" is closed"#, |stage, said| {
            expect_that(!is_open(stage, said)?, || "it is open".to_owned())
        }),
        is("{name} waits at {text}", r#"amber waits at "Gate""#, |stage, said| {
            let robot = stage.robot(said.value(0))?;
            expect_that(passage(stage, &robot, said.value(1))? == Some(Passage::Waits), || {
                "it does not wait there".to_owned()
            })
        }),
        is("{name} has passed {text}", r#"amber has passed "Gate""#, |stage, said| {
            let robot = stage.robot(said.value(0))?;
            let now = passage(stage, &robot, said.value(1))?;
            expect_that(now == Some(Passage::Left), || match now {
                None => "it has not come there".to_owned(),
                Some(Passage::Waits) => "it waits there".to_owned(),
                Some(_) => "it is within".to_owned(),
            })
        }),
        is("{name} is within {text}", r#"amber is within "Lift""#, |stage, said| {
            let robot = stage.robot(said.value(0))?;
            expect_that(passage(stage, &robot, said.value(1))? == Some(Passage::Within), || "it is not".to_owned())
        }),
        is(
            "at most {number} robot(s) was/were ever within {text}",
            r#"at most 1 robot was ever within "Lift""#,
            |stage, said| {
                let (mut within, mut most) = (0_i64, 0);
                for (_, passage) in passages(stage, said.value(1))? {
                    within += match passage {
                        Passage::Within => 1,
                        Passage::Left => -1,
                        Passage::Waits => 0,
                    };
                    within = within.max(0);
                    most = most.max(within);
                }
                expect_that(most as f64 <= said.number(0), || format!("{most} were at once"))
            },
        ),
        is("{name} passed {text} before {name}", r#"amber passed "Gate" before birch"#, |stage, said| {
            let (one, other) = (stage.robot(said.value(0))?, stage.robot(said.value(2))?);
            let mut order = vec![];
            for (robot, passage) in passages(stage, said.value(1))? {
                if passage == Passage::Within && !order.contains(&robot) {
                    order.push(robot);
                }
            }
            let place = |robot| order.iter().position(|passed| passed == robot);
            let before = place(&one).is_some_and(|one| place(&other).is_none_or(|other| one < other));
            expect_that(before, || {
                let order: Vec<&str> = order.iter().map(RobotId::as_str).collect();
                format!(
                    "there passed, in this order: {}",
                    if order.is_empty() { "nobody".to_owned() } else { order.join(", ") }
                )
            })
        }),
    ]
}

fn telemetry(stage: &Fixture, said: &StepArguments) -> Result<Telemetry, StepFailure> {
    let robot = stage.robot(said.value(0))?;
    Ok(stage.running().world.telemetry(&robot).expect("a robot that is here"))
}

fn body(stage: &Fixture, said: &StepArguments) -> Result<RobotReport, StepFailure> {
    let robot = stage.robot(said.value(0))?;
    Ok(stage.with_world(|world| world.robot_report(&robot)).expect("a robot that is here"))
}

fn position(here: &Telemetry) -> String {
    format!("it is at {:.2}, {:.2} (the last place it passed is {})", here.pose.x, here.pose.y, here.place)
}

/// How the latest goal stands that the scenario gave a robot.
fn status(stage: &Fixture, said: &StepArguments) -> Result<GoalStatus, StepFailure> {
    let robot = stage.robot(said.value(0))?;
    let Some((goal, _)) = stage.goals.get(&robot) else {
        return Err(StepFailure::Invalid(format!("{robot} was told nothing by this scenario")));
    };
    Ok(stage.running().world.status(&robot, *goal).expect("a goal that was given"))
}

fn in_words(status: &GoalStatus) -> String {
    match status {
        GoalStatus::Sent => "it has not begun".to_owned(),
        GoalStatus::Executing(feedback) => format!("it is at it; {:.1} m are left", feedback.distance_remaining.get()),
        GoalStatus::Succeeded => "it has done it".to_owned(),
        GoalStatus::Canceled => "it was stopped".to_owned(),
        GoalStatus::Aborted(why) => format!("it could not: {}", why.message),
    }
}

fn collisions(stage: &Fixture) -> Vec<(String, Option<String>)> {
    let collided = stage.journal().filter_map(|entry| match &entry.event {
        WorldEvent::Collided { robot, with } => Some((robot.to_string(), with.as_ref().map(ToString::to_string))),
        _ => None,
    });
    collided.collect()
}

fn collided(collisions: &[(String, Option<String>)]) -> String {
    if collisions.is_empty() {
        return "nobody has run into anything".to_owned();
    }
    let line = |(one, other): &(String, Option<String>)| {
        format!("{one} has run into {}", other.as_deref().unwrap_or("a wall"))
    };
    collisions.iter().map(line).collect::<Vec<_>>().join("; ")
}

fn seen(
    stage: &Fixture,
    said: &StepArguments,
    of: fn(&SensorReading) -> Option<Vec<DetectedObject>>,
) -> Result<Vec<String>, StepFailure> {
    let robot = stage.robot(said.value(0))?;
    let readings = stage.with_world(|world| world.read_sensors(&robot)).unwrap_or_default();
    let all: Vec<Vec<DetectedObject>> = readings.iter().filter_map(of).collect();
    if all.is_empty() {
        return Err(StepFailure::Invalid(format!("{robot} has no such sensor")));
    }
    let name = |seen: DetectedObject| match seen {
        DetectedObject::Robot(robot) => robot.to_string(),
        DetectedObject::Person(person) => person.as_str().to_owned(),
    };
    Ok(all.into_iter().flatten().map(name).collect())
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "nobody".to_owned() } else { names.join(", ") }
}

fn sample(stage: &Fixture, id: &str) -> Result<SampleReport, StepFailure> {
    let found = stage.with_world(|world| world.sample(&id.into()));
    found.ok_or_else(|| {
        let known = stage.with_world(|world| world.samples());
        let known: Vec<String> = known.iter().map(|sample| sample.id.as_str().to_owned()).collect();
        StepFailure::Invalid(format!("there is no {id:?}; there are: {}", list(&known)))
    })
}

fn keeper(stage: &Fixture, id: &str, wanted: &SampleHolder) -> StepResult {
    let keeper = sample(stage, id)?.keeper;
    expect_that(keeper == *wanted, || format!("it is {}", with(&keeper)))
}

fn with(keeper: &SampleHolder) -> String {
    match keeper {
        SampleHolder::Table(place) => format!("on the table at {place}"),
        SampleHolder::Drawer(robot) => format!("in the drawer of {robot}"),
        SampleHolder::Arm(robot) => format!("in the arm of {robot}"),
        SampleHolder::Person(person) => format!("with {}", person.as_str()),
    }
}

fn is_open(stage: &Fixture, said: &StepArguments) -> Result<bool, StepFailure> {
    let wanted = said.value(0);
    if stage.with_world(|world| world.map().door(wanted).is_none()) {
        return Err(StepFailure::Invalid(format!("there is no door {wanted:?} on this map")));
    }
    let latest = stage.journal().filter_map(|entry| match &entry.event {
        WorldEvent::DoorMoved { door, open } if door == wanted => Some(*open),
        _ => None,
    });
    Ok(latest.last() == Some(true))
}

/// How a robot stands to a door or a lift.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Passage {
    Waits,
    Within,
    Left,
}

/// Who came to a door or lift, got in and out, in order.
fn passages(stage: &Fixture, what: &str) -> Result<Vec<(RobotId, Passage)>, StepFailure> {
    if stage.with_world(|world| world.map().door(what).is_none() && world.map().lift(what).is_none()) {
        return Err(StepFailure::Invalid(format!("there is no door or lift {what:?} on this map")));
    }
    let of = |entry: &WorldEvent| {
        let (robot, name, passage) = match entry {
            WorldEvent::DoorRequested { robot, door } => (robot, door, Passage::Waits),
            WorldEvent::DoorEntered { robot, door } => (robot, door, Passage::Within),
            WorldEvent::DoorLeft { robot, door } => (robot, door, Passage::Left),
            WorldEvent::LiftRequested { robot, lift, .. } => (robot, lift, Passage::Waits),
            WorldEvent::LiftEntered { robot, lift } => (robot, lift, Passage::Within),
            WorldEvent::LiftLeft { robot, lift, .. } => (robot, lift, Passage::Left),
            _ => return None,
        };
        (name == what).then(|| (robot.clone(), passage))
    };
    Ok(stage.journal().filter_map(|entry| of(&entry.event)).collect())
}

fn passage(stage: &Fixture, robot: &RobotId, what: &str) -> Result<Option<Passage>, StepFailure> {
    let all = passages(stage, what)?;
    Ok(all.into_iter().filter(|(who, _)| who == robot).map(|(_, passage)| passage).next_back())
}
