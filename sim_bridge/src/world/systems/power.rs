//! Charge as a function of time.
//!
//! While a robot has a goal under way its battery loses its discharge rate; otherwise that rate times its idle factor. Docked
//! at a charger it gains its charging rate beside.
//! Between two such changes the charge is a straight line, so the instant at which it crosses the stopping share is
//! known beforehand and stands in the queue.

use crate::world::World;
use crate::world::components::SimRobot;
use crate::world::event_log::WorldEvent;
use crate::world::event_queue::TimerId;
use crate::world::goals::GoalHistory;
use crate::world::preconditions::action_error;
use crate::world::setup::RobotSetup;
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, SystemTimer, kinds};
use crate::world::systems::docking::Docked;
use consort_protocol::ids::RobotId;
use consort_protocol::units::BatteryShare;
use consort_skills::actions::{ActionError, BackendEvent, ErrorCode, Goal};
use hecs::Entity;

/// Below this share of a full battery a robot stops dead: 5 %, as in the published evaluation (thesis 4.1.2).
pub const STOPPING_SHARE: f64 = 0.05;

/// An idle robot loses this part of its discharge rate: 0.1, as in the published rig.
pub const fn default_idle_factor() -> f64 {
    0.1
}

/// A robot's battery.
pub(crate) struct Battery {
    /// Share of a full one at `since`.
    charge: f64,
    since: f64,
    /// Share lost per second from `since` on; negative while it charges.
    rate: f64,
    /// False once the charge fell to the stopping share.
    pub(crate) able: bool,
    strands: Option<TimerId>,
}

impl Battery {
    pub(crate) fn new(charge: BatteryShare) -> Self {
        Self { charge: charge.get(), since: 0.0, rate: 0.0, able: true, strands: None }
    }

    /// Charge left at an instant after the latest change; never below empty.
    pub(crate) fn at(&self, time: f64) -> BatteryShare {
        let left = self.charge - self.rate * (time - self.since);
        BatteryShare::new(left.clamp(0.0, 1.0)).expect("clamped to a share")
    }

    /// When the charge reaches the stopping share; `None` if it never does, or has before.
    fn crosses(&self) -> Option<f64> {
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
        kinds![SimRobot, Docked, GoalHistory]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![Battery]
    }

    fn init_robot(&self, floor: &mut SimState, robot: Entity, body: &RobotSetup) {
        floor.insert(robot, Battery::new(body.battery));
        floor.set_working(robot, false);
    }

    fn check_goal_allowed(&self, floor: &SimState, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        if floor.get::<Battery>(robot).able { Ok(()) } else { Err(floor.too_low(robot)) }
    }

    fn on_timer(&self, floor: &mut SimState, SystemTimer { entity: robot, .. }: SystemTimer) {
        floor.run_down(robot);
        let why = floor.too_low(robot);
        floor.abort_goal(robot, why);
        let robot = floor.robot_id(robot);
        floor.log_after_commands(WorldEvent::Stranded { robot: robot.clone() });
        floor.emit(BackendEvent::Stranded { robot });
    }

    fn on_event(&self, floor: &mut SimState, what: &WorldEvent) {
        let (robot, working) = match what {
            WorldEvent::GoalStarted { robot, .. } => (robot, true),
            WorldEvent::GoalEnded { robot, .. } => (robot, false),
            WorldEvent::Docked { robot, .. } => {
                if let Some(robot) = floor.robots.get(robot).copied() {
                    let working = floor.get::<GoalHistory>(robot).is_busy();
                    floor.set_working(robot, working);
                }
                return;
            }
            _ => return,
        };
        if let Some(robot) = floor.robots.get(robot).copied()
            && floor.get::<GoalHistory>(robot).is_busy() == working
        {
            floor.set_working(robot, working);
        }
    }
}

impl World {
    /// From one moment to the next a robot has this charge, whatever it had before: a battery that fails, or is filled. A
    /// robot that stands with an empty battery stays where it is all the same (but see
    /// [`exchange_battery`](Self::exchange_battery)). Of a robot that is not here nothing is said.
    pub fn set_charge(&mut self, robot: &RobotId, charge: BatteryShare) {
        let Some(robot) = self.state.robots.get(robot).copied() else { return };
        self.run_as(&Power, |floor| floor.set_charge(robot, charge));
    }

    /// Somebody gives a robot a full battery: one that stood with an empty battery can move again, from where it stands.
    pub fn replace_battery(&mut self, robot: &RobotId) {
        let Some(robot) = self.state.robots.get(robot).copied() else { return };
        self.run_as(&Power, |floor| {
            floor.get_mut::<Battery>(robot).able = true;
            floor.set_charge(robot, BatteryShare::FULL);
        });
    }
}

impl SimState {
    /// From now on the robot works, or idles; the line of its charge bends here.
    fn set_working(&mut self, robot: Entity, working: bool) {
        let charging = self.find::<Docked>(robot).is_some_and(|docked| docked.0);
        let rate = {
            let body = &self.get::<SimRobot>(robot).0;
            body.rate(working).get() - if charging { body.charging.get() } else { 0.0 }
        };
        let now = self.now;
        let (old, crosses) = {
            let mut battery = self.get_mut::<Battery>(robot);
            battery.charge = battery.at(now).get();
            (battery.since, battery.rate) = (now, rate);
            (battery.strands.take(), battery.crosses())
        };
        if let Some(ticket) = old {
            self.queue.cancel(ticket);
        }
        let ticket = crosses.map(|time| self.schedule(time, robot, 0));
        self.get_mut::<Battery>(robot).strands = ticket;
    }

    fn set_charge(&mut self, robot: Entity, charge: BatteryShare) {
        let (now, working) = (self.now, self.get::<GoalHistory>(robot).is_busy());
        {
            let mut battery = self.get_mut::<Battery>(robot);
            (battery.charge, battery.since) = (charge.get(), now);
        }
        self.set_working(robot, working);
    }

    fn too_low(&self, robot: Entity) -> ActionError {
        let left = self.get::<Battery>(robot).at(self.now);
        action_error(
            ErrorCode::BatteryLow,
            format!("the battery of {} is down to {}", self.robot_id(robot), left.percent()),
        )
    }

    /// The charge has come down to the stopping share. What is left drains on at the idle rate.
    fn run_down(&mut self, robot: Entity) {
        let now = self.now;
        {
            let mut battery = self.get_mut::<Battery>(robot);
            battery.charge = battery.charge.min(STOPPING_SHARE);
            (battery.since, battery.able) = (now, false);
            battery.strands = None;
        }
        self.set_working(robot, false);
    }
}
