//! Model check of leases: two robots, one role, two coordinators, in every order of events.
//!
//! The model executes the state machines of production: [`RoleLease`](consort_protocol::lease::RoleLease),
//! the decisions of a leader session, the ledger, and both sides of a robot driver. The model itself
//! contains only what is around them: the clocks, the network, elections, disks and faults.
//!
//! ```text
//!  coordinator A, B ── award notice ──▶ robot 1, 2 ── command ──▶ driver server 1, 2: the body acts
//!                   ◀── report ───────             ◀── state ───
//!                   ── reply ────────▶
//! ```
//!
//! Time is counted in ticks of 1 s with the default terms: the lease is 4 ticks, the grace 2, the
//! client timeout 3. The reaction of a body (0.6 s) and the drift of clocks count as 1 tick, the half
//! of the grace. A goal that stops slowly needs a further tick, by which its permission ends before the
//! lease. A tick takes no time for its events, so a node acts at any tick or not at all: a pause of any
//! length is a sequence of ticks without an event of that node. States that differ only in the time are
//! the same state, so time is not bounded.
//!
//! A suspended machine is that of a robot's node: the node does nothing, its clock (`CLOCK_BOOTTIME`)
//! continues, and so do its driver server and the body.
//!
//! # Coverage
//!
//! With the events of both robots and all faults, the model has millions of states, most of which differ
//! only in the second robot. The robots share the ledger and the sessions of the coordinators, which
//! decide about each award by its epoch. So two kinds of checks cover all faults together:
//!
//! - Only the first robot has events, and suffers from all faults at once: a restart, a suspension,
//!   takeovers, late states, lost commands. The second robot counts as acting from its award on, which
//!   is earlier than it can act: the body of the first robot must rest at that award and afterwards.
//! - Both robots have events, and the first suffers from a restart, late states, or a suspension,
//!   each with takeovers. These checks find events of a robot that change the lease of the other.

mod check;
mod flaw;
mod key;
mod robot;
mod world;

use consort_protocol::units::NodeTime;
use std::time::Duration;

/// A number of ticks.
const fn ticks(count: u64) -> Duration {
    Duration::from_secs(count)
}

/// Time of a tick by a clock that started `base` ticks before.
fn clock(base: u64, tick: u64) -> NodeTime {
    NodeTime::at(ticks(base + tick))
}

/// First tick. The driver servers have sent states before.
const FIRST_TICK: u64 = 20;

/// Ticks from the end of a permission until the body is at rest.
const REACTION: u64 = 1;

/// Time from the cancel of a goal that stops slowly until its body is at rest: with the lateness of the
/// stop and the drift of clocks a tick more than [`REACTION`].
const SLOW_CANCEL: Duration = Duration::from_millis(1_500);
