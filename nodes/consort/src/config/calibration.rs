//! Configuration files of calibrations: see [`Calibration`].

use super::read::ConfigFile;
use consort_protocol::mission::Domain;
use consort_skills::descriptor::Calibration;
use std::path::Path;

impl ConfigFile for Calibration {
    const KIND: &'static str = "calibration";

    fn resolve_paths(&mut self, _: &Path) {}

    fn validate(&self, _: &Domain) -> Vec<String> {
        self.validation_errors()
    }
}
