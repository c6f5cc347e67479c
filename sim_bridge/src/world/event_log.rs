//! What happened, for displays and reports. Nobody has to read it: it is bounded, and the oldest entries go first.

use super::World;
use super::names::{PersonName, SampleId};
use super::samples::SampleHolder;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::units::WorldTime;
use consort_skills::actions::{Goal, GoalId, GoalStatus};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Something that happened, and when.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LoggedEvent {
    /// When.
    pub time: WorldTime,
    /// What.
    pub event: WorldEvent,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorldEvent {
    /// A robot began a goal.
    GoalStarted {
        /// Which robot.
        robot: RobotId,
        /// Its number.
        id: GoalId,
        /// What is to be done.
        goal: Goal,
    },
    /// A goal ended, or was refused.
    GoalEnded {
        /// Whose.
        robot: RobotId,
        /// Its number.
        id: GoalId,
        /// How.
        status: GoalStatus,
    },
    /// A robot's drawer was opened or closed.
    DrawerMoved {
        /// Whose.
        robot: RobotId,
        /// Whether it stands open now.
        open: bool,
    },
    /// A robot has approached a person, or that person has proved who they are.
    Approached {
        /// Which robot.
        robot: RobotId,
        /// Whom.
        person: PersonName,
        /// Whether they have proved who they are.
        authenticated: bool,
    },
    /// A person has called off the mission for which a robot came.
    MissionCanceled {
        /// Who.
        person: PersonName,
        /// Which robot came.
        robot: RobotId,
    },
    /// A person does not do what a robot waits for.
    HandoverDeclined {
        /// Who.
        person: PersonName,
        /// Which robot waits.
        robot: RobotId,
    },
    /// A person has left their place.
    PersonLeft {
        /// Who.
        person: PersonName,
    },
    /// A person is back at their place.
    PersonReturned {
        /// Who.
        person: PersonName,
    },
    /// A person began to hand a sample over.
    HandoverStarted {
        /// Who.
        person: PersonName,
        /// To which robot.
        robot: RobotId,
    },
    /// A sample changed hands.
    SampleMoved {
        /// Which.
        sample: SampleId,
        /// Who had it.
        from: SampleHolder,
        /// Who has it.
        to: SampleHolder,
    },
    /// A robot stands before an automatic door that it wants to pass.
    DoorRequested {
        /// Which robot.
        robot: RobotId,
        /// Which door.
        door: String,
    },
    /// A robot may pass an open door, and is on its way through it.
    DoorEntered {
        /// Which robot.
        robot: RobotId,
        /// Which door.
        door: String,
    },
    /// A robot has passed a door, or no longer waits for it.
    DoorLeft {
        /// Which robot.
        robot: RobotId,
        /// Which door.
        door: String,
    },
    /// An automatic door stands open, or closed.
    DoorMoved {
        /// Which door.
        door: String,
        /// Whether it stands open now.
        open: bool,
    },
    /// A robot stands at a stop of a lift that it wants to ride.
    LiftRequested {
        /// Which robot.
        robot: RobotId,
        /// Which lift.
        lift: String,
        /// Where it stands.
        at: PlaceId,
        /// Where it wants to go.
        to: PlaceId,
    },
    /// A robot has got into a lift.
    LiftEntered {
        /// Which robot.
        robot: RobotId,
        /// Which lift.
        lift: String,
    },
    /// A robot has got out of a lift, or no longer waits for it.
    LiftLeft {
        /// Which robot.
        robot: RobotId,
        /// Which lift.
        lift: String,
        /// Where it stands now.
        at: PlaceId,
    },
    /// Something stands in a way from now on.
    LaneBlocked {
        /// What it is called.
        obstacle: String,
        /// The way, by its two ends.
        between: (PlaceId, PlaceId),
    },
    /// It was taken away.
    LaneCleared {
        /// What it is called.
        obstacle: String,
        /// The way, by its two ends.
        between: (PlaceId, PlaceId),
    },
    /// A robot has connected to the charger at its place, or disconnected.
    Docked {
        /// Which robot.
        robot: RobotId,
        /// Whether it is connected now.
        docked: bool,
    },
    /// A robot that is steered ran into something, and stands.
    Collided {
        /// Which robot.
        robot: RobotId,
        /// The other robot; none for a wall.
        with: Option<RobotId>,
    },
    /// A robot's battery fell to the stopping share.
    Stranded {
        /// Which robot.
        robot: RobotId,
    },
}

/// See the [module](self).
#[derive(Default)]
pub(super) struct EventLog {
    entries: VecDeque<LoggedEvent>,
    /// How many were ever written.
    written: u64,
}

impl EventLog {
    pub(super) fn write(&mut self, now: f64, what: WorldEvent, kept: usize) {
        self.entries.push_back(LoggedEvent { time: WorldTime::from_secs(now), event: what });
        self.written += 1;
        if self.entries.len() > kept {
            self.entries.pop_front();
        }
    }
}

impl World {
    /// What happened since this was last asked for, oldest first.
    pub fn drain_event_log(&mut self) -> Vec<LoggedEvent> {
        std::mem::take(&mut self.state.event_log.entries).into()
    }

    /// What happened after the first `number` happenings of this world, as far as it is still in the journal, oldest first;
    /// and how many there have been by now. It stays in the journal.
    pub(crate) fn events_after(&self, number: u64) -> (impl Iterator<Item = &LoggedEvent>, u64) {
        let EventLog { entries, written } = &self.state.event_log;
        let new = usize::try_from(written.saturating_sub(number)).unwrap_or(usize::MAX);
        (entries.iter().skip(entries.len().saturating_sub(new)), *written)
    }
}
