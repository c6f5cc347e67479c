//! Doors, lifts and obstacles on the way of a drive.

use super::task::{DriveTask, Stage};
use crate::map::PlaceIndex;
use crate::world::drive_progress::{DriveProgress, LENGTH_EPSILON_M, OBSTACLE_DETECTION_M};
use crate::world::event::WorldEvent;
use crate::world::location::{MapPosition, RobotLocation};
use crate::world::preconditions::action_error;
use crate::world::sim_state::SimState;
use crate::world::systems::doors::DoorState;
use consort_skills::actions::ErrorCode;
use hecs::Entity;

impl SimState {
    /// Handles a steered robot's passage through a door.
    pub(crate) fn on_steered_door_passed(&mut self, robot: Entity) {
        let passed = match &mut self.get_mut::<DriveTask>(robot).stage {
            Stage::Driving(progress) => progress.leave_door(),
            Stage::Idle | Stage::AtDoor(..) | Stage::AtLift(_) | Stage::InLift => None,
        };
        if let Some(door) = passed {
            self.leave_doorway(robot, door);
        }
        self.watch_next_door(robot);
    }

    /// Requests a notification when a steered robot has passed the next door, if that is before the
    /// end of the current part.
    pub(super) fn watch_next_door(&self, robot: Entity) {
        if let Stage::Driving(progress) = &self.get::<DriveTask>(robot).stage {
            let past_m = progress.next_stop_m();
            self.notify_when_remaining(robot, (past_m < progress.until_m).then_some(progress.until_m - past_m));
        }
    }

    /// Returns the first obstacle ahead, with the distance at which the robot stops before it.
    pub(super) fn obstacle_ahead(&self, progress: &DriveProgress) -> Option<(f64, String)> {
        let (from, to, first, last) = progress.drive.lane?;
        let ahead = self.obstacles_on(from, to).into_iter().filter_map(|(share, event)| {
            let at = (share - first) / (last - first) * progress.drive.length_m();
            let ahead = at + LENGTH_EPSILON_M >= progress.done_m && at <= progress.drive.length_m() + LENGTH_EPSILON_M;
            ahead.then(|| ((at - OBSTACLE_DETECTION_M).max(progress.done_m), event))
        });
        ahead.min_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)))
    }

    /// Stops before an obstacle: aborts the goal and remembers the lane as blocked.
    pub(super) fn give_up(&mut self, robot: Entity, progress: &DriveProgress, error: &str) {
        self.stop_robot(robot);
        let Some((from, to, first, last)) = progress.drive.lane else { return };
        self.remember_closure(robot, from, to);
        let (from, to) = if last >= first { (from, to) } else { (to, from) };
        let message =
            format!("the lane from {} to {} is blocked: {error}", self.map.place_at(from).id, self.map.place_at(to).id);
        self.abort_goal(robot, action_error(ErrorCode::Blocked, message));
    }

    pub(super) fn wait_at_door(&mut self, robot: Entity, progress: DriveProgress, door: Entity) {
        self.stop_at(robot, &progress);
        let timer = self.schedule(self.now + self.durations.door_timeout_s, robot, 0);
        {
            let mut task = self.get_mut::<DriveTask>(robot);
            (task.stage, task.timer) = (Stage::AtDoor(progress, door), Some(timer));
        }
        let door = self.get::<DoorState>(door).name.clone();
        self.log_event(WorldEvent::DoorRequested { robot: self.robot_id(robot), door });
    }

    /// Handles the timeout at a door: if the door has admitted no robot for that time, the robot
    /// gives up.
    pub(super) fn on_door_timeout(&mut self, robot: Entity, progress: DriveProgress, door: Entity) {
        let (name, until) = {
            let doorway = self.get::<DoorState>(door);
            (doorway.name.clone(), doorway.last_entry_time + self.durations.door_timeout_s)
        };
        if until > self.now {
            let timer = self.schedule(until, robot, 0);
            let mut task = self.get_mut::<DriveTask>(robot);
            (task.stage, task.timer) = (Stage::AtDoor(progress, door), Some(timer));
            return;
        }
        self.give_up(robot, &progress, &format!("{name} admitted no robot for {} s", self.durations.door_timeout_s));
        self.log_event(WorldEvent::DoorLeft { robot: self.robot_id(robot), door: name });
    }

    pub(super) fn enter_doorway(&mut self, robot: Entity) {
        match self.take_stage(robot) {
            Stage::AtDoor(mut progress, door) => {
                progress.finish_stop();
                self.get_mut::<DriveTask>(robot).doorway = Some(door);
                self.proceed(robot, progress, false);
            }
            stage => self.get_mut::<DriveTask>(robot).stage = stage,
        }
    }

    pub(super) fn leave_doorway(&mut self, robot: Entity, door: Entity) {
        self.get_mut::<DriveTask>(robot).doorway = None;
        let door = self.get::<DoorState>(door).name.clone();
        self.log_event(WorldEvent::DoorLeft { robot: self.robot_id(robot), door });
    }

    pub(super) fn enter_lift(&mut self, robot: Entity) {
        let Stage::AtLift(to) = self.get::<DriveTask>(robot).stage else { return };
        self.depart(robot);
        self.get_mut::<DriveTask>(robot).stage = Stage::InLift;
        self.place_robot(robot, MapPosition::Lift { to }, self.map.place_at(to).pose);
    }

    pub(super) fn leave_lift(&mut self, robot: Entity, at: PlaceIndex) {
        if !matches!(self.get::<DriveTask>(robot).stage, Stage::InLift) {
            return;
        }
        self.place_robot(robot, MapPosition::Place(at), self.map.place_at(at).pose);
        let target = {
            let mut task = self.get_mut::<DriveTask>(robot);
            task.stage = Stage::Idle;
            task.target.clone()
        };
        let Some(target) = target else { return };
        if target.place.as_ref() == Some(&self.map.place_at(at).id) {
            return self.on_arrival(robot);
        }
        self.continue_to(robot, &target);
    }

    /// Re-evaluates the obstacles ahead of every driving robot, after an obstacle appeared or
    /// disappeared.
    pub(super) fn recheck_obstacles(&mut self) {
        let robots: Vec<Entity> = self.robots.values().copied().collect();
        for robot in robots {
            let is_driving = matches!(&self.get::<DriveTask>(robot).stage, Stage::Driving(progress) if progress.drive.lane.is_some());
            if !is_driving {
                continue;
            }
            let left_m = match &*self.get::<RobotLocation>(robot) {
                RobotLocation::Driving(part) => part.remaining(self.now).get(),
                RobotLocation::Standing { .. } => self.steered_remaining_m(robot),
            };
            let Stage::Driving(mut progress) = self.take_stage(robot) else { continue };
            progress.done_m = progress.until_m - left_m;
            self.proceed(robot, progress, true);
        }
    }
}
