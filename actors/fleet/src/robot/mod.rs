//! The robot: prices work, holds at most 1 role, and executes its plan step by step.
//!
//! ```text
//!  call for bids ─▶ Bidder (estimator)                ─▶ bid response
//!  award notice  ─▶ RoleLease (epoch, lease)          ─▶ report ─▶ coordinator
//!                      │ start, suspend, resume, halt
//!                      ▼
//!                   Sequencer (Algorithm 2) ─▶ step ─▶ SkillRunner (behavior tree) ─▶ RobotDriver
//!                      │  ▲                               │ failed, crashed, no progress
//!                      │  └──────── RecoveryPolicy ◀──────┘
//!                      ▼     (retry, alternative, release the role)
//!               CheckpointWriter ─▶ CheckpointStore ─▶ signals to other roles, robot to robot
//! ```
//!
//! The `Robot` actor owns the mailbox, the timers and the bus, and performs decisions. The values
//! in the other files make the decisions. The state of the actor is split by concern:
//!
//! | value | concern |
//! |---|---|
//! | `LeaseClient` | award, coordinator, reports |
//! | `Execution` with `ActivePlan` | steps, attempts, recovery, release |
//! | `CheckpointStorage` | writes of the checkpoint |
//! | `DriverLink` with `WorkerRecord` | telemetry, and the robot's own knowledge record |
//! | `StandingOrders` | hold, maintenance, closures and alarms, ordered by people |
//! | `LeaderCheck` with `LeaderPoll` | the coordinator, confirmed by the voters |
//! | `ChargeControl` | charging while the robot is free |
//! | `DeviceAccess` | claims of doors, lifts and other devices of the building |
//! | `AlarmDrive` | drives to assembly places, and back to the plan |
//!
//! Each skill runs in an actor of its own: a panic in a skill fails the attempt and not the node.
//!
//! The robot stores its award and its progress in a [`Checkpoint`] before it notifies other nodes.
//! After a restart it asks the coordinator whether the award is still valid, and continues at the
//! right task. A restarted robot with a checkpoint is not free until the coordinator has replied.

mod active_plan;
mod actor;
mod alarm_drive;
mod bidder;
mod charging;
mod checkpoint;
mod checkpoint_storage;
mod checkpoint_writer;
mod device_access;
mod driver_link;
mod energy_check;
mod execution;
mod leader_poll;
mod lease_client;
mod own_tasks;
mod recovery_policy;
mod release;
mod report;
mod sequencer;
mod settings;
mod signals;
mod skill_runner;
mod standing_orders;
mod task_timeout;
#[cfg(test)]
pub(crate) mod test_values;
mod worker_record;

pub(crate) use actor::{Robot, RobotMessage};
pub use bidder::{BidContext, Bidder, PresentWork};
pub(crate) use charging::RobotCharging;
pub use charging::{BatterySwap, ChargeThresholds, Charger, ChargerReserve, ChargingSettings};
pub use checkpoint::{Checkpoint, CheckpointError};
pub(crate) use energy_check::pricing_context;
pub use sequencer::{AlternativeProgress, OwnProgress, Sequencer, SequencerAction, StepRef};
pub(crate) use settings::{ExecutionSettings, PricingSettings, RobotLinks, RobotSettings, RobotStart};
pub(crate) use task_timeout::TaskTimeout;
pub(crate) use worker_record::MotionScope;
