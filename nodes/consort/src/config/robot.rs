//! The robot file: a node that controls a robot.

use super::devices::{DeviceDriverConfig, ROBOT_DRIVERS_MAX, driver_problems, resolve_drivers};
use super::fleet::unknown_skill;
use super::node::{common_config, validate_common};
use super::{BusConfig, CommonConfig, ConfigFile, FleetRef, NodeFile, TelemetryConfig, yes};
use consort_driver::{DriverEndpoint, DriverSetting};
use consort_protocol::ids::{NodeId, PlaceId, RobotId, TaskType};
use consort_protocol::knowledge::Attributes;
use consort_protocol::mission::Domain;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond, WattHours};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// A robot file. `name`, `place` and `skills` are required.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotConfig {
    /// The robot's name, and its node's: unique in the fleet.
    pub name: RobotId,
    /// Its place until the driver has reported.
    pub place: PlaceId,
    /// The navigation graph on whose lanes it drives, as `"0"`: the map names the graphs of its lanes. Default: none, and
    /// it drives on all lanes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub graph: Option<String>,
    /// The task types of its skills.
    pub skills: BTreeSet<TaskType>,
    /// Its attributes, as `section = "icu"`: booleans, numbers or texts that conditions of ensembles and
    /// roles use as `robot.attributes.section`. Default: none.
    #[serde(default, skip_serializing_if = "Attributes::is_empty")]
    pub attributes: Attributes,
    /// Its average speed in metres per second, the basis of its estimates. None: it does not drive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_mps: Option<MetresPerSecond>,
    /// Charge until the driver has reported, as a share. Default 1, a full battery.
    #[serde(default = "full")]
    pub battery: BatteryShare,
    /// Charge used per second of work, as a share. Default 0: mains power.
    #[serde(default = "nothing")]
    pub discharge_share_per_s: SharePerSecond,
    /// Capacity of its battery, in watt-hours: with the powers of the chargers the basis of its forecast of the time to
    /// charge, by which it selects a charger. Default: unknown, and it uses the nearest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub capacity_wh: Option<WattHours>,
    /// Charge below which it takes no work, as a share. Default 0.08, as in the published
    /// evaluation.
    #[serde(default = "useful_charge")]
    pub useful_charge: BatteryShare,
    /// True if the node does not move; such nodes are preferred as voters. Default: false.
    #[serde(default)]
    pub stationary: bool,
    /// True if the node runs on mains power; such nodes are preferred as voters. Default: false.
    #[serde(default)]
    pub mains_powered: bool,
    /// True if the node may keep a copy of the ledger, and coordinate. Default: true.
    #[serde(default = "yes")]
    pub may_vote: bool,
    /// Command line of the robot's driver, as `["python3", "driver.py"]`: the node starts the program and
    /// exchanges JSON lines with it. A program with a `/` and arguments that name files are relative to
    /// this file. Or the socket on which a driver listens: `"unix:driver.sock"` or `"tcp:127.0.0.1:7700"`.
    /// Default: none, and the driver is elsewhere on the bus.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub driver: Option<DriverSetting>,
    /// Directory of the node's store. Default: none, and all state is lost when the node ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data_dir: Option<PathBuf>,
    /// Address of the dashboard, as `127.0.0.1:8088`; port 0 selects any free port. Default: none,
    /// and no dashboard is served.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dashboard: Option<SocketAddr>,
    /// The fleet: the path of its file, or a table with the same keys. Default: a fleet of all
    /// defaults.
    #[serde(default)]
    pub fleet: FleetRef,
    /// Network settings.
    #[serde(default)]
    pub bus: BusConfig,
    /// Log, metrics and spans.
    #[serde(default)]
    pub telemetry: TelemetryConfig,
    /// Drivers of doors, lifts and other devices of the building that the node runs. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub device: Vec<DeviceDriverConfig>,
}

fn full() -> BatteryShare {
    BatteryShare::FULL
}

fn nothing() -> SharePerSecond {
    SharePerSecond::new(0.0).expect("0 is a rate")
}

/// Default charge below which a robot takes no work.
pub(crate) fn useful_charge() -> BatteryShare {
    BatteryShare::new(0.08).expect("0.08 is a share")
}

impl RobotConfig {
    /// Creates the configuration of a robot, with the defaults of a robot file.
    pub fn new(name: RobotId, place: PlaceId, skills: BTreeSet<TaskType>) -> RobotConfig {
        RobotConfig {
            name,
            place,
            graph: None,
            skills,
            attributes: Attributes::default(),
            speed_mps: None,
            battery: full(),
            discharge_share_per_s: nothing(),
            capacity_wh: None,
            useful_charge: useful_charge(),
            stationary: false,
            mains_powered: false,
            may_vote: true,
            driver: None,
            data_dir: None,
            dashboard: None,
            fleet: FleetRef::default(),
            bus: BusConfig::default(),
            telemetry: TelemetryConfig::default(),
            device: vec![],
        }
    }
}

impl ConfigFile for RobotConfig {
    const KIND: &'static str = "robot";

    fn resolve_paths(&mut self, folder: &Path) {
        if let Some(driver) = &mut self.driver {
            driver.resolve(folder);
        }
        resolve_drivers(&mut self.device, folder);
        self.common_mut().resolve_paths(folder);
    }

    fn validate(&self, domain: &Domain) -> Vec<String> {
        let unknown = self.skills.iter().filter(|skill| domain.get(skill).is_none());
        let mut validate: Vec<String> =
            unknown.map(|skill| format!("skills: {}", unknown_skill(skill, domain))).collect();
        if self.skills.is_empty() {
            validate.push("skills: the list is empty; such a robot would get no work".to_owned());
        }
        let travels = self.skills.iter().find(|skill| domain.ihtn_names().reaching.contains(*skill));
        if let (Some(skill), None) = (travels, self.speed_mps) {
            validate.push(format!("speed_mps: is missing, and the robot has the skill `{skill}`"));
        }
        if let Some(Err(problem)) = self.driver.clone().map(DriverEndpoint::try_from) {
            validate.push(format!("driver: {problem}"));
        }
        validate.extend(driver_problems(&self.device, ROBOT_DRIVERS_MAX));
        validate.extend(validate_common(&self.fleet, &self.bus, &self.telemetry, domain));
        validate
    }
}

impl NodeFile for RobotConfig {
    fn node(&self) -> NodeId {
        NodeId::from(self.name.clone())
    }

    fn common_mut(&mut self) -> CommonConfig<'_> {
        common_config!(self, archive: None, is_powered: self.mains_powered)
    }
}
