//! Locations of robots, as functions of time.

use crate::kinematics::TrapezoidProfile;
use crate::map::{Map, PlaceIndex};
use consort_protocol::pose::Pose;
use consort_protocol::units::Metres;

/// Position of a robot on the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum MapPosition {
    /// At a place.
    Place(PlaceIndex),
    /// On a lane, after this share of its length from `from` to `to`.
    Lane { from: PlaceIndex, to: PlaceIndex, share: f64 },
    /// Off the lanes, after passing `near`.
    Floor { near: PlaceIndex },
    /// In a lift, on the way to a stop.
    Lift { to: PlaceIndex },
}

/// Location of a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RobotLocation {
    Standing { position: MapPosition, pose: Pose },
    Driving(StraightDrive),
}

/// A straight drive in progress.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StraightDrive {
    /// Position at the start.
    pub(crate) start_position: MapPosition,
    pub(crate) start_pose: Pose,
    pub(crate) start_time: f64,
    /// Position at the end.
    pub(crate) end_position: MapPosition,
    pub(crate) end_pose: Pose,
    /// Distance covered over time.
    pub(crate) profile: TrapezoidProfile,
    /// The part of a lane that the drive follows, if any.
    pub(crate) lane: Option<LanePart>,
    /// True for driving backward.
    pub(crate) backward: bool,
}

/// Part of a lane: the lane's ends, and the shares of its length at the start and the end of the
/// part.
pub(crate) type LanePart = (PlaceIndex, PlaceIndex, f64, f64);

impl StraightDrive {
    /// Share of the drive that is covered, from 0 to 1.
    fn share(&self, time: f64) -> f64 {
        if time >= self.end_time() { 1.0 } else { self.profile.distance_at(time - self.start_time) / self.length_m() }
    }

    /// Arrival time.
    pub(crate) fn end_time(&self) -> f64 {
        self.start_time + self.profile.duration_s()
    }

    pub(crate) fn length_m(&self) -> f64 {
        self.profile.length_m()
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

    /// Returns the section between two distances from the start, driven from `now` on.
    pub(crate) fn segment(&self, from_m: f64, to_m: f64, now: f64, speed_mps: f64) -> StraightDrive {
        let whole_m = self.length_m();
        let share = |m: f64| if whole_m > 0.0 { (m / whole_m).clamp(0.0, 1.0) } else { 1.0 };
        let (a, b) = (share(from_m), share(to_m));
        StraightDrive {
            start_position: self.spot_after(a),
            start_pose: self.pose_after(a),
            start_time: now,
            end_position: self.spot_after(b),
            end_pose: self.pose_after(b),
            profile: TrapezoidProfile::constant_speed((to_m - from_m).max(0.0), speed_mps),
            lane: self
                .lane
                .map(|(from, to, first, last)| (from, to, first + (last - first) * a, first + (last - first) * b)),
            backward: self.backward,
        }
    }

    pub(crate) fn remaining(&self, time: f64) -> Metres {
        Metres::new(self.length_m() * (1.0 - self.share(time))).unwrap_or(Metres::ZERO)
    }

    /// Position of the robot if it stops at this time.
    fn map_position(&self, time: f64) -> MapPosition {
        self.spot_after(self.share(time))
    }

    fn spot_after(&self, share: f64) -> MapPosition {
        match self.lane {
            _ if share <= 0.0 => self.start_position,
            _ if share >= 1.0 => self.end_position,
            Some((from, to, first, last)) => MapPosition::Lane { from, to, share: first + (last - first) * share },
            None => MapPosition::Floor { near: self.start_position.last_place() },
        }
    }
}

impl MapPosition {
    /// The current place, or the last place passed.
    pub(crate) fn last_place(self) -> PlaceIndex {
        match self {
            MapPosition::Place(place) => place,
            MapPosition::Lane { from, .. } => from,
            MapPosition::Floor { near } => near,
            MapPosition::Lift { to } => to,
        }
    }

    /// Text for messages: `at IC Room 1`, `between Dock and Crossing`.
    pub(crate) fn describe(self, map: &Map) -> String {
        let name = |place| &map.place_at(place).id;
        match self {
            MapPosition::Place(place) => format!("at {}", name(place)),
            MapPosition::Lane { from, to, .. } => format!("between {} and {}", name(from), name(to)),
            MapPosition::Floor { near } => format!("off the lanes near {}", name(near)),
            MapPosition::Lift { to } => {
                let lift = map.lift_at(name(to)).map_or("a lift", |lift| lift.name.as_str());
                format!("in {lift} on the way to {}", name(to))
            }
        }
    }
}

impl RobotLocation {
    pub(crate) fn pose(&self, time: f64) -> Pose {
        match self {
            RobotLocation::Standing { pose, .. } => *pose,
            RobotLocation::Driving(drive) => drive.pose(time),
        }
    }

    pub(crate) fn map_position(&self, time: f64) -> MapPosition {
        match self {
            RobotLocation::Standing { position: spot, .. } => *spot,
            RobotLocation::Driving(drive) => drive.map_position(time),
        }
    }
}
