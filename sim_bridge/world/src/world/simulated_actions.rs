//! Checks of the systems that declarations of actions name.
//!
//! A system with goals of several kinds, such as docking, has a name for each: `as` in the declaration. The
//! parameters of a kind are those of the standard action of this name.

use super::action_systems::{ActionSystem, ActionSystems};
use super::setup::{ProgramParts, SetupError, SetupErrors};
use super::system::System;
use super::system_access::SystemIndex;
use super::systems::{self, declared_actions::DeclaredActions};
use consort_protocol::ids::ActionName;
use consort_skills::domain::standard_domain;
use consort_skills::domain_file::{ActionForm, DomainFile, ParameterForm, SimulatedAction};
use consort_skills::extensions::Extensions;
use consort_text::AllowedNames;
use serde_json::json;
use std::collections::BTreeMap;

/// Creates the table of the systems from checked declarations. Actions whose system is not part of the world are
/// left out.
pub(super) fn systems_of_actions(
    actions: &BTreeMap<ActionName, ActionForm>,
    systems: &[&'static dyn System],
) -> ActionSystems {
    let executed = |(action, form): (&ActionName, &ActionForm)| {
        let name = form.simulate.system.as_deref().unwrap_or(DeclaredActions.name());
        let index = systems.iter().position(|system| system.name() == name)?;
        let kind = goal_kind(action, &form.simulate, systems[index]).ok()?;
        let cancel = form.cancel.as_ref().filter(|_| form.simulate.system.is_none());
        let cancel_s = cancel.map_or(0.0, |cancel| cancel.within_s);
        Some((action.clone(), ActionSystem { index: SystemIndex(index), kind, cancel_s }))
    };
    actions.iter().filter_map(executed).collect()
}

/// Checks that this program simulates the actions of a domain.
///
/// # Errors
/// [`SetupErrors`] with each action that its system cannot execute, and with the unusable parts of the
/// program.
pub fn check_simulated_actions(domain: &DomainFile, extensions: Extensions) -> Result<(), SetupErrors> {
    let (actions, program) = (domain.simulated_actions().collect(), ProgramParts(extensions.simulator));
    let mut errors = program.unusable_parts();
    errors.extend(action_errors(&actions, program));
    if errors.is_empty() { Ok(()) } else { Err(SetupErrors(errors)) }
}

/// Returns the errors in the declarations of actions that name a system.
pub(super) fn action_errors(actions: &BTreeMap<ActionName, ActionForm>, program: ProgramParts) -> Vec<SetupError> {
    let named = actions.iter().filter_map(|(action, form)| Some((action, form, form.simulate.system.as_deref()?)));
    named.flat_map(|(action, form, name)| errors_of_action(action, form, name, program)).collect()
}

fn errors_of_action(action: &ActionName, form: &ActionForm, name: &str, program: ProgramParts) -> Vec<SetupError> {
    let error =
        |key: &str, problem| SetupError::ActionOfSystem { action: action.clone(), key: key.to_owned(), problem };
    let Some(system) = program.system(name) else {
        return vec![SetupError::UnknownActionSystem {
            action: action.clone(),
            name: name.to_owned(),
            known: program.system_names().collect::<Vec<_>>().join(", "),
            hint: crate::suggest::did_you_mean(name, program.system_names()),
        }];
    };
    if system.goal_kinds().is_empty() && systems::by_name(name).is_some() {
        return vec![error("simulate.system", format!("the system {name} executes no goals of actions"))];
    }
    match goal_kind(action, &form.simulate, system) {
        Ok(kind) => {
            let problems = parameter_problems(form, &kind).into_iter();
            problems.map(|(name, problem)| error(&format!("parameters.{name}"), problem)).collect()
        }
        Err(problem) => vec![error("simulate.as", problem)],
    }
}

/// Returns the system's name for goals of an action: `as`, or the name of the action, or the only name.
fn goal_kind(action: &ActionName, simulate: &SimulatedAction, system: &dyn System) -> Result<ActionName, String> {
    let kinds = system.goal_kinds();
    let is_kind = |name: &ActionName| kinds.contains(&name.as_str());
    let allowed = |name: &ActionName| AllowedNames::suggest_for(name.as_str(), kinds);
    match (&simulate.goal_kind, kinds) {
        (Some(kind), _) if is_kind(kind) => Ok(kind.clone()),
        (Some(_), []) => Err(format!("the system {} has a single kind of goals; omit `as`", system.name())),
        (Some(kind), _) => Err(format!("the system {} has no goals {kind}; {}", system.name(), allowed(kind))),
        (None, []) => Ok(action.clone()),
        (None, _) if is_kind(action) => Ok(action.clone()),
        (None, [kind]) => Ok(ActionName::new(*kind).expect("the name of an action is a slug")),
        (None, _) => Err(format!("the system {} has several kinds of goals; {}", system.name(), allowed(action))),
    }
}

/// Returns the parameters that goals of this kind cannot have, with the reasons. They must be those of the
/// standard action; a kind of a program has any parameters.
fn parameter_problems(form: &ActionForm, kind: &ActionName) -> Vec<(String, String)> {
    let Some((_, standard)) = standard_domain().action_forms().find(|(name, _)| *name == kind) else { return vec![] };
    let is_missing = |name: &String| form.parameters.get(name).is_none_or(|own| own.optional);
    let required = standard.parameters.iter().filter(|(_, read)| !read.optional).map(|(name, _)| name);
    let missing = required.filter(|name| is_missing(name)).map(|name| (name, format!("{kind} needs this parameter")));
    let wrong = form.parameters.iter().filter_map(|(name, own)| match standard.parameters.get(name) {
        Some(read) => Some((name, parameter_problem(own, read, kind)?)),
        None => {
            let known = AllowedNames::suggest_for(name, standard.parameters.keys());
            Some((name, format!("{kind} has no such parameter; {known}")))
        }
    });
    missing.chain(wrong).map(|(name, problem)| (name.clone(), problem)).collect()
}

fn parameter_problem(own: &ParameterForm, read: &ParameterForm, kind: &ActionName) -> Option<String> {
    if own.kind != read.kind {
        return Some(format!("{kind} has this parameter with the type {}", json!(read.kind)));
    }
    let is_allowed = read.one_of.is_empty() || !own.one_of.is_empty() && own.one_of.is_subset(&read.one_of);
    (!is_allowed).then(|| format!("`one_of` of this parameter of {kind} is {}", json!(read.one_of)))
}
