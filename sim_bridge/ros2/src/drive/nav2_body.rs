//! A robot under Nav2 as a body of the fleet, as a value: what its driver wants goes out as [`Ask`]s, what Nav2 says comes in
//! as [`Heard`], and time when its host lets it pass.
//!
//! The body drives and waits; what needs an arm, a drawer or a charger it refuses. Between two drives it is where the last
//! one left it. Its battery is not known, and counts as full.

use crate::action_client::End;
use crate::mapping;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, Metres, Seconds, WorldTime};
use consort_skills::actions::{
    ActionError, BodyEvent, BodyHost, ErrorCode, Feedback, Goal, GoalId, GoalStatus, PersonAsk, Progress, Telemetry,
    Waypoint,
};
use std::collections::{BTreeMap, VecDeque};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender};

/// A pose this close to a place is at that place: Nav2's default goal tolerance.
const AT_PLACE_M: f64 = 0.25;

/// Ended goals whose status can still be asked for.
const REMEMBERED: usize = 32;

/// How often a host looks whether Nav2 has said anything, while it has something to do.
const LOOK_S: f64 = 0.05;

/// How long a way on which the robot was blocked counts as closed: as in the simulated world.
const CLOSURE_REMEMBERED_S: f64 = 300.0;

/// Something for Nav2.
#[derive(Debug, Clone, PartialEq)]
pub enum Ask {
    /// Drive to a pose; what is heard of it has the same number.
    Drive(u64, Pose),
    /// Stop that drive.
    Stop(u64),
}

/// Something from Nav2, about the drive of a number.
#[derive(Debug, Clone, PartialEq)]
pub enum Heard {
    /// How it goes.
    Progress {
        /// Which drive.
        drive: u64,
        /// Where the robot is.
        pose: Pose,
        /// Way left.
        distance_m: f64,
        /// Seconds left.
        remaining_s: f64,
    },
    /// It was not taken on: why.
    Refused(u64, String),
    /// It has ended.
    Ended(u64, End),
}

/// How far a goal has come in terms of its own, with so many waypoints after the one that is driven to.
fn reached(goal: &Goal, afterwards: usize) -> Progress {
    match goal {
        Goal::FollowWaypoints { waypoints } => {
            let current = waypoints.len().saturating_sub(afterwards + 1);
            Progress::Waypoint(u32::try_from(current).unwrap_or(u32::MAX))
        }
        _ => Progress::Unsaid,
    }
}

/// See the [module](self).
pub struct Nav2Body {
    robot: RobotId,
    places: BTreeMap<PlaceId, Pose>,
    asks: UnboundedSender<Ask>,
    heard: UnboundedReceiver<Heard>,
    now: WorldTime,
    pose: Pose,
    place: PlaceId,
    /// Ways on which it was blocked, and until when they count as closed.
    closed: Vec<((PlaceId, PlaceId), f64)>,
    current: Option<Current>,
    ended: VecDeque<(GoalId, Goal, GoalStatus)>,
    news: Vec<BodyEvent>,
    drives: u64,
}

struct Current {
    id: GoalId,
    goal: Goal,
    doing: Doing,
}

enum Doing {
    /// Until then, in seconds of world time.
    Waiting(f64),
    Driving {
        drive: u64,
        to: Waypoint,
        /// Where it is to go then.
        afterwards: VecDeque<Waypoint>,
        feedback: Feedback,
        stopping: bool,
    },
}

impl Nav2Body {
    /// The body of a robot that stands at a place of a map. What it asks of Nav2 goes to `asks`, what is heard comes from
    /// `heard`.
    ///
    /// # Errors
    /// [`ActionError`] if the place is not on the map.
    pub fn new(
        robot: RobotId,
        place: PlaceId,
        places: BTreeMap<PlaceId, Pose>,
        asks: UnboundedSender<Ask>,
        heard: UnboundedReceiver<Heard>,
    ) -> Result<Nav2Body, ActionError> {
        let Some(pose) = places.get(&place).copied() else {
            let names: Vec<&str> = places.keys().map(PlaceId::as_str).collect();
            let message = format!("{:?} is not on the map; allowed are {}", place.as_str(), names.join(", "));
            return Err(ActionError { code: ErrorCode::Unknown, message });
        };
        Ok(Nav2Body {
            robot,
            places,
            asks,
            heard,
            now: WorldTime::ZERO,
            pose,
            place,
            closed: vec![],
            current: None,
            ended: VecDeque::new(),
            news: vec![],
            drives: 0,
        })
    }

    fn ask(&self, ask: Ask) {
        // Without anybody to ask the program is ending.
        let _ = self.asks.send(ask);
    }

    fn knows(&self, id: GoalId) -> bool {
        self.current.as_ref().is_some_and(|current| current.id == id) || self.ended.iter().any(|(old, ..)| *old == id)
    }

    fn drive(&mut self, to: Waypoint, afterwards: VecDeque<Waypoint>) -> Doing {
        self.drives += 1;
        let drive = self.drives;
        self.ask(Ask::Drive(drive, to.pose));
        let distance_remaining = self.pose.distance(to.pose);
        let feedback = Feedback::left(distance_remaining, Seconds::ZERO);
        Doing::Driving { drive, to, afterwards, feedback, stopping: false }
    }

    /// What a goal comes to, if this body can do it.
    fn begin(&mut self, goal: &Goal) -> Result<Doing, ActionError> {
        let refuse = |what: &str| {
            let message = format!("{} is driven by Nav2, and cannot {what}", self.robot);
            Err(ActionError { code: ErrorCode::Unknown, message })
        };
        match goal {
            Goal::NavigateToPose { pose, place } => {
                let to = Waypoint { pose: *pose, place: place.clone() };
                Ok(self.drive(to, VecDeque::new()))
            }
            Goal::FollowWaypoints { waypoints } => {
                let mut waypoints = VecDeque::from(waypoints.clone());
                match waypoints.pop_front() {
                    Some(first) => Ok(self.drive(first, waypoints)),
                    None => refuse("follow no waypoints"),
                }
            }
            Goal::Wait { time } => Ok(Doing::Waiting(self.now.as_secs() + time.get())),
            Goal::ApproachPerson { .. } => refuse("approach a person"),
            Goal::AuthenticatePerson { .. } => refuse("authenticate a person"),
            Goal::OperateDrawer { .. } => refuse("operate a drawer"),
            Goal::ApproachRobot { .. } => refuse("approach a robot"),
            Goal::PickUp { .. } => refuse("pick anything up"),
            Goal::Grasp { .. } => refuse("grasp anything"),
            Goal::Deposit { .. } => refuse("deposit anything"),
            Goal::Spin { .. } => refuse("spin"),
            Goal::Dock { .. } | Goal::Undock => refuse("dock"),
        }
    }

    fn conclude(&mut self, id: GoalId, goal: Goal, status: GoalStatus) {
        self.news.push(BodyEvent::GoalEnded { robot: self.robot.clone(), goal: id, status: status.clone() });
        self.ended.push_back((id, goal, status));
        while self.ended.len() > REMEMBERED {
            self.ended.pop_front();
        }
    }

    fn take(&mut self, heard: Heard) {
        let number = match &heard {
            Heard::Progress { drive, .. } | Heard::Refused(drive, _) | Heard::Ended(drive, _) => *drive,
        };
        let is_this = |doing: &Doing| matches!(doing, Doing::Driving { drive, .. } if *drive == number);
        let Some(Current { id, goal, doing: Doing::Driving { drive, to, mut afterwards, stopping, feedback: _ } }) =
            self.current.take_if(|current| is_this(&current.doing))
        else {
            return; // of a drive that is over for us
        };
        match heard {
            Heard::Progress { pose, distance_m, remaining_s, .. } => {
                self.is_at(pose, None);
                let distance_remaining = Metres::new(distance_m).unwrap_or(Metres::ZERO);
                let time_remaining = Seconds::new(remaining_s).unwrap_or(Seconds::ZERO);
                let feedback = Feedback::left(distance_remaining, time_remaining);
                self.current =
                    Some(Current { id, goal, doing: Doing::Driving { drive, to, afterwards, feedback, stopping } });
            }
            Heard::Ended(_, End::Succeeded) => {
                self.is_at(to.pose, to.place);
                match afterwards.pop_front() {
                    Some(next) if !stopping => {
                        let doing = self.drive(next, afterwards);
                        self.current = Some(Current { id, goal, doing });
                    }
                    Some(_) => self.conclude(id, goal, GoalStatus::Canceled),
                    None => self.conclude(id, goal, GoalStatus::Succeeded),
                }
            }
            Heard::Ended(_, End::Canceled) if stopping => self.conclude(id, goal, GoalStatus::Canceled),
            Heard::Ended(_, End::Canceled) => {
                self.abort(id, goal, ErrorCode::Unknown, "it was canceled at Nav2".to_owned());
            }
            Heard::Ended(_, End::Aborted(outcome)) => {
                let error = mapping::error(&outcome);
                if error.code == ErrorCode::Blocked {
                    self.remember_closed(to.place);
                }
                self.conclude(id, goal, GoalStatus::Aborted(error));
            }
            Heard::Ended(_, End::Lost(why)) => self.abort(id, goal, ErrorCode::TimedOut, why),
            Heard::Refused(_, why) => self.abort(id, goal, ErrorCode::Unknown, why),
        }
    }

    fn abort(&mut self, id: GoalId, goal: Goal, code: ErrorCode, message: String) {
        self.conclude(id, goal, GoalStatus::Aborted(ActionError { code, message }));
    }

    /// The robot is there; at a place, if the pose is one.
    fn is_at(&mut self, pose: Pose, place: Option<PlaceId>) {
        self.pose = pose;
        let near = || {
            let distances = self.places.iter().map(|(place, at)| (at.distance(pose).get(), place));
            let nearest = distances.min_by(|(a, first), (b, second)| a.total_cmp(b).then_with(|| first.cmp(second)));
            nearest.filter(|(distance, _)| *distance <= AT_PLACE_M).map(|(_, place)| place.clone())
        };
        if let Some(place) = place.or_else(near) {
            self.place = place;
        }
    }

    fn remember_closed(&mut self, to: Option<PlaceId>) {
        let Some(to) = to.filter(|to| *to != self.place) else { return };
        let way = (self.place.clone(), to);
        self.closed.retain(|(known, _)| *known != way);
        self.closed.push((way, self.now.as_secs() + CLOSURE_REMEMBERED_S));
    }
}

impl BodyHost for Nav2Body {
    fn robots(&self) -> Vec<RobotId> {
        vec![self.robot.clone()]
    }

    fn has_people(&self) -> bool {
        false
    }

    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        if *robot != self.robot || self.knows(id) {
            return;
        }
        if self.current.is_some() {
            let message = format!("{} has a goal under way", self.robot);
            return self.abort(id, goal, ErrorCode::Busy, message);
        }
        match self.begin(&goal) {
            Ok(doing) => self.current = Some(Current { id, goal, doing }),
            Err(error) => self.conclude(id, goal, GoalStatus::Aborted(error)),
        }
    }

    fn cancel(&mut self, robot: &RobotId, id: GoalId) {
        if *robot != self.robot {
            return;
        }
        let Some(current) = self.current.as_mut().filter(|current| current.id == id) else { return };
        match &mut current.doing {
            Doing::Driving { drive, stopping, .. } => {
                let drive = *drive;
                if !std::mem::replace(stopping, true) {
                    self.ask(Ask::Stop(drive));
                }
            }
            Doing::Waiting(_) => {
                if let Some(Current { id, goal, .. }) = self.current.take() {
                    self.conclude(id, goal, GoalStatus::Canceled);
                }
            }
        }
    }

    fn ask_person(&mut self, id: GoalId, _ask: PersonAsk) {
        let message = "there are no people here".to_owned();
        self.news
            .push(BodyEvent::PersonEnded { ask: id, result: Err(ActionError { code: ErrorCode::Unknown, message }) });
    }

    fn dismiss_person(&mut self, _id: GoalId) {}

    fn now(&self) -> WorldTime {
        self.now
    }

    fn next_due(&self) -> Option<WorldTime> {
        let now = self.now.as_secs();
        match self.current.as_ref().map(|current| &current.doing) {
            _ if !self.news.is_empty() => Some(self.now),
            Some(Doing::Waiting(until)) => Some(WorldTime::from_secs(until.max(now))),
            Some(Doing::Driving { .. }) => Some(WorldTime::from_secs(now + LOOK_S)),
            None => None,
        }
    }

    fn advance(&mut self, to: WorldTime) -> Vec<BodyEvent> {
        self.now = WorldTime::from_secs(to.as_secs().max(self.now.as_secs()));
        while let Ok(heard) = self.heard.try_recv() {
            self.take(heard);
        }
        let now = self.now.as_secs();
        self.closed.retain(|(_, until)| *until > now);
        let over = |doing: &Doing| matches!(doing, Doing::Waiting(until) if *until <= now);
        if let Some(Current { id, goal, .. }) = self.current.take_if(|current| over(&current.doing)) {
            self.conclude(id, goal, GoalStatus::Succeeded);
        }
        std::mem::take(&mut self.news)
    }

    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus> {
        if *robot != self.robot {
            return None;
        }
        if let Some(current) = self.current.as_ref().filter(|current| current.id == id) {
            return Some(GoalStatus::Executing(match &current.doing {
                Doing::Driving { feedback, afterwards, .. } => {
                    Feedback { progress: reached(&current.goal, afterwards.len()), ..*feedback }
                }
                Doing::Waiting(until) => {
                    let left = Seconds::new(until - self.now.as_secs()).unwrap_or(Seconds::ZERO);
                    Feedback::left(Metres::ZERO, left)
                }
            }));
        }
        self.ended.iter().find(|(ended, ..)| *ended == id).map(|(.., status)| status.clone())
    }

    fn goals(&self, robot: &RobotId) -> Vec<GoalId> {
        if *robot != self.robot {
            return vec![];
        }
        let ended = self.ended.iter().map(|(id, ..)| *id);
        let mut goals: Vec<GoalId> = ended.chain(self.current.as_ref().map(|current| current.id)).collect();
        goals.sort();
        goals
    }

    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal> {
        if *robot != self.robot {
            return None;
        }
        let current = self.current.as_ref().filter(|current| current.id == id).map(|current| current.goal.clone());
        current.or_else(|| self.ended.iter().find(|(ended, ..)| *ended == id).map(|(_, goal, _)| goal.clone()))
    }

    fn asks(&self) -> Vec<GoalId> {
        vec![]
    }

    fn answer(&self, _id: GoalId) -> Option<Result<(), ActionError>> {
        None
    }

    fn was_dismissed(&self, _id: GoalId) -> bool {
        false
    }

    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        (*robot == self.robot).then(|| Telemetry {
            time: self.now,
            pose: self.pose,
            place: self.place.clone(),
            battery: BatteryShare::FULL,
            able: true,
            closed: self.closed.iter().map(|(way, _)| way.clone()).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::Outcome;
    use tokio::sync::mpsc::unbounded_channel;

    struct Story {
        body: Nav2Body,
        asked: UnboundedReceiver<Ask>,
        nav2: UnboundedSender<Heard>,
        now: f64,
    }

    fn place(name: &str) -> PlaceId {
        name.parse().unwrap()
    }

    fn ada() -> RobotId {
        "ada".parse().unwrap()
    }

    /// A at (0, 0), B at (10, 0), C at (20, 0); the robot is at A.
    fn story() -> Story {
        let places = [("A", 0.0), ("B", 10.0), ("C", 20.0)].map(|(name, x)| (place(name), Pose::new(x, 0.0, 0.0)));
        let ((asks, asked), (nav2, heard)) = (unbounded_channel(), unbounded_channel());
        let body = Nav2Body::new(ada(), place("A"), places.into(), asks, heard).unwrap();
        Story { body, asked, nav2, now: 0.0 }
    }

    impl Story {
        fn to(&self, name: &str) -> Waypoint {
            Waypoint { pose: self.body.places[&place(name)], place: Some(place(name)) }
        }

        fn go(&mut self, id: u64, name: &str) {
            let Waypoint { pose, place } = self.to(name);
            self.body.start(&ada(), GoalId(id), Goal::NavigateToPose { pose, place });
        }

        fn asked(&mut self) -> Vec<Ask> {
            std::iter::from_fn(|| self.asked.try_recv().ok()).collect()
        }

        /// Nav2 says something, and a second passes: how goals end meanwhile.
        fn hear(&mut self, heard: Option<Heard>) -> Vec<(u64, GoalStatus)> {
            heard.into_iter().for_each(|heard| self.nav2.send(heard).unwrap());
            self.now += 1.0;
            let events = self.body.advance(WorldTime::from_secs(self.now));
            let ended = |event| match event {
                BodyEvent::GoalEnded { goal, status, .. } => (goal.0, status),
                other => panic!("{other:?}"),
            };
            events.into_iter().map(ended).collect()
        }

        fn telemetry(&self) -> Telemetry {
            self.body.telemetry(&ada()).unwrap()
        }
    }

    fn aborted(code: ErrorCode, message: &str) -> GoalStatus {
        GoalStatus::Aborted(ActionError { code, message: message.to_owned() })
    }

    fn outcome(error_code: u16) -> End {
        End::Aborted(Outcome { error_code, error_msg: "why".to_owned() })
    }

    #[test]
    fn a_drive_is_asked_of_nav2_and_ends_as_it_ends_there() {
        let mut story = story();
        assert_eq!(story.body.next_due(), None, "nothing is under way");
        story.go(7, "B");
        assert_eq!(story.asked(), [Ask::Drive(1, Pose::new(10.0, 0.0, 0.0))]);
        let progress = Heard::Progress { drive: 1, pose: Pose::new(4.0, 0.1, 0.2), distance_m: 6.0, remaining_s: 12.0 };
        assert_eq!(story.hear(Some(progress)), []);
        let feedback = Feedback::left(Metres::new(6.0).unwrap(), Seconds::new(12.0).unwrap());
        assert_eq!(story.body.status(&ada(), GoalId(7)), Some(GoalStatus::Executing(feedback)));
        assert_eq!((story.telemetry().pose, story.telemetry().place), (Pose::new(4.0, 0.1, 0.2), place("A")));
        assert_eq!(story.hear(Some(Heard::Ended(1, End::Succeeded))), [(7, GoalStatus::Succeeded)]);
        assert_eq!(story.telemetry().place, place("B"));
        story.go(7, "C");
        assert_eq!((story.asked(), story.hear(None)), (vec![], vec![]), "a repeated id starts nothing");
    }

    #[test]
    fn waypoints_are_driven_to_one_after_the_other() {
        let mut story = story();
        let waypoints = vec![story.to("B"), story.to("C")];
        story.body.start(&ada(), GoalId(1), Goal::FollowWaypoints { waypoints });
        assert_eq!(story.hear(Some(Heard::Ended(1, End::Succeeded))), []);
        assert_eq!(story.asked(), [Ask::Drive(1, Pose::new(10.0, 0.0, 0.0)), Ask::Drive(2, Pose::new(20.0, 0.0, 0.0))]);
        assert_eq!(story.hear(Some(Heard::Ended(1, outcome(208)))), [], "of a drive that is over");
        let Some(GoalStatus::Executing(feedback)) = story.body.status(&ada(), GoalId(1)) else { panic!("it drives") };
        assert_eq!(feedback.progress, Progress::Waypoint(1));
        assert_eq!(story.hear(Some(Heard::Ended(2, End::Succeeded))), [(1, GoalStatus::Succeeded)]);
    }

    #[test]
    fn a_canceled_drive_ends_when_nav2_says_so() {
        let mut story = story();
        story.go(1, "B");
        story.body.cancel(&ada(), GoalId(1));
        story.body.cancel(&ada(), GoalId(1));
        assert_eq!(story.asked()[1..], [Ask::Stop(1)], "asked once");
        assert_eq!(story.hear(None), []);
        story.go(2, "B");
        let busy = aborted(ErrorCode::Busy, "ada has a goal under way");
        assert_eq!(story.hear(Some(Heard::Ended(1, End::Canceled))), [(2, busy), (1, GoalStatus::Canceled)]);
    }

    #[test]
    fn a_stop_between_two_waypoints_is_a_stop() {
        let mut story = story();
        let waypoints = vec![story.to("B"), story.to("C")];
        story.body.start(&ada(), GoalId(1), Goal::FollowWaypoints { waypoints });
        story.body.cancel(&ada(), GoalId(1));
        assert_eq!(story.hear(Some(Heard::Ended(1, End::Succeeded))), [(1, GoalStatus::Canceled)]);
    }

    #[test]
    fn failures_of_nav2_keep_their_kind() {
        let mut story = story();
        let mut fail = |id: u64, heard: Heard| {
            story.go(id, "B");
            let ended = story.hear(Some(heard));
            match ended.as_slice() {
                [(_, GoalStatus::Aborted(error))] => error.to_string(),
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(fail(1, Heard::Ended(1, outcome(208))), "no route: Nav2 error 208: why");
        assert_eq!(fail(2, Heard::Ended(2, End::Canceled)), "unknown: it was canceled at Nav2");
        assert_eq!(fail(3, Heard::Ended(3, End::Lost("it is gone".to_owned()))), "timed out: it is gone");
        assert_eq!(fail(4, Heard::Refused(4, "Nav2 rejected it".to_owned())), "unknown: Nav2 rejected it");
    }

    #[test]
    fn where_nav2_was_blocked_counts_as_closed_for_a_while() {
        let mut story = story();
        story.go(1, "B");
        let why = aborted(ErrorCode::Blocked, "Nav2 error 105: why");
        assert_eq!(story.hear(Some(Heard::Ended(1, outcome(105)))), [(1, why)]);
        assert_eq!(story.telemetry().closed, [(place("A"), place("B"))]);
        story.now += 300.0;
        story.hear(None);
        assert_eq!(story.telemetry().closed, []);
    }

    #[test]
    fn it_waits_and_does_nothing_else() {
        let mut story = story();
        story.body.start(&ada(), GoalId(1), Goal::Wait { time: Seconds::new(1.5).unwrap() });
        assert_eq!(story.body.next_due(), Some(WorldTime::from_secs(1.5)));
        assert_eq!(story.hear(None), []);
        assert_eq!(story.hear(None), [(1, GoalStatus::Succeeded)]);
        story.body.start(&ada(), GoalId(2), Goal::Undock);
        assert_eq!(story.body.next_due(), Some(story.body.now()), "a refusal is told at once");
        let cannot = aborted(ErrorCode::Unknown, "ada is driven by Nav2, and cannot dock");
        assert_eq!(story.hear(None), [(2, cannot)]);
        story.body.start(&ada(), GoalId(3), Goal::Wait { time: Seconds::new(9.0).unwrap() });
        story.body.cancel(&ada(), GoalId(3));
        assert_eq!(story.hear(None), [(3, GoalStatus::Canceled)]);
        assert_eq!(story.body.goals(&ada()), [GoalId(1), GoalId(2), GoalId(3)]);
    }

    #[test]
    fn a_place_that_is_not_on_the_map_is_refused() {
        let ((asks, _), (_, heard)) = (unbounded_channel(), unbounded_channel());
        let places = [(place("A"), Pose::default())].into();
        let refused = Nav2Body::new(ada(), place("Z"), places, asks, heard).err().unwrap();
        assert_eq!(refused.message, "\"Z\" is not on the map; allowed are A");
    }
}
