//! Behavior in Gherkin: a library of steps with which people who are no programmers say what a fleet must do, and a runner.
//!
//! ```text
//!  feature files ──▶ features (read, outlines expanded, every step looked up) ──▶ cucumber ──▶ report
//!                        │ a step that nobody knows: file, line, the nearest ones     │ one thread a scenario
//!                        ▼                                                            ▼
//!                      book ◀── phrases: settings, facts, deeds          stage: cast ──▶ world, fleet on virtual time
//! ```
//!
//! Three kinds of phrases make all steps. A *setting* (`Given a nurse in "IC Room 6"`) says what there is before anything
//! happens. A *deed* (`the coordinator dies`) is done at once after `When`, or is arranged for later: `Given the coordinator
//! dies when task navto_lab has begun`. A *fact* (`amber is at "Dock"`) is looked at: `Then amber is at "Dock"`, `Then within
//! 20 s …`, `Then for 60 s …`, `When the fleet runs until …`. Whoever adds a phrase adds it to a list in its file, with an
//! example; all forms follow.
//!
//! Every scenario has a thread and a paused runtime of its own, so nothing of one is left in another, and one seed gives one
//! run whatever runs beside it. All times are those of the world in which robots and people live.

mod event_text;
mod features;
mod fixture;
mod fleet_actions;
mod fleet_facts;
mod goal_actions;
mod mission_requests;
mod report;
mod robot_facts;
mod run;
mod scenario_setup;
mod settings;
mod step_arguments;
mod step_pattern;
mod step_registry;

pub use features::{FeatureErrors, Features, ScenarioFilter};
pub use report::FeatureOutcome;
pub use run::{RunOptions, run};
pub use step_registry::{StepDoc, step_docs};
