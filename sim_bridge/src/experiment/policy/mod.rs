//! Who gets which role, by four rules. `consort` itself is [`consort_protocol::auction::select`]; here are those it is
//! compared with, as arithmetic on bids.

mod allocators;
mod greedy;
mod optimal;
mod random;

pub use allocators::{GreedyAllocator, OracleAllocator, RandomAllocator};
pub use greedy::greedy;
pub use optimal::{SuccessEstimate, optimal};
pub use random::random;

use consort_protocol::ids::{RobotId, RoleId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Who holds which role; a robot holds one at most.
pub type Coalition = BTreeMap<RoleId, RobotId>;

/// A rule by which roles are given to robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Policy {
    /// Ours.
    Consort,
    /// The thesis' rule: greedy per role, on the coordinator's estimates.
    MissionControl,
    /// The thesis' baseline: anybody, whether or not they can.
    Random,
    /// An oracle that knows how likely each robot is to succeed.
    Optimal,
}

impl Policy {
    /// All of them.
    pub const ALL: [Policy; 4] = [Policy::Consort, Policy::MissionControl, Policy::Random, Policy::Optimal];

    /// As in files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Policy::Consort => "consort",
            Policy::MissionControl => "mission-control",
            Policy::Random => "random",
            Policy::Optimal => "optimal",
        }
    }
}

impl fmt::Display for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
