//! A recording that can be looked at: what the picture was at any time of it.

use super::parser::{RecordedInput, RecordingContents, RecordingError, read};
use super::schemas::{MessageKind, RepeatedViewMessage};
use crate::fleet_model::{FleetInput, FleetModel, FloorPlan};
use consort_protocol::count::count;
use consort_protocol::keys::Keys;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

/// Copies of the picture that are kept. With more of them jumps are shorter, and take more memory.
pub const KEYFRAMES_MAX: usize = 128;

/// From one copy to the next, to begin with, in milliseconds. It doubles whenever there are too many copies.
const APART_MS: u64 = 1000;

/// Marks of a recording at most; there would be no room for more.
const MARKS: usize = 2000;

/// What is marked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TimelineMarkKind {
    /// Another node coordinates.
    Coordinator,
    /// A mission was carried out.
    Completed,
    /// A mission ended otherwise.
    Ended,
}

/// Something to look for in a recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TimelineMark {
    /// When it was heard of.
    pub at_ms: u64,
    /// What kind of thing it is.
    pub kind: TimelineMarkKind,
    /// What it is, in words.
    pub text: String,
}

/// A recording.
pub struct RecordingReader {
    keys: Keys,
    fleet: String,
    topics: BTreeMap<u16, String>,
    inputs: Vec<RecordedInput>,
    /// The picture after so many inputs, from none on.
    keyframes: Vec<(usize, FleetModel)>,
    marks: Vec<TimelineMark>,
    from_ms: u64,
    to_ms: u64,
    problem: Option<String>,
    senseless: usize,
}

impl RecordingReader {
    /// Opens a recording, and plays it once.
    ///
    /// # Errors
    /// [`ReadError`] if nothing of it can be shown.
    pub fn open(path: &Path) -> Result<RecordingReader, RecordingError> {
        let RecordingContents { fleet, node, began_ms, topics, inputs, until_ms, damage: problem } = read(path)?;
        let picture = FleetModel::new(fleet.to_string(), node, FloorPlan::default(), began_ms);
        let mut reel = RecordingReader {
            keys: Keys::new(&fleet),
            fleet: fleet.to_string(),
            topics,
            inputs,
            keyframes: vec![(0, picture.clone())],
            marks: vec![],
            from_ms: began_ms,
            to_ms: until_ms,
            problem,
            senseless: 0,
        };
        reel.play_once(picture);
        Ok(reel)
    }

    fn play_once(&mut self, mut picture: FleetModel) {
        let (mut marker, mut apart_ms, mut copied_ms) = (Marker::default(), APART_MS, self.from_ms);
        let mut views = BTreeMap::new();
        for index in 0..self.inputs.len() {
            let at_ms = self.inputs[index].at_ms;
            self.resolve(&mut views, index);
            if at_ms >= copied_ms.saturating_add(apart_ms) {
                copied_ms = at_ms;
                self.keyframes.push((index, picture.clone()));
                if self.keyframes.len() > KEYFRAMES_MAX {
                    apart_ms *= 2;
                    let mut nth = 0..;
                    self.keyframes.retain(|_| nth.next().is_some_and(|nth| nth % 2 == 0));
                }
            }
            if self.take(&mut picture, index) {
                marker.look(&picture, at_ms);
            } else {
                self.senseless += 1;
            }
        }
        self.marks = marker.marks;
    }

    /// What says only that it is as before becomes what was before. `views` has the latest of each key, by its place.
    fn resolve(&mut self, views: &mut BTreeMap<String, usize>, index: usize) {
        let data = &self.inputs[index].data;
        match self.inputs[index].kind {
            MessageKind::View => {
                if let Ok(KeySaid { key }) = serde_json::from_slice(data) {
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

    /// Has a picture take an input in; whether it made sense.
    fn take(&self, picture: &mut FleetModel, index: usize) -> bool {
        let input = &self.inputs[index];
        let topic = self.topics.get(&input.topic).map_or("", String::as_str);
        let mut heard = input.kind.parse(&self.keys, topic, &input.data);
        if let (Some(FleetInput::View { view: Value::Object(view), .. }), Some(age_ms)) = (&mut heard, input.age_ms) {
            view.insert("age_ms".to_owned(), age_ms.into());
        }
        if let Some(heard) = &heard {
            picture.apply(heard, input.at_ms);
        }
        heard.is_some()
    }

    /// Brings a picture that has taken in the first `taken` inputs to what it was at an instant: with all that was heard until
    /// then, and nothing of later. How many inputs it has taken in now.
    pub fn seek(&self, picture: &mut FleetModel, taken: usize, to_ms: u64) -> usize {
        let until = self.inputs.partition_point(|input| input.at_ms <= to_ms);
        // The first one has taken in nothing: there is always one.
        let before = self.keyframes.partition_point(|(inputs, _)| *inputs <= until).saturating_sub(1);
        let (inputs, keyframe) = &self.keyframes[before];
        let mut from = taken;
        if taken > until || taken < *inputs {
            picture.clone_from(keyframe);
            picture.mark_all_changed();
            from = *inputs;
        }
        for index in from..until {
            self.take(picture, index);
        }
        until
    }

    /// The picture at an instant.
    pub fn model_at(&self, at_ms: u64) -> FleetModel {
        let mut picture = self.initial_model();
        self.seek(&mut picture, 0, at_ms);
        picture
    }

    /// The picture of nothing yet.
    pub fn initial_model(&self) -> FleetModel {
        self.keyframes[0].1.clone()
    }

    /// The fleet.
    pub fn fleet(&self) -> &str {
        &self.fleet
    }

    /// When it began, in milliseconds since 1970.
    pub fn from_ms(&self) -> u64 {
        self.from_ms
    }

    /// When the last of it was heard.
    pub fn to_ms(&self) -> u64 {
        self.to_ms
    }

    /// What is marked, in the order of time.
    pub fn marks(&self) -> &[TimelineMark] {
        &self.marks
    }

    /// How many messages it is made of.
    pub fn inputs(&self) -> usize {
        self.inputs.len()
    }

    /// What is wrong with the file, if it could not be read to its end or holds what makes no sense.
    pub fn damage(&self) -> Option<String> {
        let (one, many) = ("message makes no sense, and is left out", "messages make no sense, and are left out");
        let senseless = (self.senseless > 0).then(|| count(self.senseless, one, many));
        let problems: Vec<String> = self.problem.iter().cloned().chain(senseless).collect();
        (!problems.is_empty()).then(|| problems.join("; "))
    }
}

/// Of a view, which it is.
#[derive(Deserialize)]
struct KeySaid {
    key: String,
}

/// Finds what is to be marked.
#[derive(Default)]
struct Marker {
    marks: Vec<TimelineMark>,
    coordinator: Option<(String, u64)>,
    ended: BTreeSet<String>,
}

impl Marker {
    fn look(&mut self, picture: &FleetModel, at_ms: u64) {
        if let Some(now) = picture.coordinator() {
            let is = (now.node.clone(), now.term);
            if self.coordinator.as_ref() != Some(&is) {
                // Whoever is heard first was there before.
                if self.coordinator.is_some() {
                    let text = format!("{} coordinates, term {}", now.node, now.term);
                    self.mark(at_ms, TimelineMarkKind::Coordinator, text);
                }
                self.coordinator = Some(is);
            }
        }
        let ended = picture.missions().iter().filter(|(_, mission)| mission.ended);
        let news = ended.filter(|(id, _)| !self.ended.contains(*id));
        let news: Vec<_> = news.map(|(id, mission)| (id.clone(), mission.state.clone(), mission.ended_ms)).collect();
        for (id, state, ended_ms) in news {
            // When others ended, nobody saw.
            if ended_ms.is_some() {
                let kind = if state == "completed" { TimelineMarkKind::Completed } else { TimelineMarkKind::Ended };
                self.mark(at_ms, kind, format!("{id} {}", state.replace('_', " ")));
            }
            self.ended.insert(id);
        }
    }

    fn mark(&mut self, at_ms: u64, kind: TimelineMarkKind, text: String) {
        if self.marks.len() < MARKS {
            self.marks.push(TimelineMark { at_ms, kind, text });
        }
    }
}
