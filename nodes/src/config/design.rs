//! Designs of evaluations as files. What they say is in [`consort_sim::experiment::design`].

use super::read::{ConfigFile, settle_path, under};
use crate::floor::is_shipped;
use consort_sim::experiment::calibration::{Calibration, Factor};
use consort_sim::experiment::design::Design;
use std::path::Path;

impl ConfigFile for Design {
    const KIND: &'static str = "design";

    fn settle(&mut self, folder: &Path) {
        if !is_shipped(&self.map) {
            self.map = under(folder, Path::new(&self.map)).display().to_string();
        }
        settle_path(&mut self.travel.legs, folder);
    }

    fn problems(&self) -> Vec<String> {
        Design::problems(self)
    }
}

impl ConfigFile for Calibration {
    const KIND: &'static str = "calibration";

    fn settle(&mut self, _: &Path) {}

    fn problems(&self) -> Vec<String> {
        let skills = self.skills.iter().map(|(skill, factor)| (format!("skills.{skill}"), factor));
        let to = self.to.iter().map(|(place, factor)| (format!("to.{:?}", place.as_str()), factor));
        let from = self.from.iter().map(|(place, factor)| (format!("from.{:?}", place.as_str()), factor));
        let legs = self.legs.iter().map(|leg| (format!("legs, {} to {}", leg.from, leg.to), &leg.factor));
        let sound = |factor: &Factor| {
            let above = |number: f64| number.is_finite() && number > 0.0;
            above(factor.mean) && above(factor.upper) && factor.sd.is_finite() && factor.sd >= 0.0
        };
        let wrong = skills.chain(to).chain(from).chain(legs).filter(|(_, factor)| !sound(factor));
        let mut problems: Vec<String> = wrong
            .map(|(key, Factor { mean, sd, upper, .. })| {
                let allowed = "allowed are a mean and an upper quantile above 0, and a deviation of 0 or more";
                format!("{key}: mean {mean}, sd {sd}, upper {upper}; {allowed}")
            })
            .collect();
        if !(0.5..1.0).contains(&self.quantile) {
            problems.push(format!("quantile is {}, allowed is 0.5 to below 1", self.quantile));
        }
        problems
    }
}
