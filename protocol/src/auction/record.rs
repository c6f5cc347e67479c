//! What is kept of an auction, for people to look at.

use super::bid::{AuctionId, BidPart, RefusalReason, ViabilityError};
use crate::ids::{RobotId, RoleId};
use crate::units::Seconds;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What an auction heard and decided.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AuctionRecord {
    /// Which round.
    pub auction: AuctionId,
    /// When: milliseconds on the coordinator's wall clock, to show.
    pub at_ms: u64,
    /// Every answer, in the order of roles and robots.
    pub entries: Vec<AuctionEntry>,
    /// Answers left out because the record would have grown too large.
    pub omitted: u32,
    /// Who was chosen.
    pub chosen: BTreeMap<RoleId, RobotId>,
    /// Why nobody was, if so.
    pub failure: Option<String>,
}

impl AuctionRecord {
    /// Most answers that a record holds.
    pub const ENTRIES_MAX: usize = 256;

    /// Most bytes that the parts of all bids in a record take up, near enough: the ledger keeps a record for each mission.
    /// Some ten bids of a dozen steps.
    pub const PARTS_BYTES_MAX: usize = 8 * 1024;
}

/// One robot's answer for one role, judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AuctionEntry {
    /// For which role.
    pub role: RoleId,
    /// By whom.
    pub robot: RobotId,
    /// What came of it.
    pub verdict: BidVerdict,
    /// The bid step by step. Empty if there is none, or if the record has no room for it: the winners' come first, then those
    /// of the quickest.
    #[serde(default)]
    pub parts: Vec<BidPart>,
}

/// What came of a robot's answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BidVerdict {
    /// A bid that could be taken.
    Viable {
        /// Time for the plan.
        time: Seconds,
        /// Charge used, as a share.
        energy: f64,
        /// Charge left, as a share.
        remaining: f64,
    },
    /// A bid that could not.
    Unviable {
        /// Time for the plan.
        time: Seconds,
        /// Charge used, as a share.
        energy: f64,
        /// Charge left, as a share.
        remaining: f64,
        /// Why not.
        why: ViabilityError,
    },
    /// No bid.
    Refused {
        /// Why not.
        reason: RefusalReason,
    },
}
