//! Rate limit of a driver's lines: a token bucket.

use std::time::Duration;

/// Lines per second that a driver may send for long. A driver that reports pose and feedback at 20
/// Hz needs 40. Raised: a flood takes more of the node's time.
const LINES_PER_S: f64 = 200.0;

/// Lines that a driver may send at once.
const BURST: f64 = 400.0;

/// Token bucket, as a value: time is passed in, as the time since its creation.
#[derive(Debug, Clone)]
pub(crate) struct Throttle {
    tokens: f64,
    updated: Duration,
}

impl Throttle {
    /// Creates a full bucket.
    pub(crate) fn new() -> Throttle {
        Throttle { tokens: BURST, updated: Duration::ZERO }
    }

    /// Takes a token for a line. Returns the time for which the next line must wait.
    pub(crate) fn take(&mut self, now: Duration) -> Duration {
        let elapsed = now.saturating_sub(self.updated).as_secs_f64();
        self.tokens = (self.tokens + elapsed * LINES_PER_S).min(BURST) - 1.0;
        self.updated = now.max(self.updated);
        Duration::from_secs_f64((-self.tokens).max(0.0) / LINES_PER_S)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_passes_and_a_flood_is_slowed_to_the_rate() {
        let mut throttle = Throttle::new();
        let waits: Vec<Duration> = (0..410).map(|_| throttle.take(Duration::ZERO)).collect();
        assert!(waits[..400].iter().all(Duration::is_zero));
        assert_eq!(waits[409], Duration::from_millis(50), "10 lines at 200 a second");
        assert!(throttle.take(Duration::from_secs(1)).is_zero(), "the bucket fills again");
    }
}
