//! A recording with random access: the model at any time.

use super::parser::{RecordedInput, RecordingContents, RecordingError, read};
use super::schemas::{MessageKind, RepeatedViewMessage};
use crate::fleet_model::{FleetInput, FleetModel, FloorPlan};
use consort_protocol::keys::Keys;
use consort_text::count;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

/// Maximum number of copies of the model. More copies make seeks faster and use more memory.
pub const KEYFRAMES_MAX: usize = 128;

/// Initial time between copies, in milliseconds. It doubles whenever there are too many copies.
const KEYFRAME_INTERVAL_MS: u64 = 1000;

/// Maximum number of marks; the page has no space for more.
const MARKS_MAX: usize = 2000;

/// Kind of a mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TimelineMarkKind {
    /// The coordinator changed.
    Coordinator,
    /// A mission was completed.
    Completed,
    /// A mission ended otherwise.
    Ended,
}

/// A mark on the timeline of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TimelineMark {
    /// Time of receipt.
    pub at_ms: u64,
    /// Kind.
    pub kind: TimelineMarkKind,
    /// Description.
    pub text: String,
}

/// A recording.
pub struct RecordingReader {
    keys: Keys,
    fleet: String,
    topics: BTreeMap<u16, String>,
    inputs: Vec<RecordedInput>,
    /// Copies of the model with the number of applied inputs, starting with none.
    keyframes: Vec<(usize, FleetModel)>,
    marks: Vec<TimelineMark>,
    from_ms: u64,
    to_ms: u64,
    damage: Option<String>,
    invalid: usize,
}

impl RecordingReader {
    /// Opens a recording, and plays it once.
    ///
    /// # Errors
    /// [`RecordingError`] if nothing can be shown.
    pub fn open(path: &Path) -> Result<RecordingReader, RecordingError> {
        let RecordingContents { fleet, node, began_ms, topics, inputs, until_ms, damage } = read(path)?;
        let model = FleetModel::new(fleet.to_string(), node, FloorPlan::default(), began_ms);
        let mut reader = RecordingReader {
            keys: Keys::new(&fleet),
            fleet: fleet.to_string(),
            topics,
            inputs,
            keyframes: vec![(0, model.clone())],
            marks: vec![],
            from_ms: began_ms,
            to_ms: until_ms,
            damage,
            invalid: 0,
        };
        reader.play_once(model);
        Ok(reader)
    }

    fn play_once(&mut self, mut model: FleetModel) {
        let (mut marker, mut interval_ms, mut copied_ms) = (Marker::default(), KEYFRAME_INTERVAL_MS, self.from_ms);
        let mut views = BTreeMap::new();
        for index in 0..self.inputs.len() {
            let at_ms = self.inputs[index].at_ms;
            self.resolve(&mut views, index);
            if at_ms >= copied_ms.saturating_add(interval_ms) {
                copied_ms = at_ms;
                self.keyframes.push((index, model.clone()));
                if self.keyframes.len() > KEYFRAMES_MAX {
                    interval_ms *= 2;
                    let mut nth = 0..;
                    self.keyframes.retain(|_| nth.next().is_some_and(|nth| nth % 2 == 0));
                }
            }
            if self.take(&mut model, index) {
                marker.look(&model, at_ms);
            } else {
                self.invalid += 1;
            }
        }
        self.marks = marker.marks;
    }

    /// Resolves a repeated view to its content. `views` has the index of the latest view of each
    /// key.
    fn resolve(&mut self, views: &mut BTreeMap<String, usize>, index: usize) {
        let data = &self.inputs[index].data;
        match self.inputs[index].kind {
            MessageKind::View => {
                if let Ok(ViewKey { key }) = serde_json::from_slice(data) {
                    views.insert(key, index);
                }
            }
            MessageKind::RepeatedView => {
                let Ok(RepeatedViewMessage { key, age_ms }) = serde_json::from_slice(data) else { return };
                let Some(before) = views.get(&key).map(|before| &self.inputs[*before]) else { return };
                let (topic, data, at_ms) = (before.topic, Arc::clone(&before.data), self.inputs[index].at_ms);
                self.inputs[index] = RecordedInput { at_ms, kind: MessageKind::View, topic, data, age_ms };
            }
            MessageKind::Event | MessageKind::Beacon | MessageKind::Telemetry | MessageKind::Links => {}
        }
    }

    /// Returns the inputs in the order of their times, without those that are invalid.
    pub fn valid_inputs(&self) -> impl Iterator<Item = FleetInput> {
        (0..self.inputs.len()).filter_map(|index| self.parse(index))
    }

    /// Parses an input; `None` if it is invalid.
    fn parse(&self, index: usize) -> Option<FleetInput> {
        let input = &self.inputs[index];
        let topic = self.topics.get(&input.topic).map_or("", String::as_str);
        let mut fleet_input = input.kind.parse(&self.keys, topic, &input.data);
        if let (Some(FleetInput::View { view: Value::Object(view), .. }), Some(age_ms)) =
            (&mut fleet_input, input.age_ms)
        {
            view.insert("age_ms".to_owned(), age_ms.into());
        }
        fleet_input
    }

    /// Applies an input to a model; returns false if the input is invalid.
    fn take(&self, model: &mut FleetModel, index: usize) -> bool {
        let input = self.parse(index);
        if let Some(input) = &input {
            model.apply(input, self.inputs[index].at_ms);
        }
        input.is_some()
    }

    /// Brings a model that has applied the first `taken` inputs to its state at an instant: with
    /// all inputs until then, and none later. Returns the number of applied inputs.
    pub fn seek(&self, model: &mut FleetModel, applied: usize, to_ms: u64) -> usize {
        let until = self.inputs.partition_point(|input| input.at_ms <= to_ms);
        // The first keyframe has no inputs, so there is always a match.
        let before = self.keyframes.partition_point(|(inputs, _)| *inputs <= until).saturating_sub(1);
        let (inputs, keyframe) = &self.keyframes[before];
        let mut from = applied;
        if applied > until || applied < *inputs {
            model.clone_from(keyframe);
            model.mark_all_changed();
            from = *inputs;
        }
        for index in from..until {
            self.take(model, index);
        }
        until
    }

    /// Returns the model at an instant.
    pub fn model_at(&self, at_ms: u64) -> FleetModel {
        let mut model = self.initial_model();
        self.seek(&mut model, 0, at_ms);
        model
    }

    /// Returns the empty model.
    pub fn initial_model(&self) -> FleetModel {
        self.keyframes[0].1.clone()
    }

    /// Returns the fleet.
    pub fn fleet(&self) -> &str {
        &self.fleet
    }

    /// Returns the start, in milliseconds since 1970.
    pub fn from_ms(&self) -> u64 {
        self.from_ms
    }

    /// Returns the time of the last message.
    pub fn to_ms(&self) -> u64 {
        self.to_ms
    }

    /// Returns the marks, in the order of time.
    pub fn marks(&self) -> &[TimelineMark] {
        &self.marks
    }

    /// Returns the number of messages.
    pub fn inputs(&self) -> usize {
        self.inputs.len()
    }

    /// Describes the damage, if the file could not be read to its end or has invalid messages.
    pub fn damage(&self) -> Option<String> {
        let (one, many) = ("invalid message was skipped", "invalid messages were skipped");
        let invalid = (self.invalid > 0).then(|| count(self.invalid, one, many));
        let problems: Vec<String> = self.damage.iter().cloned().chain(invalid).collect();
        (!problems.is_empty()).then(|| problems.join("; "))
    }
}

/// The key of a view.
#[derive(Deserialize)]
struct ViewKey {
    key: String,
}

/// Finds the marks.
#[derive(Default)]
struct Marker {
    marks: Vec<TimelineMark>,
    coordinator: Option<(String, u64)>,
    ended: BTreeSet<String>,
}

impl Marker {
    fn look(&mut self, model: &FleetModel, at_ms: u64) {
        if let Some(now) = model.coordinator() {
            let is = (now.node.clone(), now.term);
            if self.coordinator.as_ref() != Some(&is) {
                // The first coordinator is not a change.
                if self.coordinator.is_some() {
                    let text = format!("coordinator {}, term {}", now.node, now.term);
                    self.mark(at_ms, TimelineMarkKind::Coordinator, text);
                }
                self.coordinator = Some(is);
            }
        }
        let ended = model.missions().iter().filter(|(_, mission)| mission.ended);
        let newly_ended = ended.filter(|(id, _)| !self.ended.contains(*id));
        let newly_ended: Vec<_> =
            newly_ended.map(|(id, mission)| (id.clone(), mission.state.clone(), mission.ended_ms)).collect();
        for (id, state, ended_ms) in newly_ended {
            // The end of other missions was not observed.
            if ended_ms.is_some() {
                let kind = if state == "completed" { TimelineMarkKind::Completed } else { TimelineMarkKind::Ended };
                self.mark(at_ms, kind, format!("{id} {}", state.replace('_', " ")));
            }
            self.ended.insert(id);
        }
    }

    fn mark(&mut self, at_ms: u64, kind: TimelineMarkKind, text: String) {
        if self.marks.len() < MARKS_MAX {
            self.marks.push(TimelineMark { at_ms, kind, text });
        }
    }
}
