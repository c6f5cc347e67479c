//! How a robot gets from where it stands to a pose or a place: along a lane, over the floor, or by a lift. Nothing moves yet.

use crate::kinematics::TrapezoidProfile;
use crate::map::{Facing, PlaceIndex, limits};
use crate::world::components::SimRobot;
use crate::world::location::{LanePart, MapPosition, RobotLocation, StraightDrive};
use crate::world::preconditions::action_error;
use crate::world::sim_state::SimState;
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_skills::actions::{ActionError, ErrorCode, Waypoint};
use hecs::Entity;

/// A pose given for a place must be this close to where the map has it; more is a robot with another map.
const SAME_SPOT_M: f64 = 0.1;

/// Where a robot is to go.
#[derive(Debug, Clone)]
pub(crate) struct DriveTarget {
    pub(crate) pose: Pose,
    pub(crate) place: Option<PlaceId>,
}

impl From<&Waypoint> for DriveTarget {
    fn from(waypoint: &Waypoint) -> DriveTarget {
        DriveTarget { pose: waypoint.pose, place: waypoint.place.clone() }
    }
}

/// How one gets to where one wants to go.
pub(crate) enum LegPlan {
    /// By a drive, at a speed in metres per second.
    Drive(StraightDrive, f64),
    /// By a lift.
    Ride { lift: String, from: PlaceIndex, to: PlaceIndex },
}

impl SimState {
    /// Finds the way to a pose or place; nothing moves yet.
    pub(crate) fn plan_leg(
        &self,
        robot: Entity,
        DriveTarget { pose, place }: &DriveTarget,
    ) -> Result<LegPlan, ActionError> {
        let body = &self.get::<SimRobot>(robot).0;
        if !body.mobile {
            return Err(action_error(ErrorCode::NoRoute, format!("{} cannot drive", body.id)));
        }
        let sane = |value: f64| value.abs() <= limits::EXTENT_M;
        if ![pose.x, pose.y, pose.yaw].into_iter().all(sane) {
            let message = format!("({}, {}, {}) is not a pose on a floor", pose.x, pose.y, pose.yaw);
            return Err(action_error(ErrorCode::Unknown, message));
        }
        let whereabouts = *self.get::<RobotLocation>(robot);
        let (start_pose, start_spot) = (whereabouts.pose(self.now), whereabouts.map_position(self.now));
        let (end_spot, end_pose, length_m, lane) = match place {
            Some(place) => {
                let (place, end_pose) = self.destination(place, *pose)?;
                if let Some((from, lift)) = self.lift_from(start_spot, place) {
                    return Ok(LegPlan::Ride { lift, from, to: place });
                }
                let (length_m, lane) = self.leg(start_spot, start_pose, place)?;
                (MapPosition::Place(place), end_pose, length_m, lane)
            }
            None => {
                let near = start_spot.last_place();
                let there = self.map.place_at(near).pose.distance(*pose).get() <= SAME_SPOT_M;
                let spot = if there { MapPosition::Place(near) } else { MapPosition::Floor { near } };
                (spot, *pose, start_pose.distance(*pose).get(), None)
            }
        };
        let (limit, backward) = lane.map_or((None, false), |stretch| self.rules(stretch));
        let speed_mps = limit.map_or(body.speed.get(), |limit| body.speed.get().min(limit));
        let (began, run) = (self.now, TrapezoidProfile::constant_speed(length_m, speed_mps));
        let drive = StraightDrive {
            start_position: start_spot,
            start_pose,
            start_time: began,
            end_position: end_spot,
            end_pose,
            profile: run,
            lane,
            backward,
        };
        Ok(LegPlan::Drive(drive, speed_mps))
    }

    /// The lift to take from where a robot stands, if no lane leads there.
    fn lift_from(&self, start: MapPosition, to: PlaceIndex) -> Option<(PlaceIndex, String)> {
        let MapPosition::Place(from) = start else { return None };
        let lift = self.lift_between(&self.map.place_at(from).id, &self.map.place_at(to).id)?;
        self.map.lane_between(from, to).is_none().then_some((from, lift))
    }

    /// How fast one may drive on a part of a lane, in metres per second, and whether one drives backward there.
    fn rules(&self, (from, to, first, last): LanePart) -> (Option<f64>, bool) {
        let Some(lane) = self.map.lane_between(from, to) else { return (None, false) };
        let along = (lane.from == self.map.place_at(from).id) == (last >= first);
        let facing = lane.facing.map(|facing| if along { facing } else { facing.reversed() });
        (lane.speed_limit.map(|limit| limit.get()), facing == Some(Facing::Backward))
    }

    /// Where a place is, for a robot that believes it to be at a pose.
    pub(crate) fn destination(&self, place: &PlaceId, pose: Pose) -> Result<(PlaceIndex, Pose), ActionError> {
        let Some(index) = self.map.index(place) else {
            let message = format!("there is no place {:?} here{}", place.as_str(), self.map.suggest(place));
            return Err(action_error(ErrorCode::Unknown, message));
        };
        let known = self.map.place_at(index).pose;
        if known.distance(pose).get() > SAME_SPOT_M {
            let message =
                format!("{place} is at ({}, {}) on this map, not at ({}, {})", known.x, known.y, pose.x, pose.y);
            return Err(action_error(ErrorCode::Unknown, message));
        }
        Ok((index, Pose { yaw: pose.yaw, ..known }))
    }

    /// How far it is along the map from where a robot stands, and along which part of which lane.
    fn leg(&self, start: MapPosition, pose: Pose, to: PlaceIndex) -> Result<(f64, Option<LanePart>), ActionError> {
        let name = |place| &self.map.place_at(place).id;
        let no_lane = |message| Err(action_error(ErrorCode::NoRoute, message));
        match start {
            MapPosition::Place(from) if from == to => Ok((0.0, None)),
            MapPosition::Place(from) => match self.map.lane_between(from, to) {
                Some(lane) => Ok((lane.length.get(), Some((from, to, 0.0, 1.0)))),
                None => no_lane(format!("no lane from {} to {}", name(from), name(to))),
            },
            MapPosition::Lane { from, to: end, share } if to == end => {
                let length_m = self.map.lane_between(from, end).map_or(0.0, |lane| lane.length.get());
                Ok((length_m * (1.0 - share), Some((from, end, share, 1.0))))
            }
            MapPosition::Lane { from, to: end, share } if to == from => match self.map.lane_between(end, from) {
                Some(lane) => Ok((lane.length.get() * share, Some((from, end, share, 0.0)))),
                None => no_lane(format!("the lane from {} to {} is one-way", name(from), name(end))),
            },
            MapPosition::Lane { .. } | MapPosition::Lift { .. } => {
                no_lane(format!("no lane to {} from {}", name(to), start.describe(&self.map)))
            }
            MapPosition::Floor { near } if to == near => Ok((pose.distance(self.map.place_at(near).pose).get(), None)),
            MapPosition::Floor { near } => no_lane(format!(
                "no lane to {} from {}: the way back is to {}",
                name(to),
                start.describe(&self.map),
                name(near)
            )),
        }
    }
}
