//! Queries of levels, doors and lifts of a map.

use super::model::{Door, Lane, LaneDoor, LevelIndex, Lift, LiftRide, Map, MapLevel, PlaceIndex};
use consort_protocol::ids::PlaceId;
use consort_protocol::units::Seconds;

impl Map {
    /// Returns all levels, in the order of the file. Never empty: a map without levels has the
    /// level [`DEFAULT_LEVEL`](super::DEFAULT_LEVEL).
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
    pub(crate) fn lanes_on(&self, level: LevelIndex) -> impl Iterator<Item = &Lane> {
        self.lanes.iter().filter(move |lane| self.level_of(&lane.from) == Some(level))
    }

    /// Returns all doors, in the order of the file.
    pub fn doors(&self) -> &[Door] {
        &self.doors
    }

    /// Returns the posts of a door, as (x, y) in metres, a pair for each position of the door. A
    /// door without a span is 1 m wide and stands across the middle of each of its lanes.
    pub(crate) fn door_posts(&self, door: &Door) -> Vec<((f64, f64), (f64, f64))> {
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
    pub(crate) fn doors_on(&self, from: &PlaceId, to: &PlaceId) -> Vec<LaneDoor<'_>> {
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
    pub(crate) fn lift_at(&self, place: &PlaceId) -> Option<&Lift> {
        self.index(place).and_then(|index| self.lift_of.get(&index)).map(|lift| &self.lifts[*lift])
    }

    /// Returns the ride by lift from `from` to `to`; `None` if no lift stops at both.
    pub(crate) fn ride(&self, from: &PlaceId, to: &PlaceId) -> Option<LiftRide<'_>> {
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
pub fn intersection(a: (f64, f64), b: (f64, f64), c: (f64, f64), d: (f64, f64)) -> Option<f64> {
    let (along, across) = ((b.0 - a.0, b.1 - a.1), (d.0 - c.0, d.1 - c.1));
    let turn = along.0 * across.1 - along.1 * across.0;
    let gap = (c.0 - a.0, c.1 - a.1);
    let share = (gap.0 * across.1 - gap.1 * across.0) / turn;
    let on_other = (gap.0 * along.1 - gap.1 * along.0) / turn;
    let within = |share: f64| (0.0..=1.0).contains(&share);
    (turn != 0.0 && within(share) && within(on_other)).then_some(share)
}
