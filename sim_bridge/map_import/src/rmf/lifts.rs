//! The lifts of a building, and their stops.

use super::coordinates::{CoordinateSystem, LevelTransform, Point};
use super::diagnostic::{EntryError, RmfDiagnostic};
use super::level::{Level, level_named};
use super::raw::{self, Building};
use crate::drawing::Drawing;
use consort_world::map::LiftEntry;
use consort_world::suggest::did_you_mean;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// Margin around the cabin in which a place is still a stop, in metres: the gap between cabin and
/// shaft.
const GAP_M: f64 = 0.05;

/// Adds the lifts of a building to the drawing.
pub(super) fn read(
    building: &Building,
    system: CoordinateSystem,
    levels: &[Level],
    drawing: &mut Drawing,
    diagnostics: &mut Vec<RmfDiagnostic>,
) {
    let lifts = building.lifts.as_ref().map_or(&[][..], |lifts| &lifts.0);
    let names: BTreeSet<&str> = lifts.iter().map(|(name, _)| name.as_str()).collect();
    let mut named_stops: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for level in levels {
        for (vertex, place) in &level.places {
            let named = level.vertices[*vertex].parameters.get("lift_cabin").and_then(Value::as_str);
            let Some(named) = named.filter(|named| !named.is_empty()) else { continue };
            if names.contains(named) {
                named_stops.entry(named).or_default().insert(place);
            } else {
                let hint = did_you_mean(named, names.iter().copied());
                let at = format!("level {:?}, vertex {vertex}", level.name);
                let error = EntryError::UnknownLift { lift: named.to_owned(), hint };
                diagnostics.push(RmfDiagnostic { at, error });
            }
        }
    }
    for (name, lift) in lifts {
        let cabin = match Cabin::of(lift, system, levels, &building.reference_level_name) {
            Ok(cabin) => cabin,
            Err(error) => {
                diagnostics.push(RmfDiagnostic { at: format!("lift {name:?}"), error });
                continue;
            }
        };
        let named_stops = named_stops.get(name.as_str());
        let stops: Vec<String> = levels
            .iter()
            .flat_map(|level| level.places.iter().map(move |(vertex, place)| (level, *vertex, place)))
            .filter(|(level, vertex, place)| {
                named_stops.is_some_and(|named_stops| named_stops.contains(place.as_str()))
                    || cabin.holds(level, *vertex, system)
            })
            .map(|(_, _, place)| place.clone())
            .collect();
        if stops.is_empty() {
            drawing
                .notes
                .push(format!("lift {name:?} is ignored: no lane ends in its cabin on a level with its doors"));
        } else {
            drawing.map.lifts.push(LiftEntry { name: name.clone(), stops, ..LiftEntry::default() });
        }
    }
}

/// The floor of a lift, and the levels with its doors.
struct Cabin {
    centre: Point,
    /// Half of its width and depth.
    half: (f64, f64),
    yaw: f64,
    levels: BTreeSet<String>,
}

impl Cabin {
    fn of(
        lift: &raw::Lift,
        system: CoordinateSystem,
        levels: &[Level],
        reference: &Option<String>,
    ) -> Result<Cabin, EntryError> {
        for (field, value) in [("width", lift.width), ("depth", lift.depth)] {
            if !(value > 0.0 && value.is_finite()) {
                let (field, text) = (field.to_owned(), value.to_string());
                return Err(EntryError::InvalidValue { field, text, allowed: "a number of metres above 0" });
            }
        }
        let floor = |field: &'static str, name: &Option<String>| {
            let named = name.as_deref().filter(|name| !name.is_empty());
            named.map(|name| level_named(levels, field, name)).transpose()
        };
        let own = floor("reference_floor_name", &lift.reference_floor_name)?;
        let shared = floor("reference_level_name", reference)?;
        let lowest =
            floor("lowest_floor", &lift.lowest_floor)?.map_or(f64::NEG_INFINITY, |level| levels[level].elevation);
        let highest =
            floor("highest_floor", &lift.highest_floor)?.map_or(f64::INFINITY, |level| levels[level].elevation);
        let mut served = BTreeSet::new();
        for (name, doors) in lift.level_doors.as_ref().map_or(&[][..], |levels| &levels.0) {
            let level = level_named(levels, "level_doors", name)?;
            let has_doors = doors.as_array().is_none_or(|doors| !doors.is_empty());
            if has_doors && (lowest..=highest).contains(&levels[level].elevation) {
                served.insert(name.clone());
            }
        }
        let frame = own.or(shared).and_then(|level| levels[level].frame);
        let frame = frame.or_else(|| levels.iter().find_map(|level| level.frame)).unwrap_or(LevelTransform::METRES);
        let centre = frame.apply(system.to_y_up((lift.x, lift.y)));
        Ok(Cabin { centre, half: (lift.width / 2.0 + GAP_M, lift.depth / 2.0 + GAP_M), yaw: lift.yaw, levels: served })
    }

    fn holds(&self, level: &Level, vertex: usize, system: CoordinateSystem) -> bool {
        let Some(frame) = level.frame.filter(|_| self.levels.contains(level.name)) else { return false };
        let (x, y) = frame.apply(system.to_y_up(level.vertices[vertex].at));
        let (dx, dy) = (x - self.centre.0, y - self.centre.1);
        let (sin, cos) = self.yaw.sin_cos();
        (dx * cos + dy * sin).abs() <= self.half.0 && (dy * cos - dx * sin).abs() <= self.half.1
    }
}
