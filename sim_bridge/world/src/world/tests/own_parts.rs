//! Systems and chassis of a program.

use super::robot;
use super::steering::until_ended;
use crate::component_types;
use crate::extend::{Chassis, ChassisSettings, ComponentType, SimState, SimulatorExtension, System, SystemTimer};
use crate::kinematics::{Kinematics, OwnSettings};
use crate::map;
use crate::world::{RobotSetup, World, WorldSetup, check_simulated_actions};
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond, WorldTime};
use consort_skills::actions::{Goal, GoalId, GoalStatus, NavigateToPose, RobotBackend as _};
use consort_skills::domain_file::DomainFile;
use consort_skills::extensions::Extensions;
use nalgebra::Isometry2;
use std::collections::BTreeMap;

/// Counts the seconds, and shows them as a reading.
struct Seconds;
struct Count(f64);

impl System for Seconds {
    fn name(&self) -> &'static str {
        "seconds"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![Count]
    }

    fn init_world(&self, state: &mut SimState, _: &WorldSetup) {
        state.insert_resource(Count(0.0));
        let clock = state.spawn();
        state.schedule(1.0, clock, 1);
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { entity, number }: SystemTimer) {
        state.resource_mut::<Count>().0 = number as f64;
        let robots: Vec<_> = state.robots().map(|(_, robot)| robot).collect();
        for robot in robots {
            assert!(state.set_reading(robot, "count", Scalar::Number(number as f64)));
            assert!(!state.set_reading(robot, "unknown", Scalar::Number(1.0)));
            assert_eq!(state.reading(robot, "count"), Some(Scalar::Number((number as f64).min(3.0))));
        }
        state.schedule(number as f64 + 1.0, entity, number + 1);
    }
}

/// Is at its target at once.
#[derive(Debug)]
struct Teleporter(Isometry2<f64>, Option<Isometry2<f64>>);

impl Chassis for Teleporter {
    fn set_target(&mut self, target: Option<Isometry2<f64>>) {
        self.1 = target;
    }
    fn set_max_speed(&mut self, _: f64) {}
    fn set_heading(&mut self, _: f64) {}
    fn stop_immediately(&mut self) {
        self.1 = None;
    }
    fn control_step(&mut self, _: f64) -> bool {
        let Some(target) = self.1.take() else { return false };
        self.0 = target;
        true
    }
    fn integrate(&mut self, _: f64) {}
    fn is_moving(&self) -> bool {
        self.1.is_some()
    }
    fn pose(&self) -> Isometry2<f64> {
        self.0
    }
    fn remaining_m(&self) -> f64 {
        0.0
    }
}

fn teleporter(settings: &ChassisSettings) -> Result<Box<dyn Chassis>, String> {
    match settings.numbers.get("range_m") {
        Some(range) if *range < 0.0 => Err(format!("range_m is {range}, allowed is 0 or more")),
        _ => Ok(Box::new(Teleporter(settings.pose, None))),
    }
}

const OWN: SimulatorExtension = SimulatorExtension { systems: &[&Seconds], chassis: &[("teleporter", teleporter)] };
static TWICE: SimulatorExtension = SimulatorExtension { systems: &[&Seconds, &Seconds], chassis: &[] };
const EXTENSIONS: Extensions = Extensions { simulator: Some(&OWN), ..Extensions::NONE };

fn domain(text: &str) -> DomainFile {
    let form = consort_protocol::yaml::parse(text).unwrap();
    DomainFile::check(form, &BTreeMap::new(), &[]).unwrap()
}

fn setup(name: &str, range_m: f64) -> WorldSetup {
    let (speed, discharge) = (MetresPerSecond::new(0.5).unwrap(), SharePerSecond::new(0.0).unwrap());
    let carrier = RobotSetup::carrier(robot("r1"), "Dock".parse().unwrap(), speed, BatteryShare::FULL, discharge);
    let settings = BTreeMap::from([("range_m".to_owned(), range_m)]);
    let kinematics = Some(Kinematics::Own(OwnSettings { settings, ..OwnSettings::named(name) }));
    let extensions = EXTENSIONS.with_domain(
        "count.yaml",
        domain("domain: count\nreadings: { count: { type: number, minimum: 0, maximum: 3, simulate: { value: 0 } } }"),
    );
    let setup = WorldSetup::new(map::shipped("hospital").unwrap(), 1).extended(extensions);
    setup.robot(RobotSetup { kinematics, ..carrier })
}

#[test]
fn a_program_adds_systems_and_chassis() {
    let mut world = World::new(setup("teleporter", 5.0)).unwrap();
    let place: consort_protocol::ids::PlaceId = "Crossing".parse().unwrap();
    let pose = world.map().topology().places[&place];
    world.start(&robot("r1"), GoalId(1), Goal::from(NavigateToPose::to(pose, Some(place))));
    assert_eq!(until_ended(&mut world, "r1", 1), GoalStatus::succeeded());
    assert!(world.now().as_secs() < 1.0, "it was there at once");
    world.advance(WorldTime::from_secs(5.5));
    assert_eq!(world.state().resource::<Count>().0, 5.0);
    let telemetry = world.telemetry(&robot("r1")).unwrap();
    assert_eq!(telemetry.readings["count"], Scalar::Number(3.0), "it is limited to its range");
    assert!((telemetry.pose.x - pose.x).hypot(telemetry.pose.y - pose.y) < 1e-9);
}

#[test]
fn mistakes_with_own_parts_are_named() {
    let error = |name, range_m| World::new(setup(name, range_m)).unwrap_err().to_string();
    let unknown = error("teleportr", 1.0);
    assert!(
        unknown.contains("robot r1: this program has no chassis \"teleportr\"; did you mean \"teleporter\"?"),
        "{unknown}"
    );
    let invalid = error("teleporter", -1.0);
    assert!(invalid.contains("robot r1: chassis teleporter: range_m is -1, allowed is 0 or more"), "{invalid}");
    let count = domain("domain: d\nactions: { tally: { simulate: { system: second } } }");
    let unknown = check_simulated_actions(&count, EXTENSIONS).unwrap_err().to_string();
    assert!(
        unknown.contains("actions.tally.simulate.system: there is no system \"second\"; did you mean \"seconds\"?"),
        "{unknown}"
    );
}

#[test]
fn systems_with_the_name_of_another_and_values_of_another_type_are_rejected() {
    let error = |simulator| {
        let extensions = Extensions { simulator: Some(simulator), ..Extensions::NONE };
        let setup = WorldSetup::new(map::shipped("hospital").unwrap(), 1).extended(extensions);
        World::new(setup).unwrap_err().to_string()
    };
    let twice = error(&TWICE);
    assert!(twice.contains("this program has a second system \"seconds\"; a system"), "{twice}");
    let other = error(&"seconds");
    assert!(other.contains("is no consort_world::extend::SimulatorExtension"), "{other}");
}
