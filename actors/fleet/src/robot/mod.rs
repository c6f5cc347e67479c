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
//! The [`Robot`] actor owns the mailbox, the timers and the bus. The values in the other files make
//! the decisions. The actor itself is split over 4 files: `actor` (messages, own knowledge record,
//! bids), `role_lease` (awards, reports, decommission), `execution` (the plan) and `checkpointing`
//! (the checkpoint). Each skill runs in an actor of its own: a panic in a skill fails the attempt
//! and not the node.
//!
//! The robot stores its award and its progress in a [`Checkpoint`] before it notifies other nodes.
//! After a restart it asks the coordinator whether the award is still valid, and continues at the
//! right task. A restarted robot with a checkpoint is not free until the coordinator has replied.

mod active_plan;
mod actor;
mod bidder;
mod checkpoint;
mod checkpoint_writer;
mod checkpointing;
mod energy_check;
mod execution;
mod recovery_policy;
mod release;
mod role_lease;
mod sequencer;
mod settings;
mod signals;
mod skill_runner;
mod task_timeout;

pub use actor::{Robot, RobotMessage};
pub use bidder::{BidContext, Bidder};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use checkpoint_writer::{CheckpointWriter, PendingOutput};
pub use energy_check::EnergyForecast;
pub use recovery_policy::{AttemptFailure, RecoveryAction, RecoveryPolicy};
pub(crate) use role_lease::send_report;
pub use sequencer::{AlternativeProgress, Sequencer, SequencerAction, StaleSignal, StepRef};
pub use settings::RobotSettings;
pub(crate) use signals::{SignalExchange, StaleSignals};
pub use skill_runner::SkillOutcome;
pub use task_timeout::{TaskTimeout, TaskTimer};
