//! Where a body is, as a function of time.

use super::floor::Floor;
use crate::map::{Map, PlaceIndex};
use consort_protocol::pose::Pose;
use consort_protocol::units::Metres;
use hecs::Entity;

/// What a robot's position means on the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Spot {
    /// At a place.
    Place(PlaceIndex),
    /// In the middle of a lane, after this share of its length from `from` to `to`.
    Lane { from: PlaceIndex, to: PlaceIndex, share: f64 },
    /// Anywhere on the floor, having last passed `near`.
    Floor { near: PlaceIndex },
    /// In a lift, on the way to one of its stops.
    Lift { to: PlaceIndex },
}

/// Where a robot is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Whereabouts {
    Standing { spot: Spot, pose: Pose },
    Driving(Drive),
}

/// A straight line under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Drive {
    /// Where it stood when it began.
    pub(crate) start_spot: Spot,
    pub(crate) start_pose: Pose,
    pub(crate) began: f64,
    /// Where it will stand.
    pub(crate) end_spot: Spot,
    pub(crate) end_pose: Pose,
    pub(crate) ends: f64,
    pub(crate) length_m: f64,
    /// The part of a lane it follows, if it does.
    pub(crate) lane: Option<Stretch>,
    /// Whether it drives with its back in front.
    pub(crate) backward: bool,
}

/// Part of a lane: the lane's ends, and the shares of its length where the part begins and ends.
pub(crate) type Stretch = (PlaceIndex, PlaceIndex, f64, f64);

impl Drive {
    /// Share of the drive done, from 0 to 1.
    fn share(&self, time: f64) -> f64 {
        if time >= self.ends { 1.0 } else { ((time - self.began) / (self.ends - self.began)).clamp(0.0, 1.0) }
    }

    fn pose(&self, time: f64) -> Pose {
        self.pose_after(self.share(time))
    }

    fn pose_after(&self, share: f64) -> Pose {
        let (a, b) = (self.start_pose, self.end_pose);
        if share >= 1.0 {
            return b;
        }
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let front = if self.backward { (-dx, -dy) } else { (dx, dy) };
        let yaw = if share > 0.0 && (dx, dy) != (0.0, 0.0) { front.1.atan2(front.0) } else { a.yaw };
        Pose::new(a.x + dx * share, a.y + dy * share, yaw)
    }

    /// The part of it between two distances from its start, driven from `now` on.
    pub(crate) fn part(&self, from_m: f64, to_m: f64, now: f64, speed_mps: f64) -> Drive {
        let share = |m: f64| if self.length_m > 0.0 { (m / self.length_m).clamp(0.0, 1.0) } else { 1.0 };
        let (a, b) = (share(from_m), share(to_m));
        let length_m = to_m - from_m;
        Drive {
            start_spot: self.spot_after(a),
            start_pose: self.pose_after(a),
            began: now,
            end_spot: self.spot_after(b),
            end_pose: self.pose_after(b),
            ends: now + length_m / speed_mps,
            length_m,
            lane: self
                .lane
                .map(|(from, to, first, last)| (from, to, first + (last - first) * a, first + (last - first) * b)),
            backward: self.backward,
        }
    }

    pub(crate) fn remaining(&self, time: f64) -> Metres {
        Metres::new(self.length_m * (1.0 - self.share(time))).unwrap_or(Metres::ZERO)
    }

    /// Where it stands if it stops now.
    fn spot(&self, time: f64) -> Spot {
        self.spot_after(self.share(time))
    }

    fn spot_after(&self, share: f64) -> Spot {
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
    pub(crate) fn last_place(self) -> PlaceIndex {
        match self {
            Spot::Place(place) => place,
            Spot::Lane { from, .. } => from,
            Spot::Floor { near } => near,
            Spot::Lift { to } => to,
        }
    }

    /// For people: `at IC Room 1`, `between Dock and Crossing`.
    pub(crate) fn describe(self, map: &Map) -> String {
        let name = |place| &map.at(place).id;
        match self {
            Spot::Place(place) => format!("at {}", name(place)),
            Spot::Lane { from, to, .. } => format!("between {} and {}", name(from), name(to)),
            Spot::Floor { near } => format!("off the lanes near {}", name(near)),
            Spot::Lift { to } => {
                let lift = map.lift_at(name(to)).map_or("a lift", |lift| lift.name.as_str());
                format!("in {lift} on the way to {}", name(to))
            }
        }
    }
}

impl Whereabouts {
    pub(crate) fn pose(&self, time: f64) -> Pose {
        match self {
            Whereabouts::Standing { pose, .. } => *pose,
            Whereabouts::Driving(drive) => drive.pose(time),
        }
    }

    pub(crate) fn spot(&self, time: f64) -> Spot {
        match self {
            Whereabouts::Standing { spot, .. } => *spot,
            Whereabouts::Driving(drive) => drive.spot(time),
        }
    }
}

impl Floor {
    pub(crate) fn spot(&self, robot: Entity) -> Spot {
        self.get::<Whereabouts>(robot).spot(self.now)
    }
}
