//! How a robot gets from where it stands to a pose or a place: along a lane, over the floor, or by a lift. Nothing moves yet.

use crate::kinematics::StraightRun;
use crate::map::{Facing, PlaceIndex, limits};
use crate::world::components::Body;
use crate::world::floor::Floor;
use crate::world::reach::refused;
use crate::world::whereabouts::{Drive, Spot, Stretch, Whereabouts};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_skills::actions::{ActionError, ErrorCode, Waypoint};
use hecs::Entity;

/// A pose given for a place must be this close to where the map has it; more is a robot with another map.
const SAME_SPOT_M: f64 = 0.1;

/// Where a robot is to go.
#[derive(Debug, Clone)]
pub(crate) struct Errand {
    pub(crate) pose: Pose,
    pub(crate) place: Option<PlaceId>,
}

impl From<&Waypoint> for Errand {
    fn from(waypoint: &Waypoint) -> Errand {
        Errand { pose: waypoint.pose, place: waypoint.place.clone() }
    }
}

/// How one gets to where one wants to go.
pub(crate) enum Way {
    /// By a drive, at a speed in metres per second.
    Drive(Drive, f64),
    /// By a lift.
    Ride { lift: String, from: PlaceIndex, to: PlaceIndex },
}

impl Floor {
    /// Finds the way to a pose or place; nothing moves yet.
    pub(crate) fn find_way(&self, robot: Entity, Errand { pose, place }: &Errand) -> Result<Way, ActionError> {
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
                let (place, end_pose) = self.destination(place, *pose)?;
                if let Some((from, lift)) = self.lift_from(start_spot, place) {
                    return Ok(Way::Ride { lift, from, to: place });
                }
                let (length_m, lane) = self.leg(start_spot, start_pose, place)?;
                (Spot::Place(place), end_pose, length_m, lane)
            }
            None => {
                let near = start_spot.last_place();
                let there = self.map.at(near).pose.distance(*pose).get() <= SAME_SPOT_M;
                let spot = if there { Spot::Place(near) } else { Spot::Floor { near } };
                (spot, *pose, start_pose.distance(*pose).get(), None)
            }
        };
        let (limit, backward) = lane.map_or((None, false), |stretch| self.rules(stretch));
        let speed_mps = limit.map_or(body.speed.get(), |limit| body.speed.get().min(limit));
        let (began, run) = (self.now, StraightRun::steady(length_m, speed_mps));
        let drive = Drive { start_spot, start_pose, began, end_spot, end_pose, run, lane, backward };
        Ok(Way::Drive(drive, speed_mps))
    }

    /// The lift to take from where a robot stands, if no lane leads there.
    fn lift_from(&self, start: Spot, to: PlaceIndex) -> Option<(PlaceIndex, String)> {
        let Spot::Place(from) = start else { return None };
        let lift = self.lift_between(&self.map.at(from).id, &self.map.at(to).id)?;
        self.map.drivable(from, to).is_none().then_some((from, lift))
    }

    /// How fast one may drive on a part of a lane, in metres per second, and whether one drives backward there.
    fn rules(&self, (from, to, first, last): Stretch) -> (Option<f64>, bool) {
        let Some(lane) = self.map.drivable(from, to) else { return (None, false) };
        let along = (lane.from == self.map.at(from).id) == (last >= first);
        let facing = lane.facing.map(|facing| if along { facing } else { facing.reversed() });
        (lane.speed_limit.map(|limit| limit.get()), facing == Some(Facing::Backward))
    }

    /// Where a place is, for a robot that believes it to be at a pose.
    pub(crate) fn destination(&self, place: &PlaceId, pose: Pose) -> Result<(PlaceIndex, Pose), ActionError> {
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
            Spot::Lane { .. } | Spot::Lift { .. } => {
                no_lane(format!("no lane to {} from {}", name(to), start.describe(&self.map)))
            }
            Spot::Floor { near } if to == near => Ok((pose.distance(self.map.at(near).pose).get(), None)),
            Spot::Floor { near } => no_lane(format!(
                "no lane to {} from {}: the way back is to {}",
                name(to),
                start.describe(&self.map),
                name(near)
            )),
        }
    }
}
