//! Checks levels, doors and lifts.

use crate::map::building::intersection;
use crate::map::diagnostic::{BuildingDiagnostic, LaneName, MapDiagnostic};
use crate::map::file::{DoorEntry, LevelEntry, LiftEntry, MapFile, limits};
use crate::map::model::{DEFAULT_LEVEL, Door, LevelIndex, Lift, Map, MapLevel, PlaceIndex};
use crate::suggest::did_you_mean;
use consort_protocol::ids::PlaceId;
use consort_protocol::units::{MetresPerSecond, Seconds};
use std::collections::BTreeSet;

type Diagnostics = Vec<MapDiagnostic>;

fn report(diagnostics: &mut Diagnostics, error: BuildingDiagnostic) {
    diagnostics.push(error.into());
}

fn check_name(what: &'static str, name: &str, names_seen: &mut BTreeSet<String>, diagnostics: &mut Diagnostics) {
    // The rules for names of places apply to levels, doors and lifts, too.
    if PlaceId::new(name).is_err() {
        report(diagnostics, BuildingDiagnostic::Name { what, text: name.to_owned() });
    } else if !names_seen.insert(name.to_owned()) {
        report(diagnostics, BuildingDiagnostic::Duplicate { what, name: name.to_owned() });
    }
}

struct Bounds {
    min: f64,
    max: f64,
}

const EXTENT: Bounds = Bounds { min: -limits::EXTENT_M, max: limits::EXTENT_M };
const OPENING: Bounds = Bounds { min: 0.0, max: 3600.0 };
const SPEED: Bounds = Bounds { min: 0.01, max: 100.0 };

fn check_number(
    (what, name): (&'static str, &str),
    field: &'static str,
    value: f64,
    Bounds { min, max }: Bounds,
    diagnostics: &mut Diagnostics,
) {
    if !(min..=max).contains(&value) {
        report(diagnostics, BuildingDiagnostic::Number { what, name: name.to_owned(), field, value, min, max });
    }
}

/// Adds the levels to the map, and the walls with their levels.
pub(super) fn check_levels(file: &MapFile, map: &mut Map, diagnostics: &mut Diagnostics) {
    let ground = [LevelEntry { name: DEFAULT_LEVEL.to_owned(), ..LevelEntry::default() }];
    let entries = if file.levels.is_empty() { &ground[..] } else { &file.levels };
    let mut names_seen = BTreeSet::new();
    for (index, entry) in entries.iter().enumerate() {
        check_name("level", &entry.name, &mut names_seen, diagnostics);
        check_number(("level", &entry.name), "elevation_m", entry.elevation_m, EXTENT, diagnostics);
        map.levels.push(MapLevel { name: entry.name.clone(), elevation_m: entry.elevation_m });
        let first = if index == 0 { file.walls.as_slice() } else { &[] };
        map.walls.extend(first.iter().chain(&entry.walls).cloned());
        map.wall_levels.resize(map.walls.len(), LevelIndex(index));
    }
}

/// Returns the level of a place or a door.
pub(super) fn check_level_of(
    what: &'static str,
    name: &str,
    level: Option<&str>,
    map: &Map,
    diagnostics: &mut Diagnostics,
) -> LevelIndex {
    let Some(level) = level else { return LevelIndex::default() };
    map.level_named(level).unwrap_or_else(|| {
        let hint = did_you_mean(level, map.levels.iter().map(|level| level.name.as_str()));
        report(
            diagnostics,
            BuildingDiagnostic::UnknownLevel { what, name: name.to_owned(), level: level.to_owned(), hint },
        );
        LevelIndex::default()
    })
}

/// Adds doors and lifts to the map. All lanes must have been added before.
pub(super) fn check_doors_and_lifts(file: &MapFile, map: &mut Map, diagnostics: &mut Diagnostics) {
    let mut names_seen = BTreeSet::new();
    for entry in &file.doors {
        check_name("door", &entry.name, &mut names_seen, diagnostics);
        add_door(entry, map, file, diagnostics);
    }
    let mut names_seen = BTreeSet::new();
    for entry in &file.lifts {
        check_name("lift", &entry.name, &mut names_seen, diagnostics);
        add_lift(entry, map, file, diagnostics);
    }
}

fn add_door(entry: &DoorEntry, map: &mut Map, file: &MapFile, diagnostics: &mut Diagnostics) {
    let before = diagnostics.len();
    let subject = ("door", entry.name.as_str());
    check_number(subject, "opening_s", entry.opening_s, OPENING, diagnostics);
    if let Some(((ax, ay), (bx, by))) = entry.span {
        for corner in [ax, ay, bx, by] {
            check_number(subject, "a corner of span", corner, EXTENT, diagnostics);
        }
    }
    let is_drawn_only = entry.on.is_empty() && entry.span.is_some() && entry.level.is_some();
    if entry.on.is_empty() && !is_drawn_only {
        report(diagnostics, BuildingDiagnostic::DoorOnNoLane { door: entry.name.clone() });
    }
    let (mut lanes_through_door, mut lanes_seen) = (Vec::new(), BTreeSet::new());
    for ends in &entry.on {
        match lane_of(map, ends) {
            Some(lane) if lanes_seen.insert(lane) => lanes_through_door.push((lane, ends)),
            Some(_) => {}                        // repeated, or with the ends exchanged
            None if is_in_file(file, ends) => {} // the error of the lane is reported already
            None => {
                let (door, lane) = (entry.name.clone(), LaneName(ends.0.clone(), ends.1.clone()));
                let hint = lane_hint(map, ends);
                report(diagnostics, BuildingDiagnostic::UnknownLane { door, lane, hint });
            }
        }
    }
    let level = |lane: usize| map.level_of(&map.lanes[lane].from);
    if lanes_through_door.windows(2).any(|pair| level(pair[0].0) != level(pair[1].0)) {
        report(diagnostics, BuildingDiagnostic::DoorAcrossLevels { door: entry.name.clone() });
    }
    if diagnostics.len() > before {
        return;
    }
    let drawn_on = || check_level_of("door", &entry.name, entry.level.as_deref(), map, diagnostics);
    let level = lanes_through_door.first().and_then(|(lane, _)| level(*lane)).unwrap_or_else(drawn_on);
    let (index, mut lanes) = (map.doors.len(), Vec::new());
    for (lane, ends) in lanes_through_door {
        let (from, to) = (map.lanes[lane].from.clone(), map.lanes[lane].to.clone());
        let share = entry.span.map_or(Some(0.5), |(a, b)| {
            let [start, end] = [&from, &to].map(|id| map.place(id).map_or((0.0, 0.0), |p| (p.pose.x, p.pose.y)));
            intersection(start, end, a, b)
        });
        match share {
            Some(share) => map.doors_by_lane.entry(lane).or_default().push((index, share)),
            None => {
                let (door, lane) = (entry.name.clone(), LaneName(ends.0.clone(), ends.1.clone()));
                report(diagnostics, BuildingDiagnostic::DoorMissesLane { door, lane });
            }
        }
        lanes.push((from, to));
    }
    let opening = Seconds::new(entry.opening_s).expect("checked above");
    map.doors.push(Door { name: entry.name.clone(), lanes, opening, span: entry.span, level });
}

/// Checks whether the file contains this lane, valid or not.
fn is_in_file(file: &MapFile, ends: &(String, String)) -> bool {
    file.lanes.iter().any(|lane| lane.between == *ends || (&lane.between.1, &lane.between.0) == (&ends.0, &ends.1))
}

/// Returns the lane between two places, in either order of the ends.
fn lane_of(map: &Map, ends: &(String, String)) -> Option<usize> {
    let index = |text: &String| PlaceId::new(text.as_str()).ok().and_then(|id| map.index(&id));
    let (a, b) = (index(&ends.0)?, index(&ends.1)?);
    map.by_ends.get(&(a, b)).or_else(|| map.by_ends.get(&(b, a))).copied()
}

fn lane_hint(map: &Map, ends: &(String, String)) -> String {
    let known = || map.places.iter().map(|place| place.id.as_str());
    for end in [&ends.0, &ends.1] {
        if !known().any(|name| name == end) {
            return format!("; there is no place {end:?}{}", did_you_mean(end, known()));
        }
    }
    let others = map.lanes.iter().filter_map(|lane| match (lane.from.as_str(), lane.to.as_str()) {
        (from, to) if from == ends.0 => Some(to),
        (from, to) if to == ends.0 => Some(from),
        _ => None,
    });
    let others: BTreeSet<String> = others.map(|name| format!("{name:?}")).collect();
    let others: Vec<String> = others.into_iter().take(8).collect();
    format!("; lanes from {:?} lead to {}", ends.0, others.join(", "))
}

fn add_lift(entry: &LiftEntry, map: &mut Map, file: &MapFile, diagnostics: &mut Diagnostics) {
    let before = diagnostics.len();
    let subject = ("lift", entry.name.as_str());
    check_number(subject, "opening_s", entry.opening_s, OPENING, diagnostics);
    check_number(subject, "speed_mps", entry.speed_mps, SPEED, diagnostics);
    if entry.capacity == 0 {
        report(diagnostics, BuildingDiagnostic::ZeroCapacity { lift: entry.name.clone() });
    }
    let (index, mut stops): (usize, Vec<PlaceIndex>) = (map.lifts.len(), Vec::new());
    for text in &entry.stops {
        let Some(place) = PlaceId::new(text.as_str()).ok().and_then(|id| map.index(&id)) else {
            if file.places.iter().any(|place| place.name == *text) {
                return; // the error of the place is reported already
            }
            let hint = did_you_mean(text, map.places.iter().map(|place| place.id.as_str()));
            report(
                diagnostics,
                BuildingDiagnostic::UnknownStop { lift: entry.name.clone(), place: text.clone(), hint },
            );
            continue;
        };
        let other_lift = map.lift_of.get(&place).map(|lift| map.lifts[*lift].name.clone());
        let other_lift = other_lift.or_else(|| stops.contains(&place).then(|| entry.name.clone()));
        match other_lift {
            Some(other) => {
                let (lift, place) = (entry.name.clone(), text.clone());
                report(diagnostics, BuildingDiagnostic::StopOfAnotherLift { lift, place, other });
            }
            None => stops.push(place),
        }
    }
    let levels: BTreeSet<_> = stops.iter().map(|stop| map.place_at(*stop).level).collect();
    if levels.len() < 2 && diagnostics.len() == before {
        report(diagnostics, BuildingDiagnostic::SingleLevelLift { lift: entry.name.clone(), levels: levels.len() });
    }
    if diagnostics.len() > before {
        return;
    }
    map.lift_of.extend(stops.iter().map(|stop| (*stop, index)));
    map.lifts.push(Lift {
        name: entry.name.clone(),
        stops: stops.iter().map(|stop| map.place_at(*stop).id.clone()).collect(),
        capacity: entry.capacity,
        opening: Seconds::new(entry.opening_s).expect("checked above"),
        speed: MetresPerSecond::new(entry.speed_mps).expect("checked above"),
    });
}
