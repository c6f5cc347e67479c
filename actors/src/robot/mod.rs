//! A robot: it prices work, holds at most one role, and carries its plan out step by step.
//!
//! ```text
//!  call for bids ─▶ Bidder (estimator)             ─▶ tender
//!  award notice  ─▶ Tenure (epoch, lease)          ─▶ report ─▶ coordinator
//!                      │ start, suspend, resume, halt
//!                      ▼
//!                   Sequencer (Algorithm 2) ─▶ next step ─▶ SkillRunner (behavior tree) ─▶ Body
//!                      │  ▲
//!                      ▼  └── signals of other roles
//!                   signals to other roles, robot to robot
//! ```
//!
//! The [`Robot`] actor owns mailbox, timers and bus; the values beside it decide. A skill runs in an actor of its own,
//! so that one that panics fails its task and not the node.

mod actor;
mod bidder;
mod sequencer;
mod skill_runner;
mod talk;

pub(crate) use actor::ask;
pub use actor::{Robot, RobotMessage, RobotSettings};
pub use bidder::{Bidder, Circumstance};
pub use sequencer::{Move, Sequencer};
pub use skill_runner::SkillOutcome;
pub(crate) use talk::Talk;
