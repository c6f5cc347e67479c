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
        Clock { start: Instant::now(), wall_origin_ms: origin_ms }
    }

    /// How long the node has been up.
    pub fn now(&self) -> NodeTime {
        NodeTime::at(self.start.elapsed())
    }

    /// Date and time to show to people, in milliseconds since 1970. A later correction of the machine's date is not
    /// followed: nothing may be decided by it.
    pub fn wall_ms(&self) -> u64 {
        self.wall_origin_ms.saturating_add(self.now().as_millis())
    }

    /// When, on tokio's clock, it will be `at` on this one.
    pub fn instant(&self, at: NodeTime) -> Instant {
        self.start + at.since(NodeTime::ZERO)
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
}
