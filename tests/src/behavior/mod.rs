//! Behavior tests in Gherkin: steps that describe the required behavior of a fleet in plain words,
//! and their runner.
//!
//! ```text
//!  feature files ──▶ features (read, outlines expanded, every step resolved) ──▶ cucumber ──▶ report
//!                        │ unknown step: file, line, nearest steps                   │ one thread per scenario
//!                        ▼                                                           ▼
//!            step_registry ◀── steps: settings, facts, actions          fixture: scenario_setup ──▶ world, virtual fleet
//! ```
//!
//! There are three kinds of steps. A *setting* (`Given a nurse in "IC Room 6"`) describes the
//! initial state. An *action* (`the coordinator is killed`) is done at once after `When`, or is
//! planned for later: `Given the coordinator is killed when task navto_lab has begun`. A *fact*
//! (`amber is at "Dock"`) is checked: `Then amber is at "Dock"`, `Then within 20 s …`,
//! `Then for 60 s …`, `When the fleet runs until …`.
//!
//! Each step is a function with its phrase (`step_pattern`), listed in `steps` of its file, in the
//! order of the documentation; a function that is not listed is a compiler warning. All forms
//! follow from the phrase. A program can add steps of its own ([`OwnSteps`]).
//!
//! Every scenario has its own thread and its own paused runtime. So no state passes from one
//! scenario to the next, and a seed determines a run regardless of other runs. All times are world
//! times, in which robots and people live.

mod declared_goal;
mod event_text;
mod features;
mod fixture;
mod fleet_actions;
mod fleet_facts;
mod goal_actions;
mod item_facts;
mod mission_requests;
mod own_steps;
mod passage_facts;
mod report;
mod robot_facts;
mod robot_table;
mod run;
mod scenario_setup;
mod settings;
mod step_arguments;
mod step_meaning;
mod step_pattern;
mod step_registry;
mod step_result;

pub use features::{FeatureErrors, Features, ScenarioFilter, TagExpressionError};
pub use fixture::Fixture;
pub use own_steps::{OwnSteps, add_steps};
pub use report::FeatureOutcome;
pub use run::{RunOptions, run};
pub use step_arguments::StepArguments;
pub use step_pattern::FactFn;
pub use step_registry::{StepDoc, step_docs};
pub use step_result::{StepFailure, StepResult, expect_that};
