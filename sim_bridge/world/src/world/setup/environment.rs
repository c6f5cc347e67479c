//! Setup of doors, obstacles and objects.

use super::error::SetupError;
use crate::map::Map;
use crate::suggest::did_you_mean;
use crate::world::names::SampleId;
use consort_protocol::ids::PlaceId;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Allowed durations, in seconds.
const SECONDS: std::ops::RangeInclusive<f64> = 0.0..=86_400.0;

/// Settings of an automatic door of the map, if they differ from the defaults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DoorSetup {
    /// Name of the door on the map.
    pub name: String,
    /// Number of robots allowed in the doorway at once. Default: 1, a narrow door.
    #[serde(default = "one")]
    pub capacity: usize,
    /// Seconds for which the door stays open behind the last robot. Default: 2, a guess.
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
    /// A door with default settings.
    pub fn named(name: String) -> DoorSetup {
        DoorSetup { name, capacity: one(), open_for_s: two_seconds() }
    }

    fn check(&self, map: &Map, errors: &mut Vec<SetupError>) {
        let subject = format!("door {}", self.name);
        if map.door(&self.name).is_none() {
            let hint = did_you_mean(&self.name, map.doors().iter().map(|door| door.name.as_str()));
            errors.push(SetupError::UnknownDoor { name: self.name.clone(), map: map.name().to_owned(), hint });
        }
        if self.capacity == 0 {
            errors.push(SetupError::InvalidNumber {
                subject: subject.clone(),
                field: "capacity",
                value: 0.0,
                allowed: "1 or more",
            });
        }
        seconds(subject, "open_for_s", self.open_for_s, errors);
    }
}

/// An obstacle in a lane for some time. No robot passes it, in either direction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Obstacle {
    /// Name of the obstacle.
    pub name: String,
    /// The blocked lane, by its two ends.
    pub on: (PlaceId, PlaceId),
    /// Position as a share of the lane from the first end to the second. Default: the middle.
    #[serde(default = "half")]
    pub at: f64,
    /// Time at which the obstacle appears, in seconds of world time. Default: from the start.
    #[serde(default)]
    pub from_s: f64,
    /// Time at which the obstacle disappears, in seconds of world time. Default: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

fn half() -> f64 {
    0.5
}

impl Obstacle {
    /// A permanent obstacle in the middle of the lane between two places.
    pub fn between(name: &str, a: PlaceId, b: PlaceId) -> Obstacle {
        Obstacle { name: name.to_owned(), on: (a, b), at: half(), from_s: 0.0, until_s: None }
    }

    /// Checks that the obstacle is on a lane of the map, and that its numbers are valid.
    ///
    /// # Errors
    /// [`SetupError`] for the first mistake.
    pub(crate) fn check(&self, map: &Map) -> Result<(), SetupError> {
        let subject = format!("obstacle {}", self.name);
        let (a, b) = &self.on;
        for place in [a, b] {
            if map.place(place).is_none() {
                let (map, hint) = (map.name().to_owned(), map.suggest(place));
                return Err(SetupError::UnknownPlace { subject, place: place.clone(), map, hint });
            }
        }
        if map.lane(a, b).or_else(|| map.lane(b, a)).is_none() {
            return Err(SetupError::UnknownLane { subject, a: a.clone(), b: b.clone(), map: map.name().to_owned() });
        }
        let number =
            |field, value, allowed| Err(SetupError::InvalidNumber { subject: subject.clone(), field, value, allowed });
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

/// An object that arms can grasp, carry and put down.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ObjectSetup {
    /// Name of the object; no sample has the same name.
    pub name: SampleId,
    /// Place with the table on which the object lies.
    pub place: PlaceId,
    /// Weight in kilograms. Default: 0.1, as much as a sample.
    #[serde(default = "sample_kg")]
    pub weight_kg: f64,
    /// Distance in metres from the position of robots at that place. Default: 0. An object that an
    /// arm has put down is within reach of every robot.
    #[serde(default)]
    pub distance_m: f64,
}

/// Weight of a sample in kilograms: a tube in its bag.
pub(in crate::world) fn sample_kg() -> f64 {
    0.1
}

impl ObjectSetup {
    /// Checks the numbers.
    pub(in crate::world) fn check(&self, errors: &mut Vec<SetupError>) {
        let subject = format!("object {}", self.name);
        for (field, value) in [("weight_kg", self.weight_kg), ("distance_m", self.distance_m)] {
            check_non_negative(&subject, field, value, errors);
        }
    }
}

/// Checks that a number is from 0 to 1000.
pub(in crate::world) fn check_non_negative(
    subject: &str,
    field: &'static str,
    value: f64,
    errors: &mut Vec<SetupError>,
) {
    if !(0.0..=1_000.0).contains(&value) {
        let allowed = "a number from 0 to 1000";
        errors.push(SetupError::InvalidNumber { subject: subject.to_owned(), field, value, allowed });
    }
}

fn seconds(subject: String, field: &'static str, value: f64, errors: &mut Vec<SetupError>) {
    if !SECONDS.contains(&value) {
        let allowed = "a number of seconds from 0 to 86400";
        errors.push(SetupError::InvalidNumber { subject, field, value, allowed });
    }
}

/// Checks doors and obstacles.
pub(in crate::world) fn check(map: &Map, doors: &[DoorSetup], obstacles: &[Obstacle], errors: &mut Vec<SetupError>) {
    let mut seen = BTreeSet::new();
    let mut check_unique = |subject: String, errors: &mut Vec<SetupError>| {
        if !seen.insert(subject.clone()) {
            errors.push(SetupError::Duplicate { subject });
        }
    };
    for door in doors {
        door.check(map, errors);
        check_unique(format!("door {}", door.name), errors);
    }
    for obstacle in obstacles {
        errors.extend(obstacle.check(map).err());
        check_unique(format!("obstacle {}", obstacle.name), errors);
    }
}
