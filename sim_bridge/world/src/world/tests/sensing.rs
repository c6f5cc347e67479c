//! Detection of walls, robots and people.

use super::*;
use crate::space::Sensor;
use std::f64::consts::FRAC_PI_2;

/// A at the origin; B 4 m east of it, in the open; C 4 m north, behind a wall; D 2 m south.
fn rooms() -> Map {
    let text = "{name: rooms, walls: [[[-2, 2], [2, 2]], [[8, -1], [8, 1]]], places: [{name: A, kind: other, x_m: 0, \
                y_m: 0}, {name: B, kind: other, x_m: 4, y_m: 0}, {name: C, kind: other, x_m: 0, y_m: 4}, {name: D, \
                kind: other, x_m: 0, y_m: -2}], lanes: [{between: [A, B]}, {between: [B, C]}, {between: [A, D]}]}";
    map::read(text, "rooms").unwrap()
}

fn world_with(sensors: Vec<Sensor>) -> World {
    let setup = WorldSetup::new(rooms(), 1).robot(RobotSetup { sensors, ..carrier("r1", "A") });
    let setup = setup.robot(carrier("east", "B")).robot(carrier("north", "C")).person(nurse("Nia", "D", "s1"));
    World::new(setup).unwrap()
}

fn names(reading: &SensorReading) -> Vec<String> {
    let (SensorReading::Camera(seen) | SensorReading::Proximity(seen)) = reading else { panic!("{reading:?}") };
    let name = |sighting: &Detection| match &sighting.object {
        DetectedObject::Robot(robot) => robot.as_str().to_owned(),
        DetectedObject::Person(person) => person.as_str().to_owned(),
    };
    seen.iter().map(name).collect()
}

#[test]
fn a_ray_ends_at_the_first_wall_or_body() {
    let ray = |bearing_rad, reach_m| Sensor::Range { bearing_rad, reach_m };
    let mut world = world_with(vec![ray(0.0, 10.0), ray(FRAC_PI_2, 10.0), ray(0.0, 3.0), ray(-FRAC_PI_2, 10.0)]);
    let [east, north, short, south] = world.read_sensors(&robot("r1")).unwrap().try_into().unwrap();
    assert_eq!(east, SensorReading::Range(Some(3.75)), "the edge of the robot at B");
    let SensorReading::Range(Some(wall_m)) = north else { panic!("{north:?}") };
    assert!((wall_m - 2.0).abs() < 1e-9, "{wall_m}");
    assert_eq!(short, SensorReading::Range(None));
    let SensorReading::Range(Some(nurse_m)) = south else { panic!("{south:?}") };
    assert!((nurse_m - 1.75).abs() < 1e-9, "{nurse_m}");
    // The robot at B drives off: behind it is a wall.
    let goal = drive_goal(&world, "C");
    run_to_success(&mut world, "east", 1, goal);
    let Some(SensorReading::Range(Some(wall_m))) = world.read_sensors(&robot("r1")).unwrap().first().cloned() else {
        panic!()
    };
    assert!((wall_m - 8.0).abs() < 1e-9, "{wall_m}");
}

#[test]
fn ranges_are_read_by_direction_without_other_sensors() {
    let ray = |bearing_rad, reach_m| Sensor::Range { bearing_rad, reach_m };
    let world = world_with(vec![ray(0.0, 3.0), Sensor::Proximity { reach_m: 1.0 }, ray(-FRAC_PI_2, 10.0)]);
    let ranges = world.read_ranges(&robot("r1"));
    let bearings: Vec<f64> = ranges.iter().map(|range| range.bearing_rad).collect();
    assert_eq!(bearings, [-FRAC_PI_2, 0.0]);
    assert!((ranges[0].distance_m.unwrap() - 1.75).abs() < 1e-9, "the nurse");
    assert_eq!(ranges[1], RangeReading { bearing_rad: 0.0, reach_m: 3.0, distance_m: None });
    assert_eq!((world.read_ranges(&robot("east")), world.read_ranges(&robot("r9"))), (vec![], vec![]));
}

#[test]
fn a_camera_detects_bodies_in_view_and_not_behind_a_wall() {
    let camera = |bearing_rad, field_of_view_rad, reach_m| Sensor::Camera { bearing_rad, field_of_view_rad, reach_m };
    let tau = std::f64::consts::TAU;
    let world = world_with(vec![
        camera(0.0, 1.0, 10.0),
        camera(FRAC_PI_2, 1.0, 10.0),
        camera(0.0, tau, 10.0),
        camera(0.0, tau, 3.0),
    ]);
    let readings = world.read_sensors(&robot("r1")).unwrap();
    let seen: Vec<Vec<String>> = readings.iter().map(names).collect();
    assert_eq!(seen, [vec!["east"], vec![], vec!["Nia", "east"], vec!["Nia"]]);
    let SensorReading::Camera(sightings) = &readings[2] else { panic!() };
    assert_eq!((sightings[1].distance_m, sightings[1].bearing_rad), (4.0, 0.0));
    assert!((sightings[0].bearing_rad + FRAC_PI_2).abs() < 1e-9, "to the right");
}

#[test]
fn a_proximity_sensor_detects_through_walls() {
    let world = world_with(vec![Sensor::Proximity { reach_m: 3.5 }, Sensor::Proximity { reach_m: 1.0 }]);
    let seen: Vec<Vec<String>> = world.read_sensors(&robot("r1")).unwrap().iter().map(names).collect();
    assert_eq!(seen, [vec!["Nia", "east", "north"], vec![]]);
    assert_eq!((world.read_sensors(&robot("east")), world.read_sensors(&robot("r9"))), (Some(vec![]), None));
}

#[test]
fn sensors_are_read_from_files_and_checked() {
    let sensor: Sensor = serde_json::from_str(r#"{"kind": "camera", "field_of_view_rad": 1.2, "reach_m": 8}"#).unwrap();
    assert_eq!(sensor, Sensor::Camera { bearing_rad: 0.0, field_of_view_rad: 1.2, reach_m: 8.0 });
    let body = RobotSetup { sensors: vec![Sensor::Proximity { reach_m: f64::NAN }], ..carrier("r1", "A") };
    let said = World::new(WorldSetup::new(rooms(), 1).robot(body)).unwrap_err().to_string();
    assert_eq!(said, "robot r1: reach_m is NaN, allowed is a number of metres from 0 to 1000");
}
