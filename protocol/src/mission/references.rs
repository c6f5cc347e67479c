//! Validation of references between tasks: conditions, inputs, and results of missions.

use super::condition;
use super::diagnostic::{MissionDiagnostic, MissionErrorKind};
use super::domain::Domain;
use super::limits::{CONDITIONS_MAX, ENTRIES_MAX};
use super::model::{Mission, ResultReference, TaskBody, TaskSpec};
use super::order::GlobalOrder;
use super::outcome::{OUTCOMES_BYTES_MAX, RESULTS_MAX};
use super::structure::{at, paths, specs};
use crate::ids::TaskId;
use consort_text::AllowedNames;
use std::collections::BTreeMap;

/// Returns the problems of all references of a mission with a valid order.
pub(super) fn reference_problems(
    mission: &Mission,
    order: &GlobalOrder<'_>,
    domain: &Domain,
) -> Vec<MissionDiagnostic> {
    let numbers: BTreeMap<&TaskId, usize> = (0..order.len()).map(|task| (order.id(task), task)).collect();
    let check = ReferenceCheck { order, numbers, domain };
    let mut found = vec![];
    let paths = paths(mission);
    for (node, path) in mission.tasks.iter().zip(&paths) {
        for (path, id, spec) in specs(&node.id, &node.body, path) {
            let problems = match node.body {
                TaskBody::Elementary(_) => check.task(id, spec),
                TaskBody::Abstract(_) if spec.inputs.is_empty() && spec.conditions.is_empty() => vec![],
                TaskBody::Abstract(_) => vec![MissionErrorKind::AlternativeUsesResults],
            };
            found.extend(problems.into_iter().map(|kind| at(&path, kind)));
        }
    }
    let bytes: usize = (0..order.len()).map(|task| check.outcome_bytes_max(task)).sum();
    if bytes > OUTCOMES_BYTES_MAX {
        found.push(at("root", MissionErrorKind::LargeResults { bytes, max: OUTCOMES_BYTES_MAX }));
    }
    if mission.results.len() > RESULTS_MAX {
        let (what, count) = ("results", mission.results.len());
        found.push(at("result", MissionErrorKind::TooManyEntries { what, found: count, max: RESULTS_MAX }));
    }
    for (name, text) in &mission.results {
        let path = format!("result/{name}");
        found.extend(check.expression(text, None).into_iter().map(|kind| at(&path, kind)));
    }
    found
}

struct ReferenceCheck<'a> {
    order: &'a GlobalOrder<'a>,
    /// Numbers of the elementary tasks.
    numbers: BTreeMap<&'a TaskId, usize>,
    domain: &'a Domain,
}

impl ReferenceCheck<'_> {
    fn task(&self, id: &TaskId, spec: &TaskSpec) -> Vec<MissionErrorKind> {
        let mut found = vec![];
        for (what, count, max) in
            [("conditions", spec.conditions.len(), CONDITIONS_MAX), ("inputs", spec.inputs.len(), ENTRIES_MAX)]
        {
            if count > max {
                found.push(MissionErrorKind::TooManyEntries { what, found: count, max });
            }
        }
        for text in &spec.conditions {
            found.extend(self.expression(text, Some(id)));
        }
        if let Some(item) = spec.items().next().filter(|_| !spec.conditions.is_empty()) {
            found.push(MissionErrorKind::ConditionalItem { item: item.clone() });
        }
        for (name, input) in &spec.inputs {
            found.extend(self.input(id, spec, name, input));
        }
        found
    }

    /// Returns the maximum size of the outcome of a task in bytes.
    fn outcome_bytes_max(&self, task: usize) -> usize {
        let Some(schema) = self.domain.get(&self.order.spec(task).task_type) else { return 0 };
        let results = schema.results.iter().map(|(name, kind)| name.len() + 2 + kind.result_bytes_max());
        let results: usize = results.sum();
        if results == 0 { 0 } else { self.order.id(task).as_str().len() + 4 + results }
    }

    /// Checks an expression of a task, or of the mission's result.
    fn expression(&self, text: &str, user: Option<&TaskId>) -> Vec<MissionErrorKind> {
        let used = match condition::results_used(text) {
            Ok(used) => used,
            Err(problem) => return vec![MissionErrorKind::Expression { text: text.to_owned(), problem }],
        };
        let problem = |(task, result): (TaskId, Option<String>)| match self.used_task(&task, user) {
            Ok(spec) => result.and_then(|result| self.unknown_result(&task, spec, &result)),
            Err(kind) => Some(kind),
        };
        used.into_iter().filter_map(problem).collect()
    }

    fn input(
        &self,
        id: &TaskId,
        spec: &TaskSpec,
        name: &str,
        ResultReference { task, result }: &ResultReference,
    ) -> Option<MissionErrorKind> {
        let used = match self.used_task(task, Some(id)) {
            Ok(used) => used,
            Err(kind) => return Some(kind),
        };
        if let Some(kind) = self.unknown_result(task, used, result) {
            return Some(kind);
        }
        // An unknown type or parameter is reported with the task.
        let found = self.domain.get(&used.task_type)?.results.get(result)?;
        let wanted = &self.domain.get(&spec.task_type)?.parameters.get(name)?.kind;
        (!found.may_become(wanted)).then(|| MissionErrorKind::ResultKind {
            name: name.to_owned(),
            kind: wanted.to_string(),
            task: task.clone(),
            result: result.clone(),
            found: found.to_string(),
        })
    }

    /// Returns the task whose result is used by `user`, or by the mission's result.
    fn used_task(&self, task: &TaskId, user: Option<&TaskId>) -> Result<&TaskSpec, MissionErrorKind> {
        let Some(&number) = self.numbers.get(task) else {
            let allowed = AllowedNames::suggest_for(task.as_str(), self.numbers.keys());
            return Err(MissionErrorKind::UnknownTask { task: task.to_string(), allowed });
        };
        match user.and_then(|user| self.numbers.get(user)) {
            Some(&user) if !self.order.precedes(number, user) => {
                Err(MissionErrorKind::LaterTask { task: task.clone() })
            }
            _ => Ok(self.order.spec(number)),
        }
    }

    fn unknown_result(&self, task: &TaskId, spec: &TaskSpec, result: &str) -> Option<MissionErrorKind> {
        let results = &self.domain.get(&spec.task_type)?.results;
        (!results.contains_key(result)).then(|| MissionErrorKind::UnknownResult {
            task: task.clone(),
            result: result.to_owned(),
            task_type: spec.task_type.clone(),
            allowed: AllowedNames::suggest_for(result, results.keys()),
        })
    }
}
