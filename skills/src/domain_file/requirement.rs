//! The condition of a task type on its robot.
//!
//! A condition on readings is true, false or unknown. A robot bids only if it is true. Where no readings are given, an
//! unknown condition does not count: the readings of a robot that performs the task have changed since its bid.

use super::expression::Expression;
use super::form::ParameterForm;
use cel::Context;
use consort_protocol::expression::cel_value;
use consort_protocol::mission::ValueKind;
use consort_protocol::scalar::Scalar;
use consort_text::AllowedNames;
use std::collections::{BTreeMap, HashMap};

/// Variable with the readings of the robot's driver.
const READINGS: &str = "readings";

const IS_FALSE: &str = "is false";

/// The compiled condition.
pub(super) struct Requirement {
    condition: Expression,
    /// Readings that it uses.
    readings: BTreeMap<String, ValueKind>,
}

/// A condition that is false or has no value.
pub(super) struct Unmet {
    /// `is false`, or the reason for which it has no value.
    pub(super) problem: String,
    /// True if other readings may change it.
    pub(super) may_change: bool,
}

impl Requirement {
    /// Compiles a condition. `declared` are the readings of all domains, and `variables` examples of all other
    /// variables.
    pub(super) fn compile(
        text: &str,
        declared: &BTreeMap<String, ParameterForm>,
        mut variables: Context<'static, 'static>,
    ) -> Result<Requirement, String> {
        let condition = Expression::compile(text)?;
        let (mut readings, mut examples) = (BTreeMap::new(), BTreeMap::new());
        for name in condition.fields_of(READINGS) {
            let Some(form) = declared.get(&name) else {
                let allowed = AllowedNames::suggest_for(&name, declared.keys());
                return Err(format!("no domain declares the reading `{name}`; {allowed}"));
            };
            examples.extend(form.value_kind().parse(&form.example()).map(|example| (name.clone(), example)));
            readings.insert(name, form.value_kind());
        }
        let requirement = Requirement { condition, readings };
        if !requirement.condition.uses_attributes() {
            if requirement.uses_readings() {
                requirement.add_readings(&mut variables, &examples);
            }
            requirement.condition.condition(&variables).map_err(|problem| format!("`{text}` {problem}"))?;
        }
        Ok(requirement)
    }

    /// Returns the condition.
    pub(super) fn expression(&self) -> &Expression {
        &self.condition
    }

    fn uses_readings(&self) -> bool {
        !self.readings.is_empty()
    }

    /// Checks the condition for a robot. `variables` are all variables except the readings.
    ///
    /// # Errors
    /// The condition is false or has no value. It may change if the readings decide about it.
    pub(super) fn check(
        &self,
        variables: &mut Context<'static, 'static>,
        readings: Option<&BTreeMap<String, Scalar>>,
    ) -> Result<(), Unmet> {
        match (self.condition.condition(variables), readings) {
            (Ok(true), _) => return Ok(()),
            (Ok(false), _) => return Err(Unmet { problem: IS_FALSE.to_owned(), may_change: false }),
            (Err(problem), _) if !self.uses_readings() => return Err(Unmet { problem, may_change: false }),
            (Err(_), None) => return Ok(()),
            (Err(_), Some(readings)) => self.add_readings(variables, readings),
        }
        let problem = match self.condition.condition(variables) {
            Ok(true) => return Ok(()),
            Ok(false) => IS_FALSE.to_owned(),
            Err(problem) => readings.and_then(|readings| self.unknown_reading(readings)).unwrap_or(problem),
        };
        Err(Unmet { problem, may_change: true })
    }

    fn add_readings(&self, variables: &mut Context<'static, 'static>, readings: &BTreeMap<String, Scalar>) {
        let value = |(name, kind): (&String, &ValueKind)| {
            let value = kind.accept(readings.get(name)?)?;
            Some((name.clone(), cel_value(&value)))
        };
        let values: HashMap<String, cel::Value> = self.readings.iter().filter_map(value).collect();
        variables.add_variable_from_value(READINGS, values);
    }

    /// Describes the first used reading without a valid value.
    fn unknown_reading(&self, readings: &BTreeMap<String, Scalar>) -> Option<String> {
        self.readings.iter().find_map(|(name, kind)| match readings.get(name) {
            None => Some(format!("has no value: the reading `{name}` is unknown: the driver has not published it")),
            Some(value) if kind.accept(value).is_none() => {
                Some(format!("has no value: the reading `{name}` is `{value}`; allowed is {kind}"))
            }
            Some(_) => None,
        })
    }
}
