//! A design with all that it names: scenarios, map and legs.

use crate::config::{Diagnostic, Diagnostics};
use crate::inputs::read_text;
use crate::map_loader;
use consort_sim::experiment::calibration::Calibration;
use consort_sim::experiment::design::{self, Design, Scenario};
use consort_sim::experiment::published_format;
use consort_sim::experiment::travel::{MeasuredLegs, TravelModel};
use consort_sim::map::{self, Map};
use consort_tests::experiment::ExperimentSetup;
use std::fmt::Display;
use std::path::Path;
use std::sync::Arc;

/// An evaluation that could be begun: a design with all that it names.
pub struct Evaluation {
    /// The design.
    pub design: Design,
    /// What is tried.
    pub scenarios: Vec<Scenario>,
    /// Where.
    pub map: Map,
    /// How long drives take.
    pub travel: TravelModel,
}

/// Files that take the place of what the design says.
#[derive(Default)]
pub struct InputOverrides<'a> {
    /// Scenarios in the form of the published ones.
    pub scenarios: Option<&'a Path>,
    /// A map of any form.
    pub map: Option<&'a Path>,
    /// Measured legs.
    pub legs: Option<&'a Path>,
}

impl Evaluation {
    /// Reads what a design names.
    ///
    /// # Errors
    /// [`Problems`] of a file that it names.
    pub fn load(design: Design, instead: &InputOverrides<'_>) -> Result<Evaluation, Diagnostics> {
        let scenarios = match instead.scenarios {
            Some(file) => {
                published_format::scenarios(&read_text(file)?, &design).map_err(|problem| wrong(file, problem))?
            }
            None => design::scenarios(&design),
        };
        let map = match instead.map {
            Some(file) => load_map(&file.display().to_string())?,
            None => load_map(&design.map)?,
        };
        let travel = match instead.legs.or(design.travel.legs.as_deref()) {
            Some(file) => {
                let legs = MeasuredLegs::read(read_text(file)?.as_bytes()).map_err(|problem| wrong(file, problem))?;
                TravelModel::Empirical(legs)
            }
            None => TravelModel::Kinematic(design.travel.clone()),
        };
        Ok(Evaluation { design, scenarios, map, travel })
    }

    /// The stage on which trials of a design are played that is like this one's, with what was learned.
    ///
    /// # Errors
    /// [`Problems`] of what the design says of its map and mission, without the file's name.
    pub fn trial_fixture(
        &self,
        design: Design,
        learned: Option<Arc<Calibration>>,
    ) -> Result<ExperimentSetup, Diagnostics> {
        let set = ExperimentSetup::new(design, self.scenarios.clone(), self.map.clone(), self.travel.clone(), learned);
        set.map_err(|error| Diagnostics(error.0.iter().map(|problem| Diagnostic::for_file("", problem)).collect()))
    }
}

fn load_map(name: &str) -> Result<Map, Diagnostics> {
    if map_loader::is_shipped(name) {
        return map::shipped(name).map_err(|problem| map_loader::diagnostics(name, problem));
    }
    let text = map_loader::read_text(name)?;
    if map_loader::is_published_format(&text) {
        return published_format::published_map(&text, name).map_err(|problem| wrong(Path::new(name), problem));
    }
    map::read(&text, name).map_err(|problem| map_loader::diagnostics(name, problem))
}

fn wrong(file: &Path, problem: impl Display) -> Diagnostics {
    Diagnostic::for_file(file.display(), problem).into()
}
