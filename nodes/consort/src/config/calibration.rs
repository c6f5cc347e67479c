//! Configuration files of calibrations: see [`consort_evaluation::calibration`].

use super::read::ConfigFile;
use consort_evaluation::calibration::{Calibration, TimeFactor};
use consort_protocol::mission::Domain;
use std::path::Path;

impl ConfigFile for Calibration {
    const KIND: &'static str = "calibration";

    fn resolve_paths(&mut self, _: &Path) {}

    fn validate(&self, _: &Domain) -> Vec<String> {
        let skills = self.skills.iter().map(|(skill, factor)| (format!("skills.{skill}"), factor));
        let to = self.to.iter().map(|(place, factor)| (format!("to.{:?}", place.as_str()), factor));
        let from = self.from.iter().map(|(place, factor)| (format!("from.{:?}", place.as_str()), factor));
        let legs = self.legs.iter().map(|leg| (format!("legs, {} to {}", leg.from, leg.to), &leg.factor));
        let sound = |factor: &TimeFactor| {
            let above = |number: f64| number.is_finite() && number > 0.0;
            above(factor.mean) && above(factor.upper) && factor.sd.is_finite() && factor.sd >= 0.0
        };
        let wrong = skills.chain(to).chain(from).chain(legs).filter(|(_, factor)| !sound(factor));
        let mut validate: Vec<String> = wrong
            .map(|(key, TimeFactor { mean, sd, upper, .. })| {
                let allowed = "allowed are a mean and an upper quantile above 0, and a deviation of 0 or more";
                format!("{key}: mean {mean}, sd {sd}, upper {upper}; {allowed}")
            })
            .collect();
        if !(0.5..1.0).contains(&self.quantile) {
            validate.push(format!("quantile is {}, allowed is 0.5 to below 1", self.quantile));
        }
        validate
    }
}
