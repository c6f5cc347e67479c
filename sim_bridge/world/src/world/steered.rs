//! Robots that drive or fly with kinematics: their components, and their drives.

use super::components::SimRobot;
use super::location::{MapPosition, RobotLocation, StraightDrive};
use super::setup::RobotSetup;
use super::sim_state::SimState;
use super::simulation::World;
use crate::kinematics::{KinematicModel, Kinematics, Neighbour, ProfileLimits, TrapezoidProfile};
use crate::space::{BodyGrid, Disc, NearBody};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use hecs::Entity;
use nalgebra::{Isometry2, Vector2, Vector3};
use std::collections::BTreeSet;

/// A robot with kinematics. Between two steps its motion is changed by
/// [`SimState::change_steered`], so that the next step notes it.
pub(crate) struct Steered {
    pub(crate) model: KinematicModel,
    /// Time up to which the model is integrated.
    pub(super) since: f64,
    /// The current part of the drive, as a straight line.
    pub(super) part: Option<StraightDrive>,
    /// Remaining distance at which to notify [`driving`](super::systems::driving), in metres.
    pub(super) notify_at_m: Option<f64>,
    /// Current level.
    pub(super) level: usize,
}

/// The body of a robot.
pub(crate) struct Footprint {
    /// Number of the body in the [`BodyIndex`].
    pub(crate) number: usize,
    pub(crate) radius_m: f64,
}

/// Positions of all bodies as of the latest step. A step only reads the components of robots that
/// move, that have been changed since, or that have no kinematics: all others are where they were.
pub(crate) struct BodyIndex {
    pub(crate) bodies: BodyGrid,
    /// Robot of each body, by the number of the body.
    pub(crate) owners: Vec<Entity>,
    /// Whether each robot moves with its kinematics, by the number of the body.
    pub(crate) moving: Vec<bool>,
    /// Robots without kinematics. Their positions are functions of time.
    unsteered: Vec<Entity>,
    /// Robots with kinematics that have been moved, pushed, started or stopped since the latest step.
    pub(super) changed: BTreeSet<Entity>,
    /// Scratch space, reused between steps.
    pub(super) placements: Vec<Placement>,
    pub(super) arrived: Vec<Entity>,
    pub(super) passed: Vec<Entity>,
}

/// Position of a body now.
pub(super) struct Placement {
    pub(super) number: usize,
    pub(super) at: Vector3<f64>,
    pub(super) position: MapPosition,
    pub(super) moves: bool,
}

/// Bodies around a robot; scratch space, reused between robots.
#[derive(Default)]
pub(super) struct Neighbourhood {
    found: Vec<NearBody>,
    pub(super) neighbours: Vec<Neighbour>,
}

/// Cell size of the body grid: about the distance at which drones consider others.
const CELL_M: f64 = 2.0;
/// Clearance to another robot that stands at the target, in metres.
const CLEARANCE_M: f64 = 0.1;

impl Steered {
    /// Applies a push. If the robot stood still until now, its integration starts now.
    pub(crate) fn push(&mut self, by: Vector3<f64>, now: f64) {
        if !self.model.is_moving() {
            self.since = now;
        }
        self.model.push(by);
    }

    /// Returns the current location, from the previous location.
    pub(super) fn location(&self, before: &RobotLocation) -> RobotLocation {
        let pose = self.pose();
        let position = match (&self.part, before) {
            (Some(part), _) => part.position_at(&pose),
            (None, RobotLocation::Standing { position, .. }) => *position,
            (None, RobotLocation::Driving(drive)) => drive.start_position,
        };
        RobotLocation::Standing { position, pose }
    }

    /// Remaining distance of the current part, in metres.
    pub(super) fn remaining_m(&self) -> f64 {
        self.part.map_or(0.0, |part| part.length_m() * (1.0 - part.share_at(&self.pose())))
    }

    pub(super) fn pose(&self) -> Pose {
        let pose = self.model.pose();
        Pose::new(pose.translation.x, pose.translation.y, pose.rotation.angle())
    }
}

impl StraightDrive {
    /// Returns the share of the line that is covered, from 0 to 1, for a position next to it.
    fn share_at(&self, at: &Pose) -> f64 {
        let (start, end) = (&self.start_pose, &self.end_pose);
        let along = Vector2::new(end.x - start.x, end.y - start.y);
        let length_2 = along.norm_squared();
        if length_2 > 0.0 {
            (along.dot(&Vector2::new(at.x - start.x, at.y - start.y)) / length_2).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }

    /// Returns the map position for a position next to the line that is not known to be its end.
    fn position_at(&self, at: &Pose) -> MapPosition {
        let share = self.share_at(at);
        match self.lane {
            _ if share <= 0.0 => self.start_position,
            Some((from, to, first, last)) => MapPosition::Lane { from, to, share: first + (last - first) * share },
            None => MapPosition::Floor { near: self.start_position.last_place() },
        }
    }
}

impl Default for BodyIndex {
    fn default() -> BodyIndex {
        BodyIndex {
            bodies: BodyGrid::new(CELL_M),
            owners: Vec::new(),
            moving: Vec::new(),
            unsteered: Vec::new(),
            changed: BTreeSet::new(),
            placements: Vec::new(),
            arrived: Vec::new(),
            passed: Vec::new(),
        }
    }
}

impl BodyIndex {
    /// Adds the body of a robot and returns its number.
    pub(super) fn add(&mut self, robot: Entity, radius_m: f64, is_steered: bool) -> usize {
        self.owners.push(robot);
        self.moving.push(false);
        self.bodies.add(Disc { at: Vector3::zeros(), radius_m, level: Disc::NO_LEVEL });
        if is_steered {
            self.changed.insert(robot);
        } else {
            self.unsteered.push(robot);
        }
        self.owners.len() - 1
    }

    /// Collects the bodies that a robot, which has the body `number`, must avoid.
    pub(super) fn collect_neighbours(&self, number: usize, steered: &Steered, around: &mut Neighbourhood) {
        around.neighbours.clear();
        let Some(reach_m) = steered.model.neighbour_range_m(self.bodies.max_radius_m()) else { return };
        let at = steered.model.position();
        self.bodies.collect_near(&at, steered.level, reach_m, &mut around.found);
        let others = around.found.iter().map(|near| near.number()).filter(|other| *other != number);
        around.neighbours.extend(others.map(|other| {
            let disc = self.bodies.disc(other);
            Neighbour { offset: disc.at - at, radius_m: disc.radius_m }
        }));
    }
}

impl World {
    /// Reads the kinematic model of a robot as of the latest step; `None` for a robot without
    /// kinematics or an unknown robot.
    pub(crate) fn with_kinematic_model<T>(
        &self,
        robot: &RobotId,
        read: impl FnOnce(&KinematicModel) -> T,
    ) -> Option<T> {
        let robot = *self.state.robots.get(robot)?;
        self.state.find::<Steered>(robot).map(|steered| read(&steered.model))
    }
}

impl SimState {
    /// Checks whether a robot is moving now.
    pub(crate) fn is_moving(&self, robot: Entity) -> bool {
        let drives = match &*self.get::<RobotLocation>(robot) {
            RobotLocation::Standing { .. } => false,
            RobotLocation::Driving(drive) => drive.end_time() > self.now,
        };
        drives || self.find::<Steered>(robot).is_some_and(|steered| steered.model.is_moving())
    }

    pub(crate) fn map_position(&self, robot: Entity) -> MapPosition {
        self.get::<RobotLocation>(robot).map_position(self.now)
    }

    /// Checks whether a robot has kinematics.
    pub(crate) fn is_steered(&self, robot: Entity) -> bool {
        self.find::<Steered>(robot).is_some()
    }

    /// Drives a steered robot along a straight line with its kinematics. At the end
    /// [`SimState::on_steered_arrival`] is called. If the target is unchanged, the robot just
    /// continues.
    pub(crate) fn steer(&mut self, robot: Entity, part: StraightDrive, speed_mps: f64) {
        let under_way = self.get::<Steered>(robot).part;
        if under_way
            .is_some_and(|current| current.end_pose == part.end_pose && current.end_position == part.end_position)
        {
            return;
        }
        self.advance_steered(robot);
        if !self.is_stepping() {
            let mut index = std::mem::take(&mut *self.resource_mut::<BodyIndex>());
            self.refresh_index(&mut index);
            *self.resource_mut::<BodyIndex>() = index;
        }
        let (target, level) = (isometry(self.end_pose_beside(robot, &part)), self.level_of(part.start_position));
        self.change_steered(robot, |steered| {
            steered.model.set_max_speed(speed_mps);
            if part.backward {
                steered.model.set_target_backward(target);
            } else {
                steered.model.set_target(target);
            }
            (steered.part, steered.level) = (Some(part), level);
        });
        self.start_stepping();
    }

    /// Changes the motion of a steered robot between two steps. Returns false for a robot without
    /// kinematics.
    pub(crate) fn change_steered(&self, robot: Entity, change: impl FnOnce(&mut Steered)) -> bool {
        let Some(mut steered) = self.find_mut::<Steered>(robot) else { return false };
        if !steered.model.is_moving() {
            steered.since = self.now; // time has no effect on a robot at rest
        }
        change(&mut steered);
        self.resource_mut::<BodyIndex>().changed.insert(robot);
        true
    }

    /// Requests a call of [`SimState::on_steered_door_passed`] when `remaining_m` metres of the
    /// current part remain.
    pub(crate) fn notify_when_remaining(&self, robot: Entity, remaining_m: Option<f64>) {
        self.get_mut::<Steered>(robot).notify_at_m = remaining_m;
    }

    /// Ends the drive of a steered robot, which brakes.
    pub(crate) fn brake(&mut self, robot: Entity) {
        self.advance_steered(robot);
        let under_way = self.find::<Steered>(robot).is_some_and(|steered| steered.part.is_some());
        if under_way {
            self.change_steered(robot, |steered| {
                steered.part = None;
                steered.model.brake();
            });
            self.start_stepping();
        }
    }

    /// Creates the kinematic model of a robot at standstill.
    pub(crate) fn kinematic_model(&self, kinematics: &Kinematics, body: &RobotSetup, pose: Pose) -> KinematicModel {
        KinematicModel::new(kinematics, body.speed.get(), body.radius_m, isometry(pose), self.own_chassis)
    }

    /// Moves a robot to another position at once.
    pub(crate) fn place_robot(&mut self, robot: Entity, position: MapPosition, pose: Pose) {
        *self.get_mut::<RobotLocation>(robot) = RobotLocation::Standing { position, pose };
        let level = self.level_of(position);
        let body = &self.get::<SimRobot>(robot).0;
        if let Some(kinematics) = &body.kinematics {
            let model = self.kinematic_model(kinematics, body, pose);
            let placed = Steered { model, since: self.now, part: None, notify_at_m: None, level };
            self.change_steered(robot, |steered| *steered = placed);
        }
    }

    /// Remaining distance of a steered robot's current part, by its position on the map, in metres.
    pub(crate) fn steered_remaining_m(&self, robot: Entity) -> f64 {
        self.find::<Steered>(robot).map_or(0.0, |steered| steered.remaining_m())
    }

    /// Remaining driving distance of a steered robot's current part, with an estimated time.
    pub(crate) fn steered_remaining(&self, robot: Entity, speed_mps: f64) -> (f64, f64) {
        let remaining_m = self.find::<Steered>(robot).map_or(0.0, |steered| steered.model.remaining_m());
        let kinematics = &self.get::<SimRobot>(robot).0.kinematics;
        let time_s = kinematics.as_ref().map_or(0.0, |kinematics| estimated_time_s(kinematics, speed_mps, remaining_m));
        (remaining_m, time_s)
    }

    /// Returns the end of a drive: its target, or a point before a robot that stands there.
    fn end_pose_beside(&self, robot: Entity, drive: &StraightDrive) -> Pose {
        let (start, end) = (drive.start_pose, drive.end_pose);
        let back = Vector2::new(start.x - end.x, start.y - end.y);
        let (index, own_m) = (self.resource::<BodyIndex>(), self.get::<Footprint>(robot).radius_m);
        let (at, reach_m) = (Vector3::new(end.x, end.y, 0.0), own_m + index.bodies.max_radius_m() + CLEARANCE_M);
        let mut room_m: f64 = 0.0;
        index.bodies.for_each_near(&at, self.level_of(drive.end_position), reach_m, |name, disc| {
            let (other, needs_m) = (index.owners[name], own_m + disc.radius_m + CLEARANCE_M);
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

    /// Integrates the motion of a single steered robot up to now.
    pub(crate) fn advance_steered(&mut self, robot: Entity) {
        let now = self.now;
        let Some(mut steered) = self.find_mut::<Steered>(robot) else { return };
        if steered.model.is_moving() {
            let elapsed_s = now - steered.since;
            steered.model.advance(elapsed_s, &[]);
            let mut location = self.get_mut::<RobotLocation>(robot);
            *location = steered.location(&location);
            self.resource_mut::<BodyIndex>().changed.insert(robot);
        }
        steered.since = now;
    }

    pub(crate) fn level_of(&self, position: MapPosition) -> usize {
        self.map.place_at(position.last_place()).level.0
    }

    /// Brings the body index up to the current positions. `index.placements` contains those of the
    /// robots that the step has moved.
    pub(super) fn refresh_index(&mut self, index: &mut BodyIndex) {
        let mut placements = std::mem::take(&mut index.placements);
        placements.extend(std::mem::take(&mut index.changed).into_iter().map(|robot| self.placement(robot)));
        placements.extend(index.unsteered.iter().map(|robot| self.placement(*robot)));
        for Placement { number, at, position, moves } in placements.drain(..) {
            let in_lift = matches!(position, MapPosition::Lift { .. });
            let level = if in_lift { Disc::NO_LEVEL } else { self.level_of(position) };
            index.bodies.place(number, at, level);
            index.moving[number] = moves;
        }
        index.bodies.refresh();
        index.placements = placements;
    }

    fn placement(&self, robot: Entity) -> Placement {
        let (location, number) = (self.get::<RobotLocation>(robot), self.get::<Footprint>(robot).number);
        let (at, moves) = match self.find::<Steered>(robot) {
            Some(steered) => (steered.model.position(), steered.model.is_moving()),
            None => {
                let pose = location.pose(self.now);
                (Vector3::new(pose.x, pose.y, 0.0), false)
            }
        };
        Placement { number, at, position: location.map_position(self.now), moves }
    }
}

/// Estimates the time for a distance.
fn estimated_time_s(kinematics: &Kinematics, speed_mps: f64, distance_m: f64) -> f64 {
    let acceleration = kinematics.acceleration_mps2();
    let ramp = ProfileLimits { speed_mps, acceleration_mps2: acceleration, deceleration_mps2: acceleration };
    TrapezoidProfile::new(distance_m, ramp).duration_s()
}

pub(super) fn isometry(pose: Pose) -> Isometry2<f64> {
    Isometry2::new(Vector2::new(pose.x, pose.y), pose.yaw)
}
