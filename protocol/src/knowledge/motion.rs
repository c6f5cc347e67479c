//! Motion of a robot: what changes while it drives and works, in steps.

use super::content::RobotKnowledge;
use super::record::RecordStamp;
use crate::ids::PlaceId;
use crate::pose::Pose;
use crate::units::BatteryShare;
use serde::{Deserialize, Serialize};

/// Distance from the sent pose from which on a pose is sent again, in centimetres. Raised: fewer messages, and people see
/// less exact poses. A guess: half the length of a small robot.
const DISTANCE_MIN_CM: f64 = 25.0;

/// Difference from the sent heading from which on a heading is sent again, in degrees: a guess.
const TURN_MIN_DEG: u16 = 15;

/// Difference from the sent charge from which on a charge is sent again. Bids and the robot itself use the exact charge.
const CHARGE_MIN_PERMILLE: u16 = 20;

/// Degrees of a full turn.
const TURN_DEG: u16 = 360;

/// Full battery.
const FULL_PERMILLE: u16 = 1000;

/// Place, pose and charge of a robot, in steps of 1 cm, 1° and 0.1 %. In a large fleet they are sent apart from the record,
/// to the nodes that use them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Motion {
    place: PlaceId,
    x_cm: i32,
    y_cm: i32,
    yaw_deg: u16,
    charge_permille: u16,
}

/// Confirmation of a node's record in a large fleet, with the motion of its robot since then. Only nodes that use it
/// subscribe to it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MotionUpdate {
    /// Latest version of the record.
    pub stamp: RecordStamp,
    /// Grows with each update of this version, so that a late update changes nothing.
    pub number: u64,
    /// Motion of the robot; `None` without a robot, and while the record contains the latest.
    pub motion: Option<Motion>,
}

impl Motion {
    /// Returns the motion of a robot. A pose farther than 20,000 km from the origin is moved to that distance.
    pub fn of(robot: &RobotKnowledge) -> Motion {
        let Pose { x, y, yaw } = robot.pose;
        // A conversion of a float saturates.
        Motion {
            place: robot.place.clone(),
            x_cm: (x * 100.0).round() as i32,
            y_cm: (y * 100.0).round() as i32,
            yaw_deg: yaw.to_degrees().rem_euclid(f64::from(TURN_DEG)).round() as u16 % TURN_DEG,
            charge_permille: (robot.battery.get() * f64::from(FULL_PERMILLE)).round() as u16,
        }
    }

    /// Returns the current or last place.
    pub fn place(&self) -> &PlaceId {
        &self.place
    }

    /// Checks whether the difference from the sent motion exceeds the dead band.
    pub fn is_worth_sending(&self, sent: &Motion) -> bool {
        let (dx, dy) = (f64::from(self.x_cm) - f64::from(sent.x_cm), f64::from(self.y_cm) - f64::from(sent.y_cm));
        let turn = self.yaw_deg.abs_diff(sent.yaw_deg) % TURN_DEG;
        self.place != sent.place
            || dx.hypot(dy) >= DISTANCE_MIN_CM
            || turn.min(TURN_DEG - turn) >= TURN_MIN_DEG
            || self.charge_permille.abs_diff(sent.charge_permille) >= CHARGE_MIN_PERMILLE
    }

    /// Sets place, pose and charge of a robot. Values of other nodes are limited to their ranges.
    pub fn apply_to(&self, robot: &mut RobotKnowledge) {
        let turn = f64::from(self.yaw_deg % TURN_DEG);
        let yaw = if turn > 180.0 { turn - f64::from(TURN_DEG) } else { turn };
        robot.place = self.place.clone();
        robot.pose = Pose::new(f64::from(self.x_cm) / 100.0, f64::from(self.y_cm) / 100.0, yaw.to_radians());
        let charge = f64::from(self.charge_permille.min(FULL_PERMILLE)) / f64::from(FULL_PERMILLE);
        robot.battery = BatteryShare::new(charge).unwrap_or(robot.battery);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec;
    use crate::ensemble::example_robot;
    use proptest::prelude::*;

    fn robot(place: &str, pose: Pose, battery: f64) -> RobotKnowledge {
        let battery = BatteryShare::new(battery).unwrap();
        RobotKnowledge { place: place.parse().unwrap(), pose, battery, ..example_robot() }
    }

    #[test]
    fn a_change_within_the_dead_band_is_not_worth_sending() {
        let sent = Motion::of(&robot("Dock", Pose::new(1.0, 2.0, 0.05), 0.9));
        for (place, x, yaw, battery, expected) in [
            ("Dock", 1.2, 0.05, 0.9, false),
            ("Dock", 1.25, 0.05, 0.9, true),
            ("Lab", 1.0, 0.05, 0.9, true),
            ("Dock", 1.0, -0.05, 0.9, false),
            ("Dock", 1.0, -0.3, 0.9, true),
            ("Dock", 1.0, 0.05, 0.885, false),
            ("Dock", 1.0, 0.05, 0.88, true),
        ] {
            let now = Motion::of(&robot(place, Pose::new(x, 2.0, yaw), battery));
            assert_eq!(now.is_worth_sending(&sent), expected, "{place} {x} {yaw} {battery}");
        }
    }

    #[test]
    fn values_out_of_range_are_limited() {
        let wrong = Pose::new(f64::INFINITY, f64::NAN, f64::NAN);
        let mut limited = robot("Dock", Pose::default(), 0.5);
        Motion::of(&robot("Lab", wrong, 1.0)).apply_to(&mut limited);
        assert_eq!((limited.pose.y, limited.pose.yaw, limited.battery), (0.0, 0.0, BatteryShare::FULL));
        assert!(limited.pose.x.is_finite());
        let foreign = Motion { charge_permille: u16::MAX, yaw_deg: u16::MAX, ..Motion::of(&limited) };
        foreign.apply_to(&mut limited);
        assert_eq!(limited.battery, BatteryShare::FULL);
        assert!(limited.pose.yaw.abs() <= std::f64::consts::PI);
    }

    proptest! {
        #[test]
        fn a_received_motion_differs_by_half_a_step(
            x in -1e4..1e4f64, y in -1e4..1e4f64, yaw in -7.0..7.0f64, battery in 0.0..=1.0f64,
        ) {
            let sent = robot("Lab", Pose::new(x, y, yaw), battery);
            let motion = codec::decode::<Motion>(&codec::encode(&Motion::of(&sent)).unwrap()).unwrap();
            let mut received = robot("Dock", Pose::default(), 0.0);
            motion.apply_to(&mut received);
            prop_assert_eq!(&received.place, &sent.place);
            prop_assert!((received.pose.x - x).abs() <= 0.005_001 && (received.pose.y - y).abs() <= 0.005_001);
            let turn = (received.pose.yaw - yaw).rem_euclid(std::f64::consts::TAU);
            prop_assert!(turn.min(std::f64::consts::TAU - turn) <= 0.5_f64.to_radians() + 1e-9);
            prop_assert!((received.battery.get() - battery).abs() <= 0.000_501);
        }
    }
}
