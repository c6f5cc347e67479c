//! A node's clock: its uptime, and the date and time.
//!
//! The uptime follows the [boot clock](BootInstant) of the machine, and the date the machine's date,
//! with its corrections. In a simulation both follow tokio's clock, and advance with the simulation
//! only.

use crate::boot_instant::BootInstant;
use consort_protocol::units::NodeTime;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::time::Instant;

/// Clock of a node. It starts when it is created, within a tokio runtime.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    start: BootInstant,
    wall: WallClock,
    /// Seconds counted per second of tokio's clock: 1, except for a drifting clock.
    rate: f64,
}

#[derive(Debug, Clone, Copy)]
enum WallClock {
    /// That of the machine.
    Machine,
    /// The date at the start of the clock, in milliseconds since 1970.
    StartedAt(u64),
}

impl Clock {
    /// Creates the clock of a node on a real machine.
    pub fn real() -> Clock {
        Clock { start: BootInstant::now(), wall: WallClock::Machine, rate: 1.0 }
    }

    /// Creates a clock with a fixed date at its start, in milliseconds since 1970, so that a run
    /// repeats exactly.
    pub fn virtual_at(origin_ms: u64) -> Clock {
        Clock { start: BootInstant::now(), wall: WallClock::StartedAt(origin_ms), rate: 1.0 }
    }

    /// Returns the same clock, running fast or slow: it counts `rate` seconds per second. Readings,
    /// and instants computed from them, drift with it. Sleep periods (heartbeats, time limits) do
    /// not. Leases and leadership are decided by readings.
    ///
    /// # Panics
    /// If the rate is not finite or not above zero: an error of the caller.
    #[must_use]
    pub fn drifting(self, rate: f64) -> Clock {
        assert!(rate.is_finite() && rate > 0.0, "the rate of a clock must be finite and above zero, not {rate}");
        Clock { rate, ..self }
    }

    /// Returns the node's uptime.
    pub fn now(&self) -> NodeTime {
        let elapsed = self.start.elapsed();
        // Without drift the value is not rounded.
        NodeTime::at(if self.rate == 1.0 { elapsed } else { elapsed.mul_f64(self.rate) })
    }

    /// Returns the date and time, in milliseconds since 1970. It may jump in both directions, and may
    /// differ from that of other nodes.
    pub fn wall_ms(&self) -> u64 {
        match self.wall {
            // A date before 1970 counts as 1970.
            WallClock::Machine => {
                let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
                u64::try_from(since_1970.as_millis()).unwrap_or(u64::MAX)
            }
            WallClock::StartedAt(origin_ms) => origin_ms.saturating_add(self.now().as_millis()),
        }
    }

    /// Returns the date and time as the time since 1970.
    pub(crate) fn unix_time(&self) -> Duration {
        Duration::from_millis(self.wall_ms())
    }

    /// Returns the instant of tokio's clock at which this clock reads `at`.
    pub fn instant(&self, at: NodeTime) -> Instant {
        let since = at.since(NodeTime::ZERO);
        (self.start + if self.rate == 1.0 { since } else { since.div_f64(self.rate) }).to_tokio()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_virtual_clock_advances_only_with_the_simulation() {
        let clock = Clock::virtual_at(1_000);
        std::thread::sleep(Duration::from_millis(3));
        assert_eq!((clock.now(), clock.wall_ms()), (NodeTime::ZERO, 1_000));
        tokio::time::advance(Duration::from_millis(250)).await;
        assert_eq!((clock.now().as_millis(), clock.wall_ms()), (250, 1_250));
        assert_eq!(clock.instant(clock.now()), Instant::now());
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_drifting_clock_scales_its_readings_and_instants() {
        let (fast, slow) = (Clock::virtual_at(0).drifting(1.25), Clock::virtual_at(0).drifting(0.75));
        tokio::time::advance(Duration::from_secs(4)).await;
        assert_eq!((fast.now().as_millis(), slow.now().as_millis()), (5_000, 3_000));
        assert_eq!(fast.instant(NodeTime::at(Duration::from_secs(10))), Instant::now() + Duration::from_secs(4));
    }
}
