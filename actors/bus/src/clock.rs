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
    /// Period in which the uptime stands still, as times since the start; empty, except in mutation checks.
    stopped: (Duration, Duration),
}

#[derive(Debug, Clone, Copy)]
enum WallClock {
    /// That of the machine.
    Machine,
    /// The date at the start of the clock, in milliseconds since 1970, and a period in which the date is
    /// wrong.
    StartedAt(u64, Option<ClockError>),
}

/// Error of the date in a period.
#[derive(Debug, Clone, Copy)]
struct ClockError {
    from: BootInstant,
    until: BootInstant,
    ahead_ms: i64,
}

impl Clock {
    /// Creates the clock of a node on a real machine.
    pub fn real() -> Clock {
        Clock::starting(WallClock::Machine)
    }

    /// Creates a clock with a fixed date at its start, in milliseconds since 1970, so that a run
    /// repeats exactly.
    pub fn virtual_at(origin_ms: u64) -> Clock {
        Clock::starting(WallClock::StartedAt(origin_ms, None))
    }

    fn starting(wall: WallClock) -> Clock {
        Clock { start: BootInstant::now(), wall, rate: 1.0, stopped: (Duration::ZERO, Duration::ZERO) }
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

    /// Returns the same virtual clock with a date that is ahead in a period, by a number of milliseconds
    /// that may be negative. The uptime is right.
    #[must_use]
    pub fn with_wrong_date(self, from: BootInstant, until: BootInstant, ahead_ms: i64) -> Clock {
        match self.wall {
            WallClock::Machine => self,
            WallClock::StartedAt(origin_ms, _) => {
                let error = ClockError { from, until, ahead_ms };
                Clock { wall: WallClock::StartedAt(origin_ms, Some(error)), ..self }
            }
        }
    }

    /// Returns the same clock with an uptime that stands still in a period, like a clock that does not
    /// count the suspension of its machine.
    #[must_use]
    pub fn stopped(self, from: BootInstant, until: BootInstant) -> Clock {
        Clock { stopped: (from - self.start, until - self.start), ..self }
    }

    /// Returns the node's uptime.
    pub fn now(&self) -> NodeTime {
        let elapsed = self.start.elapsed();
        let (from, until) = self.stopped;
        let elapsed = elapsed - elapsed.min(until).saturating_sub(from);
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
            WallClock::StartedAt(origin_ms, error) => {
                let (date_ms, now) = (origin_ms.saturating_add(self.now().as_millis()), BootInstant::now());
                let error = error.filter(|error| (error.from..error.until).contains(&now));
                date_ms.saturating_add_signed(error.map_or(0, |error| error.ahead_ms))
            }
        }
    }

    /// Returns the date and time as the time since 1970.
    pub(crate) fn unix_time(&self) -> Duration {
        Duration::from_millis(self.wall_ms())
    }

    /// Returns the instant of tokio's clock at which this clock reads `at`.
    pub fn instant(&self, at: NodeTime) -> Instant {
        let since = at.since(NodeTime::ZERO);
        let since = if self.rate == 1.0 { since } else { since.div_f64(self.rate) };
        let (from, until) = self.stopped;
        (self.start + since + if since > from { until.saturating_sub(from) } else { Duration::ZERO }).to_tokio()
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
    async fn a_wrong_date_leaves_the_uptime_right() {
        let (start, second) = (BootInstant::now(), Duration::from_secs(1));
        let clock = Clock::virtual_at(60_000).with_wrong_date(start + second, start + 2 * second, -30_000);
        tokio::time::advance(second).await;
        assert_eq!((clock.now().as_millis(), clock.wall_ms()), (1_000, 31_000));
        tokio::time::advance(second).await;
        assert_eq!((clock.now().as_millis(), clock.wall_ms()), (2_000, 62_000));
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_stopped_clock_does_not_count_a_period() {
        let (start, second) = (BootInstant::now(), Duration::from_secs(1));
        let clock = Clock::virtual_at(0).stopped(start + second, start + 4 * second);
        tokio::time::advance(3 * second).await;
        assert_eq!(clock.now().as_millis(), 1_000);
        tokio::time::advance(2 * second).await;
        assert_eq!(clock.now().as_millis(), 2_000);
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
