//! An evaluation design with its referenced files: scenarios, map and legs.

use consort_evaluation::design::{self, Design, Scenario};
use consort_evaluation::published_format;
use consort_evaluation::travel::{MeasuredLegs, TravelModel};
use consort_nodes::diagnostic::{Diagnostic, Diagnostics};
use consort_nodes::inputs::read_text;
use consort_nodes::map_loader;
use consort_skills::descriptor::Calibration;
use consort_skills::workload::Workload;
use consort_tests::experiment::ExperimentSetup;
use consort_world::map::{self, Map};
use std::fmt::Display;
use std::path::Path;
use std::sync::Arc;

/// An evaluation ready to run: a design with its referenced files.
pub(crate) struct Evaluation {
    /// The design.
    pub(crate) design: Design,
    /// The scenarios.
    pub(crate) scenarios: Vec<Scenario>,
    /// The map.
    pub(crate) map: Map,
    /// Durations of drives.
    pub(crate) travel: TravelModel,
    /// Missions of the user, and extensions.
    pub(crate) workload: Workload,
}

/// Files that override the design.
#[derive(Default)]
pub(crate) struct InputOverrides<'a> {
    /// Scenarios in the published format.
    pub(crate) scenarios: Option<&'a Path>,
    /// A map of any format.
    pub(crate) map: Option<&'a Path>,
    /// Measured legs.
    pub(crate) legs: Option<&'a Path>,
}

impl Evaluation {
    /// Checks a design, and reads the files that it references.
    ///
    /// # Errors
    /// [`Diagnostics`] of the design, without its file's name, or of a referenced file.
    pub(crate) fn load(
        design: Design,
        instead: &InputOverrides<'_>,
        workload: Workload,
    ) -> Result<Evaluation, Diagnostics> {
        let problems = design.validation_errors(&workload);
        Diagnostics::into_result(problems.into_iter().map(|problem| Diagnostic::for_file("", problem)).collect())?;
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
            Some(file) => TravelModel::Empirical(load_legs(file)?),
            None => TravelModel::Kinematic(design.travel.clone()),
        };
        Ok(Evaluation { design, scenarios, map, travel, workload })
    }

    /// Creates the fixture for trials of a design based on this evaluation, with learned
    /// corrections.
    ///
    /// # Errors
    /// [`Diagnostics`] of the design's map and mission, without the file's name.
    pub(crate) fn trial_fixture(
        &self,
        design: Design,
        calibration: Option<Arc<Calibration>>,
    ) -> Result<ExperimentSetup, Diagnostics> {
        let (scenarios, map, travel) = (self.scenarios.clone(), self.map.clone(), self.travel.clone());
        let set = ExperimentSetup::new(design, scenarios, map, travel, calibration, self.workload.clone());
        set.map_err(|error| Diagnostics(error.0.iter().map(|problem| Diagnostic::for_file("", problem)).collect()))
    }
}

/// Reads a file of measured drives.
///
/// # Errors
/// [`Diagnostics`] of the file, with the line.
pub(crate) fn load_legs(file: &Path) -> Result<MeasuredLegs, Diagnostics> {
    MeasuredLegs::read(read_text(file)?.as_bytes()).map_err(|problem| wrong(file, problem))
}

fn load_map(name: &str) -> Result<Map, Diagnostics> {
    if map_loader::is_shipped(name) {
        return map::shipped(name).map_err(|problem| map_loader::diagnostics(name, problem));
    }
    let text = map_loader::read_text(name)?;
    if map_loader::is_published_format(&text) {
        return published_format::published_map(&text, name).map_err(|problem| wrong(Path::new(name), problem));
    }
    consort_map_import::read(&text, name).map_err(|problem| map_loader::diagnostics(name, problem))
}

fn wrong(file: &Path, problem: impl Display) -> Diagnostics {
    Diagnostic::for_file(file.display(), problem).into()
}
