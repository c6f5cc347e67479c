//! Progress of a robot's drive, as a component.

use crate::map::PlaceIndex;
use crate::world::drive_progress::DriveProgress;
use crate::world::event_queue::TimerId;
use crate::world::routing::DriveTarget;
use hecs::Entity;
use std::collections::VecDeque;

/// Progress of a robot's drive, apart from its location.
pub(crate) struct DriveTask {
    /// Target of the active goal.
    pub(super) target: Option<DriveTarget>,
    /// Number of targets of the active goal.
    pub(super) targets: usize,
    /// Later targets.
    pub(super) next_targets: VecDeque<DriveTarget>,
    pub(super) stage: Stage,
    pub(super) timer: Option<TimerId>,
    /// The doorway that the robot is in.
    pub(super) doorway: Option<Entity>,
}

/// Stage of a drive.
pub(super) enum Stage {
    /// No drive.
    Idle,
    Driving(DriveProgress),
    AtDoor(DriveProgress, Entity),
    AtLift(PlaceIndex),
    /// Until the lift arrives, even if the goal ends.
    InLift,
}
