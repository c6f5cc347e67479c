//! What robots perceive. A sensor costs nothing until it is read: what it reads is computed from where everybody is then.

use super::World;
use super::components::{PersonInfo, SimRobot};
use super::location::RobotLocation;
use super::names::PersonName;
use super::systems::steering::Steered;
use crate::space::{BodyGrid, Disc, Sensor};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use hecs::Entity;
use nalgebra::{Isometry2, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What a sensor reads, in the order of a robot's sensors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorReading {
    /// Metres from the robot's middle to the first wall or body along the ray; none if there is none within reach.
    Range(Option<f64>),
    /// Who is in the camera's picture, the nearest first.
    Camera(Vec<Detection>),
    /// Who is near, the nearest first.
    Proximity(Vec<Detection>),
}

/// Somebody perceived.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// Who.
    pub object: DetectedObject,
    /// How far, from middle to middle.
    pub distance_m: f64,
    /// In which direction, to the left of ahead.
    pub bearing_rad: f64,
}

/// Who can be perceived.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DetectedObject {
    /// A robot.
    Robot(RobotId),
    /// A person.
    Person(PersonName),
}

/// From the middle of a person to their outermost part: half the width of shoulders.
const PERSON_RADIUS_M: f64 = 0.25;
/// How wide the cells are in which bodies are looked for: about what feelers reach.
const CELL_M: f64 = 2.0;

impl World {
    /// What a robot's sensors read now, in the order of its setup; none for a robot that is not here. For many robots
    /// [`readings`](World::readings) is quicker.
    pub fn read_sensors(&self, robot: &RobotId) -> Option<Vec<SensorReading>> {
        let own = self.state.robots.keys().position(|name| name == robot)?;
        Some(Scene::of(self).read(self, own, self.state.robots[robot]))
    }

    /// What the sensors of all robots that have any read now. The work grows with the number of robots and of what they
    /// perceive, not with all pairs of them.
    pub fn read_all_sensors(&self) -> BTreeMap<RobotId, Vec<SensorReading>> {
        let scene = Scene::of(self);
        let robots = self.state.robots.iter().enumerate();
        let perceive = robots.filter(|(_, (_, robot))| !self.state.get::<SimRobot>(**robot).0.sensors.is_empty());
        perceive.map(|(own, (name, robot))| (name.clone(), scene.read(self, own, *robot))).collect()
    }
}

/// Where everybody is at one instant: robots in the order of their names, then people.
struct Scene {
    bodies: BodyGrid,
    who: Vec<DetectedObject>,
}

impl Scene {
    fn of(world: &World) -> Scene {
        let (floor, mut who, mut discs) = (&world.state, Vec::new(), Vec::new());
        for (name, robot) in &floor.robots {
            let (pose, level) =
                (floor.get::<RobotLocation>(*robot).pose(floor.now), floor.level_of(floor.map_position(*robot)));
            let steered = floor.find::<Steered>(*robot);
            let at = steered.map_or(Vector3::new(pose.x, pose.y, 0.0), |steered| steered.model.position());
            discs.push(Disc { at, radius_m: floor.get::<SimRobot>(*robot).0.radius_m, level });
            who.push(DetectedObject::Robot(name.clone()));
        }
        for (name, person) in &floor.people {
            let place = floor.map.place_at(floor.get::<PersonInfo>(*person).place);
            let at = Vector3::new(place.pose.x, place.pose.y, 0.0);
            discs.push(Disc { at, radius_m: PERSON_RADIUS_M, level: place.level.0 });
            who.push(DetectedObject::Person(name.clone()));
        }
        let mut bodies = BodyGrid::default();
        bodies.rebuild(discs, CELL_M);
        Scene { bodies, who }
    }

    /// What a robot reads that is `own` among the bodies.
    fn read(&self, world: &World, own: usize, robot: Entity) -> Vec<SensorReading> {
        let floor = &world.state;
        let Pose { x, y, yaw } = floor.get::<RobotLocation>(robot).pose(floor.now);
        let (pose, walls) = (Isometry2::new(Vector2::new(x, y), yaw), &floor.walls[self.bodies.disc(own).level]);
        let sightings = |sensor: &Sensor| {
            let mut seen = Vec::new();
            sensor.for_each_detection(&pose, own, &self.bodies, walls, |name, distance_m, bearing_rad| {
                seen.push(Detection { object: self.who[name].clone(), distance_m, bearing_rad });
            });
            seen.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m).then_with(|| a.object.cmp(&b.object)));
            seen
        };
        let read = |sensor: &Sensor| match sensor {
            Sensor::Range { .. } => SensorReading::Range(sensor.measure_range_m(&pose, own, &self.bodies, walls)),
            Sensor::Camera { .. } => SensorReading::Camera(sightings(sensor)),
            Sensor::Proximity { .. } => SensorReading::Proximity(sightings(sensor)),
        };
        floor.get::<SimRobot>(robot).0.sensors.iter().map(read).collect()
    }
}
