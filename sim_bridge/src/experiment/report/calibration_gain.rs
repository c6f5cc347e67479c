//! What calibration gains: the same trials with estimates as they were, and with what was learned.

use super::super::calibration::{Calibration, Observation};
use super::super::results::TrialRow;

/// What calibration gains.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationGain {
    /// What was learned.
    pub calibration: Calibration,
    /// Trials from which it was learned.
    pub trials: usize,
    /// Rows of other trials with estimates as they were.
    pub before: Vec<TrialRow>,
    /// Rows of the same trials with what was learned.
    pub after: Vec<TrialRow>,
    /// What tasks took in those, beside what was estimated before.
    pub observed_before: Vec<Observation>,
    /// And with what was learned.
    pub observed_after: Vec<Observation>,
}

impl CalibrationGain {
    /// The mean absolute error of estimates of drives, in seconds, and how many drives there were.
    pub fn mean_drive_error_s(observed: &[Observation]) -> (f64, usize) {
        let drives = observed.iter().filter(|seen| seen.to.is_some());
        let errors: Vec<f64> = drives.map(|seen| (seen.actual_s - seen.predicted_s).abs()).collect();
        (super::super::stats::mean(&errors), errors.len())
    }

    /// The share of drives that used no more energy than was set aside for them.
    pub fn share_within_budget(observed: &[Observation]) -> f64 {
        let drives: Vec<&Observation> = observed.iter().filter(|seen| seen.to.is_some()).collect();
        let kept = drives.iter().filter(|seen| seen.actual_share <= seen.budget_share + 1e-9).count();
        if drives.is_empty() { 0.0 } else { kept as f64 / drives.len() as f64 }
    }
}
