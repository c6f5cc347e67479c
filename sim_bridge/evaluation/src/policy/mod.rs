//! Assignment of roles to robots, by four policies. The policy `consort` is
//! [`consort_protocol::auction::optimal_assignment`]; this module contains the policies that it is
//! compared with, as calculations on bids.

mod allocators;
mod greedy;
mod optimal;
mod random;

pub use allocators::{GreedyAllocator, OracleAllocator, RandomAllocator};
use greedy::greedy;
pub use optimal::SuccessEstimate;
use optimal::optimal;
use random::random;

use consort_protocol::ids::{RobotId, RoleId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// The robot of each role; a robot has at most a single role.
pub(crate) type Coalition = BTreeMap<RoleId, RobotId>;

/// A rule that assigns roles to robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Policy {
    /// The policy of this project.
    Consort,
    /// The rule of the thesis: greedy per role, with the coordinator's estimates.
    MissionControl,
    /// The baseline of the thesis: a random robot, with or without the required skills.
    Random,
    /// An oracle with the success probability of each robot.
    Optimal,
}

impl Policy {
    /// All policies.
    pub const ALL: [Policy; 4] = [Policy::Consort, Policy::MissionControl, Policy::Random, Policy::Optimal];

    /// Returns the name used in files.
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
