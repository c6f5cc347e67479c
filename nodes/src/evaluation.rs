//! A design with all that it names: scenarios, map and legs.

use crate::config::{Problem, Problems};
use crate::floor;
use crate::source::text;
use consort_sim::experiment::calibration::Calibration;
use consort_sim::experiment::design::{self, Design, Scenario};
use consort_sim::experiment::reference;
use consort_sim::experiment::travel::{Legs, TravelModel};
use consort_sim::map::{self, Map};
use consort_tests::experiment::Stage;
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
pub struct Instead<'a> {
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
    pub fn of(design: Design, instead: &Instead<'_>) -> Result<Evaluation, Problems> {
        let scenarios = match instead.scenarios {
            Some(file) => reference::scenarios(&text(file)?, &design).map_err(|problem| wrong(file, problem))?,
            None => design::scenarios(&design),
        };
        let map = match instead.map {
            Some(file) => load_map(&file.display().to_string())?,
            None => load_map(&design.map)?,
        };
        let travel = match instead.legs.or(design.travel.legs.as_deref()) {
            Some(file) => {
                let legs = Legs::read(text(file)?.as_bytes()).map_err(|problem| wrong(file, problem))?;
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
    pub fn stage(&self, design: Design, learned: Option<Arc<Calibration>>) -> Result<Stage, Problems> {
        let set = Stage::set(design, self.scenarios.clone(), self.map.clone(), self.travel.clone(), learned);
        set.map_err(|error| Problems(error.0.iter().map(|problem| Problem::of("", problem)).collect()))
    }
}

fn load_map(name: &str) -> Result<Map, Problems> {
    if floor::is_shipped(name) {
        return map::shipped(name).map_err(|problem| floor::problems(name, problem));
    }
    let text = floor::text(name)?;
    if floor::is_published_form(&text) {
        return reference::floor(&text, name).map_err(|problem| wrong(Path::new(name), problem));
    }
    map::read(&text, name).map_err(|problem| floor::problems(name, problem))
}

fn wrong(file: &Path, problem: impl Display) -> Problems {
    Problem::of(file.display(), problem).into()
}
