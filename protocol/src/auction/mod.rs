//! Auctions: calls, bids, and the assignment of roles to robots.
//!
//! All open roles of a mission are auctioned at once (Algorithm 1 of the thesis, with an optimal
//! assignment in place of a greedy choice per role). A robot fills at most 1 role, and either all
//! open roles are filled or none. A role whose robot is busy may be promised (the module `promise`), at the best
//! position among the promised roles of the robot (the module `insertion`), and after a stop at a charger (the module
//! `charging_stop`). Missions that are auctioned at the same time are
//! allocated together (the module `together`). In a large fleet the robots that may get a role are asked first (the module
//! `candidates`).

mod allocator;
mod assignment;
mod bid;
mod candidates;
mod charging_stop;
mod clearing;
mod energy;
mod energy_exceeded;
mod explain;
mod insertion;
mod invitation;
mod promise;
mod record;
mod restriction;
mod together;

pub use allocator::{Allocator, AllocatorInput, OptimalAssignment};
pub use assignment::{AssignmentError, optimal_assignment};
pub use bid::{
    AuctionId, Bid, BidLimits, BidPart, BidRefusal, BidResponse, CallForBids, PresentRole, RefusalReason, RoleEstimate,
    RoleReply, ViabilityError,
};
pub use candidates::{Candidates, Expectation, Price, RoleTerms};
pub use charging_stop::{CHARGE_TOLERANCE, ChargingStop, StopLimits, StopOption, plan_stop};
pub use clearing::{AuctionContext, AuctionOutcome, clear_auction, clear_auction_with};
pub use energy::EnergyBudget;
pub use energy_exceeded::EnergyExceeded;
pub use explain::{BidCost, Explanation, RobotExplanation, RobotOutcome, RoleExplanation, explain};
pub use insertion::{
    Objective, PlannedRole, PromisedRole, RoleInsertion, RoleOfMission, RoleSpan, TimelineEnd, TimelineStart,
    Timelines, end_of_promised, insert_role,
};
pub use invitation::Invitation;
pub use promise::{PromiseContext, PromiseTerms, RobotQueue};
pub use record::{AuctionEntry, AuctionRecord, BidVerdict, NotAskedReason};
pub use restriction::{RobotRestriction, restrict_replies};
pub use together::{OpenAuction, allocate_together, joint_count};
