//! Devices of the building: their declaration in the fleet file, and their drivers in the files of nodes.

use consort_driver::{DriverEndpoint, DriverSetting};
use consort_protocol::devices::{AlarmPosition, Device, DeviceKind, Devices};
use consort_protocol::ids::{DeviceId, NodeId, PlaceId};
use consort_protocol::ledger::MapPart;
use consort_protocol::mission::Domain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

/// Longest time without a response or a confirmation, in seconds.
const SILENT_S_MAX: u32 = 3600;

/// Most drivers of devices at a node without a robot: a record is at most 3 KiB, and names have up to 64 bytes.
pub(super) const DRIVERS_MAX: usize = 16;

/// Most drivers of devices at the node of a robot, whose record also describes the robot. A guess.
pub(super) const ROBOT_DRIVERS_MAX: usize = 4;

/// `[[device]]` in the fleet file: a door, a lift or another device of the building. A robot requests it, and enters once
/// the device confirms. A device serves one robot at a time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DeviceConfig {
    /// Its name.
    pub name: DeviceId,
    /// Its kind, for people: `door`, `lift`, `call_point`, `dispenser` or `other`.
    pub kind: DeviceKind,
    /// Name of the node that runs its driver, usually a station. No other node reports the device, whatever its certificate
    /// permits.
    pub host: NodeId,
    /// Lanes of the map that it guards, each by its two ends, in both directions. The ride of a lift between two stops is a
    /// lane, too. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lanes: Vec<(PlaceId, PlaceId)>,
    /// Places that it guards: a robot needs the device on the ways into them, at them, and on the ways out of them, as at
    /// the stops of a lift. Default: none.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub places: BTreeSet<PlaceId>,
    /// Seconds without a response or a confirmation after which the device counts as silent: robots then drive other ways, or
    /// wait. Longer than the device needs to become ready. Default 30.
    #[serde(default = "silent_after_s")]
    pub silent_after_s: u32,
    /// State during an alarm: `open`, and robots pass without a request; `closed`; or `out_of_use`, as a lift. Robots use the
    /// device in no other state. Default `closed`.
    #[serde(default = "closed")]
    pub in_alarm: AlarmPosition,
}

/// `[[device]]` in the file of a node: the driver of a device of which the fleet file names the node as its host.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DeviceDriverConfig {
    /// Name of the device.
    pub name: DeviceId,
    /// Command line of the device's driver, or the socket on which a driver listens, as `driver` in a robot file. Without it
    /// the device is simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub driver: Option<DriverSetting>,
    /// Seconds until a simulated device is ready, and until it has returned. Default 3.
    #[serde(default = "simulated_s")]
    pub simulated_s: u32,
}

/// Estimate: twice the time that a lift of a low building needs.
fn silent_after_s() -> u32 {
    30
}

fn closed() -> AlarmPosition {
    AlarmPosition::Closed
}

/// Estimate: sliding doors of hospitals take 2 to 4 seconds.
fn simulated_s() -> u32 {
    3
}

impl DeviceConfig {
    /// Returns the device.
    fn device(&self) -> Device {
        Device {
            name: self.name.clone(),
            kind: self.kind,
            host: self.host.clone(),
            lanes: self.lanes.iter().cloned().collect(),
            places: self.places.clone(),
            silent_after: Duration::from_secs(self.silent_after_s.into()),
            in_alarm: self.in_alarm,
        }
    }
}

/// Returns the devices. Places and lanes are checked if the map of the domain is known.
///
/// # Errors
/// All problems.
pub(crate) fn devices(configs: &[DeviceConfig], domain: &Domain) -> Result<Devices, Vec<String>> {
    let mut problems = vec![];
    for (index, config) in configs.iter().enumerate() {
        let mut problem = |text: String| problems.push(format!("device {}: {text}", config.name));
        if configs[..index].iter().any(|other| other.name == config.name) {
            problem("is declared twice".to_owned());
        }
        if config.lanes.is_empty() && config.places.is_empty() {
            problem("guards nothing; name its `lanes` or its `places`".to_owned());
        }
        if !(1..=SILENT_S_MAX).contains(&config.silent_after_s) {
            problem(format!("silent_after_s is {}; allowed are 1 to {SILENT_S_MAX}", config.silent_after_s));
        }
        let places = config.places.iter().map(|place| ("places", MapPart::Place(place.clone())));
        let lanes = config.lanes.iter().map(|(a, b)| ("lanes", MapPart::of_lane(a.clone(), b.clone())));
        for (key, part) in places.chain(lanes) {
            if let Err(unknown) = part.check(domain) {
                problem(format!("{key}: {unknown}"));
            }
        }
    }
    if problems.is_empty() { Ok(Devices::new(configs.iter().map(DeviceConfig::device))) } else { Err(problems) }
}

/// Resolves the paths of drivers relative to `folder`, the folder of the file.
pub(super) fn resolve_drivers(configs: &mut [DeviceDriverConfig], folder: &Path) {
    configs.iter_mut().filter_map(|device| device.driver.as_mut()).for_each(|driver| driver.resolve(folder));
}

/// Returns the problems of the drivers of a node, which runs at most `drivers_max`.
pub(super) fn driver_problems(configs: &[DeviceDriverConfig], drivers_max: usize) -> Vec<String> {
    let problem = |config: &DeviceDriverConfig| {
        let problem = config.driver.clone().map(DriverEndpoint::try_from)?.err()?;
        Some(format!("device {}: driver: {problem}", config.name))
    };
    let too_many = (configs.len() > drivers_max).then(|| {
        format!(
            "device: {} drivers; allowed are {drivers_max} at this node, since its record has to contain all",
            configs.len()
        )
    });
    let is_repeated = |(index, config): &(usize, &DeviceDriverConfig)| {
        configs[..*index].iter().any(|other| other.name == config.name)
    };
    let repeated = configs.iter().enumerate().filter(is_repeated);
    let repeated =
        repeated.map(|(_, config)| format!("device {}: is named twice; a device has one driver", config.name));
    configs.iter().filter_map(problem).chain(repeated).chain(too_many).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct File {
        device: Vec<DeviceConfig>,
    }

    fn problems(text: &str, domain: &Domain) -> Vec<String> {
        devices(&toml::from_str::<File>(text).unwrap().device, domain).err().unwrap_or_default()
    }

    #[test]
    fn drivers_of_devices_perform_the_actions_of_the_device_domain() {
        let domain = consort_skills::domain::device_domain();
        let actions: Vec<String> = domain.action_forms().map(|(name, _)| name.to_string()).collect();
        assert_eq!(actions, ["alarm", "serve"]);
    }

    #[test]
    fn a_node_runs_one_driver_for_each_device() {
        let door = || DeviceDriverConfig { name: "door".parse().unwrap(), driver: None, simulated_s: 3 };
        assert_eq!(driver_problems(&[door()], DRIVERS_MAX), Vec::<String>::new());
        assert_eq!(
            driver_problems(&[door(), door()], DRIVERS_MAX),
            ["device door: is named twice; a device has one driver"]
        );
    }

    #[test]
    fn problems_of_devices_name_the_device() {
        let door = "[[device]]\nname = \"door\"\nkind = \"door\"\nhost = \"station\"\nlanes = [[\"Hall\", \"Yard\"]]\n";
        let domain = Domain::default().with_places(["Hall", "Yard"].map(|name| name.parse().unwrap()));
        assert_eq!(problems(door, &domain), Vec::<String>::new());
        let wrong = format!(
            "{door}{door}[[device]]\nname = \"lift\"\nkind = \"lift\"\nhost = \"station\"\nsilent_after_s = 0\n\
             [[device]]\nname = \"hatch\"\nkind = \"dispenser\"\nhost = \"station\"\nplaces = [\"Yrd\"]\n"
        );
        assert_eq!(
            problems(&wrong, &domain),
            [
                "device door: is declared twice",
                "device lift: guards nothing; name its `lanes` or its `places`",
                "device lift: silent_after_s is 0; allowed are 1 to 3600",
                "device hatch: places: there is no place Yrd; allowed: Hall, Yard; did you mean `Yard`?",
            ]
        );
    }
}
