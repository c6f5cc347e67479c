//! Tasks of a robot that belong to no plan: drives to chargers, parking places and assembly places, with their
//! estimates.

use super::skill_runner::RunningSkill;
use super::task_timeout::TaskTimer;
use consort_protocol::ids::{PlaceId, RoleId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::Seconds;
use consort_skills::descriptor::{EstimateContext, Estimator};
use consort_skills::environment::Routes;

/// Type of the task of driving to a place, in the standard domain.
const DRIVE: &str = "navigation";

/// A running task.
pub(super) struct OwnTask {
    pub(super) spec: TaskSpec,
    pub(super) skill: RunningSkill,
    pub(super) timer: TaskTimer,
}

/// A drive with its estimated cost.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drive {
    pub(super) to: PlaceId,
    pub(super) time: Seconds,
    /// Charge that the drive needs, with the energy margin of the estimator, as a share of a full battery.
    pub(super) energy: f64,
}

/// Returns the drives to those of the places that can be reached, the nearest first.
pub(super) fn nearest<'a>(
    estimator: &Estimator,
    context: &EstimateContext,
    places: impl IntoIterator<Item = &'a PlaceId>,
) -> Vec<Drive> {
    let drive = |to: &PlaceId| {
        let estimate = estimator.estimate(&drive_to(to), context).ok()?;
        let energy = estimate.energy + estimator.margin_sds() * estimate.energy_sd;
        Some(Drive { to: to.clone(), time: estimate.time, energy })
    };
    let mut drives: Vec<Drive> = places.into_iter().filter_map(drive).collect();
    drives.sort_by(|one, other| one.time.get().total_cmp(&other.time.get()).then_with(|| one.to.cmp(&other.to)));
    drives
}

/// Returns all places of the map; none if the robot has no routes.
pub(super) fn places(estimator: &Estimator) -> impl Iterator<Item = &PlaceId> {
    estimator.environment().find::<Routes>().into_iter().flat_map(Routes::places)
}

/// Returns the task of driving to a place.
pub(super) fn drive_to(place: &PlaceId) -> TaskSpec {
    task(DRIVE, "to", place)
}

/// Checks whether a task is a drive to a place.
pub(super) fn is_drive(task: &TaskSpec) -> bool {
    task.task_type.as_str() == DRIVE
}

/// Returns the task of connecting to a charger.
pub(super) fn dock_at(charger: &PlaceId) -> TaskSpec {
    task("dock", "charger", charger)
}

/// Returns a task of the standard domain. It belongs to no mission, so its role has no meaning.
fn task(task_type: &str, parameter: &str, place: &PlaceId) -> TaskSpec {
    let (task_type, role) = (TaskType::new(task_type).expect("a slug"), RoleId::new("self").expect("a slug"));
    let mut task = TaskSpec::of(task_type, vec![role]);
    task.parameters.insert(parameter.to_owned(), place.as_str().to_owned());
    task
}
