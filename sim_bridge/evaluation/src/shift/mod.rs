//! A shift: many requests for a fleet, under policies that differ in what they know and when they decide.
//!
//! ```text
//!            ┌─ instantaneous, consort: the auctions of the fleet ──┐
//!  requests ─┼─ tessi: an insertion at each request ────────────────┼─▶ figures of each run ─▶ PolicyFigures
//!            └─ oracle: a plan for all requests, made beforehand ───┘
//! ```
//!
//! All policies run on the same fleet with the same requests and random numbers.

mod figures;
mod hindsight;
mod tessi;

pub use figures::{PolicyFigures, ShiftFigures, ShiftMetrics};
pub use hindsight::{ShiftJob, plan_in_hindsight};
pub use tessi::tessi_insertion;

use serde::Serialize;

/// Rule by which the missions of a shift get their carriers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ShiftPolicy {
    /// An instantaneous auction: a mission gets robots that are free, all at once.
    Instantaneous,
    /// TeSSI (Nunes and Gini, 2015): each request is inserted at once in the timeline of the carrier that ends first
    /// with it, and stays there.
    Tessi,
    /// The policy of this project: auctions with promised roles.
    Consort,
    /// Hindsight: a plan of all requests, made before the first ([`plan_in_hindsight`]).
    Oracle,
}

impl ShiftPolicy {
    /// All policies.
    pub const ALL: [ShiftPolicy; 4] =
        [ShiftPolicy::Instantaneous, ShiftPolicy::Tessi, ShiftPolicy::Consort, ShiftPolicy::Oracle];

    /// Returns the name.
    pub const fn as_str(self) -> &'static str {
        match self {
            ShiftPolicy::Instantaneous => "instantaneous",
            ShiftPolicy::Tessi => "tessi",
            ShiftPolicy::Consort => "consort",
            ShiftPolicy::Oracle => "oracle",
        }
    }
}
