//! An MCAP file that Foxglove opens: messages of its own schemas, as JSON.
//!
//! | topic | schema | when |
//! |---|---|---|
//! | `/map` | `foxglove.SceneUpdate` | once: walls, lanes, places, lifts, in the frame `world` |
//! | `/doors`, `/obstacles`, `/people` | `foxglove.SceneUpdate` | at first, and when one changes |
//! | `/robots` | `foxglove.SceneUpdate` | once: each in its own frame, `robot/NAME` |
//! | `/tf` | `foxglove.FrameTransforms` | at first all robots, then those that have moved |
//! | `/robots/NAME/pose` | `foxglove.PoseInFrame` | likewise |
//! | `/robots/NAME/state` | `consort.RobotState` | at first, once a second while it moves, and when something happens to it |
//! | `/log` | `foxglove.Log` | whatever happens, in words |

mod message;
mod scene;
mod schema;
mod words;

use super::{Moment, RecordError, Tape};
use crate::world::{Happening, JournalEntry, Stance, World};
use consort_protocol::ids::RobotId;
use consort_skills::actions::BodyHost;
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use message::{FrameTransform, FrameTransforms, Log, PoseInFrame, RobotState, Time};
use schema::Schema;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// After so much world time, in seconds, or so many bytes, a chunk is written to the file: what a killed process may lose.
pub const CHUNK_S: f64 = 5.0;
/// See [`CHUNK_S`].
pub const CHUNK_BYTES: u64 = 256 * 1024;

/// How often it is written what state a moving robot is in, in seconds.
const STATE_EVERY_S: f64 = 1.0;

/// The frame in which the map is.
pub const WORLD_FRAME: &str = "world";

/// The frame that goes with a robot.
pub fn frame_of(robot: &RobotId) -> String {
    format!("robot/{robot}")
}

/// See the [module](self).
pub(super) struct Foxglove {
    file: PathBuf,
    writer: Writer<BufWriter<File>>,
    schemas: BTreeMap<&'static str, u16>,
    /// By topic: its number, and how many messages it has.
    channels: BTreeMap<String, (u16, u32)>,
    /// When the first message of the chunk was written that is not in the file yet.
    chunk_since_s: Option<f64>,
    /// When the state of each robot was last written.
    stated_s: BTreeMap<RobotId, f64>,
    /// Time of the latest message, in nanoseconds: later ones are never earlier.
    latest: u64,
    messages: u64,
}

impl Foxglove {
    pub(super) fn create(file: &Path) -> Result<Foxglove, RecordError> {
        let sink = File::create(file).map_err(RecordError::of(file))?;
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            // A chunk reaches the file whole: of one that was begun, nothing could be read.
            .disable_seeking(true)
            .library(concat!("consort ", env!("CARGO_PKG_VERSION")));
        let writer = options.create(BufWriter::new(sink)).map_err(RecordError::of(file))?;
        Ok(Foxglove {
            file: file.to_owned(),
            writer,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            chunk_since_s: None,
            stated_s: BTreeMap::new(),
            latest: 0,
            messages: 0,
        })
    }

    fn write(
        &mut self,
        topic: &str,
        schema: &'static Schema,
        at_s: f64,
        message: &impl Serialize,
    ) -> Result<(), RecordError> {
        let channel = self.channel(topic, schema)?;
        self.latest = self.latest.max(Time::of(at_s).nanoseconds());
        let (channel_id, sequence) = (channel.0, channel.1);
        let header = MessageHeader { channel_id, sequence, log_time: self.latest, publish_time: self.latest };
        let data = serde_json::to_vec(message).map_err(RecordError::of(&self.file))?;
        self.writer.write_to_known_channel(&header, &data).map_err(RecordError::of(&self.file))?;
        self.chunk_since_s.get_or_insert(at_s);
        self.messages += 1;
        Ok(())
    }

    /// A topic's number, and that of the message to come.
    fn channel(&mut self, topic: &str, schema: &'static Schema) -> Result<(u16, u32), RecordError> {
        if let Some((channel, messages)) = self.channels.get_mut(topic) {
            *messages += 1;
            return Ok((*channel, *messages));
        }
        let schema_id = match self.schemas.get(schema.name) {
            Some(id) => *id,
            None => {
                let text = serde_json::to_vec(&schema.describe()).map_err(RecordError::of(&self.file))?;
                let id =
                    self.writer.add_schema(schema.name, "jsonschema", &text).map_err(RecordError::of(&self.file))?;
                self.schemas.insert(schema.name, id);
                id
            }
        };
        let added = self.writer.add_channel(schema_id, topic, "json", &BTreeMap::new());
        let channel = added.map_err(RecordError::of(&self.file))?;
        self.channels.insert(topic.to_owned(), (channel, 1));
        Ok((channel, 1))
    }

    fn stand(&mut self, world: &World, now_s: f64, stances: &[Stance]) -> Result<(), RecordError> {
        if stances.is_empty() {
            return Ok(());
        }
        let timestamp = Time::of(now_s);
        let mut transforms = Vec::with_capacity(stances.len());
        for stance in stances {
            let pose = message::Pose::of(world.map(), stance);
            let topic = format!("/robots/{}/pose", stance.robot);
            let in_frame = PoseInFrame { timestamp, frame_id: WORLD_FRAME.to_owned(), pose };
            self.write(&topic, &schema::POSE_IN_FRAME, now_s, &in_frame)?;
            transforms.push(FrameTransform {
                timestamp,
                parent_frame_id: WORLD_FRAME.to_owned(),
                child_frame_id: frame_of(&stance.robot),
                translation: pose.position,
                rotation: pose.orientation,
            });
        }
        self.write("/tf", &schema::FRAME_TRANSFORMS, now_s, &FrameTransforms { transforms })
    }

    fn state(&mut self, world: &World, now_s: f64, robot: &RobotId) -> Result<(), RecordError> {
        let (Some(telemetry), Some(body)) = (world.telemetry(robot), world.body(robot)) else { return Ok(()) };
        let carries = body.in_drawer.iter().chain(&body.in_arm).map(ToString::to_string).collect();
        let state = RobotState {
            timestamp: Time::of(now_s),
            place: telemetry.place.to_string(),
            battery: telemetry.battery.get(),
            able: telemetry.able,
            drawer_open: body.drawer_open,
            carries,
        };
        self.stated_s.insert(robot.clone(), now_s);
        self.write(&format!("/robots/{robot}/state"), &schema::ROBOT_STATE, now_s, &state)
    }

    /// Writes the scenes that change with what has happened.
    fn redraw(&mut self, world: &World, JournalEntry { time, what }: &JournalEntry) -> Result<(), RecordError> {
        let (map, at_s) = (world.map(), time.as_secs());
        let (topic, scene) = match what {
            Happening::Door { door, open } => ("/doors", scene::door(map, door, *open, at_s)),
            Happening::WayClosed { obstacle, between } => ("/obstacles", scene::obstacle(map, obstacle, between, at_s)),
            Happening::WayOpened { obstacle, .. } => ("/obstacles", scene::gone(obstacle, at_s)),
            Happening::WalkedAway { person } => ("/people", scene::gone(person.as_str(), at_s)),
            Happening::CameBack { person } => {
                let people = world.people().into_iter().filter(|other| other.name == *person);
                ("/people", scene::people(map, people, at_s))
            }
            _ => return Ok(()),
        };
        self.write(topic, &schema::SCENE_UPDATE, at_s, &scene)
    }
}

impl Tape for Foxglove {
    fn begin(&mut self, world: &World) -> Result<(), RecordError> {
        let (map, now_s) = (world.map(), world.now().as_secs());
        let said = [("map", map.name()), ("clock", "world time: from 0 when the world begins")];
        let metadata = said.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        let record = mcap::write::Metadata { name: "consort.world".to_owned(), metadata };
        self.writer.write_metadata(&record).map_err(RecordError::of(&self.file))?;
        let robots: Vec<RobotId> = world.robots();
        let bodies = robots.iter().filter_map(|robot| world.setup_of(robot));
        let scenes = [
            ("/map", scene::map(map, now_s)),
            ("/doors", scene::doors(map, now_s)),
            ("/people", scene::people(map, world.people().into_iter().filter(|person| !person.away), now_s)),
            ("/robots", scene::robots(bodies, now_s)),
        ];
        for (topic, scene) in scenes.iter().filter(|(_, scene)| !scene.is_empty()) {
            self.write(topic, &schema::SCENE_UPDATE, now_s, scene)?;
        }
        let stances: Vec<Stance> = world.stances().collect();
        self.stand(world, now_s, &stances)?;
        robots.iter().try_for_each(|robot| self.state(world, now_s, robot))
    }

    fn take(&mut self, world: &World, moment: &Moment<'_>) -> Result<(), RecordError> {
        let now_s = moment.now_s;
        for entry in moment.news {
            let (level, name, message) = words::of(&entry.what);
            let timestamp = Time::of(entry.time.as_secs());
            let log = Log { timestamp, level, message, name, file: String::new(), line: 0 };
            self.write("/log", &schema::LOG, entry.time.as_secs(), &log)?;
            self.redraw(world, entry)?;
        }
        self.stand(world, now_s, moment.moved)?;
        for robot in world.robots() {
            let due = self.stated_s.get(&robot).is_none_or(|stated_s| now_s >= stated_s + STATE_EVERY_S - 1e-6);
            let moved = moment.moved.iter().any(|stance| stance.robot == robot);
            if due && moved || moment.news.iter().any(|entry| words::is_about(&entry.what, &robot)) {
                self.state(world, now_s, &robot)?;
            }
        }
        Ok(())
    }

    fn time_passed(&mut self, now_s: f64) -> Result<(), RecordError> {
        if self.chunk_since_s.is_some_and(|since_s| now_s >= since_s + CHUNK_S) {
            self.chunk_since_s = None;
            self.writer.flush().map_err(RecordError::of(&self.file))?;
        }
        Ok(())
    }

    fn end(&mut self, world: &World) -> Result<String, RecordError> {
        self.writer.finish().map_err(RecordError::of(&self.file))?;
        let (file, messages, now_s) = (self.file.display(), self.messages, world.now().as_secs());
        Ok(format!("{file}: {messages} messages, {now_s:.0} s of world time"))
    }
}
