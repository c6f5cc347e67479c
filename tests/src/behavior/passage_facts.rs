//! Facts about doors and lifts, and the robots that pass them.

use super::fixture::Fixture;
use super::step_arguments::StepArguments;
use super::step_pattern::{FactStep, fact};
use super::step_result::{StepFailure, expect_that};
use consort_protocol::ids::RobotId;
use consort_world::world::WorldEvent;

/// Returns the steps of this file, in the order of their documentation.
pub(super) fn steps() -> Vec<FactStep> {
    vec![door_is_open(), door_is_closed(), waits_at(), has_passed(), is_within(), at_most_within(), passed_before()]
}

fn door_is_open() -> FactStep {
    fact("door {text} is open", r#"door "Gate" is open"#, |fixture, arguments| {
        expect_that(is_open(fixture, arguments)?, || "it is closed".to_owned())
    })
}

fn door_is_closed() -> FactStep {
    fact("door {text} is closed", r#"door "Gate" is closed"#, |fixture, arguments| {
        expect_that(!is_open(fixture, arguments)?, || "it is open".to_owned())
    })
}

fn waits_at() -> FactStep {
    fact("{name} waits at {text}", r#"amber waits at "Gate""#, |fixture, arguments| {
        let robot = fixture.robot(arguments.value(0))?;
        expect_that(passage(fixture, &robot, arguments.value(1))? == Some(Passage::Waits), || {
            "it does not wait there".to_owned()
        })
    })
}

fn has_passed() -> FactStep {
    fact("{name} has passed {text}", r#"amber has passed "Gate""#, |fixture, arguments| {
        let robot = fixture.robot(arguments.value(0))?;
        let now = passage(fixture, &robot, arguments.value(1))?;
        expect_that(now == Some(Passage::Left), || match now {
            None => "it has not come there".to_owned(),
            Some(Passage::Waits) => "it waits there".to_owned(),
            Some(_) => "it is within".to_owned(),
        })
    })
}

fn is_within() -> FactStep {
    fact("{name} is within {text}", r#"amber is within "Lift""#, |fixture, arguments| {
        let robot = fixture.robot(arguments.value(0))?;
        expect_that(passage(fixture, &robot, arguments.value(1))? == Some(Passage::Within), || "it is not".to_owned())
    })
}

fn at_most_within() -> FactStep {
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
    )
}

fn passed_before() -> FactStep {
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
    })
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
