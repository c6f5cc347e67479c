//! Log of the robots' bodies, as their driver server publishes them, and what must hold in it while a robot has to stand
//! still, places are closed, or a speed is limited.
//!
//! After an interruption of the log, as while the driver server was stopped or cut off, the time in which robots must
//! follow an order counts anew: states may arrive late, and a driver server that continues permits goals for a while.

use crate::order_bounds::{SPEED_TOLERANCE_MPS, STATE_GAP, heeds_closures_within, stops_within};
use consort_bus::{Sample, Stream};
use consort_fleet::robot_driver::DriverState;
use consort_protocol::codec;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::pose::Pose;
use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

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
    /// Time of the world in seconds.
    time_s: f64,
}

/// The log. Clones share the same states.
#[derive(Debug, Clone, Default)]
pub struct BodyLog(Arc<Mutex<Vec<BodyState>>>);

impl BodyLog {
    /// Records published states of driver servers until the stream ends.
    pub async fn record(self, mut states: Stream<Sample>) {
        while let Some(sample) = states.recv().await {
            if let Ok(DriverState { robot, telemetry, .. }) = codec::decode::<DriverState>(&sample.payload) {
                let time_s = telemetry.time.as_secs();
                self.add(BodyState { at: Instant::now(), robot, pose: telemetry.pose, place: telemetry.place, time_s });
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

    /// Checks that a robot stands still in a period in which it has to: from the time at which it is bound by a hold or
    /// an alarm to the order that ends it. Returns the number of checked states.
    ///
    /// # Errors
    /// Description of the first movement.
    pub fn check_still(&self, robot: &RobotId, period: &Range<Instant>, lease: Duration) -> Result<usize, String> {
        let segments = self.segments(robot, period, stops_within(lease) + STATE_GAP);
        for segment in &segments {
            for pair in segment.windows(2) {
                let moved_m = pair[0].pose.distance(pair[1].pose).get();
                if moved_m > AT_REST_M {
                    let after_s = (pair[1].at - period.start).as_secs_f64();
                    return Err(format!("{robot} moved by {moved_m:.2} m, {after_s:.1} s after it had to stand still"));
                }
            }
        }
        Ok(segments.iter().map(Vec::len).sum())
    }

    /// Checks that a robot does not enter places while they are closed: from the time at which it is bound by the closure
    /// to the order that opens them. It may leave one of them through another, and so also a place of `others`: those that
    /// other orders may have closed. Returns the number of checked states.
    ///
    /// # Errors
    /// Description of the first entry.
    pub fn check_closed(
        &self,
        robot: &RobotId,
        (places, others): (&BTreeSet<PlaceId>, &BTreeSet<PlaceId>),
        closed: &Range<Instant>,
        lease: Duration,
    ) -> Result<usize, String> {
        let segments = self.segments(robot, closed, heeds_closures_within(lease) + STATE_GAP);
        let is_closed = |place: &PlaceId| places.contains(place) || others.contains(place);
        let enters = |pair: &&[BodyState]| !is_closed(&pair[0].place) && places.contains(&pair[1].place);
        for segment in &segments {
            if let Some(pair) = segment.windows(2).find(enters) {
                let (place, closed_s) = (&pair[1].place, (pair[1].at - closed.start).as_secs_f64());
                return Err(format!("{robot} entered {place}, {closed_s:.1} s after it was closed"));
            }
        }
        Ok(segments.iter().map(Vec::len).sum())
    }

    /// Checks the speed of a robot that has last passed a place with a speed limit, which holds on every lane from
    /// there: from the time at which the robot is bound by the limit to the order that clears it. Returns the number of
    /// checked pairs of states. Where a robot drives to is not known, so the lanes to the place are not checked.
    ///
    /// # Errors
    /// Description of the first speed above the limit.
    pub fn check_limited(
        &self,
        robot: &RobotId,
        (place, limit_mps): (&PlaceId, f64),
        limited: &Range<Instant>,
        lease: Duration,
    ) -> Result<usize, String> {
        let segments = self.segments(robot, limited, heeds_closures_within(lease) + STATE_GAP);
        let pairs = segments.iter().flat_map(|segment| segment.windows(2));
        let mut checked = 0;
        for pair in pairs.filter(|pair| pair.iter().all(|state| state.place == *place)) {
            let time_s = pair[1].time_s - pair[0].time_s;
            if time_s <= 0.0 {
                continue;
            }
            let speed_mps = pair[0].pose.distance(pair[1].pose).get() / time_s;
            if speed_mps > limit_mps + SPEED_TOLERANCE_MPS {
                let after_s = (pair[1].at - limited.start).as_secs_f64();
                return Err(format!(
                    "{robot} drove from {place} at {speed_mps:.2} m/s, {after_s:.1} s after {limit_mps} m/s were allowed"
                ));
            }
            checked += 1;
        }
        Ok(checked)
    }

    /// Returns the states of a robot in a period, without those in the time `within` after its start and after each
    /// interruption.
    fn segments(&self, robot: &RobotId, period: &Range<Instant>, within: Duration) -> Vec<Vec<BodyState>> {
        let log = self.lock();
        let (mut segments, mut from) = (vec![vec![]], period.start + within);
        let mut last: Option<Instant> = None;
        for state in log.iter().filter(|state| state.robot == *robot && state.at < period.end) {
            if last.is_none_or(|last| state.at - last > STATE_GAP) {
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
            // The world is twice as fast.
            let (at, time_s) = (start + seconds(at_s), 2.0 * at_s);
            log.add(BodyState { at, robot: slug("ada"), pose, place: slug(place), time_s });
        }
    }

    #[test]
    fn a_held_robot_that_moves_after_the_bound_is_found() {
        let (log, start, ada) = (BodyLog::default(), Instant::now(), slug::<RobotId>("ada"));
        // It drives until 8 s after the hold, and again from 30 s on.
        add(&log, start, 0..30, |at_s| at_s.min(18.0), "Dock");
        add(&log, start, 30..40, |at_s| at_s, "Dock");
        let held = |from_s, to_s| log.check_still(&ada, &(start + seconds(from_s)..start + seconds(to_s)), LEASE);
        assert_eq!(held(10.0, 30.0), Ok(23), "from 8.5 s after the hold");
        assert_eq!(held(9.0, 30.0), Err("ada moved by 0.50 m, 9.0 s after it had to stand still".to_owned()));
        let violation = held(10.0, 31.0).unwrap_err();
        assert_eq!(violation, "ada moved by 12.00 m, 20.0 s after it had to stand still");
    }

    #[test]
    fn after_an_interruption_a_robot_may_move_for_a_while() {
        let (log, start, ada) = (BodyLog::default(), Instant::now(), slug::<RobotId>("ada"));
        add(&log, start, 0..20, |_| 0.0, "Dock");
        add(&log, start, 25..60, |at_s| at_s.min(30.0), "Dock");
        let held = |to_s| log.check_still(&ada, &(start..start + seconds(to_s)), LEASE);
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
        let check_beside = |robot: &RobotId, places: &[&PlaceId], others: &[&PlaceId], from_s| {
            let [places, others] = [places, others].map(|places| places.iter().copied().cloned().collect());
            log.check_closed(robot, (&places, &others), &(start + seconds(from_s)..start + seconds(40.0)), LEASE)
        };
        let check = |robot: &RobotId, places: &[&PlaceId], from_s| check_beside(robot, places, &[], from_s);
        let violation = check(&ada, &[&ward], 0.0).unwrap_err();
        assert_eq!(violation, "ada entered Ward, 20.0 s after it was closed");
        assert!(check(&ada, &[&ward], 10.0).is_ok(), "it was on its way");
        assert!(check(&ada, &[&hall], 0.0).is_ok(), "it leaves a closed place");
        assert!(check(&ada, &[&hall, &ward], 0.0).is_ok(), "it leaves a closed place through another");
        assert!(
            check_beside(&ada, &[&ward], &[&hall], 0.0).is_ok(),
            "another order has closed the place that it leaves"
        );
        assert!(check_beside(&ada, &[&ward], &[&ward], 0.0).is_err());
        assert!(check(&slug("bob"), &[&ward], 0.0).is_ok());
    }

    #[test]
    fn a_robot_that_exceeds_a_limit_after_the_bound_is_found() {
        let (log, start, ada, ward) = (BodyLog::default(), Instant::now(), slug("ada"), slug::<PlaceId>("Ward"));
        // It drives at 0.6 m/s, and from 15 s on at 0.3 m/s.
        let x_m = |at_s: f64| 1.2 * at_s.min(15.0) + 0.6 * (at_s - 15.0).max(0.0);
        add(&log, start, 0..30, x_m, "Ward");
        add(&log, start, 30..40, |at_s| 1.2 * at_s, "Hall");
        let check = |limit_mps, from_s| {
            log.check_limited(&ada, (&ward, limit_mps), &(start + seconds(from_s)..start + seconds(40.0)), LEASE)
        };
        assert_eq!(check(0.3, 4.0), Ok(27), "states from 16 s to 29.5 s");
        let violation = check(0.3, 1.0).unwrap_err();
        assert_eq!(violation, "ada drove from Ward at 0.60 m/s, 12.5 s after 0.3 m/s were allowed");
        assert!(check(0.2, 4.0).is_err());
        assert!(check(0.6, 1.0).is_ok());
    }
}
