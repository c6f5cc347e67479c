//! Text of events for the report of a failed step.

use crate::Observation;
use consort_protocol::event::EventKind;
use consort_skills::actions::GoalStatus;
use consort_world::world::{SampleHolder, WorldEvent as InWorld};

/// Describes an event of a node or an action of the scenario; `None` for events that are too
/// frequent for a report.
pub(super) fn node_observation(entry: &Observation) -> Option<String> {
    let text = match entry {
        Observation::TestAction { action: what, .. } => format!("*** {what}"),
        Observation::Published(event) => of(&event.kind)?,
        Observation::RequestAcknowledged { .. }
        | Observation::OrderAcknowledged { .. }
        | Observation::CertificateRevoked { .. }
        | Observation::LeadershipChanged { .. }
        | Observation::EntryApplied { .. } => return None,
    };
    Some(format!("{:<12} {text}", entry.node().as_str()))
}

fn of(what: &EventKind) -> Option<String> {
    Some(match what {
        EventKind::Elected { .. } => "coordinates".to_owned(),
        EventKind::SteppedDown { .. } => "no longer coordinates".to_owned(),
        EventKind::Submitted { mission, .. } => format!("{mission} is acknowledged"),
        EventKind::ScheduleChanged { schedule, change, by } => {
            format!("schedule {schedule} is {} by {by}", change.as_str())
        }
        EventKind::PriorityChanged { mission, priority } => format!("{mission} has priority {}", priority.get()),
        EventKind::RoleOrdered { mission, role, order } => {
            format!("{role} of {mission} is {}", order.as_deref().unwrap_or("without an order"))
        }
        EventKind::RobotOrders { robot, orders } => format!("{robot} is {}", orders.state_text()),
        EventKind::AlarmChanged { raised: Some(raised), .. } => format!("the fleet is {}", raised.text()),
        EventKind::AlarmChanged { alarm, raised: None } => format!("alarm {alarm} is cleared"),
        EventKind::ClosureChanged { part, order } => part.state_text(order.as_ref()),
        EventKind::ChargerLeased { charger, robot } => format!("leases {charger} to {robot}"),
        EventKind::ChargerFreed { charger, robot, cause } => format!("frees {charger} of {robot}: {cause}"),
        EventKind::DeviceLeased { device, robot } => format!("leases {device} to {robot}"),
        EventKind::DeviceFreed { device, robot, cause } => format!("frees {device} of {robot}: {cause}"),
        EventKind::OccurrenceSubmitted { schedule, mission, .. } => format!("{schedule} submits {mission}"),
        EventKind::Closed { mission, record } => {
            let why = record.failure.as_ref().map(|why| format!(": {why}")).unwrap_or_default();
            format!("the auction for {mission} is closed{why}")
        }
        EventKind::Awarded { mission, holders, promised, .. } => {
            let promised = promised.iter().map(|(role, robot)| format!("promises {role} to {robot}"));
            let given = holders.iter().map(|(role, robot)| format!("gives {role} to {robot}"));
            format!("{mission}: {}", given.chain(promised).collect::<Vec<_>>().join(", "))
        }
        EventKind::Released { mission, role, cause } => format!("{mission}: takes {role} back: {cause}"),
        EventKind::Mission { mission, state, .. } => format!("{mission} is {}", state.as_str()),
        EventKind::TaskBegan { role, task, .. } => format!("{role} begins {task}"),
        EventKind::TaskEnded { role, task, .. } => format!("{role} has ended {task}"),
        EventKind::TaskSkipped { role, task, .. } => format!("{role} skips {task}"),
        EventKind::Escalated { role, task, to, .. } => format!("{role} has not answered {task}: {to} is asked, too"),
        EventKind::QuestionAsked { role, task, message, .. } => format!("{role} is asked in {task}: {message}"),
        EventKind::QuestionAnswered { role, task, .. } => format!("the question to {role} in {task} is answered"),
        EventKind::QuestionClosed { role, task, cause, .. } => {
            format!("the question to {role} in {task} is closed: {cause}")
        }
        EventKind::TaskFailed { role, task, cause, .. } => format!("{role} failed at {task}: {cause}"),
        EventKind::TaskRetried { role, task, cause, .. } => format!("{role} tries {task} again: {cause}"),
        EventKind::Alternative { role, task, .. } => format!("{role} takes an alternative to {task}"),
        EventKind::GaveUp { role, cause, .. } => format!("gives {role} up: {cause}"),
        EventKind::Suspended { role, .. } => format!("{role} suspends: its lease was not renewed"),
        EventKind::Resumed { role, .. } => format!("{role} goes on"),
        EventKind::Halted { role, reason, .. } => format!("puts {role} down: {reason:?}"),
        EventKind::LowCharge { role, cause, .. } => format!("{role} goes on although {cause}"),
        EventKind::Foreign { .. }
        | EventKind::Voters { .. }
        | EventKind::Joined { .. }
        | EventKind::Left { .. }
        | EventKind::BidsRequested { .. }
        | EventKind::Bid { .. }
        | EventKind::Progress { .. }
        | EventKind::Started { .. }
        | EventKind::Sent { .. }
        | EventKind::Received { .. }
        | EventKind::StaleSignal { .. } => return None,
    })
}

/// Describes an event of the world.
pub(super) fn world_event(what: &InWorld) -> Option<String> {
    let line = |who: &str, what: String| Some(format!("{who:<12} ({what})"));
    match what {
        InWorld::GoalEnded { robot, status: GoalStatus::Aborted(why), .. } => {
            line(robot.as_str(), format!("could not: {}", why.message))
        }
        InWorld::GoalStarted { .. }
        | InWorld::GoalEnded { .. }
        | InWorld::DrawerMoved { .. }
        | InWorld::HandoverStarted { .. } => None,
        InWorld::Approached { robot, person, authenticated } => {
            let how = if *authenticated { "has authenticated" } else { "has approached" };
            line(robot.as_str(), format!("{how}: {}", person.as_str()))
        }
        InWorld::MissionCanceled { person, robot } => {
            line(person.as_str(), format!("calls the mission of {robot} off"))
        }
        InWorld::HandoverDeclined { person, robot } => {
            line(person.as_str(), format!("declines what {robot} waits for"))
        }
        InWorld::PersonLeft { person } => line(person.as_str(), "walks away".to_owned()),
        InWorld::PersonReturned { person } => line(person.as_str(), "comes back".to_owned()),
        InWorld::SampleConsumed { sample, .. } => line(sample.as_str(), "is used up".to_owned()),
        InWorld::SampleMoved { sample, to, .. } | InWorld::SampleCreated { sample, holder: to } => {
            let (who, how) = match to {
                SampleHolder::Table(place) => (place.as_str(), "lies here"),
                SampleHolder::Drawer(robot) => (robot.as_str(), "is in its drawer"),
                SampleHolder::Arm(robot) => (robot.as_str(), "is in its arm"),
                SampleHolder::Person(person) => (person.as_str(), "is with her"),
            };
            line(who, format!("{} {how}", sample.as_str()))
        }
        InWorld::DoorRequested { robot, door } => line(robot.as_str(), format!("waits at door {door}")),
        InWorld::DoorEntered { robot, door } => line(robot.as_str(), format!("goes through door {door}")),
        InWorld::DoorLeft { robot, door } => line(robot.as_str(), format!("has left door {door}")),
        InWorld::DoorMoved { door, open } => {
            line(door, if *open { "stands open".to_owned() } else { "is closed".to_owned() })
        }
        InWorld::LiftRequested { robot, lift, to, .. } => {
            line(robot.as_str(), format!("waits at lift {lift} for {to}"))
        }
        InWorld::LiftEntered { robot, lift } => line(robot.as_str(), format!("is in lift {lift}")),
        InWorld::LiftLeft { robot, lift, at } => line(robot.as_str(), format!("is out of lift {lift}, at {at}")),
        InWorld::LaneBlocked { obstacle, .. } => line("building", format!("{obstacle} is there")),
        InWorld::LaneCleared { obstacle, .. } => line("building", format!("{obstacle} is removed")),
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
