//! What costs time on the way, beside its length: doors that open, lifts that come, limits of speed.

use super::EnvironmentDescriptor;
use consort_protocol::ids::PlaceId;
use consort_protocol::units::{Metres, MetresPerSecond, Seconds};
use std::collections::BTreeMap;

/// What is known of the ways between neighbouring places, each in its own direction. Ways of which nothing is known are driven
/// without a stop at the robot's own speed. Nobody can tell beforehand how long the queue will be at a door or a lift: it is
/// reckoned with as if the robot was the only one there.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Passages {
    /// By where they lead from, and then to.
    ways: BTreeMap<PlaceId, BTreeMap<PlaceId, Passage>>,
}

/// The way from one place to a neighbour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Passage {
    /// It is driven.
    Drive {
        /// The fastest that is allowed there.
        speed_limit: Option<MetresPerSecond>,
        /// How long a robot stands on the way, as it is to be expected.
        stands: Seconds,
    },
    /// It is ridden, by lift: how long that takes with the wait for it, as it is to be expected.
    Lift(Seconds),
}

impl EnvironmentDescriptor for Passages {
    const KIND: &'static str = "passages";
}

impl Passages {
    /// The same with one more way, in place of what was known of it.
    #[must_use]
    pub fn with(mut self, from: PlaceId, to: PlaceId, passage: Passage) -> Passages {
        self.ways.entry(from).or_default().insert(to, passage);
        self
    }

    /// Whether nothing is known of any way.
    pub fn is_empty(&self) -> bool {
        self.ways.is_empty()
    }

    /// How long it takes from one place to its neighbour, over a way of this length, at this speed where it is allowed.
    pub fn time(&self, from: &PlaceId, to: &PlaceId, length: Metres, speed: MetresPerSecond) -> Seconds {
        match self.ways.get(from).and_then(|ways| ways.get(to)) {
            None => length.at(speed),
            Some(Passage::Drive { speed_limit, stands }) => {
                let slower = speed_limit.filter(|limit| limit.get() < speed.get());
                length.at(slower.unwrap_or(speed)) + *stands
            }
            Some(Passage::Lift(time)) => *time,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_is_as_slow_as_its_limit_its_doors_and_its_lift() {
        let place = |name| PlaceId::new(name).unwrap();
        let speed = |speed| MetresPerSecond::new(speed).unwrap();
        let seconds = |seconds| Seconds::new(seconds).unwrap();
        let limit = |limit| Passage::Drive { speed_limit: Some(speed(limit)), stands: seconds(3.0) };
        let passages = Passages::default()
            .with(place("A"), place("B"), limit(0.25))
            .with(place("B"), place("C"), limit(2.0))
            .with(place("C"), place("D"), Passage::Lift(seconds(12.0)));
        let ways = ["A", "B", "C", "D", "A"].map(place);
        let times =
            ways.windows(2).map(|way| passages.time(&way[0], &way[1], Metres::new(5.0).unwrap(), speed(0.5)).get());
        // The last leads from D to A, of which nothing is known.
        assert_eq!(times.collect::<Vec<_>>(), [23.0, 13.0, 12.0, 10.0]);
        assert!(!passages.is_empty() && Passages::default().is_empty());
    }
}
