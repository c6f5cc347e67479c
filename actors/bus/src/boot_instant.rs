//! Instants that count the time in which the machine was suspended.
//!
//! While a machine is suspended, tokio's clock stands still (`CLOCK_MONOTONIC`), but the other
//! machines of the fleet continue: a lease or a leadership would seem valid long after it has
//! expired. The boot clock of the machine (`CLOCK_BOOTTIME`) does not stop.

use rustix::time::{ClockId, clock_gettime};
use std::ops::{Add, Sub};
use std::sync::OnceLock;
use std::time::Duration;
use tokio::time::Instant;

/// Shortest time of suspension that is noticed. The two clocks cannot be read at the same moment, so
/// they always seem to differ a little.
const NOTICED_MIN: Duration = Duration::from_millis(100);

/// Returns the time for which the machine was suspended since the first call in this process.
pub fn suspended() -> Duration {
    static AHEAD_AT_START: OnceLock<Duration> = OnceLock::new();
    let ahead = boot_clock_ahead();
    noticed(ahead.saturating_sub(*AHEAD_AT_START.get_or_init(|| ahead)))
}

fn noticed(ahead: Duration) -> Duration {
    if ahead < NOTICED_MIN { Duration::ZERO } else { ahead }
}

/// Returns the time by which the boot clock is ahead of the monotonic clock.
fn boot_clock_ahead() -> Duration {
    // On systems other than Linux the monotonic clock continues while the machine is suspended.
    #[cfg(target_os = "linux")]
    const BOOT: ClockId = ClockId::Boottime;
    #[cfg(not(target_os = "linux"))]
    const BOOT: ClockId = ClockId::Monotonic;
    let read = |clock| Duration::try_from(clock_gettime(clock)).unwrap_or_default();
    let monotonic = read(ClockId::Monotonic);
    read(BOOT).saturating_sub(monotonic)
}

/// Instant of the machine's boot clock. On paused time it follows tokio's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct BootInstant(Instant);

impl BootInstant {
    /// Returns the current instant.
    pub fn now() -> BootInstant {
        BootInstant(Instant::now() + suspended())
    }

    /// Returns the time since this instant; 0 if it is in the future.
    pub fn elapsed(&self) -> Duration {
        BootInstant::now() - *self
    }

    /// Returns the instant of tokio's clock at which this instant is reached, unless the machine is
    /// suspended until then.
    pub fn to_tokio(self) -> Instant {
        // A past instant may lie before the start of tokio's clock.
        self.0.checked_sub(suspended()).unwrap_or_else(Instant::now)
    }
}

impl Add<Duration> for BootInstant {
    type Output = BootInstant;

    fn add(self, time: Duration) -> BootInstant {
        BootInstant(self.0 + time)
    }
}

impl Sub for BootInstant {
    type Output = Duration;

    /// Returns the time since `earlier`; 0 if it is later.
    fn sub(self, earlier: BootInstant) -> Duration {
        self.0.saturating_duration_since(earlier.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_real_suspension_is_noticed() {
        assert_eq!(noticed(Duration::from_millis(99)), Duration::ZERO);
        assert_eq!(noticed(Duration::from_millis(4_100)), Duration::from_millis(4_100));
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn instants_follow_paused_time() {
        let started = BootInstant::now();
        assert_eq!(started.elapsed(), Duration::ZERO);
        tokio::time::advance(Duration::from_secs(4)).await;
        assert_eq!((started + Duration::from_secs(4)).to_tokio(), Instant::now());
        assert_eq!((started.elapsed(), started - BootInstant::now()), (Duration::from_secs(4), Duration::ZERO));
    }
}
