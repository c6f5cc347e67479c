//! Skill descriptors: a robot's own estimates of the cost of tasks (thesis 3.5.1).
//!
//! ```text
//!  DescriptorRegistry ──resolve(Environment)──▶ Estimator ──price(LocalPlan, EstimateContext)──▶ a BidPart per step
//! ```
//!
//! Tasks are chained: a task begins where the previous task ends. A descriptor may state the
//! uncertainty of its energy estimate. A robot with an energy margin then bids only if its
//! battery lasts in all but the worst cases.
//!
//! ```
//! use consort_protocol::knowledge::Attributes;
//! use consort_protocol::mission::TaskSpec;
//! use consort_protocol::units::{MetresPerSecond, Seconds, SharePerSecond};
//! use consort_skills::descriptor::{DescriptorRegistry, EstimateContext, FixedDuration};
//! use consort_skills::environment::{Environment, SpeedLimits};
//!
//! let estimator = DescriptorRegistry::new()
//!     .with(FixedDuration::new("wave".parse()?, Seconds::new(4.0)?))
//!     .resolve(Environment::new())?;
//! let robot = EstimateContext {
//!     place: "Dock".parse()?,
//!     pose: None,
//!     speed: MetresPerSecond::new(0.5)?,
//!     discharge: SharePerSecond::new(0.001)?,
//!     closed: vec![],
//!     limits: SpeedLimits::default(),
//!     attributes: Attributes::default(),
//!     readings: None,
//! };
//! let estimate = estimator.estimate(&TaskSpec::of("wave".parse()?, vec!["r1".parse()?]), &robot)?;
//! assert_eq!((estimate.time.get(), estimate.energy), (4.0, 0.004));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod calibration;
mod estimate;
mod fixed;
mod registry;

pub use calibration::{Calibration, LegFactor, MeasuredCharging, TimeFactor};
pub use estimate::{Estimate, EstimateContext, EstimateError, SkillDescriptor};
pub use fixed::FixedDuration;
pub use registry::{
    DescriptorRegistry, ESTIMATOR_VERSION, Estimator, MissingRequirement, PlanBudget, PriceError, ResolveError,
};

#[cfg(test)]
mod tests;
