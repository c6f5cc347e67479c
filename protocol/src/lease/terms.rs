//! Duration of leases, and the bound on clock drift that it allows.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Duration of a lease without contact. Fleet-wide: all nodes must use the same values.
///
/// # Clocks
///
/// Leases are measured by each node's monotonic clock. Clocks need not agree on the time. They may
/// even run at different rates, within a bound ([`drift_max`](LeaseTerms::drift_max)). Let the
/// fastest clock of the fleet count `1 + d` seconds while the slowest counts 1 second, and measure
/// all times below in seconds of the slowest clock. That is the worst case for the clocks of the
/// robot and of the first coordinator. `L` is the lease, `G` the grace, and `r` the robot's
/// reaction: the time from the end of its lease until it has come to rest (its control period and
/// its stopping time).
///
/// - The robot sends a report at `s`. If the report is answered and no later report is, the robot
///   is at rest by `s + L + r`.
/// - The coordinator replies at `a`, and `a >= s`. A majority had followed it at most `G / 2`
///   before.
/// - A later coordinator was elected by a majority. At least one node of that majority had followed
///   the first coordinator at that moment, and voted afterwards. So the later coordinator takes
///   over no earlier than `a - G / 2`, and counts from then on. On the fastest clock it has counted
///   `L + G` after `(L + G) / (1 + d)`. It releases the role no earlier than
///   `a - G / 2 + (L + G) / (1 + d)`.
///
/// No other robot acts in the role before this robot is at rest if, in the worst case `s = a`,
///
/// ```text
/// L + r <= (L + G) / (1 + d) - G / 2      that is      d <= (G / 2 - r) / (L + G / 2 + r)
/// ```
///
/// With the defaults and a reaction of 0.5 s this is 9 %; real clocks differ by less than 0.1 %. A
/// coordinator that stays leader counts from `a`, which allows `d <= (G - r) / (L + r)`: 33 %.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseTerms {
    /// The robot suspends this long after it sent the last report that was answered. Raised: the
    /// robot keeps moving through longer blackouts, but lost robots are replaced later. Default 4
    /// s: several times the duration of a takeover.
    pub lease: Duration,
    /// Additional wait of the coordinator. It covers clock drift and the maximum age of the
    /// coordinator's last contact with a quorum. Default 2 s.
    pub grace: Duration,
}

impl Default for LeaseTerms {
    fn default() -> Self {
        LeaseTerms { lease: Duration::from_secs(4), grace: Duration::from_secs(2) }
    }
}

/// Longest time from the end of a lease until a robot whose node runs is at rest: the interval of
/// its lease checks, 250 ms, and as much for the stop to reach the driver and to take effect.
pub const LEASE_REACTION: Duration = Duration::from_millis(500);

/// Relative clock drift at which configured leases must be safe. Real clocks differ by less than a
/// tenth of it.
const DRIFT_REQUIRED: f64 = 0.01;

impl LeaseTerms {
    /// Returns the smallest grace with which a lease is safe at a drift of 1 % and the
    /// [reaction](LEASE_REACTION) of robots: the derivation above, solved for `G` and rounded up to
    /// milliseconds.
    pub fn grace_min(lease: Duration) -> Duration {
        let (lease, reaction) = (lease.as_secs_f64(), LEASE_REACTION.as_secs_f64());
        let half = (reaction + DRIFT_REQUIRED * (lease + reaction)) / (1.0 - DRIFT_REQUIRED);
        Duration::from_millis((2.0 * half * 1e3).ceil() as u64)
    }

    /// Returns the largest relative clock drift between the slowest and the fastest clock at which
    /// leases are safe; see the derivation above. `reaction` is the time from the end of a lease
    /// until the robot is at rest. Returns 0 if the grace does not even cover the reaction.
    pub fn drift_max(&self, reaction: Duration) -> f64 {
        let (lease, half, reaction) =
            (self.lease.as_secs_f64(), self.grace.as_secs_f64() / 2.0, reaction.as_secs_f64());
        ((half - reaction) / (lease + half + reaction)).max(0.0)
    }

    /// Returns the maximum age of a coordinator's last contact with a quorum for it to renew
    /// leases: half the grace. The other half is for drift.
    pub fn leadership_age_max(&self) -> Duration {
        self.grace / 2
    }
}
