//! The side of the robots: backends, their events, and requests to people.

use super::error::ActionError;
use super::goal::{Goal, GoalId, GoalStatus};
use super::robot::Telemetry;
use consort_protocol::ids::{RobotId, RoleId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::WorldTime;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// Task type of the request to take the items off robots. No domain can declare it, since its name contains a dot.
const TAKE_ITEMS: &str = "consort.take_items";

/// A task for a person with an unmanaged role, requested by the messages of the mission's plan; or the request to take the
/// items off robots, which belongs to no plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PersonRequest {
    /// The person's role in the mission.
    pub role: RoleId,
    /// The task, as in the mission.
    pub task: TaskSpec,
    /// Holders of the managed roles.
    pub holders: BTreeMap<RoleId, RobotId>,
}

impl PersonRequest {
    /// Returns the request to take all items off a robot that has them from this role.
    ///
    /// # Panics
    /// Never: the task type is valid.
    pub fn taking_items(role: RoleId, robot: RobotId) -> PersonRequest {
        let task_type = TaskType::new(TAKE_ITEMS).expect("a valid task type");
        let task = TaskSpec::of(task_type, vec![role.clone()]);
        PersonRequest { holders: [(role.clone(), robot)].into(), role, task }
    }

    /// Checks whether it is the request to take all items off the robots that hold the roles.
    pub fn takes_items(&self) -> bool {
        self.task.task_type.as_str() == TAKE_ITEMS
    }
}

/// Result of a person request: the results of the task by name, or the reason why the person declined or
/// could not do it.
pub type PersonResult = Result<BTreeMap<String, Scalar>, ActionError>;

/// An event of a robot or a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum BackendEvent {
    /// A robot's goal ended; the status is final.
    GoalEnded {
        /// Robot.
        robot: RobotId,
        /// Goal.
        goal: GoalId,
        /// Final status.
        status: GoalStatus,
    },
    /// A robot's battery fell below the share it needs to move. The robot stands where it is.
    Stranded {
        /// Robot.
        robot: RobotId,
    },
    /// A person cancels the mission for which a robot came.
    MissionCanceled {
        /// Name of the person.
        by: String,
        /// Role of the person.
        role: RoleId,
        /// The robot that came.
        robot: RobotId,
    },
    /// A person request ended.
    PersonRequestEnded {
        /// Id of the request.
        request: GoalId,
        /// Result.
        result: PersonResult,
    },
}

/// Backend of robots: a simulated world, or an adapter to real robots. Time only moves in
/// [`advance`](RobotBackend::advance).
pub trait RobotBackend: Send + Sync {
    /// The robots of this backend.
    fn robots(&self) -> Vec<RobotId>;

    /// Checks whether this backend serves person requests and world reports. In a fleet this is a
    /// single backend; an adapter to a single robot does not.
    fn serves_people(&self) -> bool {
        true
    }

    /// Starts a goal. A rejection, too, is reported as [`BackendEvent::GoalEnded`] by the next
    /// `advance`. A goal that arrives while another is active is rejected with
    /// [`ErrorCode::Busy`](super::ErrorCode::Busy). A repeated id changes nothing.
    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal);

    /// Permits a goal for this time from now on, and replaces the permission before. Called before
    /// the start of the goal, and whenever its client renews the permission. The caller cancels the
    /// goal at the end, so only a backend that forwards goals to another process needs it.
    fn permit(&mut self, robot: &RobotId, id: GoalId, keep_for: Duration) {
        let _ = (robot, id, keep_for);
    }

    /// Cancels a goal. Without effect if it is not active.
    fn cancel(&mut self, robot: &RobotId, id: GoalId);

    /// Requests a task of a person. The result is reported as [`BackendEvent::PersonRequestEnded`],
    /// possibly much later: the person waits for a robot nearby with an open drawer. A request that
    /// [takes items](PersonRequest::takes_items) is done at once. A repeated id changes nothing.
    fn request_person(&mut self, id: GoalId, request: PersonRequest);

    /// Cancels a person request. If the request arrives after its cancelation, it is not served.
    fn cancel_person_request(&mut self, id: GoalId);

    /// The world's clock.
    fn now(&self) -> WorldTime;

    /// Time of the next event without further input; `None` while nothing is active. Never earlier
    /// than `now`.
    fn next_due(&self) -> Option<WorldTime>;

    /// Advances time up to and including `to`, and returns the events in order.
    fn advance(&mut self, to: WorldTime) -> Vec<BackendEvent>;

    /// Status of a goal that is active (`Executing` with current feedback) or ended lately; `None`
    /// if unknown.
    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus>;

    /// Goals of a robot that are active or ended lately, in the order of their ids. Used by a
    /// driver server that restarts while robots are active.
    fn goals(&self, robot: &RobotId) -> Vec<GoalId>;

    /// The content of a robot's goal that is active or ended lately; `None` if unknown.
    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal>;

    /// Open person requests, in the order of their arrival. Used by a driver server that restarts
    /// while requests are open.
    fn open_person_requests(&self) -> Vec<GoalId>;

    /// Result of a person request; `None` if it is open, was canceled, or ended long ago.
    fn person_result(&self, id: GoalId) -> Option<PersonResult>;

    /// Checks whether a person request was canceled lately, before it ended.
    fn was_person_request_canceled(&self, id: GoalId) -> bool;

    /// Report of a robot as of `now`; `None` for an unknown robot.
    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry>;

    /// State of the world beyond the robots (objects, people), as JSON for displays. No decision
    /// depends on it.
    fn report(&self) -> serde_json::Value {
        serde_json::Value::Null
    }

    /// Readings of a robot's range sensors as of `now`, as a JSON list for bridges to other software. No
    /// decision depends on it.
    fn range_readings(&self, robot: &RobotId) -> serde_json::Value {
        let _ = robot;
        serde_json::Value::Array(vec![])
    }
}
