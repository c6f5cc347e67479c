//! A recording of a world as an MCAP file.

use super::mcap_file::{CHUNK_S, ExistingFile, McapFile, MessageStamp};
use super::message::{self, Log, RobotState, Time};
use super::poses::write_poses;
use super::schema::{self, Schema};
use super::{event_text, scene};
use crate::record::sink::{RecordError, RecordingSink, WorldChanges};
use crate::world::{LoggedEvent, MotionState, PersonReport, World, WorldEvent};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_skills::actions::RobotBackend;
use consort_text::count;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

/// Interval at which the state of a moving robot is written, in seconds.
const STATE_EVERY_S: f64 = 1.0;

/// The sink of a recording.
pub(in crate::record) struct FoxgloveSink {
    file: McapFile,
    /// Time at which the state of each robot was last written.
    state_written_s: BTreeMap<RobotId, f64>,
}

impl FoxgloveSink {
    pub(in crate::record) fn create(file: &Path) -> Result<FoxgloveSink, RecordError> {
        Ok(FoxgloveSink { file: McapFile::create(file, ExistingFile::Replace)?, state_written_s: BTreeMap::new() })
    }

    fn write(
        &mut self,
        topic: &str,
        schema: &'static Schema,
        at_s: f64,
        message: &impl Serialize,
    ) -> Result<(), RecordError> {
        self.file.write(topic, schema, MessageStamp::at(Time::from_seconds(at_s)), message)
    }

    fn write_positions(&mut self, world: &World, now_s: f64, positions: &[MotionState]) -> Result<(), RecordError> {
        if positions.is_empty() {
            return Ok(());
        }
        let poses = positions.iter().map(|position| (&position.robot, message::Pose::of(world.map(), position)));
        write_poses(&mut self.file, poses, Time::from_seconds(now_s))
    }

    fn state(&mut self, world: &World, now_s: f64, robot: &RobotId) -> Result<(), RecordError> {
        let (Some(telemetry), Some(body)) = (world.telemetry(robot), world.robot_report(robot)) else { return Ok(()) };
        let carries = body.in_drawer.iter().chain(&body.in_arm).map(ToString::to_string).collect();
        let state = RobotState {
            timestamp: Time::from_seconds(now_s),
            place: telemetry.place.to_string(),
            battery: telemetry.battery.get(),
            able: telemetry.able,
            drawer_open: body.drawer_open,
            carries,
        };
        self.state_written_s.insert(robot.clone(), now_s);
        self.write(&format!("/robots/{robot}/state"), &schema::ROBOT_STATE, now_s, &state)
    }

    /// Writes the scenes that an event changes.
    fn redraw(&mut self, world: &World, LoggedEvent { time, event }: &LoggedEvent) -> Result<(), RecordError> {
        let (map, at_s) = (world.map(), time.as_secs());
        let at = Time::from_seconds(at_s);
        let (topic, scene) = match event {
            WorldEvent::DoorMoved { door, open } => ("/doors", scene::door(map, door, *open, at)),
            WorldEvent::LaneBlocked { obstacle, between } => {
                ("/obstacles", scene::obstacle(map, obstacle, between, at))
            }
            WorldEvent::LaneCleared { obstacle, .. } => ("/obstacles", scene::deletions(&[obstacle], at)),
            WorldEvent::PersonLeft { person } => ("/people", scene::deletions(&[person.as_str()], at)),
            WorldEvent::PersonReturned { person } => {
                let people = world.people().into_iter().filter(|other| other.name == *person);
                ("/people", scene::people(map, people.map(name_and_place), at))
            }
            _ => return Ok(()),
        };
        self.write(topic, &schema::SCENE_UPDATE, at_s, &scene)
    }
}

impl RecordingSink for FoxgloveSink {
    fn begin(&mut self, world: &World) -> Result<(), RecordError> {
        let (map, now_s) = (world.map(), world.now().as_secs());
        let metadata = [("map", map.name()), ("clock", "world time: from 0 when the world begins")];
        self.file
            .write_metadata("consort.world", metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into())?;
        let robots: Vec<RobotId> = world.robots();
        let bodies = robots.iter().filter_map(|robot| world.robot_setup(robot)).map(|body| (body.id, body.radius_m));
        let (people, at) = (world.people().into_iter().filter(|person| !person.away), Time::from_seconds(now_s));
        let scenes = [
            ("/map", scene::map(map, at)),
            ("/doors", scene::doors(map, |_| false, at)),
            ("/people", scene::people(map, people.map(name_and_place), at)),
            ("/robots", scene::robots(bodies, at)),
        ];
        for (topic, scene) in scenes.iter().filter(|(_, scene)| !scene.is_empty()) {
            self.write(topic, &schema::SCENE_UPDATE, now_s, scene)?;
        }
        let positions: Vec<MotionState> = world.motion_states().collect();
        self.write_positions(world, now_s, &positions)?;
        robots.iter().try_for_each(|robot| self.state(world, now_s, robot))
    }

    fn write_changes(&mut self, world: &World, changes: &WorldChanges<'_>) -> Result<(), RecordError> {
        let now_s = changes.now_s;
        for entry in changes.events {
            let (level, name, message) = event_text::log_line(&entry.event);
            let timestamp = Time::from_seconds(entry.time.as_secs());
            let log = Log { timestamp, level, message, name, file: String::new(), line: 0 };
            self.write("/log", &schema::LOG, entry.time.as_secs(), &log)?;
            self.redraw(world, entry)?;
        }
        self.write_positions(world, now_s, changes.moved)?;
        for robot in world.robots() {
            let due = self
                .state_written_s
                .get(&robot)
                .is_none_or(|state_written_s| now_s >= state_written_s + STATE_EVERY_S - 1e-6);
            let moved = changes.moved.iter().any(|position| position.robot == robot);
            if due && moved || changes.events.iter().any(|entry| event_text::changes_state_of(&entry.event, &robot)) {
                self.state(world, now_s, &robot)?;
            }
        }
        Ok(())
    }

    fn on_time_advanced(&mut self, now_s: f64) -> Result<(), RecordError> {
        self.file.flush_if_older(Time::from_seconds(now_s), Duration::from_secs_f64(CHUNK_S))
    }

    fn end(&mut self, world: &World) -> Result<String, RecordError> {
        self.file.finish()?;
        let (file, now_s) = (self.file.path().display(), world.now().as_secs());
        let messages = count(self.file.messages(), "message", "messages");
        Ok(format!("{file}: {messages}, {now_s:.0} s of world time"))
    }
}

fn name_and_place(person: PersonReport) -> (String, PlaceId) {
    (person.name.to_string(), person.place)
}
