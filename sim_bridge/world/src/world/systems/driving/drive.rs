//! A drive: its legs, from part to part, to the arrival.

use super::task::{DriveTask, Stage};
use crate::world::components::{CoPresence, DepartureCount};
use crate::world::drive_progress::{DoorStop, DriveProgress, LENGTH_EPSILON_M};
use crate::world::event::WorldEvent;
use crate::world::location::RobotLocation;
use crate::world::routing::{DriveTarget, LegPlan};
use crate::world::sim_state::SimState;
use crate::world::systems::doors::DoorState;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, Feedback};
use hecs::Entity;

impl SimState {
    /// Sets the target of a robot, if there is a route. A robot in a lift drives there after it
    /// gets out.
    pub(super) fn set_target(&mut self, robot: Entity, target: DriveTarget) -> Result<(), ActionError> {
        let in_lift = matches!(self.get::<DriveTask>(robot).stage, Stage::InLift);
        if in_lift {
            target.place.as_ref().map(|place| self.destination(place, target.pose)).transpose()?;
        } else {
            let plan = self.plan_leg(robot, &target)?;
            self.start_leg(robot, plan);
        }
        self.get_mut::<DriveTask>(robot).target = Some(target);
        Ok(())
    }

    /// Ends the drive with its goal: the robot stops where it is and no longer waits.
    pub(super) fn end_drive(&mut self, robot: Entity) {
        {
            let mut task = self.get_mut::<DriveTask>(robot);
            task.target = None;
            task.next_targets.clear();
        }
        match self.take_stage(robot) {
            Stage::Idle => {}
            Stage::Driving(_) => self.stop_robot(robot),
            Stage::AtDoor(_, door) => {
                let door = self.get::<DoorState>(door).name.clone();
                self.log_event(WorldEvent::DoorLeft { robot: self.robot_id(robot), door });
            }
            Stage::AtLift(to) => {
                let at = self.map.place_at(self.map_position(robot).last_place()).id.clone();
                let lift = self.lift_between(&at, &self.map.place_at(to).id).unwrap_or_default();
                self.log_event(WorldEvent::LiftLeft { robot: self.robot_id(robot), lift, at });
            }
            stage @ Stage::InLift => self.get_mut::<DriveTask>(robot).stage = stage,
        }
    }

    /// Starts a drive, or waits for a lift. A robot that departs loses its co-presence.
    fn start_leg(&mut self, robot: Entity, plan: LegPlan) {
        match plan {
            LegPlan::Drive(drive, speed_mps) => {
                if drive.length_m() > 0.0 {
                    self.depart(robot);
                }
                let progress = DriveProgress::new(drive, speed_mps, self);
                let doorway = self.get::<DriveTask>(robot).doorway.filter(|door| !progress.passes_door(*door));
                if let Some(door) = doorway {
                    self.leave_doorway(robot, door);
                }
                self.proceed(robot, progress, true);
            }
            LegPlan::Ride { lift, from, to } => {
                self.get_mut::<DriveTask>(robot).stage = Stage::AtLift(to);
                let [at, to] = [from, to].map(|place| self.map.place_at(place).id.clone());
                self.log_event(WorldEvent::LiftRequested { robot: self.robot_id(robot), lift, at, to });
            }
        }
    }

    pub(super) fn depart(&self, robot: Entity) {
        if let Some(mut beside) = self.find_mut::<CoPresence>(robot) {
            *beside = CoPresence::None;
        }
        self.get_mut::<DepartureCount>(robot).0 += 1;
    }

    /// Performs the door actions at the robot's position, and drives on.
    pub(super) fn proceed(&mut self, robot: Entity, mut progress: DriveProgress, is_new: bool) {
        while let Some(stop) = progress.current_stop() {
            let doorway = self.get::<DriveTask>(robot).doorway;
            match stop {
                DoorStop::Enter(door) if doorway != Some(door) => return self.wait_at_door(robot, progress, door),
                DoorStop::Enter(_) => {}
                DoorStop::Leave(door) => self.leave_doorway(robot, door),
            }
            progress.finish_stop();
        }
        if progress.is_complete() && !is_new {
            self.get_mut::<DriveTask>(robot).stage = Stage::Driving(progress);
            return self.on_arrival(robot);
        }
        let obstacle = self.obstacle_ahead(&progress);
        if let Some((_, event)) = obstacle.as_ref().filter(|(at, _)| *at <= progress.done_m + LENGTH_EPSILON_M) {
            return self.give_up(robot, &progress, &format!("{event} is in the way"));
        }
        self.drive_part(robot, progress, obstacle.map(|(at, _)| at));
    }

    /// Handles the end of the current part of the drive.
    pub(super) fn finish_part(&mut self, robot: Entity, mut progress: DriveProgress) {
        progress.done_m = progress.until_m;
        self.proceed(robot, progress, false);
    }

    /// Drives to the next door action or obstacle.
    fn drive_part(&mut self, robot: Entity, mut progress: DriveProgress, obstacle_m: Option<f64>) {
        let steered = self.is_steered(robot);
        let stop_m = if steered { progress.next_wait_m() } else { progress.next_stop_m() };
        progress.until_m = stop_m.min(obstacle_m.unwrap_or(f64::INFINITY));
        let part = progress.drive.segment(progress.done_m, progress.until_m, self.now, progress.speed_mps);
        if steered {
            self.steer(robot, part, progress.speed_mps);
            self.get_mut::<DriveTask>(robot).stage = Stage::Driving(progress);
            return self.watch_next_door(robot);
        }
        *self.get_mut::<RobotLocation>(robot) = RobotLocation::Driving(part);
        let timer = self.schedule(part.end_time(), robot, 0);
        let mut task = self.get_mut::<DriveTask>(robot);
        (task.stage, task.timer) = (Stage::Driving(progress), Some(timer));
    }

    /// Handles the arrival of a steered robot at the end of the current part.
    pub(crate) fn on_steered_arrival(&mut self, robot: Entity) {
        if !matches!(self.get::<DriveTask>(robot).stage, Stage::Driving(_)) {
            return; // it had already reached the end when the obstacles were rechecked, and waits at a door
        }
        if let Stage::Driving(progress) = self.take_stage(robot) {
            self.finish_part(robot, progress);
        }
    }

    /// Handles arrival at the target: drives to the next target, or completes the goal.
    pub(super) fn on_arrival(&mut self, robot: Entity) {
        let next = self.get_mut::<DriveTask>(robot).next_targets.pop_front();
        let Some(next) = next else { return self.complete_goal(robot) };
        drop(self.take_stage(robot));
        self.stop_robot(robot);
        self.continue_to(robot, &next);
        self.get_mut::<DriveTask>(robot).target = Some(next);
    }

    pub(super) fn continue_to(&mut self, robot: Entity, target: &DriveTarget) {
        match self.plan_leg(robot, target) {
            Ok(plan) => self.start_leg(robot, plan),
            Err(error) => self.abort_goal(robot, error),
        }
    }

    /// Takes the stage of a robot's drive, leaves `Idle` in its place, and cancels its timer.
    pub(super) fn take_stage(&mut self, robot: Entity) -> Stage {
        let (stage, timer) = {
            let mut task = self.get_mut::<DriveTask>(robot);
            (std::mem::replace(&mut task.stage, Stage::Idle), task.timer.take())
        };
        timer.into_iter().for_each(|timer| self.queue.cancel(timer));
        stage
    }

    pub(super) fn stop_at(&self, robot: Entity, progress: &DriveProgress) {
        let here = progress.drive.segment(progress.done_m, progress.done_m, self.now, progress.speed_mps);
        // A steered robot stops only near the point.
        let pose = if self.is_steered(robot) { self.get::<RobotLocation>(robot).pose(self.now) } else { here.end_pose };
        *self.get_mut::<RobotLocation>(robot) = RobotLocation::Standing { position: here.end_position, pose };
    }

    /// Stops a robot at its current position; a steered robot brakes.
    pub(super) fn stop_robot(&mut self, robot: Entity) {
        self.brake(robot);
        let mut location = self.get_mut::<RobotLocation>(robot);
        *location =
            RobotLocation::Standing { position: location.map_position(self.now), pose: location.pose(self.now) };
    }

    /// Returns the remaining distance and time as far as the robot can estimate them, without
    /// waiting times at doors and lifts.
    pub(super) fn remaining_feedback(&self, robot: Entity) -> Option<Feedback> {
        let task = self.get::<DriveTask>(robot);
        let (progress, left_m, left_s) = match (&task.stage, &*self.get::<RobotLocation>(robot)) {
            (Stage::Driving(progress), RobotLocation::Driving(part)) => {
                (progress, part.remaining(self.now).get(), (part.end_time() - self.now).max(0.0))
            }
            (Stage::Driving(progress), RobotLocation::Standing { .. }) => {
                let (left_m, left_s) = self.steered_remaining(robot, progress.speed_mps);
                (progress, left_m, left_s)
            }
            (Stage::AtDoor(progress, _), _) => (progress, 0.0, 0.0),
            (Stage::Idle | Stage::AtLift(_) | Stage::InLift, _) => return None,
        };
        let reached_m = if matches!(task.stage, Stage::Driving(_)) { progress.until_m } else { progress.done_m };
        let beyond_m = progress.drive.length_m() - reached_m;
        Some(Feedback::remaining(
            Metres::new(left_m + beyond_m).unwrap_or(Metres::ZERO),
            Seconds::new(left_s + beyond_m / progress.speed_mps).unwrap_or(Seconds::ZERO),
        ))
    }
}
