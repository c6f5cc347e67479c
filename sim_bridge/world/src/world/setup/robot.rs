//! Setup of a robot.

use crate::kinematics::Kinematics;
use crate::space::Sensor;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond, WattHours};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Setup of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotSetup {
    /// Name.
    pub id: RobotId,
    /// Place at the start.
    pub place: PlaceId,
    /// Driving speed, in metres per second.
    #[serde(rename = "speed_mps")]
    pub speed: MetresPerSecond,
    /// State of charge at the start, 0 to 1.
    pub battery: BatteryShare,
    /// Discharge per second while a goal is active, as a share. The robot's estimator must use the
    /// same rate.
    #[serde(rename = "discharge_share_per_s")]
    pub discharge: SharePerSecond,
    /// Discharge without an active goal, as a fraction of `discharge`: 0 to 1, default 0.1 as in
    /// the published rig.
    #[serde(default = "default_idle_factor")]
    pub idle_factor: f64,
    /// Capacity of the battery, in watt-hours: it charges with the power of the charger, if the fleet
    /// file states one. Default: none, and it charges at `charging_share_per_s`.
    #[serde(rename = "capacity_wh", default, skip_serializing_if = "Option::is_none")]
    pub capacity: Option<WattHours>,
    /// Charge per second while docked at a charger; the discharge is subtracted from it. Default:
    /// 0.0005 /s, a guess: full in somewhat more than half an hour.
    #[serde(rename = "charging_share_per_s", default = "default_charging")]
    pub charging: SharePerSecond,
    /// True if the robot can drive.
    #[serde(default = "yes")]
    pub mobile: bool,
    /// True if the robot has a drawer that people and arms can reach into.
    #[serde(default)]
    pub has_drawer: bool,
    /// True if the robot has an arm, which holds a single object.
    #[serde(default)]
    pub has_arm: bool,
    /// Greatest payload of the arm, in kilograms. Default: 2, a guess.
    #[serde(default = "two_kilograms")]
    pub payload_max_kg: f64,
    /// Reach of the arm from the robot's position, in metres. Default: 1, a guess.
    #[serde(default = "one_metre")]
    pub reach_m: f64,
    /// Distance from the centre to the outermost part, in metres.
    #[serde(default = "default_radius_m")]
    pub radius_m: f64,
    /// Kinematics. Without it the robot drives in straight lines that are computed ahead, which
    /// costs nothing while it drives, and passes through every body in its way.
    #[serde(default)]
    pub kinematics: Option<Kinematics>,
    /// Sensors.
    #[serde(default)]
    pub sensors: Vec<Sensor>,
}

/// Default discharge of an idle robot, as a fraction of its discharge rate: 0.1, as in the
/// published rig.
const fn default_idle_factor() -> f64 {
    0.1
}

/// Default radius of a robot: 0.25 m, about that of a small hospital robot.
const fn default_radius_m() -> f64 {
    0.25
}

fn default_charging() -> SharePerSecond {
    SharePerSecond::new(0.0005).expect("0.0005 /s is a rate")
}

fn two_kilograms() -> f64 {
    2.0
}

fn one_metre() -> f64 {
    1.0
}

fn yes() -> bool {
    true
}

impl RobotSetup {
    /// A mobile robot with a drawer.
    pub fn carrier(
        id: RobotId,
        place: PlaceId,
        speed: MetresPerSecond,
        battery: BatteryShare,
        discharge: SharePerSecond,
    ) -> Self {
        Self {
            id,
            place,
            speed,
            battery,
            discharge,
            idle_factor: default_idle_factor(),
            capacity: None,
            charging: default_charging(),
            mobile: true,
            has_drawer: true,
            has_arm: false,
            payload_max_kg: two_kilograms(),
            reach_m: one_metre(),
            radius_m: default_radius_m(),
            kinematics: None,
            sensors: Vec::new(),
        }
    }

    /// A stationary arm on mains power.
    pub fn arm(id: RobotId, place: PlaceId) -> Self {
        let speed = MetresPerSecond::new(1.0).expect("1 m/s is a speed");
        let discharge = SharePerSecond::new(0.0).expect("0 /s is a rate");
        let carrier = Self::carrier(id, place, speed, BatteryShare::FULL, discharge);
        Self { mobile: false, has_drawer: false, has_arm: true, ..carrier }
    }

    /// Returns the discharge rate with or without an active goal.
    pub(crate) fn rate(&self, working: bool) -> SharePerSecond {
        if working {
            return self.discharge;
        }
        SharePerSecond::new(self.discharge.get() * self.idle_factor).unwrap_or(self.discharge)
    }
}
