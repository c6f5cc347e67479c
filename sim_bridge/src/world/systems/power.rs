//! Charge as a function of time.
//!
//! While a robot has a goal under way its battery loses its discharge rate; otherwise that rate times its idle factor. Docked
//! at a charger it gains its charging rate beside.
//! Between two such changes the charge is a straight line, so the instant at which it crosses the stopping share is
//! known beforehand and stands in the queue.

use crate::world::World;
use crate::world::components::Body;
use crate::world::floor::Floor;
use crate::world::goals::GoalBook;
use crate::world::journal::Happening;
use crate::world::queue::Ticket;
use crate::world::reach::refused;
use crate::world::setup::RobotBody;
use crate::world::system::{Kind, System, Wake, kinds};
use crate::world::systems::docking::Docked;
use consort_protocol::ids::RobotId;
use consort_protocol::units::BatteryShare;
use consort_skills::actions::{ActionError, BodyEvent, ErrorCode, Goal};
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
    strands: Option<Ticket>,
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

    fn reads(&self) -> Vec<Kind> {
        kinds![Body, Docked, GoalBook]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Battery]
    }

    fn equip(&self, floor: &mut Floor, robot: Entity, body: &RobotBody) {
        floor.give(robot, Battery::new(body.battery));
        floor.set_working(robot, false);
    }

    fn permit(&self, floor: &Floor, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        if floor.get::<Battery>(robot).able { Ok(()) } else { Err(floor.too_low(robot)) }
    }

    fn wake(&self, floor: &mut Floor, Wake { about: robot, .. }: Wake) {
        floor.run_down(robot);
        let why = floor.too_low(robot);
        floor.break_off(robot, why);
        let robot = floor.name(robot);
        floor.note_then(Happening::Stranded { robot: robot.clone() });
        floor.say(BodyEvent::Stranded { robot });
    }

    fn observe(&self, floor: &mut Floor, what: &Happening) {
        let (robot, working) = match what {
            Happening::GoalBegan { robot, .. } => (robot, true),
            Happening::GoalEnded { robot, .. } => (robot, false),
            Happening::Docked { robot, .. } => {
                if let Some(robot) = floor.robots.get(robot).copied() {
                    let working = floor.get::<GoalBook>(robot).is_busy();
                    floor.set_working(robot, working);
                }
                return;
            }
            _ => return,
        };
        if let Some(robot) = floor.robots.get(robot).copied()
            && floor.get::<GoalBook>(robot).is_busy() == working
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
        let Some(robot) = self.floor.robots.get(robot).copied() else { return };
        self.have(&Power, |floor| floor.set_charge(robot, charge));
    }

    /// Somebody gives a robot a full battery: one that stood with an empty battery can move again, from where it stands.
    pub fn exchange_battery(&mut self, robot: &RobotId) {
        let Some(robot) = self.floor.robots.get(robot).copied() else { return };
        self.have(&Power, |floor| {
            floor.get_mut::<Battery>(robot).able = true;
            floor.set_charge(robot, BatteryShare::FULL);
        });
    }
}

impl Floor {
    /// From now on the robot works, or idles; the line of its charge bends here.
    fn set_working(&mut self, robot: Entity, working: bool) {
        let charging = self.find::<Docked>(robot).is_some_and(|docked| docked.0);
        let rate = {
            let body = &self.get::<Body>(robot).0;
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
            self.queue.take_back(ticket);
        }
        let ticket = crosses.map(|time| self.arrange(time, robot, 0));
        self.get_mut::<Battery>(robot).strands = ticket;
    }

    fn set_charge(&mut self, robot: Entity, charge: BatteryShare) {
        let (now, working) = (self.now, self.get::<GoalBook>(robot).is_busy());
        {
            let mut battery = self.get_mut::<Battery>(robot);
            (battery.charge, battery.since) = (charge.get(), now);
        }
        self.set_working(robot, working);
    }

    fn too_low(&self, robot: Entity) -> ActionError {
        let left = self.get::<Battery>(robot).at(self.now);
        refused(ErrorCode::BatteryLow, format!("the battery of {} is down to {}", self.name(robot), left.percent()))
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
