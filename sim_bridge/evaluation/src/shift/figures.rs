//! Figures of runs, and their means with confidence intervals.

use super::ShiftPolicy;
use crate::stats::MeanEstimate;
use serde::Serialize;

/// A value for each measure of a shift. Times are in seconds of world time. Those until the completion are times of the
/// completed missions, so they compare policies only if each completes all missions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ShiftMetrics<T> {
    /// Completed missions per hour, from the first request to the last completion.
    pub per_hour: T,
    /// Mean time from the request of a mission to its first task, of the missions that have begun.
    pub waiting_s: T,
    /// 95th percentile of this time.
    pub waiting_p95_s: T,
    /// Mean time from the request of a mission to its completion.
    pub completion_s: T,
    /// 95th percentile of this time.
    pub completion_p95_s: T,
    /// Distance of all carriers in metres.
    pub distance_m: T,
    /// Discharge of all carriers, in full batteries.
    pub energy: T,
    /// Number of messages on the network, once for each receiver.
    pub messages: T,
    /// Duration of the run.
    pub wall_s: T,
}

/// Returns a measure of a run.
type Measure = fn(&ShiftMetrics<f64>) -> f64;

impl<T> ShiftMetrics<T> {
    /// Computes a value for each measure.
    fn each(compute: impl Fn(Measure) -> T) -> ShiftMetrics<T> {
        ShiftMetrics {
            per_hour: compute(|of| of.per_hour),
            waiting_s: compute(|of| of.waiting_s),
            waiting_p95_s: compute(|of| of.waiting_p95_s),
            completion_s: compute(|of| of.completion_s),
            completion_p95_s: compute(|of| of.completion_p95_s),
            distance_m: compute(|of| of.distance_m),
            energy: compute(|of| of.energy),
            messages: compute(|of| of.messages),
            wall_s: compute(|of| of.wall_s),
        }
    }
}

/// Figures of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ShiftFigures {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of requested missions.
    pub missions: usize,
    /// Number of completed missions.
    pub completed: usize,
    /// Number of missions that were completed late.
    pub late: usize,
    /// Number of carriers whose battery fell to the charge at which they stop.
    pub stranded: usize,
    /// Least charge of a carrier.
    pub charge_min: f64,
    /// The measures.
    pub metrics: ShiftMetrics<f64>,
}

/// Figures of a policy: means over runs with different seeds, with confidence intervals of 95 %.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PolicyFigures {
    /// The policy.
    pub policy: ShiftPolicy,
    /// Mean rate of requests; `None` if all are requested at once.
    pub requests_per_hour: Option<f64>,
    /// Means of the measures.
    pub means: ShiftMetrics<MeanEstimate>,
    /// Mean differences to the first policy, with the same seeds; `None` for the first policy.
    pub differences: Option<ShiftMetrics<MeanEstimate>>,
    /// The runs.
    pub runs: Vec<ShiftFigures>,
}

impl PolicyFigures {
    /// Summarises runs, and compares them with the runs of the first policy, which have the same seeds.
    pub fn of(
        policy: ShiftPolicy,
        requests_per_hour: Option<f64>,
        runs: Vec<ShiftFigures>,
        first: Option<&PolicyFigures>,
    ) -> PolicyFigures {
        let values = |of: Measure| runs.iter().map(|run| of(&run.metrics)).collect::<Vec<f64>>();
        let means = ShiftMetrics::each(|of| MeanEstimate::of(&values(of)));
        let differences = first.map(|first| {
            ShiftMetrics::each(|of| {
                let pairs = first.runs.iter().zip(&runs);
                let differences: Vec<f64> = pairs.map(|(first, run)| of(&run.metrics) - of(&first.metrics)).collect();
                MeanEstimate::of(&differences)
            })
        });
        PolicyFigures { policy, requests_per_hour, means, differences, runs }
    }

    /// Returns the number of requested missions of all runs.
    pub fn missions(&self) -> usize {
        self.runs.iter().map(|run| run.missions).sum()
    }

    /// Returns the number of completed missions of all runs.
    pub fn completed(&self) -> usize {
        self.runs.iter().map(|run| run.completed).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(seed: u64, completion_s: f64) -> ShiftFigures {
        let zero = ShiftMetrics::each(|_| 0.0);
        let metrics = ShiftMetrics { completion_s, ..zero };
        ShiftFigures { seed, missions: 10, completed: 9, late: 1, stranded: 0, charge_min: 0.5, metrics }
    }

    #[test]
    fn runs_are_compared_pair_by_pair() {
        let runs = |values: [f64; 3]| (1..).zip(values).map(|(seed, value)| run(seed, value)).collect();
        let first = PolicyFigures::of(ShiftPolicy::Instantaneous, None, runs([100.0, 200.0, 300.0]), None);
        assert_eq!((first.missions(), first.completed()), (30, 27));
        assert_eq!(first.differences, None);
        let second = PolicyFigures::of(ShiftPolicy::Consort, None, runs([90.0, 190.0, 290.0]), Some(&first));
        let interval = first.means.completion_s.interval.expect("three runs");
        assert!(interval.low < 0.0 && interval.high > 400.0, "the seeds differ much: {interval:?}");
        let difference = second.differences.expect("it is compared").completion_s;
        assert_eq!(difference.mean, -10.0);
        let interval = difference.interval.expect("three pairs");
        assert_eq!((interval.low, interval.high), (-10.0, -10.0), "each pair differs by the same time");
    }
}
