//! Bounds of the checks of orders of people and of chargers, in chaos tests and in logs of real fleets. The longest times
//! until robots in a role follow orders depend on the duration of a lease.

use consort_fleet::robot_driver::CLIENT_TIMEOUT;
use consort_protocol::lease::LEASE_REACTION;
use std::time::Duration;

/// Time for messages on their way, and for a former coordinator that renews leases until it steps down.
const DELIVERY: Duration = Duration::from_secs(2);

/// Rounding of a measured speed, in metres per second.
pub(crate) const SPEED_TOLERANCE_MPS: f64 = 0.001;

/// Time for which the nodes of two robots must have been in contact, so that each has the claim of the other to a charger:
/// the least age of a claim on which a robot acts (2 s), and lost records.
pub(crate) const CHARGER_CONTACT: Duration = Duration::from_secs(10);

/// Longest time between two states of a body in a log without interruption, and for which a state may be on its way: three
/// times the interval of the driver server.
pub(crate) const STATE_GAP: Duration = Duration::from_millis(1_500);

/// Returns the longest duration of a period that lasts `time` by the clock of a robot: clocks differ by up to 10 %.
fn drifting(time: Duration) -> Duration {
    time + time / 10
}

/// Returns the longest time until a held robot is at rest. No command permits more than the lease from before the hold.
pub(crate) fn stops_within(lease: Duration) -> Duration {
    drifting(lease).max(CLIENT_TIMEOUT) + LEASE_REACTION + DELIVERY
}

/// Returns the longest time until a robot enters nothing that is closed. Each renewal of its lease contains the closure,
/// and its body may follow the latest command from before.
pub(crate) fn heeds_closures_within(lease: Duration) -> Duration {
    drifting(lease) + DELIVERY + drifting(CLIENT_TIMEOUT) + LEASE_REACTION
}
