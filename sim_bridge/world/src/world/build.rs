//! Building a world from a setup.

use super::components::SimRobot;
use super::goal_history::GoalHistory;
use super::location::{MapPosition, RobotLocation};
use super::samples::{HandoverCount, HolderEntity, PayloadData};
use super::setup::environment;
use super::setup::{
    Durations, ProgramParts, RobotSetup, SetupError, SetupErrors, WorldLimits, WorldSetup, default_step_s,
};
use super::sim_state::SimState;
use super::simulated_actions::{action_errors, systems_of_actions};
use super::simulation::World;
use super::systems;
use crate::kinematics::{ChassisSettings, Kinematics, OwnSettings, build_chassis};
use crate::map::Map;
use consort_protocol::charging_curve::ChargingCurve;
use consort_protocol::ids::PlaceId;
use consort_skills::domain::standard_domain;
use nalgebra::Isometry2;
use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::ops::RangeInclusive;

const SPEED_MPS: RangeInclusive<f64> = 0.001..=100.0;
const RADIUS_M: RangeInclusive<f64> = 0.01..=10.0;
const DURATION_S: RangeInclusive<f64> = 0.0..=86_400.0;

impl WorldSetup {
    /// An empty world with default durations and limits, and the standard domain.
    pub fn new(map: Map, seed: u64) -> Self {
        let (durations, limits) = (Durations::default(), WorldLimits::default());
        let systems = systems::system_names().map(str::to_owned).collect();
        let (robots, people, objects) = (Vec::new(), Vec::new(), Vec::new());
        let (chargers, doors, obstacles) = (BTreeMap::new(), Vec::new(), Vec::new());
        let (step_s, wind, program) = (default_step_s(), None, ProgramParts::default());
        let threads = NonZeroUsize::MIN;
        let (actions, tasks, readings) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        let setup = Self {
            map,
            robots,
            people,
            objects,
            chargers,
            charging_curve: ChargingCurve::default(),
            doors,
            obstacles,
            seed,
            durations,
            actions,
            tasks,
            readings,
            limits,
            systems,
            step_s,
            threads,
            wind,
            program,
        };
        setup.domain(standard_domain())
    }
}

impl World {
    /// Creates a world at time zero.
    ///
    /// # Errors
    /// [`SetupErrors`] with every error in the setup.
    pub fn new(setup: WorldSetup) -> Result<World, SetupErrors> {
        let errors = check(&setup);
        if !errors.is_empty() {
            return Err(SetupErrors(errors));
        }
        let systems: Vec<_> = setup.systems.iter().filter_map(|name| setup.program.system(name)).collect();
        let actions = systems_of_actions(&setup.actions, &systems);
        let mut state = SimState::new(setup.map.clone(), setup.durations, setup.limits, setup.step_s);
        (state.chargers, state.charging_curve) = (setup.chargers.clone(), setup.charging_curve.clone());
        let rates = setup.actions.iter().filter_map(|(name, action)| Some((name.clone(), action.discharge?)));
        state.discharge_of_actions = rates.collect();
        let renewing = setup.actions.iter().filter(|(_, action)| action.simulate.renews_battery);
        state.renewing_actions = renewing.map(|(name, _)| name.clone()).collect();
        (state.own_chassis, state.threads) = (setup.program.chassis(), setup.threads);
        state.insert_resource(HandoverCount::default());
        let mut world = World::with(state, systems, actions);
        world.for_each_system(|system, state| system.init_world(state, &setup));
        for object in &setup.objects {
            let place = world.state.map.index(&object.place).expect("checked: the place is on the map");
            let load = PayloadData { weight_kg: object.weight_kg, distance_m: object.distance_m };
            world.state.spawn_sample(object.name.clone(), HolderEntity::Table(place), load);
        }
        for robot in setup.robots {
            world.spawn_robot(robot);
        }
        Ok(world)
    }

    fn spawn_robot(&mut self, setup: RobotSetup) {
        let state = &mut self.state;
        let place = state.map.index(&setup.place).expect("checked: the place is on the map");
        let robot = state.spawn();
        state.insert(robot, SimRobot(setup.clone()));
        state.insert(
            robot,
            RobotLocation::Standing { position: MapPosition::Place(place), pose: state.map.place_at(place).pose },
        );
        state.insert(robot, GoalHistory::default());
        state.robots.insert(setup.id.clone(), robot);
        self.for_each_system(|system, state| system.init_robot(state, robot, &setup));
    }
}

fn check(setup: &WorldSetup) -> Vec<SetupError> {
    let mut errors = Vec::new();
    let samples: Vec<_> = setup.people.iter().flat_map(|person| &person.samples).collect();
    let counts = [("robots", setup.robots.len()), ("people", setup.people.len()), ("samples", samples.len())];
    let max = setup.limits.entities_max;
    for (what, count) in counts.into_iter().filter(|(_, count)| *count > max) {
        errors.push(SetupError::TooMany { what, count, max });
    }
    check_numbers(&setup.durations, &setup.limits, &mut errors);
    check_step(setup, &mut errors);
    errors.extend(setup.program.unusable_parts());
    check_systems(setup, &mut errors);
    errors.extend(action_errors(&setup.actions, setup.program));
    environment::check(&setup.map, &setup.doors, &setup.obstacles, &mut errors);
    for charger in setup.chargers.keys() {
        check_place(setup, "charger", charger, &mut errors);
    }
    let mut seen = BTreeSet::new();
    for robot in &setup.robots {
        let subject = format!("robot {}", robot.id);
        check_place(setup, &subject, &robot.place, &mut errors);
        check_robot(robot, &subject, &mut errors);
        check_kinematics(setup, robot, &subject, &mut errors);
        check_unique(subject, &mut seen, &mut errors);
    }
    for person in &setup.people {
        let subject = format!("person {}", person.name);
        check_name("person", person.name.as_str(), person.name.is_valid(), &mut errors);
        check_place(setup, &subject, &person.place, &mut errors);
        person.spontaneous_actions.iter().for_each(|action| action.check(&subject, &mut errors));
        check_unique(subject, &mut seen, &mut errors);
    }
    for object in &setup.objects {
        let subject = format!("object {}", object.name);
        check_name("object", object.name.as_str(), object.name.is_valid(), &mut errors);
        check_place(setup, &subject, &object.place, &mut errors);
        object.check(&mut errors);
        check_unique(format!("sample {}", object.name), &mut seen, &mut errors);
    }
    for sample in samples {
        check_name("sample", sample.as_str(), sample.is_valid(), &mut errors);
        check_unique(format!("sample {sample}"), &mut seen, &mut errors);
    }
    errors
}

fn check_place(setup: &WorldSetup, subject: &str, place: &PlaceId, errors: &mut Vec<SetupError>) {
    if setup.map.place(place).is_none() {
        let (map, hint) = (setup.map.name().to_owned(), setup.map.suggest(place));
        errors.push(SetupError::UnknownPlace { subject: subject.to_owned(), place: place.clone(), map, hint });
    }
}

fn check_unique(subject: String, seen: &mut BTreeSet<String>, errors: &mut Vec<SetupError>) {
    if !seen.insert(subject.clone()) {
        errors.push(SetupError::Duplicate { subject });
    }
}

fn check_name(what: &'static str, name: &str, valid: bool, errors: &mut Vec<SetupError>) {
    if !valid {
        errors.push(SetupError::InvalidName { what, name: name.to_owned() });
    }
}

fn check_robot(robot: &RobotSetup, subject: &str, errors: &mut Vec<SetupError>) {
    if !(0.0..=1.0).contains(&robot.idle_factor) {
        let (field, allowed) = ("idle_factor", "a number from 0 to 1");
        errors.push(SetupError::InvalidNumber {
            subject: subject.to_owned(),
            field,
            value: robot.idle_factor,
            allowed,
        });
    }
    for (field, value) in [("payload_max_kg", robot.payload_max_kg), ("reach_m", robot.reach_m)] {
        environment::check_non_negative(subject, field, value, errors);
    }
    if !SPEED_MPS.contains(&robot.speed.get()) {
        let (field, allowed) = ("speed_mps", "a number from 0.001 to 100");
        errors.push(SetupError::InvalidNumber {
            subject: subject.to_owned(),
            field,
            value: robot.speed.get(),
            allowed,
        });
    }
}

fn check_kinematics(setup: &WorldSetup, robot: &RobotSetup, subject: &str, errors: &mut Vec<SetupError>) {
    if !RADIUS_M.contains(&robot.radius_m) {
        let (field, allowed) = ("radius_m", "a number of metres from 0.01 to 10");
        errors.push(SetupError::InvalidNumber { subject: subject.to_owned(), field, value: robot.radius_m, allowed });
    }
    let mut number = |field, value, range: RangeInclusive<f64>, allowed| {
        if !range.contains(&value) {
            errors.push(SetupError::InvalidNumber { subject: subject.to_owned(), field, value, allowed });
        }
    };
    for sensor in &robot.sensors {
        number("reach_m", sensor.reach_m(), 0.0..=1_000.0, "a number of metres from 0 to 1000");
        number("field_of_view_rad", sensor.field_of_view_rad(), 0.0..=std::f64::consts::TAU, "a number from 0 to 2 pi");
        number("bearing_rad", sensor.bearing_rad(), -10.0..=10.0, "a number from -10 to 10");
    }
    let Some(kinematics) = &robot.kinematics else { return };
    if let Err(error) = kinematics.check() {
        errors.push(SetupError::Kinematics { subject: subject.to_owned(), error });
    }
    if let Kinematics::Own(own) = kinematics {
        check_own_chassis(setup, robot, own, subject, errors);
    }
    if !["driving", "steering"].iter().all(|needed| setup.systems.iter().any(|name| name == needed)) {
        errors.push(SetupError::MissingSystems { subject: subject.to_owned(), systems: setup.systems.join(", ") });
    }
}

fn check_own_chassis(
    setup: &WorldSetup,
    robot: &RobotSetup,
    own: &OwnSettings,
    subject: &str,
    errors: &mut Vec<SetupError>,
) {
    let (numbers, max_mps, radius_m) = (own.settings.clone(), robot.speed.get(), robot.radius_m);
    let settings = ChassisSettings { numbers, max_mps, radius_m, pose: Isometry2::identity() };
    let (subject, name) = (subject.to_owned(), own.name.clone());
    let known = setup.program.chassis();
    match build_chassis(known, &name, &settings) {
        Some(Ok(_)) => {}
        Some(Err(problem)) => errors.push(SetupError::InvalidChassis { subject, name, problem }),
        None => {
            let names = || known.iter().map(|(name, _)| *name);
            let hint = crate::suggest::did_you_mean(&name, names());
            let known = names().collect::<Vec<_>>().join(", ");
            errors.push(SetupError::UnknownChassis { subject, name, known, hint });
        }
    }
}

fn check_step(setup: &WorldSetup, errors: &mut Vec<SetupError>) {
    let mut number = |subject: &str, field, value, range: RangeInclusive<f64>, allowed| {
        if !range.contains(&value) {
            errors.push(SetupError::InvalidNumber { subject: subject.to_owned(), field, value, allowed });
        }
    };
    number("world", "step_s", setup.step_s, 0.001..=10.0, "a number of seconds from 0.001 to 10");
    if let Some(wind) = setup.wind {
        number("wind", "interval_s", wind.interval_s, 0.01..=86_400.0, "a number of seconds from 0.01 to 86400");
        number("wind", "probability", wind.probability, 0.0..=1.0, "a number from 0 to 1");
        number("wind", "max_speed_change_mps", wind.max_speed_change_mps, 0.0..=10.0, "a number from 0 to 10");
    }
}

fn check_numbers(durations: &Durations, limits: &WorldLimits, errors: &mut Vec<SetupError>) {
    let allowed = "a number of seconds from 0 to 86400";
    for (field, value) in [
        ("approach_person_s", durations.approach_person_s),
        ("authenticate_person_s", durations.authenticate_person_s),
        ("operate_drawer_s", durations.operate_drawer_s),
        ("approach_robot_s", durations.approach_robot_s),
        ("pick_up_s", durations.pick_up_s),
        ("deposit_s", durations.deposit_s),
        ("dock_s", durations.dock_s),
        ("person_min_s", durations.person_min_s),
        ("person_max_s", durations.person_max_s),
        ("door_timeout_s", durations.door_timeout_s),
        ("closure_memory_s", durations.closure_memory_s),
    ] {
        if !DURATION_S.contains(&value) {
            errors.push(SetupError::InvalidNumber { subject: "durations".to_owned(), field, value, allowed });
        }
    }
    if durations.person_max_s < durations.person_min_s {
        let (value, allowed) = (durations.person_max_s, "no less than person_min_s");
        errors.push(SetupError::InvalidNumber {
            subject: "durations".to_owned(),
            field: "person_max_s",
            value,
            allowed,
        });
    }
    for (field, value) in [("drawer_slots", limits.drawer_slots), ("ended_goals_kept", limits.ended_goals_kept)] {
        if value == 0 {
            let allowed = "1 or more";
            errors.push(SetupError::InvalidNumber { subject: "limits".to_owned(), field, value: 0.0, allowed });
        }
    }
}

fn check_systems(setup: &WorldSetup, errors: &mut Vec<SetupError>) {
    let mut seen = BTreeSet::new();
    for name in &setup.systems {
        if setup.program.system(name).is_none() {
            let hint = crate::suggest::did_you_mean(name, setup.program.system_names());
            let known = setup.program.system_names().collect::<Vec<_>>().join(", ");
            errors.push(SetupError::UnknownSystem { name: name.clone(), known, hint });
        }
        check_unique(format!("system {name}"), &mut seen, errors);
    }
}
