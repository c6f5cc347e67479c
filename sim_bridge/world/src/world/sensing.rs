//! Sensors of robots. A sensor costs nothing until it is read: a reading is computed from the
//! current positions.

use super::components::{PersonInfo, SimRobot};
use super::location::RobotLocation;
use super::names::PersonName;
use super::simulation::World;
use super::steered::Steered;
use crate::space::{BodyGrid, Disc, Sensor};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use hecs::Entity;
use nalgebra::{Isometry2, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Reading of a sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorReading {
    /// Distance in metres from the robot's centre to the first wall or body along the ray; `None`
    /// if there is none in range.
    Range(Option<f64>),
    /// Robots and people in the camera's field of view, the nearest first.
    Camera(Vec<Detection>),
    /// Robots and people nearby, the nearest first.
    Proximity(Vec<Detection>),
}

/// Reading of a range sensor, with its direction and range.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RangeReading {
    /// Direction, in radians to the left of ahead.
    pub bearing_rad: f64,
    /// Range, in metres.
    pub reach_m: f64,
    /// Distance in metres from the robot's centre to the first wall or body; `None` if there is none in
    /// range.
    pub distance_m: Option<f64>,
}

/// A detected robot or person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// Detected robot or person.
    pub object: DetectedObject,
    /// Distance from centre to centre.
    pub distance_m: f64,
    /// Direction, in radians to the left of ahead.
    pub bearing_rad: f64,
}

/// A robot or person that sensors detect.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DetectedObject {
    /// A robot.
    Robot(RobotId),
    /// A person.
    Person(PersonName),
}

/// Radius of a person: half the width of the shoulders.
const PERSON_RADIUS_M: f64 = 0.25;
/// Cell size of the body grid: about the range of proximity sensors.
const CELL_M: f64 = 2.0;

impl World {
    /// Returns the current readings of a robot's sensors, in the order of its setup; `None` for an
    /// unknown robot.
    pub fn read_sensors(&self, robot: &RobotId) -> Option<Vec<SensorReading>> {
        let own_index = self.state.robots.keys().position(|name| name == robot)?;
        Some(Scene::of(self).read(self, own_index, self.state.robots[robot]))
    }

    /// Returns the current readings of a robot's range sensors, in the order of their directions; empty
    /// for an unknown robot.
    pub fn read_ranges(&self, robot: &RobotId) -> Vec<RangeReading> {
        let sensors = self.robot_setup(robot).map(|setup| setup.sensors).unwrap_or_default();
        if !sensors.iter().any(|sensor| matches!(sensor, Sensor::Range { .. })) {
            return vec![];
        }
        let readings = self.read_sensors(robot).unwrap_or_default();
        let range = |(sensor, reading): (&Sensor, SensorReading)| match (*sensor, reading) {
            (Sensor::Range { bearing_rad, reach_m }, SensorReading::Range(distance_m)) => {
                Some(RangeReading { bearing_rad, reach_m, distance_m })
            }
            _ => None,
        };
        let mut ranges: Vec<RangeReading> = sensors.iter().zip(readings).filter_map(range).collect();
        ranges.sort_by(|a, b| a.bearing_rad.total_cmp(&b.bearing_rad));
        ranges
    }
}

/// Positions at an instant: robots in the order of their names, then people.
struct Scene {
    bodies: BodyGrid,
    objects: Vec<DetectedObject>,
}

impl Scene {
    fn of(world: &World) -> Scene {
        let (state, mut objects, mut bodies) = (&world.state, Vec::new(), BodyGrid::new(CELL_M));
        for (name, robot) in &state.robots {
            let (pose, level) =
                (state.get::<RobotLocation>(*robot).pose(state.now), state.level_of(state.map_position(*robot)));
            let steered = state.find::<Steered>(*robot);
            let at = steered.map_or(Vector3::new(pose.x, pose.y, 0.0), |steered| steered.model.position());
            bodies.add(Disc { at, radius_m: state.get::<SimRobot>(*robot).0.radius_m, level });
            objects.push(DetectedObject::Robot(name.clone()));
        }
        for (name, person) in &state.people {
            let place = state.map.place_at(state.get::<PersonInfo>(*person).place);
            let at = Vector3::new(place.pose.x, place.pose.y, 0.0);
            bodies.add(Disc { at, radius_m: PERSON_RADIUS_M, level: place.level.0 });
            objects.push(DetectedObject::Person(name.clone()));
        }
        bodies.refresh();
        Scene { bodies, objects }
    }

    /// Reads the sensors of a robot, which has the index `own_index` among the bodies.
    fn read(&self, world: &World, own_index: usize, robot: Entity) -> Vec<SensorReading> {
        let state = &world.state;
        let Pose { x, y, yaw } = state.get::<RobotLocation>(robot).pose(state.now);
        let (pose, walls) = (Isometry2::new(Vector2::new(x, y), yaw), &state.walls[self.bodies.disc(own_index).level]);
        let detections = |sensor: &Sensor| {
            let mut detected = Vec::new();
            sensor.for_each_detection(&pose, own_index, &self.bodies, walls, |name, distance_m, bearing_rad| {
                detected.push(Detection { object: self.objects[name].clone(), distance_m, bearing_rad });
            });
            detected.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m).then_with(|| a.object.cmp(&b.object)));
            detected
        };
        let read = |sensor: &Sensor| match sensor {
            Sensor::Range { .. } => SensorReading::Range(sensor.measure_range_m(&pose, own_index, &self.bodies, walls)),
            Sensor::Camera { .. } => SensorReading::Camera(detections(sensor)),
            Sensor::Proximity { .. } => SensorReading::Proximity(detections(sensor)),
        };
        state.get::<SimRobot>(robot).0.sensors.iter().map(read).collect()
    }
}
