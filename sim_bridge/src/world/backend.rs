//! The world as a host of bodies.

use super::World;
use super::location::RobotLocation;
use super::preconditions::action_error;
use super::sim_state::{ScheduledEvent, SimCommand};
use super::systems::people::PersonRequests;
use super::systems::power::Battery;
use consort_protocol::ids::RobotId;
use consort_protocol::units::{BatteryShare, WorldTime};
use consort_skills::actions::{
    ActionError, BackendEvent, ErrorCode, Goal, GoalId, GoalStatus, PersonRequest, RobotBackend, Telemetry,
};

impl World {
    fn fall_due(&mut self, due: ScheduledEvent) {
        match due {
            ScheduledEvent::Emit(event) => self.state.emit(*event),
            ScheduledEvent::GoalEnds(robot) => {
                if let Some(event) = self.complete_goal(robot) {
                    self.state.emit(event);
                }
            }
            ScheduledEvent::Step => self.step(),
            ScheduledEvent::SystemTimer(place, wake) => {
                self.run_system(super::SystemIndex(place), |system, floor| system.on_timer(floor, wake))
            }
        }
    }

    /// Lets all systems step, and arranges the next time if any has to go on.
    fn step(&mut self) {
        self.state.clear_step();
        let mut goes_on = false;
        self.for_each_system(|system, floor| goes_on |= system.step(floor));
        if goes_on {
            self.state.start_stepping();
        }
    }

    /// Shows what happened to all systems and carries out what they ask, until there is nothing more; what is to be told the
    /// outside comes in order.
    pub(super) fn process_commands(&mut self) -> Vec<BackendEvent> {
        let mut told = Vec::new();
        loop {
            if let Some(what) = self.state.unobserved_events.pop_front() {
                self.for_each_system(|system, floor| system.on_event(floor, &what));
                continue;
            }
            match self.state.commands.pop_front() {
                Some(SimCommand::Emit(event)) => told.push(event),
                Some(SimCommand::Log(what)) => self.state.log_event(what),
                Some(SimCommand::AbortGoal(robot, why)) => {
                    told.extend(self.interrupt_goal(robot, GoalStatus::Aborted(why)))
                }
                Some(SimCommand::CompleteGoal(robot)) => told.extend(self.complete_goal(robot)),
                None => return told,
            }
        }
    }

    /// The same after something from outside: what is to be told is told by the next `advance`.
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
        let mut taken = false;
        self.for_each_system(|system, floor| taken |= system.request_person(floor, id, &ask));
        if !taken {
            let why = action_error(ErrorCode::Unknown, "there are no people in this world".to_owned());
            self.state.emit(BackendEvent::PersonRequestEnded { ask: id, result: Err(why) });
        }
        self.process_commands_and_defer();
    }

    fn cancel_person_request(&mut self, id: GoalId) {
        self.for_each_system(|system, floor| system.cancel_person_request(floor, id));
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
            self.fall_due(due);
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

    fn person_result(&self, id: GoalId) -> Option<Result<(), ActionError>> {
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
        let floor = &self.state;
        let whereabouts = floor.get::<RobotLocation>(robot);
        let battery = floor.find::<Battery>(robot);
        Some(Telemetry {
            time: self.now(),
            pose: whereabouts.pose(floor.now),
            place: floor.map.place_at(whereabouts.map_position(floor.now).last_place()).id.clone(),
            battery: battery.as_ref().map_or(BatteryShare::FULL, |battery| battery.at(floor.now)),
            able: battery.is_none_or(|battery| battery.able),
            closed: floor.known_closures(robot),
        })
    }

    fn report(&self) -> serde_json::Value {
        let (samples, people, doors) = (self.samples(), self.people(), self.doors());
        serde_json::json!({ "time_s": self.state.now, "samples": samples, "people": people, "doors": doors })
    }
}
