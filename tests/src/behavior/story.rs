//! What happened, in words, for whoever asks why a step failed.

use crate::Entry;
use consort_protocol::event::Happening;
use consort_sim::world::{Happening as InWorld, Keeper};
use consort_skills::actions::GoalStatus;

/// What a node told, or the scenario did to it; nothing of what is told too often to be read.
pub(super) fn of_nodes(entry: &Entry) -> Option<String> {
    let told = match entry {
        Entry::Done { what, .. } => format!("*** {what}"),
        Entry::Told(event) => of(&event.what)?,
        Entry::Acknowledged { .. } | Entry::Believes { .. } | Entry::Applied { .. } => return None,
    };
    Some(format!("{:<12} {told}", entry.node().as_str()))
}

fn of(what: &Happening) -> Option<String> {
    Some(match what {
        Happening::Elected { .. } => "coordinates".to_owned(),
        Happening::SteppedDown { .. } => "no longer coordinates".to_owned(),
        Happening::Submitted { mission, .. } => format!("{mission} is acknowledged"),
        Happening::Closed { mission, record } => {
            let why = record.failure.as_ref().map(|why| format!(": {why}")).unwrap_or_default();
            format!("the auction for {mission} is closed{why}")
        }
        Happening::Awarded { mission, holders, .. } => {
            let given: Vec<String> = holders.iter().map(|(role, robot)| format!("{role} to {robot}")).collect();
            format!("{mission}: gives {}", given.join(", "))
        }
        Happening::Released { mission, role, cause } => format!("{mission}: takes {role} back: {cause}"),
        Happening::Mission { mission, state, .. } => format!("{mission} is {}", state.word()),
        Happening::TaskBegan { role, task, .. } => format!("{role} begins {task}"),
        Happening::TaskEnded { role, task, .. } => format!("{role} has ended {task}"),
        Happening::TaskFailed { role, task, cause, .. } => format!("{role} failed at {task}: {cause}"),
        Happening::TaskRetried { role, task, cause, .. } => format!("{role} tries {task} again: {cause}"),
        Happening::Alternative { role, task, .. } => format!("{role} does otherwise what {task} was for"),
        Happening::GaveUp { role, cause, .. } => format!("gives {role} up: {cause}"),
        Happening::Suspended { role, .. } => format!("{role} stands still: nobody renews its lease"),
        Happening::Resumed { role, .. } => format!("{role} goes on"),
        Happening::Halted { role, reason, .. } => format!("puts {role} down: {reason:?}"),
        Happening::ChargeShort { role, cause, .. } => format!("{role} goes on although {cause}"),
        Happening::Foreign { .. }
        | Happening::Voters { .. }
        | Happening::Joined { .. }
        | Happening::Left { .. }
        | Happening::Called { .. }
        | Happening::Bid { .. }
        | Happening::Progress { .. }
        | Happening::Started { .. }
        | Happening::Sent { .. }
        | Happening::Heard { .. }
        | Happening::Outdated { .. } => return None,
    })
}

/// What happened in the world.
pub(super) fn in_world(what: &InWorld) -> Option<String> {
    let line = |who: &str, what: String| Some(format!("{who:<12} ({what})"));
    match what {
        InWorld::GoalEnded { robot, status: GoalStatus::Aborted(why), .. } => {
            line(robot.as_str(), format!("could not: {}", why.message))
        }
        InWorld::GoalBegan { .. } | InWorld::GoalEnded { .. } | InWorld::Drawer { .. } | InWorld::HandsOut { .. } => {
            None
        }
        InWorld::Approached { robot, person, authenticated } => {
            let how = if *authenticated { "knows who she is" } else { "has approached" };
            line(robot.as_str(), format!("{how}: {}", person.as_str()))
        }
        InWorld::CalledOff { person, robot } => line(person.as_str(), format!("calls the mission of {robot} off")),
        InWorld::Declined { person, robot } => line(person.as_str(), format!("declines what {robot} waits for")),
        InWorld::WalkedAway { person } => line(person.as_str(), "walks away".to_owned()),
        InWorld::CameBack { person } => line(person.as_str(), "comes back".to_owned()),
        InWorld::SampleMoved { sample, to, .. } => {
            let (who, how) = match to {
                Keeper::Table(place) => (place.as_str(), "lies here"),
                Keeper::Drawer(robot) => (robot.as_str(), "is in its drawer"),
                Keeper::Arm(robot) => (robot.as_str(), "is in its arm"),
                Keeper::Person(person) => (person.as_str(), "is with her"),
            };
            line(who, format!("{} {how}", sample.as_str()))
        }
        InWorld::DoorAwaited { robot, door } => line(robot.as_str(), format!("waits at door {door}")),
        InWorld::DoorEntered { robot, door } => line(robot.as_str(), format!("goes through door {door}")),
        InWorld::DoorLeft { robot, door } => line(robot.as_str(), format!("has left door {door}")),
        InWorld::Door { door, open } => {
            line(door, if *open { "stands open".to_owned() } else { "is closed".to_owned() })
        }
        InWorld::LiftAwaited { robot, lift, to, .. } => line(robot.as_str(), format!("waits at lift {lift} for {to}")),
        InWorld::LiftEntered { robot, lift } => line(robot.as_str(), format!("is in lift {lift}")),
        InWorld::LiftLeft { robot, lift, at } => line(robot.as_str(), format!("is out of lift {lift}, at {at}")),
        InWorld::WayClosed { obstacle, .. } => line("building", format!("{obstacle} is there")),
        InWorld::WayOpened { obstacle, .. } => line("building", format!("{obstacle} is gone")),
        InWorld::Docked { robot, docked } => {
            line(robot.as_str(), if *docked { "is docked".to_owned() } else { "is not docked any more".to_owned() })
        }
        InWorld::Collided { robot, with } => {
            let with = with.as_ref().map_or("a wall", |other| other.as_str());
            line(robot.as_str(), format!("ran into {with}"))
        }
        InWorld::Stranded { robot } => line(robot.as_str(), "its battery is too low to move".to_owned()),
    }
}
