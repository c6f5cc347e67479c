//! Where a body is, as a function of time.
//!
//! A drive is a straight line at the robot's own speed, the same in every direction: its position is computed from when
//! it began, and its end is an entry in the queue. Robots may pass through one another.

use super::components::{Beside, Body, Departures};
use super::{World, actions::refused};
use crate::map::{Map, PlaceIndex, limits};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::Metres;
use consort_skills::actions::{ActionError, ErrorCode};
use hecs::Entity;

/// A pose given for a place must be this close to where the map has it; more is a robot with another map.
pub(super) const SAME_SPOT_M: f64 = 0.1;

/// What a robot's position means on the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Spot {
    /// At a place.
    Place(PlaceIndex),
    /// In the middle of a lane, after this share of its length from `from` to `to`.
    Lane { from: PlaceIndex, to: PlaceIndex, share: f64 },
    /// Anywhere on the floor, having last passed `near`.
    Floor { near: PlaceIndex },
}

/// Where a robot is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Whereabouts {
    Standing { spot: Spot, pose: Pose },
    Driving(Drive),
}

/// A straight line under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drive {
    /// Where it stood when it began.
    start_spot: Spot,
    start_pose: Pose,
    began: f64,
    /// Where it will stand.
    end_spot: Spot,
    end_pose: Pose,
    pub(super) ends: f64,
    length_m: f64,
    /// The part of a lane it follows, if it does.
    lane: Option<Stretch>,
}

/// Part of a lane: the lane's ends, and the shares of its length where the part begins and ends.
type Stretch = (PlaceIndex, PlaceIndex, f64, f64);

impl Drive {
    /// Share of the drive done, from 0 to 1.
    fn share(&self, time: f64) -> f64 {
        if time >= self.ends { 1.0 } else { ((time - self.began) / (self.ends - self.began)).clamp(0.0, 1.0) }
    }

    fn pose(&self, time: f64) -> Pose {
        let (a, b, share) = (self.start_pose, self.end_pose, self.share(time));
        if share >= 1.0 {
            return b;
        }
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let yaw = if share > 0.0 && (dx, dy) != (0.0, 0.0) { dy.atan2(dx) } else { a.yaw };
        Pose::new(a.x + dx * share, a.y + dy * share, yaw)
    }

    pub(super) fn remaining(&self, time: f64) -> Metres {
        Metres::new(self.length_m * (1.0 - self.share(time))).unwrap_or(Metres::ZERO)
    }

    /// Where it stands if it stops now.
    fn spot(&self, time: f64) -> Spot {
        let share = self.share(time);
        match self.lane {
            _ if share <= 0.0 => self.start_spot,
            _ if share >= 1.0 => self.end_spot,
            Some((from, to, first, last)) => Spot::Lane { from, to, share: first + (last - first) * share },
            None => Spot::Floor { near: self.start_spot.last_place() },
        }
    }
}

impl Spot {
    /// The place, or the last one passed.
    pub(super) fn last_place(self) -> PlaceIndex {
        match self {
            Spot::Place(place) => place,
            Spot::Lane { from, .. } => from,
            Spot::Floor { near } => near,
        }
    }

    /// For people: `at IC Room 1`, `between Dock and Crossing`.
    pub(super) fn describe(self, map: &Map) -> String {
        let name = |place| &map.at(place).id;
        match self {
            Spot::Place(place) => format!("at {}", name(place)),
            Spot::Lane { from, to, .. } => format!("between {} and {}", name(from), name(to)),
            Spot::Floor { near } => format!("off the lanes near {}", name(near)),
        }
    }
}

impl Whereabouts {
    pub(super) fn pose(&self, time: f64) -> Pose {
        match self {
            Whereabouts::Standing { pose, .. } => *pose,
            Whereabouts::Driving(drive) => drive.pose(time),
        }
    }

    pub(super) fn spot(&self, time: f64) -> Spot {
        match self {
            Whereabouts::Standing { spot, .. } => *spot,
            Whereabouts::Driving(drive) => drive.spot(time),
        }
    }
}

impl World {
    pub(super) fn spot(&self, robot: Entity) -> Spot {
        self.get::<Whereabouts>(robot).spot(self.now)
    }

    /// Plans a straight line to a pose or place; nothing moves yet.
    pub(super) fn drive(&self, robot: Entity, pose: Pose, place: Option<&PlaceId>) -> Result<Drive, ActionError> {
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
    pub(super) fn set_off(&mut self, robot: Entity, drive: Drive) {
        *self.get_mut::<Whereabouts>(robot) = Whereabouts::Driving(drive);
        if drive.length_m > 0.0 {
            *self.get_mut::<Beside>(robot) = Beside::Nobody;
            self.get_mut::<Departures>(robot).0 += 1;
        }
    }

    /// Lets a robot stand where it is now, whether it was driving or not.
    pub(super) fn stand_still(&mut self, robot: Entity) {
        let mut whereabouts = self.get_mut::<Whereabouts>(robot);
        *whereabouts = Whereabouts::Standing { spot: whereabouts.spot(self.now), pose: whereabouts.pose(self.now) };
    }
}
