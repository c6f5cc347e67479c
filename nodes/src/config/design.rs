//! Designs of evaluations as files. What they say is in [`consort_sim::experiment::design`].

use super::read::{ConfigFile, settle_path, under};
use crate::floor::is_shipped;
use consort_sim::experiment::calibration::Calibration;
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
        let factors = self.skills.values().chain(self.to.values()).chain(self.from.values());
        let factors = factors.chain(self.legs.iter().map(|leg| &leg.factor));
        let sound = |number: f64| number.is_finite() && number > 0.0;
        let wrong = factors.filter(|factor| !(sound(factor.mean) && sound(factor.upper)));
        wrong
            .map(|factor| {
                format!("a factor of {} or {} is none: allowed are numbers above 0", factor.mean, factor.upper)
            })
            .collect()
    }
}
