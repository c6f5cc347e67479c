//! Any kinematic model, with the clock of its control loop.

use super::ackermann::Ackermann;
use super::aerial::Aerial;
use super::avoidance::Neighbour;
use super::chassis::{ChassisSettings, NamedChassis, OwnChassis, build_chassis};
use super::differential::Differential;
use super::motion_math::TIME_EPSILON_S;
use super::omnidirectional::Omnidirectional;
use super::settings::Kinematics;
use nalgebra::{Isometry2, Vector3};

/// A moving robot. It takes a target and elapsed time, and reports its arrival.
#[derive(Debug)]
pub(crate) struct KinematicModel {
    chassis: Chassis,
    period_s: f64,
    /// Time until the next control cycle.
    decides_in_s: f64,
}

#[derive(Debug)]
enum Chassis {
    Differential(Differential),
    Omnidirectional(Omnidirectional),
    Ackermann(Ackermann),
    Aerial(Aerial),
    Own(OwnChassis),
}

/// Applies the same expression to whichever model it is.
macro_rules! any {
    ($chassis:expr, $model:ident => $does:expr) => {
        match $chassis {
            Chassis::Differential($model) => $does,
            Chassis::Omnidirectional($model) => $does,
            Chassis::Ackermann($model) => $does,
            Chassis::Aerial($model) => $does,
            Chassis::Own(OwnChassis($model)) => $does,
        }
    };
}

impl KinematicModel {
    /// Creates a robot at standstill. `max_mps` is its top speed in metres per second, `radius_m`
    /// the distance from its centre to its outermost part in metres.
    ///
    /// # Panics
    /// If the program has no chassis of the name, or if its settings are invalid: setups are checked before.
    pub(crate) fn new(
        kinematics: &Kinematics,
        max_mps: f64,
        radius_m: f64,
        pose: Isometry2<f64>,
        own_chassis: &[NamedChassis],
    ) -> KinematicModel {
        let (chassis, period_s) = match kinematics {
            Kinematics::Differential(settings) => {
                (Chassis::Differential(Differential::new(*settings, max_mps, pose)), settings.control_period_s)
            }
            Kinematics::Omnidirectional(settings) => {
                (Chassis::Omnidirectional(Omnidirectional::new(*settings, max_mps, pose)), settings.control_period_s)
            }
            Kinematics::Ackermann(settings) => {
                (Chassis::Ackermann(Ackermann::new(*settings, max_mps, pose)), settings.control_period_s)
            }
            Kinematics::Aerial(settings) => {
                (Chassis::Aerial(Aerial::new(*settings, max_mps, radius_m, &pose)), settings.control_period_s)
            }
            Kinematics::Own(own) => {
                let settings = ChassisSettings { numbers: own.settings.clone(), max_mps, radius_m, pose };
                let chassis = build_chassis(own_chassis, &own.name, &settings).expect("checked: the chassis is known");
                (Chassis::Own(chassis.expect("checked: the settings are valid")), own.control_period_s)
            }
        };
        KinematicModel { chassis, period_s, decides_in_s: 0.0 }
    }

    /// Sets a new target pose, replacing the previous target.
    pub(crate) fn set_target(&mut self, target: Isometry2<f64>) {
        any!(&mut self.chassis, model => model.set_target(Some(target)));
    }

    /// Sets a new target pose to be reached in reverse. For models that move in every direction
    /// this is the same as [`set_target`](KinematicModel::set_target).
    pub(crate) fn set_target_backward(&mut self, target: Isometry2<f64>) {
        match &mut self.chassis {
            Chassis::Differential(model) => model.set_target_backward(target),
            Chassis::Ackermann(model) => model.set_target_backward(target),
            Chassis::Omnidirectional(_) | Chassis::Aerial(_) | Chassis::Own(_) => self.set_target(target),
        }
    }

    /// Limits the speed from now on, in metres per second.
    pub(crate) fn set_max_speed(&mut self, max_mps: f64) {
        match &mut self.chassis {
            Chassis::Differential(model) => model.max_mps = max_mps,
            Chassis::Omnidirectional(model) => model.max_mps = max_mps,
            Chassis::Ackermann(model) => model.max_mps = max_mps,
            Chassis::Aerial(model) => model.max_mps = max_mps,
            Chassis::Own(OwnChassis(model)) => model.set_max_speed(max_mps),
        }
    }

    /// Sets the heading of a robot at standstill, in radians, at once.
    pub(crate) fn set_heading(&mut self, yaw: f64) {
        any!(&mut self.chassis, model => model.set_heading(yaw));
    }

    /// Brakes to a standstill as fast as the brakes allow. A drone hovers afterwards.
    pub(crate) fn brake(&mut self) {
        any!(&mut self.chassis, model => model.set_target(None));
    }

    /// Stops instantly, after a collision.
    pub(crate) fn stop_immediately(&mut self) {
        any!(&mut self.chassis, model => model.stop_immediately());
    }

    /// Advances time by `dt_s` seconds among other bodies at their current positions. Returns the
    /// seconds that had passed on arrival, if the robot arrived. Only drones avoid other bodies.
    pub(crate) fn advance(&mut self, dt_s: f64, around: &[Neighbour]) -> Option<f64> {
        let (mut elapsed, mut arrived) = (0.0, None);
        while dt_s - elapsed > TIME_EPSILON_S {
            if self.decides_in_s <= TIME_EPSILON_S {
                if self.control_step(around) {
                    arrived = Some(elapsed);
                }
                self.decides_in_s = self.period_s;
            }
            let slice = self.decides_in_s.min(dt_s - elapsed);
            any!(&mut self.chassis, model => model.integrate(slice));
            self.decides_in_s -= slice;
            elapsed += slice;
        }
        arrived
    }

    fn control_step(&mut self, around: &[Neighbour]) -> bool {
        match &mut self.chassis {
            Chassis::Differential(model) => model.control_step(self.period_s),
            Chassis::Omnidirectional(model) => model.control_step(self.period_s),
            Chassis::Ackermann(model) => model.control_step(self.period_s),
            Chassis::Aerial(model) => model.control_step(self.period_s, around),
            Chassis::Own(OwnChassis(model)) => model.control_step(self.period_s),
        }
    }

    /// Checks whether the robot moves or is about to. If not, advancing time has no effect.
    pub(crate) fn is_moving(&self) -> bool {
        any!(&self.chassis, model => model.is_moving())
    }

    /// Current pose, projected onto the floor.
    pub(crate) fn pose(&self) -> Isometry2<f64> {
        match &self.chassis {
            Chassis::Differential(model) => *model.pose(),
            Chassis::Omnidirectional(model) => *model.pose(),
            Chassis::Ackermann(model) => *model.pose(),
            Chassis::Aerial(model) => model.pose_above(),
            Chassis::Own(OwnChassis(model)) => model.pose(),
        }
    }

    /// Position of the centre: x, y and height above the floor, in metres.
    pub(crate) fn position(&self) -> Vector3<f64> {
        match &self.chassis {
            Chassis::Aerial(model) => *model.position(),
            Chassis::Differential(_) | Chassis::Omnidirectional(_) | Chassis::Ackermann(_) | Chassis::Own(_) => {
                let at = self.pose().translation.vector;
                Vector3::new(at.x, at.y, 0.0)
            }
        }
    }

    /// Distance to the target in metres; 0 without a target.
    pub(crate) fn remaining_m(&self) -> f64 {
        any!(&self.chassis, model => model.remaining_m())
    }

    /// Returns the distance, from centre to centre, within which the robot must consider other
    /// bodies with a radius of at most `radius_m`; `None` if the model avoids no other bodies.
    pub(crate) fn neighbour_range_m(&self, radius_m: f64) -> Option<f64> {
        match &self.chassis {
            Chassis::Aerial(model) => Some(model.neighbour_range_m(radius_m)),
            Chassis::Differential(_) | Chassis::Omnidirectional(_) | Chassis::Ackermann(_) | Chassis::Own(_) => None,
        }
    }

    /// Applies a gust. It pushes a robot in the air, and has no effect on the floor.
    pub(crate) fn push(&mut self, by: Vector3<f64>) {
        if let Chassis::Aerial(model) = &mut self.chassis {
            model.push(by);
        }
    }

    /// Checks whether the robot is in the air and holds its position there.
    pub(crate) fn is_hovering(&self) -> bool {
        matches!(&self.chassis, Chassis::Aerial(model) if model.is_holding())
    }

    /// Returns a copy of a shipped model.
    #[cfg(test)]
    pub(crate) fn copy(&self) -> KinematicModel {
        let chassis = match &self.chassis {
            Chassis::Differential(model) => Chassis::Differential(*model),
            Chassis::Omnidirectional(model) => Chassis::Omnidirectional(*model),
            Chassis::Ackermann(model) => Chassis::Ackermann(*model),
            Chassis::Aerial(model) => Chassis::Aerial(*model),
            Chassis::Own(_) => unreachable!("not a shipped model"),
        };
        KinematicModel { chassis, ..*self }
    }

    /// The differential drive, if this model is a differential drive.
    #[cfg(test)]
    pub(crate) fn as_differential(&self) -> Option<&Differential> {
        if let Chassis::Differential(model) = &self.chassis { Some(model) } else { None }
    }

    /// The omnidirectional chassis, if this model is omnidirectional.
    #[cfg(test)]
    pub(crate) fn as_omnidirectional(&self) -> Option<&Omnidirectional> {
        if let Chassis::Omnidirectional(model) = &self.chassis { Some(model) } else { None }
    }

    /// The car, if this model is a car.
    #[cfg(test)]
    pub(crate) fn as_ackermann(&self) -> Option<&Ackermann> {
        if let Chassis::Ackermann(model) = &self.chassis { Some(model) } else { None }
    }

    /// The drone, if this model is a drone.
    #[cfg(test)]
    pub(crate) fn as_aerial(&self) -> Option<&Aerial> {
        if let Chassis::Aerial(model) = &self.chassis { Some(model) } else { None }
    }
}
