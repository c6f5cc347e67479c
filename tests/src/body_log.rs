//! Log of the robots' bodies, as their driver server publishes them, and what must hold in it while a robot is held or a
//! place is closed.
//!
//! After an interruption of the log, as while the driver server was stopped or cut off, the time in which robots must
//! follow an order counts anew: states may arrive late, and a driver server that continues permits goals for a while.

use crate::order_bounds::{heeds_closures_within, stops_within};
use consort_bus::{Sample, Stream};
use consort_fleet::robot_driver::DriverState;
use consort_protocol::codec;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::pose::Pose;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Longest time between two states in a log without interruption: three times the interval of the driver server.
const GAP: Duration = Duration::from_millis(1_500);

/// Distance in metres up to which two poses are the same place.
const AT_REST_M: f64 = 0.02;

/// State of a body.
#[derive(Debug, Clone, PartialEq)]
struct BodyState {
    /// Time of arrival.
    at: Instant,
    robot: RobotId,
    pose: Pose,
    /// Last place that it has passed.
    place: PlaceId,
}

/// The log. Clones share the same states.
#[derive(Debug, Clone, Default)]
pub struct BodyLog(Arc<Mutex<Vec<BodyState>>>);

impl BodyLog {
    /// Records published states of driver servers until the stream ends.
    pub async fn record(self, mut states: Stream<Sample>) {
        while let Some(sample) = states.recv().await {
            if let Ok(DriverState { robot, telemetry, .. }) = codec::decode::<DriverState>(&sample.payload) {
                self.add(BodyState { at: Instant::now(), robot, pose: telemetry.pose, place: telemetry.place });
            }
        }
    }

    fn add(&self, state: BodyState) {
        self.lock().push(state);
    }

    fn lock(&self) -> MutexGuard<'_, Vec<BodyState>> {
        // Each write is a single step.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Checks that a robot stands still while it is held: from the acknowledgement to the order that ends the hold.
    /// Returns the number of checked states.
    ///
    /// # Errors
    /// Description of the first movement.
    pub fn check_held(&self, robot: &RobotId, held: &Range<Instant>, lease: Duration) -> Result<usize, String> {
        let segments = self.segments(robot, held, stops_within(lease) + GAP);
        for segment in &segments {
            for pair in segment.windows(2) {
                let moved_m = pair[0].pose.distance(pair[1].pose).get();
                if moved_m > AT_REST_M {
                    let held_s = (pair[1].at - held.start).as_secs_f64();
                    return Err(format!("{robot} moved by {moved_m:.2} m, {held_s:.1} s after it was held"));
                }
            }
        }
        Ok(segments.iter().map(Vec::len).sum())
    }

    /// Checks that a robot does not enter a place while it is closed: from the acknowledgement to the order that opens
    /// it. Returns the number of checked states.
    ///
    /// # Errors
    /// Description of the first entry.
    pub fn check_closed(
        &self,
        robot: &RobotId,
        place: &PlaceId,
        closed: &Range<Instant>,
        lease: Duration,
    ) -> Result<usize, String> {
        let segments = self.segments(robot, closed, heeds_closures_within(lease) + GAP);
        for segment in &segments {
            if let Some(pair) = segment.windows(2).find(|pair| pair[0].place != *place && pair[1].place == *place) {
                let closed_s = (pair[1].at - closed.start).as_secs_f64();
                return Err(format!("{robot} entered {place}, {closed_s:.1} s after it was closed"));
            }
        }
        Ok(segments.iter().map(Vec::len).sum())
    }

    /// Returns the states of a robot in a period, without those in the time `within` after its start and after each
    /// interruption.
    fn segments(&self, robot: &RobotId, period: &Range<Instant>, within: Duration) -> Vec<Vec<BodyState>> {
        let log = self.lock();
        let (mut segments, mut from) = (vec![vec![]], period.start + within);
        let mut last: Option<Instant> = None;
        for state in log.iter().filter(|state| state.robot == *robot && state.at < period.end) {
            if last.is_none_or(|last| state.at - last > GAP) {
                from = from.max(state.at + within);
                segments.push(vec![]);
            }
            last = Some(state.at);
            if state.at >= from {
                segments.last_mut().expect("the first exists").push(state.clone());
            }
        }
        segments
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;

    const LEASE: Duration = Duration::from_secs(4);

    fn seconds(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    /// Adds a state of ada in each half second of a period, at `x_m` and after `place`.
    fn add(log: &BodyLog, start: Instant, period: Range<u32>, x_m: impl Fn(f64) -> f64, place: &str) {
        for number in period.start * 2..period.end * 2 {
            let at_s = f64::from(number) / 2.0;
            let pose = Pose::new(x_m(at_s), 0.0, 0.0);
            log.add(BodyState { at: start + seconds(at_s), robot: slug("ada"), pose, place: slug(place) });
        }
    }

    #[test]
    fn a_held_robot_that_moves_after_the_bound_is_found() {
        let (log, start, ada) = (BodyLog::default(), Instant::now(), slug::<RobotId>("ada"));
        // It drives until 8 s after the hold, and again from 30 s on.
        add(&log, start, 0..30, |at_s| at_s.min(18.0), "Dock");
        add(&log, start, 30..40, |at_s| at_s, "Dock");
        let held = |from_s, to_s| log.check_held(&ada, &(start + seconds(from_s)..start + seconds(to_s)), LEASE);
        assert_eq!(held(10.0, 30.0), Ok(23), "from 8.5 s after the hold");
        assert_eq!(held(9.0, 30.0), Err("ada moved by 0.50 m, 9.0 s after it was held".to_owned()));
        let violation = held(10.0, 31.0).unwrap_err();
        assert_eq!(violation, "ada moved by 12.00 m, 20.0 s after it was held");
    }

    #[test]
    fn after_an_interruption_a_robot_may_move_for_a_while() {
        let (log, start, ada) = (BodyLog::default(), Instant::now(), slug::<RobotId>("ada"));
        add(&log, start, 0..20, |_| 0.0, "Dock");
        add(&log, start, 25..60, |at_s| at_s.min(30.0), "Dock");
        let held = |to_s| log.check_held(&ada, &(start..start + seconds(to_s)), LEASE);
        assert_eq!(held(60.0), Ok(23 + 53), "from 8.5 s and from 33.5 s on");
        add(&log, start, 60..61, |_| 0.0, "Dock");
        assert!(held(61.0).is_err());
    }

    #[test]
    fn a_robot_that_enters_a_closed_place_after_the_bound_is_found() {
        let (log, start, ada) = (BodyLog::default(), Instant::now(), slug::<RobotId>("ada"));
        let (ward, hall) = (slug::<PlaceId>("Ward"), slug::<PlaceId>("Hall"));
        add(&log, start, 0..20, |_| 0.0, "Hall");
        add(&log, start, 20..40, |_| 0.0, "Ward");
        let check = |place: &PlaceId, from_s| {
            log.check_closed(&ada, place, &(start + seconds(from_s)..start + seconds(40.0)), LEASE)
        };
        let violation = check(&ward, 0.0).unwrap_err();
        assert_eq!(violation, "ada entered Ward, 20.0 s after it was closed");
        assert!(check(&ward, 10.0).is_ok(), "it was on its way");
        assert!(check(&hall, 0.0).is_ok(), "it leaves a closed place");
        assert!(log.check_closed(&slug("bob"), &ward, &(start..start + seconds(40.0)), LEASE).is_ok());
    }
}
