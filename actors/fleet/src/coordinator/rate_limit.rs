//! Limits of requests: the number of requests and missions that a coordinator accepts, and the time that they may take.

use consort_protocol::units::NodeTime;
use governor::clock::{Clock as _, FakeRelativeClock};
use governor::middleware::NoOpMiddleware;
use governor::nanos::Nanos;
use governor::state::{InMemoryState, NotKeyed};
use governor::{Quota, RateLimiter};
use std::num::NonZeroU32;
use std::time::Duration;

/// Burst size, in seconds of the steady rate.
const BURST_S: NonZeroU32 = NonZeroU32::new(5).unwrap();

/// Limits of a fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RequestLimits {
    /// Maximum number of active missions; 0 for no limit. Raised: the ledger keeps longer queues,
    /// and each auction has to search them.
    pub missions_max: usize,
    /// Steady rate of requests per second, with bursts of 5 times as many; 0 for no limit. Raised:
    /// a client that sends requests without end uses more of the coordinator's time.
    pub requests_per_s: u32,
    /// Time to wait for an answer of people, in seconds, for tasks and questions that state none; `None` for no limit.
    /// Raised: robots wait for longer for an answer that does not come.
    pub patience_s: Option<u32>,
    /// Bound on the time of missions that state none; `None` for no bound. Raised: a mission that cannot go on keeps its
    /// robots for longer.
    pub time_limit: Option<Duration>,
}

impl Default for RequestLimits {
    /// 1000 missions, 200 requests per second, an hour for an answer, and no bound on the time of missions.
    fn default() -> Self {
        RequestLimits { missions_max: 1000, requests_per_s: 200, patience_s: Some(3600), time_limit: None }
    }
}

type Limiter = RateLimiter<NotKeyed, InMemoryState, FakeRelativeClock, NoOpMiddleware<Nanos>>;

/// Rate limiter of requests, on the node's clock.
pub(super) struct RequestLimiter {
    /// The limiter and its clock. `None` for no limit.
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

    /// Accepts a request, or returns the time until the next request would be accepted.
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
    fn the_limiter_accepts_a_steady_rate_and_a_burst() {
        let limits = RequestLimits { requests_per_s: 10, ..RequestLimits::default() };
        let mut limiter = RequestLimiter::new(limits, at(0));
        let taken = (0..100).filter(|_| limiter.try_acquire(at(0)).is_ok()).count();
        assert_eq!(taken, 50);
        assert_eq!(limiter.try_acquire(at(0)), Err(Duration::from_millis(100)));
        let taken = (1..=100).filter(|tenths| limiter.try_acquire(at(100 * tenths)).is_ok()).count();
        assert_eq!(taken, 100, "ten in a second are taken for good");
        assert!(limiter.try_acquire(at(10_000)).is_err());
    }

    #[test]
    fn without_a_limit_every_request_is_accepted() {
        let mut limiter = RequestLimiter::new(RequestLimits { requests_per_s: 0, ..RequestLimits::default() }, at(0));
        assert!((0..10_000).all(|_| limiter.try_acquire(at(0)).is_ok()));
    }
}
