//! Driving, or flying, as a chassis does: robots that were given kinematics.
//!
//! Which way a goal leads is decided as for those that drive in straight lines ([`Driving`]); how it is driven, by a
//! [`Mover`]. When that arrives is not known before: while any of them moves the world steps.

use super::driving::Driving;
use crate::kinematics::{Kinematics, Mover, Neighbour, Ramp, StraightRun};
use crate::space::{Bodies, Disc};
use crate::world::World;
use crate::world::components::{Beside, Body, Departures};
use crate::world::floor::Floor;
use crate::world::setup::{RobotBody, WorldSetup};
use crate::world::system::{Kind, LATER, System, kinds};
use crate::world::whereabouts::{Drive, Spot, Whereabouts};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, Feedback, Goal};
use hecs::Entity;
use nalgebra::{Isometry2, Vector2, Vector3};

/// A robot with kinematics.
pub(crate) struct Steered {
    pub(crate) mover: Mover,
    /// The instant at which the mover is.
    since: f64,
    /// What it is on its way to.
    course: Option<Drive>,
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
        let mut kinds = Driving.reads();
        kinds.extend(kinds![Body]);
        kinds
    }

    fn writes(&self) -> Vec<Kind> {
        let mut kinds = Driving.writes();
        kinds.extend(kinds![Steered, Footprint, Surroundings, Whereabouts, Departures, Beside]);
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
            floor.give(robot, Steered { mover, since: floor.now, course: None, level });
            if floor.find::<Departures>(robot).is_none() {
                floor.give(robot, Departures(0));
            }
        }
    }

    fn begin(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        floor.find::<Steered>(robot)?;
        let begun = Driving.begin(floor, robot, goal)?;
        Some(begun.map(|ends| if floor.set_course(robot) { LATER } else { ends }))
    }

    fn finish(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        let course = floor.get_mut::<Steered>(robot).course.take();
        let Some(course) = course else { return Driving.finish(floor, robot, goal) };
        let pose = floor.get::<Whereabouts>(robot).pose(floor.now);
        *floor.get_mut::<Whereabouts>(robot) = Whereabouts::Standing { spot: course.end_spot, pose };
        Ok(())
    }

    fn halt(&self, floor: &mut Floor, robot: Entity, goal: &Goal) {
        floor.catch_up(robot);
        let course = floor.get_mut::<Steered>(robot).course.take();
        if course.is_none() {
            return Driving.halt(floor, robot, goal);
        }
        floor.get_mut::<Steered>(robot).mover.halt();
        floor.step_on();
    }

    fn feedback(&self, floor: &Floor, robot: Entity, _goal: &Goal, usual: Feedback) -> Feedback {
        let (steered, body) = (floor.get::<Steered>(robot), floor.get::<Body>(robot));
        let left_m = steered.mover.remaining_m();
        let expected_s = body.0.kinematics.map_or(0.0, |kinematics| about(&kinematics, body.0.speed.get(), left_m));
        Feedback {
            distance_remaining: Metres::new(left_m).unwrap_or(Metres::ZERO),
            time_remaining: Seconds::new(expected_s).unwrap_or(usual.time_remaining),
        }
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
            if steered.mover.advance(now - steered.since, &there.around).is_some() && steered.course.is_some() {
                there.arrived.push(robot);
            }
            steered.since = now;
            goes_on |= steered.mover.is_moving();
            *whereabouts = steered.whereabouts(whereabouts);
        }
        for robot in there.arrived.drain(..) {
            floor.achieve(robot);
        }
        floor.lay_out(&mut there);
        *floor.own_mut::<Surroundings>() = there;
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
            (Some(course), _) => course.spot_with(self.mover.remaining_m()),
            (None, Whereabouts::Standing { spot, .. }) => *spot,
            (None, Whereabouts::Driving(drive)) => drive.start_spot,
        };
        Whereabouts::Standing { spot, pose }
    }

    fn pose(&self) -> Pose {
        let pose = self.mover.pose();
        Pose::new(pose.translation.x, pose.translation.y, pose.rotation.angle())
    }
}

impl Drive {
    /// Where one stands who has so many metres of this drive left.
    fn spot_with(&self, remaining_m: f64) -> Spot {
        let share = if self.length_m > 0.0 { (1.0 - remaining_m / self.length_m).clamp(0.0, 1.0) } else { 0.0 };
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
    /// Turns the straight line that has just been planned into a course to steer; false if there is none to steer.
    fn set_course(&mut self, robot: Entity) -> bool {
        let Whereabouts::Driving(drive) = *self.get::<Whereabouts>(robot) else { return false };
        *self.get_mut::<Whereabouts>(robot) = Whereabouts::Standing { spot: drive.start_spot, pose: drive.start_pose };
        self.catch_up(robot);
        if !self.is_stepping() {
            let mut there = std::mem::take(&mut *self.own_mut::<Surroundings>());
            self.lay_out(&mut there);
            *self.own_mut::<Surroundings>() = there;
        }
        let (target, level) = (isometry(self.beside_others(robot, &drive)), self.level_of(drive.start_spot));
        let mut steered = self.get_mut::<Steered>(robot);
        steered.mover.aim(target);
        (steered.course, steered.level) = (Some(drive), level);
        drop(steered);
        self.step_on();
        true
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

    /// Lets the time since the latest step pass for one robot alone.
    fn catch_up(&mut self, robot: Entity) {
        let now = self.now;
        let mut steered = self.get_mut::<Steered>(robot);
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
