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

mod actor;
mod bidder;
mod forecast;
mod holding;
mod job;
mod ladder;
mod page;
mod patience;
mod pen;
mod record;
mod sequencer;
mod settings;
mod skill_runner;
mod surrender;
mod talk;
mod work;

pub use actor::{Robot, RobotMessage};
pub use bidder::{Bidder, Circumstance};
pub use forecast::Forecast;
pub(crate) use holding::send_report;
pub use ladder::{Ladder, Rung, Setback};
pub use page::{Page, PageError};
pub use patience::{Patience, Stopwatch};
pub use pen::{Pen, Telling};
pub use sequencer::{Detours, Move, Outdated, Sequencer, Spot};
pub use settings::RobotSettings;
pub use skill_runner::SkillOutcome;
pub(crate) use talk::{OutdatedSignals, Talk};
