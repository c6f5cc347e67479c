//! What a setup says of doors, of what stands in the way, and of what lies about.

use super::names::SampleId;
use super::setup::SetupError;
use crate::map::Map;
use crate::suggest::did_you_mean;
use consort_protocol::ids::PlaceId;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Seconds that something may take or wait.
const SECONDS: std::ops::RangeInclusive<f64> = 0.0..=86_400.0;

/// How an automatic door of the map behaves, where it is not as usual.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DoorSetup {
    /// Its name on the map.
    pub name: String,
    /// How many robots may be in the doorway at once. By default 1: it is narrow.
    #[serde(default = "one")]
    pub capacity: usize,
    /// Seconds that it stays open behind the last one. By default 2, a guess.
    #[serde(default = "two_seconds")]
    pub open_for_s: f64,
}

fn one() -> usize {
    1
}

fn two_seconds() -> f64 {
    2.0
}

impl DoorSetup {
    /// A door as usual.
    pub fn named(name: String) -> DoorSetup {
        DoorSetup { name, capacity: one(), open_for_s: two_seconds() }
    }

    fn check(&self, map: &Map, problems: &mut Vec<SetupError>) {
        let who = format!("door {}", self.name);
        if map.door(&self.name).is_none() {
            let hint = did_you_mean(&self.name, map.doors().iter().map(|door| door.name.as_str()));
            problems.push(SetupError::UnknownDoor { name: self.name.clone(), map: map.name().to_owned(), hint });
        }
        if self.capacity == 0 {
            problems.push(SetupError::InvalidNumber {
                who: who.clone(),
                field: "capacity",
                value: 0.0,
                allowed: "1 or more",
            });
        }
        seconds(who, "open_for_s", self.open_for_s, problems);
    }
}

/// Something that stands in a lane for a while: no robot passes it, in either direction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Obstacle {
    /// What it is called.
    pub name: String,
    /// The lane it stands in, by its two ends.
    pub on: (PlaceId, PlaceId),
    /// Where: the share of the way from the first end to the second. By default in the middle.
    #[serde(default = "half")]
    pub at: f64,
    /// When it comes, in seconds of world time. By default it is there from the first.
    #[serde(default)]
    pub from_s: f64,
    /// When it goes. By default never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

fn half() -> f64 {
    0.5
}

impl Obstacle {
    /// Something in the middle of the lane between two places, that does not go away by itself.
    pub fn between(name: &str, a: PlaceId, b: PlaceId) -> Obstacle {
        Obstacle { name: name.to_owned(), on: (a, b), at: half(), from_s: 0.0, until_s: None }
    }

    /// Whether it stands in a lane of a map, and its numbers make sense.
    ///
    /// # Errors
    /// [`SetupError`] names the first thing that is wrong.
    pub fn check(&self, map: &Map) -> Result<(), SetupError> {
        let who = format!("obstacle {}", self.name);
        let (a, b) = &self.on;
        for place in [a, b] {
            if map.place(place).is_none() {
                let (map, hint) = (map.name().to_owned(), map.suggest(place));
                return Err(SetupError::UnknownPlace { who, place: place.clone(), map, hint });
            }
        }
        if map.lane(a, b).or_else(|| map.lane(b, a)).is_none() {
            return Err(SetupError::UnknownLane { who, a: a.clone(), b: b.clone(), map: map.name().to_owned() });
        }
        let number = |field, value, allowed| Err(SetupError::InvalidNumber { who: who.clone(), field, value, allowed });
        if !(0.0..=1.0).contains(&self.at) {
            return number("at", self.at, "a number from 0 to 1");
        }
        if !(0.0..=f64::MAX).contains(&self.from_s) {
            return number("from_s", self.from_s, "a number of seconds, 0 or more");
        }
        match self.until_s {
            Some(until) if !(self.from_s..=f64::MAX).contains(&until) => {
                number("until_s", until, "a number of seconds, no less than from_s")
            }
            _ => Ok(()),
        }
    }
}

/// A thing that arms take, carry and put down.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ObjectSetup {
    /// What it is called; no sample has the same name.
    pub name: SampleId,
    /// On the table of which place it lies.
    pub place: PlaceId,
    /// What it weighs, in kilograms. By default as much as a sample, 0.1.
    #[serde(default = "sample_kg")]
    pub weight_kg: f64,
    /// How far from where robots stand at that place it lies, in metres. By default right there. What an arm puts down lies
    /// within everybody's reach.
    #[serde(default)]
    pub distance_m: f64,
}

/// What a sample weighs, in kilograms: a tube in its bag.
pub(super) fn sample_kg() -> f64 {
    0.1
}

impl ObjectSetup {
    /// All that is wrong with its numbers.
    pub(super) fn check(&self, problems: &mut Vec<SetupError>) {
        let who = format!("object {}", self.name);
        for (field, value) in [("weight_kg", self.weight_kg), ("distance_m", self.distance_m)] {
            check_non_negative(&who, field, value, problems);
        }
    }
}

/// A number that may be anything from 0 to a thousand.
pub(super) fn check_non_negative(who: &str, field: &'static str, value: f64, problems: &mut Vec<SetupError>) {
    if !(0.0..=1_000.0).contains(&value) {
        let allowed = "a number from 0 to 1000";
        problems.push(SetupError::InvalidNumber { who: who.to_owned(), field, value, allowed });
    }
}

fn seconds(who: String, field: &'static str, value: f64, problems: &mut Vec<SetupError>) {
    if !SECONDS.contains(&value) {
        let allowed = "a number of seconds from 0 to 86400";
        problems.push(SetupError::InvalidNumber { who, field, value, allowed });
    }
}

/// All that is wrong with them.
pub(super) fn check(map: &Map, doors: &[DoorSetup], obstacles: &[Obstacle], problems: &mut Vec<SetupError>) {
    let mut seen = BTreeSet::new();
    let mut twice = |who: String, problems: &mut Vec<SetupError>| {
        if !seen.insert(who.clone()) {
            problems.push(SetupError::Duplicate { who });
        }
    };
    for door in doors {
        door.check(map, problems);
        twice(format!("door {}", door.name), problems);
    }
    for obstacle in obstacles {
        problems.extend(obstacle.check(map).err());
        twice(format!("obstacle {}", obstacle.name), problems);
    }
}
