//! Effect of calibration: the same trials with uncorrected and with calibrated estimates.

use super::super::calibration::Observation;
use super::super::results::TrialRow;
use consort_skills::descriptor::Calibration;

/// Effect of calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationGain {
    /// The calibration.
    pub calibration: Calibration,
    /// Number of trials used for the calibration.
    pub trials: usize,
    /// Rows of other trials with uncorrected estimates.
    pub before: Vec<TrialRow>,
    /// Rows of the same trials with calibrated estimates.
    pub after: Vec<TrialRow>,
    /// Tasks of those trials with their uncorrected estimates.
    pub observed_before: Vec<Observation>,
    /// Tasks of those trials with their calibrated estimates.
    pub observed_after: Vec<Observation>,
}

impl CalibrationGain {
    /// Returns the mean absolute error of the estimated drive times in seconds, and the number of
    /// drives.
    pub(crate) fn mean_drive_error_s(observed: &[Observation]) -> (f64, usize) {
        let drives = observed.iter().filter(|drive| drive.to.is_some());
        let errors: Vec<f64> = drives.map(|drive| (drive.actual_s - drive.predicted_s).abs()).collect();
        (super::super::stats::mean(&errors), errors.len())
    }

    /// Returns the share of drives that used no more energy than budgeted.
    pub(crate) fn share_within_budget(observed: &[Observation]) -> f64 {
        let drives: Vec<&Observation> = observed.iter().filter(|drive| drive.to.is_some()).collect();
        let within_budget = drives.iter().filter(|drive| drive.actual_share <= drive.budget_share + 1e-9).count();
        if drives.is_empty() { 0.0 } else { within_budget as f64 / drives.len() as f64 }
    }
}
