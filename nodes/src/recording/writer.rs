//! The file that is being written.

use super::gaps::{EventGap, GapDetector};
use super::schemas::{
    self, BEACON, EVENT, FLEET_METADATA, FORMAT_VERSION, GAP, LINKS, LinksMessage, REPEATED_VIEW, RepeatedViewMessage,
    TELEMETRY, VIEW, ViewMessage,
};
use crate::fleet_model::{FleetInput, FleetModel};
use crate::map_loader::LoadedMap;
use consort_protocol::count::count;
use consort_protocol::event::Event;
use consort_protocol::ids::{FleetId, PlaceId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::pose::Pose;
use consort_sim::record::RecordError;
use consort_sim::record::foxglove::{ExistingFile, FleetScene, LogMessage, McapFile, MessageStamp, RobotPose, Time};
use serde::Serialize;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

/// After this long what was heard is in the file: what is lost if the recorder is killed.
pub const FLUSH_AFTER: Duration = Duration::from_secs(1);

/// What a recording holds.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RecordingStats {
    /// Its length in seconds.
    pub seconds: f64,
    /// Events heard.
    pub events: u64,
    /// Reports of bodies.
    pub reports: u64,
    /// Views that nodes answered.
    pub views: u64,
    /// Stretches in which events of a node were not heard.
    pub gaps: u64,
    /// Events that were not heard.
    pub lost: u64,
    /// Messages in all.
    pub messages: u64,
    /// Size of the file.
    pub bytes: u64,
}

/// A file on which a fleet is recorded.
pub struct RecordingWriter {
    file: McapFile,
    keys: Keys,
    scene: FleetScene,
    gaps: GapDetector,
    /// Each view as it was last written, whole.
    views: BTreeMap<Key, Value>,
    began_ms: u64,
    latest_ms: u64,
    recorded: RecordingStats,
}

impl RecordingWriter {
    /// Begins a recording of a fleet, drawn at `node`.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written, or is there already and is to be kept.
    pub fn create(
        path: &Path,
        existing: ExistingFile,
        fleet: &FleetId,
        node: &str,
        began_ms: u64,
    ) -> Result<RecordingWriter, RecordError> {
        let mut file = McapFile::create(path, existing)?;
        let said = [
            ("fleet", fleet.to_string()),
            ("node", node.to_owned()),
            ("began_ms", began_ms.to_string()),
            ("format", FORMAT_VERSION.to_owned()),
            ("clock", "milliseconds since 1970, of the recorder's clock".to_owned()),
        ];
        file.write_metadata(FLEET_METADATA, said.map(|(name, value)| (name.to_owned(), value)).into())?;
        Ok(RecordingWriter {
            file,
            keys: Keys::new(fleet),
            scene: FleetScene::default(),
            gaps: GapDetector::default(),
            views: BTreeMap::new(),
            began_ms,
            latest_ms: began_ms,
            recorded: RecordingStats::default(),
        })
    }

    /// Writes down what was heard. `picture` has taken it in already.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written to.
    pub fn write_input(&mut self, heard: &FleetInput, picture: &FleetModel, now_ms: u64) -> Result<(), RecordError> {
        self.latest_ms = self.latest_ms.max(now_ms);
        let at = Time::from_millis(now_ms);
        match heard {
            FleetInput::Event(event) => self.event(event, picture, at),
            FleetInput::Beacon(beacon) => self.file.write("/coordinator", &BEACON, MessageStamp::at(at), beacon),
            FleetInput::Links(links) => {
                self.file.write("/links", &LINKS, MessageStamp::at(at), &LinksMessage { links: *links })
            }
            FleetInput::Telemetry { robot, telemetry } => {
                self.recorded.reports += 1;
                self.file.write(&schemas::telemetry_topic(robot), &TELEMETRY, MessageStamp::at(at), telemetry)?;
                self.scene.set_robots(&mut self.file, robot_at(picture, robot), at)
            }
            FleetInput::View { key, view } => {
                self.recorded.views += 1;
                self.view(key, view, picture, now_ms)?;
                self.draw(key, view, picture, at)
            }
        }
    }

    fn event(&mut self, event: &Event, picture: &FleetModel, at: Time) -> Result<(), RecordError> {
        if let Some(gap) = self.gaps.observe(event) {
            self.gap(&gap, at)?;
        }
        self.recorded.events += 1;
        let said = Time::from_millis(event.at_ms);
        // The format has 32 bits for it; the message itself has all.
        let stamp = MessageStamp { log_time: at, publish_time: said, sequence: Some(event.sequence as u32) };
        self.file.write("/events", &EVENT, stamp, event)?;
        let Some((_, logged)) = picture.log().last_key_value() else { return Ok(()) };
        let message = format!("{}: {}", logged.word, logged.text);
        let said = LogMessage { name: event.node.to_string(), message, is_warning: logged.alarm };
        self.scene.log(&mut self.file, said, MessageStamp { sequence: None, ..stamp })
    }

    /// Most answers are those of a second ago.
    fn view(&mut self, key: &Key, view: &Value, picture: &FleetModel, now_ms: u64) -> Result<(), RecordError> {
        let age_ms = view.get("age_ms").and_then(Value::as_u64);
        let said = Time::from_millis(now_ms.saturating_sub(age_ms.unwrap_or(0)));
        let (stamp, said) = (
            MessageStamp { log_time: Time::from_millis(now_ms), publish_time: said, sequence: None },
            self.keys.write(key),
        );
        if self.views.get(key).is_some_and(|before| is_same(before, view)) {
            return self.file.write("/view/again", &REPEATED_VIEW, stamp, &RepeatedViewMessage { key: said, age_ms });
        }
        self.views.insert(key.clone(), view.clone());
        // Of missions that are forgotten nothing more is heard.
        self.views.retain(|key, _| match key {
            Key::ViewMission(mission) => picture.missions().contains_key(mission.as_str()),
            _ => true,
        });
        self.file.write(&schemas::view_topic(key), &VIEW, stamp, &ViewMessage { key: said, view })
    }

    fn gap(&mut self, gap: &EventGap, at: Time) -> Result<(), RecordError> {
        self.recorded.gaps += 1;
        self.recorded.lost += gap.lost;
        self.file.write("/gaps", &GAP, MessageStamp::at(at), gap)?;
        let lost = count(gap.lost, "event was", "events were");
        let message = format!("{lost} not heard, after number {}", gap.after);
        let said = LogMessage { name: gap.node.to_string(), message, is_warning: true };
        self.scene.log(&mut self.file, said, MessageStamp::at(at))
    }

    /// What a view changes of the scene.
    fn draw(&mut self, key: &Key, view: &Value, picture: &FleetModel, at: Time) -> Result<(), RecordError> {
        match key {
            Key::ViewMap => match LoadedMap::from_view(view).ok().and_then(|floor| floor.map) {
                Some(map) => self.scene.set_map(&mut self.file, map, at),
                None => Ok(()),
            },
            Key::ViewFleet => {
                let robots = || picture.robots().keys();
                let present: BTreeSet<RobotId> = robots().filter_map(|name| RobotId::new(name.clone()).ok()).collect();
                self.scene.retain_robots(&mut self.file, &present, at)?;
                self.scene.set_robots(&mut self.file, robots().filter_map(|robot| robot_at(picture, robot)), at)
            }
            Key::ViewWorld => {
                let there = picture.people().iter().filter(|(_, person)| !person.away);
                let places = there.filter_map(|(name, person)| Some((name.clone(), place(&person.place)?)));
                let people: BTreeMap<String, PlaceId> = places.collect();
                self.scene.set_people(&mut self.file, people, at)?;
                let doors = picture.doors().iter().map(|(name, state)| (name.clone(), state != "closed"));
                self.scene.set_doors(&mut self.file, doors.collect(), at)
            }
            _ => Ok(()),
        }
    }

    /// Time has passed, whatever was heard: what is as old as [`CHUNK`] reaches the file.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written to.
    pub fn flush_due(&mut self, now_ms: u64) -> Result<(), RecordError> {
        self.file.flush_if_older(Time::from_millis(now_ms), FLUSH_AFTER)
    }

    /// What it holds so far; the size is that of the file as it is.
    pub fn stats(&self) -> RecordingStats {
        let seconds = self.latest_ms.saturating_sub(self.began_ms) as f64 / 1000.0;
        let bytes = std::fs::metadata(self.file.path()).map_or(0, |file| file.len());
        RecordingStats { seconds, messages: self.file.messages(), bytes, ..self.recorded.clone() }
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`RecordError`] if it cannot be written to.
    pub fn finish(mut self) -> Result<RecordingStats, RecordError> {
        self.file.finish()?;
        Ok(self.stats())
    }
}

/// Whether two answers are the same but for their age.
fn is_same(before: &Value, now: &Value) -> bool {
    let (Some(before), Some(now)) = (before.as_object(), now.as_object()) else { return false };
    let field = |(name, value): (&String, &Value)| {
        before.get(name).is_some_and(|before| match name.as_str() {
            "age_ms" | "at_ms" => before.is_u64() && value.is_u64(),
            _ => before == value,
        })
    };
    before.len() == now.len() && now.iter().all(field)
}

/// Where a robot is, as far as anybody has said.
fn robot_at(picture: &FleetModel, robot: &str) -> Option<RobotPose> {
    let shown = picture.robots().get(robot).filter(|shown| !shown.place.is_empty())?;
    let (place, pose) = (place(&shown.place), Pose::new(shown.x, shown.y, shown.yaw));
    Some(RobotPose { robot: RobotId::new(robot).ok()?, place, pose })
}

fn place(name: &str) -> Option<PlaceId> {
    PlaceId::new(name).ok()
}
