//! The file of simulated vehicles.

use crate::catalog::fill;
use crate::file::{BrokerAccess, BrokerForm, FileError, interface};
use consort_protocol::ids::ActionName;
use consort_skills::actions::{Goal, JsonObject};
use consort_vda5050_core::{ExecutorSettings, Vehicle, VehicleAction, Version};
use consort_world::map;
use consort_world::world::{RobotSetup, World, WorldSetup};
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Content of the file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehiclesFile {
    /// The broker.
    pub broker: BrokerForm,
    /// First level of the topics.
    #[serde(default = "interface")]
    pub interface: String,
    /// Version of the protocol.
    pub version: String,
    /// Manufacturer, as in the topics.
    pub manufacturer: String,
    /// Map: a shipped map, or a file of the form of the world. Its name is the `mapId`.
    pub map: String,
    /// The robots, as in a world file. Their names are the serial numbers.
    pub robots: Vec<RobotSetup>,
    /// Types of actions that the vehicles execute, and the actions of the simulated robots.
    #[serde(default)]
    pub actions: BTreeMap<String, SimulatedForm>,
}

/// An action of a simulated robot.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedForm {
    /// The action, for example `wait`.
    pub action: ActionName,
    /// Its parameters. `{NAME}` stands for a parameter of the vehicle's action.
    #[serde(default)]
    pub parameters: BTreeMap<String, Value>,
}

/// A simulated vehicle.
#[derive(Debug, Clone)]
pub struct SimulatedVehicle {
    /// Its identity.
    pub vehicle: Vehicle,
    /// Its robot.
    pub robot: RobotSetup,
    /// Settings of its state machine.
    pub executor: ExecutorSettings,
}

/// A checked file.
pub struct VehiclesSettings {
    /// The broker.
    pub broker: BrokerAccess,
    /// The world of the robots.
    pub world: World,
    /// The vehicles.
    pub vehicles: Vec<SimulatedVehicle>,
    actions: BTreeMap<String, SimulatedForm>,
}

impl VehiclesSettings {
    /// Reads and checks a file. Names of files in it are relative to it.
    ///
    /// # Errors
    /// The first problem, with its place.
    pub fn read(path: &Path) -> Result<VehiclesSettings, FileError> {
        let text = fs::read_to_string(path).map_err(|problem| FileError::Read { path: path.to_owned(), problem })?;
        VehiclesSettings::parse(path, &text)
    }

    fn parse(path: &Path, text: &str) -> Result<VehiclesSettings, FileError> {
        let file: VehiclesFile = serde_saphyr::from_str(text)
            .map_err(|problem| FileError::Form { path: path.to_owned(), problem: problem.to_string() })?;
        let wrong =
            |place: &str, problem: String| FileError::Value { path: path.to_owned(), place: place.to_owned(), problem };
        let version: Version = file.version.parse().map_err(|problem| wrong("version", format!("{problem}")))?;
        let map = if map::SHIPPED.contains(&file.map.as_str()) {
            map::shipped(&file.map)
        } else {
            let path = path.parent().unwrap_or(Path::new("")).join(&file.map);
            let text = fs::read_to_string(&path).map_err(|problem| FileError::Read { path, problem })?;
            map::read(&text, &file.map)
        };
        let map = map.map_err(|problem| wrong("map", problem.to_string()))?;
        let map_name = map.name().to_owned();
        if file.robots.is_empty() {
            return Err(wrong("robots", "the list is empty; allowed is 1 robot or more".to_owned()));
        }
        let mut vehicles = vec![];
        for robot in &file.robots {
            let vehicle = Vehicle::new(&file.interface, version, &file.manufacturer, robot.id.as_str())
                .map_err(|problem| wrong(problem.field, problem.to_string()))?;
            let executor = ExecutorSettings {
                version,
                map: map_name.clone(),
                series: "simulated by Consort".to_owned(),
                actions: file.actions.keys().cloned().collect(),
                speed_max_mps: robot.speed.get(),
                radius_m: robot.radius_m,
            };
            vehicles.push(SimulatedVehicle { vehicle, robot: robot.clone(), executor });
        }
        let setup = WorldSetup { robots: file.robots, ..WorldSetup::new(map, 1) };
        let world = World::new(setup).map_err(|problem| wrong("robots", problem.to_string()))?;
        Ok(VehiclesSettings { broker: file.broker.access(path)?, world, vehicles, actions: file.actions })
    }

    /// Returns the goal of a robot for an action of its vehicle; `None` for an unknown type.
    pub fn goal(&self, action: &VehicleAction) -> Option<Goal> {
        let form = self.actions.get(&action.kind)?;
        let given = JsonObject::from_iter(action.parameters.clone());
        let filled = form.parameters.iter().filter_map(|(key, form)| Some((key.clone(), fill(form, &given)?)));
        Some(Goal {
            action: form.action.clone(),
            parameters: filled.collect(),
            repeatable: false,
            hands_over: None,
            since: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_vda5050_core::{BlockingType, Topic};
    use serde_json::json;

    const TEXT: &str = "\
broker: { url: \"mqtt://127.0.0.1:1883\" }
version: \"2.1\"
manufacturer: Consort
map: clinic
robots:
  - { id: ada, place: Dock, speed_mps: 1, battery: 1, discharge_share_per_s: 0.0001 }
actions:
  pick: { action: wait, parameters: { time: \"{duration}\" } }
";

    #[test]
    fn a_robot_is_a_vehicle_and_its_actions_are_filled() {
        let settings = VehiclesSettings::parse(Path::new("vehicles.yaml"), TEXT).unwrap();
        assert_eq!(settings.vehicles[0].vehicle.topic(Topic::Order), "uagv/v2/Consort/ada/order");
        assert_eq!(settings.vehicles[0].executor.map, "clinic");
        let action = |kind: &str| VehicleAction {
            id: "x".to_owned(),
            kind: kind.to_owned(),
            blocking: BlockingType::Hard,
            parameters: BTreeMap::from([("duration".to_owned(), json!(2))]),
        };
        let goal = settings.goal(&action("pick")).unwrap();
        assert_eq!((goal.action.as_str(), &goal.parameters["time"]), ("wait", &json!(2)));
        assert!(settings.goal(&action("sing")).is_none());
    }

    #[test]
    fn an_error_names_the_place_in_the_file() {
        let error = |part: &str, other: &str| {
            let problem = VehiclesSettings::parse(Path::new("vehicles.yaml"), &TEXT.replace(part, other)).err();
            problem.unwrap().to_string()
        };
        assert!(error("\"2.1\"", "\"1.1\"").contains("version: "));
        assert!(error("Dock", "Cellar").contains("robots: "));
        assert!(error("Consort", "a/b").contains("manufacturer: "));
    }
}
