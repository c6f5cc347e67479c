//! Longest times until robots in a role follow the orders of people, by the duration of a lease.

use consort_fleet::robot_driver::CLIENT_TIMEOUT;
use consort_protocol::lease::LEASE_REACTION;
use std::time::Duration;

/// Time for messages on their way, and for a former coordinator that renews leases until it steps down.
const DELIVERY: Duration = Duration::from_secs(2);

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
