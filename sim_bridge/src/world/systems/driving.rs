//! Driving to a pose: a straight line at the robot's own speed, the same in every direction.
//!
//! Its position is computed from when it began, and its end is an entry in the queue: a robot under way costs nothing.
//! Robots may pass through one another.

use crate::map::{PlaceIndex, limits};
use crate::world::components::{Beside, Body, Departures};
use crate::world::floor::Floor;
use crate::world::reach::refused;
use crate::world::setup::RobotBody;
use crate::world::system::{Kind, System, kinds};
use crate::world::whereabouts::{Drive, Spot, Stretch, Whereabouts};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_skills::actions::{ActionError, ErrorCode, Feedback, Goal};
use hecs::Entity;

/// A pose given for a place must be this close to where the map has it; more is a robot with another map.
const SAME_SPOT_M: f64 = 0.1;

/// See the [module](self).
pub(crate) struct Driving;

impl System for Driving {
    fn name(&self) -> &'static str {
        "driving"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![Body]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Whereabouts, Departures, Beside]
    }

    fn equip(&self, floor: &mut Floor, robot: Entity, _body: &RobotBody) {
        floor.give(robot, Departures(0));
    }

    fn begin(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let Goal::NavigateToPose { pose, place } = goal else { return None };
        let drive = floor.plan_drive(robot, *pose, place.as_ref());
        Some(drive.map(|drive| {
            floor.set_off(robot, drive);
            drive.ends
        }))
    }

    fn finish(&self, floor: &mut Floor, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        floor.stand_still(robot);
        Ok(())
    }

    fn halt(&self, floor: &mut Floor, robot: Entity, _goal: &Goal) {
        floor.stand_still(robot);
    }

    fn feedback(&self, floor: &Floor, robot: Entity, _goal: &Goal, usual: Feedback) -> Feedback {
        match &*floor.get::<Whereabouts>(robot) {
            Whereabouts::Driving(drive) => Feedback { distance_remaining: drive.remaining(floor.now), ..usual },
            Whereabouts::Standing { .. } => usual,
        }
    }
}

impl Floor {
    /// Plans a straight line to a pose or place; nothing moves yet.
    fn plan_drive(&self, robot: Entity, pose: Pose, place: Option<&PlaceId>) -> Result<Drive, ActionError> {
        let body = &self.get::<Body>(robot).0;
        if !body.mobile {
            return Err(refused(ErrorCode::NoRoute, format!("{} cannot drive", body.id)));
        }
        let sane = |value: f64| value.abs() <= limits::EXTENT_M;
        if ![pose.x, pose.y, pose.yaw].into_iter().all(sane) {
            let message = format!("({}, {}, {}) is not a pose on a floor", pose.x, pose.y, pose.yaw);
            return Err(refused(ErrorCode::Unknown, message));
        }
        let whereabouts = *self.get::<Whereabouts>(robot);
        let (start_pose, start_spot) = (whereabouts.pose(self.now), whereabouts.spot(self.now));
        let (end_spot, end_pose, length_m, lane) = match place {
            Some(place) => {
                let (place, end_pose) = self.destination(place, pose)?;
                let (length_m, lane) = self.leg(start_spot, start_pose, place)?;
                (Spot::Place(place), end_pose, length_m, lane)
            }
            None => {
                let near = start_spot.last_place();
                let there = self.map.at(near).pose.distance(pose).get() <= SAME_SPOT_M;
                let spot = if there { Spot::Place(near) } else { Spot::Floor { near } };
                (spot, pose, start_pose.distance(pose).get(), None)
            }
        };
        let ends = self.now + length_m / body.speed.get();
        Ok(Drive { start_spot, start_pose, began: self.now, end_spot, end_pose, ends, length_m, lane })
    }

    fn destination(&self, place: &PlaceId, pose: Pose) -> Result<(PlaceIndex, Pose), ActionError> {
        let Some(index) = self.map.index(place) else {
            let message = format!("there is no place {:?} here{}", place.as_str(), self.map.suggest(place));
            return Err(refused(ErrorCode::Unknown, message));
        };
        let known = self.map.at(index).pose;
        if known.distance(pose).get() > SAME_SPOT_M {
            let message =
                format!("{place} is at ({}, {}) on this map, not at ({}, {})", known.x, known.y, pose.x, pose.y);
            return Err(refused(ErrorCode::Unknown, message));
        }
        Ok((index, Pose { yaw: pose.yaw, ..known }))
    }

    /// How far it is along the map from where a robot stands, and along which part of which lane.
    fn leg(&self, start: Spot, pose: Pose, to: PlaceIndex) -> Result<(f64, Option<Stretch>), ActionError> {
        let name = |place| &self.map.at(place).id;
        let no_lane = |message| Err(refused(ErrorCode::NoRoute, message));
        match start {
            Spot::Place(from) if from == to => Ok((0.0, None)),
            Spot::Place(from) => match self.map.drivable(from, to) {
                Some(lane) => Ok((lane.length.get(), Some((from, to, 0.0, 1.0)))),
                None => no_lane(format!("no lane from {} to {}", name(from), name(to))),
            },
            Spot::Lane { from, to: end, share } if to == end => {
                let length_m = self.map.drivable(from, end).map_or(0.0, |lane| lane.length.get());
                Ok((length_m * (1.0 - share), Some((from, end, share, 1.0))))
            }
            Spot::Lane { from, to: end, share } if to == from => match self.map.drivable(end, from) {
                Some(lane) => Ok((lane.length.get() * share, Some((from, end, share, 0.0)))),
                None => no_lane(format!("the lane from {} to {} is one-way", name(from), name(end))),
            },
            Spot::Lane { .. } => no_lane(format!("no lane to {} from {}", name(to), start.describe(&self.map))),
            Spot::Floor { near } if to == near => Ok((pose.distance(self.map.at(near).pose).get(), None)),
            Spot::Floor { near } => no_lane(format!(
                "no lane to {} from {}: the way back is to {}",
                name(to),
                start.describe(&self.map),
                name(near)
            )),
        }
    }

    /// Sets a robot in motion. Whoever it was beside, it is no longer.
    fn set_off(&mut self, robot: Entity, drive: Drive) {
        *self.get_mut::<Whereabouts>(robot) = Whereabouts::Driving(drive);
        if drive.length_m > 0.0 {
            if let Some(mut beside) = self.find_mut::<Beside>(robot) {
                *beside = Beside::Nobody;
            }
            self.get_mut::<Departures>(robot).0 += 1;
        }
    }

    /// Lets a robot stand where it is now, whether it was driving or not.
    fn stand_still(&mut self, robot: Entity) {
        let mut whereabouts = self.get_mut::<Whereabouts>(robot);
        *whereabouts = Whereabouts::Standing { spot: whereabouts.spot(self.now), pose: whereabouts.pose(self.now) };
    }
}
