//! Settings of a node.

use crate::autopilot::AutopilotRule;
use crate::coordinator::{CandidateSettings, RequestLimits};
use crate::observe::SharedObserver;
use crate::robot::ChargingSettings;
use consort_bus::clock::Clock;
use consort_bus::record_signer::SharedRecordSigner;
use consort_protocol::auction::{Allocator, BidLimits, PromiseTerms};
use consort_protocol::devices::Devices;
use consort_protocol::ensemble::Ensembles;
use consort_protocol::ids::{AlarmId, DeviceId, FleetId, NodeId};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::{AlarmPlan, HistoryLimits};
use consort_protocol::mission::Domain;
use consort_protocol::timing::Timing;
use consort_protocol::units::WattHours;
use consort_protocol::versions::VersionRange;
use consort_protocol::view::MapView;
use consort_raft::store::NodeStore;
use consort_skills::actions::RobotBackend;
use consort_skills::descriptor::Estimator;
use consort_skills::library::SkillLibrary;
use consort_skills::missions::NamedMissions;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Settings shared by all nodes of a fleet.
#[derive(Clone)]
pub struct FleetSettings {
    /// Id of the fleet.
    pub fleet: FleetId,
    /// Ensembles of the fleet: their members receive calls for bids.
    pub ensembles: Arc<Ensembles>,
    /// The task types that missions may use.
    pub domain: Arc<Domain>,
    /// The missions that a request may name.
    pub missions: Arc<NamedMissions>,
    /// The alarms that people may raise.
    pub alarms: Arc<BTreeMap<AlarmId, AlarmPlan>>,
    /// Limits that bids must meet.
    pub limits: BidLimits,
    /// Chargers, and when robots use them; `None` if robots charge by tasks of missions only.
    pub charging: Option<Arc<ChargingSettings>>,
    /// Doors, lifts and other devices of the building.
    pub devices: Arc<Devices>,
    /// Limits of what robots promise while they hold other roles.
    pub promises: PromiseTerms,
    /// Limits of accepted requests and missions.
    pub request_limits: RequestLimits,
    /// Limits of the ledger's history of ended missions.
    pub history_limits: HistoryLimits,
    /// Allocation rule: [`OptimalAssignment`](consort_protocol::auction::OptimalAssignment), except
    /// in evaluations.
    pub allocator: Arc<dyn Allocator>,
    /// Choice of the robots that auctions ask in a large fleet; `None` to ask all.
    pub candidates: Option<CandidateSettings>,
    /// Durations of leases.
    pub lease_terms: LeaseTerms,
    /// Time for which an auction waits for missing bids.
    pub bid_window: Duration,
    /// Maximum time for a held role without an ended step, while it could make progress. Then the
    /// role is taken from its holder. Zero means never.
    pub stall_timeout: Duration,
    /// Number of voting nodes that must be in contact and agree on a founder before it founds the
    /// fleet's ledger. If this is not more than half of all, partitions of the fleet may each found
    /// a ledger.
    pub bootstrap_expect: usize,
    /// Timing profile: speed of detection and reaction.
    pub timing: Timing,
    /// Number of voters that the autopilot aims at: odd, up to [`crate::autopilot::VOTERS_MAX`].
    pub voters: usize,
    /// Decision rule of the autopilot: [`decide`](crate::autopilot::decide), except in mutation
    /// checks.
    pub autopilot_rule: AutopilotRule,
    /// Time without contact after which the autopilot replaces a voter.
    pub dead_after: Duration,
    /// Number of applied entries of the ledger after which a node takes a snapshot.
    pub snapshot_every: u64,
    /// Number of entries of the ledger that a node keeps although its snapshot covers them.
    pub log_entries_kept: u64,
    /// Nodes receive what they use: motion and heartbeats go to nodes that do not move, run on mains power, or are members of
    /// the ledger's cluster, and records go to all nodes when they change. For large fleets.
    pub scoped_knowledge: bool,
    /// The fleet's map, served as `view/map`. No decision depends on it.
    pub map: Option<Arc<MapView>>,
}

/// Settings of a single node.
pub struct NodeSettings {
    /// Settings of the fleet.
    pub fleet: FleetSettings,
    /// Id of the node.
    pub node: NodeId,
    /// Incarnation of the node: larger than any previous incarnation.
    pub incarnation: u64,
    /// Seed of all random decisions.
    pub seed: u64,
    /// Persistent store.
    pub store: NodeStore,
    /// Clock of the node.
    pub clock: Clock,
    /// Wire versions that the node reads: those of the program, unless a test limits them.
    pub supported_versions: VersionRange,
    /// The node keeps a copy of the ledger and may coordinate.
    pub may_vote: bool,
    /// The node does not move.
    pub stationary: bool,
    /// The node has mains power.
    pub mains_powered: bool,
    /// Signs the node's own records and verifies forwarded records, in a fleet with certificates.
    pub record_signer: Option<SharedRecordSigner>,
    /// The robot of the node, if any.
    pub robot: Option<RobotPart>,
    /// The driver server of the node, if any.
    pub driver_server: Option<DriverServerPart>,
    /// Devices of the building whose drivers the node runs.
    pub devices: Vec<DevicePart>,
    /// Observer of the node's events, called synchronously; usually none.
    pub observer: Option<SharedObserver>,
}

/// The robot of a node.
pub struct RobotPart {
    /// Published worker until the driver has reported.
    pub worker: RobotKnowledge,
    /// Estimator of time and energy.
    pub estimator: Arc<Estimator>,
    /// Skills of the robot.
    pub library: Arc<SkillLibrary>,
    /// Capacity of its battery, if it is known.
    pub capacity: Option<WattHours>,
}

/// The driver server of a node.
pub struct DriverServerPart {
    /// The simulated world or robot adapter.
    pub world: Box<dyn RobotBackend>,
    /// World seconds per second of node time.
    pub speed: f64,
}

/// A device that a node serves with a driver.
pub struct DevicePart {
    /// The device, as named in the fleet file.
    pub device: DeviceId,
    /// Its driver, which serves the goals of a robot with the name of the device.
    pub driver: Box<dyn RobotBackend>,
}
