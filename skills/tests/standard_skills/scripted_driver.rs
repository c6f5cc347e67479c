//! A robot that follows a script, and otherwise completes every goal.

use super::{PlaceId, Pose, place};
use consort_protocol::units::{BatteryShare, Metres, MetresPerSecond, Seconds, WorldTime};
use consort_skills::actions::{
    ActionError, ErrorCode, Feedback, FollowWaypoints, Goal, GoalId, GoalResult, GoalStatus, NavigateToPose,
    RobotActions, Telemetry, Wait,
};
use consort_skills::environment::SpeedLimits;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};

/// Executes a single goal at a time, and is slow to stop: a canceled goal ends only when the test
/// ends it.
pub(crate) struct ScriptedDriver {
    telemetry: Telemetry,
    /// Lanes and places that people have closed.
    closed_by_people: Vec<(PlaceId, PlaceId)>,
    /// Ways that devices of the building have not admitted.
    guarded: Vec<(PlaceId, PlaceId)>,
    /// Requested routes, without repetitions.
    requested: Vec<Vec<PlaceId>>,
    /// Speed limits of people.
    limits: SpeedLimits,
    /// Results of goals, in order. Later goals succeed.
    script: VecDeque<Result<(), ActionError>>,
    goals: Vec<(Goal, GoalStatus)>,
    canceling: Option<GoalId>,
    /// Goals completed in an earlier attempt.
    completed: Vec<Goal>,
}

impl ScriptedDriver {
    pub(crate) fn at(name: &str) -> ScriptedDriver {
        let x = match name {
            "A" => 0.0,
            "B" => 10.0,
            _ => 20.0,
        };
        let telemetry = Telemetry {
            time: WorldTime::ZERO,
            pose: Pose::new(x, 0.0, 0.0),
            place: place(name),
            battery: BatteryShare::FULL,
            able: true,
            closed: vec![],
            readings: BTreeMap::new(),
        };
        ScriptedDriver {
            telemetry,
            closed_by_people: vec![],
            guarded: vec![],
            requested: vec![],
            limits: SpeedLimits::default(),
            script: VecDeque::new(),
            goals: Vec::new(),
            canceling: None,
            completed: vec![],
        }
    }

    /// Sets the results of the next goals.
    pub(crate) fn with_results(mut self, script: impl IntoIterator<Item = Result<(), ActionError>>) -> ScriptedDriver {
        self.script.extend(script);
        self
    }

    /// People close a lane, or a place given twice.
    pub(crate) fn close(&mut self, a: &str, b: &str) {
        let lane = (place(a), place(b));
        self.closed_by_people.push(lane.clone());
        self.telemetry.closed.push(lane);
    }

    /// A device guards a way.
    pub(crate) fn guard(&mut self, from: &str, to: &str) {
        self.guarded.push((place(from), place(to)));
    }

    /// All devices admit the robot.
    pub(crate) fn admit(&mut self) {
        self.guarded.clear();
    }

    /// All routes requested from the devices of the building, as text.
    pub(crate) fn requested(&self) -> Vec<String> {
        let text = |route: &Vec<PlaceId>| route.iter().map(PlaceId::as_str).collect::<Vec<_>>().join(" ");
        self.requested.iter().map(text).collect()
    }

    /// People limit the speed on a lane, and nowhere else.
    pub(crate) fn limit(&mut self, a: &str, b: &str, speed: f64) {
        let speed = MetresPerSecond::new(speed).expect("a speed");
        self.limits = [((place(a), place(b)), speed)].into_iter().collect();
    }

    /// People open all that they have closed.
    pub(crate) fn open_all(&mut self) {
        self.telemetry.closed.retain(|lane| !self.closed_by_people.contains(lane));
        self.closed_by_people.clear();
    }

    /// Adds a goal completed in an earlier attempt.
    pub(crate) fn with_completed(mut self, goal: Goal) -> ScriptedDriver {
        self.completed.push(goal);
        self
    }

    /// All goals received, as text.
    pub(crate) fn sent(&self) -> Vec<String> {
        let shown = |(goal, _): &(Goal, GoalStatus)| {
            let text = |name: &str| match goal.parameters.get(name) {
                Some(Value::String(text)) => text.clone(),
                other => other.map(ToString::to_string).unwrap_or_default(),
            };
            match goal.action.as_str() {
                "navigate_to_pose" => match goal.read() {
                    Some(Ok(NavigateToPose { place: Some(place), pose, speed_max_mps })) => {
                        let limit = speed_max_mps.map(|limit| format!(" at {} m/s", limit.get())).unwrap_or_default();
                        format!("drive {place} {}{limit}", pose.x)
                    }
                    _ => "drive".to_owned(),
                },
                "approach_person" => format!("approach person {}", text("role")),
                "authenticate_person" => format!("authenticate {}", text("role")),
                "operate_drawer" => format!("drawer {}", text("action")),
                "follow_waypoints" => match goal.read() {
                    Some(Ok(FollowWaypoints { waypoints })) => format!("follow {} waypoints", waypoints.len()),
                    _ => "follow".to_owned(),
                },
                "approach_robot" => format!("approach robot {}", text("robot")),
                "pick_up" => format!("pick up from {}", text("from")),
                "grasp" => format!("grasp {}", text("object")),
                "deposit" if goal.parameters.contains_key("into") => format!("deposit into {}", text("into")),
                "wait" => match goal.read() {
                    Some(Ok(Wait { time })) => format!("wait {time}"),
                    _ => "wait".to_owned(),
                },
                other => other.to_owned(),
            }
        };
        self.goals.iter().map(shown).collect()
    }

    /// All goals received.
    pub(crate) fn goals(&self) -> Vec<Goal> {
        self.goals.iter().map(|(goal, _)| goal.clone()).collect()
    }

    /// Ends the active goal with its result in the script.
    pub(crate) fn end_goal(&mut self) {
        let Some((goal, status)) = self.goals.last_mut().filter(|(_, status)| !status.is_final()) else { return };
        *status = match self.script.pop_front().unwrap_or(Ok(())) {
            Err(error) => {
                let drive = goal.read().filter(|_| error.code == ErrorCode::Blocked);
                if let Some(Ok(NavigateToPose { place: Some(to), .. })) = drive {
                    self.telemetry.closed.push((self.telemetry.place.clone(), to));
                }
                GoalStatus::Aborted(error)
            }
            Ok(()) => {
                if let Some(Ok(NavigateToPose { pose, place: Some(place), .. })) = goal.read() {
                    (self.telemetry.pose, self.telemetry.place) = (pose, place);
                }
                GoalStatus::succeeded()
            }
        };
    }

    /// Sets the position of the robot, after passing `passed`.
    pub(crate) fn set_position(&mut self, x: f64, passed: PlaceId) {
        self.telemetry.pose.x = x;
        self.telemetry.place = passed;
    }

    /// Checks whether the active goal is being canceled.
    pub(crate) fn is_canceling(&self) -> bool {
        self.canceling.is_some()
    }

    /// Completes a cancelation.
    pub(crate) fn complete_cancel(&mut self) {
        let goal = self.canceling.take().expect("it was asked to stop");
        self.goals[goal.0 as usize].1 = GoalStatus::Canceled;
    }

    /// Drops all goals, as after a restart.
    pub(crate) fn forget_goals(&mut self) {
        self.goals.clear();
    }
}

impl RobotActions for ScriptedDriver {
    fn send_goal(&mut self, goal: Goal) -> GoalId {
        let busy = self.goals.last().is_some_and(|(_, status)| !status.is_final());
        let feedback = Feedback::remaining(Metres::ZERO, Seconds::ZERO);
        let status = if busy {
            GoalStatus::Aborted(ActionError::new(ErrorCode::Busy, "at work".to_owned()))
        } else {
            GoalStatus::Executing(feedback)
        };
        self.goals.push((goal, status));
        GoalId(self.goals.len() as u64 - 1)
    }

    fn status(&self, goal: GoalId) -> Option<GoalStatus> {
        self.goals.get(goal.0 as usize).map(|(_, status)| status.clone())
    }

    fn cancel(&mut self, goal: GoalId) {
        self.canceling = Some(goal);
    }

    fn telemetry(&self) -> Option<&Telemetry> {
        Some(&self.telemetry)
    }

    fn speed(&self) -> Option<MetresPerSecond> {
        MetresPerSecond::new(1.0).ok()
    }

    fn speed_limits(&self) -> Option<&SpeedLimits> {
        Some(&self.limits)
    }

    fn closed_by_people(&self) -> &[(PlaceId, PlaceId)] {
        &self.closed_by_people
    }

    fn request_way(&mut self, from: &PlaceId, to: &PlaceId, then: &[PlaceId]) -> bool {
        let route = [&[from.clone(), to.clone()][..], then].concat();
        if self.requested.last() != Some(&route) {
            self.requested.push(route);
        }
        !self.guarded.contains(&(from.clone(), to.clone()))
    }

    fn take_completed(&mut self, goal: &Goal) -> Option<GoalResult> {
        let completed = self.completed.iter().position(|completed| completed == goal);
        completed.map(|index| self.completed.remove(index)).map(|_| GoalResult::default())
    }
}
