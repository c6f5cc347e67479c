//! Driving, or flying, as a chassis does: robots that were given kinematics.
//!
//! Which way a goal leads, and where to stand on it and wait, is decided as for those that drive in straight lines
//! ([`Driving`]); how each part of it is driven, by a [`Mover`]. When that arrives is not known before: while any of them
//! moves the world steps.

use super::driving::Driving;
use crate::kinematics::{Kinematics, Mover, Neighbour, Ramp, StraightRun};
use crate::space::{Bodies, Disc};
use crate::world::World;
use crate::world::components::Body;
use crate::world::floor::Floor;
use crate::world::setup::{RobotBody, WorldSetup};
use crate::world::system::{Kind, System, Wake, kinds};
use crate::world::whereabouts::{Drive, Spot, Whereabouts};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use hecs::Entity;
use nalgebra::{Isometry2, Vector2, Vector3};

/// A robot with kinematics.
pub(crate) struct Steered {
    pub(crate) mover: Mover,
    /// The instant at which the mover is.
    since: f64,
    /// The part of its way that is under way: what it would be along a straight line.
    course: Option<Drive>,
    /// When so much of it is left, there is something to do without a stop.
    watched_m: Option<f64>,
    /// The level that it is on.
    level: usize,
}

/// What a robot takes up: from its middle to its outermost part, in metres.
pub(crate) struct Footprint(pub(crate) f64);

/// What is where, as of the latest step.
#[derive(Default)]
pub(crate) struct Surroundings {
    pub(crate) bodies: Bodies,
    /// Whose body is whose, by their names among the bodies, and whether it moves in steps.
    pub(crate) whose: Vec<(Entity, bool)>,
    /// Room to work in, kept from step to step.
    found: Vec<(Entity, Disc, Spot, bool)>,
    around: Vec<Neighbour>,
    arrived: Vec<Entity>,
    passed: Vec<Entity>,
}

/// How wide the cells are in which bodies are looked for: about what drones look at around them.
const CELL_M: f64 = 2.0;
/// Room that a robot leaves beside another that stands where it was sent.
const BESIDE_M: f64 = 0.1;

/// See the [module](self).
pub(crate) struct Steering;

impl System for Steering {
    fn name(&self) -> &'static str {
        "steering"
    }

    fn reads(&self) -> Vec<Kind> {
        Driving.reads()
    }

    fn writes(&self) -> Vec<Kind> {
        let mut kinds = Driving.writes();
        kinds.extend(kinds![Footprint]);
        kinds
    }

    fn furnish(&self, floor: &mut Floor, _setup: &WorldSetup) {
        floor.furnish(Surroundings::default());
    }

    fn equip(&self, floor: &mut Floor, robot: Entity, body: &RobotBody) {
        floor.give(robot, Footprint(body.radius_m));
        if let Some(kinematics) = &body.kinematics {
            let pose = isometry(floor.get::<Whereabouts>(robot).pose(floor.now));
            let mover = Mover::new(kinematics, body.speed.get(), body.radius_m, pose);
            let level = floor.level_of(floor.spot(robot));
            floor.give(robot, Steered { mover, since: floor.now, course: None, watched_m: None, level });
        }
    }

    fn wake(&self, floor: &mut Floor, wake: Wake) {
        Driving.wake(floor, wake);
    }

    fn step(&self, floor: &mut Floor) -> bool {
        let mut there = std::mem::take(&mut *floor.own_mut::<Surroundings>());
        let mut goes_on = false;
        let now = floor.now;
        for (robot, steered, whereabouts) in floor.each::<(Entity, &mut Steered, &mut Whereabouts)>() {
            if !steered.mover.is_moving() {
                steered.since = now;
                continue;
            }
            there.look_around(robot, steered);
            let arrives = steered.mover.advance(now - steered.since, &there.around).is_some();
            steered.since = now;
            goes_on |= steered.mover.is_moving();
            *whereabouts = steered.whereabouts(whereabouts);
            if arrives && let Some(course) = steered.course.take() {
                *whereabouts = Whereabouts::Standing { spot: course.end_spot, pose: steered.pose() };
                there.arrived.push(robot);
            } else if steered.watched_m.is_some_and(|watched_m| steered.left_m() <= watched_m) {
                steered.watched_m = None;
                there.passed.push(robot);
            }
        }
        floor.lay_out(&mut there);
        let (mut arrived, mut passed) = (std::mem::take(&mut there.arrived), std::mem::take(&mut there.passed));
        *floor.own_mut::<Surroundings>() = there;
        passed.drain(..).for_each(|robot| floor.steered_past(robot));
        arrived.drain(..).for_each(|robot| floor.steered_there(robot));
        let mut there = floor.own_mut::<Surroundings>();
        (there.arrived, there.passed) = (arrived, passed);
        goes_on
    }
}

impl Steered {
    /// Something pushes it now. If it stood until now, nothing has happened to it since the latest step.
    pub(crate) fn push(&mut self, by: Vector3<f64>, now: f64) {
        if !self.mover.is_moving() {
            self.since = now;
        }
        self.mover.push(by);
    }

    /// Where it is now, given where it was.
    fn whereabouts(&self, before: &Whereabouts) -> Whereabouts {
        let pose = self.pose();
        let spot = match (&self.course, before) {
            (Some(course), _) => course.spot_beside(&self.pose()),
            (None, Whereabouts::Standing { spot, .. }) => *spot,
            (None, Whereabouts::Driving(drive)) => drive.start_spot,
        };
        Whereabouts::Standing { spot, pose }
    }

    /// How much of the part of its way that is under way is left, in metres.
    fn left_m(&self) -> f64 {
        self.course.map_or(0.0, |course| course.length_m() * (1.0 - course.share_beside(&self.pose())))
    }

    fn pose(&self) -> Pose {
        let pose = self.mover.pose();
        Pose::new(pose.translation.x, pose.translation.y, pose.rotation.angle())
    }
}

impl Drive {
    /// How much of the line is done, from 0 to 1, when one is beside it.
    fn share_beside(&self, at: &Pose) -> f64 {
        let (start, end) = (&self.start_pose, &self.end_pose);
        let along = Vector2::new(end.x - start.x, end.y - start.y);
        let whole = along.norm_squared();
        if whole > 0.0 {
            (along.dot(&Vector2::new(at.x - start.x, at.y - start.y)) / whole).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }

    /// Where one stands who is beside the line, and not yet said to be at its end.
    fn spot_beside(&self, at: &Pose) -> Spot {
        let share = self.share_beside(at);
        match self.lane {
            _ if share <= 0.0 => self.start_spot,
            Some((from, to, first, last)) => Spot::Lane { from, to, share: first + (last - first) * share },
            None => Spot::Floor { near: self.start_spot.last_place() },
        }
    }
}

impl Surroundings {
    /// Collects whom a robot has to make way for.
    fn look_around(&mut self, robot: Entity, steered: &Steered) {
        self.around.clear();
        let Some(reach_m) = steered.mover.looks_m(self.bodies.largest_m()) else { return };
        let (at, level) = (steered.mover.position(), steered.level);
        let (around, whose) = (&mut self.around, &self.whose);
        self.bodies.near(&at, level, reach_m, |name, disc| {
            if whose[name].0 != robot {
                around.push(Neighbour { offset: disc.at - at, radius_m: disc.radius_m });
            }
        });
    }
}

impl World {
    /// How a robot with kinematics moves, as of the latest step; none for one without, or that is not here.
    pub fn mover(&self, robot: &RobotId) -> Option<Mover> {
        let robot = *self.floor.robots.get(robot)?;
        self.floor.find::<Steered>(robot).map(|steered| steered.mover)
    }
}

impl Floor {
    /// Whether a robot is steered.
    pub(crate) fn is_steered(&self, robot: Entity) -> bool {
        self.find::<Steered>(robot).is_some()
    }

    /// Has a robot that is steered drive a straight line as its chassis does; [`Floor::steered_there`] is said once it is
    /// at the end. If that is where it is on its way to already, it just goes on.
    pub(crate) fn steer(&mut self, robot: Entity, part: Drive, speed_mps: f64) {
        let under_way = self.get::<Steered>(robot).course;
        if under_way.is_some_and(|course| course.end_pose == part.end_pose && course.end_spot == part.end_spot) {
            return;
        }
        self.catch_up(robot);
        if !self.is_stepping() {
            let mut there = std::mem::take(&mut *self.own_mut::<Surroundings>());
            self.lay_out(&mut there);
            *self.own_mut::<Surroundings>() = there;
        }
        let (target, level) = (isometry(self.beside_others(robot, &part)), self.level_of(part.start_spot));
        let mut steered = self.get_mut::<Steered>(robot);
        steered.mover.drive_at_most(speed_mps);
        if part.backward {
            steered.mover.aim_backward(target);
        } else {
            steered.mover.aim(target);
        }
        (steered.course, steered.level) = (Some(part), level);
        drop(steered);
        self.step_on();
    }

    /// Has [`Floor::steered_past`] said when so many metres are left of what a robot drives.
    pub(crate) fn watch(&self, robot: Entity, left_m: Option<f64>) {
        self.get_mut::<Steered>(robot).watched_m = left_m;
    }

    /// If a robot is steered and under way, it no longer is, and brakes.
    pub(crate) fn brake(&mut self, robot: Entity) {
        self.catch_up(robot);
        let under_way = self.find_mut::<Steered>(robot).is_some_and(|mut steered| steered.course.take().is_some());
        if under_way {
            self.get_mut::<Steered>(robot).mover.halt();
            self.step_on();
        }
    }

    /// Puts a robot somewhere else.
    pub(crate) fn put(&mut self, robot: Entity, spot: Spot, pose: Pose) {
        *self.get_mut::<Whereabouts>(robot) = Whereabouts::Standing { spot, pose };
        let level = self.level_of(spot);
        let body = &self.get::<Body>(robot).0;
        if let (Some(kinematics), Some(mut steered)) = (&body.kinematics, self.find_mut::<Steered>(robot)) {
            let mover = Mover::new(kinematics, body.speed.get(), body.radius_m, isometry(pose));
            *steered = Steered { mover, since: self.now, course: None, watched_m: None, level };
        }
    }

    /// How much of the part of its way is left that a robot is on, as far as its place on the map goes, in metres.
    pub(crate) fn steered_left_m(&self, robot: Entity) -> f64 {
        self.find::<Steered>(robot).map_or(0.0, |steered| steered.left_m())
    }

    /// How far it still has to drive on the part of its way that it is on, and about how long that takes.
    pub(crate) fn steered_left(&self, robot: Entity, speed_mps: f64) -> (f64, f64) {
        let left_m = self.find::<Steered>(robot).map_or(0.0, |steered| steered.mover.remaining_m());
        let kinematics = self.get::<Body>(robot).0.kinematics;
        (left_m, kinematics.map_or(0.0, |kinematics| about(&kinematics, speed_mps, left_m)))
    }

    /// Where a drive is to end: where it was sent, or this side of whoever stands there.
    fn beside_others(&self, robot: Entity, drive: &Drive) -> Pose {
        let (start, end) = (drive.start_pose, drive.end_pose);
        let back = Vector2::new(start.x - end.x, start.y - end.y);
        let (there, own_m) = (self.own::<Surroundings>(), self.get::<Footprint>(robot).0);
        let (at, reach_m) = (Vector3::new(end.x, end.y, 0.0), own_m + there.bodies.largest_m() + BESIDE_M);
        let mut room_m: f64 = 0.0;
        there.bodies.near(&at, self.level_of(drive.end_spot), reach_m, |name, disc| {
            let (other, needs_m) = (there.whose[name].0, own_m + disc.radius_m + BESIDE_M);
            if other != robot && self.spot(other) == drive.end_spot && (disc.at - at).norm() < needs_m {
                room_m = room_m.max(needs_m);
            }
        });
        if room_m == 0.0 || back.norm() <= room_m {
            return end;
        }
        let beside = Vector2::new(end.x, end.y) + back.normalize() * room_m;
        Pose::new(beside.x, beside.y, end.yaw)
    }

    /// Lets the time since the latest step pass for one robot alone, if it is steered.
    pub(crate) fn catch_up(&mut self, robot: Entity) {
        let now = self.now;
        let Some(mut steered) = self.find_mut::<Steered>(robot) else { return };
        if steered.mover.is_moving() {
            let passes = now - steered.since;
            steered.mover.advance(passes, &[]);
            let mut whereabouts = self.get_mut::<Whereabouts>(robot);
            *whereabouts = steered.whereabouts(&whereabouts);
        }
        steered.since = now;
    }

    pub(crate) fn level_of(&self, spot: Spot) -> usize {
        self.map.at(spot.last_place()).level.0
    }

    /// Notes where all bodies are now.
    fn lay_out(&mut self, there: &mut Surroundings) {
        let (now, found) = (self.now, &mut there.found);
        found.clear();
        for (robot, footprint, whereabouts, steered) in
            self.each::<(Entity, &Footprint, &Whereabouts, Option<&Steered>)>()
        {
            let at = match steered {
                Some(steered) => steered.mover.position(),
                None => Vector3::new(whereabouts.pose(now).x, whereabouts.pose(now).y, 0.0),
            };
            let moves = steered.is_some_and(|steered| steered.mover.is_moving());
            found.push((robot, Disc { at, radius_m: footprint.0, level: 0 }, whereabouts.spot(now), moves));
        }
        // Who is in a lift is in nobody's way.
        found.retain(|(_, _, spot, _)| !matches!(spot, Spot::Lift { .. }));
        let map = &self.map;
        let level = |spot: Spot| map.at(spot.last_place()).level.0;
        let discs = found.iter().map(|(_, disc, spot, _)| Disc { level: level(*spot), ..*disc });
        there.bodies.lay_out(discs, CELL_M);
        there.whose.clear();
        there.whose.extend(found.iter().map(|(robot, _, _, moves)| (*robot, *moves)));
    }
}

/// About how long a robot takes for a distance.
fn about(kinematics: &Kinematics, speed_mps: f64, distance_m: f64) -> f64 {
    let acceleration = kinematics.acceleration_mps2();
    let ramp = Ramp { speed_mps, acceleration_mps2: acceleration, deceleration_mps2: acceleration };
    StraightRun::new(distance_m, ramp).duration_s()
}

fn isometry(pose: Pose) -> Isometry2<f64> {
    Isometry2::new(Vector2::new(pose.x, pose.y), pose.yaw)
}
