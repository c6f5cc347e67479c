//! Delays on the way: doors that open, lifts, speed limits of the map and of people.

use super::descriptor::EnvironmentDescriptor;
use super::speed_limits::SpeedLimits;
use consort_protocol::ids::PlaceId;
use consort_protocol::units::{Metres, MetresPerSecond, Seconds};
use std::collections::BTreeMap;

/// Travel data of the edges between neighbouring places, by direction. An edge without data is
/// driven without a stop at the robot's own speed. The length of a queue at a door or a lift cannot
/// be predicted, so the times assume that the robot is alone.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Passages {
    /// Data by start, then by end.
    edges: BTreeMap<PlaceId, BTreeMap<PlaceId, Passage>>,
    /// Speed limits of people.
    limits: SpeedLimits,
}

/// Travel data of an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Passage {
    /// The edge is driven.
    Drive {
        /// Speed limit.
        speed_limit: Option<MetresPerSecond>,
        /// Expected waiting time on the edge.
        expected_wait: Seconds,
    },
    /// The edge is a lift ride: the expected duration, including the wait for the lift.
    Lift(Seconds),
}

impl EnvironmentDescriptor for Passages {
    const KIND: &'static str = "passages";
}

impl Passages {
    /// Adds the data of an edge, replacing earlier data.
    #[must_use]
    pub fn with(mut self, from: PlaceId, to: PlaceId, passage: Passage) -> Passages {
        self.edges.entry(from).or_default().insert(to, passage);
        self
    }

    /// Sets the speed limits of people.
    #[must_use]
    pub fn with_limits(self, limits: SpeedLimits) -> Passages {
        Passages { limits, ..self }
    }

    /// Returns the speed limits of people.
    pub(super) fn limits(&self) -> &SpeedLimits {
        &self.limits
    }

    /// Checks whether there are no data.
    pub fn is_empty(&self) -> bool {
        self.edges.is_empty() && self.limits.is_empty()
    }

    /// Checks whether an edge is a lift ride, in this direction.
    pub(super) fn is_lift(&self, from: &PlaceId, to: &PlaceId) -> bool {
        matches!(self.edges.get(from).and_then(|edges| edges.get(to)), Some(Passage::Lift(_)))
    }

    /// Returns the travel time from a place to its neighbour, over an edge of this length, at this
    /// speed or the lowest limit.
    pub fn time(&self, from: &PlaceId, to: &PlaceId, length: Metres, speed: MetresPerSecond) -> Seconds {
        let speed = self.speed(from, to, self.limits.slowed(from, to, speed));
        match self.passage(from, to) {
            None => length.at(speed),
            Some(Passage::Drive { expected_wait, .. }) => length.at(speed) + *expected_wait,
            Some(Passage::Lift(time)) => *time,
        }
    }

    /// Returns the speed of a robot of this speed from a place to its neighbour, under the limit of the map.
    pub(super) fn speed(&self, from: &PlaceId, to: &PlaceId, speed: MetresPerSecond) -> MetresPerSecond {
        match self.passage(from, to) {
            Some(Passage::Drive { speed_limit: Some(limit), .. }) if limit.get() < speed.get() => *limit,
            Some(Passage::Drive { .. } | Passage::Lift(_)) | None => speed,
        }
    }

    fn passage(&self, from: &PlaceId, to: &PlaceId) -> Option<&Passage> {
        self.edges.get(from)?.get(to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn travel_time_includes_limits_doors_and_lifts() {
        let place = |name| PlaceId::new(name).unwrap();
        let speed = |speed| MetresPerSecond::new(speed).unwrap();
        let seconds = |seconds| Seconds::new(seconds).unwrap();
        let limit = |limit| Passage::Drive { speed_limit: Some(speed(limit)), expected_wait: seconds(3.0) };
        let passages = Passages::default()
            .with(place("A"), place("B"), limit(0.25))
            .with(place("B"), place("C"), limit(2.0))
            .with(place("C"), place("D"), Passage::Lift(seconds(12.0)));
        let edges = ["A", "B", "C", "D", "A"].map(place);
        let times =
            edges.windows(2).map(|way| passages.time(&way[0], &way[1], Metres::new(5.0).unwrap(), speed(0.5)).get());
        // There are no data for the last edge, from D to A.
        assert_eq!(times.collect::<Vec<_>>(), [23.0, 13.0, 12.0, 10.0]);
        let limits: SpeedLimits = [((place("D"), place("D")), speed(0.1))].into_iter().collect();
        let limited = passages.clone().with_limits(limits.clone());
        let times =
            edges.windows(2).map(|way| limited.time(&way[0], &way[1], Metres::new(5.0).unwrap(), speed(0.5)).get());
        assert_eq!(times.collect::<Vec<_>>(), [23.0, 13.0, 12.0, 50.0], "a lift is as fast as before");
        assert!(!passages.is_empty() && Passages::default().is_empty());
        assert!(!Passages::default().with_limits(limits).is_empty());
    }
}
