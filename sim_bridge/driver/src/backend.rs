//! The driver of a robot as backend of a driver server.

use crate::contract::Contract;
use crate::endpoint::DriverEndpoint;
use crate::process::{DriverProcess, ProcessCommand};
use crate::session::{DriverSession, SessionAction};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, WorldTime};
use consort_skills::actions::{
    ActionError, BackendEvent, ErrorCode, Goal, GoalId, GoalStatus, NavigateToPose, PersonRequest, PersonResult,
    PlaceTracker, RobotBackend, Telemetry,
};
use std::collections::BTreeMap;
use std::time::Duration;
use tracing::{info, warn};

/// Interval at which events of the process are handled during a goal or a start.
const CHECK_INTERVAL_S: f64 = 0.05;

/// Interval at which they are handled otherwise.
const IDLE_INTERVAL_S: f64 = 0.25;

/// Time for which the last report of a driver that restarts is served, longer than a goal waits for
/// it. Then the robot is out of service.
const REPORT_GRACE: Duration = Duration::from_secs(6);

/// A robot before its driver has reported.
#[derive(Debug, Clone)]
pub struct RobotStart {
    /// The robot.
    pub robot: RobotId,
    /// Its place.
    pub place: PlaceId,
    /// Its charge.
    pub charge: BatteryShare,
    /// Places of the fleet's map.
    pub places: BTreeMap<PlaceId, Pose>,
}

/// The backend. It passes time and events to the session, and performs the session's actions.
pub struct ProcessDriver {
    robot: RobotId,
    places: PlaceTracker,
    session: DriverSession,
    process: DriverProcess,
    now: WorldTime,
    rejected: Vec<BackendEvent>,
}

impl ProcessDriver {
    /// Creates the backend; called within a runtime. The process starts, or the connection is made, when
    /// time first advances.
    pub fn new(start: RobotStart, endpoint: DriverEndpoint, contract: Contract) -> ProcessDriver {
        let RobotStart { robot, place, charge, places } = start;
        let pose = places.get(&place).copied().unwrap_or_default();
        ProcessDriver {
            session: DriverSession::new(robot.clone(), contract, pose, charge),
            process: DriverProcess::start(robot.clone(), endpoint),
            robot,
            places: PlaceTracker::new(place, places),
            now: WorldTime::ZERO,
            rejected: vec![],
        }
    }

    fn elapsed(&self) -> Duration {
        Duration::try_from_secs_f64(self.now.as_secs()).unwrap_or(Duration::MAX)
    }

    fn perform(&mut self, actions: Vec<SessionAction>) {
        for action in actions {
            let command = match action {
                SessionAction::Spawn => ProcessCommand::Spawn,
                SessionAction::Send(message) => ProcessCommand::Send(message),
                SessionAction::Kill(reason) => {
                    warn!(robot = %self.robot, reason, "driver killed");
                    ProcessCommand::Kill(reason)
                }
                SessionAction::Log(what) => {
                    info!(robot = %self.robot, what, "driver");
                    continue;
                }
            };
            // The task ends only with this value.
            let _ = self.process.commands.send(command);
        }
    }

    /// Sets the place of the robot from its reported pose.
    fn update_place(&mut self) {
        let reported = self.session.reported();
        let pose = reported.pose;
        let named = reported.place.clone().filter(|place| self.places.is_on_map(place));
        self.places.set(pose, named);
    }

    /// Records the connection on which a drive was blocked.
    fn add_closure(&mut self, id: GoalId, status: &GoalStatus) {
        let GoalStatus::Aborted(ActionError { code: ErrorCode::Blocked, .. }) = status else { return };
        let goal = self.session.goal(id).and_then(|goal| goal.read());
        let Some(Ok(NavigateToPose { place: Some(to), .. })) = goal else { return };
        self.places.add_closure(to, self.now);
    }
}

impl RobotBackend for ProcessDriver {
    fn robots(&self) -> Vec<RobotId> {
        vec![self.robot.clone()]
    }

    fn serves_people(&self) -> bool {
        false
    }

    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        if *robot == self.robot {
            let actions = self.session.start(id, goal, self.elapsed());
            self.perform(actions);
        }
    }

    fn permit(&mut self, robot: &RobotId, id: GoalId, keep_for: Duration) {
        if *robot == self.robot {
            let actions = self.session.permit(id, keep_for, self.elapsed());
            self.perform(actions);
        }
    }

    fn cancel(&mut self, robot: &RobotId, id: GoalId) {
        if *robot == self.robot {
            let actions = self.session.cancel(id, self.elapsed());
            self.perform(actions);
        }
    }

    fn request_person(&mut self, id: GoalId, _request: PersonRequest) {
        let message = "this driver has no people".to_owned();
        self.rejected.push(BackendEvent::PersonRequestEnded {
            request: id,
            result: Err(ActionError::rejected(ErrorCode::Unknown, message)),
        });
    }

    fn cancel_person_request(&mut self, _id: GoalId) {}

    fn now(&self) -> WorldTime {
        self.now
    }

    fn next_due(&self) -> Option<WorldTime> {
        let is_busy = !self.session.is_served(self.elapsed(), Duration::ZERO)
            || self.session.goals().iter().any(|id| self.session.status(*id).is_some_and(|status| !status.is_final()));
        let interval = match (self.session.has_ended_goals(), is_busy) {
            (true, _) => 0.0,
            (false, true) => CHECK_INTERVAL_S,
            (false, false) => IDLE_INTERVAL_S,
        };
        Some(WorldTime::from_secs(self.now.as_secs() + interval))
    }

    fn advance(&mut self, to: WorldTime) -> Vec<BackendEvent> {
        self.now = WorldTime::from_secs(to.as_secs().max(self.now.as_secs()));
        let now = self.elapsed();
        while let Ok(event) = self.process.events.try_recv() {
            let actions = self.session.handle(event, now);
            self.perform(actions);
        }
        self.update_place();
        let actions = self.session.tick(self.places.place(), now);
        self.perform(actions);
        self.places.end_closures(self.now);
        let mut events = std::mem::take(&mut self.rejected);
        for outcome in self.session.take_ended() {
            self.add_closure(outcome.id, &outcome.status);
            let (robot, goal, status) = (self.robot.clone(), outcome.id, outcome.status);
            events.push(BackendEvent::GoalEnded { robot, goal, status });
        }
        events
    }

    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus> {
        if *robot == self.robot { self.session.status(id) } else { None }
    }

    fn goals(&self, robot: &RobotId) -> Vec<GoalId> {
        if *robot == self.robot { self.session.goals() } else { vec![] }
    }

    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal> {
        if *robot == self.robot { self.session.goal(id) } else { None }
    }

    fn open_person_requests(&self) -> Vec<GoalId> {
        vec![]
    }

    fn person_result(&self, _id: GoalId) -> Option<PersonResult> {
        None
    }

    fn was_person_request_canceled(&self, _id: GoalId) -> bool {
        false
    }

    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        let is_served = *robot == self.robot && self.session.is_served(self.elapsed(), REPORT_GRACE);
        let reported = self.session.reported();
        is_served.then(|| Telemetry {
            time: self.now,
            pose: reported.pose,
            place: self.places.place().clone(),
            battery: reported.charge,
            able: reported.able,
            closed: self.places.closed(),
            readings: reported.readings.clone(),
        })
    }
}
