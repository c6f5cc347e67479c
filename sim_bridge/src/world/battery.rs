//! Charge as a function of time.
//!
//! While a robot has a goal under way its battery loses its discharge rate; otherwise that rate times its idle factor.
//! Between two such changes the charge is a straight line, so the instant at which it crosses the stopping share is
//! known beforehand and stands in the queue.

use super::components::Body;
use super::goals::GoalBook;
use super::queue::Ticket;
use super::{Due, World};
use consort_protocol::ids::RobotId;
use consort_protocol::units::BatteryShare;
use hecs::Entity;

/// Below this share of a full battery a robot stops dead: 5 %, as in the published evaluation (thesis 4.1.2).
pub const STOPPING_SHARE: f64 = 0.05;

/// An idle robot loses this part of its discharge rate: 0.1, as in the published rig.
pub const fn default_idle_factor() -> f64 {
    0.1
}

/// A robot's battery.
pub(super) struct Battery {
    /// Share of a full one at `since`.
    charge: f64,
    since: f64,
    /// Share lost per second from `since` on.
    rate: f64,
    /// False once the charge fell to the stopping share.
    pub(super) able: bool,
    strands: Option<Ticket>,
}

impl Battery {
    pub(super) fn new(charge: BatteryShare) -> Self {
        Self { charge: charge.get(), since: 0.0, rate: 0.0, able: true, strands: None }
    }

    /// Charge left at an instant after the latest change; never below empty.
    pub(super) fn at(&self, time: f64) -> BatteryShare {
        let left = self.charge - self.rate * (time - self.since);
        BatteryShare::new(left.clamp(0.0, 1.0)).expect("clamped to a share")
    }

    /// When the charge reaches the stopping share; `None` if it never does, or has before.
    fn crosses(&self) -> Option<f64> {
        let above = self.charge - STOPPING_SHARE;
        match self.able {
            false => None,
            true if above <= 0.0 => Some(self.since),
            // No time at all is infinite for a battery that loses nothing.
            true => Some(self.since + above / self.rate).filter(|time| time.is_finite()),
        }
    }
}

impl World {
    /// From now on the robot works, or idles; the line of its charge bends here.
    pub(super) fn set_working(&mut self, robot: Entity, working: bool) {
        let rate = self.get::<Body>(robot).0.rate(working).get();
        let now = self.now;
        let (old, crosses) = {
            let mut battery = self.get_mut::<Battery>(robot);
            battery.charge = battery.at(now).get();
            (battery.since, battery.rate) = (now, rate);
            (battery.strands.take(), battery.crosses())
        };
        if let Some(ticket) = old {
            self.queue.take_back(ticket);
        }
        let ticket = crosses.map(|time| self.queue.arrange(time, Due::Strands(robot)));
        self.get_mut::<Battery>(robot).strands = ticket;
    }

    /// From one moment to the next a robot has this charge, whatever it had before: a battery that fails, or is filled. A
    /// robot that stands with an empty battery stays where it is all the same (but see
    /// [`exchange_battery`](Self::exchange_battery)). Of a robot that is not here nothing is said.
    pub fn set_charge(&mut self, robot: &RobotId, charge: BatteryShare) {
        let Some(robot) = self.robots.get(robot).copied() else { return };
        let (now, working) = (self.now, self.get::<GoalBook>(robot).is_busy());
        {
            let mut battery = self.get_mut::<Battery>(robot);
            (battery.charge, battery.since) = (charge.get(), now);
        }
        self.set_working(robot, working);
    }

    /// Somebody gives a robot a full battery: one that stood with an empty battery can move again, from where it stands.
    pub fn exchange_battery(&mut self, robot: &RobotId) {
        if let Some(entity) = self.robots.get(robot).copied() {
            self.get_mut::<Battery>(entity).able = true;
        }
        self.set_charge(robot, BatteryShare::FULL);
    }

    /// The charge has come down to the stopping share. What is left drains on at the idle rate.
    pub(super) fn run_down(&mut self, robot: Entity) {
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
