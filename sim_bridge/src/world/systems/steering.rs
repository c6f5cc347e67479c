//! Driving, or flying, as a chassis does: robots that were given kinematics.
//!
//! Which way a goal leads, and where to stand on it and wait, is decided as for those that drive in straight lines
//! ([`Driving`]); how each part of it is driven, by a [`Mover`]. When that arrives is not known before: while any of them
//! moves the world steps.

use super::driving::Driving;
use crate::kinematics::{KinematicModel, Kinematics, Neighbour, ProfileLimits, TrapezoidProfile};
use crate::space::{BodyGrid, Disc};
use crate::world::World;
use crate::world::components::SimRobot;
use crate::world::location::{MapPosition, RobotLocation, StraightDrive};
use crate::world::setup::{RobotSetup, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, SystemTimer, kinds};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use hecs::Entity;
use nalgebra::{Isometry2, Vector2, Vector3};

/// A robot with kinematics.
pub(crate) struct Steered {
    pub(crate) model: KinematicModel,
    /// The instant at which the mover is.
    since: f64,
    /// The part of its way that is under way: what it would be along a straight line.
    course: Option<StraightDrive>,
    /// When so much of it is left, there is something to do without a stop.
    watched_m: Option<f64>,
    /// The level that it is on.
    level: usize,
}

/// What a robot takes up: from its middle to its outermost part, in metres.
pub(crate) struct Footprint(pub(crate) f64);

/// What is where, as of the latest step.
#[derive(Default)]
pub(crate) struct BodyIndex {
    pub(crate) bodies: BodyGrid,
    /// Whose body is whose, by their names among the bodies, and whether it moves in steps.
    pub(crate) owners: Vec<(Entity, bool)>,
    /// Room to work in, kept from step to step.
    found: Vec<(Entity, Disc, MapPosition, bool)>,
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

    fn reads(&self) -> Vec<ComponentType> {
        Driving.reads()
    }

    fn writes(&self) -> Vec<ComponentType> {
        let mut kinds = Driving.writes();
        kinds.extend(kinds![Footprint]);
        kinds
    }

    fn init_world(&self, floor: &mut SimState, _setup: &WorldSetup) {
        floor.insert_resource(BodyIndex::default());
    }

    fn init_robot(&self, floor: &mut SimState, robot: Entity, body: &RobotSetup) {
        floor.insert(robot, Footprint(body.radius_m));
        if let Some(kinematics) = &body.kinematics {
            let pose = isometry(floor.get::<RobotLocation>(robot).pose(floor.now));
            let mover = KinematicModel::new(kinematics, body.speed.get(), body.radius_m, pose);
            let level = floor.level_of(floor.map_position(robot));
            floor.insert(robot, Steered { model: mover, since: floor.now, course: None, watched_m: None, level });
        }
    }

    fn on_timer(&self, floor: &mut SimState, on_timer: SystemTimer) {
        Driving.on_timer(floor, on_timer);
    }

    fn step(&self, floor: &mut SimState) -> bool {
        let mut there = std::mem::take(&mut *floor.resource_mut::<BodyIndex>());
        let mut goes_on = false;
        let now = floor.now;
        for (robot, steered, whereabouts) in floor.query::<(Entity, &mut Steered, &mut RobotLocation)>() {
            if !steered.model.is_moving() {
                steered.since = now;
                continue;
            }
            there.look_around(robot, steered);
            let arrives = steered.model.advance(now - steered.since, &there.around).is_some();
            steered.since = now;
            goes_on |= steered.model.is_moving();
            *whereabouts = steered.whereabouts(whereabouts);
            if arrives && let Some(course) = steered.course.take() {
                *whereabouts = RobotLocation::Standing { position: course.end_position, pose: steered.pose() };
                there.arrived.push(robot);
            } else if steered.watched_m.is_some_and(|watched_m| steered.left_m() <= watched_m) {
                steered.watched_m = None;
                there.passed.push(robot);
            }
        }
        floor.lay_out(&mut there);
        let (mut arrived, mut passed) = (std::mem::take(&mut there.arrived), std::mem::take(&mut there.passed));
        *floor.resource_mut::<BodyIndex>() = there;
        passed.drain(..).for_each(|robot| floor.on_steered_door_passed(robot));
        arrived.drain(..).for_each(|robot| floor.on_steered_arrival(robot));
        let mut there = floor.resource_mut::<BodyIndex>();
        (there.arrived, there.passed) = (arrived, passed);
        goes_on
    }
}

impl Steered {
    /// Something pushes it now. If it stood until now, nothing has happened to it since the latest step.
    pub(crate) fn push(&mut self, by: Vector3<f64>, now: f64) {
        if !self.model.is_moving() {
            self.since = now;
        }
        self.model.push(by);
    }

    /// Where it is now, given where it was.
    fn whereabouts(&self, before: &RobotLocation) -> RobotLocation {
        let pose = self.pose();
        let spot = match (&self.course, before) {
            (Some(course), _) => course.spot_beside(&self.pose()),
            (None, RobotLocation::Standing { position: spot, .. }) => *spot,
            (None, RobotLocation::Driving(drive)) => drive.start_position,
        };
        RobotLocation::Standing { position: spot, pose }
    }

    /// How much of the part of its way that is under way is left, in metres.
    fn left_m(&self) -> f64 {
        self.course.map_or(0.0, |course| course.length_m() * (1.0 - course.share_beside(&self.pose())))
    }

    fn pose(&self) -> Pose {
        let pose = self.model.pose();
        Pose::new(pose.translation.x, pose.translation.y, pose.rotation.angle())
    }
}

impl StraightDrive {
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
    fn spot_beside(&self, at: &Pose) -> MapPosition {
        let share = self.share_beside(at);
        match self.lane {
            _ if share <= 0.0 => self.start_position,
            Some((from, to, first, last)) => MapPosition::Lane { from, to, share: first + (last - first) * share },
            None => MapPosition::Floor { near: self.start_position.last_place() },
        }
    }
}

impl BodyIndex {
    /// Collects whom a robot has to make way for.
    fn look_around(&mut self, robot: Entity, steered: &Steered) {
        self.around.clear();
        let Some(reach_m) = steered.model.neighbour_range_m(self.bodies.max_radius_m()) else { return };
        let (at, level) = (steered.model.position(), steered.level);
        let (around, whose) = (&mut self.around, &self.owners);
        self.bodies.for_each_near(&at, level, reach_m, |name, disc| {
            if whose[name].0 != robot {
                around.push(Neighbour { offset: disc.at - at, radius_m: disc.radius_m });
            }
        });
    }
}

impl World {
    /// How a robot with kinematics moves, as of the latest step; none for one without, or that is not here.
    pub fn kinematic_model(&self, robot: &RobotId) -> Option<KinematicModel> {
        let robot = *self.state.robots.get(robot)?;
        self.state.find::<Steered>(robot).map(|steered| steered.model)
    }
}

impl SimState {
    /// Whether a robot is steered.
    pub(crate) fn is_steered(&self, robot: Entity) -> bool {
        self.find::<Steered>(robot).is_some()
    }

    /// Has a robot that is steered drive a straight line as its chassis does; [`Floor::steered_there`] is said once it is
    /// at the end. If that is where it is on its way to already, it just goes on.
    pub(crate) fn steer(&mut self, robot: Entity, part: StraightDrive, speed_mps: f64) {
        let under_way = self.get::<Steered>(robot).course;
        if under_way.is_some_and(|course| course.end_pose == part.end_pose && course.end_position == part.end_position)
        {
            return;
        }
        self.advance_steered(robot);
        if !self.is_stepping() {
            let mut there = std::mem::take(&mut *self.resource_mut::<BodyIndex>());
            self.lay_out(&mut there);
            *self.resource_mut::<BodyIndex>() = there;
        }
        let (target, level) = (isometry(self.beside_others(robot, &part)), self.level_of(part.start_position));
        let mut steered = self.get_mut::<Steered>(robot);
        steered.model.set_max_speed(speed_mps);
        if part.backward {
            steered.model.set_target_backward(target);
        } else {
            steered.model.set_target(target);
        }
        (steered.course, steered.level) = (Some(part), level);
        drop(steered);
        self.start_stepping();
    }

    /// Has [`Floor::steered_past`] said when so many metres are left of what a robot drives.
    pub(crate) fn notify_when_remaining(&self, robot: Entity, left_m: Option<f64>) {
        self.get_mut::<Steered>(robot).watched_m = left_m;
    }

    /// If a robot is steered and under way, it no longer is, and brakes.
    pub(crate) fn brake(&mut self, robot: Entity) {
        self.advance_steered(robot);
        let under_way = self.find_mut::<Steered>(robot).is_some_and(|mut steered| steered.course.take().is_some());
        if under_way {
            self.get_mut::<Steered>(robot).model.brake();
            self.start_stepping();
        }
    }

    /// Puts a robot somewhere else.
    pub(crate) fn place_robot(&mut self, robot: Entity, spot: MapPosition, pose: Pose) {
        *self.get_mut::<RobotLocation>(robot) = RobotLocation::Standing { position: spot, pose };
        let level = self.level_of(spot);
        let body = &self.get::<SimRobot>(robot).0;
        if let (Some(kinematics), Some(mut steered)) = (&body.kinematics, self.find_mut::<Steered>(robot)) {
            let mover = KinematicModel::new(kinematics, body.speed.get(), body.radius_m, isometry(pose));
            *steered = Steered { model: mover, since: self.now, course: None, watched_m: None, level };
        }
    }

    /// How much of the part of its way is left that a robot is on, as far as its place on the map goes, in metres.
    pub(crate) fn steered_remaining_m(&self, robot: Entity) -> f64 {
        self.find::<Steered>(robot).map_or(0.0, |steered| steered.left_m())
    }

    /// How far it still has to drive on the part of its way that it is on, and about how long that takes.
    pub(crate) fn steered_remaining(&self, robot: Entity, speed_mps: f64) -> (f64, f64) {
        let left_m = self.find::<Steered>(robot).map_or(0.0, |steered| steered.model.remaining_m());
        let kinematics = self.get::<SimRobot>(robot).0.kinematics;
        (left_m, kinematics.map_or(0.0, |kinematics| about(&kinematics, speed_mps, left_m)))
    }

    /// Where a drive is to end: where it was sent, or this side of whoever stands there.
    fn beside_others(&self, robot: Entity, drive: &StraightDrive) -> Pose {
        let (start, end) = (drive.start_pose, drive.end_pose);
        let back = Vector2::new(start.x - end.x, start.y - end.y);
        let (there, own_m) = (self.resource::<BodyIndex>(), self.get::<Footprint>(robot).0);
        let (at, reach_m) = (Vector3::new(end.x, end.y, 0.0), own_m + there.bodies.max_radius_m() + BESIDE_M);
        let mut room_m: f64 = 0.0;
        there.bodies.for_each_near(&at, self.level_of(drive.end_position), reach_m, |name, disc| {
            let (other, needs_m) = (there.owners[name].0, own_m + disc.radius_m + BESIDE_M);
            if other != robot && self.map_position(other) == drive.end_position && (disc.at - at).norm() < needs_m {
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
    pub(crate) fn advance_steered(&mut self, robot: Entity) {
        let now = self.now;
        let Some(mut steered) = self.find_mut::<Steered>(robot) else { return };
        if steered.model.is_moving() {
            let passes = now - steered.since;
            steered.model.advance(passes, &[]);
            let mut whereabouts = self.get_mut::<RobotLocation>(robot);
            *whereabouts = steered.whereabouts(&whereabouts);
        }
        steered.since = now;
    }

    pub(crate) fn level_of(&self, spot: MapPosition) -> usize {
        self.map.place_at(spot.last_place()).level.0
    }

    /// Notes where all bodies are now.
    fn lay_out(&mut self, there: &mut BodyIndex) {
        let (now, found) = (self.now, &mut there.found);
        found.clear();
        for (robot, footprint, whereabouts, steered) in
            self.query::<(Entity, &Footprint, &RobotLocation, Option<&Steered>)>()
        {
            let at = match steered {
                Some(steered) => steered.model.position(),
                None => Vector3::new(whereabouts.pose(now).x, whereabouts.pose(now).y, 0.0),
            };
            let moves = steered.is_some_and(|steered| steered.model.is_moving());
            found.push((robot, Disc { at, radius_m: footprint.0, level: 0 }, whereabouts.map_position(now), moves));
        }
        // Who is in a lift is in nobody's way.
        found.retain(|(_, _, spot, _)| !matches!(spot, MapPosition::Lift { .. }));
        let map = &self.map;
        let level = |spot: MapPosition| map.place_at(spot.last_place()).level.0;
        let discs = found.iter().map(|(_, disc, spot, _)| Disc { level: level(*spot), ..*disc });
        there.bodies.rebuild(discs, CELL_M);
        there.owners.clear();
        there.owners.extend(found.iter().map(|(robot, _, _, moves)| (*robot, *moves)));
    }
}

/// About how long a robot takes for a distance.
fn about(kinematics: &Kinematics, speed_mps: f64, distance_m: f64) -> f64 {
    let acceleration = kinematics.acceleration_mps2();
    let ramp = ProfileLimits { speed_mps, acceleration_mps2: acceleration, deceleration_mps2: acceleration };
    TrapezoidProfile::new(distance_m, ramp).duration_s()
}

fn isometry(pose: Pose) -> Isometry2<f64> {
    Isometry2::new(Vector2::new(pose.x, pose.y), pose.yaw)
}
