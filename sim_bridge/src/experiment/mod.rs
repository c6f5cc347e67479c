//! The evaluation of thesis chapter 4 as values: what is decided about an experiment and what is concluded from it. No fleets
//! run here and nothing waits.

pub mod calibration;
pub mod design;
pub mod outcome;
pub mod policy;
pub mod published_format;
pub mod report;
pub mod results;
pub mod seeds;
pub mod stats;
pub mod success_estimate;
pub mod travel;
