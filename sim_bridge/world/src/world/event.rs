//! Events of the world, and their log for displays and reports. The log is bounded and drops the
//! oldest entries, so reading it is optional.

use super::names::{PersonName, SampleId};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::units::WorldTime;
use consort_skills::actions::{Goal, GoalId, GoalStatus};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// A world event with its time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LoggedEvent {
    /// Time of the event.
    pub time: WorldTime,
    /// The event.
    pub event: WorldEvent,
}

/// An event in the world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorldEvent {
    /// A robot started a goal.
    GoalStarted {
        /// Robot with the goal.
        robot: RobotId,
        /// Id of the goal.
        id: GoalId,
        /// The goal.
        goal: Goal,
    },
    /// A goal ended, or was rejected.
    GoalEnded {
        /// Robot with the goal.
        robot: RobotId,
        /// Id of the goal.
        id: GoalId,
        /// Final status.
        status: GoalStatus,
    },
    /// A robot's drawer was opened or closed.
    DrawerMoved {
        /// Robot with the drawer.
        robot: RobotId,
        /// True if the drawer is open now.
        open: bool,
    },
    /// A robot has approached a person, or the person has authenticated.
    Approached {
        /// Robot that approached.
        robot: RobotId,
        /// Person approached.
        person: PersonName,
        /// True if the person has authenticated.
        authenticated: bool,
    },
    /// A person canceled the mission for which a robot came.
    MissionCanceled {
        /// Person.
        person: PersonName,
        /// Robot that came.
        robot: RobotId,
    },
    /// A person declined the handover that a robot waits for.
    HandoverDeclined {
        /// Person.
        person: PersonName,
        /// Robot that waits.
        robot: RobotId,
    },
    /// A person left their place.
    PersonLeft {
        /// Person.
        person: PersonName,
    },
    /// A person returned to their place.
    PersonReturned {
        /// Person.
        person: PersonName,
    },
    /// A person started to hand over a sample.
    HandoverStarted {
        /// Person.
        person: PersonName,
        /// Receiving robot.
        robot: RobotId,
    },
    /// A sample changed hands.
    SampleMoved {
        /// Sample.
        sample: SampleId,
        /// Previous holder.
        from: SampleHolder,
        /// New holder.
        to: SampleHolder,
    },
    /// A robot waits before an automatic door.
    DoorRequested {
        /// Robot.
        robot: RobotId,
        /// Door.
        door: String,
    },
    /// A door admitted a robot, which is now passing through it.
    DoorEntered {
        /// Robot.
        robot: RobotId,
        /// Door.
        door: String,
    },
    /// A robot has passed a door, or no longer waits for it.
    DoorLeft {
        /// Robot.
        robot: RobotId,
        /// Door.
        door: String,
    },
    /// An automatic door finished opening or closing.
    DoorMoved {
        /// Door.
        door: String,
        /// True if the door is open now.
        open: bool,
    },
    /// A robot waits at a stop of a lift.
    LiftRequested {
        /// Robot.
        robot: RobotId,
        /// Lift.
        lift: String,
        /// Stop at which the robot waits.
        at: PlaceId,
        /// Destination.
        to: PlaceId,
    },
    /// A robot entered a lift.
    LiftEntered {
        /// Robot.
        robot: RobotId,
        /// Lift.
        lift: String,
    },
    /// A robot left a lift, or no longer waits for it.
    LiftLeft {
        /// Robot.
        robot: RobotId,
        /// Lift.
        lift: String,
        /// Current place of the robot.
        at: PlaceId,
    },
    /// An obstacle blocks a lane from now on.
    LaneBlocked {
        /// Name of the obstacle.
        obstacle: String,
        /// The lane, by its two ends.
        between: (PlaceId, PlaceId),
    },
    /// An obstacle was removed.
    LaneCleared {
        /// Name of the obstacle.
        obstacle: String,
        /// The lane, by its two ends.
        between: (PlaceId, PlaceId),
    },
    /// A robot connected to the charger at its place, or disconnected.
    Docked {
        /// Robot.
        robot: RobotId,
        /// True if the robot is connected now.
        docked: bool,
    },
    /// A steered robot collided, and stopped.
    Collided {
        /// Robot.
        robot: RobotId,
        /// The other robot; `None` for a wall.
        with: Option<RobotId>,
    },
    /// A robot's battery fell to the stopping share.
    Stranded {
        /// Robot.
        robot: RobotId,
    },
    /// A goal created a sample.
    SampleCreated {
        /// Sample.
        sample: SampleId,
        /// Holder.
        holder: SampleHolder,
    },
    /// A goal consumed a sample.
    SampleConsumed {
        /// Sample.
        sample: SampleId,
        /// Previous holder.
        from: SampleHolder,
    },
}

/// Holder of a sample.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SampleHolder {
    /// The table of a place.
    Table(PlaceId),
    /// A robot's drawer.
    Drawer(RobotId),
    /// A robot's arm.
    Arm(RobotId),
    /// A person.
    Person(PersonName),
}

/// The log of events.
#[derive(Default)]
pub(super) struct EventLog {
    entries: VecDeque<LoggedEvent>,
    /// Number of entries ever written.
    written: u64,
}

impl EventLog {
    pub(super) fn write(&mut self, now: f64, event: WorldEvent, kept: usize) {
        self.entries.push_back(LoggedEvent { time: WorldTime::from_secs(now), event });
        self.written += 1;
        if self.entries.len() > kept {
            self.entries.pop_front();
        }
    }

    /// Returns and removes the entries, oldest first.
    pub(super) fn drain(&mut self) -> Vec<LoggedEvent> {
        std::mem::take(&mut self.entries).into()
    }

    /// Returns the entries after the first `number` events ever written that are still in the log,
    /// oldest first, and the number of events so far.
    pub(super) fn after(&self, number: u64) -> (impl Iterator<Item = &LoggedEvent>, u64) {
        let new = usize::try_from(self.written.saturating_sub(number)).unwrap_or(usize::MAX);
        (self.entries.iter().skip(self.entries.len().saturating_sub(new)), self.written)
    }
}
