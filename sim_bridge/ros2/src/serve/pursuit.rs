//! One robot's goals from ROS 2, pursued with its body: what is to be ordered of the body, and what is to be told the client,
//! as a value. It is told what arrives and what time it is, and waits for nobody.
//!
//! ```text
//!  Wanted ─▶ plan ─▶ order Start ─▶ the body's states ─▶ Tell … End
//!              ▲                        │ blocked, and it knows more than before
//!              └────────────────────────┘
//! ```

use crate::goals::{Ending, Uuid};
use crate::itinerary::{Atlas, Itinerary};
use crate::mapping::{PoseProblem, failure};
use crate::messages::Outcome;
use consort_actors::body::{BodyState, Order, SILENCE};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, WorldTime};
use consort_skills::actions::{ActionError, ErrorCode, Feedback, GoalId, GoalStatus, Telemetry};
use std::sync::Arc;
use std::time::Duration;

/// Something for the outside to do, in the order given.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Send this to the body's host; without an order it only says that somebody drives.
    Command(Option<Order>),
    /// Tell the client how it goes.
    Tell(Uuid, Report),
    /// Tell the client how it ended.
    End(Uuid, Ending, Outcome),
}

/// How a goal goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Where the robot is.
    pub pose: Pose,
    /// Seconds of world time since the goal was taken up.
    pub navigation_s: f64,
    /// Seconds of world time left, as far as the body can tell.
    pub remaining_s: f64,
    /// How often it went round something.
    pub recoveries: i16,
    /// Way left.
    pub distance: Metres,
}

/// Pursues the goals of one robot.
#[derive(Debug)]
pub struct Pursuit {
    robot: RobotId,
    atlas: Arc<Atlas>,
    /// The id of the next goal that the body gets.
    next: u64,
    latest: Option<Telemetry>,
    /// Of the latest state.
    number: u64,
    heard: Duration,
    under_way: Option<UnderWay>,
    /// What the body is to do when it has put down what it is at.
    waiting: Option<(Uuid, Pose)>,
}

#[derive(Debug)]
struct UnderWay {
    /// Whom it is for; nobody once another goal has taken its place.
    client: Option<Uuid>,
    to: Pose,
    goal: GoalId,
    itinerary: Itinerary,
    /// What the body knew to be closed when it set off.
    known: Vec<(PlaceId, PlaceId)>,
    /// Whether its host has heard of the goal.
    begun: bool,
    canceling: bool,
    /// It was blocked, and the report of what it met may be yet to come.
    blocked: Option<ActionError>,
    since: WorldTime,
    asked: Duration,
    recoveries: i16,
}

impl Pursuit {
    /// Pursues goals of a robot on a map. The body's goals get ids from `first_goal` on: none of them may have been used.
    pub fn new(robot: RobotId, atlas: Arc<Atlas>, first_goal: u64) -> Pursuit {
        let (latest, heard) = (None, Duration::ZERO);
        Pursuit { robot, atlas, next: first_goal, latest, number: 0, heard, under_way: None, waiting: None }
    }

    /// Whether anything is under way: then [`tick`](Self::tick) is due every now and then.
    pub fn is_busy(&self) -> bool {
        self.under_way.is_some()
    }

    /// A client wants the robot somewhere. It ends what another wanted before.
    pub fn want(&mut self, client: Uuid, to: Result<Pose, PoseProblem>, now: Duration) -> Vec<Action> {
        let mut actions = Vec::new();
        let to = match to {
            Ok(to) => to,
            Err(problem) => {
                let outcome = Outcome { error_code: problem.code(), error_msg: problem.to_string() };
                return vec![Action::End(client, Ending::Aborted, outcome)];
            }
        };
        if let Some((former, _)) = self.waiting.replace((client, to)) {
            actions.push(superseded(former));
        }
        match &mut self.under_way {
            Some(at) => {
                actions.extend(at.client.take().map(superseded));
                at.canceling = true;
                actions.push(Action::Command(Some(Order::Cancel { id: at.goal })));
            }
            None => actions.extend(self.set_off(now)),
        }
        actions
    }

    /// A client wants its goal ended.
    pub fn cancel(&mut self, client: Uuid) -> Vec<Action> {
        if self.waiting.as_ref().is_some_and(|(waiting, _)| *waiting == client) {
            self.waiting = None;
            return vec![Action::End(client, Ending::Canceled, Outcome::default())];
        }
        match self.under_way.as_mut().filter(|at| at.client == Some(client)) {
            Some(at) => {
                at.canceling = true;
                vec![Action::Command(Some(Order::Cancel { id: at.goal }))]
            }
            None => vec![],
        }
    }

    /// The body's host says how the body is.
    pub fn hear(&mut self, state: BodyState, now: Duration) -> Vec<Action> {
        if state.number <= self.number && self.number - state.number < 1 << 32 {
            return vec![]; // overtaken by a later one; a number far below is a host that started anew
        }
        (self.number, self.heard) = (state.number, now);
        let telemetry = state.telemetry;
        self.latest = Some(telemetry.clone());
        let Some(at) = &mut self.under_way else { return vec![] };
        let status = state.goals.into_iter().find(|(id, _)| *id == at.goal).map(|(_, status)| status);
        at.begun |= status.is_some();
        match status {
            Some(GoalStatus::Sent) => vec![],
            Some(GoalStatus::Executing(feedback)) => {
                let Some(client) = at.client else { return vec![] };
                vec![Action::Tell(client, report(&self.atlas, at, &telemetry, feedback))]
            }
            Some(GoalStatus::Succeeded) => self.end(Ending::Succeeded, Outcome::default(), now),
            Some(GoalStatus::Canceled) if at.canceling => self.end(Ending::Canceled, Outcome::default(), now),
            Some(GoalStatus::Canceled) => self.fail(ErrorCode::Unknown, "it was called off from elsewhere", now),
            Some(GoalStatus::Aborted(error)) if error.code == ErrorCode::Blocked && !at.canceling => {
                if telemetry.closed.iter().any(|way| !at.known.contains(way)) {
                    return self.go_round(now);
                }
                match &at.blocked {
                    Some(_) => self.end(Ending::Aborted, failure(&error), now),
                    None => {
                        at.blocked = Some(error);
                        vec![]
                    }
                }
            }
            Some(GoalStatus::Aborted(error)) => self.end(Ending::Aborted, failure(&error), now),
            None if at.begun => self.fail(ErrorCode::Unknown, "its host no longer knows of the drive", now),
            // A state from before the host heard of the goal.
            None => vec![],
        }
    }

    /// Time has passed: says that the driver is there, repeats what was not heard, and gives up on a body that says nothing.
    pub fn tick(&mut self, now: Duration) -> Vec<Action> {
        let Some(at) = &self.under_way else { return vec![] };
        if now.saturating_sub(self.heard.max(at.asked)) > SILENCE {
            let why = format!("its body has said nothing for {} s", SILENCE.as_secs());
            return self.fail(ErrorCode::TimedOut, &why, now);
        }
        let order = match (at.begun, at.canceling) {
            (_, true) => Some(Order::Cancel { id: at.goal }),
            (false, false) => Some(Order::Start { id: at.goal, goal: at.itinerary.goal.clone() }),
            (true, false) => None,
        };
        vec![Action::Command(order)]
    }

    /// Takes up what waits.
    fn set_off(&mut self, now: Duration) -> Vec<Action> {
        let Some((client, to)) = self.waiting.take() else { return vec![] };
        let Some(telemetry) = &self.latest else {
            let error = self.say(ErrorCode::TimedOut, "its body has not been heard of yet");
            return vec![Action::End(client, Ending::Aborted, failure(&error))];
        };
        match self.atlas.plan(telemetry, to) {
            Ok(itinerary) => {
                let (since, known) = (telemetry.time, telemetry.closed.clone());
                self.start(UnderWay {
                    client: Some(client),
                    to,
                    goal: GoalId(self.next),
                    itinerary,
                    known,
                    begun: false,
                    canceling: false,
                    blocked: None,
                    since,
                    asked: now,
                    recoveries: 0,
                })
            }
            Err(error) => vec![Action::End(client, Ending::Aborted, failure(&error))],
        }
    }

    fn start(&mut self, at: UnderWay) -> Vec<Action> {
        self.next += 1;
        let start = Order::Start { id: at.goal, goal: at.itinerary.goal.clone() };
        self.under_way = Some(at);
        vec![Action::Command(Some(start))]
    }

    /// The way is blocked, and the body has learned of something closed: another way, if there is one.
    fn go_round(&mut self, now: Duration) -> Vec<Action> {
        let (Some(at), Some(telemetry)) = (self.under_way.take(), self.latest.clone()) else { return vec![] };
        match self.atlas.plan(&telemetry, at.to) {
            Ok(itinerary) => {
                let recoveries = at.recoveries.saturating_add(1);
                let (goal, known) = (GoalId(self.next), telemetry.closed);
                self.start(UnderWay {
                    goal,
                    itinerary,
                    known,
                    begun: false,
                    blocked: None,
                    asked: now,
                    recoveries,
                    ..at
                })
            }
            Err(error) => {
                self.under_way = Some(at);
                self.end(Ending::Aborted, failure(&error), now)
            }
        }
    }

    fn fail(&mut self, code: ErrorCode, why: &str, now: Duration) -> Vec<Action> {
        let error = self.say(code, why);
        self.end(Ending::Aborted, failure(&error), now)
    }

    fn say(&self, code: ErrorCode, why: &str) -> ActionError {
        ActionError { code, message: format!("{}: {why}", self.robot) }
    }

    /// What was under way is over; what waits is taken up.
    fn end(&mut self, how: Ending, outcome: Outcome, now: Duration) -> Vec<Action> {
        let client = self.under_way.take().and_then(|at| at.client);
        let mut actions: Vec<Action> = client.map(|client| Action::End(client, how, outcome)).into_iter().collect();
        actions.extend(self.set_off(now));
        actions
    }
}

fn superseded(client: Uuid) -> Action {
    let error_msg = "another goal has taken its place".to_owned();
    Action::End(client, Ending::Aborted, Outcome { error_code: 9000, error_msg })
}

/// How it goes with the whole way, where the body tells of the leg that it is on.
fn report(atlas: &Atlas, at: &UnderWay, telemetry: &Telemetry, leg: Feedback) -> Report {
    let distance = atlas.distance_remaining(&at.itinerary, telemetry);
    let (leg_m, leg_s) = (leg.distance_remaining.get(), leg.time_remaining.get());
    let remaining_s = if leg_m > 0.0 { leg_s * (distance.get() / leg_m).max(1.0) } else { leg_s };
    let navigation_s = telemetry.time.as_secs() - at.since.as_secs();
    Report { pose: telemetry.pose, navigation_s, remaining_s, recoveries: at.recoveries, distance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::units::{BatteryShare, Seconds};
    use std::sync::atomic::{AtomicU64, Ordering};

    static NUMBER: AtomicU64 = AtomicU64::new(1);

    const ALICE: Uuid = [1; 16];
    const BERT: Uuid = [2; 16];

    /// A square of ways, 10 m a side: A – B – C – D – A.
    fn pursuit() -> Pursuit {
        let text = "{name: square, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}, \
            {name: C, kind: other, x_m: 10, y_m: 10}, {name: D, kind: other, x_m: 0, y_m: 10}], \
            lanes: [{between: [A, B]}, {between: [B, C]}, {between: [C, D]}, {between: [D, A]}]}";
        let atlas = Atlas::new(consort_sim::map::read(text, "square.yaml").unwrap()).unwrap();
        let mut pursuit = Pursuit::new("ada".parse().unwrap(), Arc::new(atlas), 100);
        assert_eq!(pursuit.hear(state(&[]), s(0)), []);
        pursuit
    }

    fn s(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    fn place(name: &str) -> PlaceId {
        name.parse().unwrap()
    }

    /// The body at A at 5 s of world time.
    fn state(goals: &[(u64, GoalStatus)]) -> BodyState {
        let telemetry = Telemetry {
            time: WorldTime::from_secs(5.0),
            pose: Pose::default(),
            place: place("A"),
            battery: BatteryShare::FULL,
            able: true,
            closed: vec![],
        };
        let goals = goals.iter().map(|(id, status)| (GoalId(*id), status.clone())).collect();
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        BodyState { robot: "ada".parse().unwrap(), number, telemetry, goals, done: vec![] }
    }

    fn knowing(closed: (&str, &str), goals: &[(u64, GoalStatus)]) -> BodyState {
        let mut state = state(goals);
        state.telemetry.closed.push((place(closed.0), place(closed.1)));
        state
    }

    fn executing(metres: f64, seconds: f64) -> GoalStatus {
        GoalStatus::Executing(Feedback::left(Metres::new(metres).unwrap(), Seconds::new(seconds).unwrap()))
    }

    fn aborted(code: ErrorCode) -> GoalStatus {
        GoalStatus::Aborted(ActionError { code, message: "why".to_owned() })
    }

    fn at_b() -> Result<Pose, PoseProblem> {
        Ok(Pose::new(10.0, 0.0, 0.0))
    }

    /// Orders by kind and id, endings by client and code.
    fn brief(actions: &[Action]) -> Vec<String> {
        let brief = |action: &Action| match action {
            Action::Command(None) => "there".to_owned(),
            Action::Command(Some(Order::Start { id, .. })) => format!("start {}", id.0),
            Action::Command(Some(Order::Cancel { id })) => format!("cancel {}", id.0),
            Action::Tell(client, report) => format!("tell {} {:.1} m", client[0], report.distance.get()),
            Action::End(client, how, outcome) => format!("end {} {how:?} {}", client[0], outcome.error_code),
        };
        actions.iter().map(brief).collect()
    }

    #[test]
    fn a_drive_is_begun_told_of_and_ended() {
        let mut pursuit = pursuit();
        assert_eq!(brief(&pursuit.want(ALICE, Ok(Pose::new(10.0, 10.0, 0.0)), s(1))), ["start 100"]);
        assert_eq!(brief(&pursuit.hear(state(&[]), s(1))), [] as [&str; 0], "the host has not heard of it yet");
        assert_eq!(brief(&pursuit.tick(s(1))), ["start 100"], "so it is told again");
        let told = pursuit.hear(state(&[(100, executing(4.0, 8.0))]), s(2));
        let expected = Report {
            pose: Pose::default(),
            navigation_s: 0.0,
            remaining_s: 40.0,
            recoveries: 0,
            distance: Metres::new(20.0).unwrap(),
        };
        assert_eq!(told, [Action::Tell(ALICE, expected)]);
        assert_eq!(brief(&pursuit.tick(s(2))), ["there"]);
        let ended = pursuit.hear(state(&[(100, GoalStatus::Succeeded)]), s(9));
        assert_eq!(ended, [Action::End(ALICE, Ending::Succeeded, Outcome::default())]);
        assert!(!pursuit.is_busy());
        assert_eq!(pursuit.tick(s(99)), [], "a body at rest is left alone");
    }

    #[test]
    fn what_is_canceled_ends_when_the_body_stands() {
        let mut pursuit = pursuit();
        pursuit.want(ALICE, at_b(), s(1));
        assert_eq!(brief(&pursuit.cancel(BERT)), [] as [&str; 0], "not his");
        assert_eq!(brief(&pursuit.cancel(ALICE)), ["cancel 100"]);
        assert_eq!(brief(&pursuit.tick(s(1))), ["cancel 100"], "until it is so");
        assert_eq!(brief(&pursuit.hear(state(&[(100, executing(4.0, 8.0))]), s(2))), ["tell 1 10.0 m"]);
        assert_eq!(brief(&pursuit.hear(state(&[(100, GoalStatus::Canceled)]), s(2))), ["end 1 Canceled 0"]);
    }

    #[test]
    fn what_somebody_else_calls_off_is_aborted() {
        let mut pursuit = pursuit();
        pursuit.want(ALICE, at_b(), s(1));
        let ended = pursuit.hear(state(&[(100, GoalStatus::Canceled)]), s(2));
        let error_msg = "unknown: ada: it was called off from elsewhere".to_owned();
        assert_eq!(ended, [Action::End(ALICE, Ending::Aborted, Outcome { error_code: 9000, error_msg })]);
    }

    #[test]
    fn a_later_goal_takes_the_place_of_an_earlier_one_once_the_body_stands() {
        let mut pursuit = pursuit();
        pursuit.want(ALICE, at_b(), s(1));
        assert_eq!(brief(&pursuit.want(BERT, at_b(), s(2))), ["end 1 Aborted 9000", "cancel 100"]);
        assert_eq!(brief(&pursuit.want(ALICE, at_b(), s(2))), ["end 2 Aborted 9000", "cancel 100"]);
        assert_eq!(brief(&pursuit.hear(state(&[(100, GoalStatus::Canceled)]), s(3))), ["start 101"]);
        assert_eq!(brief(&pursuit.hear(state(&[(101, GoalStatus::Succeeded)]), s(4))), ["end 1 Succeeded 0"]);
    }

    #[test]
    fn what_waits_can_be_canceled_too() {
        let mut pursuit = pursuit();
        pursuit.want(ALICE, at_b(), s(1));
        pursuit.want(BERT, at_b(), s(2));
        assert_eq!(brief(&pursuit.cancel(BERT)), ["end 2 Canceled 0"]);
        assert_eq!(brief(&pursuit.hear(state(&[(100, GoalStatus::Canceled)]), s(3))), [] as [&str; 0]);
        assert!(!pursuit.is_busy());
    }

    #[test]
    fn a_blocked_robot_goes_round_what_it_has_learned_of() {
        let mut pursuit = pursuit();
        pursuit.want(ALICE, at_b(), s(1));
        assert_eq!(brief(&pursuit.hear(state(&[(100, aborted(ErrorCode::Blocked))]), s(2))), [] as [&str; 0]);
        let learned = knowing(("A", "B"), &[(100, aborted(ErrorCode::Blocked))]);
        assert_eq!(brief(&pursuit.hear(learned, s(2))), ["start 101"]);
        let told = pursuit.hear(knowing(("A", "B"), &[(101, executing(10.0, 20.0))]), s(3));
        assert!(matches!(told.as_slice(), [Action::Tell(_, Report { recoveries: 1, .. })]), "{told:?}");
        let ended = pursuit.hear(knowing(("A", "B"), &[(101, aborted(ErrorCode::Blocked))]), s(4));
        assert_eq!(brief(&ended), [] as [&str; 0], "it knows no more: perhaps the next state says what it met");
        let ended = pursuit.hear(knowing(("A", "B"), &[(101, aborted(ErrorCode::Blocked))]), s(5));
        assert_eq!(brief(&ended), ["end 1 Aborted 105"]);
    }

    #[test]
    fn failures_end_with_the_codes_of_nav2() {
        let mut pursuit = pursuit();
        let nowhere = pursuit.want(ALICE, Ok(Pose::new(99.0, 0.0, 0.0)), s(1));
        assert_eq!(brief(&nowhere), ["end 1 Aborted 208"]);
        let odd = pursuit.want(ALICE, Err(PoseProblem::Frame("odom".to_owned())), s(1));
        assert_eq!(brief(&odd), ["end 1 Aborted 9002"]);
        pursuit.want(ALICE, at_b(), s(1));
        assert_eq!(brief(&pursuit.hear(state(&[(100, aborted(ErrorCode::BatteryLow))]), s(2))), ["end 1 Aborted 9000"]);
    }

    #[test]
    fn a_body_that_falls_silent_or_forgets_ends_the_goal() {
        let mut pursuit = pursuit();
        pursuit.want(ALICE, at_b(), s(10));
        assert_eq!(brief(&pursuit.tick(s(13))), ["start 100"], "it was asked at 10 s");
        let ended = pursuit.tick(s(14));
        let error_msg = "timed out: ada: its body has said nothing for 3 s".to_owned();
        assert_eq!(ended, [Action::End(ALICE, Ending::Aborted, Outcome { error_code: 9003, error_msg })]);

        pursuit.want(ALICE, at_b(), s(20));
        pursuit.hear(state(&[(101, executing(9.0, 9.0))]), s(20));
        assert_eq!(brief(&pursuit.hear(state(&[]), s(21))), ["end 1 Aborted 9000"], "a host that started anew");
    }

    #[test]
    fn a_state_that_was_overtaken_says_nothing() {
        let mut pursuit = pursuit();
        let early = state(&[]);
        pursuit.want(ALICE, at_b(), s(1));
        pursuit.hear(state(&[(100, executing(9.0, 9.0))]), s(1));
        assert_eq!(pursuit.hear(early, s(2)), [], "it is from before the goal");
        assert!(pursuit.is_busy());
    }

    #[test]
    fn a_body_that_was_never_heard_of_is_no_body() {
        let atlas = Arc::clone(&pursuit().atlas);
        let mut pursuit = Pursuit::new("bob".parse().unwrap(), atlas, 1);
        assert_eq!(brief(&pursuit.want(ALICE, at_b(), s(1))), ["end 1 Aborted 9003"]);
    }
}
