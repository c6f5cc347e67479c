//! The evaluation of thesis chapter 4 as values: what is decided about an experiment and what is concluded from it. No fleets
//! run here and nothing waits.

pub mod outcome;
pub mod policy;
pub mod results;
pub mod seeds;
pub mod stats;
