//! Charge as a function of time.
//!
//! While a robot has an active goal, its battery loses charge at the discharge rate, otherwise at
//! that rate times the idle factor. Docked at a charger, it also gains charge: the power of the
//! charger over the capacity of the battery, or the charging rate of the robot if either is unknown.
//! Between two such changes the charge is linear, so the instant at which it crosses the stopping
//! share is known in advance and is scheduled.

use crate::component_types;
use crate::world::components::SimRobot;
use crate::world::event::WorldEvent;
use crate::world::event_queue::TimerId;
use crate::world::goal_history::GoalHistory;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::setup::RobotSetup;
use crate::world::sim_state::SimState;
use crate::world::simulation::World;
use crate::world::system::System;
use crate::world::system_access::{ComponentType, SystemTimer};
use crate::world::systems::docking::Docked;
use consort_protocol::ids::RobotId;
use consort_protocol::units::{BatteryShare, SharePerSecond};
use consort_skills::actions::{ActionError, BackendEvent, ErrorCode, Goal};
use hecs::Entity;

/// State of charge below which a robot stops: 5 %, as in the published evaluation (thesis 4.1.2).
pub const STOPPING_SHARE: f64 = 0.05;

/// A robot's battery.
pub(crate) struct Battery {
    /// State of charge at `since`.
    charge: f64,
    since: f64,
    /// Share lost per second from `since` on; negative while charging.
    rate: f64,
    /// False once the charge has fallen to the stopping share.
    pub(crate) able: bool,
    depletion_timer: Option<TimerId>,
}

impl Battery {
    pub(crate) fn new(charge: BatteryShare) -> Self {
        Self { charge: charge.get(), since: 0.0, rate: 0.0, able: true, depletion_timer: None }
    }

    /// Returns the charge at an instant after the latest change; never below empty.
    pub(crate) fn at(&self, time: f64) -> BatteryShare {
        let left = self.charge - self.rate * (time - self.since);
        BatteryShare::new(left.clamp(0.0, 1.0)).expect("clamped to a share")
    }

    /// Returns the instant at which the charge reaches the stopping share; `None` if it never does,
    /// or already has.
    fn depletion_time(&self) -> Option<f64> {
        let above = self.charge - STOPPING_SHARE;
        match self.able {
            false => None,
            true if above <= 0.0 => Some(self.since),
            true if self.rate <= 0.0 => None,
            true => Some(self.since + above / self.rate).filter(|time| time.is_finite()),
        }
    }
}

/// See the [module](self).
pub(crate) struct Power;

impl System for Power {
    fn name(&self) -> &'static str {
        "power"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot, Docked, GoalHistory, RobotLocation]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![Battery]
    }

    fn init_robot(&self, state: &mut SimState, robot: Entity, body: &RobotSetup) {
        state.insert(robot, Battery::new(body.battery));
        state.set_working(robot, false);
    }

    fn check_goal_allowed(&self, state: &SimState, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        if state.get::<Battery>(robot).able { Ok(()) } else { Err(state.low_battery_error(robot)) }
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { entity: robot, .. }: SystemTimer) {
        state.deplete(robot);
        let error = state.low_battery_error(robot);
        state.abort_goal(robot, error);
        let robot = state.robot_id(robot);
        state.log_after_commands(WorldEvent::Stranded { robot: robot.clone() });
        state.emit(BackendEvent::Stranded { robot });
    }

    fn on_event(&self, state: &mut SimState, event: &WorldEvent) {
        let (robot, working) = match event {
            WorldEvent::GoalStarted { robot, .. } => (robot, true),
            WorldEvent::GoalEnded { robot, .. } => (robot, false),
            WorldEvent::Docked { robot, .. } => {
                if let Some(robot) = state.robots.get(robot).copied() {
                    let working = state.get::<GoalHistory>(robot).is_busy();
                    state.set_working(robot, working);
                }
                return;
            }
            _ => return,
        };
        if let Some(robot) = state.robots.get(robot).copied()
            && state.get::<GoalHistory>(robot).is_busy() == working
        {
            state.set_working(robot, working);
        }
    }
}

impl World {
    /// Sets the charge of a robot, for a battery that fails or is filled. A robot that stands with
    /// an empty battery still does not move (but see [`replace_battery`](Self::replace_battery)).
    /// An unknown robot is ignored.
    pub fn set_charge(&mut self, robot: &RobotId, charge: BatteryShare) {
        let Some(robot) = self.state.robots.get(robot).copied() else { return };
        self.run_as(&Power, |state| state.set_charge(robot, charge));
    }

    /// Gives a robot a full battery. A robot that stood with an empty battery can move again.
    pub fn replace_battery(&mut self, robot: &RobotId) {
        let Some(robot) = self.state.robots.get(robot).copied() else { return };
        self.run_as(&Power, |state| {
            state.get_mut::<Battery>(robot).able = true;
            state.set_charge(robot, BatteryShare::FULL);
        });
    }
}

impl SimState {
    /// Changes the discharge rate at the start or end of a goal.
    fn set_working(&mut self, robot: Entity, working: bool) {
        let docked = self.find::<Docked>(robot).is_some_and(|docked| docked.0);
        let gain = if docked { self.charging_rate(robot).get() } else { 0.0 };
        let rate = self.get::<SimRobot>(robot).0.rate(working).get() - gain;
        let now = self.now;
        let (old, depletion_time) = {
            let mut battery = self.get_mut::<Battery>(robot);
            battery.charge = battery.at(now).get();
            (battery.since, battery.rate) = (now, rate);
            (battery.depletion_timer.take(), battery.depletion_time())
        };
        if let Some(timer) = old {
            self.queue.cancel(timer);
        }
        let timer = depletion_time.map(|time| self.schedule(time, robot, 0));
        self.get_mut::<Battery>(robot).depletion_timer = timer;
    }

    /// Returns the share per second that a docked robot gains.
    fn charging_rate(&self, robot: Entity) -> SharePerSecond {
        let place = self.require_place(robot).ok().map(|place| &self.map.place_at(place).id);
        let power = place.and_then(|place| self.chargers.get(place).copied().flatten());
        let body = &self.get::<SimRobot>(robot).0;
        match (power, body.capacity) {
            (Some(power), Some(capacity)) => power.fills(capacity),
            _ => body.charging,
        }
    }

    fn set_charge(&mut self, robot: Entity, charge: BatteryShare) {
        let (now, working) = (self.now, self.get::<GoalHistory>(robot).is_busy());
        {
            let mut battery = self.get_mut::<Battery>(robot);
            (battery.charge, battery.since) = (charge.get(), now);
        }
        self.set_working(robot, working);
    }

    fn low_battery_error(&self, robot: Entity) -> ActionError {
        let left = self.get::<Battery>(robot).at(self.now);
        action_error(
            ErrorCode::BatteryLow,
            format!("the battery of {} is down to {}", self.robot_id(robot), left.percent()),
        )
    }

    /// Handles the fall to the stopping share. The rest drains at the idle rate.
    fn deplete(&mut self, robot: Entity) {
        let now = self.now;
        {
            let mut battery = self.get_mut::<Battery>(robot);
            battery.charge = battery.charge.min(STOPPING_SHARE);
            (battery.since, battery.able) = (now, false);
            battery.depletion_timer = None;
        }
        self.set_working(robot, false);
    }
}
