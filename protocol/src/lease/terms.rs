//! Duration of leases, and the bound on clock drift that it allows.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Longest time from the instant at which a driver server has to stop a robot until the order to
/// stop has reached its body: the delay of a timer, and the control period of the driver (50 ms for
/// a robot under Nav2).
pub(super) const STOP_LATENESS: Duration = Duration::from_millis(100);

/// Longest time in which a body comes to rest after the order to stop, for an action that declares no
/// longer time. A guess, which every robot of a fleet must meet: 0.5 m at 2 m/s. A robot that needs
/// longer needs a driver that limits its speed. The 3 s after which a driver that does not end a canceled
/// goal is killed are no such declaration: the body must rest within this time.
pub(super) const STOPPING_TIME: Duration = Duration::from_millis(500);

/// Longest time from the end of a lease until the robot is at rest. The client timeout of driver
/// servers is not part of it: a command carries the [time](super::keep_for) for which it may be
/// acted on, which ends with the lease.
pub const LEASE_REACTION: Duration = STOP_LATENESS.saturating_add(STOPPING_TIME);

/// Time after the renewal of a lease in which the next command of the robot's node reaches its driver:
/// the interval at which the robot checks its lease, that of commands, and the delay of replies.
const RENEWAL_LATENESS: Duration = Duration::from_secs(1);

/// Returns the time by which the permission of a goal ends before the lease, if the body may need
/// `cancel_within` from the cancel of the goal until it is at rest: the part of this time that
/// [`LEASE_REACTION`] does not cover. So a body that stops slowly is at rest as early as all others.
pub fn stop_lead(cancel_within: Duration) -> Duration {
    cancel_within.saturating_sub(STOPPING_TIME)
}

/// Largest relative difference between the rates of two clocks of a fleet. Quartz clocks differ by
/// less than 0.01 %, and time synchronisation adds at most 0.05 %.
pub const CLOCK_DRIFT_MAX: f64 = 0.01;

/// Duration of a lease without contact. Fleet-wide: all nodes must use the same values.
///
/// # Clocks
///
/// Leases are measured by each node's monotonic clock. Clocks need not agree on the time. They may
/// even run at different rates, within a bound ([`drift_max`](LeaseTerms::drift_max)). Let the
/// fastest clock of the fleet count `1 + d` seconds while the slowest counts 1 second, and measure
/// all times below in seconds of the slowest clock. That is the worst case for the clocks of the
/// robot, of its driver server and of the first coordinator. `L` is the lease, `G` the grace, and
/// `r` the robot's [reaction](LEASE_REACTION).
///
/// - The robot sends a report at `s`. If the report is answered and no later report is, no command
///   lets its driver server act after `s + L`, whatever happens to the robot's node and to the links
///   (derived in [`keep_for`](super::keep_for)). The body is at rest by `s + L + r`. A goal whose
///   cancel may take longer is stopped [earlier](stop_lead) by the difference.
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
///                                         or           G >= 2 (L d + r (1 + d)) / (1 - d)
/// ```
///
/// With the defaults and a reaction of 0.6 s this allows a drift of 7 %. A coordinator that stays
/// leader counts from `a`, which allows `d <= (G - r) / (L + r)`: 30 %. A fleet must allow at least
/// [`CLOCK_DRIFT_MAX`]; a configuration whose grace is below [`grace_min`](LeaseTerms::grace_min) is
/// refused.
///
/// The driver server and the body are assumed to work: a driver server that is killed or paused while
/// its robot moves must be backed by a dead-man switch of the robot itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseTerms {
    /// The robot suspends this long after it sent the last report that was answered. Raised: the
    /// robot keeps moving through longer blackouts, but lost robots are replaced later. Default 4
    /// s: several times the duration of a takeover.
    pub lease: Duration,
    /// Additional wait of the coordinator. It covers the reaction of the robot, clock drift, and the
    /// maximum age of the coordinator's last contact with a quorum. Default 2 s.
    pub grace: Duration,
}

impl Default for LeaseTerms {
    fn default() -> Self {
        LeaseTerms { lease: Duration::from_secs(4), grace: Duration::from_secs(2) }
    }
}

impl LeaseTerms {
    /// Returns the smallest grace with which a lease is safe at a drift of [`CLOCK_DRIFT_MAX`] and
    /// the [reaction](LEASE_REACTION) of robots: the derivation above, solved for `G` and rounded up
    /// to milliseconds.
    pub fn grace_min(lease: Duration) -> Duration {
        let (lease, reaction) = (lease.as_secs_f64(), LEASE_REACTION.as_secs_f64());
        let half = (reaction + CLOCK_DRIFT_MAX * (lease + reaction)) / (1.0 - CLOCK_DRIFT_MAX);
        Duration::from_millis((2.0 * half * 1e3).ceil() as u64)
    }

    /// Returns the longest time that a body may need from the cancel of a goal until it is at rest. The
    /// permission of such a goal ends [before the lease](stop_lead). What is left must outlast a lost
    /// report: two times a quarter of the lease. Otherwise the goal would be stopped although the
    /// coordinator renews the lease.
    pub fn cancel_within_max(lease: Duration) -> Duration {
        STOPPING_TIME + (lease / 2).saturating_sub(RENEWAL_LATENESS)
    }

    /// Returns the smallest lease with which a body may need `cancel_within` from the cancel of a goal
    /// until it is at rest, rounded up to milliseconds: [`cancel_within_max`](LeaseTerms::cancel_within_max), solved
    /// for the lease.
    pub fn lease_min(cancel_within: Duration) -> Duration {
        match stop_lead(cancel_within) {
            Duration::ZERO => Duration::ZERO,
            lead => Duration::from_millis(((lead + RENEWAL_LATENESS).as_secs_f64() * 2e3).ceil() as u64),
        }
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
