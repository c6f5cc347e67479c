//! Checks of readings, and of the effects of simulated goals on them.

use super::form::{Addition, ParameterForm, ReadingForm, SimulatedEffect, SimulatedResult};
use super::{DomainProblem, problem, value_problems};
use crate::actions::READINGS_MAX;
use consort_protocol::ids::ActionName;
use consort_protocol::scalar::{NAME_BYTES_MAX, Scalar};
use consort_text::AllowedNames;
use std::collections::BTreeMap;

/// Returns the problems of the readings of a domain. `number` is that of the readings of all domains.
pub(super) fn reading_problems(readings: &BTreeMap<String, ReadingForm>, number: usize) -> Vec<DomainProblem> {
    let mut problems = value_problems("readings", readings.iter().map(|(name, reading)| (name, &reading.value)));
    for (name, reading) in readings {
        let place = format!("readings.{name}");
        if name.len() > NAME_BYTES_MAX {
            problems.push(problem(&place, format!("allowed are at most {NAME_BYTES_MAX} letters")));
        }
        if !reading.value.kind.is_value() {
            problems.push(problem(&place, "allowed are place, seconds, number, integer, bool and text"));
        }
        if reading.value.optional {
            problems.push(problem(&place, "a reading is not `optional`"));
        }
        let simulated = reading.simulate.value.as_ref();
        let wrong = simulated.and_then(|value| value_problem("reading", &reading.value, value));
        problems.extend(wrong.map(|wrong| problem(format!("{place}.simulate.value"), wrong)));
    }
    if number > READINGS_MAX {
        let wrong = format!("{number} readings in all domains; at most {READINGS_MAX} are allowed");
        problems.push(problem("readings", wrong));
    }
    problems
}

/// Returns the problems of the effects of an action on these readings.
pub(super) fn effect_problems(
    action: &ActionName,
    effects: &BTreeMap<String, SimulatedEffect>,
    readings: &BTreeMap<&str, &ReadingForm>,
) -> Vec<DomainProblem> {
    let wrong = effects.iter().filter_map(|(name, effect)| {
        let wrong = match (readings.get(name.as_str()), effect) {
            (None, _) => {
                let known = AllowedNames::suggest_for(name, readings.keys());
                Some(format!("the domain declares no such reading; {known}"))
            }
            (Some(reading), SimulatedEffect::Set(value)) => value_problem("reading", &reading.value, value),
            (Some(reading), SimulatedEffect::Add(Addition { add })) => {
                let is_number = reading.value.nearest(0.0).is_some() && add.is_finite();
                let kind = reading.value.value_kind();
                (!is_number)
                    .then(|| format!("`add` needs a finite number and a reading that is a number; it is {kind}"))
            }
        };
        Some(problem(format!("actions.{action}.simulate.effects.{name}"), wrong?))
    });
    wrong.collect()
}

/// Returns the problem of a value in the simulator that does not fit its form: that of a reading or of a result.
pub(super) fn value_problem(what: &str, form: &ParameterForm, simulated: &SimulatedResult) -> Option<String> {
    match simulated {
        SimulatedResult::Range([least, greatest]) if least > greatest => {
            Some(misfit(&range(*least, *greatest), what, form))
        }
        SimulatedResult::Distributed(distribution) => match distribution.problem() {
            Some(allowed) => Some(allowed.to_owned()),
            None => {
                let fits = distribution.bounds().into_iter().all(|bound| is_number(form, bound));
                (!fits).then(|| misfit(&distribution.to_string(), what, form))
            }
        },
        _ => passed_value_problem(what, form, simulated),
    }
}

/// Same as [`value_problem`] for a value that is passed through, as feedback: a range may fall.
pub(super) fn passed_value_problem(what: &str, form: &ParameterForm, simulated: &SimulatedResult) -> Option<String> {
    let kind = form.value_kind();
    let accepts = |value: &Scalar| kind.accept(value).is_some();
    let wrong = match simulated {
        SimulatedResult::Value(value) => (!accepts(value)).then(|| format!("`{value}`")),
        SimulatedResult::OneOf(values) if values.is_empty() => Some("an empty list".to_owned()),
        SimulatedResult::OneOf(values) => values.iter().find(|value| !accepts(value)).map(|value| format!("`{value}`")),
        SimulatedResult::Range([first, last]) => {
            (!(is_number(form, *first) && is_number(form, *last))).then(|| range(*first, *last))
        }
        SimulatedResult::Distributed(distribution) => {
            return Some(format!("{distribution} cannot be passed through; allowed are a range, a list and a value"));
        }
    };
    wrong.map(|wrong| misfit(&wrong, what, form))
}

fn range(first: f64, last: f64) -> String {
    format!("the range [{first}, {last}]")
}

fn misfit(wrong: &str, what: &str, form: &ParameterForm) -> String {
    format!("{wrong} does not fit the {what}; allowed is {}", form.value_kind())
}

/// Checks whether a form accepts a number.
fn is_number(form: &ParameterForm, number: f64) -> bool {
    form.nearest(number).is_some_and(|nearest| is_same(&nearest, number))
}

/// Checks whether a value of a reading is this number.
fn is_same(value: &Scalar, number: f64) -> bool {
    match value {
        Scalar::Number(value) => *value == number,
        Scalar::Integer(value) => *value as f64 == number,
        Scalar::Bool(_) | Scalar::Text(_) => false,
    }
}
