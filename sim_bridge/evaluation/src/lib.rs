//! The evaluation of thesis chapter 4 as values: the design of an experiment and the conclusions
//! from its results. This module runs no fleets and never blocks.

pub mod allocation;
pub mod calibration;
pub mod design;
pub mod energy;
pub mod outcome;
pub mod policy;
pub mod published_format;
pub mod report;
pub mod results;
pub mod seeds;
pub mod shift;
pub mod stats;
pub mod success_estimate;
pub mod travel;
