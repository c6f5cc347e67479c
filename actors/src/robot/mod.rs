//! A robot: it prices work, holds at most one role, and carries its plan out step by step.
//!
//! ```text
//!  call for bids ─▶ Bidder (estimator)             ─▶ tender
//!  award notice  ─▶ Tenure (epoch, lease)          ─▶ report ─▶ coordinator
//!                      │ start, suspend, resume, halt
//!                      ▼
//!                   Sequencer (Algorithm 2) ─▶ next step ─▶ SkillRunner (behavior tree) ─▶ Body
//!                      │  ▲                                    │ failed, crashed, no progress
//!                      │  └──────────── Ladder ◀───────────────┘
//!                      ▼        (again, another way, give up)
//!                   Pen ─▶ notebook ─▶ signals to other roles, robot to robot
//! ```
//!
//! The [`Robot`] actor owns mailbox, timers and bus; the values beside it decide. What the actor does stands in four
//! files: `actor` (messages, knowledge of itself, bids), `holding` (awards, reports, leaving), `work` (the plan) and `record`
//! (the notebook). A skill runs in an actor of its own, so that one that panics fails its attempt and not the node.
//!
//! What a robot holds and how far it has come is on the [`Page`] of its notebook before others are told, so that its next
//! life can ask whether the role is still its own, and go on at the right task. A robot that was restarted is not free
//! before it was told.

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
