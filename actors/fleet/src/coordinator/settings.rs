//! Settings of a coordinator.

use super::rate_limit::RequestLimits;
use crate::autopilot::AutopilotSettings;
use crate::events::EventPublisher;
use crate::robot::ChargingSettings;
use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_bus::wire_version::WireVersion;
use consort_gossip::SharedKnowledge;
use consort_protocol::auction::{Allocator, BidLimits, PromiseTerms};
use consort_protocol::devices::Devices;
use consort_protocol::ensemble::Ensembles;
use consort_protocol::ids::{AlarmId, NodeId};
use consort_protocol::keys::Keys;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::{AlarmPlan, HistoryLimits, Ledger};
use consort_protocol::mission::Domain;
use consort_raft::Replica;
use consort_skills::descriptor::Estimator;
use consort_skills::missions::NamedMissions;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Settings of a coordinator. Most are the same in the whole fleet.
#[derive(Clone)]
pub(crate) struct CoordinatorSettings {
    /// Parts of the node that the coordinator uses.
    pub(crate) parts: NodeParts,
    pub(crate) auctions: AuctionSettings,
    pub(crate) autopilot: AutopilotSettings,
    /// The task types that missions may use.
    pub(crate) domain: Arc<Domain>,
    /// The missions that a request may name.
    pub(crate) missions: Arc<NamedMissions>,
    /// The alarms that a request may raise.
    pub(crate) alarms: Arc<BTreeMap<AlarmId, AlarmPlan>>,
    /// Doors, lifts and other devices of the building.
    pub(crate) devices: Arc<Devices>,
    /// Charging in the fleet, if robots charge by themselves, or people swap their batteries.
    pub(crate) charging: Option<Arc<ChargingSettings>>,
    /// Limits of accepted requests and missions.
    pub(crate) request_limits: RequestLimits,
    /// Limits of the ledger's history of ended missions.
    pub(crate) history_limits: HistoryLimits,
    /// Durations of leases.
    pub(crate) lease_terms: LeaseTerms,
    /// Maximum time for a held role without an ended step, while it could make progress. Then the
    /// role is taken from its holder. Zero means never. Raised: long drives are not interrupted,
    /// idle holders keep their roles for longer.
    pub(crate) stall_timeout: Duration,
    /// Interval of the beacon and of the periodic work. Default 250 ms.
    pub(crate) tick_interval: Duration,
    /// Seed of the cluster id, in case this node founds the ledger.
    pub(crate) cluster_seed: u64,
}

/// Parts of a node that its coordinator uses.
#[derive(Clone)]
pub(crate) struct NodeParts {
    /// Id of this node.
    pub(crate) node: NodeId,
    /// The fleet's keys.
    pub(crate) keys: Keys,
    pub(crate) bus: SharedBus,
    pub(crate) clock: Clock,
    /// The node's copy of the ledger.
    pub(crate) replica: Replica<Ledger>,
    /// Records received from other nodes.
    pub(crate) knowledge: SharedKnowledge,
    /// Wire version that the node writes.
    pub(crate) wire_version: WireVersion,
    pub(crate) events: EventPublisher,
}

/// Settings of auctions.
#[derive(Clone)]
pub(crate) struct AuctionSettings {
    /// Ensembles of the fleet: their members receive calls for bids.
    pub(crate) ensembles: Arc<Ensembles>,
    /// Limits that bids must meet.
    pub(crate) limits: BidLimits,
    /// Limits of what robots promise.
    pub(crate) promises: PromiseTerms,
    /// Allocation rule of the auctions.
    pub(crate) allocator: Arc<dyn Allocator>,
    /// Choice of the robots to ask; `None` to ask all.
    pub(crate) candidates: Option<CandidateSettings>,
    /// Time for which an auction waits for missing bids. Raised: robots on slow links still win
    /// roles, unreachable robots delay every auction for longer. Default 200 ms.
    pub(crate) bid_window: Duration,
}

/// Choice of the robots that an auction asks in a large fleet.
#[derive(Clone)]
pub struct CandidateSettings {
    /// Number of robots that an auction asks first. A fleet of at most this size asks all. Raised: more messages, and fewer auctions that
    /// ask again. Default 16: two messages for each stay below 40.
    pub count: usize,
    /// Estimates no task of a robot to cost more than the robot does itself.
    pub estimator: Arc<Estimator>,
    /// Version of that estimator, as in the records of robots. The costs of robots with another version are unknown.
    pub estimator_version: String,
}

impl CandidateSettings {
    /// Default of [`count`](Self::count).
    pub const DEFAULT_COUNT: usize = 16;
}

impl AuctionSettings {
    /// Checks whether an auction with this number of members asks candidates only.
    pub(super) fn asks_candidates(&self, members: usize) -> bool {
        self.candidates.as_ref().is_some_and(|settings| members > settings.count)
    }
}
