//! Behavior tests in Gherkin: the shipped features, and the reports of failing ones.

mod failing_steps;
mod features;
mod step_docs;
