//! The world as a host of bodies.

use super::World;
use super::floor::{Due, Order};
use super::reach::refused;
use super::systems::people::Asks;
use super::systems::power::Battery;
use super::whereabouts::Whereabouts;
use consort_protocol::ids::RobotId;
use consort_protocol::units::{BatteryShare, WorldTime};
use consort_skills::actions::{
    ActionError, BodyEvent, BodyHost, ErrorCode, Goal, GoalId, GoalStatus, PersonAsk, Telemetry,
};

impl World {
    fn fall_due(&mut self, due: Due) {
        match due {
            Due::Say(event) => self.floor.say(*event),
            Due::GoalEnds(robot) => {
                if let Some(event) = self.complete(robot) {
                    self.floor.say(event);
                }
            }
            Due::Step => self.step(),
            Due::Wake(place, wake) => self.work(super::Chosen(place), |system, floor| system.wake(floor, wake)),
        }
    }

    /// Lets all systems step, and arranges the next time if any has to go on.
    fn step(&mut self) {
        self.floor.stepped();
        let mut goes_on = false;
        self.each_system(|system, floor| goes_on |= system.step(floor));
        if goes_on {
            self.floor.step_on();
        }
    }

    /// Shows what happened to all systems and carries out what they ask, until there is nothing more; what is to be told the
    /// outside comes in order.
    pub(super) fn follow_up(&mut self) -> Vec<BodyEvent> {
        let mut told = Vec::new();
        loop {
            if let Some(what) = self.floor.news.pop_front() {
                self.each_system(|system, floor| system.observe(floor, &what));
                continue;
            }
            match self.floor.orders.pop_front() {
                Some(Order::Say(event)) => told.push(event),
                Some(Order::Note(what)) => self.floor.note(what),
                Some(Order::BreakOff(robot, why)) => told.extend(self.interrupt(robot, GoalStatus::Aborted(why))),
                Some(Order::Achieve(robot)) => told.extend(self.complete(robot)),
                None => return told,
            }
        }
    }

    /// The same after something from outside: what is to be told is told by the next `advance`.
    pub(super) fn follow_up_later(&mut self) {
        for event in self.follow_up() {
            self.floor.queue.arrange(self.floor.now, Due::Say(Box::new(event)));
        }
    }
}

impl BodyHost for World {
    fn robots(&self) -> Vec<RobotId> {
        self.floor.robots.keys().cloned().collect()
    }

    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        match self.floor.robots.get(robot).copied() {
            Some(robot) => self.begin(robot, id, goal),
            None => self.refuse_stranger(robot, id),
        }
        self.follow_up_later();
    }

    fn cancel(&mut self, robot: &RobotId, id: GoalId) {
        if let Some(robot) = self.floor.robots.get(robot).copied() {
            self.cancel_goal(robot, id);
            self.follow_up_later();
        }
    }

    fn ask_person(&mut self, id: GoalId, ask: PersonAsk) {
        let mut taken = false;
        self.each_system(|system, floor| taken |= system.ask(floor, id, &ask));
        if !taken {
            let why = refused(ErrorCode::Unknown, "there are no people in this world".to_owned());
            self.floor.say(BodyEvent::PersonEnded { ask: id, result: Err(why) });
        }
        self.follow_up_later();
    }

    fn dismiss_person(&mut self, id: GoalId) {
        self.each_system(|system, floor| system.dismiss(floor, id));
        self.follow_up_later();
    }

    fn now(&self) -> WorldTime {
        WorldTime::from_secs(self.floor.now)
    }

    fn next_due(&self) -> Option<WorldTime> {
        self.floor.queue.first_time().map(WorldTime::from_secs)
    }

    fn advance(&mut self, to: WorldTime) -> Vec<BodyEvent> {
        let to = to.as_secs().max(self.floor.now);
        let mut events = Vec::new();
        while let Some((time, due)) = self.floor.queue.pop_until(to) {
            self.floor.now = time;
            self.fall_due(due);
            events.extend(self.follow_up());
        }
        self.floor.now = to;
        events
    }

    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus> {
        self.goal_status(*self.floor.robots.get(robot)?, id)
    }

    fn goals(&self, robot: &RobotId) -> Vec<GoalId> {
        self.floor.robots.get(robot).map_or(vec![], |robot| self.goals_of(*robot))
    }

    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal> {
        self.goal_of(*self.floor.robots.get(robot)?, id)
    }

    fn asks(&self) -> Vec<GoalId> {
        if self.floor.has::<Asks>() { self.floor.own::<Asks>().unended() } else { vec![] }
    }

    fn answer(&self, id: GoalId) -> Option<Result<(), ActionError>> {
        if self.floor.has::<Asks>() { self.floor.own::<Asks>().answer(id) } else { None }
    }

    fn was_dismissed(&self, id: GoalId) -> bool {
        self.floor.has::<Asks>() && self.floor.own::<Asks>().was_withdrawn(id)
    }

    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        let robot = *self.floor.robots.get(robot)?;
        let floor = &self.floor;
        let whereabouts = floor.get::<Whereabouts>(robot);
        let battery = floor.find::<Battery>(robot);
        Some(Telemetry {
            time: self.now(),
            pose: whereabouts.pose(floor.now),
            place: floor.map.at(whereabouts.spot(floor.now).last_place()).id.clone(),
            battery: battery.as_ref().map_or(BatteryShare::FULL, |battery| battery.at(floor.now)),
            able: battery.is_none_or(|battery| battery.able),
            closed: floor.closed_ways(robot),
        })
    }

    fn report(&self) -> serde_json::Value {
        let (samples, people, doors) = (self.samples(), self.people(), self.doors());
        serde_json::json!({ "time_s": self.floor.now, "samples": samples, "people": people, "doors": doors })
    }
}
