//! What happened, for displays and reports. Nobody has to read it: it is bounded, and the oldest entries go first.

use super::World;
use super::names::{PersonName, SampleId};
use super::samples::Keeper;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::units::WorldTime;
use consort_skills::actions::{Goal, GoalId, GoalStatus};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Something that happened, and when.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JournalEntry {
    /// When.
    pub time: WorldTime,
    /// What.
    pub what: Happening,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Happening {
    /// A robot began a goal.
    GoalBegan {
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
    Drawer {
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
    CalledOff {
        /// Who.
        person: PersonName,
        /// Which robot came.
        robot: RobotId,
    },
    /// A person does not do what a robot waits for.
    Declined {
        /// Who.
        person: PersonName,
        /// Which robot waits.
        robot: RobotId,
    },
    /// A person has left their place.
    WalkedAway {
        /// Who.
        person: PersonName,
    },
    /// A person is back at their place.
    CameBack {
        /// Who.
        person: PersonName,
    },
    /// A person began to hand a sample over.
    HandsOut {
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
        from: Keeper,
        /// Who has it.
        to: Keeper,
    },
    /// A robot stands before an automatic door that it wants to pass.
    DoorAwaited {
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
    Door {
        /// Which door.
        door: String,
        /// Whether it stands open now.
        open: bool,
    },
    /// A robot stands at a stop of a lift that it wants to ride.
    LiftAwaited {
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
    WayClosed {
        /// What it is called.
        obstacle: String,
        /// The way, by its two ends.
        between: (PlaceId, PlaceId),
    },
    /// It was taken away.
    WayOpened {
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
pub(super) struct Journal(VecDeque<JournalEntry>);

impl Journal {
    pub(super) fn write(&mut self, now: f64, what: Happening, kept: usize) {
        self.0.push_back(JournalEntry { time: WorldTime::from_secs(now), what });
        if self.0.len() > kept {
            self.0.pop_front();
        }
    }
}

impl World {
    /// What happened since this was last asked for, oldest first.
    pub fn drain_journal(&mut self) -> Vec<JournalEntry> {
        std::mem::take(&mut self.floor.journal.0).into()
    }
}
