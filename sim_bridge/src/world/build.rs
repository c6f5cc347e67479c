//! From a setup to a world.

use super::components::SimRobot;
use super::goals::GoalHistory;
use super::location::{MapPosition, RobotLocation};
use super::samples::{HandoverCount, HolderEntity, PayloadData};
use super::setup::{Durations, RobotSetup, SetupError, SetupErrors, WorldLimits, WorldSetup};
use super::sim_state::SimState;
use super::{World, environment_setup, systems};
use consort_protocol::ids::PlaceId;
use std::collections::BTreeSet;
use std::ops::RangeInclusive;

const SPEED_MPS: RangeInclusive<f64> = 0.001..=100.0;
const RADIUS_M: RangeInclusive<f64> = 0.01..=10.0;
const DURATION_S: RangeInclusive<f64> = 0.0..=86_400.0;

impl World {
    /// Sets up a world at time zero.
    ///
    /// # Errors
    /// [`SetupErrors`] with all that is wrong with the setup.
    pub fn new(setup: WorldSetup) -> Result<World, SetupErrors> {
        let problems = check(&setup);
        if !problems.is_empty() {
            return Err(SetupErrors(problems));
        }
        let systems = setup.systems.iter().filter_map(|name| systems::by_name(name)).collect();
        let mut floor = SimState::new(setup.map.clone(), setup.durations, setup.limits, setup.step_s);
        floor.insert_resource(HandoverCount::default());
        let mut world = World { state: floor, systems };
        world.for_each_system(|system, floor| system.init_world(floor, &setup));
        for object in &setup.objects {
            let place = world.state.map.index(&object.place).expect("checked: the place is on the map");
            let load = PayloadData { weight_kg: object.weight_kg, distance_m: object.distance_m };
            world.state.spawn_sample(object.name.clone(), HolderEntity::Table(place), load);
        }
        for body in setup.robots {
            world.spawn_robot(body);
        }
        Ok(world)
    }

    fn spawn_robot(&mut self, body: RobotSetup) {
        let floor = &mut self.state;
        let place = floor.map.index(&body.place).expect("checked: the place is on the map");
        let robot = floor.spawn();
        floor.insert(robot, SimRobot(body.clone()));
        floor.insert(
            robot,
            RobotLocation::Standing { position: MapPosition::Place(place), pose: floor.map.place_at(place).pose },
        );
        floor.insert(robot, GoalHistory::default());
        floor.robots.insert(body.id.clone(), robot);
        self.for_each_system(|system, floor| system.init_robot(floor, robot, &body));
    }
}

fn check(setup: &WorldSetup) -> Vec<SetupError> {
    let mut problems = Vec::new();
    let samples: Vec<_> = setup.people.iter().flat_map(|person| &person.samples).collect();
    let counts = [("robots", setup.robots.len()), ("people", setup.people.len()), ("samples", samples.len())];
    let max = setup.limits.entities_max;
    for (what, count) in counts.into_iter().filter(|(_, count)| *count > max) {
        problems.push(SetupError::TooMany { what, count, max });
    }
    check_numbers(&setup.durations, &setup.limits, &mut problems);
    check_step(setup, &mut problems);
    check_systems(&setup.systems, &mut problems);
    environment_setup::check(&setup.map, &setup.doors, &setup.obstacles, &mut problems);
    let mut seen = BTreeSet::new();
    for body in &setup.robots {
        let who = format!("robot {}", body.id);
        check_place(setup, &who, &body.place, &mut problems);
        check_body(body, &who, &mut problems);
        check_kinematics(setup, body, &who, &mut problems);
        check_twice(who, &mut seen, &mut problems);
    }
    for person in &setup.people {
        let who = format!("person {}", person.name);
        check_name("person", person.name.as_str(), person.name.is_sound(), &mut problems);
        check_place(setup, &who, &person.place, &mut problems);
        person.mood.iter().for_each(|mood| mood.check(&who, &mut problems));
        check_twice(who, &mut seen, &mut problems);
    }
    for object in &setup.objects {
        let who = format!("object {}", object.name);
        check_name("object", object.name.as_str(), object.name.is_sound(), &mut problems);
        check_place(setup, &who, &object.place, &mut problems);
        object.check(&mut problems);
        check_twice(format!("sample {}", object.name), &mut seen, &mut problems);
    }
    for sample in samples {
        check_name("sample", sample.as_str(), sample.is_sound(), &mut problems);
        check_twice(format!("sample {sample}"), &mut seen, &mut problems);
    }
    problems
}

fn check_place(setup: &WorldSetup, who: &str, place: &PlaceId, problems: &mut Vec<SetupError>) {
    if setup.map.place(place).is_none() {
        let (map, hint) = (setup.map.name().to_owned(), setup.map.suggest(place));
        problems.push(SetupError::UnknownPlace { who: who.to_owned(), place: place.clone(), map, hint });
    }
}

fn check_twice(who: String, seen: &mut BTreeSet<String>, problems: &mut Vec<SetupError>) {
    if !seen.insert(who.clone()) {
        problems.push(SetupError::Duplicate { who });
    }
}

fn check_name(what: &'static str, name: &str, sound: bool, problems: &mut Vec<SetupError>) {
    if !sound {
        problems.push(SetupError::InvalidName { what, name: name.to_owned() });
    }
}

fn check_body(body: &RobotSetup, who: &str, problems: &mut Vec<SetupError>) {
    if !(0.0..=1.0).contains(&body.idle_factor) {
        let (field, allowed) = ("idle_factor", "a number from 0 to 1");
        problems.push(SetupError::InvalidNumber { who: who.to_owned(), field, value: body.idle_factor, allowed });
    }
    for (field, value) in [("payload_max_kg", body.payload_max_kg), ("reach_m", body.reach_m)] {
        environment_setup::check_non_negative(who, field, value, problems);
    }
    if !SPEED_MPS.contains(&body.speed.get()) {
        let (field, allowed) = ("speed_mps", "a number from 0.001 to 100");
        problems.push(SetupError::InvalidNumber { who: who.to_owned(), field, value: body.speed.get(), allowed });
    }
}

fn check_kinematics(setup: &WorldSetup, body: &RobotSetup, who: &str, problems: &mut Vec<SetupError>) {
    if !RADIUS_M.contains(&body.radius_m) {
        let (field, allowed) = ("radius_m", "a number of metres from 0.01 to 10");
        problems.push(SetupError::InvalidNumber { who: who.to_owned(), field, value: body.radius_m, allowed });
    }
    let mut number = |field, value, range: RangeInclusive<f64>, allowed| {
        if !range.contains(&value) {
            problems.push(SetupError::InvalidNumber { who: who.to_owned(), field, value, allowed });
        }
    };
    for sensor in &body.sensors {
        number("reach_m", sensor.reach_m(), 0.0..=1_000.0, "a number of metres from 0 to 1000");
        number("opening_rad", sensor.opening_rad(), 0.0..=std::f64::consts::TAU, "a number from 0 to 2 pi");
        number("bearing_rad", sensor.bearing_rad(), -10.0..=10.0, "a number from -10 to 10");
    }
    let Some(kinematics) = &body.kinematics else { return };
    if let Err(problem) = kinematics.check() {
        problems.push(SetupError::Kinematics { who: who.to_owned(), problem });
    }
    if !["driving", "steering"].iter().all(|needed| setup.systems.iter().any(|name| name == needed)) {
        problems.push(SetupError::MissingSystems { who: who.to_owned(), systems: setup.systems.join(", ") });
    }
}

fn check_step(setup: &WorldSetup, problems: &mut Vec<SetupError>) {
    let mut number = |who: &str, field, value, range: RangeInclusive<f64>, allowed| {
        if !range.contains(&value) {
            problems.push(SetupError::InvalidNumber { who: who.to_owned(), field, value, allowed });
        }
    };
    number("world", "step_s", setup.step_s, 0.001..=10.0, "a number of seconds from 0.001 to 10");
    if let Some(gusts) = setup.gusts {
        number("gusts", "every_s", gusts.every_s, 0.01..=86_400.0, "a number of seconds from 0.01 to 86400");
        number("gusts", "chance", gusts.chance, 0.0..=1.0, "a number from 0 to 1");
        number("gusts", "strength_mps", gusts.strength_mps, 0.0..=10.0, "a number from 0 to 10");
    }
}

fn check_numbers(durations: &Durations, limits: &WorldLimits, problems: &mut Vec<SetupError>) {
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
        ("door_patience_s", durations.door_patience_s),
        ("closure_remembered_s", durations.closure_remembered_s),
    ] {
        if !DURATION_S.contains(&value) {
            problems.push(SetupError::InvalidNumber { who: "durations".to_owned(), field, value, allowed });
        }
    }
    if durations.person_max_s < durations.person_min_s {
        let (value, allowed) = (durations.person_max_s, "no less than person_min_s");
        problems.push(SetupError::InvalidNumber { who: "durations".to_owned(), field: "person_max_s", value, allowed });
    }
    for (field, value) in [("drawer_slots", limits.drawer_slots), ("ended_kept", limits.ended_kept)] {
        if value == 0 {
            let allowed = "1 or more";
            problems.push(SetupError::InvalidNumber { who: "limits".to_owned(), field, value: 0.0, allowed });
        }
    }
}

fn check_systems(chosen: &[String], problems: &mut Vec<SetupError>) {
    let mut seen = BTreeSet::new();
    for name in chosen {
        if systems::by_name(name).is_none() {
            let hint = crate::suggest::did_you_mean(name, systems::system_names());
            let known = systems::system_names().collect::<Vec<_>>().join(", ");
            problems.push(SetupError::UnknownSystem { name: name.clone(), known, hint });
        }
        check_twice(format!("system {name}"), &mut seen, problems);
    }
}
