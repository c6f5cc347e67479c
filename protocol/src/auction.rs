//! Auctions: who is asked, what they answer, and who gets which role.
//!
//! All open roles of a mission are auctioned at once (Algorithm 1 of the thesis, with an exact assignment in place of a
//! greedy pick per role): one robot fills at most one role, and either every open role is filled or none is.

mod bid;
mod choice;
mod conclude;
mod explain;
mod record;
mod select;

pub use bid::{Answer, AuctionId, Bid, BidPart, CallForBids, Limits, Refusal, RefusalReason, Tender, Unviable};
pub use choice::{Ballot, Choice, Exact};
pub use conclude::{Circumstances, Conclusion, conclude, conclude_by};
pub use explain::{Explanation, Outcome, Price, RobotExplained, RoleExplained, explain};
pub use record::{AuctionEntry, AuctionRecord, Verdict};
pub use select::{NoCoalition, select};
