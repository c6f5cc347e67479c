//! Time for which a driver server may act on a command.
//!
//! A command may be delayed for any time, so the time left when it is sent says nothing about the
//! time left when it arrives. A command therefore names the latest state of the driver server that
//! its sender has received, and carries the time for which the robot may act *after that state was
//! sent*:
//!
//! ```text
//! driver server  sends state n ────────────────── command arrives ─── stops: state n + keep_for
//! driver client      receives state n ── sends command ───────────────────── end of the lease
//!                    └───────────────────── keep_for ──────────────────────┘
//! ```
//!
//! The state was sent before it was received. So the robot stops before its lease has ended, by as
//! much as the state was delayed, and a command that arrives after that time has no effect. No bound
//! on the delay of messages is needed. The same holds for a node that is paused between its check of
//! the lease and its command.

use crate::units::NodeTime;
use std::time::Duration;

/// Returns the time after the sending of a state for which the robot may act, by the clock of the
/// driver client; `None` if it may not act. The robot may act until `allowed_until`, and for at most
/// `client_timeout` without a further command. The state was received at `received`.
pub fn keep_for(
    allowed_until: NodeTime,
    client_timeout: Duration,
    received: NodeTime,
    now: NodeTime,
) -> Option<Duration> {
    let until = allowed_until.min(now + client_timeout);
    (until > now).then(|| until.since(received))
}

/// Returns the instant at which a driver server must stop the robot, by its own clock, for a command
/// that arrives now; `None` if that instant has passed. The state that the command names was sent at
/// `state_sent`.
pub fn stop_at(keep_for: Duration, client_timeout: Duration, state_sent: NodeTime, now: NodeTime) -> Option<NodeTime> {
    let stop = (state_sent + keep_for).min(now + client_timeout);
    (stop > now).then_some(stop)
}
