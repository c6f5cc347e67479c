//! Place of a robot whose hardware reports poses, and the connections on which it was blocked.

use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::WorldTime;
use std::collections::BTreeMap;

/// Greatest distance of a pose from a place at which it counts as that place: Nav2's default goal
/// tolerance.
const AT_PLACE_M: f64 = 0.25;

/// Time for which a connection counts as closed after the robot was blocked on it: as in the
/// simulated world.
const CLOSURE_S: f64 = 300.0;

/// Current or last place of a robot on a map, with the connections that are closed for it.
#[derive(Debug, Clone)]
pub struct PlaceTracker {
    places: BTreeMap<PlaceId, Pose>,
    place: PlaceId,
    /// Connections on which the robot was blocked, each with the end of its closure.
    closed: Vec<((PlaceId, PlaceId), f64)>,
}

impl PlaceTracker {
    /// Creates the tracker of a robot at a place of a map.
    pub fn new(place: PlaceId, places: BTreeMap<PlaceId, Pose>) -> PlaceTracker {
        PlaceTracker { places, place, closed: vec![] }
    }

    /// Returns the current or last place.
    pub fn place(&self) -> &PlaceId {
        &self.place
    }

    /// Checks whether a place is on the map.
    pub fn is_on_map(&self, place: &PlaceId) -> bool {
        self.places.contains_key(place)
    }

    /// Sets the place: the stated one, or else the nearest if the pose is at it.
    pub fn set(&mut self, pose: Pose, stated: Option<PlaceId>) {
        let near = || {
            let distances = self.places.iter().map(|(place, at)| (at.distance(pose).get(), place));
            let nearest = distances.min_by(|(a, first), (b, second)| a.total_cmp(b).then_with(|| first.cmp(second)));
            nearest.filter(|(distance, _)| *distance <= AT_PLACE_M).map(|(_, place)| place.clone())
        };
        if let Some(place) = stated.or_else(near) {
            self.place = place;
        }
    }

    /// Records that the robot was blocked on its way to a place.
    pub fn add_closure(&mut self, to: PlaceId, now: WorldTime) {
        if to == self.place {
            return;
        }
        let connection = (self.place.clone(), to);
        self.closed.retain(|(known, _)| *known != connection);
        self.closed.push((connection, now.as_secs() + CLOSURE_S));
    }

    /// Ends the closures that are over by now.
    pub fn end_closures(&mut self, now: WorldTime) {
        let now = now.as_secs();
        self.closed.retain(|(_, until)| *until > now);
    }

    /// Returns the closed connections.
    pub fn closed(&self) -> Vec<(PlaceId, PlaceId)> {
        self.closed.iter().map(|(connection, _)| connection.clone()).collect()
    }
}
