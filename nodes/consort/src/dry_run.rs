//! Computes the result of an auction offline, with the robots' bidders and the coordinator's
//! allocator, without a fleet.

use crate::inputs::WorkerEntry;
use crate::wiring::SkillResources;
use consort_fleet::robot::{BidContext, Bidder};
use consort_protocol::auction::{
    AuctionContext, AuctionId, BidLimits, BidPart, BidResponse, CallForBids, EnergyBudget, Invitation, RoleReply,
    clear_auction,
};
use consort_protocol::ensemble::Membership;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::mission::{Mission, Role};
use consort_protocol::plan::Division;
use consort_protocol::units::Energy;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// A worker's bid or refusal for a role.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct WorkerBid {
    /// The worker.
    pub worker: RobotId,
    /// Time for the whole plan, in seconds; none for a refusal.
    pub time_s: Option<f64>,
    /// Charge used, as a share.
    pub energy: Option<f64>,
    /// Charge left, as a share.
    pub remaining: Option<f64>,
    /// True if the bid meets the limits.
    pub viable: bool,
    /// Reason if it does not.
    pub reason: Option<String>,
    /// Cost of each step.
    #[serde(skip)]
    pub parts: Vec<BidPart>,
}

/// Result of an auction.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DryRunOutcome {
    /// Bids and refusals by role, in the order of the workers.
    pub bids: BTreeMap<RoleId, Vec<WorkerBid>>,
    /// Assignment of roles: every role, except for roles of spread loops that stay open; or none.
    pub holders: BTreeMap<RoleId, RobotId>,
    /// Reason if no role is assigned.
    pub failure: Option<String>,
}

/// Auctions the plans of `roles` among the workers, who count as members of every ensemble. Roles without
/// a plan are skipped.
pub(crate) fn simulate_auction(
    mission: &Mission,
    division: &Division,
    roles: &BTreeSet<RoleId>,
    workers: &[WorkerEntry],
    equipment: &SkillResources,
    limits: &BidLimits,
) -> DryRunOutcome {
    let open = division.plans.iter().filter(|(role, _)| roles.contains(*role));
    let condition = |(role, declared): (&RoleId, &Role)| Some((role.clone(), declared.eligible.clone()?));
    let call = CallForBids {
        auction: AuctionId { mission: MissionId::new("dry-run").expect("a slug"), term: 0, round: 1 },
        ensembles: vec![],
        eligible: mission.roles.iter().filter_map(condition).collect(),
        spread: mission.roles.iter().filter(|(_, declared)| declared.spread).map(|(role, _)| role.clone()).collect(),
        roles: open.map(|(role, plan)| (role.clone(), plan.clone())).collect(),
    };
    let tenders: Vec<BidResponse> = workers.iter().map(|worker| tender(worker, &call, equipment)).collect();
    let robots = workers.iter().map(|worker| worker.name.clone()).collect();
    let invitation = Invitation { robots, preferred: vec![] };
    let unavailable = BTreeMap::new();
    let excluded = BTreeMap::new();
    let circumstances = AuctionContext {
        invitation: &invitation,
        unavailable: &unavailable,
        excluded: &excluded,
        limits,
        energy: mission.energy_max.map(|limit| EnergyBudget { limit, used: Energy::ZERO }),
        promises: None,
        window_ms: 0,
        at_ms: 0,
    };
    let conclusion = clear_auction(&call, &tenders, &circumstances);

    let mut bids: BTreeMap<RoleId, Vec<WorkerBid>> = BTreeMap::new();
    for answer in tenders.into_iter().flat_map(|tender| tender.replies) {
        let (role, bid_of) = bid_of(answer, limits);
        bids.entry(role).or_default().push(bid_of);
    }
    DryRunOutcome { bids, holders: conclusion.holders.unwrap_or_default(), failure: conclusion.record.failure }
}

fn tender(worker: &WorkerEntry, call: &CallForBids, equipment: &SkillResources) -> BidResponse {
    let bidder = Bidder::new(worker.name.clone(), Arc::clone(&equipment.estimator));
    let membership = Membership { member: true, reason: "named in the file".to_owned(), age_ms: 0 };
    let own = worker.worker(&equipment.places);
    bidder.respond(call, &BidContext { worker: &own, closed_lanes: &[], age_ms: 0, membership, present: None })
}

fn bid_of(answer: RoleReply, limits: &BidLimits) -> (RoleId, WorkerBid) {
    match answer {
        RoleReply::Bid(bid) => {
            let why_not = bid.check_viable(limits).err();
            let bid_of = WorkerBid {
                worker: bid.robot,
                time_s: Some(bid.time.get()),
                energy: Some(bid.energy),
                remaining: Some(bid.remaining),
                viable: why_not.is_none(),
                reason: why_not.map(|why| why.to_string()),
                parts: bid.parts,
            };
            (bid.role, bid_of)
        }
        RoleReply::Refusal(refusal) => {
            let bid_of = WorkerBid {
                worker: refusal.robot,
                time_s: None,
                energy: None,
                remaining: None,
                viable: false,
                reason: Some(refusal.reason.to_string()),
                parts: vec![],
            };
            (refusal.role, bid_of)
        }
    }
}
