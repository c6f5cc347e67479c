//! What a building has beside places and lanes: levels, doors, lifts.

use super::{Lane, Map, PlaceIndex};
use consort_protocol::ids::PlaceId;
use consort_protocol::units::{MetresPerSecond, Seconds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The level of a map that names none.
pub const DEFAULT_LEVEL: &str = "ground";

/// Position of a level in [`Map::levels`]; the default is the first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LevelIndex(pub(crate) usize);

/// A floor of the building.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLevel {
    /// Its name, unique on the map.
    pub name: String,
    /// Metres above the lowest level, or above whatever the map counts from.
    pub elevation_m: f64,
}

/// An automatic door. It stands across at least one lane.
#[derive(Debug, Clone, PartialEq)]
pub struct Door {
    /// Its name, unique among the doors.
    pub name: String,
    /// The lanes that lead through it, each by its ends as the lane has them; all on one level.
    pub lanes: Vec<(PlaceId, PlaceId)>,
    /// Time from closed to open, and from open to closed.
    pub opening: Seconds,
    /// The two posts, as (x, y) in metres; none if the map does not say, and then it stands in the middle of each lane.
    pub span: Option<((f64, f64), (f64, f64))>,
}

/// A door on the way from one place to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaneDoor<'a> {
    /// The door.
    pub door: &'a Door,
    /// Where it stands, as the share of the way from 0 (the start) to 1 (the end).
    pub at: f64,
}

/// A lift that joins places on two levels or more.
#[derive(Debug, Clone, PartialEq)]
pub struct Lift {
    /// Its name, unique among the lifts.
    pub name: String,
    /// The places one steps in and out at; each belongs to this lift alone.
    pub stops: Vec<PlaceId>,
    /// How many robots fit in.
    pub capacity: u32,
    /// Time from closed to open of its doors, and from open to closed.
    pub opening: Seconds,
    /// How fast the cabin goes up and down.
    pub speed: MetresPerSecond,
}

/// A ride by lift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LiftRide<'a> {
    /// The lift.
    pub lift: &'a Lift,
    /// How long it takes from the closing of the doors at one stop to their having opened at the other.
    pub time: Seconds,
}

/// Which way a robot faces on a lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Facing {
    /// To where the lane goes.
    Forward,
    /// To where it came from.
    Backward,
}

impl Facing {
    /// The same heading, as seen by one who drives the lane the other way.
    pub fn reversed(self) -> Facing {
        match self {
            Facing::Forward => Facing::Backward,
            Facing::Backward => Facing::Forward,
        }
    }
}

impl Map {
    /// All levels, in the order of the file. Never empty: a map that names none has one, [`GROUND`].
    pub fn levels(&self) -> &[MapLevel] {
        &self.levels
    }

    /// A level by its index.
    ///
    /// # Panics
    /// If the index is of another map.
    pub fn level(&self, index: LevelIndex) -> &MapLevel {
        &self.levels[index.0]
    }

    /// All levels with their indices.
    pub fn level_indices(&self) -> impl ExactSizeIterator<Item = LevelIndex> + use<> {
        (0..self.levels.len()).map(LevelIndex)
    }

    /// The level of this name.
    pub fn level_named(&self, name: &str) -> Option<LevelIndex> {
        self.levels.iter().position(|level| level.name == name).map(LevelIndex)
    }

    /// The level of a place.
    pub fn level_of(&self, place: &PlaceId) -> Option<LevelIndex> {
        self.place(place).map(|place| place.level)
    }

    /// The walls of one level, as polylines of (x, y) in metres.
    pub fn walls_on(&self, level: LevelIndex) -> impl Iterator<Item = &[(f64, f64)]> {
        let walls = self.walls.iter().zip(&self.wall_levels);
        walls.filter(move |(_, at)| **at == level).map(|(wall, _)| wall.as_slice())
    }

    /// The lanes of one level, in the order of the file.
    pub fn lanes_on(&self, level: LevelIndex) -> impl Iterator<Item = &Lane> {
        self.lanes.iter().filter(move |lane| self.level_of(&lane.from) == Some(level))
    }

    /// All doors, in the order of the file.
    pub fn doors(&self) -> &[Door] {
        &self.doors
    }

    /// Where a door stands: its posts, as (x, y) in metres, for each place where it stands. Without a span it is a metre wide,
    /// across the middle of each of its lanes.
    pub fn door_posts(&self, door: &Door) -> Vec<((f64, f64), (f64, f64))> {
        if let Some(span) = door.span {
            return vec![span];
        }
        let across = |(from, to): &(PlaceId, PlaceId)| {
            let [a, b] = [self.place(from)?.pose, self.place(to)?.pose];
            let (dx, dy) = (b.x - a.x, b.y - a.y);
            let half = 0.5 / dx.hypot(dy).max(1e-9);
            let (x, y) = (f64::midpoint(a.x, b.x), f64::midpoint(a.y, b.y));
            Some(((x - dy * half, y + dx * half), (x + dy * half, y - dx * half)))
        };
        door.lanes.iter().filter_map(across).collect()
    }

    /// The door of this name.
    pub fn door(&self, name: &str) -> Option<&Door> {
        self.doors.iter().find(|door| door.name == name)
    }

    /// The doors one meets on the lane from one place to the other, in that order. None if no lane leads there.
    pub fn doors_on(&self, from: &PlaceId, to: &PlaceId) -> Vec<LaneDoor<'_>> {
        let ends = self.index(from).zip(self.index(to));
        let Some(lane) = ends.and_then(|ends| self.by_ends.get(&ends)) else { return Vec::new() };
        let forward = self.lanes[*lane].from == *from;
        let met = self.doors_by_lane.get(lane).into_iter().flatten();
        let mut doors: Vec<_> = met
            .map(|(door, share)| LaneDoor { door: &self.doors[*door], at: if forward { *share } else { 1.0 - *share } })
            .collect();
        doors.sort_by(|a, b| a.at.total_cmp(&b.at));
        doors
    }

    /// All lifts, in the order of the file.
    pub fn lifts(&self) -> &[Lift] {
        &self.lifts
    }

    /// The lift of this name.
    pub fn lift(&self, name: &str) -> Option<&Lift> {
        self.lifts.iter().find(|lift| lift.name == name)
    }

    /// The lift that has a stop at this place.
    pub fn lift_at(&self, place: &PlaceId) -> Option<&Lift> {
        self.index(place).and_then(|index| self.lift_of.get(&index)).map(|lift| &self.lifts[*lift])
    }

    /// The ride by lift from one place to the other; none if no lift stops at both.
    pub fn ride(&self, from: &PlaceId, to: &PlaceId) -> Option<LiftRide<'_>> {
        let (a, b) = (self.index(from)?, self.index(to)?);
        let lift = *self.lift_of.get(&a).filter(|lift| a != b && self.lift_of.get(&b) == Some(*lift))?;
        let lift = &self.lifts[lift];
        let height = |place: PlaceIndex| self.level(self.place_at(place).level).elevation_m;
        let doors = 2.0 * lift.opening.get();
        let time = Seconds::new(doors + (height(a) - height(b)).abs() / lift.speed.get());
        Some(LiftRide { lift, time: time.expect("elevations, speeds and opening times of a sound map are finite") })
    }
}

/// Where the straight line from `a` to `b` meets that from `c` to `d`, as the share of the way from `a` to `b`.
/// Parallel lines never meet.
pub(crate) fn intersection(a: (f64, f64), b: (f64, f64), c: (f64, f64), d: (f64, f64)) -> Option<f64> {
    let (along, across) = ((b.0 - a.0, b.1 - a.1), (d.0 - c.0, d.1 - c.1));
    let turn = along.0 * across.1 - along.1 * across.0;
    let gap = (c.0 - a.0, c.1 - a.1);
    let share = (gap.0 * across.1 - gap.1 * across.0) / turn;
    let on_other = (gap.0 * along.1 - gap.1 * along.0) / turn;
    let within = |share: f64| (0.0..=1.0).contains(&share);
    (turn != 0.0 && within(share) && within(on_other)).then_some(share)
}
