//! Record of an auction, for display.

use super::bid::{AuctionId, BidPart, RefusalReason, ViabilityError};
use crate::ids::{RobotId, RoleId};
use crate::units::Seconds;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Replies and decision of an auction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuctionRecord {
    /// Round of the auction.
    pub auction: AuctionId,
    /// Time on the coordinator's wall clock, in milliseconds, for display.
    pub at_ms: u64,
    /// All replies, in the order of roles and robots.
    pub entries: Vec<AuctionEntry>,
    /// Number of replies omitted to bound the size of the record.
    pub omitted: u32,
    /// Robot chosen for each role.
    pub chosen: BTreeMap<RoleId, RobotId>,
    /// Reason, if no roles were assigned.
    pub failure: Option<String>,
}

impl AuctionRecord {
    /// Maximum number of replies in a record.
    pub(super) const ENTRIES_MAX: usize = 256;

    /// Approximate maximum size of the parts of all bids in a record, in bytes: the ledger stores a
    /// record for each mission. Enough for about ten bids of a dozen steps.
    pub(super) const PARTS_BYTES_MAX: usize = 8 * 1024;
}

/// Reply of a robot for a role, with its verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuctionEntry {
    /// Role.
    pub role: RoleId,
    /// Robot that replied.
    pub robot: RobotId,
    /// Verdict on the reply.
    pub verdict: BidVerdict,
    /// Cost of each step of the bid. Empty if there is no bid or no room for it: the winners' parts
    /// are kept first, then those of the fastest bids.
    #[serde(default)]
    pub parts: Vec<BidPart>,
}

/// Verdict on a robot's reply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BidVerdict {
    /// The bid is within the limits.
    Viable {
        /// Time for the plan.
        time: Seconds,
        /// Charge used, as a share.
        energy: f64,
        /// Charge left, as a share.
        remaining: f64,
    },
    /// The bid is outside the limits.
    Unviable {
        /// Time for the plan.
        time: Seconds,
        /// Charge used, as a share.
        energy: f64,
        /// Charge left, as a share.
        remaining: f64,
        /// Limit that is violated.
        why: ViabilityError,
    },
    /// The robot refused.
    Refused {
        /// Reason of the refusal.
        reason: RefusalReason,
    },
}
