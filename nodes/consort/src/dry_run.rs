//! Computes the result of an auction offline, with the robots' bidders and the coordinator's
//! allocator, without a fleet.

use crate::inputs::WorkerEntry;
use crate::wiring::SkillResources;
use consort_fleet::robot::{BidContext, Bidder, ChargerReserve, ChargingSettings, PresentWork};
use consort_protocol::auction::{
    AuctionContext, AuctionId, BidLimits, BidPart, BidResponse, CallForBids, EnergyBudget, Invitation, PresentRole,
    PromiseContext, PromiseTerms, RefusalReason, RobotQueue, RoleEstimate, RoleReply, Timelines, clear_auction,
    explain,
};
use consort_protocol::ensemble::{Ensembles, Membership};
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::knowledge::{Availability, Knowledge, KnowledgeBase, Record, RecordStamp, RobotKnowledge};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger, Submission};
use consort_protocol::mission::{Mission, Role};
use consort_protocol::plan::Division;
use consort_protocol::units::{Energy, NodeTime, Seconds};
use consort_skills::environment::SpeedLimits;
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
    /// Robot of each role. Roles of spread loops may be left open. Empty after a failure.
    pub holders: BTreeMap<RoleId, RobotId>,
    /// Roles that are promised to busy robots, with the estimated time until each begins.
    pub promised: BTreeMap<RoleId, Seconds>,
    /// Explanation of each promised role.
    pub why: Vec<String>,
    /// Reason if no role is assigned.
    pub failure: Option<String>,
}

/// The fleet of the computed auction.
pub(crate) struct AssumedFleet {
    /// Estimator of its robots, and the domain of its missions.
    pub equipment: SkillResources,
    /// Limits of bids.
    pub limits: BidLimits,
    /// Its chargers, if robots must be able to reach a charger after a role.
    pub charging: Option<Arc<ChargingSettings>>,
    /// Limits of what its robots promise.
    pub promises: PromiseTerms,
    /// Time to wait for an answer of people, in seconds, where the mission states none; `None` for no limit.
    pub patience_s: Option<u32>,
    /// Its ensembles. `None`: every worker is a member of every ensemble.
    pub ensembles: Option<Arc<Ensembles>>,
}

/// Memberships of the workers, evaluated as robots and coordinator evaluate them.
struct Memberships<'a> {
    ensembles: Option<&'a Ensembles>,
    coordinator: NodeId,
    base: KnowledgeBase,
}

impl<'a> Memberships<'a> {
    /// Assumes a station on mains power as coordinator, and robots with the defaults of a robot file.
    fn of(workers: &[WorkerEntry], fleet: &'a AssumedFleet) -> Memberships<'a> {
        let coordinator = NodeId::new("coordinator").expect("a slug");
        let mut base = KnowledgeBase::default();
        let mut add = |owner: NodeId, robot: Option<RobotKnowledge>| {
            let is_station = robot.is_none();
            let knowledge = Knowledge { stationary: is_station, mains_powered: is_station, ..Knowledge::of(robot) };
            let record = Record { owner, stamp: RecordStamp::default(), knowledge, proof: None };
            base.merge(record, NodeTime::ZERO);
        };
        for worker in workers {
            add(worker.name.clone().into(), Some(worker.worker(&fleet.equipment.places)));
        }
        add(coordinator.clone(), None);
        Memberships { ensembles: fleet.ensembles.as_deref(), coordinator, base }
    }

    fn invitation(&self, call: &CallForBids, workers: &[WorkerEntry]) -> Invitation {
        let Some(ensembles) = self.ensembles else {
            let robots = workers.iter().map(|worker| worker.name.clone()).collect();
            return Invitation { robots, preferred: vec![] };
        };
        let robots = |nodes: BTreeSet<NodeId>| nodes.into_iter().map(RobotId::from).collect();
        let members = ensembles.members(&self.coordinator, &self.base, NodeTime::ZERO);
        Invitation::of(&call.ensembles, &members.into_iter().map(|(name, nodes)| (name, robots(nodes))).collect())
    }

    fn of_worker(&self, call: &CallForBids, worker: &WorkerEntry) -> Membership {
        let Some(ensembles) = self.ensembles else {
            return Membership { member: true, reason: "named in the file".to_owned(), age_ms: 0 };
        };
        let node = NodeId::from(worker.name.clone());
        ensembles.membership_of(&call.ensembles, &node, &self.coordinator, &self.base, NodeTime::ZERO)
    }
}

/// Auctions the plans of `roles` among the workers. Roles without a plan are skipped.
pub(crate) fn simulate_auction(
    mission: &Mission,
    division: &Division,
    roles: &BTreeSet<RoleId>,
    workers: &[WorkerEntry],
    fleet: &AssumedFleet,
) -> DryRunOutcome {
    let AssumedFleet { limits, .. } = fleet;
    let open = division.plans.iter().filter(|(role, _)| roles.contains(*role));
    let condition = |(role, declared): (&RoleId, &Role)| Some((role.clone(), declared.eligible.clone()?));
    let call = CallForBids {
        auction: AuctionId { mission: MissionId::new("dry-run").expect("a slug"), term: 0, round: 1 },
        ensembles: mission.ensembles.clone(),
        eligible: mission.roles.iter().filter_map(condition).collect(),
        spread: mission.roles.iter().filter(|(_, declared)| declared.spread).map(|(role, _)| role.clone()).collect(),
        roles: open.map(|(role, plan)| (role.clone(), plan.clone())).collect(),
        timelines: Timelines::default(),
    };
    let memberships = Memberships::of(workers, fleet);
    let respond = |worker: &WorkerEntry| response(worker, &call, memberships.of_worker(&call, worker), fleet);
    let tenders: Vec<BidResponse> = workers.iter().map(respond).collect();
    let invitation = memberships.invitation(&call, workers);
    let queues: BTreeMap<RobotId, RobotQueue> = workers
        .iter()
        .filter(|worker| worker.busy_s.is_some())
        .map(|worker| (worker.name.clone(), busy_queue()))
        .collect();
    let unavailable = queues.iter().map(|(robot, queue)| (robot.clone(), queue.reason.clone())).collect();
    let (unpromisable, excluded) = (BTreeMap::new(), BTreeMap::new());
    let startable = startable_roles(mission, division);
    let promises = PromiseContext {
        queues: &queues,
        unavailable: &unpromisable,
        startable: &startable,
        may_wait: false,
        terms: fleet.promises,
    };
    let circumstances = AuctionContext {
        invitation: &invitation,
        unavailable: &unavailable,
        excluded: &excluded,
        limits,
        energy: mission.energy_max.map(|limit| EnergyBudget { limit, used: Energy::ZERO }),
        promises: Some(promises).filter(|promises| promises.terms.promises_max > 0),
        window_ms: 0,
        at_ms: 0,
    };
    let conclusion = clear_auction(&call, &tenders, &circumstances);

    let mut bids: BTreeMap<RoleId, Vec<WorkerBid>> = BTreeMap::new();
    for answer in tenders.into_iter().flat_map(|tender| tender.replies) {
        let (role, bid_of) = bid_of(answer, limits);
        bids.entry(role).or_default().push(bid_of);
    }
    let record = conclusion.record;
    let explained = explain(&record).roles.into_iter().filter(|role| record.promised.contains_key(&role.role));
    let why = explained.map(|role| format!("{}: {}", role.role, role.why)).collect();
    let (holders, promised) = (conclusion.holders.unwrap_or_default(), record.promised);
    DryRunOutcome { bids, holders, promised, why, failure: record.failure }
}

/// Returns the roles that can start before any step of another role has ended.
fn startable_roles(mission: &Mission, division: &Division) -> BTreeSet<RoleId> {
    let mut ledger = Ledger::default();
    let request = "dry-run".parse().expect("the id of a request");
    let submission = Submission::of(request, mission.clone(), division.clone());
    ledger.apply(Epoch::default(), Command::Submit(Box::new(submission)));
    let roles = ledger.missions().flat_map(|entry| entry.roles.keys().filter(move |role| entry.can_proceed(role)));
    roles.cloned().collect()
}

/// Returns the role that a busy worker holds.
fn other_role() -> (MissionId, RoleId) {
    (MissionId::new("another-mission").expect("a slug"), RoleId::new("another-role").expect("a slug"))
}

fn busy_queue() -> RobotQueue {
    let (mission, role) = other_role();
    RobotQueue {
        held: Some(RoleEstimate { time: Seconds::ZERO, energy: Energy::ZERO }),
        promised: 0,
        preceding: 0,
        time: Seconds::ZERO,
        energy: Energy::ZERO,
        yields: false,
        reason: RefusalReason::Busy { mission, role },
    }
}

fn response(worker: &WorkerEntry, call: &CallForBids, membership: Membership, fleet: &AssumedFleet) -> BidResponse {
    let AssumedFleet { equipment, limits, charging, .. } = fleet;
    let (mission, role) = other_role();
    let present = worker.busy_s.map(|time| {
        let role = PresentRole { mission: mission.clone(), role: role.clone(), time };
        PresentWork::ending_at(role, worker.place.clone())
    });
    let mut own = worker.worker(&equipment.places);
    if present.is_some() {
        own.availability = Availability::Holding { mission, role, suspended: false };
    }
    let chargers = charging.as_ref().and_then(|settings| ChargerReserve::of(settings, *limits, &worker.name, &own));
    let bidder = Bidder::new(worker.name.clone(), Arc::clone(&equipment.estimator)).with_chargers(chargers);
    let context = BidContext {
        worker: &own,
        closed_lanes: &[],
        found_closed: &[],
        closures: &[],
        speed_limits: SpeedLimits::default(),
        readings: None,
        age_ms: 0,
        membership,
        present,
    };
    bidder.respond(call, &context)
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
