//! Parts of a building besides places and lanes: levels, doors and lifts.

use super::{Lane, Map, PlaceIndex};
use consort_protocol::ids::PlaceId;
use consort_protocol::units::{MetresPerSecond, Seconds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Name of the only level of a map without levels.
pub const DEFAULT_LEVEL: &str = "ground";

/// Index of a level in [`Map::levels`]; the default is the first level.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LevelIndex(pub(crate) usize);

/// A level (storey) of the building.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLevel {
    /// Its name, unique on the map.
    pub name: String,
    /// Metres above the lowest level, or above the zero height of the map.
    pub elevation_m: f64,
}

/// An automatic door across its lanes (at least 1).
#[derive(Debug, Clone, PartialEq)]
pub struct Door {
    /// Its name, unique among the doors.
    pub name: String,
    /// The lanes through the door, each given by its ends in the order of the lane; all on the same
    /// level.
    pub lanes: Vec<(PlaceId, PlaceId)>,
    /// Time from closed to open, and from open to closed.
    pub opening: Seconds,
    /// The two posts, as (x, y) in metres. `None` if the map gives none; the door then stands in
    /// the middle of each lane.
    pub span: Option<((f64, f64), (f64, f64))>,
}

/// A door on a lane, with its position in driving direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaneDoor<'a> {
    /// The door.
    pub door: &'a Door,
    /// Position on the lane, from 0 (start) to 1 (end).
    pub at: f64,
}

/// A lift that connects places on two or more levels.
#[derive(Debug, Clone, PartialEq)]
pub struct Lift {
    /// Its name, unique among the lifts.
    pub name: String,
    /// The places at its doors; each place belongs to a single lift.
    pub stops: Vec<PlaceId>,
    /// Number of robots in the cabin at the same time.
    pub capacity: u32,
    /// Time from closed to open of its doors, and from open to closed.
    pub opening: Seconds,
    /// Vertical speed of the cabin.
    pub speed: MetresPerSecond,
}

/// A ride by lift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LiftRide<'a> {
    /// The lift.
    pub lift: &'a Lift,
    /// Time from the closing of the doors at the first stop until they are open at the second.
    pub time: Seconds,
}

/// Heading of a robot on a lane, relative to the direction of the lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Facing {
    /// Robots face the direction of the lane.
    Forward,
    /// Robots face against the direction of the lane.
    Backward,
}

impl Facing {
    /// Returns the same heading relative to the opposite direction of the lane.
    pub fn reversed(self) -> Facing {
        match self {
            Facing::Forward => Facing::Backward,
            Facing::Backward => Facing::Forward,
        }
    }
}

impl Map {
    /// Returns all levels, in the order of the file. Never empty: a map without levels has the
    /// level [`DEFAULT_LEVEL`].
    pub fn levels(&self) -> &[MapLevel] {
        &self.levels
    }

    /// Returns a level by its index.
    ///
    /// # Panics
    /// If the index belongs to another map.
    pub fn level(&self, index: LevelIndex) -> &MapLevel {
        &self.levels[index.0]
    }

    /// Returns the indices of all levels.
    pub fn level_indices(&self) -> impl ExactSizeIterator<Item = LevelIndex> + use<> {
        (0..self.levels.len()).map(LevelIndex)
    }

    /// Returns the level with this name.
    pub fn level_named(&self, name: &str) -> Option<LevelIndex> {
        self.levels.iter().position(|level| level.name == name).map(LevelIndex)
    }

    /// Returns the level of a place.
    pub fn level_of(&self, place: &PlaceId) -> Option<LevelIndex> {
        self.place(place).map(|place| place.level)
    }

    /// Returns the walls of a level, as polylines of (x, y) in metres.
    pub fn walls_on(&self, level: LevelIndex) -> impl Iterator<Item = &[(f64, f64)]> {
        let walls = self.walls.iter().zip(&self.wall_levels);
        walls.filter(move |(_, at)| **at == level).map(|(wall, _)| wall.as_slice())
    }

    /// Returns the lanes of a level, in the order of the file.
    pub fn lanes_on(&self, level: LevelIndex) -> impl Iterator<Item = &Lane> {
        self.lanes.iter().filter(move |lane| self.level_of(&lane.from) == Some(level))
    }

    /// Returns all doors, in the order of the file.
    pub fn doors(&self) -> &[Door] {
        &self.doors
    }

    /// Returns the posts of a door, as (x, y) in metres, a pair for each position of the door. A
    /// door without a span is 1 m wide and stands across the middle of each of its lanes.
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

    /// Returns the door with this name.
    pub fn door(&self, name: &str) -> Option<&Door> {
        self.doors.iter().find(|door| door.name == name)
    }

    /// Returns the doors on the lane from `from` to `to`, in driving order. Empty if no lane leads
    /// there.
    pub fn doors_on(&self, from: &PlaceId, to: &PlaceId) -> Vec<LaneDoor<'_>> {
        let ends = self.index(from).zip(self.index(to));
        let Some(lane) = ends.and_then(|ends| self.by_ends.get(&ends)) else { return Vec::new() };
        let forward = self.lanes[*lane].from == *from;
        let doors_on_lane = self.doors_by_lane.get(lane).into_iter().flatten();
        let mut doors: Vec<_> = doors_on_lane
            .map(|(door, share)| LaneDoor { door: &self.doors[*door], at: if forward { *share } else { 1.0 - *share } })
            .collect();
        doors.sort_by(|a, b| a.at.total_cmp(&b.at));
        doors
    }

    /// Returns all lifts, in the order of the file.
    pub fn lifts(&self) -> &[Lift] {
        &self.lifts
    }

    /// Returns the lift with this name.
    pub fn lift(&self, name: &str) -> Option<&Lift> {
        self.lifts.iter().find(|lift| lift.name == name)
    }

    /// Returns the lift with a stop at this place.
    pub fn lift_at(&self, place: &PlaceId) -> Option<&Lift> {
        self.index(place).and_then(|index| self.lift_of.get(&index)).map(|lift| &self.lifts[*lift])
    }

    /// Returns the ride by lift from `from` to `to`; `None` if no lift stops at both.
    pub fn ride(&self, from: &PlaceId, to: &PlaceId) -> Option<LiftRide<'_>> {
        let (a, b) = (self.index(from)?, self.index(to)?);
        let lift = *self.lift_of.get(&a).filter(|lift| a != b && self.lift_of.get(&b) == Some(*lift))?;
        let lift = &self.lifts[lift];
        let height = |place: PlaceIndex| self.level(self.place_at(place).level).elevation_m;
        let doors = 2.0 * lift.opening.get();
        let time = Seconds::new(doors + (height(a) - height(b)).abs() / lift.speed.get());
        Some(LiftRide { lift, time: time.expect("elevations, speeds and opening times of a valid map are finite") })
    }
}

/// Returns the intersection of the segment from `a` to `b` with the segment from `c` to `d`, as a
/// fraction of the way from `a` to `b`. `None` for parallel segments.
pub(crate) fn intersection(a: (f64, f64), b: (f64, f64), c: (f64, f64), d: (f64, f64)) -> Option<f64> {
    let (along, across) = ((b.0 - a.0, b.1 - a.1), (d.0 - c.0, d.1 - c.1));
    let turn = along.0 * across.1 - along.1 * across.0;
    let gap = (c.0 - a.0, c.1 - a.1);
    let share = (gap.0 * across.1 - gap.1 * across.0) / turn;
    let on_other = (gap.0 * along.1 - gap.1 * along.0) / turn;
    let within = |share: f64| (0.0..=1.0).contains(&share);
    (turn != 0.0 && within(share) && within(on_other)).then_some(share)
}
