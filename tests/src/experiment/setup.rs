//! What all trials of a design share.

use consort_protocol::ensemble::{Ensemble, EnsembleSpec};
use consort_protocol::ids::TaskType;
use consort_protocol::mission::{Domain, MissionTemplate, shipped};
use consort_sim::experiment::calibration::Calibration;
use consort_sim::experiment::design::{Design, Scenario};
use consort_sim::experiment::travel::TravelModel;
use consort_sim::map::Map;
use consort_skills::descriptor::{DescriptorRegistry, Estimator};
use consort_skills::library::SkillLibrary;
use std::sync::Arc;

/// What all trials of a design share.
pub struct ExperimentSetup {
    /// The design.
    pub design: Design,
    /// Its scenarios.
    pub scenarios: Vec<Scenario>,
    /// How long drives take.
    pub travel: TravelModel,
    pub(super) map: Map,
    pub(super) domain: Arc<Domain>,
    pub(super) ensemble: Arc<Ensemble>,
    pub(super) template: MissionTemplate,
    /// Without what was learned: what a coordinator that knows no better reckons with.
    pub(super) standard: Arc<Estimator>,
    /// What robots bid with.
    pub(super) estimator: Arc<Estimator>,
    pub(super) library: Arc<SkillLibrary>,
}

/// Why a design cannot be carried out: all that is wrong, each with its key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExperimentSetupError(pub Vec<String>);

impl std::fmt::Display for ExperimentSetupError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0.join("\n"))
    }
}

impl std::error::Error for ExperimentSetupError {}

impl ExperimentSetup {
    /// A design on a map, with its scenarios, and what robots have learned if they have.
    ///
    /// # Errors
    /// [`StageError`] with all that is wrong with the design, or places that are not on the map.
    pub fn new(
        design: Design,
        scenarios: Vec<Scenario>,
        map: Map,
        travel: TravelModel,
        learned: Option<Arc<Calibration>>,
    ) -> Result<ExperimentSetup, ExperimentSetupError> {
        let mut problems = design.validation_errors();
        if problems.is_empty() {
            for scenario in &scenarios {
                problems.extend(design.unknown_places(scenario, &map));
            }
        }
        let whole = |problem: String| ExperimentSetupError(vec![problem]);
        if !problems.is_empty() {
            problems.dedup();
            return Err(ExperimentSetupError(problems));
        }
        let template = shipped().get(&design.mission.name).cloned();
        let template = template.ok_or_else(|| whole(format!("no mission {} is shipped", design.mission.name)))?;
        let domain = Domain::hospital().with_places(map.topology().places.into_keys());
        for scenario in &scenarios {
            let of = |problem: String| format!("scenario {}: {problem}", scenario.code);
            match scenario.parameters(&design.mission).map(|given| template.instantiate(&given, &domain)) {
                Ok(Ok(_)) => {}
                Ok(Err(errors)) => problems.extend(errors.diagnostics.iter().map(|problem| of(problem.to_string()))),
                Err(problem) => problems.push(of(problem.to_string())),
            }
        }
        if !problems.is_empty() {
            return Err(ExperimentSetupError(problems));
        }
        let skills: std::collections::BTreeSet<TaskType> = domain.task_types().cloned().collect();
        let spec = EnsembleSpec::with_any_skill_of(crate::slug("robots"), skills);
        let ensemble = Ensemble::compile(spec).map_err(|problem| whole(problem.to_string()))?;
        let environment = map.environment().map_err(|problem| whole(problem.to_string()))?;
        let resolve = |registry: DescriptorRegistry| {
            registry.resolve(environment.clone()).map(Arc::new).map_err(|problem| whole(problem.to_string()))
        };
        let standard = resolve(DescriptorRegistry::standard())?;
        let estimator = match &learned {
            Some(learned) => resolve(learned.descriptors())?,
            None => Arc::clone(&standard),
        };
        Ok(ExperimentSetup {
            design,
            scenarios,
            travel,
            map,
            domain: Arc::new(domain),
            ensemble: Arc::new(ensemble),
            template,
            standard,
            estimator,
            library: Arc::new(SkillLibrary::standard(environment)),
        })
    }
}
