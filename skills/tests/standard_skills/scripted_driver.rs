//! A robot that follows a script, and otherwise completes every goal.

use super::{PlaceId, Pose, place};
use consort_protocol::units::{BatteryShare, Metres, Seconds, WorldTime};
use consort_skills::actions::{
    ActionError, ErrorCode, Feedback, Goal, GoalId, GoalResult, GoalStatus, RobotActions, Telemetry,
};
use std::collections::{BTreeMap, VecDeque};

/// Executes a single goal at a time, and is slow to stop: a canceled goal ends only when the test
/// ends it.
pub(crate) struct ScriptedDriver {
    telemetry: Telemetry,
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
        ScriptedDriver { telemetry, script: VecDeque::new(), goals: Vec::new(), canceling: None, completed: vec![] }
    }

    /// Sets the results of the next goals.
    pub(crate) fn with_results(mut self, script: impl IntoIterator<Item = Result<(), ActionError>>) -> ScriptedDriver {
        self.script.extend(script);
        self
    }

    /// Adds a goal completed in an earlier attempt.
    pub(crate) fn with_completed(mut self, goal: Goal) -> ScriptedDriver {
        self.completed.push(goal);
        self
    }

    /// All goals received, as text.
    pub(crate) fn sent(&self) -> Vec<String> {
        let shown = |(goal, _): &(Goal, GoalStatus)| match goal {
            Goal::NavigateToPose { place: Some(place), pose } => format!("drive {place} {}", pose.x),
            Goal::NavigateToPose { place: None, .. } => "drive".to_owned(),
            Goal::ApproachPerson { role } => format!("approach person {role}"),
            Goal::AuthenticatePerson { role } => format!("authenticate {role}"),
            Goal::OperateDrawer { open } => format!("drawer {open}"),
            Goal::ApproachRobot { robot } => format!("approach robot {robot}"),
            Goal::PickUp { from } => format!("pick up from {from}"),
            Goal::Grasp { object } => format!("grasp {object}"),
            Goal::Deposit { into: Some(robot) } => format!("deposit into {robot}"),
            Goal::Deposit { into: None } => "deposit".to_owned(),
            Goal::Wait { time } => format!("wait {time}"),
            Goal::FollowWaypoints { waypoints } => format!("follow {} waypoints", waypoints.len()),
            Goal::Spin { angle_rad } => format!("spin {angle_rad}"),
            Goal::Dock { .. } => "dock".to_owned(),
            Goal::Undock => "undock".to_owned(),
            Goal::Declared(goal) => goal.action.to_string(),
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
                if let (ErrorCode::Blocked, Goal::NavigateToPose { place: Some(to), .. }) = (error.code, &*goal) {
                    self.telemetry.closed.push((self.telemetry.place.clone(), to.clone()));
                }
                GoalStatus::Aborted(error)
            }
            Ok(()) => {
                if let Goal::NavigateToPose { pose, place: Some(place) } = goal {
                    (self.telemetry.pose, self.telemetry.place) = (*pose, place.clone());
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

    fn take_completed(&mut self, goal: &Goal) -> Option<GoalResult> {
        let completed = self.completed.iter().position(|completed| completed == goal);
        completed.map(|index| self.completed.remove(index)).map(|_| GoalResult::default())
    }
}
