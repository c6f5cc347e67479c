//! The way that a skill requests from the devices of the building, and the answer of the robot actor.

use consort_protocol::devices::Devices;
use consort_protocol::ids::PlaceId;
use consort_protocol::units::NodeTime;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Time after which a request that is not repeated has ended: several ticks of a skill.
const REQUEST_LASTS: Duration = Duration::from_secs(3);

/// A way from a place to its neighbour.
pub(crate) type Way = (PlaceId, PlaceId);

/// The way that a skill requests.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct RequestedWay {
    /// The way to the next place.
    pub(crate) way: Way,
    /// The ways after it, up to the first place at which the robot can wait without a device.
    pub(crate) then: Vec<Way>,
}

/// Request of a skill, for all clones of a driver.
#[derive(Clone, Default)]
pub(crate) struct SharedWays {
    devices: Arc<Devices>,
    state: Arc<Mutex<Ways>>,
}

#[derive(Default)]
struct Ways {
    requested: Option<(RequestedWay, NodeTime)>,
    granted: Option<Way>,
}

impl SharedWays {
    /// Creates the requests for these devices.
    pub(crate) fn new(devices: Arc<Devices>) -> SharedWays {
        SharedWays { devices, state: Arc::default() }
    }

    /// Requests a way, after which the route leads to these places. Returns true if the robot may drive it now.
    pub(super) fn request(&self, from: &PlaceId, to: &PlaceId, then: &[PlaceId], now: NodeTime) -> bool {
        if from == to {
            return true; // back to the place that the robot has left last
        }
        let mut ways = self.lock();
        if self.devices.guarding(from, to).next().is_none() {
            ways.requested = None;
            return true;
        }
        let way = (from.clone(), to.clone());
        let is_granted = ways.granted.as_ref() == Some(&way);
        let then = self.devices.ways_inside(to, then);
        ways.requested = Some((RequestedWay { way, then }, now));
        is_granted
    }

    /// Ends the request.
    pub(super) fn end(&self) {
        self.lock().requested = None;
    }

    /// Returns the requested way.
    pub(crate) fn requested(&self, now: NodeTime) -> Option<RequestedWay> {
        let requested = self.lock().requested.clone();
        requested.filter(|(_, at)| now.since(*at) < REQUEST_LASTS).map(|(requested, _)| requested)
    }

    /// Grants a way, and no other.
    pub(crate) fn grant(&self, way: Option<Way>) {
        self.lock().granted = way;
    }

    fn lock(&self) -> MutexGuard<'_, Ways> {
        // Each write is a single step.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
