//! The demo's robots, arms, nurses and missions, derived from its flags.

use crate::config::{ChargerConfig, ChargingConfig, FleetConfig, FleetRef, RobotConfig, StationConfig, WorldConfig};
use consort_driver::DriverSetting;
use consort_protocol::ensemble::EnsembleSpec;
use consort_protocol::ids::{EnsembleId, FleetId, NodeId, PlaceId, RequestId, RobotId, RoleId, TaskType};
use consort_protocol::mission::{Domain, Mission, ValueKind};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_skills::missions;
use consort_world::world::{PersonSetup, RobotSetup};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};

/// Rooms with nurses, in the order in which missions use them.
const ROOMS: [&str; 14] = [
    "IC Room 6",
    "PC Room 3",
    "IC Room 2",
    "PC Room 8",
    "IC Room 4",
    "PC Room 1",
    "IC Room 1",
    "PC Room 6",
    "IC Room 5",
    "PC Room 2",
    "IC Room 3",
    "PC Room 7",
    "PC Room 4",
    "PC Room 5",
];

/// Robots' names; the first robot creates the ledger and usually coordinates first.
const NAMES: [&str; 26] = [
    "amber", "birch", "cedar", "dune", "ember", "flint", "grove", "hazel", "iris", "jade", "kelp", "larch", "maple",
    "nova", "opal", "pearl", "quartz", "reed", "sage", "terra", "umber", "vale", "willow", "xenon", "yarrow", "zinnia",
];

const CARRIER: [&str; 5] = ["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"];

/// Skills that every mobile robot has.
const SERVICES: [&str; 5] = ["wait", "carry", "disinfect", "measure_vital_signs", "operate_door"];

/// Skills that need an arm.
const OF_ARMS: [&str; 3] = ["pick_up", "grasp", "deposit"];

/// Places of chargers, in the order of use: few robots pass or visit them.
const CHARGERS: [&str; 6] = ["Dock", "PC Corridor 8", "IC Corridor 6", "PC Room 4", "IC Room 3", "PC Room 7"];

/// Charge below which a robot charges, as a share.
const CHARGES_BELOW: f64 = 0.4;

/// Charge that a robot gains at a charger, as a share per second: about four times what it uses while it works.
const CHARGING: f64 = 0.002;

/// A kind of robot: its differences from the other kinds.
struct Kind {
    lacks: Option<&'static str>,
    speed_mps: f64,
    battery: f64,
    discharge: f64,
}

/// Different skills, speeds and batteries. The first kind cannot carry, so it has time to
/// coordinate.
const KINDS: [Kind; 6] = [
    Kind { lacks: Some("operate_drawer"), speed_mps: 0.9, battery: 0.95, discharge: 0.000_5 },
    Kind { lacks: None, speed_mps: 0.7, battery: 0.90, discharge: 0.000_6 },
    Kind { lacks: None, speed_mps: 0.5, battery: 0.80, discharge: 0.000_4 },
    Kind { lacks: Some("authenticate_person"), speed_mps: 0.8, battery: 0.85, discharge: 0.000_5 },
    Kind { lacks: None, speed_mps: 0.8, battery: 0.13, discharge: 0.000_8 },
    Kind { lacks: None, speed_mps: 0.6, battery: 0.70, discharge: 0.000_3 },
];

/// Nodes and missions of the demo.
#[derive(Debug, Clone)]
pub struct DemoScenario {
    /// The fleet's settings.
    pub fleet: FleetConfig,
    /// The hospital, with simulated robots and nurses.
    pub world: WorldConfig,
    /// The nodes of the robots, including the arms.
    pub robots: Vec<RobotConfig>,
    /// Nodes without a robot, added if there are too few others to outvote a failed node.
    pub stations: Vec<StationConfig>,
    /// Missions to submit.
    pub requests: Vec<MissionRequest>,
}

/// A mission that the demo submits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissionRequest {
    /// Name of the request.
    pub request: RequestId,
    /// The nurse's room.
    pub room: PlaceId,
}

/// Returns the place of a role's first task, or else the last place before that task.
fn place_of_role(mission: &Mission, role: &RoleId, domain: &Domain) -> Option<PlaceId> {
    let mut place = None;
    for (_, spec) in mission.elementary() {
        let schema = domain.get(&spec.task_type);
        let is_place = |name: &str| {
            let parameter = schema.and_then(|schema| schema.parameters.get(name));
            parameter.is_some_and(|parameter| parameter.kind == ValueKind::Place)
        };
        let own = spec.parameters.iter().filter(|(name, _)| is_place(name)).find_map(|(_, value)| value.parse().ok());
        place = own.or(place);
        if spec.roles.contains(role) {
            break;
        }
    }
    place
}

fn slug<T: std::str::FromStr<Err: std::fmt::Debug>>(text: &str) -> T {
    text.parse().expect("the demo's own names are names")
}

/// Returns the chargers of a fleet with `robots` mobile robots: one for each three robots, but at least two.
fn charging(robots: usize) -> ChargingConfig {
    let count = robots.div_ceil(3).clamp(2, CHARGERS.len());
    let charger = |place: &&str| ChargerConfig { place: slug(place), power_w: None, eligible: None };
    ChargingConfig {
        below: BatteryShare::new(CHARGES_BELOW).expect("a share"),
        charger: CHARGERS[..count].iter().map(charger).collect(),
        ..ChargingConfig::default()
    }
}

/// Returns the simulated robot of a mobile robot.
fn simulated_carrier(robot: &RobotConfig, speed: MetresPerSecond) -> RobotSetup {
    let (id, place) = (robot.name.clone(), robot.place.clone());
    RobotSetup {
        charging: SharePerSecond::new(CHARGING).expect("a rate"),
        ..RobotSetup::carrier(id, place, speed, robot.battery, robot.discharge_share_per_s)
    }
}

/// Creates mobile robots, with random start places and speeds.
fn carriers(robots: usize, rng: &mut ChaCha8Rng, simulated: &mut Vec<RobotSetup>) -> Vec<RobotConfig> {
    let mut starts: Vec<&str> = ROOMS.into_iter().chain(["Dock"]).collect();
    starts.shuffle(rng);
    let mut carrier = |index: usize| {
        // A single robot must be able to do the job.
        let kind = &KINDS[if robots < 3 { index + 1 } else { index % KINDS.len() }];
        let name = NAMES.get(index).map_or_else(|| format!("robot-{index}"), |name| (*name).to_owned());
        let place: PlaceId = slug(starts[index % starts.len()]);
        let jitter = 1.0 + rng.random_range(-0.03..0.03);
        let speed = MetresPerSecond::new(kind.speed_mps * jitter).expect("a speed");
        let battery = BatteryShare::new(kind.battery).expect("a share");
        let discharge = SharePerSecond::new(kind.discharge).expect("a rate");
        let own = CARRIER.into_iter().filter(|skill| Some(*skill) != kind.lacks);
        let skills = own.chain(SERVICES).map(slug).collect();
        let id: RobotId = slug(&name);
        let robot = RobotConfig {
            speed_mps: Some(speed),
            battery,
            discharge_share_per_s: discharge,
            ..RobotConfig::new(id, place, skills)
        };
        simulated.push(simulated_carrier(&robot, speed));
        robot
    };
    (0..robots).map(&mut carrier).collect()
}

/// Creates the arms of the laboratory.
fn arms(arms: usize, simulated: &mut Vec<RobotSetup>) -> impl Iterator<Item = RobotConfig> {
    (0..arms).map(move |index| {
        let name = if index == 0 { "lab-arm".to_owned() } else { format!("lab-arm-{}", index + 1) };
        let (id, place): (RobotId, PlaceId) = (slug(&name), slug("Laboratory"));
        simulated.push(RobotSetup::arm(id.clone(), place.clone()));
        let skills: BTreeSet<TaskType> = BTreeSet::from([slug("pick_up")]);
        RobotConfig { stationary: true, mains_powered: true, ..RobotConfig::new(id, place, skills) }
    })
}

/// Creates a nurse in every room, with a sample for each mission of the demo, and further samples for all
/// other requests.
fn nurses(missions: usize) -> Vec<PersonSetup> {
    let nurse = |(index, room): (usize, &str)| {
        let samples = (index..missions).step_by(ROOMS.len()).map(|mission| format!("sample-{}", mission + 1));
        PersonSetup {
            samples: samples.map(|sample| sample.as_str().into()).collect(),
            endless_samples: true,
            ..PersonSetup::new(&format!("nurse of {room}"), slug("nurse"), slug(room))
        }
    };
    ROOMS.into_iter().enumerate().map(nurse).collect()
}

impl DemoScenario {
    /// Creates a scenario with `robots` mobile robots and `missions` missions; `speed` is in world
    /// seconds per second. The seed decides the robots' start places and the nurses' speed.
    pub fn new(robots: usize, missions: usize, speed: f64, seed: u64) -> DemoScenario {
        let mut simulated = vec![];
        let mut scenario = carriers(robots, &mut ChaCha8Rng::seed_from_u64(seed), &mut simulated);
        // An arm for each parallel mission, within reason: each mission needs an arm from its
        // beginning.
        scenario.extend(arms(missions.clamp(1, 3), &mut simulated));
        // Three voters survive the failure of a voter.
        let stations: Vec<StationConfig> = (scenario.len()..3)
            .map(|index| StationConfig::new(slug::<NodeId>(&format!("station-{}", index + 1))))
            .collect();
        let requests: Vec<MissionRequest> = (0..missions)
            .map(|index| MissionRequest {
                request: slug(&format!("demo-{}", index + 1)),
                room: slug(ROOMS[index % ROOMS.len()]),
            })
            .collect();
        let fleet = FleetConfig {
            name: slug::<FleetId>("demo"),
            bootstrap_expect: scenario.len() + stations.len(),
            ensemble: vec![EnsembleSpec::with_any_skill_of(
                slug::<EnsembleId>("logistics"),
                BTreeSet::from([slug("operate_drawer"), slug("pick_up")]),
            )],
            charging: Some(charging(robots)),
            ..FleetConfig::default()
        };
        let world = WorldConfig { seed, speed, robot: simulated, person: nurses(missions), ..WorldConfig::default() };
        DemoScenario { fleet: fleet.clone(), world, robots: scenario, stations, requests }.in_fleet(fleet)
    }

    /// Returns the same scenario in another fleet; all its nodes use its settings.
    #[must_use]
    pub fn in_fleet(mut self, fleet: FleetConfig) -> DemoScenario {
        let reference = FleetRef::from(fleet.clone());
        self.fleet = fleet;
        self.world.fleet = reference.clone();
        self.robots.iter_mut().for_each(|robot| robot.fleet = reference.clone());
        self.stations.iter_mut().for_each(|station| station.fleet = reference.clone());
        self
    }

    /// Adds skills to all robots.
    #[must_use]
    pub fn with_skills(mut self, skills: &BTreeSet<TaskType>) -> DemoScenario {
        self.robots.iter_mut().for_each(|robot| robot.skills.extend(skills.iter().cloned()));
        self
    }

    /// Adds a person on call for each unmanaged role of a mission that nobody in the world has. Of the people in
    /// the role only those count for whom `counts` is true.
    #[must_use]
    fn with_people(self, mission: &Mission, domain: &Domain, counts: fn(&PersonSetup) -> bool) -> DemoScenario {
        mission
            .unmanaged_roles()
            .fold(self, |scenario, role| scenario.with_person(role, place_of_role(mission, role, domain), counts))
    }

    /// Adds a person on call, at the place or else in the first room, unless somebody has the role.
    #[must_use]
    fn with_person(mut self, role: &RoleId, place: Option<PlaceId>, counts: fn(&PersonSetup) -> bool) -> DemoScenario {
        if !self.world.person.iter().any(|person| person.role == *role && counts(person)) {
            let place = place.unwrap_or_else(|| slug(ROOMS[0]));
            self.world.person.push(PersonSetup {
                endless_samples: true,
                on_call: true,
                ..PersonSetup::new(&format!("{role} on call"), role.clone(), place)
            });
        }
        self
    }

    /// Adds a robot for each managed role of a mission that no robot has the skills for.
    #[must_use]
    fn with_robots(mut self, mission: &Mission) -> DemoScenario {
        for role in mission.managed_roles() {
            let skills = mission.task_types_of(role);
            if self.robots.iter().any(|robot| robot.skills.is_superset(&skills)) {
                continue;
            }
            let (id, place): (RobotId, PlaceId) = (slug(role.as_str()), slug("Dock"));
            let speed = MetresPerSecond::new(0.7).expect("a speed");
            let (battery, discharge) = (BatteryShare::FULL, SharePerSecond::new(0.000_5).expect("a rate"));
            let has_arm = skills.iter().any(|skill| OF_ARMS.contains(&skill.as_str()));
            let robot = RobotConfig {
                speed_mps: Some(speed),
                battery,
                discharge_share_per_s: discharge,
                fleet: self.world.fleet.clone(),
                ..RobotConfig::new(id, place, skills)
            };
            let simulated = RobotSetup { has_arm, has_drawer: !has_arm, ..simulated_carrier(&robot, speed) };
            self.world.robot.push(simulated);
            self.robots.push(robot);
        }
        self
    }

    /// Adds the people and robots of a mission, so that it can be completed.
    #[must_use]
    pub fn with_participants(self, mission: &Mission, domain: &Domain) -> DemoScenario {
        self.with_people(mission, domain, |_| true).with_robots(mission)
    }

    /// Adds the people and robots of all shipped missions, so that each of them can be submitted while the
    /// demo runs, with any places; and the people of the domain's iHTNs.
    #[must_use]
    pub fn with_participants_of_all_missions(self, domain: &Domain) -> DemoScenario {
        let shipped = missions::shipped().values();
        let missions = shipped.filter_map(|mission| mission.instantiate(&BTreeMap::new(), domain).ok());
        let scenario = missions.fold(self, |scenario, mission| {
            scenario.with_people(&mission, domain, |person| person.on_call).with_robots(&mission)
        });
        let people = &domain.ihtn_names().people;
        people
            .iter()
            .fold(scenario, |scenario, role| scenario.with_person(role, None, |_| true))
            .with_more_people_on_call()
    }

    /// Adds people until there is a person on call for each three robots, in each role with a person on call: a robot waits
    /// for a person for two minutes only.
    #[must_use]
    fn with_more_people_on_call(mut self) -> DemoScenario {
        let numbers = 2..=self.robots.len().div_ceil(3);
        let on_call: Vec<PersonSetup> = self.world.person.iter().filter(|person| person.on_call).cloned().collect();
        for person in on_call {
            let further =
                |number| PersonSetup { name: format!("{} {number}", person.name).as_str().into(), ..person.clone() };
            self.world.person.extend(numbers.clone().map(further));
        }
        self
    }

    /// Gives all mobile robots a driver, in place of the simulator. They do not charge by themselves, since a driver
    /// need not have the action `dock`.
    #[must_use]
    pub fn with_driver(mut self, driver: &DriverSetting) -> DemoScenario {
        for robot in self.robots.iter_mut().filter(|robot| robot.speed_mps.is_some()) {
            robot.driver = Some(driver.clone());
            self.world.robot.retain(|simulated| simulated.id != robot.name);
        }
        let fleet = FleetConfig { charging: None, ..self.fleet.clone() };
        self.in_fleet(fleet)
    }

    /// Returns all nodes that may vote, by name.
    pub fn voters(&self) -> Vec<NodeId> {
        let robots = self.robots.iter().map(|robot| NodeId::from(robot.name.clone()));
        robots.chain(self.stations.iter().map(|station| station.name.clone())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wiring;
    use consort_skills::extensions::Extensions;

    #[test]
    fn the_seed_determines_the_scenario() {
        let text = |seed| format!("{:?}", DemoScenario::new(6, 2, 8.0, seed));
        assert_eq!(text(7), text(7));
        assert_ne!(text(7), text(8));
    }

    #[test]
    fn six_robots_differ_in_skills_speeds_and_batteries() {
        let scenario = DemoScenario::new(6, 1, 8.0, 1);
        let mobile: Vec<_> = scenario.robots.iter().filter(|robot| robot.speed_mps.is_some()).collect();
        assert_eq!(mobile.len(), 6);
        let skills: BTreeSet<_> = mobile.iter().map(|robot| &robot.skills).collect();
        assert_eq!(skills.len(), 3);
        assert_eq!(scenario.robots.len(), 7);
        assert!(scenario.stations.is_empty());
    }

    #[test]
    fn robots_charge_unless_a_driver_replaces_the_simulator() {
        for (robots, chargers) in [(1, 2), (6, 2), (12, 4), (100, 6)] {
            let scenario = DemoScenario::new(robots, 1, 8.0, 1);
            // The places of the chargers are on the map.
            let settings = wiring::fleet_settings(&scenario.fleet, Extensions::default()).unwrap();
            assert_eq!(settings.charging.map(|charging| charging.chargers.len()), Some(chargers));
        }
        let scenario = DemoScenario::new(6, 1, 8.0, 1).with_driver(&DriverSetting::Command(vec!["driver".to_owned()]));
        assert_eq!(scenario.fleet.charging, None);
        let reference = FleetRef::from(scenario.fleet);
        assert!(scenario.world.fleet == reference && scenario.robots.iter().all(|robot| robot.fleet == reference));
    }

    #[test]
    fn every_scenario_has_three_voters_and_a_sample_per_mission() {
        for (robots, missions) in [(1, 1), (2, 1), (1, 3), (30, 40)] {
            let scenario = DemoScenario::new(robots, missions, 8.0, 1);
            assert!(scenario.voters().len() >= 3);
            assert_eq!(scenario.requests.len(), missions);
            assert_eq!(scenario.world.person.iter().map(|nurse| nurse.samples.len()).sum::<usize>(), missions);
        }
    }
}
