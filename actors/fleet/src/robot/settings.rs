//! Settings of a robot.

use super::task_timeout::TaskTimeout;
use crate::events::EventPublisher;
use crate::robot_driver::RobotDriver;
use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_gossip::{GossipHandle, SharedKnowledge};
use consort_protocol::auction::BidLimits;
use consort_protocol::ensemble::Ensemble;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::Keys;
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::lease::LeaseTerms;
use consort_raft::store::CheckpointStore;
use consort_skills::descriptor::Estimator;
use consort_skills::library::SkillLibrary;
use std::sync::Arc;
use std::time::Duration;

/// Settings of a robot.
pub struct RobotSettings {
    /// Id of the robot.
    pub robot: RobotId,
    /// Incarnation of its node.
    pub incarnation: u64,
    /// Published worker until the driver has reported.
    pub worker: RobotKnowledge,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// The node's clock.
    pub clock: Clock,
    /// Event publisher.
    pub events: EventPublisher,
    /// Gossip of the node: publishes the worker.
    pub gossip: GossipHandle,
    /// Records received from other nodes.
    pub knowledge: SharedKnowledge,
    /// The ensemble of the fleet.
    pub ensemble: Arc<Ensemble>,
    /// Limits of bids. The remaining plan is checked against the same limits.
    pub limits: BidLimits,
    /// Durations of leases.
    pub lease_terms: LeaseTerms,
    /// Estimator of time and energy.
    pub estimator: Arc<Estimator>,
    /// Skills of the robot.
    pub library: Arc<SkillLibrary>,
    /// Driver of the robot.
    pub driver: RobotDriver,
    /// Store of the checkpoint.
    pub checkpoint_store: Arc<dyn CheckpointStore>,
    /// Time limits of tasks.
    pub task_timeout: TaskTimeout,
    /// Pause between two attempts at a task, in node time. Raised: an obstacle has more time to
    /// move away. Default 500 ms (a guess).
    pub retry_delay: Duration,
    /// Interval for properties sensing and for lease checks. Default 250 ms. Gossip is updated at
    /// most once per second while only pose and charge change.
    pub update_interval: Duration,
    /// Tick interval of a running skill while the driver sends no state. Default 100 ms.
    pub skill_tick_interval: Duration,
}
