//! Initial state of a scenario.

use super::step_result::StepFailure;
use crate::RobotSpec;
use consort_protocol::ensemble::EnsembleSpec;
use consort_protocol::units::{BatteryShare, SharePerSecond};
use consort_skills::extensions::Extensions;
use consort_world::SharedWorld;
use consort_world::kinematics::Kinematics;
use consort_world::map::{LaneEntry, Map, MapFile, PlaceEntry, PlaceKind};
use consort_world::space::Sensor;
use consort_world::world::{DoorSetup, ObjectSetup, Obstacle, PersonSetup, RobotSetup, World, WorldSetup};
use std::path::PathBuf;

/// Robots, people, items and the building from the settings so far.
pub(super) struct ScenarioSetup {
    /// Source of all randomness.
    pub(super) seed: u64,
    /// World seconds per second of node time.
    pub(super) speed: f64,
    /// Folder of the feature file. File names in steps are relative to it.
    pub(super) folder: PathBuf,
    pub(super) map: ScenarioMap,
    pub(super) robots: Vec<ScenarioRobot>,
    pub(super) stations: Vec<String>,
    /// Ensembles of the fleet. If the list is empty, a single ensemble contains all robots.
    pub(super) ensembles: Vec<EnsembleSpec>,
    /// Domain files and skills in addition to the standard domain.
    pub(super) extensions: Extensions,
    pub(super) people: Vec<PersonSetup>,
    pub(super) objects: Vec<ObjectSetup>,
    pub(super) doors: Vec<DoorSetup>,
    pub(super) obstacles: Vec<Obstacle>,
    pub(super) step_s: Option<f64>,
}

/// Map of a scenario.
pub(super) enum ScenarioMap {
    /// A map file.
    Map(Box<Map>),
    /// An empty room with walls. Places are given by coordinates.
    Room { width_m: f64, depth_m: f64 },
}

/// A robot: its node and its simulated robot.
pub(super) struct ScenarioRobot {
    pub(super) setup: RobotSpec,
    pub(super) chassis: Option<Kinematics>,
    pub(super) arm: Option<bool>,
    pub(super) drawer: Option<bool>,
    pub(super) payload_max_kg: Option<f64>,
    pub(super) reach_m: Option<f64>,
    pub(super) charges_per_s: Option<f64>,
    pub(super) sensors: Vec<Sensor>,
}

impl ScenarioRobot {
    pub(super) fn of(member: RobotSpec) -> ScenarioRobot {
        ScenarioRobot {
            setup: member,
            chassis: None,
            arm: None,
            drawer: None,
            payload_max_kg: None,
            reach_m: None,
            charges_per_s: None,
            sensors: vec![],
        }
    }

    fn body(&self) -> Result<RobotSetup, StepFailure> {
        let mut body = self.setup.robot_body();
        body.kinematics.clone_from(&self.chassis);
        body.sensors.clone_from(&self.sensors);
        body.has_arm = self.arm.unwrap_or(body.has_arm);
        body.has_drawer = self.drawer.unwrap_or(body.has_drawer);
        body.payload_max_kg = self.payload_max_kg.unwrap_or(body.payload_max_kg);
        body.reach_m = self.reach_m.unwrap_or(body.reach_m);
        if let Some(rate) = self.charges_per_s {
            body.charging = SharePerSecond::new(rate).map_err(StepFailure::invalid)?;
        }
        body.battery = BatteryShare::new(self.setup.battery).map_err(StepFailure::invalid)?;
        Ok(body)
    }
}

impl ScenarioSetup {
    /// Creates an empty setup in the shipped hospital.
    pub(super) fn new(folder: PathBuf, seed: u64, extensions: Extensions) -> ScenarioSetup {
        let hospital = consort_world::map::shipped("hospital").expect("the shipped map is sound");
        ScenarioSetup {
            seed,
            speed: 1.0,
            folder,
            map: ScenarioMap::Map(Box::new(hospital)),
            robots: vec![],
            stations: vec![],
            ensembles: vec![],
            extensions,
            people: vec![],
            objects: vec![],
            doors: vec![],
            obstacles: vec![],
            step_s: None,
        }
    }

    /// Returns the person at a place.
    pub(super) fn person_at(&mut self, place: &str) -> Result<&mut PersonSetup, StepFailure> {
        let found = self.people.iter_mut().find(|person| person.place.as_str() == place);
        found.ok_or_else(|| StepFailure::Invalid(format!("there is no person at {place:?}: add a person first")))
    }

    /// Creates the world.
    pub(super) fn world(&self) -> Result<SharedWorld, StepFailure> {
        let mut setup = WorldSetup::new(self.map()?, self.seed).extended(self.extensions);
        for part in &self.robots {
            setup = setup.robot(part.body()?);
        }
        setup.people.clone_from(&self.people);
        setup.objects.clone_from(&self.objects);
        setup.doors.clone_from(&self.doors);
        setup.obstacles.clone_from(&self.obstacles);
        setup.step_s = self.step_s.unwrap_or(setup.step_s);
        Ok(SharedWorld::new(World::new(setup).map_err(StepFailure::invalid)?))
    }

    fn map(&self) -> Result<Map, StepFailure> {
        let (width_m, depth_m) = match &self.map {
            ScenarioMap::Map(map) => return Ok((**map).clone()),
            ScenarioMap::Room { width_m, depth_m } => (*width_m, *depth_m),
        };
        let mut names: Vec<&str> = self.robots.iter().map(|part| part.setup.place.as_str()).collect();
        names.extend(self.people.iter().map(|person| person.place.as_str()));
        names.sort_unstable();
        names.dedup();
        let place = |name: &&str| {
            let (x_m, y_m) = coordinates(name)?;
            Ok(PlaceEntry { name: (*name).to_owned(), kind: PlaceKind::Other, x_m, y_m, ..PlaceEntry::default() })
        };
        let lane =
            |pair: &[&str]| LaneEntry { between: (pair[0].to_owned(), pair[1].to_owned()), ..LaneEntry::default() };
        let file = MapFile {
            name: "room".to_owned(),
            walls: vec![vec![(0.0, 0.0), (width_m, 0.0), (width_m, depth_m), (0.0, depth_m), (0.0, 0.0)]],
            places: names.iter().map(place).collect::<Result<_, StepFailure>>()?,
            lanes: names.windows(2).map(lane).collect(),
            ..MapFile::default()
        };
        file.check("room").map_err(StepFailure::invalid)
    }
}

/// Parses a position in metres: `1, 1.5`.
pub(super) fn coordinates(text: &str) -> Result<(f64, f64), StepFailure> {
    let number = |part: &str| part.trim().parse::<f64>().ok();
    let pair = text.split_once(',').and_then(|(x, y)| Some((number(x)?, number(y)?)));
    pair.ok_or_else(|| StepFailure::Invalid(format!("{text:?} is no position in metres, as \"1, 1.5\"")))
}
