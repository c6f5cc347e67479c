//! Dead ends in which two robots cannot pass each other: a robot that drives in meets the robot that drives out.

use super::model::{Map, PlaceIndex};
use consort_protocol::ids::PlaceId;
use consort_protocol::units::Metres;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// Two or more lanes in a row that end at a place without another way, and have no branch between.
#[derive(Debug, Clone, PartialEq)]
pub struct DeadEnd {
    /// The place at its end.
    pub place: PlaceId,
    /// The place at which it begins: the nearest place with a branch, or the other end of the map.
    pub from: PlaceId,
    /// Number of lanes and lift rides.
    pub lanes: usize,
    /// Length of the lanes.
    pub length: Metres,
}

impl fmt::Display for DeadEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DeadEnd { place, from, lanes, length } = self;
        write!(
            f,
            "place {:?} is at a dead end: on the {lanes} lanes from {:?} ({:.1} m) no two robots can pass each other",
            place.as_str(),
            from.as_str(),
            length.get()
        )
    }
}

impl Map {
    /// Returns the dead ends without a passing place, in the order of their places. A single lane counts as none: a robot
    /// waits in front of it.
    pub fn dead_ends(&self) -> Vec<DeadEnd> {
        let neighbours = self.neighbours();
        let ways_of = |place: &PlaceIndex| neighbours.get(place).map_or(0, BTreeSet::len);
        let mut found = Vec::new();
        for (end, _) in neighbours.iter().filter(|(_, ways)| ways.len() == 1) {
            let (mut before, mut at, mut lanes, mut length) = (*end, *end, 0, Metres::ZERO);
            let next =
                |before: PlaceIndex, at: PlaceIndex| neighbours.get(&at)?.iter().find(|way| **way != before).copied();
            while let Some(onward) = next(before, at) {
                let lane = self.lane_between(at, onward).or_else(|| self.lane_between(onward, at));
                length = length + lane.map_or(Metres::ZERO, |lane| lane.length);
                lanes += 1;
                (before, at) = (at, onward);
                if ways_of(&at) != 2 {
                    break;
                }
            }
            // A map that is a single row of lanes has two ends.
            let is_first_end = ways_of(&at) != 1 || *end < at;
            if lanes >= 2 && is_first_end {
                let [place, from] = [*end, at].map(|place| self.place_at(place).id.clone());
                found.push(DeadEnd { place, from, lanes, length });
            }
        }
        found
    }

    /// Returns the neighbours of each place by lanes in any direction, and by lifts.
    fn neighbours(&self) -> BTreeMap<PlaceIndex, BTreeSet<PlaceIndex>> {
        let mut neighbours: BTreeMap<PlaceIndex, BTreeSet<PlaceIndex>> = BTreeMap::new();
        let lanes = self.by_ends.keys().copied();
        let rides = self.lifts.iter().flat_map(|lift| {
            let stops: Vec<PlaceIndex> = lift.stops.iter().filter_map(|stop| self.index(stop)).collect();
            let pairs: Vec<_> = stops.windows(2).map(|pair| (pair[0], pair[1])).collect();
            pairs
        });
        for (a, b) in lanes.chain(rides) {
            neighbours.entry(a).or_default().insert(b);
            neighbours.entry(b).or_default().insert(a);
        }
        neighbours
    }
}

#[cfg(test)]
mod tests {
    use crate::map::read;

    /// Returns the dead ends of a map with these two-way lanes.
    fn dead_ends(lanes: &[(&str, &str)]) -> Vec<String> {
        let names: std::collections::BTreeSet<&str> = lanes.iter().flat_map(|(a, b)| [*a, *b]).collect();
        let place = |(x, name): (usize, &&str)| format!("{{name: {name}, kind: other, x_m: {x}, y_m: 0}}");
        let places: Vec<String> = names.iter().enumerate().map(place).collect();
        let lane = |(a, b): &(&str, &str)| format!("{{between: [{a}, {b}], length_m: 10}}");
        let lanes: Vec<String> = lanes.iter().map(lane).collect();
        let text = format!("{{name: m, places: [{}], lanes: [{}]}}", places.join(", "), lanes.join(", "));
        read(&text, "m.yaml").unwrap().dead_ends().iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_row_of_lanes_without_a_branch_is_a_dead_end() {
        let ring = [("A", "B"), ("B", "C"), ("C", "A")];
        assert!(dead_ends(&ring).is_empty(), "a ring has no end");
        let with_room = [&ring[..], &[("C", "Room")]].concat();
        assert!(dead_ends(&with_room).is_empty(), "a robot waits at C until the lane is free");
        let with_corridor = [&with_room[..], &[("Room", "Yard"), ("Yard", "Zoo")]].concat();
        assert_eq!(
            dead_ends(&with_corridor),
            ["place \"Zoo\" is at a dead end: on the 3 lanes from \"C\" (30.0 m) no two robots can pass each other"]
        );
        let with_siding = [&with_corridor[..], &[("Yard", "Siding")]].concat();
        assert!(dead_ends(&with_siding).is_empty(), "a robot may wait in the siding, {:?}", dead_ends(&with_siding));
    }

    #[test]
    fn a_map_that_is_a_single_row_is_reported_once() {
        let row = dead_ends(&[("A", "B"), ("B", "C")]);
        assert_eq!(
            row,
            ["place \"A\" is at a dead end: on the 2 lanes from \"C\" (20.0 m) no two robots can pass each other"]
        );
    }
}
