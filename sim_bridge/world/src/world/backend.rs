//! The world as a robot backend.

use super::location::RobotLocation;
use super::preconditions::action_error;
use super::sim_state::{ScheduledEvent, SimCommand};
use super::simulation::World;
use super::systems::declared_actions::Readings;
use super::systems::people::PersonRequests;
use super::systems::power::Battery;
use consort_protocol::ids::RobotId;
use consort_protocol::units::{BatteryShare, WorldTime};
use consort_skills::actions::{
    BackendEvent, ErrorCode, Goal, GoalId, GoalStatus, PersonRequest, PersonResult, RobotBackend, Telemetry,
};

impl World {
    fn handle_scheduled(&mut self, due: ScheduledEvent) {
        match due {
            ScheduledEvent::Emit(event) => self.state.emit(*event),
            ScheduledEvent::GoalEnds(robot) => {
                if let Some(event) = self.complete_goal(robot) {
                    self.state.emit(event);
                }
            }
            ScheduledEvent::Step => self.step(),
            ScheduledEvent::SystemTimer(index, wake) => {
                self.run_system(index, |system, state| system.on_timer(state, wake));
            }
        }
    }

    /// Lets all systems step, and schedules the next step if any system needs it.
    fn step(&mut self) {
        self.state.clear_step();
        let mut goes_on = false;
        self.for_each_system(|system, state| goes_on |= system.step(state));
        if goes_on {
            self.state.start_stepping();
        }
    }

    /// Shows new events to all systems and executes their commands, until none are left. Returns
    /// the events to emit, in order.
    pub(super) fn process_commands(&mut self) -> Vec<BackendEvent> {
        let mut events = Vec::new();
        loop {
            if let Some(event) = self.state.unobserved_events.pop_front() {
                self.for_each_system(|system, state| system.on_event(state, &event));
                continue;
            }
            match self.state.commands.pop_front() {
                Some(SimCommand::Emit(event)) => events.push(event),
                Some(SimCommand::Log(event)) => self.state.log_event(event),
                Some(SimCommand::AbortGoal(robot, error)) => {
                    events.extend(self.interrupt_goal(robot, GoalStatus::Aborted(error)));
                }
                Some(SimCommand::CompleteGoal(robot)) => events.extend(self.complete_goal(robot)),
                None => return events,
            }
        }
    }

    /// The same after a call from outside: the next `advance` returns the events.
    pub(super) fn process_commands_and_defer(&mut self) {
        for event in self.process_commands() {
            self.state.queue.schedule(self.state.now, ScheduledEvent::Emit(Box::new(event)));
        }
    }
}

impl RobotBackend for World {
    fn robots(&self) -> Vec<RobotId> {
        self.state.robots.keys().cloned().collect()
    }

    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        match self.state.robots.get(robot).copied() {
            Some(robot) => self.begin_goal(robot, id, goal),
            None => self.reject_unknown_robot(robot, id),
        }
        self.process_commands_and_defer();
    }

    fn cancel(&mut self, robot: &RobotId, id: GoalId) {
        if let Some(robot) = self.state.robots.get(robot).copied() {
            self.cancel_goal(robot, id);
            self.process_commands_and_defer();
        }
    }

    fn request_person(&mut self, id: GoalId, ask: PersonRequest) {
        let mut accepted = false;
        self.for_each_system(|system, state| accepted |= system.request_person(state, id, &ask));
        if !accepted {
            let error = action_error(ErrorCode::Unknown, "there are no people in this world".to_owned());
            self.state.emit(BackendEvent::PersonRequestEnded { request: id, result: Err(error) });
        }
        self.process_commands_and_defer();
    }

    fn cancel_person_request(&mut self, id: GoalId) {
        self.for_each_system(|system, state| system.cancel_person_request(state, id));
        self.process_commands_and_defer();
    }

    fn now(&self) -> WorldTime {
        WorldTime::from_secs(self.state.now)
    }

    fn next_due(&self) -> Option<WorldTime> {
        self.state.queue.next_time().map(WorldTime::from_secs)
    }

    fn advance(&mut self, to: WorldTime) -> Vec<BackendEvent> {
        let to = to.as_secs().max(self.state.now);
        let mut events = Vec::new();
        while let Some((time, due)) = self.state.queue.pop_due(to) {
            self.state.now = time;
            self.handle_scheduled(due);
            events.extend(self.process_commands());
        }
        self.state.now = to;
        events
    }

    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus> {
        self.goal_status(*self.state.robots.get(robot)?, id)
    }

    fn goals(&self, robot: &RobotId) -> Vec<GoalId> {
        self.state.robots.get(robot).map_or(vec![], |robot| self.goals_of(*robot))
    }

    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal> {
        self.goal_of(*self.state.robots.get(robot)?, id)
    }

    fn open_person_requests(&self) -> Vec<GoalId> {
        if self.state.has_resource::<PersonRequests>() {
            self.state.resource::<PersonRequests>().open_requests()
        } else {
            vec![]
        }
    }

    fn person_result(&self, id: GoalId) -> Option<PersonResult> {
        if self.state.has_resource::<PersonRequests>() {
            self.state.resource::<PersonRequests>().result(id)
        } else {
            None
        }
    }

    fn was_person_request_canceled(&self, id: GoalId) -> bool {
        self.state.has_resource::<PersonRequests>() && self.state.resource::<PersonRequests>().was_canceled(id)
    }

    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        let robot = *self.state.robots.get(robot)?;
        let state = &self.state;
        let location = state.get::<RobotLocation>(robot);
        let battery = state.find::<Battery>(robot);
        Some(Telemetry {
            time: self.now(),
            pose: location.pose(state.now),
            place: state.map.place_at(location.map_position(state.now).last_place()).id.clone(),
            battery: battery.as_ref().map_or(BatteryShare::FULL, |battery| battery.at(state.now)),
            able: battery.is_none_or(|battery| battery.able),
            closed: state.known_closures(robot),
            readings: state.find::<Readings>(robot).map(|readings| readings.0.clone()).unwrap_or_default(),
        })
    }

    fn report(&self) -> serde_json::Value {
        serde_json::to_value(self.world_report()).expect("a report serializes to JSON")
    }

    fn range_readings(&self, robot: &RobotId) -> serde_json::Value {
        serde_json::to_value(self.read_ranges(robot)).expect("readings serialize to JSON")
    }
}
