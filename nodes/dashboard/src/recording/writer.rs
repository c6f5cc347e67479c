//! Writes a recording.

use super::gaps::{EventGap, GapDetector};
use super::schemas::{
    self, BEACON, EVENT, FLEET_METADATA, FORMAT_VERSION, GAP, LINKS, LinksMessage, REPEATED_VIEW, RepeatedViewMessage,
    TELEMETRY, TelemetryMessage, VIEW, ViewMessage,
};
use crate::fleet_model::{FleetInput, FleetModel};
use crate::loaded_map::LoadedMap;
use consort_protocol::event::Event;
use consort_protocol::ids::{FleetId, PlaceId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::pose::Pose;
use consort_text::count;
use consort_world::record::RecordError;
use consort_world::record::foxglove::{ExistingFile, FleetScene, LogMessage, McapFile, MessageStamp, RobotPose, Time};
use serde::Serialize;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

/// Received inputs reach the file after this time at the latest: the loss if the recorder is
/// killed.
pub const FLUSH_AFTER: Duration = Duration::from_secs(1);

/// Statistics of a recording.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RecordingStats {
    /// Length in seconds.
    pub seconds: f64,
    /// Received events.
    pub events: u64,
    /// Telemetry reports.
    pub reports: u64,
    /// Views.
    pub views: u64,
    /// Gaps in the events of nodes.
    pub gaps: u64,
    /// Missed events.
    pub lost: u64,
    /// Messages in total.
    pub messages: u64,
    /// Size of the file.
    pub bytes: u64,
}

/// A recording that is being written.
pub struct RecordingWriter {
    file: McapFile,
    keys: Keys,
    scene: FleetScene,
    gaps: GapDetector,
    /// Last written content of each view.
    views: BTreeMap<Key, Value>,
    began_ms: u64,
    latest_ms: u64,
    recorded: RecordingStats,
}

impl RecordingWriter {
    /// Begins a recording of a fleet, observed at `node`.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written, or exists and is to be kept.
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

    /// Writes an input. The model has applied it already.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written.
    pub fn write_input(&mut self, input: &FleetInput, model: &FleetModel, now_ms: u64) -> Result<(), RecordError> {
        self.latest_ms = self.latest_ms.max(now_ms);
        let at = Time::from_millis(now_ms);
        match input {
            FleetInput::Event(event) => self.event(event, model, at),
            FleetInput::Beacon(beacon) => self.file.write("/coordinator", &BEACON, MessageStamp::at(at), beacon),
            FleetInput::Links(links) => {
                self.file.write("/links", &LINKS, MessageStamp::at(at), &LinksMessage { links: *links })
            }
            FleetInput::Telemetry { robot, telemetry, feedback } => {
                self.recorded.reports += 1;
                let message = TelemetryMessage { telemetry: telemetry.clone(), feedback: feedback.clone() };
                self.file.write(&schemas::telemetry_topic(robot), &TELEMETRY, MessageStamp::at(at), &message)?;
                self.scene.set_robots(&mut self.file, robot_at(model, robot), at)
            }
            FleetInput::View { key, view } => {
                self.recorded.views += 1;
                self.view(key, view, model, now_ms)?;
                self.draw(key, view, model, at)
            }
        }
    }

    fn event(&mut self, event: &Event, model: &FleetModel, at: Time) -> Result<(), RecordError> {
        if let Some(gap) = self.gaps.observe(event) {
            self.gap(&gap, at)?;
        }
        self.recorded.events += 1;
        let said = Time::from_millis(event.at_ms);
        // MCAP has 32 bits for the number; the message itself has all.
        let stamp = MessageStamp { log_time: at, publish_time: said, sequence: Some(event.sequence as u32) };
        self.file.write("/events", &EVENT, stamp, event)?;
        let Some((_, logged)) = model.log().last_key_value() else { return Ok(()) };
        let message = format!("{}: {}", logged.label, logged.text);
        let said = LogMessage { name: event.node.to_string(), message, is_warning: logged.alarm };
        self.scene.log(&mut self.file, said, MessageStamp { sequence: None, ..stamp })
    }

    /// Writes a view; most views repeat the content of a second ago.
    fn view(&mut self, key: &Key, view: &Value, model: &FleetModel, now_ms: u64) -> Result<(), RecordError> {
        let age_ms = view.get("age_ms").and_then(Value::as_u64);
        let said = Time::from_millis(now_ms.saturating_sub(age_ms.unwrap_or(0)));
        let (stamp, said) = (
            MessageStamp { log_time: Time::from_millis(now_ms), publish_time: said, sequence: None },
            self.keys.write(key),
        );
        if self.views.get(key).is_some_and(|before| is_equal_but_for_age(before, view)) {
            return self.file.write("/view/again", &REPEATED_VIEW, stamp, &RepeatedViewMessage { key: said, age_ms });
        }
        self.views.insert(key.clone(), view.clone());
        // Forgotten missions are not queried again.
        self.views.retain(|key, _| match key {
            Key::ViewMission(mission) => model.missions().contains_key(mission.as_str()),
            _ => true,
        });
        self.file.write(&schemas::view_topic(key), &VIEW, stamp, &ViewMessage { key: said, view })
    }

    fn gap(&mut self, gap: &EventGap, at: Time) -> Result<(), RecordError> {
        self.recorded.gaps += 1;
        self.recorded.lost += gap.lost;
        self.file.write("/gaps", &GAP, MessageStamp::at(at), gap)?;
        let lost = count(gap.lost, "event", "events");
        let message = format!("{lost} missed, after number {}", gap.after);
        let said = LogMessage { name: gap.node.to_string(), message, is_warning: true };
        self.scene.log(&mut self.file, said, MessageStamp::at(at))
    }

    /// Updates the 3D scene from a view.
    fn draw(&mut self, key: &Key, view: &Value, model: &FleetModel, at: Time) -> Result<(), RecordError> {
        match key {
            Key::ViewMap => match LoadedMap::from_view(view).ok().and_then(|floor| floor.map) {
                Some(map) => self.scene.set_map(&mut self.file, map, at),
                None => Ok(()),
            },
            Key::ViewFleet => {
                let robots = || model.robots().keys();
                let present: BTreeSet<RobotId> = robots().filter_map(|name| RobotId::new(name.clone()).ok()).collect();
                self.scene.retain_robots(&mut self.file, &present, at)?;
                self.scene.set_robots(&mut self.file, robots().filter_map(|robot| robot_at(model, robot)), at)
            }
            Key::ViewWorld => {
                let there = model.people().iter().filter(|(_, person)| !person.away);
                let places = there.filter_map(|(name, person)| Some((name.clone(), place(&person.place)?)));
                let people: BTreeMap<String, PlaceId> = places.collect();
                self.scene.set_people(&mut self.file, people, at)?;
                let doors = model.doors().iter().map(|(name, state)| (name.clone(), state != "closed"));
                self.scene.set_doors(&mut self.file, doors.collect(), at)
            }
            _ => Ok(()),
        }
    }

    /// Flushes data that is older than [`FLUSH_AFTER`].
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written.
    pub fn flush_due(&mut self, now_ms: u64) -> Result<(), RecordError> {
        self.file.flush_if_older(Time::from_millis(now_ms), FLUSH_AFTER)
    }

    /// Returns the current statistics, with the current size of the file.
    pub(crate) fn stats(&self) -> RecordingStats {
        let seconds = self.latest_ms.saturating_sub(self.began_ms) as f64 / 1000.0;
        let bytes = std::fs::metadata(self.file.path()).map_or(0, |file| file.len());
        RecordingStats { seconds, messages: self.file.messages(), bytes, ..self.recorded.clone() }
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written.
    pub fn finish(mut self) -> Result<RecordingStats, RecordError> {
        self.file.finish()?;
        Ok(self.stats())
    }
}

/// Checks whether two views are equal except for their age.
fn is_equal_but_for_age(before: &Value, now: &Value) -> bool {
    let (Some(before), Some(now)) = (before.as_object(), now.as_object()) else { return false };
    let field = |(name, value): (&String, &Value)| {
        before.get(name).is_some_and(|before| match name.as_str() {
            "age_ms" | "at_ms" => before.is_u64() && value.is_u64(),
            // The age and the revision of the copy that was read.
            "ledger" => true,
            _ => before == value,
        })
    };
    before.len() == now.len() && now.iter().all(field)
}

/// Returns the last known position of a robot.
fn robot_at(model: &FleetModel, robot: &str) -> Option<RobotPose> {
    let shown = model.robots().get(robot).filter(|shown| !shown.place.is_empty())?;
    let (place, pose) = (place(&shown.place), Pose::new(shown.x, shown.y, shown.yaw));
    Some(RobotPose { robot: RobotId::new(robot).ok()?, place, pose })
}

fn place(name: &str) -> Option<PlaceId> {
    PlaceId::new(name).ok()
}
