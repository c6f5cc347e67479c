//! Whether levels, doors and lifts are as they should be.

use super::building::{DEFAULT_LEVEL, Door, LevelIndex, Lift, MapLevel, intersection};
use super::file::{DoorEntry, LevelEntry, LiftEntry, MapFile, limits};
use super::{LaneName, Map, MapDiagnostic, PlaceIndex};
use crate::suggest::did_you_mean;
use consort_protocol::ids::PlaceId;
use consort_protocol::units::{MetresPerSecond, Seconds};
use std::collections::BTreeSet;

/// One thing that is wrong with a level, a door or a lift.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BuildingDiagnostic {
    /// The name of a level, door or lift is not one.
    #[error(
        "{text:?} cannot name a {what}: allowed are 1 to 64 characters, none of them a control character, without space at either end"
    )]
    Name {
        /// `level`, `door` or `lift`.
        what: &'static str,
        /// The name as given.
        text: String,
    },
    /// Two of one name.
    #[error("{what} {name:?} stands more than once")]
    Duplicate {
        /// `level`, `door` or `lift`.
        what: &'static str,
        /// Its name.
        name: String,
    },
    /// A number that is infinite, not a number, or out of bounds.
    #[error("{what} {name:?}: {field} is {value}, allowed is a number from {min} to {max}")]
    Number {
        /// `level`, `door` or `lift`.
        what: &'static str,
        /// Its name.
        name: String,
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
        /// The least allowed.
        min: f64,
        /// The greatest allowed.
        max: f64,
    },
    /// A level that is not on the map.
    #[error("place {place:?}: there is no level {level:?}{hint}")]
    UnknownLevel {
        /// The place that names it.
        place: String,
        /// The name as written.
        level: String,
        /// The level probably meant, in words; may be empty.
        hint: String,
    },
    /// A lane that leaves its level.
    #[error("lane {lane}: its ends are on levels {from:?} and {to:?}; only a lift joins levels")]
    LaneAcrossLevels {
        /// The lane.
        lane: LaneName,
        /// The level of its first end.
        from: String,
        /// The level of the other.
        to: String,
    },
    /// A speed limit that is none.
    #[error("lane {lane}: speed limit is {value} m/s, allowed is a number above 0")]
    SpeedLimit {
        /// The lane.
        lane: LaneName,
        /// The number.
        value: f64,
    },
    /// A door that stands across nothing.
    #[error("door {door:?} is on no lane")]
    DoorOnNoLane {
        /// The door.
        door: String,
    },
    /// A door on a lane that is not on the map.
    #[error("door {door:?}: there is no lane {lane}{hint}")]
    UnknownLane {
        /// The door.
        door: String,
        /// The lane as written.
        lane: LaneName,
        /// What was probably meant, in words; may be empty.
        hint: String,
    },
    /// A door on lanes of several levels.
    #[error("door {door:?} is on lanes of several levels")]
    DoorAcrossLevels {
        /// The door.
        door: String,
    },
    /// A door beside a lane that is said to lead through it.
    #[error("door {door:?}: lane {lane} does not lead between its posts")]
    DoorMissesLane {
        /// The door.
        door: String,
        /// The lane.
        lane: LaneName,
    },
    /// A lift to a place that is not on the map.
    #[error("lift {lift:?}: there is no place {place:?}{hint}")]
    UnknownStop {
        /// The lift.
        lift: String,
        /// The name as written.
        place: String,
        /// The place probably meant, in words; may be empty.
        hint: String,
    },
    /// A place that is a stop of two lifts, or twice of one.
    #[error("lift {lift:?}: place {place:?} is a stop of lift {other:?} already")]
    StopOfAnotherLift {
        /// The lift.
        lift: String,
        /// The place.
        place: String,
        /// The lift that has it.
        other: String,
    },
    /// A lift without stops on two levels.
    #[error("lift {lift:?} has stops on {levels} level(s) only, needed are two or more")]
    SingleLevelLift {
        /// The lift.
        lift: String,
        /// On how many levels it stops.
        levels: usize,
    },
    /// A lift for nobody.
    #[error("lift {lift:?}: capacity is 0, allowed is a number of robots from 1")]
    ZeroCapacity {
        /// The lift.
        lift: String,
    },
}

type Problems = Vec<MapDiagnostic>;

fn say(problems: &mut Problems, problem: BuildingDiagnostic) {
    problems.push(problem.into());
}

fn named(what: &'static str, name: &str, seen: &mut BTreeSet<String>, problems: &mut Problems) {
    // Levels, doors and lifts are named as places are.
    if PlaceId::new(name).is_err() {
        say(problems, BuildingDiagnostic::Name { what, text: name.to_owned() });
    } else if !seen.insert(name.to_owned()) {
        say(problems, BuildingDiagnostic::Duplicate { what, name: name.to_owned() });
    }
}

struct Bounds {
    min: f64,
    max: f64,
}

const EXTENT: Bounds = Bounds { min: -limits::EXTENT_M, max: limits::EXTENT_M };
const OPENING: Bounds = Bounds { min: 0.0, max: 3600.0 };
const SPEED: Bounds = Bounds { min: 0.01, max: 100.0 };

fn number(
    (what, name): (&'static str, &str),
    field: &'static str,
    value: f64,
    Bounds { min, max }: Bounds,
    problems: &mut Problems,
) {
    if !(min..=max).contains(&value) {
        say(problems, BuildingDiagnostic::Number { what, name: name.to_owned(), field, value, min, max });
    }
}

/// The levels of a map, and the walls of each with its level.
pub(super) fn check_levels(written: &MapFile, map: &mut Map, problems: &mut Problems) {
    let ground = [LevelEntry { name: DEFAULT_LEVEL.to_owned(), ..LevelEntry::default() }];
    let entries = if written.levels.is_empty() { &ground[..] } else { &written.levels };
    let mut seen = BTreeSet::new();
    for (index, entry) in entries.iter().enumerate() {
        named("level", &entry.name, &mut seen, problems);
        number(("level", &entry.name), "elevation_m", entry.elevation_m, EXTENT, problems);
        map.levels.push(MapLevel { name: entry.name.clone(), elevation_m: entry.elevation_m });
        let first = if index == 0 { written.walls.as_slice() } else { &[] };
        map.walls.extend(first.iter().chain(&entry.walls).cloned());
        map.wall_levels.resize(map.walls.len(), LevelIndex(index));
    }
}

/// The level that a place says it is on.
pub(super) fn check_level_of(place: &str, level: Option<&str>, map: &Map, problems: &mut Problems) -> LevelIndex {
    let Some(level) = level else { return LevelIndex::default() };
    map.level_named(level).unwrap_or_else(|| {
        let hint = did_you_mean(level, map.levels.iter().map(|level| level.name.as_str()));
        say(problems, BuildingDiagnostic::UnknownLevel { place: place.to_owned(), level: level.to_owned(), hint });
        LevelIndex::default()
    })
}

/// Doors and lifts. All lanes have been taken before.
pub(super) fn check_doors_and_lifts(written: &MapFile, map: &mut Map, problems: &mut Problems) {
    let mut seen = BTreeSet::new();
    for entry in &written.doors {
        named("door", &entry.name, &mut seen, problems);
        door(entry, map, written, problems);
    }
    let mut seen = BTreeSet::new();
    for entry in &written.lifts {
        named("lift", &entry.name, &mut seen, problems);
        lift(entry, map, written, problems);
    }
}

fn door(entry: &DoorEntry, map: &mut Map, written: &MapFile, problems: &mut Problems) {
    let before = problems.len();
    let me = ("door", entry.name.as_str());
    number(me, "opening_s", entry.opening_s, OPENING, problems);
    if let Some(((ax, ay), (bx, by))) = entry.span {
        for corner in [ax, ay, bx, by] {
            number(me, "a corner of span", corner, EXTENT, problems);
        }
    }
    if entry.on.is_empty() {
        say(problems, BuildingDiagnostic::DoorOnNoLane { door: entry.name.clone() });
    }
    let (mut met, mut seen) = (Vec::new(), BTreeSet::new());
    for ends in &entry.on {
        match lane_of(map, ends) {
            Some(lane) if seen.insert(lane) => met.push((lane, ends)),
            Some(_) => {}                       // named once more, perhaps from its other end
            None if stands(written, ends) => {} // said of the lane already
            None => {
                let (door, lane) = (entry.name.clone(), LaneName(ends.0.clone(), ends.1.clone()));
                let hint = lane_meant(map, ends);
                say(problems, BuildingDiagnostic::UnknownLane { door, lane, hint });
            }
        }
    }
    let level = |lane: usize| map.level_of(&map.lanes[lane].from);
    if met.windows(2).any(|pair| level(pair[0].0) != level(pair[1].0)) {
        say(problems, BuildingDiagnostic::DoorAcrossLevels { door: entry.name.clone() });
    }
    if problems.len() > before {
        return;
    }
    let (index, mut lanes) = (map.doors.len(), Vec::new());
    for (lane, ends) in met {
        let (from, to) = (map.lanes[lane].from.clone(), map.lanes[lane].to.clone());
        let share = entry.span.map_or(Some(0.5), |(a, b)| {
            let [start, end] = [&from, &to].map(|id| map.place(id).map_or((0.0, 0.0), |p| (p.pose.x, p.pose.y)));
            intersection(start, end, a, b)
        });
        match share {
            Some(share) => map.doors_by_lane.entry(lane).or_default().push((index, share)),
            None => {
                let (door, lane) = (entry.name.clone(), LaneName(ends.0.clone(), ends.1.clone()));
                say(problems, BuildingDiagnostic::DoorMissesLane { door, lane });
            }
        }
        lanes.push((from, to));
    }
    let opening = Seconds::new(entry.opening_s).expect("within bounds, or said above");
    map.doors.push(Door { name: entry.name.clone(), lanes, opening, span: entry.span });
}

/// Whether the file has this lane, right or wrong.
fn stands(written: &MapFile, ends: &(String, String)) -> bool {
    written.lanes.iter().any(|lane| lane.between == *ends || (&lane.between.1, &lane.between.0) == (&ends.0, &ends.1))
}

/// The lane between two places, whichever end is named first.
fn lane_of(map: &Map, ends: &(String, String)) -> Option<usize> {
    let index = |text: &String| PlaceId::new(text.as_str()).ok().and_then(|id| map.index(&id));
    let (a, b) = (index(&ends.0)?, index(&ends.1)?);
    map.by_ends.get(&(a, b)).or_else(|| map.by_ends.get(&(b, a))).copied()
}

fn lane_meant(map: &Map, ends: &(String, String)) -> String {
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

fn lift(entry: &LiftEntry, map: &mut Map, written: &MapFile, problems: &mut Problems) {
    let before = problems.len();
    let me = ("lift", entry.name.as_str());
    number(me, "opening_s", entry.opening_s, OPENING, problems);
    number(me, "speed_mps", entry.speed_mps, SPEED, problems);
    if entry.capacity == 0 {
        say(problems, BuildingDiagnostic::ZeroCapacity { lift: entry.name.clone() });
    }
    let (index, mut stops): (usize, Vec<PlaceIndex>) = (map.lifts.len(), Vec::new());
    for text in &entry.stops {
        let Some(place) = PlaceId::new(text.as_str()).ok().and_then(|id| map.index(&id)) else {
            if written.places.iter().any(|place| place.name == *text) {
                return; // said of the place already
            }
            let hint = did_you_mean(text, map.places.iter().map(|place| place.id.as_str()));
            say(problems, BuildingDiagnostic::UnknownStop { lift: entry.name.clone(), place: text.clone(), hint });
            continue;
        };
        let taken = map.lift_of.get(&place).map(|lift| map.lifts[*lift].name.clone());
        let taken = taken.or_else(|| stops.contains(&place).then(|| entry.name.clone()));
        match taken {
            Some(other) => {
                let (lift, place) = (entry.name.clone(), text.clone());
                say(problems, BuildingDiagnostic::StopOfAnotherLift { lift, place, other });
            }
            None => stops.push(place),
        }
    }
    let levels: BTreeSet<_> = stops.iter().map(|stop| map.place_at(*stop).level).collect();
    if levels.len() < 2 && problems.len() == before {
        say(problems, BuildingDiagnostic::SingleLevelLift { lift: entry.name.clone(), levels: levels.len() });
    }
    if problems.len() > before {
        return;
    }
    map.lift_of.extend(stops.iter().map(|stop| (*stop, index)));
    map.lifts.push(Lift {
        name: entry.name.clone(),
        stops: stops.iter().map(|stop| map.place_at(*stop).id.clone()).collect(),
        capacity: entry.capacity,
        opening: Seconds::new(entry.opening_s).expect("within bounds, or said above"),
        speed: MetresPerSecond::new(entry.speed_mps).expect("within bounds, or said above"),
    });
}
