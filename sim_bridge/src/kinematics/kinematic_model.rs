//! Any body that moves, with the clock of its control loop.

use super::avoidance::Neighbour;
use super::motion_math::TIME_EPSILON_S;
use super::settings::Kinematics;
use super::{Ackermann, Aerial, Differential, Omnidirectional};
use nalgebra::{Isometry2, Vector3};

/// A body that moves. It is told where to be and how much time passes, and says when it is there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KinematicModel {
    chassis: Chassis,
    period_s: f64,
    /// Time until its control loop decides again.
    decides_in_s: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Chassis {
    Differential(Differential),
    Omnidirectional(Omnidirectional),
    Ackermann(Ackermann),
    Aerial(Aerial),
}

/// Has whatever model it is do the same.
macro_rules! any {
    ($chassis:expr, $model:ident => $does:expr) => {
        match $chassis {
            Chassis::Differential($model) => $does,
            Chassis::Omnidirectional($model) => $does,
            Chassis::Ackermann($model) => $does,
            Chassis::Aerial($model) => $does,
        }
    };
}

impl KinematicModel {
    /// A body that stands at a pose, drives at most `top_mps` metres per second, and is `radius_m` metres from its middle
    /// to its outermost part.
    pub fn new(kinematics: &Kinematics, top_mps: f64, radius_m: f64, pose: Isometry2<f64>) -> KinematicModel {
        let (chassis, period_s) = match *kinematics {
            Kinematics::Differential(settings) => {
                (Chassis::Differential(Differential::new(settings, top_mps, pose)), settings.control_period_s)
            }
            Kinematics::Omnidirectional(settings) => {
                (Chassis::Omnidirectional(Omnidirectional::new(settings, top_mps, pose)), settings.control_period_s)
            }
            Kinematics::Ackermann(settings) => {
                (Chassis::Ackermann(Ackermann::new(settings, top_mps, pose)), settings.control_period_s)
            }
            Kinematics::Aerial(settings) => {
                (Chassis::Aerial(Aerial::new(settings, top_mps, radius_m, &pose)), settings.control_period_s)
            }
        };
        KinematicModel { chassis, period_s, decides_in_s: 0.0 }
    }

    /// Has it go to a pose, whatever it was about.
    pub fn set_target(&mut self, target: Isometry2<f64>) {
        any!(&mut self.chassis, model => model.aim(Some(target)));
    }

    /// The same with its back in front, if it has one: what moves in every direction does not care.
    pub fn set_target_backward(&mut self, target: Isometry2<f64>) {
        match &mut self.chassis {
            Chassis::Differential(model) => model.back(target),
            Chassis::Ackermann(model) => model.back(target),
            Chassis::Omnidirectional(_) | Chassis::Aerial(_) => self.set_target(target),
        }
    }

    /// From now on it drives at most so many metres per second.
    pub fn set_max_speed(&mut self, top_mps: f64) {
        any!(&mut self.chassis, model => model.top_mps = top_mps);
    }

    /// It stands, and looks where it is told at once, in radians.
    pub fn set_heading(&mut self, yaw: f64) {
        any!(&mut self.chassis, model => model.turn_to(yaw));
    }

    /// Has it come to a stop as soon as its brakes allow; in the air it hovers then.
    pub fn brake(&mut self) {
        any!(&mut self.chassis, model => model.aim(None));
    }

    /// It stands from one instant to the next: it ran into something.
    pub fn stop_immediately(&mut self) {
        any!(&mut self.chassis, model => model.stop_dead());
    }

    /// Lets `dt_s` seconds pass among others, as they are now. The answer is how many of them had passed when it arrived,
    /// if it did. Only what flies makes way for others.
    pub fn advance(&mut self, dt_s: f64, around: &[Neighbour]) -> Option<f64> {
        let (mut passed, mut arrived) = (0.0, None);
        while dt_s - passed > TIME_EPSILON_S {
            if self.decides_in_s <= TIME_EPSILON_S {
                if self.decide(around) {
                    arrived = Some(passed);
                }
                self.decides_in_s = self.period_s;
            }
            let slice = self.decides_in_s.min(dt_s - passed);
            any!(&mut self.chassis, model => model.coast(slice));
            self.decides_in_s -= slice;
            passed += slice;
        }
        arrived
    }

    fn decide(&mut self, around: &[Neighbour]) -> bool {
        match &mut self.chassis {
            Chassis::Differential(model) => model.decide(self.period_s),
            Chassis::Omnidirectional(model) => model.decide(self.period_s),
            Chassis::Ackermann(model) => model.decide(self.period_s),
            Chassis::Aerial(model) => model.decide(self.period_s, around),
        }
    }

    /// Whether it moves or is about to: if not, nothing comes of letting time pass.
    pub fn is_moving(&self) -> bool {
        any!(&self.chassis, model => model.is_moving())
    }

    /// Where it is, seen from above.
    pub fn pose(&self) -> Isometry2<f64> {
        match &self.chassis {
            Chassis::Differential(model) => *model.pose(),
            Chassis::Omnidirectional(model) => *model.pose(),
            Chassis::Ackermann(model) => *model.pose(),
            Chassis::Aerial(model) => model.pose_above(),
        }
    }

    /// Where its middle is: x, y and height above the floor, in metres.
    pub fn position(&self) -> Vector3<f64> {
        match &self.chassis {
            Chassis::Aerial(model) => *model.position(),
            Chassis::Differential(_) | Chassis::Omnidirectional(_) | Chassis::Ackermann(_) => {
                let at = self.pose().translation.vector;
                Vector3::new(at.x, at.y, 0.0)
            }
        }
    }

    /// How far it is to where it is to be, in metres; 0 if it is told to be nowhere else.
    pub fn remaining_m(&self) -> f64 {
        any!(&self.chassis, model => model.remaining_m())
    }

    /// How far around it has to look for others, from middle to middle, if none is larger than `radius_m`; none if it
    /// makes way for nobody.
    pub fn neighbour_range_m(&self, radius_m: f64) -> Option<f64> {
        match &self.chassis {
            Chassis::Aerial(model) => Some(model.looks_m(radius_m)),
            Chassis::Differential(_) | Chassis::Omnidirectional(_) | Chassis::Ackermann(_) => None,
        }
    }

    /// A gust: a body in the air is pushed, one on the floor is not.
    pub fn push(&mut self, by: Vector3<f64>) {
        if let Chassis::Aerial(model) = &mut self.chassis {
            model.push(by);
        }
    }

    /// Whether it is in the air and holds its place there.
    pub fn is_hovering(&self) -> bool {
        matches!(&self.chassis, Chassis::Aerial(model) if model.is_holding())
    }

    /// The differential drive that it is, if it is one.
    pub fn as_differential(&self) -> Option<&Differential> {
        if let Chassis::Differential(model) = &self.chassis { Some(model) } else { None }
    }

    /// The omnidirectional chassis that it is, if it is one.
    pub fn as_omnidirectional(&self) -> Option<&Omnidirectional> {
        if let Chassis::Omnidirectional(model) = &self.chassis { Some(model) } else { None }
    }

    /// The car that it is, if it is one.
    pub fn as_ackermann(&self) -> Option<&Ackermann> {
        if let Chassis::Ackermann(model) = &self.chassis { Some(model) } else { None }
    }

    /// The drone that it is, if it is one.
    pub fn as_aerial(&self) -> Option<&Aerial> {
        if let Chassis::Aerial(model) = &self.chassis { Some(model) } else { None }
    }
}
