//! Checks of the feedback of a goal, of the items that it moves, and of its cancel.

use super::form::{ActionForm, CancelForm, ItemHolder, ParameterForm, ParameterKind, SimulatedMove};
use super::reading_problems::passed_value_problem;
use super::{DomainProblem, problem, returned_problems};
use consort_protocol::mission::RESULTS_MAX;
use consort_protocol::scalar::NAME_BYTES_MAX;
use consort_text::AllowedNames;

/// Returns the problem of the `cancel` of an action. The upper limit bounds the time for which a robot that has lost
/// its role continues.
pub(super) fn cancel_problem(place: &str, action: &ActionForm) -> Option<DomainProblem> {
    let CancelForm { within_s } = action.cancel.as_ref()?;
    let allowed = || problem(format!("{place}.cancel.within_s"), "allowed are seconds from 0.1 to 60");
    (!(0.1..=60.0).contains(within_s)).then(allowed)
}

/// Returns the problems of the feedback of an action.
pub(super) fn feedback_problems(place: &str, action: &ActionForm) -> Vec<DomainProblem> {
    let (feedback, simulated) = (&action.feedback, &action.simulate.feedback);
    let mut problems = returned_problems(&format!("{place}.feedback"), "feedback", feedback);
    for name in feedback.keys().filter(|name| name.len() > NAME_BYTES_MAX) {
        let allowed = format!("allowed are at most {NAME_BYTES_MAX} letters");
        problems.push(problem(format!("{place}.feedback.{name}"), allowed));
    }
    if feedback.len() > RESULTS_MAX {
        let wrong = format!("{} values; at most {RESULTS_MAX} are allowed", feedback.len());
        problems.push(problem(format!("{place}.feedback"), wrong));
    }
    if action.by_people && !feedback.is_empty() {
        problems.push(problem(format!("{place}.feedback"), "people perform the action, and only robots have feedback"));
    }
    for (name, value) in simulated {
        let wrong = match (&action.simulate.system, feedback.get(name)) {
            (Some(system), _) => Some(format!("the system {system} determines the feedback; omit it")),
            (None, Some(form)) => passed_value_problem("feedback", form, value),
            (None, None) => Some(format!("no such feedback; {}", AllowedNames::suggest_for(name, feedback.keys()))),
        };
        problems.extend(wrong.map(|wrong| problem(format!("{place}.simulate.feedback.{name}"), wrong)));
    }
    problems
}

/// Returns the problems of the items that an action moves.
pub(super) fn move_problems(place: &str, action: &ActionForm) -> Vec<DomainProblem> {
    let Some(moves) = &action.simulate.moves else { return vec![] };
    let place = format!("{place}.simulate.moves");
    let SimulatedMove { from, to, item, robot, otherwise } = moves;
    let mut problems = vec![];
    if let Some(system) = &action.simulate.system {
        problems.push(problem(&place, format!("the system {system} determines what a goal moves; omit `moves`")));
    }
    if action.by_people {
        problems.push(problem(&place, "people perform the action, and only robots have `moves`"));
    }
    if !action.may_move_items() {
        problems.push(problem(&place, "an action that moves items needs `hands_over: true`"));
    }
    if from == to {
        problems.push(problem(&place, "`from` and `to` are the same; allowed are two different holders"));
    }
    if let Some(name) = item {
        problems.extend(parameter_problem(&place, "item", action, name, ParameterKind::Text));
    }
    let needs_robot = [from, to].contains(&&ItemHolder::OtherContainer);
    match robot {
        Some(_) if !needs_robot => {
            problems.push(problem(format!("{place}.robot"), "only `other_container` has a robot; omit `robot`"));
        }
        Some(name) => problems.extend(parameter_problem(&place, "robot", action, name, ParameterKind::Robot)),
        None if needs_robot => {
            let needed = "`other_container` needs `robot`: a parameter of type robot";
            problems.push(problem(&place, needed));
        }
        None => {}
    }
    if let Some(reason) = otherwise.as_ref().filter(|reason| !action.failures.contains_key(*reason)) {
        let known = AllowedNames::suggest_for(reason, action.failures.keys());
        problems.push(problem(format!("{place}.otherwise"), format!("no such failure; {known}")));
    }
    problems
}

/// Returns the problem of a name that must be a parameter of this type. A goal always has the parameter.
fn parameter_problem(
    place: &str,
    key: &str,
    action: &ActionForm,
    name: &str,
    kind: ParameterKind,
) -> Option<DomainProblem> {
    let is_allowed = |form: &ParameterForm| form.kind == kind && !form.optional;
    if action.parameters.get(name).is_some_and(is_allowed) {
        return None;
    }
    let allowed = action.parameters.iter().filter(|(_, form)| is_allowed(form)).map(|(name, _)| name);
    let known = AllowedNames::suggest_for(name, allowed);
    let kind = serde_json::json!(kind);
    let wrong = format!("no parameter with the type {kind} that is not `optional`; {known}");
    Some(problem(format!("{place}.{key}"), wrong))
}
