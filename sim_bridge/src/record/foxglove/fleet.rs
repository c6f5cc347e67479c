//! A fleet as somebody hears of it, on the topics of a recorded world: whoever tells has no world, but poses, people and
//! doors. What has not changed is not written again.
//!
//! Whoever jumps to the middle of a recording is given the latest message of each topic. So that nothing is missing then, a
//! scene is always told whole.

use super::message::{Log, Pose, Vector3, elevation_m};
use super::{McapFile, MessageStamp, Time, scene, schema, write_poses};
use crate::map::Map;
use crate::record::RecordError;
use consort_protocol::ids::{PlaceId, RobotId};
use std::collections::{BTreeMap, BTreeSet};

/// How wide robots are drawn of which nobody says it, as a radius in metres.
const RADIUS_M: f64 = 0.3;

/// Where a robot is.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotPose {
    /// Which.
    pub robot: RobotId,
    /// The place that it stands at or passed last: it tells the level.
    pub place: Option<PlaceId>,
    /// Where, in metres on its level.
    pub pose: consort_protocol::pose::Pose,
}

/// Something that happened, in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogMessage {
    /// Who or what it is about.
    pub name: String,
    /// What.
    pub message: String,
    /// Whether somebody should look at it.
    pub is_warning: bool,
}

/// What was drawn of a fleet so far.
#[derive(Debug, Default)]
pub struct FleetScene {
    map: Option<Map>,
    robots: BTreeMap<RobotId, Pose>,
    people: BTreeMap<String, PlaceId>,
    doors: BTreeMap<String, bool>,
}

impl FleetScene {
    /// Draws the map. Before there is one, no people and no doors are drawn.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written to; so with all others.
    pub fn set_map(&mut self, file: &mut McapFile, map: Map, at: Time) -> Result<(), RecordError> {
        file.write("/map", &schema::SCENE_UPDATE, MessageStamp::at(at), &scene::map(&map, at))?;
        self.map = Some(map);
        (self.people, self.doors) = (BTreeMap::new(), BTreeMap::new());
        self.draw_doors(file, at)
    }

    /// Draws robots where they are; what is said of some says nothing of the others.
    ///
    /// # Errors
    /// As [`set_map`](Self::set_map).
    pub fn set_robots(
        &mut self,
        file: &mut McapFile,
        robots: impl IntoIterator<Item = RobotPose>,
        at: Time,
    ) -> Result<(), RecordError> {
        let (before, mut moved) = (self.robots.len(), vec![]);
        for RobotPose { robot, place, pose } in robots {
            let level = self.map.as_ref().zip(place).and_then(|(map, place)| Some((map, map.level_of(&place)?)));
            let z = level.map_or(0.0, |(map, level)| elevation_m(map, level));
            let pose = Pose::facing(Vector3::new(pose.x, pose.y, z), pose.yaw);
            if self.robots.get(&robot) != Some(&pose) {
                self.robots.insert(robot.clone(), pose);
                moved.push((robot, pose));
            }
        }
        if self.robots.len() != before {
            self.draw_robots(file, &[], at)?;
        }
        match moved.is_empty() {
            true => Ok(()),
            false => write_poses(file, moved.iter().map(|(robot, pose)| (robot, *pose)), at),
        }
    }

    /// Takes robots away that are not among these.
    ///
    /// # Errors
    /// As [`set_map`](Self::set_map).
    pub fn retain_robots(
        &mut self,
        file: &mut McapFile,
        present: &BTreeSet<RobotId>,
        at: Time,
    ) -> Result<(), RecordError> {
        let gone: Vec<RobotId> = self.robots.keys().filter(|robot| !present.contains(robot)).cloned().collect();
        if gone.is_empty() {
            return Ok(());
        }
        self.robots.retain(|robot, _| present.contains(robot));
        self.draw_robots(file, &gone.iter().map(RobotId::as_str).collect::<Vec<_>>(), at)
    }

    fn draw_robots(&self, file: &mut McapFile, gone: &[&str], at: Time) -> Result<(), RecordError> {
        let mut scene = scene::robots(self.robots.keys().map(|robot| (robot.clone(), RADIUS_M)), at);
        scene.deletions = scene::deletions(gone, at).deletions;
        file.write("/robots", &schema::SCENE_UPDATE, MessageStamp::at(at), &scene)
    }

    /// Draws people at their places: those who are there, all of them.
    ///
    /// # Errors
    /// As [`set_map`](Self::set_map).
    pub fn set_people(
        &mut self,
        file: &mut McapFile,
        people: BTreeMap<String, PlaceId>,
        at: Time,
    ) -> Result<(), RecordError> {
        let Some(map) = self.map.as_ref().filter(|_| people != self.people) else { return Ok(()) };
        let before = std::mem::replace(&mut self.people, people);
        let gone: Vec<&str> =
            before.keys().filter(|name| !self.people.contains_key(*name)).map(String::as_str).collect();
        let mut scene = scene::people(map, self.people.clone().into_iter(), at);
        scene.deletions = scene::deletions(&gone, at).deletions;
        file.write("/people", &schema::SCENE_UPDATE, MessageStamp::at(at), &scene)
    }

    /// Draws doors as they stand: by name, whether it is open.
    ///
    /// # Errors
    /// As [`set_map`](Self::set_map).
    pub fn set_doors(
        &mut self,
        file: &mut McapFile,
        doors: BTreeMap<String, bool>,
        at: Time,
    ) -> Result<(), RecordError> {
        if doors == self.doors {
            return Ok(());
        }
        self.doors = doors;
        self.draw_doors(file, at)
    }

    fn draw_doors(&self, file: &mut McapFile, at: Time) -> Result<(), RecordError> {
        let Some(map) = self.map.as_ref().filter(|map| !map.doors().is_empty()) else { return Ok(()) };
        let scene = scene::doors(map, |door| self.doors.get(door) == Some(&true), at);
        file.write("/doors", &schema::SCENE_UPDATE, MessageStamp::at(at), &scene)
    }

    /// Writes what happened into the log.
    ///
    /// # Errors
    /// As [`set_map`](Self::set_map).
    pub fn log(&self, file: &mut McapFile, said: LogMessage, stamp: MessageStamp) -> Result<(), RecordError> {
        let level = if said.is_warning { super::event_text::WARNING } else { super::event_text::INFO };
        let LogMessage { name, message, .. } = said;
        let log = Log { timestamp: stamp.publish_time, level, message, name, file: String::new(), line: 0 };
        file.write("/log", &schema::LOG, stamp, &log)
    }
}
