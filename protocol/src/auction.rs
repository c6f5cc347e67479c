//! Auctions: who is asked, what they answer, and who gets which role.
//!
//! All open roles of a mission are auctioned at once (Algorithm 1 of the thesis, with an exact assignment in place of a
//! greedy pick per role): one robot fills at most one role, and either every open role is filled or none is.

mod allocator;
mod assignment;
mod bid;
mod clearing;
mod explain;
mod record;

pub use allocator::{Allocator, AllocatorInput, OptimalAssignment};
pub use assignment::{AssignmentError, optimal_assignment};
pub use bid::{
    AuctionId, Bid, BidLimits, BidPart, BidRefusal, BidResponse, CallForBids, RefusalReason, RoleReply, ViabilityError,
};
pub use clearing::{AuctionContext, AuctionOutcome, clear_auction, clear_auction_with};
pub use explain::{BidCost, Explanation, RobotExplanation, RobotOutcome, RoleExplanation, explain};
pub use record::{AuctionEntry, AuctionRecord, BidVerdict};
