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
use crate::world::components::{Beside, Body, Departures};
use crate::world::course::{Course, SAME_M, SIGHT_M, Stop};
use crate::world::floor::Floor;
use crate::world::journal::Happening;
use crate::world::queue::Ticket;
use crate::world::reach::refused;
use crate::world::setup::RobotBody;
use crate::world::system::{Kind, LATER, System, Wake, kinds};
use crate::world::systems::doors::{DoorsByName, Doorway};
use crate::world::systems::lifts::LiftsByName;
use crate::world::systems::obstacles::{InTheWay, KnownClosed};
use crate::world::systems::steering::{Footprint, Steered, Surroundings};
use crate::world::ways::{Errand, Way};
use crate::world::whereabouts::{Spot, Whereabouts};
use consort_protocol::ids::RobotId;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, ErrorCode, Feedback, Goal, Progress};
use hecs::Entity;
use std::collections::VecDeque;

/// How far a robot's drive has come, beside where it is.
pub(crate) struct Journey {
    /// Where it is to go, while a goal says so.
    errand: Option<Errand>,
    /// Where it is to go then.
    afterwards: VecDeque<Errand>,
    stage: Stage,
    wake: Option<Ticket>,
    /// The doorway that it is in.
    inside: Option<Entity>,
}

enum Stage {
    /// It goes nowhere.
    Idle,
    Rolling(Course),
    AtDoor(Course, Entity),
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

    fn reads(&self) -> Vec<Kind> {
        kinds![Body, Doorway, DoorsByName, InTheWay, LiftsByName, Footprint]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Whereabouts, Departures, Beside, Journey, KnownClosed, Steered, Surroundings]
    }

    fn equip(&self, floor: &mut Floor, robot: Entity, _body: &RobotBody) {
        floor.give(robot, Departures(0));
        floor.give(
            robot,
            Journey { errand: None, afterwards: VecDeque::new(), stage: Stage::Idle, wake: None, inside: None },
        );
    }

    fn begin(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let mut errands: VecDeque<Errand> = match goal {
            Goal::NavigateToPose { pose, place } => [Errand { pose: *pose, place: place.clone() }].into(),
            Goal::FollowWaypoints { waypoints } => waypoints.iter().map(Errand::from).collect(),
            _ => return None,
        };
        let Some(first) = errands.pop_front() else {
            return Some(Err(refused(ErrorCode::Unknown, "there are no waypoints to follow".to_owned())));
        };
        floor.catch_up(robot);
        Some(floor.set_errand(robot, first).map(|()| {
            floor.get_mut::<Journey>(robot).afterwards = errands;
            LATER
        }))
    }

    fn finish(&self, floor: &mut Floor, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        floor.drop_errand(robot);
        Ok(())
    }

    fn halt(&self, floor: &mut Floor, robot: Entity, _goal: &Goal) {
        floor.drop_errand(robot);
    }

    fn feedback(&self, floor: &Floor, robot: Entity, goal: &Goal, usual: Feedback) -> Feedback {
        let progress = match goal {
            Goal::FollowWaypoints { waypoints } => {
                let to_come = floor.get::<Journey>(robot).afterwards.len();
                Progress::Waypoint(u32::try_from(waypoints.len().saturating_sub(to_come + 1)).unwrap_or(u32::MAX))
            }
            _ => Progress::Unsaid,
        };
        Feedback { progress, ..floor.journey_left(robot).unwrap_or(usual) }
    }

    fn wake(&self, floor: &mut Floor, Wake { about: robot, .. }: Wake) {
        floor.get_mut::<Journey>(robot).wake = None;
        match floor.take_stage(robot) {
            Stage::Rolling(course) => floor.part_ends(robot, course),
            Stage::AtDoor(course, door) => floor.lose_patience(robot, course, door),
            stage @ (Stage::Idle | Stage::AtLift(_) | Stage::InLift) => {
                floor.get_mut::<Journey>(robot).stage = stage;
            }
        }
    }

    fn observe(&self, floor: &mut Floor, what: &Happening) {
        let known = |robot: &RobotId| floor.robots.get(robot).copied();
        match what {
            Happening::DoorEntered { robot, .. } => {
                if let Some(robot) = known(robot) {
                    floor.enter_doorway(robot);
                }
            }
            Happening::LiftEntered { robot, .. } => {
                if let Some(robot) = known(robot) {
                    floor.enter_lift(robot);
                }
            }
            Happening::LiftLeft { robot, at, .. } => {
                if let Some((robot, at)) = known(robot).zip(floor.map.index(at)) {
                    floor.leave_lift(robot, at);
                }
            }
            Happening::WayClosed { .. } | Happening::WayOpened { .. } => floor.look_ahead_again(),
            _ => {}
        }
    }
}

impl Floor {
    /// Sends a robot somewhere, if there is a way. One in a lift goes there once it gets out.
    fn set_errand(&mut self, robot: Entity, errand: Errand) -> Result<(), ActionError> {
        let in_lift = matches!(self.get::<Journey>(robot).stage, Stage::InLift);
        if in_lift {
            errand.place.as_ref().map(|place| self.destination(place, errand.pose)).transpose()?;
        } else {
            let way = self.find_way(robot, &errand)?;
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
                let door = self.get::<Doorway>(door).name.clone();
                self.note(Happening::DoorLeft { robot: self.name(robot), door });
            }
            Stage::AtLift(to) => {
                let at = self.map.at(self.spot(robot).last_place()).id.clone();
                let lift = self.lift_between(&at, &self.map.at(to).id).unwrap_or_default();
                self.note(Happening::LiftLeft { robot: self.name(robot), lift, at });
            }
            stage @ Stage::InLift => self.get_mut::<Journey>(robot).stage = stage,
        }
    }

    /// Sets a robot in motion, or has it wait for a lift. Whoever it was beside, it is no longer once it moves.
    fn set_off(&mut self, robot: Entity, way: Way) {
        match way {
            Way::Drive(drive, speed_mps) => {
                if drive.length_m() > 0.0 {
                    self.depart(robot);
                }
                let course = Course::new(drive, speed_mps, self);
                let inside = self.get::<Journey>(robot).inside.filter(|door| !course.leaves(*door));
                if let Some(door) = inside {
                    self.leave_doorway(robot, door);
                }
                self.proceed(robot, course, true);
            }
            Way::Ride { lift, from, to } => {
                self.get_mut::<Journey>(robot).stage = Stage::AtLift(to);
                let [at, to] = [from, to].map(|place| self.map.at(place).id.clone());
                self.note(Happening::LiftAwaited { robot: self.name(robot), lift, at, to });
            }
        }
    }

    fn depart(&self, robot: Entity) {
        if let Some(mut beside) = self.find_mut::<Beside>(robot) {
            *beside = Beside::Nobody;
        }
        self.get_mut::<Departures>(robot).0 += 1;
    }

    /// Does what there is to do where a robot has come to, and rolls on from there.
    fn proceed(&mut self, robot: Entity, mut course: Course, fresh: bool) {
        while let Some(stop) = course.stop_here() {
            let inside = self.get::<Journey>(robot).inside;
            match stop {
                Stop::Enter(door) if inside != Some(door) => return self.wait_at(robot, course, door),
                Stop::Enter(_) => {}
                Stop::Leave(door) => self.leave_doorway(robot, door),
            }
            course.stop_done();
        }
        if course.is_over() && !fresh {
            self.get_mut::<Journey>(robot).stage = Stage::Rolling(course);
            return self.arrived(robot);
        }
        let seen = self.seen_ahead(&course);
        if let Some((_, what)) = seen.as_ref().filter(|(at, _)| *at <= course.done_m + SAME_M) {
            return self.give_up(robot, &course, &format!("{what} stands in it"));
        }
        self.roll(robot, course, seen.map(|(at, _)| at));
    }

    /// It has come to the end of the part of its way that was under way.
    fn part_ends(&mut self, robot: Entity, mut course: Course) {
        course.done_m = course.until_m;
        self.proceed(robot, course, false);
    }

    /// Rolls to where there is something to do next.
    fn roll(&mut self, robot: Entity, mut course: Course, seen_m: Option<f64>) {
        let steered = self.is_steered(robot);
        let stop_m = if steered { course.next_halt_m() } else { course.next_stop_m() };
        course.until_m = stop_m.min(seen_m.unwrap_or(f64::INFINITY));
        let part = course.whole.part(course.done_m, course.until_m, self.now, course.speed_mps);
        if steered {
            self.steer(robot, part, course.speed_mps);
            self.get_mut::<Journey>(robot).stage = Stage::Rolling(course);
            return self.watch_for_doors(robot);
        }
        *self.get_mut::<Whereabouts>(robot) = Whereabouts::Driving(part);
        let wake = self.arrange(part.ends(), robot, 0);
        let mut journey = self.get_mut::<Journey>(robot);
        (journey.stage, journey.wake) = (Stage::Rolling(course), Some(wake));
    }

    /// A robot that is steered is at the end of the part of its way that was under way.
    pub(crate) fn steered_there(&mut self, robot: Entity) {
        if !matches!(self.get::<Journey>(robot).stage, Stage::Rolling(_)) {
            return; // it was beside the end before, looked ahead again there, and waits at a door already
        }
        if let Stage::Rolling(course) = self.take_stage(robot) {
            self.part_ends(robot, course);
        }
    }

    /// A robot that is steered is past a door.
    pub(crate) fn steered_past(&mut self, robot: Entity) {
        let passed = match &mut self.get_mut::<Journey>(robot).stage {
            Stage::Rolling(course) => course.pass(),
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
            self.watch(robot, (past_m < course.until_m).then_some(course.until_m - past_m));
        }
    }

    /// What stands in the way ahead, and how far along a robot stops before it: the first thing it comes to.
    fn seen_ahead(&self, course: &Course) -> Option<(f64, String)> {
        let (from, to, first, last) = course.whole.lane?;
        let ahead = self.in_the_way(from, to).into_iter().filter_map(|(share, what)| {
            let at = (share - first) / (last - first) * course.whole.length_m();
            let ahead = at + SAME_M >= course.done_m && at <= course.whole.length_m() + SAME_M;
            ahead.then(|| ((at - SIGHT_M).max(course.done_m), what))
        });
        ahead.min_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)))
    }

    /// Stands before what is in the way: the goal cannot go on, and the robot knows that this way is closed.
    fn give_up(&mut self, robot: Entity, course: &Course, why: &str) {
        self.stand_still(robot);
        let Some((from, to, first, last)) = course.whole.lane else { return };
        self.learn_closed(robot, from, to);
        let (from, to) = if last >= first { (from, to) } else { (to, from) };
        let message = format!("the way from {} to {} is blocked: {why}", self.map.at(from).id, self.map.at(to).id);
        self.break_off(robot, refused(ErrorCode::Blocked, message));
    }

    fn wait_at(&mut self, robot: Entity, course: Course, door: Entity) {
        self.stand_at(robot, &course);
        let wake = self.arrange(self.now + self.durations.door_patience_s, robot, 0);
        {
            let mut journey = self.get_mut::<Journey>(robot);
            (journey.stage, journey.wake) = (Stage::AtDoor(course, door), Some(wake));
        }
        let door = self.get::<Doorway>(door).name.clone();
        self.note(Happening::DoorAwaited { robot: self.name(robot), door });
    }

    /// It has waited for long; if the door lets nobody in, it does so no longer.
    fn lose_patience(&mut self, robot: Entity, course: Course, door: Entity) {
        let (name, until) = {
            let doorway = self.get::<Doorway>(door);
            (doorway.name.clone(), doorway.last_entry + self.durations.door_patience_s)
        };
        if until > self.now {
            let wake = self.arrange(until, robot, 0);
            let mut journey = self.get_mut::<Journey>(robot);
            (journey.stage, journey.wake) = (Stage::AtDoor(course, door), Some(wake));
            return;
        }
        self.give_up(robot, &course, &format!("{name} let nobody in for {} s", self.durations.door_patience_s));
        self.note(Happening::DoorLeft { robot: self.name(robot), door: name });
    }

    fn enter_doorway(&mut self, robot: Entity) {
        match self.take_stage(robot) {
            Stage::AtDoor(mut course, door) => {
                course.stop_done();
                self.get_mut::<Journey>(robot).inside = Some(door);
                self.proceed(robot, course, false);
            }
            stage => self.get_mut::<Journey>(robot).stage = stage,
        }
    }

    fn leave_doorway(&mut self, robot: Entity, door: Entity) {
        self.get_mut::<Journey>(robot).inside = None;
        let door = self.get::<Doorway>(door).name.clone();
        self.note(Happening::DoorLeft { robot: self.name(robot), door });
    }

    fn enter_lift(&mut self, robot: Entity) {
        let Stage::AtLift(to) = self.get::<Journey>(robot).stage else { return };
        self.depart(robot);
        self.get_mut::<Journey>(robot).stage = Stage::InLift;
        self.put(robot, Spot::Lift { to }, self.map.at(to).pose);
    }

    fn leave_lift(&mut self, robot: Entity, at: PlaceIndex) {
        if !matches!(self.get::<Journey>(robot).stage, Stage::InLift) {
            return;
        }
        self.put(robot, Spot::Place(at), self.map.at(at).pose);
        let errand = {
            let mut journey = self.get_mut::<Journey>(robot);
            journey.stage = Stage::Idle;
            journey.errand.clone()
        };
        let Some(errand) = errand else { return };
        if errand.place.as_ref() == Some(&self.map.at(at).id) {
            return self.arrived(robot);
        }
        self.go_on(robot, &errand);
    }

    /// It is where it was to go: it goes where it is to go then, or its goal has come to its end.
    fn arrived(&mut self, robot: Entity) {
        let next = self.get_mut::<Journey>(robot).afterwards.pop_front();
        let Some(next) = next else { return self.achieve(robot) };
        drop(self.take_stage(robot));
        self.stand_still(robot);
        self.go_on(robot, &next);
        self.get_mut::<Journey>(robot).errand = Some(next);
    }

    fn go_on(&mut self, robot: Entity, errand: &Errand) {
        match self.find_way(robot, errand) {
            Ok(way) => self.set_off(robot, way),
            Err(why) => self.break_off(robot, why),
        }
    }

    /// Something came into a way or went out of one: whoever is under way there looks ahead again.
    fn look_ahead_again(&mut self) {
        let robots: Vec<Entity> = self.robots.values().copied().collect();
        for robot in robots {
            let rolls =
                matches!(&self.get::<Journey>(robot).stage, Stage::Rolling(course) if course.whole.lane.is_some());
            if !rolls {
                continue;
            }
            let left = match &*self.get::<Whereabouts>(robot) {
                Whereabouts::Driving(part) => part.remaining(self.now).get(),
                Whereabouts::Standing { .. } => self.steered_left_m(robot),
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
        wake.into_iter().for_each(|wake| self.queue.take_back(wake));
        stage
    }

    fn stand_at(&self, robot: Entity, course: &Course) {
        let here = course.whole.part(course.done_m, course.done_m, self.now, course.speed_mps);
        // One that is steered comes only close.
        let pose = if self.is_steered(robot) { self.get::<Whereabouts>(robot).pose(self.now) } else { here.end_pose };
        *self.get_mut::<Whereabouts>(robot) = Whereabouts::Standing { spot: here.end_spot, pose };
    }

    /// Lets a robot stand where it is now, whether it was driving or not; one that is steered brakes.
    fn stand_still(&mut self, robot: Entity) {
        self.brake(robot);
        let mut whereabouts = self.get_mut::<Whereabouts>(robot);
        *whereabouts = Whereabouts::Standing { spot: whereabouts.spot(self.now), pose: whereabouts.pose(self.now) };
    }

    /// How far it still is, and how long as far as the robot can tell: doors and lifts may keep it waiting.
    fn journey_left(&self, robot: Entity) -> Option<Feedback> {
        let journey = self.get::<Journey>(robot);
        let (course, left_m, left_s) = match (&journey.stage, &*self.get::<Whereabouts>(robot)) {
            (Stage::Rolling(course), Whereabouts::Driving(part)) => {
                (course, part.remaining(self.now).get(), (part.ends() - self.now).max(0.0))
            }
            (Stage::Rolling(course), Whereabouts::Standing { .. }) => {
                let (left_m, left_s) = self.steered_left(robot, course.speed_mps);
                (course, left_m, left_s)
            }
            (Stage::AtDoor(course, _), _) => (course, 0.0, 0.0),
            (Stage::Idle | Stage::AtLift(_) | Stage::InLift, _) => return None,
        };
        let begun_m = if matches!(journey.stage, Stage::Rolling(_)) { course.until_m } else { course.done_m };
        let beyond_m = course.whole.length_m() - begun_m;
        Some(Feedback::left(
            Metres::new(left_m + beyond_m).unwrap_or(Metres::ZERO),
            Seconds::new(left_s + beyond_m / course.speed_mps).unwrap_or(Seconds::ZERO),
        ))
    }
}
