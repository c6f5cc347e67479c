//! Routing: from a robot's position to a pose or a place, along a lane, over the floor, or by a
//! lift. Nothing moves yet.

use crate::kinematics::TrapezoidProfile;
use crate::map::{Facing, PlaceIndex, limits};
use crate::world::components::SimRobot;
use crate::world::location::{LanePart, MapPosition, RobotLocation, StraightDrive};
use crate::world::preconditions::action_error;
use crate::world::sim_state::SimState;
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::MetresPerSecond;
use consort_skills::actions::{ActionError, ErrorCode, Waypoint};
use hecs::Entity;

/// Greatest distance between a given pose and the map's pose of the place. More means that the
/// robot uses another map.
const SAME_SPOT_M: f64 = 0.1;

/// Greatest distance from a lane at which a robot stands on it: a little more than the tolerance of
/// routes, which continue along the lane.
const ON_LANE_M: f64 = 0.3;

/// Target of a drive.
#[derive(Debug, Clone)]
pub(crate) struct DriveTarget {
    pub(crate) pose: Pose,
    pub(crate) place: Option<PlaceId>,
    /// The highest allowed speed.
    pub(crate) speed_max: Option<MetresPerSecond>,
}

impl From<&Waypoint> for DriveTarget {
    fn from(waypoint: &Waypoint) -> DriveTarget {
        DriveTarget { pose: waypoint.pose, place: waypoint.place.clone(), speed_max: None }
    }
}

/// Plan of a leg.
pub(crate) enum LegPlan {
    /// A drive, with its speed in metres per second.
    Drive(StraightDrive, f64),
    /// A ride by lift.
    Ride { lift: String, from: PlaceIndex, to: PlaceIndex },
}

impl SimState {
    /// Plans the leg to a pose or place. Nothing moves yet.
    pub(crate) fn plan_leg(
        &self,
        robot: Entity,
        DriveTarget { pose, place, speed_max }: &DriveTarget,
    ) -> Result<LegPlan, ActionError> {
        let body = &self.get::<SimRobot>(robot).0;
        if !body.mobile {
            return Err(action_error(ErrorCode::NoRoute, format!("{} cannot drive", body.id)));
        }
        let in_bounds = |value: f64| value.abs() <= limits::EXTENT_M;
        if ![pose.x, pose.y, pose.yaw].into_iter().all(in_bounds) {
            let message = format!("({}, {}, {}) is not a pose on a floor", pose.x, pose.y, pose.yaw);
            return Err(action_error(ErrorCode::Unknown, message));
        }
        let location = *self.get::<RobotLocation>(robot);
        let (start_pose, start_position) = (location.pose(self.now), location.map_position(self.now));
        let (end_position, end_pose, length_m, lane) = match place {
            Some(place) => {
                let (place, end_pose) = self.destination(place, *pose)?;
                if let Some((from, lift)) = self.lift_from(start_position, place) {
                    return Ok(LegPlan::Ride { lift, from, to: place });
                }
                let (length_m, lane) = self.leg(start_position, start_pose, place)?;
                (MapPosition::Place(place), end_pose, length_m, lane)
            }
            None => {
                let near = start_position.last_place();
                let is_at_place = self.map.place_at(near).pose.distance(*pose).get() <= SAME_SPOT_M;
                let position = if is_at_place { MapPosition::Place(near) } else { MapPosition::Floor { near } };
                (position, *pose, start_pose.distance(*pose).get(), None)
            }
        };
        let (limit, backward) = lane.map_or((None, false), |stretch| self.lane_rules(stretch));
        let limits = limit.into_iter().chain(speed_max.map(MetresPerSecond::get));
        let speed_mps = limits.fold(body.speed.get(), f64::min);
        let (start_time, profile) = (self.now, TrapezoidProfile::constant_speed(length_m, speed_mps));
        let drive =
            StraightDrive { start_position, start_pose, start_time, end_position, end_pose, profile, lane, backward };
        Ok(LegPlan::Drive(drive, speed_mps))
    }

    /// Returns the lift to the place, if no lane leads there.
    fn lift_from(&self, start: MapPosition, to: PlaceIndex) -> Option<(PlaceIndex, String)> {
        let MapPosition::Place(from) = start else { return None };
        let lift = self.lift_between(&self.map.place_at(from).id, &self.map.place_at(to).id)?;
        self.map.lane_between(from, to).is_none().then_some((from, lift))
    }

    /// Returns the speed limit on a part of a lane, in metres per second, and whether robots drive
    /// backward there.
    fn lane_rules(&self, (from, to, first, last): LanePart) -> (Option<f64>, bool) {
        let Some(lane) = self.map.lane_between(from, to) else { return (None, false) };
        let along = (lane.from == self.map.place_at(from).id) == (last >= first);
        let facing = lane.facing.map(|facing| if along { facing } else { facing.reversed() });
        (lane.speed_limit.map(|limit| limit.get()), facing == Some(Facing::Backward))
    }

    /// Returns a place and its pose, if the map of the robot agrees with it.
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

    /// Returns the length of a leg along the map, and the part of the lane it uses.
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
            MapPosition::Floor { near } => match self.share_of_lane(near, to, pose) {
                // It has left the lanes, and stands on one again.
                Some(share) => self.leg(MapPosition::Lane { from: near, to, share }, pose, to),
                None => no_lane(format!(
                    "no lane to {} from {}: the way back is to {}",
                    name(to),
                    start.describe(&self.map),
                    name(near)
                )),
            },
        }
    }

    /// Returns the share of a lane after which a pose on the lane is.
    fn share_of_lane(&self, from: PlaceIndex, to: PlaceIndex, pose: Pose) -> Option<f64> {
        self.map.lane_between(from, to)?;
        let (a, b) = (self.map.place_at(from).pose, self.map.place_at(to).pose);
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let share = ((pose.x - a.x) * dx + (pose.y - a.y) * dy) / (dx * dx + dy * dy);
        let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
        let on_lane = Pose::new(a.x + dx * share, a.y + dy * share, 0.0);
        (pose.distance(on_lane).get() <= ON_LANE_M).then_some(share)
    }
}
