//! How much a coordinator takes on at once, of all that is asked of the fleet.

use consort_protocol::units::NodeTime;
use governor::clock::{Clock as _, FakeRelativeClock};
use governor::middleware::NoOpMiddleware;
use governor::nanos::Nanos;
use governor::state::{InMemoryState, NotKeyed};
use governor::{Quota, RateLimiter};
use std::num::NonZeroU32;
use std::time::Duration;

/// How many requests may come at once, in seconds' worth of the steady rate.
const BURST_S: NonZeroU32 = NonZeroU32::new(5).unwrap();

/// What a fleet takes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RequestLimits {
    /// Missions under way at once; 0 for no limit. More: longer queues are kept in the ledger, and looked through at each auction.
    pub missions_max: usize,
    /// Requests in a second, in the long run, with five times as many at once; 0 for no limit. More: whoever asks without end
    /// has more of the coordinator's time.
    pub requests_per_s: u32,
}

impl Default for RequestLimits {
    /// 1000 missions, 200 requests in a second.
    fn default() -> Self {
        RequestLimits { missions_max: 1000, requests_per_s: 200 }
    }
}

type Limiter = RateLimiter<NotKeyed, InMemoryState, FakeRelativeClock, NoOpMiddleware<Nanos>>;

/// Counts requests, by the node's clock.
pub(super) struct RequestLimiter {
    /// The clock of the limiter, and what it shows. None if there is no limit.
    limiter: Option<(Limiter, FakeRelativeClock)>,
    now: NodeTime,
}

impl RequestLimiter {
    pub(super) fn new(limits: RequestLimits, now: NodeTime) -> RequestLimiter {
        let limiter = NonZeroU32::new(limits.requests_per_s).map(|steady| {
            let clock = FakeRelativeClock::default();
            let quota = Quota::per_second(steady).allow_burst(steady.saturating_mul(BURST_S));
            (RateLimiter::direct_with_clock(quota, clock.clone()), clock)
        });
        RequestLimiter { limiter, now }
    }

    /// Takes a request, or says after how long one would be taken.
    pub(super) fn try_acquire(&mut self, now: NodeTime) -> Result<(), Duration> {
        let Some((limiter, clock)) = &self.limiter else { return Ok(()) };
        clock.advance(now.since(self.now));
        self.now = now;
        limiter.check().map_err(|until| until.wait_time_from(clock.now()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> NodeTime {
        NodeTime::at(Duration::from_millis(ms))
    }

    #[test]
    fn a_steady_rate_and_a_burst_are_taken_and_no_more() {
        let limits = RequestLimits { requests_per_s: 10, ..RequestLimits::default() };
        let mut intake = RequestLimiter::new(limits, at(0));
        let taken = (0..100).filter(|_| intake.try_acquire(at(0)).is_ok()).count();
        assert_eq!(taken, 50);
        assert_eq!(intake.try_acquire(at(0)), Err(Duration::from_millis(100)));
        let taken = (1..=100).filter(|tenths| intake.try_acquire(at(100 * tenths)).is_ok()).count();
        assert_eq!(taken, 100, "ten in a second are taken for good");
        assert!(intake.try_acquire(at(10_000)).is_err());
    }

    #[test]
    fn without_a_limit_all_are_taken() {
        let mut intake = RequestLimiter::new(RequestLimits { missions_max: 0, requests_per_s: 0 }, at(0));
        assert!((0..10_000).all(|_| intake.try_acquire(at(0)).is_ok()));
    }
}
