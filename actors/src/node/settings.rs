//! What a node is told before it starts.

use crate::clock::Clock;
use crate::coordinator::RequestLimits;
use crate::gossip::SharedRecordSigner;
use crate::observe::SharedObserver;
use crate::store::NodeStore;
use crate::timing::Timing;
use consort_protocol::auction::{Allocator, BidLimits};
use consort_protocol::ensemble::Ensemble;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::mission::Domain;
use consort_skills::actions::RobotBackend;
use consort_skills::descriptor::Estimator;
use consort_skills::library::SkillLibrary;
use serde_json::Value;
use std::sync::Arc;
use std::time::Duration;

/// What all nodes of a fleet agree on.
#[derive(Clone)]
pub struct FleetSettings {
    /// Its name.
    pub fleet: FleetId,
    /// Whose members are asked for bids.
    pub ensemble: Arc<Ensemble>,
    /// The task types that missions may use.
    pub domain: Arc<Domain>,
    /// What bids must keep to.
    pub limits: BidLimits,
    /// What is taken on of all that is asked for.
    pub request_limits: RequestLimits,
    /// The rule by which roles are given to robots: [`Exact`](consort_protocol::auction::Exact), but for evaluations.
    pub allocator: Arc<dyn Allocator>,
    /// How long awards last.
    pub lease_terms: LeaseTerms,
    /// How long an auction waits for a member that does not answer.
    pub bid_window: Duration,
    /// After how long a held role none of whose steps ends, although it waits for nobody, is taken from its holder; zero for
    /// never.
    pub stall_timeout: Duration,
    /// Nodes that may vote and must have met, and agree on one of them, before it founds the fleet's ledger. If it is not more
    /// than half of all, parts of the fleet that do not hear each other may found one each.
    pub bootstrap_expect: usize,
    /// How fast it notices and reacts.
    pub timing: Timing,
    /// Voters that the autopilot aims at: odd, up to [`crate::autopilot::VOTERS_MAX`].
    pub voters: usize,
    /// How long a voter must be gone until the autopilot replaces it.
    pub dead_after: Duration,
    /// Its map, as it is shown on `view/map`; nothing is decided by it.
    pub map: Option<Arc<Value>>,
}

/// What one node is.
pub struct NodeSettings {
    /// The fleet's settings.
    pub fleet: FleetSettings,
    /// Its name.
    pub node: NodeId,
    /// Which life of the node this is: larger than in any former one.
    pub incarnation: u64,
    /// Where all its chance comes from.
    pub seed: u64,
    /// What it remembers of former lives.
    pub store: NodeStore,
    /// Its clock.
    pub clock: Clock,
    /// Whether it keeps a copy of the ledger and may coordinate.
    pub may_vote: bool,
    /// Whether it stays where it is.
    pub stationary: bool,
    /// Whether it lives on mains power.
    pub mains_powered: bool,
    /// Who signs what it says of itself and judges what others hand on of third ones, where the fleet has certificates.
    pub record_signer: Option<SharedRecordSigner>,
    /// Its robot, if it has one.
    pub robot: Option<RobotPart>,
    /// The bodies and people it hosts, if it does.
    pub driver_server: Option<DriverServerPart>,
    /// Is told what happens on it, in place; none as a rule.
    pub observer: Option<SharedObserver>,
}

/// A robot's part of a node.
pub struct RobotPart {
    /// What it says of itself before its body has reported.
    pub worker: RobotKnowledge,
    /// Prices its work.
    pub estimator: Arc<Estimator>,
    /// Carries its work out.
    pub library: Arc<SkillLibrary>,
}

/// A host's part of a node.
pub struct DriverServerPart {
    /// The bodies.
    pub world: Box<dyn RobotBackend>,
    /// World seconds that pass in one second of node time.
    pub speed: f64,
}
