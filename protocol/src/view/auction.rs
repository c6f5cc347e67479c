//! View of the latest auctions.

use super::{readable, readable_or_default};
use crate::auction::{AuctionRecord, Explanation};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The latest auction of each mission, latest first.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuctionsView {
    /// Auctions.
    #[serde(default, deserialize_with = "readable")]
    pub auctions: Vec<AuctionView>,
}

/// An auction with its explanation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuctionView {
    /// Replies and decision.
    #[serde(flatten)]
    pub record: AuctionRecord,
    /// Explanation, without the parts of the bids.
    #[serde(default, deserialize_with = "readable_or_default")]
    pub explanation: Explanation,
}
