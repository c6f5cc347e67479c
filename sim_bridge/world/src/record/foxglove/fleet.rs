//! A fleet as an observer receives it, on the same topics as a recorded world. The observer has no
//! world, only poses, people and doors. Unchanged values are not written again.
//!
//! A viewer that jumps to the middle of a recording receives the latest message of each topic. Each
//! message therefore contains its whole scene.

use super::mcap_file::{McapFile, MessageStamp};
use super::message::{Log, Pose, Time, Vector3, elevation_m};
use super::poses::write_poses;
use super::{event_text, scene, schema};
use crate::map::Map;
use crate::record::sink::RecordError;
use consort_protocol::ids::{PlaceId, RobotId};
use std::collections::{BTreeMap, BTreeSet};

/// Radius for drawing robots of unknown size, in metres.
const RADIUS_M: f64 = 0.3;

/// Position of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotPose {
    /// Robot.
    pub robot: RobotId,
    /// The place at which the robot stands, or the last place passed. It determines the level.
    pub place: Option<PlaceId>,
    /// Pose in metres, on its level.
    pub pose: consort_protocol::pose::Pose,
}

/// Log entry of an event, as text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogMessage {
    /// Subject of the event.
    pub name: String,
    /// Text of the event.
    pub message: String,
    /// True if the event needs attention.
    pub is_warning: bool,
}

/// State of a fleet as drawn so far.
#[derive(Debug, Default)]
pub struct FleetScene {
    map: Option<Map>,
    robots: BTreeMap<RobotId, Pose>,
    people: BTreeMap<String, PlaceId>,
    doors: BTreeMap<String, bool>,
}

impl FleetScene {
    /// Draws the map. Without a map, no people and no doors are drawn.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written. The same applies to the other methods.
    pub fn set_map(&mut self, file: &mut McapFile, map: Map, at: Time) -> Result<(), RecordError> {
        file.write("/map", &schema::SCENE_UPDATE, MessageStamp::at(at), &scene::map(&map, at))?;
        self.map = Some(map);
        (self.people, self.doors) = (BTreeMap::new(), BTreeMap::new());
        self.draw_doors(file, at)
    }

    /// Draws robots at their positions. Robots that are not listed keep theirs.
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

    /// Removes the robots that are not in `present`.
    ///
    /// # Errors
    /// As [`set_map`](Self::set_map).
    pub fn retain_robots(
        &mut self,
        file: &mut McapFile,
        present: &BTreeSet<RobotId>,
        at: Time,
    ) -> Result<(), RecordError> {
        let removed: Vec<RobotId> = self.robots.keys().filter(|robot| !present.contains(robot)).cloned().collect();
        if removed.is_empty() {
            return Ok(());
        }
        self.robots.retain(|robot, _| present.contains(robot));
        self.draw_robots(file, &removed.iter().map(RobotId::as_str).collect::<Vec<_>>(), at)
    }

    fn draw_robots(&self, file: &mut McapFile, removed: &[&str], at: Time) -> Result<(), RecordError> {
        let mut scene = scene::robots(self.robots.keys().map(|robot| (robot.clone(), RADIUS_M)), at);
        scene.deletions = scene::deletions(removed, at).deletions;
        file.write("/robots", &schema::SCENE_UPDATE, MessageStamp::at(at), &scene)
    }

    /// Draws people at their places. The list is complete: a person missing from it is removed.
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
        let removed: Vec<&str> =
            before.keys().filter(|name| !self.people.contains_key(*name)).map(String::as_str).collect();
        let mut scene = scene::people(map, self.people.clone().into_iter(), at);
        scene.deletions = scene::deletions(&removed, at).deletions;
        file.write("/people", &schema::SCENE_UPDATE, MessageStamp::at(at), &scene)
    }

    /// Draws doors: by name, whether each is open.
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

    /// Writes an event to the log.
    ///
    /// # Errors
    /// As [`set_map`](Self::set_map).
    pub fn log(&self, file: &mut McapFile, message: LogMessage, stamp: MessageStamp) -> Result<(), RecordError> {
        let level = if message.is_warning { event_text::WARNING } else { event_text::INFO };
        let LogMessage { name, message, .. } = message;
        let log = Log { timestamp: stamp.publish_time, level, message, name, file: String::new(), line: 0 };
        file.write("/log", &schema::LOG, stamp, &log)
    }
}
