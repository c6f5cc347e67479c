//! The map as estimators and skills use it: places, connections of neighbours, and the time that
//! they cost.

use super::model::{Lane, Map};
use consort_protocol::ids::PlaceId;
use consort_protocol::units::Seconds;
use consort_skills::environment::{Edge, Environment, MapError, Passage, Passages, Routes, TopologicalMap};

/// Speed, in metres per second, that converts the time of a lift ride into a length. Routes are the
/// shortest by length; a ride counts as the distance that a robot drives at this speed during the
/// ride. The cost of a ride in time is in [`Map::passages`].
const RIDE_MPS: f64 = 0.5;

/// Least length of a ride in metres: a ride that takes no time is still an edge.
const RIDE_MIN_M: f64 = 0.001;

impl Map {
    /// Returns the places, the lanes and, between places without a lane, the rides by lift.
    pub fn topology(&self) -> TopologicalMap {
        self.topology_of(None)
    }

    /// Returns the topology for robots of a navigation graph: all places, and the lanes of the graph. `None`: all
    /// lanes.
    pub fn topology_of(&self, graph: Option<&str>) -> TopologicalMap {
        let places = self.places.iter().map(|place| (place.id.clone(), place.pose)).collect();
        let lane = |lane: &Lane| Edge {
            a: lane.from.clone(),
            b: lane.to.clone(),
            length_m: lane.length.get(),
            one_way: !lane.two_way,
        };
        let lanes = self.lanes.iter().filter(|lane| lane.is_in(graph));
        let edges = lanes.map(lane).chain(self.rides());
        TopologicalMap { places, edges: edges.collect() }
    }

    /// Returns additional times and speed limits between neighbours: doors (assumed closed), lifts
    /// (assumed to be at any of their stops with the same probability) and speed limits.
    pub fn passages(&self) -> Passages {
        let mut passages = Passages::default();
        for lane in &self.lanes {
            let doors = self.doors_on(&lane.from, &lane.to);
            if doors.is_empty() && lane.speed_limit.is_none() {
                continue;
            }
            let expected_wait = doors.iter().map(|lane_door| lane_door.door.opening).sum();
            let passage = Passage::Drive { speed_limit: lane.speed_limit, expected_wait };
            passages = passages.with(lane.from.clone(), lane.to.clone(), passage);
            if lane.two_way {
                passages = passages.with(lane.to.clone(), lane.from.clone(), passage);
            }
        }
        for ride in self.rides() {
            for (from, to) in
                [(&ride.a, &ride.b), (&ride.b, &ride.a)].into_iter().take(if ride.one_way { 1 } else { 2 })
            {
                if let Some(time) = self.expected_ride(from, to) {
                    passages = passages.with(from.clone(), to.clone(), Passage::Lift(time));
                }
            }
        }
        passages
    }

    /// Returns the environment for skills and estimators.
    ///
    /// # Errors
    /// [`MapError`] never, for a valid map.
    pub fn environment(&self) -> Result<Environment, MapError> {
        Ok(Environment::new().with(Routes::new(&self.topology())?).with(self.passages()))
    }

    /// Returns the time of a ride with the expected wait: the lift comes from any of its stops, and
    /// opens.
    fn expected_ride(&self, from: &PlaceId, to: &PlaceId) -> Option<Seconds> {
        let ride = self.ride(from, to)?;
        let height = |place: &PlaceId| self.place(place).map_or(0.0, |place| self.level(place.level).elevation_m);
        let total_height: f64 = ride.lift.stops.iter().map(|stop| (height(stop) - height(from)).abs()).sum();
        let wait_s = total_height / ride.lift.stops.len() as f64 / ride.lift.speed.get();
        Some(Seconds::new(wait_s).ok()? + ride.lift.opening + ride.time)
    }

    fn rides(&self) -> impl Iterator<Item = Edge> {
        let pairs = self.lifts.iter().flat_map(|lift| {
            let stops = lift.stops.iter().enumerate();
            stops.flat_map(|(index, a)| lift.stops[index + 1..].iter().map(move |b| (a, b)))
        });
        pairs.flat_map(|(a, b)| {
            let by_lane = |from: &PlaceId, to: &PlaceId| self.lane(from, to).is_some();
            match (by_lane(a, b), by_lane(b, a)) {
                (false, false) => self.ride_edge(a, b, false),
                (false, true) => self.ride_edge(a, b, true),
                (true, false) => self.ride_edge(b, a, true),
                (true, true) => None,
            }
        })
    }

    fn ride_edge(&self, a: &PlaceId, b: &PlaceId, one_way: bool) -> Option<Edge> {
        let length_m = (self.ride(a, b)?.time.get() * RIDE_MPS).max(RIDE_MIN_M);
        Some(Edge { a: a.clone(), b: b.clone(), length_m, one_way })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn routes_use_lifts_between_places_without_a_lane() {
        let text = "{name: tower, levels: [{name: low}, {name: top, elevation_m: 4}], \
            places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: L0, kind: other, x_m: 5, y_m: 0}, \
            {name: L1, kind: other, x_m: 5, y_m: 0, level: top}, {name: B, kind: other, x_m: 9, y_m: 0, level: top}], \
            lanes: [{between: [A, L0]}, {between: [L1, B]}], lifts: [{name: Lift, stops: [L0, L1]}]}";
        let map = crate::map::read(text, "tower.yaml").unwrap();
        let routes = Routes::new(&map.topology()).unwrap();
        let place = |name| PlaceId::new(name).unwrap();
        let route = routes.route(&place("A"), &place("B")).unwrap();
        assert_eq!(route.places, ["A", "L0", "L1", "B"].map(place));
        assert_eq!(route.length.get(), 5.0 + 10.0 * RIDE_MPS + 4.0, "the ride takes 3 + 4 + 3 s");
        assert_eq!(routes.route(&place("B"), &place("A")).unwrap().places.len(), 4);
    }

    #[test]
    fn a_lane_between_two_stops_replaces_the_ride() {
        let text = "{name: loop, levels: [{name: low}, {name: top, elevation_m: 4}], \
            places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 5, y_m: 0}, \
            {name: C, kind: other, x_m: 5, y_m: 0, level: top}], \
            lanes: [{between: [A, B], one_way: true}], lifts: [{name: Lift, stops: [A, B, C]}]}";
        let topology = crate::map::read(text, "loop.yaml").unwrap().topology();
        let edges: Vec<_> = topology.edges.iter().map(|e| (e.a.as_str(), e.b.as_str(), e.one_way)).collect();
        assert_eq!(edges, [("A", "B", true), ("B", "A", true), ("A", "C", false), ("B", "C", false)]);
        topology.check().unwrap();
    }
}
