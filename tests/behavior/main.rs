//! Behavior in Gherkin: the features that come with the program, and what is said of those that fail.

mod failing_steps;
mod features;
mod step_docs;
