//! A robot under ROS 2 that a file describes, as a driver of the fleet
//! (`docs/reference/driver.md`).
//!
//! ```text
//!  node ── goal ──▶ GoalSession ── Start ──▶ execution ── filled template ──▶ action, service or topic
//!       ◀─ result ─ (state machine) ◀─ End ─ (I/O)    ◀─ result, feedback ──
//!       ◀─ pose, charge, readings ── Reports ◀──────── messages of topics
//! ```

pub mod check;
pub mod description;
pub mod execution;
mod hold;
pub mod path;
pub mod reports;
pub mod run;
pub mod session;
pub mod template;
