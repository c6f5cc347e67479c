//! Driving to a pose: a straight line at the robot's own speed or the lane's limit, the same in every direction; and riding
//! lifts, where the map has one and no lane.
//!
//! Its position is computed from when it last set off, and where it next has something to do is an entry in the queue: a
//! robot under way costs nothing. Robots may pass through one another; what holds them up are doors, lifts, and what stands
//! in the way. Off the lanes there are none of these.
//!
//! A robot with kinematics has the same journeys, but each part of one is driven by [`steering`](super::steering), which
//! says when it is there. It stops only where it may have to stand.
//!
//! ```text
//!  begin ─▶ rolling ─▶ at a door ─▶ rolling ─▶ … ─▶ achieved          at a lift ─▶ in the lift ─▶ achieved
//!              └─▶ something in the way: blocked                                        └─▶ the next errand
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
use crate::world::system::{ComponentType, END_UNKNOWN, System, SystemTimer, kinds};
use crate::world::systems::doors::{DoorState, DoorsByName};
use crate::world::systems::lifts::LiftsByName;
use crate::world::systems::obstacles::{ActiveObstacles, KnownClosures};
use crate::world::systems::steering::{BodyIndex, Footprint, Steered};
use consort_protocol::ids::RobotId;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, ErrorCode, Feedback, Goal, GoalProgress};
use hecs::Entity;
use std::collections::VecDeque;

/// How far a robot's drive has come, beside where it is.
pub(crate) struct Journey {
    /// Where it is to go, while a goal says so.
    errand: Option<DriveTarget>,
    /// Where it is to go then.
    afterwards: VecDeque<DriveTarget>,
    stage: Stage,
    wake: Option<TimerId>,
    /// The doorway that it is in.
    inside: Option<Entity>,
}

enum Stage {
    /// It goes nowhere.
    Idle,
    Rolling(DriveProgress),
    AtDoor(DriveProgress, Entity),
    AtLift(PlaceIndex),
    /// Until the lift lets it out, whatever becomes of the goal.
    InLift,
}

/// See the [module](self).
pub(crate) struct Driving;

impl System for Driving {
    fn name(&self) -> &'static str {
        "driving"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![SimRobot, DoorState, DoorsByName, ActiveObstacles, LiftsByName, Footprint]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![RobotLocation, DepartureCount, CoPresence, Journey, KnownClosures, Steered, BodyIndex]
    }

    fn init_robot(&self, floor: &mut SimState, robot: Entity, _body: &RobotSetup) {
        floor.insert(robot, DepartureCount(0));
        floor.insert(
            robot,
            Journey { errand: None, afterwards: VecDeque::new(), stage: Stage::Idle, wake: None, inside: None },
        );
    }

    fn begin_goal(&self, floor: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let mut errands: VecDeque<DriveTarget> = match goal {
            Goal::NavigateToPose { pose, place } => [DriveTarget { pose: *pose, place: place.clone() }].into(),
            Goal::FollowWaypoints { waypoints } => waypoints.iter().map(DriveTarget::from).collect(),
            _ => return None,
        };
        let Some(first) = errands.pop_front() else {
            return Some(Err(action_error(ErrorCode::Unknown, "there are no waypoints to follow".to_owned())));
        };
        floor.advance_steered(robot);
        Some(floor.set_errand(robot, first).map(|()| {
            floor.get_mut::<Journey>(robot).afterwards = errands;
            END_UNKNOWN
        }))
    }

    fn finish_goal(&self, floor: &mut SimState, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        floor.drop_errand(robot);
        Ok(())
    }

    fn halt_goal(&self, floor: &mut SimState, robot: Entity, _goal: &Goal) {
        floor.drop_errand(robot);
    }

    fn feedback(&self, floor: &SimState, robot: Entity, goal: &Goal, usual: Feedback) -> Feedback {
        let progress = match goal {
            Goal::FollowWaypoints { waypoints } => {
                let to_come = floor.get::<Journey>(robot).afterwards.len();
                GoalProgress::Waypoint(u32::try_from(waypoints.len().saturating_sub(to_come + 1)).unwrap_or(u32::MAX))
            }
            _ => GoalProgress::Unspecified,
        };
        Feedback { progress, ..floor.journey_left(robot).unwrap_or(usual) }
    }

    fn on_timer(&self, floor: &mut SimState, SystemTimer { entity: robot, .. }: SystemTimer) {
        floor.get_mut::<Journey>(robot).wake = None;
        match floor.take_stage(robot) {
            Stage::Rolling(course) => floor.part_ends(robot, course),
            Stage::AtDoor(course, door) => floor.lose_patience(robot, course, door),
            stage @ (Stage::Idle | Stage::AtLift(_) | Stage::InLift) => {
                floor.get_mut::<Journey>(robot).stage = stage;
            }
        }
    }

    fn on_event(&self, floor: &mut SimState, what: &WorldEvent) {
        let known = |robot: &RobotId| floor.robots.get(robot).copied();
        match what {
            WorldEvent::DoorEntered { robot, .. } => {
                if let Some(robot) = known(robot) {
                    floor.enter_doorway(robot);
                }
            }
            WorldEvent::LiftEntered { robot, .. } => {
                if let Some(robot) = known(robot) {
                    floor.enter_lift(robot);
                }
            }
            WorldEvent::LiftLeft { robot, at, .. } => {
                if let Some((robot, at)) = known(robot).zip(floor.map.index(at)) {
                    floor.leave_lift(robot, at);
                }
            }
            WorldEvent::LaneBlocked { .. } | WorldEvent::LaneCleared { .. } => floor.look_ahead_again(),
            _ => {}
        }
    }
}

impl SimState {
    /// Sends a robot somewhere, if there is a way. One in a lift goes there once it gets out.
    fn set_errand(&mut self, robot: Entity, errand: DriveTarget) -> Result<(), ActionError> {
        let in_lift = matches!(self.get::<Journey>(robot).stage, Stage::InLift);
        if in_lift {
            errand.place.as_ref().map(|place| self.destination(place, errand.pose)).transpose()?;
        } else {
            let way = self.plan_leg(robot, &errand)?;
            self.set_off(robot, way);
        }
        self.get_mut::<Journey>(robot).errand = Some(errand);
        Ok(())
    }

    /// The goal is over: the robot stands still where it is, and waits for nothing any longer.
    fn drop_errand(&mut self, robot: Entity) {
        {
            let mut journey = self.get_mut::<Journey>(robot);
            journey.errand = None;
            journey.afterwards.clear();
        }
        match self.take_stage(robot) {
            Stage::Idle => {}
            Stage::Rolling(_) => self.stand_still(robot),
            Stage::AtDoor(_, door) => {
                let door = self.get::<DoorState>(door).name.clone();
                self.log_event(WorldEvent::DoorLeft { robot: self.robot_id(robot), door });
            }
            Stage::AtLift(to) => {
                let at = self.map.place_at(self.map_position(robot).last_place()).id.clone();
                let lift = self.lift_between(&at, &self.map.place_at(to).id).unwrap_or_default();
                self.log_event(WorldEvent::LiftLeft { robot: self.robot_id(robot), lift, at });
            }
            stage @ Stage::InLift => self.get_mut::<Journey>(robot).stage = stage,
        }
    }

    /// Sets a robot in motion, or has it wait for a lift. Whoever it was beside, it is no longer once it moves.
    fn set_off(&mut self, robot: Entity, way: LegPlan) {
        match way {
            LegPlan::Drive(drive, speed_mps) => {
                if drive.length_m() > 0.0 {
                    self.depart(robot);
                }
                let course = DriveProgress::new(drive, speed_mps, self);
                let inside = self.get::<Journey>(robot).inside.filter(|door| !course.passes_door(*door));
                if let Some(door) = inside {
                    self.leave_doorway(robot, door);
                }
                self.proceed(robot, course, true);
            }
            LegPlan::Ride { lift, from, to } => {
                self.get_mut::<Journey>(robot).stage = Stage::AtLift(to);
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

    /// Does what there is to do where a robot has come to, and rolls on from there.
    fn proceed(&mut self, robot: Entity, mut course: DriveProgress, fresh: bool) {
        while let Some(stop) = course.current_stop() {
            let inside = self.get::<Journey>(robot).inside;
            match stop {
                DoorStop::Enter(door) if inside != Some(door) => return self.wait_at(robot, course, door),
                DoorStop::Enter(_) => {}
                DoorStop::Leave(door) => self.leave_doorway(robot, door),
            }
            course.finish_stop();
        }
        if course.is_complete() && !fresh {
            self.get_mut::<Journey>(robot).stage = Stage::Rolling(course);
            return self.arrived(robot);
        }
        let seen = self.seen_ahead(&course);
        if let Some((_, what)) = seen.as_ref().filter(|(at, _)| *at <= course.done_m + LENGTH_EPSILON_M) {
            return self.give_up(robot, &course, &format!("{what} stands in it"));
        }
        self.roll(robot, course, seen.map(|(at, _)| at));
    }

    /// It has come to the end of the part of its way that was under way.
    fn part_ends(&mut self, robot: Entity, mut course: DriveProgress) {
        course.done_m = course.until_m;
        self.proceed(robot, course, false);
    }

    /// Rolls to where there is something to do next.
    fn roll(&mut self, robot: Entity, mut course: DriveProgress, seen_m: Option<f64>) {
        let steered = self.is_steered(robot);
        let stop_m = if steered { course.next_wait_m() } else { course.next_stop_m() };
        course.until_m = stop_m.min(seen_m.unwrap_or(f64::INFINITY));
        let part = course.drive.segment(course.done_m, course.until_m, self.now, course.speed_mps);
        if steered {
            self.steer(robot, part, course.speed_mps);
            self.get_mut::<Journey>(robot).stage = Stage::Rolling(course);
            return self.watch_for_doors(robot);
        }
        *self.get_mut::<RobotLocation>(robot) = RobotLocation::Driving(part);
        let wake = self.schedule(part.end_time(), robot, 0);
        let mut journey = self.get_mut::<Journey>(robot);
        (journey.stage, journey.wake) = (Stage::Rolling(course), Some(wake));
    }

    /// A robot that is steered is at the end of the part of its way that was under way.
    pub(crate) fn on_steered_arrival(&mut self, robot: Entity) {
        if !matches!(self.get::<Journey>(robot).stage, Stage::Rolling(_)) {
            return; // it was beside the end before, looked ahead again there, and waits at a door already
        }
        if let Stage::Rolling(course) = self.take_stage(robot) {
            self.part_ends(robot, course);
        }
    }

    /// A robot that is steered is past a door.
    pub(crate) fn on_steered_door_passed(&mut self, robot: Entity) {
        let passed = match &mut self.get_mut::<Journey>(robot).stage {
            Stage::Rolling(course) => course.leave_door(),
            Stage::Idle | Stage::AtDoor(..) | Stage::AtLift(_) | Stage::InLift => None,
        };
        if let Some(door) = passed {
            self.leave_doorway(robot, door);
        }
        self.watch_for_doors(robot);
    }

    /// Has it said when a robot that is steered is past the next door, if that is before the end of this part of its way.
    fn watch_for_doors(&self, robot: Entity) {
        if let Stage::Rolling(course) = &self.get::<Journey>(robot).stage {
            let past_m = course.next_stop_m();
            self.notify_when_remaining(robot, (past_m < course.until_m).then_some(course.until_m - past_m));
        }
    }

    /// What stands in the way ahead, and how far along a robot stops before it: the first thing it comes to.
    fn seen_ahead(&self, course: &DriveProgress) -> Option<(f64, String)> {
        let (from, to, first, last) = course.drive.lane?;
        let ahead = self.obstacles_on(from, to).into_iter().filter_map(|(share, what)| {
            let at = (share - first) / (last - first) * course.drive.length_m();
            let ahead = at + LENGTH_EPSILON_M >= course.done_m && at <= course.drive.length_m() + LENGTH_EPSILON_M;
            ahead.then(|| ((at - OBSTACLE_DETECTION_M).max(course.done_m), what))
        });
        ahead.min_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)))
    }

    /// Stands before what is in the way: the goal cannot go on, and the robot knows that this way is closed.
    fn give_up(&mut self, robot: Entity, course: &DriveProgress, why: &str) {
        self.stand_still(robot);
        let Some((from, to, first, last)) = course.drive.lane else { return };
        self.remember_closure(robot, from, to);
        let (from, to) = if last >= first { (from, to) } else { (to, from) };
        let message =
            format!("the way from {} to {} is blocked: {why}", self.map.place_at(from).id, self.map.place_at(to).id);
        self.abort_goal(robot, action_error(ErrorCode::Blocked, message));
    }

    fn wait_at(&mut self, robot: Entity, course: DriveProgress, door: Entity) {
        self.stand_at(robot, &course);
        let wake = self.schedule(self.now + self.durations.door_patience_s, robot, 0);
        {
            let mut journey = self.get_mut::<Journey>(robot);
            (journey.stage, journey.wake) = (Stage::AtDoor(course, door), Some(wake));
        }
        let door = self.get::<DoorState>(door).name.clone();
        self.log_event(WorldEvent::DoorRequested { robot: self.robot_id(robot), door });
    }

    /// It has waited for long; if the door lets nobody in, it does so no longer.
    fn lose_patience(&mut self, robot: Entity, course: DriveProgress, door: Entity) {
        let (name, until) = {
            let doorway = self.get::<DoorState>(door);
            (doorway.name.clone(), doorway.last_entry_time + self.durations.door_patience_s)
        };
        if until > self.now {
            let wake = self.schedule(until, robot, 0);
            let mut journey = self.get_mut::<Journey>(robot);
            (journey.stage, journey.wake) = (Stage::AtDoor(course, door), Some(wake));
            return;
        }
        self.give_up(robot, &course, &format!("{name} let nobody in for {} s", self.durations.door_patience_s));
        self.log_event(WorldEvent::DoorLeft { robot: self.robot_id(robot), door: name });
    }

    fn enter_doorway(&mut self, robot: Entity) {
        match self.take_stage(robot) {
            Stage::AtDoor(mut course, door) => {
                course.finish_stop();
                self.get_mut::<Journey>(robot).inside = Some(door);
                self.proceed(robot, course, false);
            }
            stage => self.get_mut::<Journey>(robot).stage = stage,
        }
    }

    fn leave_doorway(&mut self, robot: Entity, door: Entity) {
        self.get_mut::<Journey>(robot).inside = None;
        let door = self.get::<DoorState>(door).name.clone();
        self.log_event(WorldEvent::DoorLeft { robot: self.robot_id(robot), door });
    }

    fn enter_lift(&mut self, robot: Entity) {
        let Stage::AtLift(to) = self.get::<Journey>(robot).stage else { return };
        self.depart(robot);
        self.get_mut::<Journey>(robot).stage = Stage::InLift;
        self.place_robot(robot, MapPosition::Lift { to }, self.map.place_at(to).pose);
    }

    fn leave_lift(&mut self, robot: Entity, at: PlaceIndex) {
        if !matches!(self.get::<Journey>(robot).stage, Stage::InLift) {
            return;
        }
        self.place_robot(robot, MapPosition::Place(at), self.map.place_at(at).pose);
        let errand = {
            let mut journey = self.get_mut::<Journey>(robot);
            journey.stage = Stage::Idle;
            journey.errand.clone()
        };
        let Some(errand) = errand else { return };
        if errand.place.as_ref() == Some(&self.map.place_at(at).id) {
            return self.arrived(robot);
        }
        self.go_on(robot, &errand);
    }

    /// It is where it was to go: it goes where it is to go then, or its goal has come to its end.
    fn arrived(&mut self, robot: Entity) {
        let next = self.get_mut::<Journey>(robot).afterwards.pop_front();
        let Some(next) = next else { return self.complete_goal(robot) };
        drop(self.take_stage(robot));
        self.stand_still(robot);
        self.go_on(robot, &next);
        self.get_mut::<Journey>(robot).errand = Some(next);
    }

    fn go_on(&mut self, robot: Entity, errand: &DriveTarget) {
        match self.plan_leg(robot, errand) {
            Ok(way) => self.set_off(robot, way),
            Err(why) => self.abort_goal(robot, why),
        }
    }

    /// Something came into a way or went out of one: whoever is under way there looks ahead again.
    fn look_ahead_again(&mut self) {
        let robots: Vec<Entity> = self.robots.values().copied().collect();
        for robot in robots {
            let rolls =
                matches!(&self.get::<Journey>(robot).stage, Stage::Rolling(course) if course.drive.lane.is_some());
            if !rolls {
                continue;
            }
            let left = match &*self.get::<RobotLocation>(robot) {
                RobotLocation::Driving(part) => part.remaining(self.now).get(),
                RobotLocation::Standing { .. } => self.steered_remaining_m(robot),
            };
            let Stage::Rolling(mut course) = self.take_stage(robot) else { continue };
            course.done_m = course.until_m - left;
            self.proceed(robot, course, true);
        }
    }

    /// What a robot's drive has come to; it is idle until something else is put there, and nothing is due.
    fn take_stage(&mut self, robot: Entity) -> Stage {
        let (stage, wake) = {
            let mut journey = self.get_mut::<Journey>(robot);
            (std::mem::replace(&mut journey.stage, Stage::Idle), journey.wake.take())
        };
        wake.into_iter().for_each(|wake| self.queue.cancel(wake));
        stage
    }

    fn stand_at(&self, robot: Entity, course: &DriveProgress) {
        let here = course.drive.segment(course.done_m, course.done_m, self.now, course.speed_mps);
        // One that is steered comes only close.
        let pose = if self.is_steered(robot) { self.get::<RobotLocation>(robot).pose(self.now) } else { here.end_pose };
        *self.get_mut::<RobotLocation>(robot) = RobotLocation::Standing { position: here.end_position, pose };
    }

    /// Lets a robot stand where it is now, whether it was driving or not; one that is steered brakes.
    fn stand_still(&mut self, robot: Entity) {
        self.brake(robot);
        let mut whereabouts = self.get_mut::<RobotLocation>(robot);
        *whereabouts =
            RobotLocation::Standing { position: whereabouts.map_position(self.now), pose: whereabouts.pose(self.now) };
    }

    /// How far it still is, and how long as far as the robot can tell: doors and lifts may keep it waiting.
    fn journey_left(&self, robot: Entity) -> Option<Feedback> {
        let journey = self.get::<Journey>(robot);
        let (course, left_m, left_s) = match (&journey.stage, &*self.get::<RobotLocation>(robot)) {
            (Stage::Rolling(course), RobotLocation::Driving(part)) => {
                (course, part.remaining(self.now).get(), (part.end_time() - self.now).max(0.0))
            }
            (Stage::Rolling(course), RobotLocation::Standing { .. }) => {
                let (left_m, left_s) = self.steered_remaining(robot, course.speed_mps);
                (course, left_m, left_s)
            }
            (Stage::AtDoor(course, _), _) => (course, 0.0, 0.0),
            (Stage::Idle | Stage::AtLift(_) | Stage::InLift, _) => return None,
        };
        let begun_m = if matches!(journey.stage, Stage::Rolling(_)) { course.until_m } else { course.done_m };
        let beyond_m = course.drive.length_m() - begun_m;
        Some(Feedback::remaining(
            Metres::new(left_m + beyond_m).unwrap_or(Metres::ZERO),
            Seconds::new(left_s + beyond_m / course.speed_mps).unwrap_or(Seconds::ZERO),
        ))
    }
}
