//! Shared setup of all trials of a design.

use consort_evaluation::design::{Design, Scenario};
use consort_evaluation::travel::TravelModel;
use consort_protocol::ensemble::{EnsembleSpec, Ensembles};
use consort_protocol::ids::TaskType;
use consort_protocol::mission::{Domain, MissionDocument};
use consort_skills::descriptor::{Calibration, DescriptorRegistry, Estimator};
use consort_skills::library::SkillLibrary;
use consort_skills::workload::Workload;
use consort_world::map::Map;
use std::sync::Arc;

/// Shared setup of all trials of a design.
pub struct ExperimentSetup {
    /// The design.
    pub design: Design,
    /// Its scenarios.
    pub scenarios: Vec<Scenario>,
    /// Duration of drives.
    pub travel: TravelModel,
    pub(super) map: Map,
    pub(super) domain: Arc<Domain>,
    pub(super) ensembles: Arc<Ensembles>,
    /// The mission and its extensions.
    pub(super) workload: Workload,
    pub(super) document: MissionDocument,
    /// The uncalibrated estimator, used by a coordinator without calibration.
    pub(super) standard: Arc<Estimator>,
    /// The estimator of the robots' bids.
    pub(super) estimator: Arc<Estimator>,
    pub(super) library: Arc<SkillLibrary>,
}

/// A design cannot be executed: all errors, each with its key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExperimentSetupError(pub Vec<String>);

impl std::fmt::Display for ExperimentSetupError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0.join("\n"))
    }
}

impl std::error::Error for ExperimentSetupError {}

impl ExperimentSetup {
    /// Builds the setup of a design on a map, with its scenarios and, if given, the calibration of
    /// the robots. `workload` has the missions that are not shipped, and the extensions of the standard domain.
    ///
    /// # Errors
    /// [`ExperimentSetupError`] with all errors of the design, or with the places that are not on
    /// the map.
    pub fn new(
        design: Design,
        scenarios: Vec<Scenario>,
        map: Map,
        travel: TravelModel,
        calibration: Option<Arc<Calibration>>,
        workload: Workload,
    ) -> Result<ExperimentSetup, ExperimentSetupError> {
        let extensions = workload.extensions;
        let task_types = extensions.domain();
        let document = workload.mission(&design.mission.name);
        let mut violations = design.validation_errors(&workload);
        if violations.is_empty() {
            for scenario in &scenarios {
                violations.extend(design.unknown_places(scenario, &map));
            }
        }
        let single_error = |error: String| ExperimentSetupError(vec![error]);
        if !violations.is_empty() {
            violations.dedup();
            return Err(ExperimentSetupError(violations));
        }
        let document = document.expect("the design is validated");
        let domain = task_types.with_places(map.topology().places.into_keys());
        for scenario in &scenarios {
            let in_scenario = |error: String| format!("scenario {}: {error}", scenario.code);
            match scenario.parameters(&design.mission).map(|given| document.instantiate(&given, &domain)) {
                Ok(Ok(_)) => {}
                Ok(Err(errors)) => {
                    violations.extend(errors.diagnostics.iter().map(|error| in_scenario(error.to_string())));
                }
                Err(error) => violations.push(in_scenario(error.to_string())),
            }
        }
        if !violations.is_empty() {
            return Err(ExperimentSetupError(violations));
        }
        let skills: std::collections::BTreeSet<TaskType> = domain.task_types().cloned().collect();
        let spec = EnsembleSpec::with_any_skill_of(crate::slug("robots"), skills);
        let ensembles = Ensembles::compile(vec![spec]).map_err(|error| single_error(error.to_string()))?;
        let environment = map.environment().map_err(|error| single_error(error.to_string()))?;
        let resolve = |registry: DescriptorRegistry| {
            registry.resolve(environment.clone()).map(Arc::new).map_err(|error| single_error(error.to_string()))
        };
        let descriptors = || extensions.descriptors(DescriptorRegistry::standard());
        let standard = resolve(descriptors())?;
        let estimator = match &calibration {
            Some(calibration) => resolve(calibration.correct(descriptors()))?,
            None => Arc::clone(&standard),
        };
        Ok(ExperimentSetup {
            design,
            scenarios,
            travel,
            map,
            domain: Arc::new(domain),
            ensembles: Arc::new(ensembles),
            workload,
            document,
            standard,
            estimator,
            library: Arc::new(extensions.library(environment).map_err(|error| single_error(error.to_string()))?),
        })
    }
}
