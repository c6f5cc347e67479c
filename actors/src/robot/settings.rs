//! How a robot works.

use super::task_timeout::TaskTimeout;
use crate::bus::SharedBus;
use crate::clock::Clock;
use crate::events::EventPublisher;
use crate::gossip::{GossipHandle, SharedKnowledge};
use crate::robot_driver::RobotDriver;
use crate::store::CheckpointStore;
use consort_protocol::auction::BidLimits;
use consort_protocol::ensemble::Ensemble;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::Keys;
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::lease::LeaseTerms;
use consort_skills::descriptor::Estimator;
use consort_skills::library::SkillLibrary;
use std::sync::Arc;
use std::time::Duration;

/// How a robot works.
pub struct RobotSettings {
    /// Its name.
    pub robot: RobotId,
    /// Which life of its node this is.
    pub incarnation: u64,
    /// What it says of itself before its body has reported.
    pub worker: RobotKnowledge,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// The node's clock.
    pub clock: Clock,
    /// Where it tells what happens.
    pub events: EventPublisher,
    /// Where its knowledge of itself goes.
    pub gossip: GossipHandle,
    /// What the node has heard.
    pub knowledge: SharedKnowledge,
    /// The ensemble it may be a member of.
    pub ensemble: Arc<Ensemble>,
    /// What bids must keep to; the robot holds the rest of its plan to the same.
    pub limits: BidLimits,
    /// How long awards last.
    pub lease_terms: LeaseTerms,
    /// Prices its work.
    pub estimator: Arc<Estimator>,
    /// Carries its work out.
    pub library: Arc<SkillLibrary>,
    /// Its body.
    pub driver: RobotDriver,
    /// Where it writes down what its next life should know.
    pub checkpoint_store: Arc<dyn CheckpointStore>,
    /// How long tasks may take.
    pub task_timeout: TaskTimeout,
    /// How long a robot stands still between two attempts at a task, in node time. Raised: what was in the way has more
    /// time to pass. Default 500 ms (a guess).
    pub retry_delay: Duration,
    /// How often properties are sensed and leases looked after. Default 250 ms; knowledge is told once a second at most while
    /// only pose and charge change.
    pub update_interval: Duration,
    /// How often a running skill is ticked while nothing is heard from the body. Default 100 ms.
    pub skill_tick_interval: Duration,
}
