//! Trend of the charge of a robot, as measured by its reports, and the time of the next threshold.

use consort_protocol::view::ChargingView;
use serde::Serialize;
use std::collections::VecDeque;

/// Minimum time between two samples, in milliseconds.
const SAMPLE_MS: u64 = 5_000;

/// Time without a sample after which the trend begins again, in milliseconds.
const GAP_MS: u64 = 60_000;

/// Maximum number of samples: ten minutes. Raised: the rate is steadier, and follows changes later.
const SAMPLES_MAX: usize = 120;

/// Smallest change of the charge that gives a rate, as a share: batteries report steps of a hundredth.
const CHANGE_MIN: f64 = 0.01;

/// Samples of the charge of a robot during an activity.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct ChargeTrend {
    /// Times in milliseconds, and shares.
    samples: VecDeque<(u64, f64)>,
}

/// Time at which the charge of a robot reaches a threshold, at the measured rate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChargeForecast {
    /// The threshold, as a share.
    pub share: f64,
    /// The time.
    pub at_ms: u64,
}

impl ChargeTrend {
    /// Adds a sample. Returns false if the latest is too recent.
    pub(super) fn observe(&mut self, share: f64, now_ms: u64) -> bool {
        if let Some((latest_ms, _)) = self.samples.back() {
            match now_ms.saturating_sub(*latest_ms) {
                0..SAMPLE_MS => return false,
                SAMPLE_MS..=GAP_MS => {}
                _ => self.samples.clear(),
            }
        }
        self.samples.push_back((now_ms, share));
        if self.samples.len() > SAMPLES_MAX {
            self.samples.pop_front();
        }
        true
    }

    /// Returns the next threshold of the charge: of a charge that falls, the charge at which a free robot charges, or
    /// below which the robot takes no work; of a charge that rises, the charge that is enough, or a full battery.
    pub(super) fn forecast(&self, useful_charge: f64, charging: Option<&ChargingView>) -> Option<ChargeForecast> {
        let ((from_ms, from), (now_ms, now)) = (*self.samples.front()?, *self.samples.back()?);
        let change = now - from;
        if change.abs() < CHANGE_MIN {
            return None;
        }
        let next = if change < 0.0 {
            let below = charging.map(|charging| charging.below.get());
            [Some(useful_charge), below].into_iter().flatten().filter(|share| *share < now).max_by(f64::total_cmp)
        } else {
            let until = charging.map(|charging| charging.until.get());
            [Some(1.0), until].into_iter().flatten().filter(|share| *share > now).min_by(f64::total_cmp)
        };
        let share = next?;
        let left_ms = (share - now) / change * now_ms.saturating_sub(from_ms) as f64;
        Some(ChargeForecast { share, at_ms: now_ms.saturating_add(left_ms.round() as u64) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::units::BatteryShare;

    const NOW: u64 = 1_000_000;

    fn charging() -> ChargingView {
        let share = |share| BatteryShare::new(share).unwrap();
        ChargingView { below: share(0.3), until: share(0.9), opportunistic: None, chargers: vec![] }
    }

    /// Returns the forecast after these charges, 10 s apart.
    fn after(charges: &[f64], charging: Option<&ChargingView>) -> Option<(f64, u64)> {
        let mut trend = ChargeTrend::default();
        for (index, charge) in (0..).zip(charges) {
            assert!(trend.observe(*charge, NOW + index * 10_000));
        }
        let forecast = trend.forecast(0.08, charging)?;
        Some((forecast.share, forecast.at_ms - NOW))
    }

    #[test]
    fn the_next_threshold_is_reached_at_the_measured_rate() {
        let settings = charging();
        let charging = Some(&settings);
        assert_eq!(after(&[0.5, 0.45, 0.4], charging), Some((0.3, 40_000)), "a free robot charges");
        assert_eq!(after(&[0.3, 0.28], charging), Some((0.08, 110_000)), "it takes no work");
        assert_eq!(after(&[0.5, 0.4], None), Some((0.08, 42_000)));
        assert_eq!(after(&[0.06, 0.04], charging), None, "no threshold is left");
        assert_eq!(after(&[0.5, 0.7], charging), Some((0.9, 20_000)), "it has charged enough");
        assert_eq!(after(&[0.94, 0.96], charging), Some((1.0, 30_000)));
        assert_eq!(after(&[0.5], charging), None, "there is no rate yet");
        assert_eq!(after(&[0.5, 0.495], charging), None);
    }

    #[test]
    fn samples_are_spaced_bounded_and_end_with_a_gap() {
        let mut trend = ChargeTrend::default();
        assert!(trend.observe(0.9, NOW) && !trend.observe(0.8, NOW + 4_999) && trend.observe(0.8, NOW + 5_000));
        assert!(trend.observe(0.7, NOW + 65_001));
        assert_eq!(trend.samples, [(NOW + 65_001, 0.7)]);
        for number in 1..200 {
            trend.observe(0.7, NOW + 65_001 + number * SAMPLE_MS);
        }
        assert_eq!(trend.samples.len(), SAMPLES_MAX);
    }
}
