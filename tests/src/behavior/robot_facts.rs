//! Facts about robots, people, items and the building.

use super::fixture::Fixture;
use super::scenario_setup::coordinates;
use super::step_arguments::{StepArguments, name};
use super::step_pattern::{FactFn, StepFailure, StepPattern, StepResult, expect_that};
use consort_protocol::ids::RobotId;
use consort_skills::actions::{GoalStatus, RobotBackend, Telemetry};
use consort_world::world::{DetectedObject, RobotReport, SampleHolder, SampleReport, SensorReading, WorldEvent};

/// Returns the patterns of these facts.
pub(super) fn patterns() -> Vec<StepPattern<FactFn>> {
    let fact = |pattern, example, fact: FactFn| StepPattern::new(pattern, example, fact);
    vec![
        fact("{name} is at {text}", r#"amber is at "Laboratory""#, |fixture, arguments| {
            let here = telemetry(fixture, arguments)?;
            if let Ok((x, y)) = coordinates(arguments.value(1)) {
                let off = (here.pose.x - x).hypot(here.pose.y - y);
                return expect_that(off < 0.1, || position(&here));
            }
            let there = fixture.with_world(|world| {
                let place = name::<consort_protocol::ids::PlaceId>(arguments.value(1)).ok()?;
                world.map().place(&place).map(|place| place.pose)
            });
            let Some(there) = there else {
                return Err(StepFailure::Invalid(format!("there is no place {:?} on this map", arguments.value(1))));
            };
            let near = here.pose.distance(there).get() < 0.1;
            expect_that(near && here.place.as_str() == arguments.value(1), || position(&here))
        }),
        fact("{name} looks {number} degrees", "amber looks 90 degrees", |fixture, arguments| {
            let here = telemetry(fixture, arguments)?;
            let off = (here.pose.yaw.to_degrees() - arguments.number(1)).rem_euclid(360.0);
            expect_that(off.min(360.0 - off) < 2.0, || format!("it looks {:.1} degrees", here.pose.yaw.to_degrees()))
        }),
        fact(
            "{name} has less than {percent} of its charge",
            "amber has less than 20 % of its charge",
            |fixture, arguments| {
                let charge = telemetry(fixture, arguments)?.battery.get();
                expect_that(charge < arguments.share(1), || format!("it has {:.1} %", charge * 100.0))
            },
        ),
        fact(
            "{name} has more than {percent} of its charge",
            "amber has more than 20 % of its charge",
            |fixture, arguments| {
                let charge = telemetry(fixture, arguments)?.battery.get();
                expect_that(charge > arguments.share(1), || format!("it has {:.1} %", charge * 100.0))
            },
        ),
        fact("{name} cannot move", "amber cannot move", |fixture, arguments| {
            let here = telemetry(fixture, arguments)?;
            expect_that(!here.able, || format!("it can, with {:.1} % of its charge", here.battery.get() * 100.0))
        }),
        fact("the goal of {name} has succeeded", "the goal of amber has succeeded", |fixture, arguments| {
            let status = status(fixture, arguments)?;
            expect_that(status == GoalStatus::Succeeded, || status_text(&status))
        }),
        fact(
            "the goal of {name} took {time} to {time}",
            "the goal of amber took 20 s to 25 s",
            |fixture, arguments| {
                let (status, robot) = (status(fixture, arguments)?, fixture.robot(arguments.value(0))?);
                expect_that(status == GoalStatus::Succeeded, || status_text(&status))?;
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
            },
        ),
        fact(
            "the goal of {name} was aborted because {text}",
            r#"the goal of amber was aborted because "no lane""#,
            |fixture, arguments| {
                let status = status(fixture, arguments)?;
                let because = matches!(&status, GoalStatus::Aborted(why) if why.message.contains(arguments.value(1)));
                expect_that(because, || status_text(&status))
            },
        ),
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
        ),
        fact("the goal of {name} was canceled", "the goal of amber was canceled", |fixture, arguments| {
            let status = status(fixture, arguments)?;
            expect_that(status == GoalStatus::Canceled, || status_text(&status))
        }),
        fact("{name} is docked", "amber is docked", |fixture, arguments| {
            let robot = fixture.robot(arguments.value(0))?;
            let latest = fixture.journal().filter_map(|entry| match &entry.event {
                WorldEvent::Docked { robot: whose, docked } if *whose == robot => Some(*docked),
                _ => None,
            });
            expect_that(latest.last() == Some(true), || "it is not".to_owned())
        }),
        fact("the drawer of {name} is open", "the drawer of amber is open", |fixture, arguments| {
            expect_that(body(fixture, arguments)?.drawer_open, || "it is closed".to_owned())
        }),
        fact("the drawer of {name} is closed", "the drawer of amber is closed", |fixture, arguments| {
            expect_that(!body(fixture, arguments)?.drawer_open, || "it is open".to_owned())
        }),
        fact("{name} has run into {name}", "amber has run into birch", |fixture, arguments| {
            let collisions = collisions(fixture);
            let pair = [arguments.value(0), arguments.value(1)];
            let ran = collisions.iter().any(|(first, second)| {
                let second = second.as_deref().unwrap_or("a wall");
                (pair == [first, second]) || (pair == [second, first])
            });
            expect_that(ran, || collisions_text(&collisions))
        }),
        fact("{name} has run into a wall", "amber has run into a wall", |fixture, arguments| {
            let collisions = collisions(fixture);
            expect_that(
                collisions.iter().any(|(first, second)| first == arguments.value(0) && second.is_none()),
                || collisions_text(&collisions),
            )
        }),
        fact("no robot has run into anything", "no robot has run into anything", |fixture, _| {
            let collisions = collisions(fixture);
            expect_that(collisions.is_empty(), || collisions_text(&collisions))
        }),
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
        }),
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
        }),
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
        }),
        fact("{name} holds {text}", r#"lab-arm holds "sample of IC Room 6""#, |fixture, arguments| {
            let robot = fixture.robot(arguments.value(0))?;
            check_holder(fixture, arguments.value(1), &SampleHolder::Arm(robot))
        }),
        fact(
            "{text} is in the drawer of {name}",
            r#""sample of IC Room 6" is in the drawer of amber"#,
            |fixture, arguments| {
                let robot = fixture.robot(arguments.value(1))?;
                check_holder(fixture, arguments.value(0), &SampleHolder::Drawer(robot))
            },
        ),
        fact("{text} lies at {text}", r#""tray" lies at "Laboratory""#, |fixture, arguments| {
            check_holder(fixture, arguments.value(0), &SampleHolder::Table(name(arguments.value(1))?))
        }),
        fact(
            "{text} is still with {text}",
            r#""sample of IC Room 6" is still with "nurse of IC Room 6""#,
            |fixture, arguments| {
                check_holder(fixture, arguments.value(0), &SampleHolder::Person(arguments.value(1).into()))
            },
        ),
        fact(
            "the sample of {text} was delivered to {name}",
            r#"the sample of "IC Room 6" was delivered to lab-arm"#,
            |fixture, arguments| {
                let (robot, id) = (fixture.robot(arguments.value(1))?, format!("sample of {}", arguments.value(0)));
                let report = sample(fixture, &id)?;
                let mut keepers: Vec<&SampleHolder> = report.history.iter().map(|(_, holder)| holder).collect();
                keepers.push(&report.holder);
                // An arm lays down what it holds when the next sample arrives.
                keepers.pop_if(|last| matches!(last, SampleHolder::Table(_)));
                let delivered = matches!(keepers[..], [SampleHolder::Person(_), SampleHolder::Drawer(_), SampleHolder::Arm(arm)] if *arm == robot);
                expect_that(delivered, || {
                    let hands: Vec<String> = keepers.into_iter().map(holder_text).collect();
                    format!("it was {}", hands.join(", then "))
                })
            },
        ),
        fact("the nurse in {text} is away", r#"the nurse in "IC Room 6" is away"#, |fixture, arguments| {
            let people = fixture.with_world(|world| world.people());
            let person = people.iter().find(|person| person.place.as_str() == arguments.value(0));
            let person = person
                .ok_or_else(|| StepFailure::Invalid(format!("there is no person for {:?}", arguments.value(0))))?;
            expect_that(person.away, || "she is there".to_owned())
        }),
        fact("door {text} is open", r#"door "Gate" is open"#, |fixture, arguments| {
            expect_that(is_open(fixture, arguments)?, || "it is closed".to_owned())
        }),
        fact("door {text} is closed", r#"door "Gate" is closed"#, |fixture, arguments| {
            expect_that(!is_open(fixture, arguments)?, || "it is open".to_owned())
        }),
        fact("{name} waits at {text}", r#"amber waits at "Gate""#, |fixture, arguments| {
            let robot = fixture.robot(arguments.value(0))?;
            expect_that(passage(fixture, &robot, arguments.value(1))? == Some(Passage::Waits), || {
                "it does not wait there".to_owned()
            })
        }),
        fact("{name} has passed {text}", r#"amber has passed "Gate""#, |fixture, arguments| {
            let robot = fixture.robot(arguments.value(0))?;
            let now = passage(fixture, &robot, arguments.value(1))?;
            expect_that(now == Some(Passage::Left), || match now {
                None => "it has not come there".to_owned(),
                Some(Passage::Waits) => "it waits there".to_owned(),
                Some(_) => "it is within".to_owned(),
            })
        }),
        fact("{name} is within {text}", r#"amber is within "Lift""#, |fixture, arguments| {
            let robot = fixture.robot(arguments.value(0))?;
            expect_that(passage(fixture, &robot, arguments.value(1))? == Some(Passage::Within), || {
                "it is not".to_owned()
            })
        }),
        fact(
            "at most {number} robot(s) was/were ever within {text}",
            r#"at most 1 robot was ever within "Lift""#,
            |fixture, arguments| {
                let (mut within, mut most) = (0_i64, 0);
                for (_, passage) in passages(fixture, arguments.value(1))? {
                    within += match passage {
                        Passage::Within => 1,
                        Passage::Left => -1,
                        Passage::Waits => 0,
                    };
                    within = within.max(0);
                    most = most.max(within);
                }
                expect_that(most as f64 <= arguments.number(0), || format!("{most} were at once"))
            },
        ),
        fact("{name} passed {text} before {name}", r#"amber passed "Gate" before birch"#, |fixture, arguments| {
            let (first, second) = (fixture.robot(arguments.value(0))?, fixture.robot(arguments.value(2))?);
            let mut order = vec![];
            for (robot, passage) in passages(fixture, arguments.value(1))? {
                if passage == Passage::Within && !order.contains(&robot) {
                    order.push(robot);
                }
            }
            let place = |robot| order.iter().position(|passed| passed == robot);
            let before = place(&first).is_some_and(|first| place(&second).is_none_or(|second| first < second));
            expect_that(before, || {
                let order: Vec<&str> = order.iter().map(RobotId::as_str).collect();
                format!(
                    "there passed, in this order: {}",
                    if order.is_empty() { "no robot".to_owned() } else { order.join(", ") }
                )
            })
        }),
    ]
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
fn status(fixture: &Fixture, arguments: &StepArguments) -> Result<GoalStatus, StepFailure> {
    let robot = fixture.robot(arguments.value(0))?;
    let Some((goal, _)) = fixture.goals.get(&robot) else {
        return Err(StepFailure::Invalid(format!("this scenario sent no goal to {robot}")));
    };
    Ok(fixture.running().world.status(&robot, *goal).expect("a goal that was given"))
}

fn status_text(status: &GoalStatus) -> String {
    match status {
        GoalStatus::Sent => "it has not begun".to_owned(),
        GoalStatus::Executing(feedback) => format!("it is at it; {:.1} m are left", feedback.distance_remaining.get()),
        GoalStatus::Succeeded => "it has done it".to_owned(),
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

fn names_text(names: &[String]) -> String {
    if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
}

fn sample(fixture: &Fixture, id: &str) -> Result<SampleReport, StepFailure> {
    let found = fixture.with_world(|world| world.sample(&id.into()));
    found.ok_or_else(|| {
        let known = fixture.with_world(|world| world.samples());
        let known: Vec<String> = known.iter().map(|sample| sample.id.as_str().to_owned()).collect();
        StepFailure::Invalid(format!("there is no {id:?}; there are: {}", names_text(&known)))
    })
}

fn check_holder(fixture: &Fixture, id: &str, wanted: &SampleHolder) -> StepResult {
    let holder = sample(fixture, id)?.holder;
    expect_that(holder == *wanted, || format!("it is {}", holder_text(&holder)))
}

fn holder_text(holder: &SampleHolder) -> String {
    match holder {
        SampleHolder::Table(place) => format!("on the table at {place}"),
        SampleHolder::Drawer(robot) => format!("in the drawer of {robot}"),
        SampleHolder::Arm(robot) => format!("in the arm of {robot}"),
        SampleHolder::Person(person) => format!("with {}", person.as_str()),
    }
}

fn is_open(fixture: &Fixture, arguments: &StepArguments) -> Result<bool, StepFailure> {
    let wanted = arguments.value(0);
    if fixture.with_world(|world| world.map().door(wanted).is_none()) {
        return Err(StepFailure::Invalid(format!("there is no door {wanted:?} on this map")));
    }
    let latest = fixture.journal().filter_map(|entry| match &entry.event {
        WorldEvent::DoorMoved { door, open } if door == wanted => Some(*open),
        _ => None,
    });
    Ok(latest.last() == Some(true))
}

/// State of a robot at a door or a lift.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Passage {
    Waits,
    Within,
    Left,
}

/// Returns the passages of all robots through a door or a lift, in order.
fn passages(fixture: &Fixture, what: &str) -> Result<Vec<(RobotId, Passage)>, StepFailure> {
    if fixture.with_world(|world| world.map().door(what).is_none() && world.map().lift(what).is_none()) {
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
    Ok(fixture.journal().filter_map(|entry| of(&entry.event)).collect())
}

fn passage(fixture: &Fixture, robot: &RobotId, what: &str) -> Result<Option<Passage>, StepFailure> {
    let all = passages(fixture, what)?;
    Ok(all.into_iter().filter(|(who, _)| who == robot).map(|(_, passage)| passage).next_back())
}
