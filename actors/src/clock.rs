//! A node's clock: how long it has been up, and what time people would say it is.
//!
//! Both follow tokio's clock, so that on paused time they advance with the simulation and with nothing else.

use consort_protocol::units::NodeTime;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::time::Instant;

/// The clock of one node, which starts when it is made. Made within a tokio runtime.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    start: Instant,
    wall_origin_ms: u64,
    /// Seconds that it counts in one second; 1 but for a clock that drifts.
    rate: f64,
}

impl Clock {
    /// The clock of a node on a real machine.
    pub fn real() -> Clock {
        // A machine whose date lies before 1970 shows 1970.
        let origin = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
        Clock::virtual_at(u64::try_from(origin.as_millis()).unwrap_or(u64::MAX))
    }

    /// The clock of a node that starts at a given date, in milliseconds since 1970, so that a run repeats to the letter.
    pub fn virtual_at(origin_ms: u64) -> Clock {
        Clock { start: Instant::now(), wall_origin_ms: origin_ms, rate: 1.0 }
    }

    /// The same clock, running fast or slow: it counts `rate` seconds in one. Readings, and instants made from them, drift
    /// with it; periods that are slept through (beats, time limits) do not. Leases and leadership are judged by readings.
    ///
    /// # Panics
    /// When the rate is not above zero: our own mistake.
    #[must_use]
    pub fn drifting(self, rate: f64) -> Clock {
        assert!(rate.is_finite() && rate > 0.0, "a clock runs forwards: {rate}");
        Clock { rate, ..self }
    }

    /// How long the node has been up.
    pub fn now(&self) -> NodeTime {
        let elapsed = self.start.elapsed();
        // A clock that does not drift is not rounded either.
        NodeTime::at(if self.rate == 1.0 { elapsed } else { elapsed.mul_f64(self.rate) })
    }

    /// Date and time to show to people, in milliseconds since 1970. A later correction of the machine's date is not
    /// followed: nothing may be decided by it.
    pub fn wall_ms(&self) -> u64 {
        self.wall_origin_ms.saturating_add(self.now().as_millis())
    }

    /// When, on tokio's clock, it will be `at` on this one.
    pub fn instant(&self, at: NodeTime) -> Instant {
        let since = at.since(NodeTime::ZERO);
        self.start + if self.rate == 1.0 { since } else { since.div_f64(self.rate) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_virtual_clock_advances_with_the_simulation_alone() {
        let clock = Clock::virtual_at(1_000);
        std::thread::sleep(Duration::from_millis(3));
        assert_eq!((clock.now(), clock.wall_ms()), (NodeTime::ZERO, 1_000));
        tokio::time::advance(Duration::from_millis(250)).await;
        assert_eq!((clock.now().as_millis(), clock.wall_ms()), (250, 1_250));
        assert_eq!(clock.instant(clock.now()), Instant::now());
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_clock_that_drifts_counts_more_or_less_and_knows_when_it_will_be() {
        let (fast, slow) = (Clock::virtual_at(0).drifting(1.25), Clock::virtual_at(0).drifting(0.75));
        tokio::time::advance(Duration::from_secs(4)).await;
        assert_eq!((fast.now().as_millis(), slow.now().as_millis()), (5_000, 3_000));
        assert_eq!(fast.instant(NodeTime::at(Duration::from_secs(10))), Instant::now() + Duration::from_secs(4));
    }
}
