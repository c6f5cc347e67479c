//! What robots perceive. A sensor costs nothing until it is read: what it reads is computed from where everybody is then.

use super::World;
use super::components::{Body, Who};
use super::names::PersonName;
use super::systems::steering::Steered;
use super::whereabouts::Whereabouts;
use crate::space::{Bodies, Disc, Sensor};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use hecs::Entity;
use nalgebra::{Isometry2, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What a sensor reads, in the order of a robot's sensors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reading {
    /// Metres from the robot's middle to the first wall or body along the ray; none if there is none within reach.
    Range(Option<f64>),
    /// Who is in the camera's picture, the nearest first.
    Camera(Vec<Sighting>),
    /// Who is near, the nearest first.
    Proximity(Vec<Sighting>),
}

/// Somebody perceived.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sighting {
    /// Who.
    pub who: Seen,
    /// How far, from middle to middle.
    pub distance_m: f64,
    /// In which direction, to the left of ahead.
    pub bearing_rad: f64,
}

/// Who can be perceived.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Seen {
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
    pub fn sense(&self, robot: &RobotId) -> Option<Vec<Reading>> {
        let own = self.floor.robots.keys().position(|name| name == robot)?;
        Some(Scene::of(self).read(self, own, self.floor.robots[robot]))
    }

    /// What the sensors of all robots that have any read now. The work grows with the number of robots and of what they
    /// perceive, not with all pairs of them.
    pub fn readings(&self) -> BTreeMap<RobotId, Vec<Reading>> {
        let scene = Scene::of(self);
        let robots = self.floor.robots.iter().enumerate();
        let perceive = robots.filter(|(_, (_, robot))| !self.floor.get::<Body>(**robot).0.sensors.is_empty());
        perceive.map(|(own, (name, robot))| (name.clone(), scene.read(self, own, *robot))).collect()
    }
}

/// Where everybody is at one instant: robots in the order of their names, then people.
struct Scene {
    bodies: Bodies,
    who: Vec<Seen>,
}

impl Scene {
    fn of(world: &World) -> Scene {
        let (floor, mut who, mut discs) = (&world.floor, Vec::new(), Vec::new());
        for (name, robot) in &floor.robots {
            let (pose, level) = (floor.get::<Whereabouts>(*robot).pose(floor.now), floor.level_of(floor.spot(*robot)));
            let steered = floor.find::<Steered>(*robot);
            let at = steered.map_or(Vector3::new(pose.x, pose.y, 0.0), |steered| steered.mover.position());
            discs.push(Disc { at, radius_m: floor.get::<Body>(*robot).0.radius_m, level });
            who.push(Seen::Robot(name.clone()));
        }
        for (name, person) in &floor.people {
            let place = floor.map.at(floor.get::<Who>(*person).place);
            let at = Vector3::new(place.pose.x, place.pose.y, 0.0);
            discs.push(Disc { at, radius_m: PERSON_RADIUS_M, level: place.level.0 });
            who.push(Seen::Person(name.clone()));
        }
        let mut bodies = Bodies::default();
        bodies.lay_out(discs, CELL_M);
        Scene { bodies, who }
    }

    /// What a robot reads that is `own` among the bodies.
    fn read(&self, world: &World, own: usize, robot: Entity) -> Vec<Reading> {
        let floor = &world.floor;
        let Pose { x, y, yaw } = floor.get::<Whereabouts>(robot).pose(floor.now);
        let (pose, walls) = (Isometry2::new(Vector2::new(x, y), yaw), &floor.walls[self.bodies.disc(own).level]);
        let sightings = |sensor: &Sensor| {
            let mut seen = Vec::new();
            sensor.perceives(&pose, own, &self.bodies, walls, |name, distance_m, bearing_rad| {
                seen.push(Sighting { who: self.who[name].clone(), distance_m, bearing_rad });
            });
            seen.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m).then_with(|| a.who.cmp(&b.who)));
            seen
        };
        let read = |sensor: &Sensor| match sensor {
            Sensor::Range { .. } => Reading::Range(sensor.free_m(&pose, own, &self.bodies, walls)),
            Sensor::Camera { .. } => Reading::Camera(sightings(sensor)),
            Sensor::Proximity { .. } => Reading::Proximity(sightings(sensor)),
        };
        floor.get::<Body>(robot).0.sensors.iter().map(read).collect()
    }
}
