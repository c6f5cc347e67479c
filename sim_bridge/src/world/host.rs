//! The world as a host of bodies.

use super::battery::Battery;
use super::motion::Whereabouts;
use super::{Due, World};
use consort_protocol::ids::RobotId;
use consort_protocol::units::WorldTime;
use consort_skills::actions::{ActionError, BodyEvent, BodyHost, Goal, GoalId, GoalStatus, PersonAsk, Telemetry};

impl World {
    fn happen(&mut self, due: Due, events: &mut Vec<BodyEvent>) {
        match due {
            Due::Say(event) => events.push(*event),
            Due::GoalEnds(robot) => {
                events.extend(self.complete(robot));
                self.serve_asks();
            }
            Due::Strands(robot) => events.extend(self.strand(robot)),
            Due::HandedOver(ask) => events.extend(self.handed_over(ask)),
        }
    }
}

impl BodyHost for World {
    fn robots(&self) -> Vec<RobotId> {
        self.robots.keys().cloned().collect()
    }

    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        match self.robots.get(robot).copied() {
            Some(robot) => self.begin(robot, id, goal),
            None => self.refuse_stranger(robot, id),
        }
    }

    fn cancel(&mut self, robot: &RobotId, id: GoalId) {
        if let Some(robot) = self.robots.get(robot).copied() {
            self.cancel_goal(robot, id);
        }
    }

    fn ask_person(&mut self, id: GoalId, ask: PersonAsk) {
        self.take_ask(id, &ask);
    }

    fn dismiss_person(&mut self, id: GoalId) {
        self.withdraw(id);
    }

    fn now(&self) -> WorldTime {
        WorldTime::from_secs(self.now)
    }

    fn next_due(&self) -> Option<WorldTime> {
        self.queue.first_time().map(WorldTime::from_secs)
    }

    fn advance(&mut self, to: WorldTime) -> Vec<BodyEvent> {
        let to = to.as_secs().max(self.now);
        let mut events = Vec::new();
        while let Some((time, due)) = self.queue.pop_until(to) {
            self.now = time;
            self.happen(due, &mut events);
        }
        self.now = to;
        events
    }

    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus> {
        self.goal_status(*self.robots.get(robot)?, id)
    }

    fn goals(&self, robot: &RobotId) -> Vec<GoalId> {
        self.robots.get(robot).map_or(vec![], |robot| self.goals_of(*robot))
    }

    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal> {
        self.goal_of(*self.robots.get(robot)?, id)
    }

    fn asks(&self) -> Vec<GoalId> {
        self.open_asks()
    }

    fn answer(&self, id: GoalId) -> Option<Result<(), ActionError>> {
        self.answer_to(id)
    }

    fn was_dismissed(&self, id: GoalId) -> bool {
        self.was_withdrawn(id)
    }

    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        let robot = *self.robots.get(robot)?;
        let (whereabouts, battery) = (self.get::<Whereabouts>(robot), self.get::<Battery>(robot));
        Some(Telemetry {
            time: self.now(),
            pose: whereabouts.pose(self.now),
            place: self.map.at(whereabouts.spot(self.now).last_place()).id.clone(),
            battery: battery.at(self.now),
            able: battery.able,
        })
    }

    fn report(&self) -> serde_json::Value {
        serde_json::json!({ "time_s": self.now, "samples": self.samples(), "people": self.people() })
    }
}
