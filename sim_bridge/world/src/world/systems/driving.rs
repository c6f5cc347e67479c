//! Driving to a pose in a straight line, at the robot's speed or the lane's limit, equally fast in
//! every direction; and riding lifts between places without a lane.
//!
//! A position is computed from the last departure, and the next point of interest is an entry in
//! the queue, so a driving robot costs nothing. Robots may pass through each other. Doors, lifts
//! and obstacles stop them. There are none of these off the lanes.
//!
//! A robot with kinematics takes the same routes, but [`steering`](super::steering) drives each
//! part and reports its end. It stops only where it may have to wait.
//!
//! ```text
//!  begin ─▶ driving ─▶ at a door ─▶ driving ─▶ … ─▶ complete          at a lift ─▶ in the lift ─▶ complete
//!              └─▶ obstacle: blocked                                                   └─▶ the next target
//! ```

use crate::map::PlaceIndex;
use crate::world::components::{CoPresence, DepartureCount, SimRobot};
use crate::world::drive_progress::{DoorStop, DriveProgress, LENGTH_EPSILON_M, OBSTACLE_DETECTION_M};
use crate::world::event_log::WorldEvent;
use crate::world::event_queue::TimerId;
use crate::world::location::{MapPosition, RobotLocation};
use crate::world::preconditions::action_error;
use crate::world::routing::{DriveTarget, LegPlan};
use crate::world::setup::RobotSetup;
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, END_UNKNOWN, System, SystemTimer, component_types};
use crate::world::systems::doors::{DoorState, DoorsByName};
use crate::world::systems::lifts::LiftsByName;
use crate::world::systems::obstacles::{ActiveObstacles, KnownClosures};
use crate::world::systems::steering::{BodyIndex, Footprint, Steered};
use consort_protocol::ids::RobotId;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, ErrorCode, Feedback, Goal, GoalProgress};
use hecs::Entity;
use std::collections::VecDeque;

/// Progress of a robot's drive, apart from its location.
pub(crate) struct DriveTask {
    /// Target of the active goal.
    target: Option<DriveTarget>,
    /// Later targets.
    next_targets: VecDeque<DriveTarget>,
    stage: Stage,
    timer: Option<TimerId>,
    /// The doorway that the robot is in.
    doorway: Option<Entity>,
}

enum Stage {
    /// No drive.
    Idle,
    Driving(DriveProgress),
    AtDoor(DriveProgress, Entity),
    AtLift(PlaceIndex),
    /// Until the lift arrives, even if the goal ends.
    InLift,
}

/// See the [module](self).
pub(crate) struct Driving;

impl System for Driving {
    fn name(&self) -> &'static str {
        "driving"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot, DoorState, DoorsByName, ActiveObstacles, LiftsByName, Footprint]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![RobotLocation, DepartureCount, CoPresence, DriveTask, KnownClosures, Steered, BodyIndex]
    }

    fn init_robot(&self, state: &mut SimState, robot: Entity, _body: &RobotSetup) {
        state.insert(robot, DepartureCount(0));
        state.insert(
            robot,
            DriveTask { target: None, next_targets: VecDeque::new(), stage: Stage::Idle, timer: None, doorway: None },
        );
    }

    fn begin_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let mut targets: VecDeque<DriveTarget> = match goal {
            Goal::NavigateToPose { pose, place } => [DriveTarget { pose: *pose, place: place.clone() }].into(),
            Goal::FollowWaypoints { waypoints } => waypoints.iter().map(DriveTarget::from).collect(),
            _ => return None,
        };
        let Some(first) = targets.pop_front() else {
            return Some(Err(action_error(ErrorCode::Unknown, "there are no waypoints to follow".to_owned())));
        };
        state.advance_steered(robot);
        Some(state.set_target(robot, first).map(|()| {
            state.get_mut::<DriveTask>(robot).next_targets = targets;
            END_UNKNOWN
        }))
    }

    fn finish_goal(&self, state: &mut SimState, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        state.end_drive(robot);
        Ok(())
    }

    fn halt_goal(&self, state: &mut SimState, robot: Entity, _goal: &Goal) {
        state.end_drive(robot);
    }

    fn feedback(&self, state: &SimState, robot: Entity, goal: &Goal, usual: Feedback) -> Feedback {
        let progress = match goal {
            Goal::FollowWaypoints { waypoints } => {
                let remaining = state.get::<DriveTask>(robot).next_targets.len();
                GoalProgress::Waypoint(u32::try_from(waypoints.len().saturating_sub(remaining + 1)).unwrap_or(u32::MAX))
            }
            _ => GoalProgress::Unspecified,
        };
        Feedback { progress, ..state.remaining_feedback(robot).unwrap_or(usual) }
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { entity: robot, .. }: SystemTimer) {
        state.get_mut::<DriveTask>(robot).timer = None;
        match state.take_stage(robot) {
            Stage::Driving(progress) => state.finish_part(robot, progress),
            Stage::AtDoor(progress, door) => state.on_door_timeout(robot, progress, door),
            stage @ (Stage::Idle | Stage::AtLift(_) | Stage::InLift) => {
                state.get_mut::<DriveTask>(robot).stage = stage;
            }
        }
    }

    fn on_event(&self, state: &mut SimState, event: &WorldEvent) {
        let entity_of = |robot: &RobotId| state.robots.get(robot).copied();
        match event {
            WorldEvent::DoorEntered { robot, .. } => {
                if let Some(robot) = entity_of(robot) {
                    state.enter_doorway(robot);
                }
            }
            WorldEvent::LiftEntered { robot, .. } => {
                if let Some(robot) = entity_of(robot) {
                    state.enter_lift(robot);
                }
            }
            WorldEvent::LiftLeft { robot, at, .. } => {
                if let Some((robot, at)) = entity_of(robot).zip(state.map.index(at)) {
                    state.leave_lift(robot, at);
                }
            }
            WorldEvent::LaneBlocked { .. } | WorldEvent::LaneCleared { .. } => state.recheck_obstacles(),
            _ => {}
        }
    }
}

impl SimState {
    /// Sets the target of a robot, if there is a route. A robot in a lift drives there after it
    /// gets out.
    fn set_target(&mut self, robot: Entity, target: DriveTarget) -> Result<(), ActionError> {
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
    fn end_drive(&mut self, robot: Entity) {
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

    fn depart(&self, robot: Entity) {
        if let Some(mut beside) = self.find_mut::<CoPresence>(robot) {
            *beside = CoPresence::None;
        }
        self.get_mut::<DepartureCount>(robot).0 += 1;
    }

    /// Performs the door actions at the robot's position, and drives on.
    fn proceed(&mut self, robot: Entity, mut progress: DriveProgress, is_new: bool) {
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
    fn finish_part(&mut self, robot: Entity, mut progress: DriveProgress) {
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
    fn watch_next_door(&self, robot: Entity) {
        if let Stage::Driving(progress) = &self.get::<DriveTask>(robot).stage {
            let past_m = progress.next_stop_m();
            self.notify_when_remaining(robot, (past_m < progress.until_m).then_some(progress.until_m - past_m));
        }
    }

    /// Returns the first obstacle ahead, with the distance at which the robot stops before it.
    fn obstacle_ahead(&self, progress: &DriveProgress) -> Option<(f64, String)> {
        let (from, to, first, last) = progress.drive.lane?;
        let ahead = self.obstacles_on(from, to).into_iter().filter_map(|(share, event)| {
            let at = (share - first) / (last - first) * progress.drive.length_m();
            let ahead = at + LENGTH_EPSILON_M >= progress.done_m && at <= progress.drive.length_m() + LENGTH_EPSILON_M;
            ahead.then(|| ((at - OBSTACLE_DETECTION_M).max(progress.done_m), event))
        });
        ahead.min_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)))
    }

    /// Stops before an obstacle: aborts the goal and remembers the lane as blocked.
    fn give_up(&mut self, robot: Entity, progress: &DriveProgress, error: &str) {
        self.stop_robot(robot);
        let Some((from, to, first, last)) = progress.drive.lane else { return };
        self.remember_closure(robot, from, to);
        let (from, to) = if last >= first { (from, to) } else { (to, from) };
        let message =
            format!("the lane from {} to {} is blocked: {error}", self.map.place_at(from).id, self.map.place_at(to).id);
        self.abort_goal(robot, action_error(ErrorCode::Blocked, message));
    }

    fn wait_at_door(&mut self, robot: Entity, progress: DriveProgress, door: Entity) {
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
    fn on_door_timeout(&mut self, robot: Entity, progress: DriveProgress, door: Entity) {
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

    fn enter_doorway(&mut self, robot: Entity) {
        match self.take_stage(robot) {
            Stage::AtDoor(mut progress, door) => {
                progress.finish_stop();
                self.get_mut::<DriveTask>(robot).doorway = Some(door);
                self.proceed(robot, progress, false);
            }
            stage => self.get_mut::<DriveTask>(robot).stage = stage,
        }
    }

    fn leave_doorway(&mut self, robot: Entity, door: Entity) {
        self.get_mut::<DriveTask>(robot).doorway = None;
        let door = self.get::<DoorState>(door).name.clone();
        self.log_event(WorldEvent::DoorLeft { robot: self.robot_id(robot), door });
    }

    fn enter_lift(&mut self, robot: Entity) {
        let Stage::AtLift(to) = self.get::<DriveTask>(robot).stage else { return };
        self.depart(robot);
        self.get_mut::<DriveTask>(robot).stage = Stage::InLift;
        self.place_robot(robot, MapPosition::Lift { to }, self.map.place_at(to).pose);
    }

    fn leave_lift(&mut self, robot: Entity, at: PlaceIndex) {
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

    /// Handles arrival at the target: drives to the next target, or completes the goal.
    fn on_arrival(&mut self, robot: Entity) {
        let next = self.get_mut::<DriveTask>(robot).next_targets.pop_front();
        let Some(next) = next else { return self.complete_goal(robot) };
        drop(self.take_stage(robot));
        self.stop_robot(robot);
        self.continue_to(robot, &next);
        self.get_mut::<DriveTask>(robot).target = Some(next);
    }

    fn continue_to(&mut self, robot: Entity, target: &DriveTarget) {
        match self.plan_leg(robot, target) {
            Ok(plan) => self.start_leg(robot, plan),
            Err(error) => self.abort_goal(robot, error),
        }
    }

    /// Re-evaluates the obstacles ahead of every driving robot, after an obstacle appeared or
    /// disappeared.
    fn recheck_obstacles(&mut self) {
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

    /// Takes the stage of a robot's drive, leaves `Idle` in its place, and cancels its timer.
    fn take_stage(&mut self, robot: Entity) -> Stage {
        let (stage, timer) = {
            let mut task = self.get_mut::<DriveTask>(robot);
            (std::mem::replace(&mut task.stage, Stage::Idle), task.timer.take())
        };
        timer.into_iter().for_each(|timer| self.queue.cancel(timer));
        stage
    }

    fn stop_at(&self, robot: Entity, progress: &DriveProgress) {
        let here = progress.drive.segment(progress.done_m, progress.done_m, self.now, progress.speed_mps);
        // A steered robot stops only near the point.
        let pose = if self.is_steered(robot) { self.get::<RobotLocation>(robot).pose(self.now) } else { here.end_pose };
        *self.get_mut::<RobotLocation>(robot) = RobotLocation::Standing { position: here.end_position, pose };
    }

    /// Stops a robot at its current position; a steered robot brakes.
    fn stop_robot(&mut self, robot: Entity) {
        self.brake(robot);
        let mut location = self.get_mut::<RobotLocation>(robot);
        *location =
            RobotLocation::Standing { position: location.map_position(self.now), pose: location.pose(self.now) };
    }

    /// Returns the remaining distance and time as far as the robot can estimate them, without
    /// waiting times at doors and lifts.
    fn remaining_feedback(&self, robot: Entity) -> Option<Feedback> {
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
