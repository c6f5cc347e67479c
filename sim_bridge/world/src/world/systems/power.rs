//! Charge as a function of time.
//!
//! While a robot has an active goal, its battery loses charge at the discharge rate, times the multiple that
//! the action declares; otherwise at that rate times the idle factor. Docked at a charger, it also gains charge: the power of the
//! charger over the capacity of the battery, or the charging rate of the robot if either is unknown,
//! as far as the charging curve permits. Between two such changes the charge is linear, so the instant
//! at which it crosses the stopping share or reaches the next step of the curve is known in advance and
//! is scheduled.

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
use consort_skills::actions::{ActionError, BackendEvent, ErrorCode, Goal, GoalId, GoalStatus};
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
    /// Timer of its depletion, or of the next step of the charging curve.
    timer: Option<TimerId>,
    /// Charge at the next step of the charging curve.
    next_step: Option<f64>,
}

/// Numbers of the timers.
const DEPLETION: u64 = 0;
const CURVE_STEP: u64 = 1;

impl Battery {
    pub(crate) fn new(charge: BatteryShare) -> Self {
        Self { charge: charge.get(), since: 0.0, rate: 0.0, able: true, timer: None, next_step: None }
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

    /// Returns the instant at which the battery reaches the next step of the charging curve, if it does.
    fn step_time(&self) -> Option<f64> {
        let step = self.next_step.filter(|_| self.rate != 0.0)?;
        Some(self.since + (self.charge - step) / self.rate).filter(|time| time.is_finite())
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

    fn on_timer(&self, state: &mut SimState, SystemTimer { entity: robot, number }: SystemTimer) {
        if number == CURVE_STEP {
            return state.begin_curve_step(robot);
        }
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
            WorldEvent::GoalEnded { robot, id, status } => {
                if let (Some(robot), GoalStatus::Succeeded(_)) = (state.robots.get(robot).copied(), status)
                    && state.renews_battery(robot, *id)
                {
                    state.renew_battery(robot);
                }
                (robot, false)
            }
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
        self.run_as(&Power, |state| state.renew_battery(robot));
    }
}

impl SimState {
    /// Checks whether an ended goal gives its robot a full battery.
    fn renews_battery(&self, robot: Entity, goal: GoalId) -> bool {
        let goals = self.get::<GoalHistory>(robot);
        goals.ended_action(goal).is_some_and(|action| self.renewing_actions.contains(action))
    }

    fn renew_battery(&mut self, robot: Entity) {
        self.get_mut::<Battery>(robot).able = true;
        self.set_charge(robot, BatteryShare::FULL);
    }

    /// Changes the discharge rate at the start or end of a goal.
    fn set_working(&mut self, robot: Entity, working: bool) {
        let docked = self.find::<Docked>(robot).is_some_and(|docked| docked.0);
        let now = self.now;
        let charge = self.get::<Battery>(robot).at(now).get();
        let loss = self.get::<SimRobot>(robot).0.rate(working).get() * self.discharge_multiple(robot, working);
        let full_gain = if docked { self.charging_rate(robot).get() } else { 0.0 };
        let curve = &self.charging_curve;
        let [above, below] = [curve.power_at(charge), curve.power_below(charge)].map(|power| loss - full_gain * power);
        let (rate, next_step) = if above < 0.0 {
            (above, curve.next_step(charge))
        } else if below > 0.0 {
            (below, curve.step_below(charge).filter(|_| docked))
        } else {
            // At a step from which on it would lose charge, the battery keeps its charge.
            (0.0, None)
        };
        let (old, next) = {
            let mut battery = self.get_mut::<Battery>(robot);
            (battery.charge, battery.since, battery.rate, battery.next_step) = (charge, now, rate, next_step);
            let depletion = battery.depletion_time().map(|time| (time, DEPLETION));
            let step = battery.step_time().map(|time| (time, CURVE_STEP));
            let next = depletion.into_iter().chain(step).min_by(|(one, _), (other, _)| one.total_cmp(other));
            (battery.timer.take(), next)
        };
        if let Some(timer) = old {
            self.queue.cancel(timer);
        }
        let timer = next.map(|(time, number)| self.schedule(time, robot, number));
        self.get_mut::<Battery>(robot).timer = timer;
    }

    /// Returns the multiple of its discharge rate with which a robot performs its goal.
    fn discharge_multiple(&self, robot: Entity, working: bool) -> f64 {
        if !working || self.discharge_of_actions.is_empty() {
            return 1.0;
        }
        let goals = self.get::<GoalHistory>(robot);
        goals.action().and_then(|action| self.discharge_of_actions.get(action)).copied().unwrap_or(1.0)
    }

    /// Begins the next step of the charging curve.
    fn begin_curve_step(&mut self, robot: Entity) {
        let (now, working) = (self.now, self.get::<GoalHistory>(robot).is_busy());
        {
            let mut battery = self.get_mut::<Battery>(robot);
            battery.timer = None;
            if let Some(step) = battery.next_step.take() {
                (battery.charge, battery.since) = (step, now);
            }
        }
        self.set_working(robot, working);
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
            battery.timer = None;
        }
        self.set_working(robot, false);
    }
}
