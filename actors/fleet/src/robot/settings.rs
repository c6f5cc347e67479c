//! Settings of a robot, grouped by the part that uses them.

use super::charging::RobotCharging;
use super::task_timeout::TaskTimeout;
use super::worker_record::MotionScope;
use crate::events::EventPublisher;
use crate::robot_driver::RobotDriver;
use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_gossip::{GossipHandle, SharedKnowledge};
use consort_protocol::auction::BidLimits;
use consort_protocol::devices::Devices;
use consort_protocol::ensemble::Ensembles;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::Keys;
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::lease::LeaseTerms;
use consort_raft::store::CheckpointStore;
use consort_skills::descriptor::Estimator;
use consort_skills::library::SkillLibrary;
use std::sync::Arc;
use std::time::Duration;

/// Arguments of the robot actor.
pub(crate) struct RobotStart {
    /// Settings of the robot.
    pub(crate) settings: RobotSettings,
    /// Published worker until the driver has reported.
    pub(crate) worker: RobotKnowledge,
    /// Driver of the robot.
    pub(crate) driver: RobotDriver,
}

/// Settings of a robot.
pub(crate) struct RobotSettings {
    /// Id of the robot.
    pub(crate) robot: RobotId,
    /// Incarnation of its node.
    pub(crate) incarnation: u64,
    /// Connections to the rest of the node and to the fleet.
    pub(crate) links: RobotLinks,
    /// Prices of plans.
    pub(crate) pricing: PricingSettings,
    /// Execution of tasks.
    pub(crate) execution: ExecutionSettings,
    /// Charging; `None` if the robot charges by tasks of missions only.
    pub(crate) charging: Option<RobotCharging>,
    /// Nodes that receive the motion of the robot.
    pub(crate) motion_scope: MotionScope,
    /// Devices of the building; `None` if the fleet has none.
    pub(crate) devices: Option<Arc<Devices>>,
    /// Durations of leases.
    pub(crate) lease_terms: LeaseTerms,
    /// Interval for properties sensing and for lease checks. Default 250 ms. Gossip is updated at
    /// most once per second while only pose and charge change.
    pub(crate) update_interval: Duration,
}

/// Connections of a robot to the rest of its node and to the fleet.
pub(crate) struct RobotLinks {
    /// The fleet's keys.
    pub(crate) keys: Keys,
    /// The bus.
    pub(crate) bus: SharedBus,
    /// The node's clock.
    pub(crate) clock: Clock,
    /// Event publisher.
    pub(crate) events: EventPublisher,
    /// Gossip of the node: publishes the worker.
    pub(crate) gossip: GossipHandle,
    /// Records received from other nodes.
    pub(crate) knowledge: SharedKnowledge,
    /// Store of the checkpoint.
    pub(crate) checkpoint_store: Arc<dyn CheckpointStore>,
}

/// Settings for the prices of plans: bids, and the energy check during execution.
pub(crate) struct PricingSettings {
    /// Ensembles of the fleet: their members receive calls for bids.
    pub(crate) ensembles: Arc<Ensembles>,
    /// Limits of bids. The remaining plan is checked against the same limits.
    pub(crate) limits: BidLimits,
    /// Estimator of time and energy.
    pub(crate) estimator: Arc<Estimator>,
}

/// Settings for the execution of tasks.
pub(crate) struct ExecutionSettings {
    /// Skills of the robot.
    pub(crate) library: Arc<SkillLibrary>,
    /// Time limits of tasks.
    pub(crate) task_timeout: TaskTimeout,
    /// Pause between two attempts at a task, in node time. Raised: an obstacle has more time to
    /// move away. Default 500 ms (a guess).
    pub(crate) retry_delay: Duration,
    /// Tick interval of a running skill while the driver sends no state. Default 100 ms.
    pub(crate) skill_tick_interval: Duration,
}
