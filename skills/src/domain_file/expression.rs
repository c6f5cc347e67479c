//! Expressions of domain files in CEL.

use cel::{Context, Program};
use consort_protocol::expression;
use std::sync::Arc;

/// Variable with the attributes of the robot.
pub(super) const ATTRIBUTES: &str = "attributes";

/// Variable with the lengths of routes and paths, by parameter.
pub(super) const DISTANCE: &str = "distance";

/// Variable with the times of drives, by parameter.
pub(super) const TRAVEL_S: &str = "travel_s";

/// A compiled expression.
pub(super) struct Expression {
    pub(super) text: String,
    program: Arc<Program>,
    /// True if the expression may use lengths or times of drives.
    pub(super) uses_drives: bool,
}

impl Expression {
    pub(super) fn compile(text: &str) -> Result<Expression, String> {
        let uses_drives = [DISTANCE, TRAVEL_S].into_iter().any(|variable| text.contains(variable));
        Ok(Expression { text: text.to_owned(), program: expression::compile(text)?, uses_drives })
    }

    /// Checks whether the expression uses attributes of the robot, which are not known beforehand.
    pub(super) fn uses_attributes(&self) -> bool {
        self.fields_of(ATTRIBUTES).next().is_some()
    }

    /// Returns the fields of a variable that the expression uses.
    pub(super) fn fields_of(&self, variable: &str) -> impl Iterator<Item = String> {
        let used = expression::fields_used(self.program.expression()).into_iter();
        used.filter(move |(name, _)| name == variable).map(|(_, field)| field)
    }

    /// Evaluates the expression to `true` or `false`.
    pub(super) fn condition(&self, variables: &Context<'static, 'static>) -> Result<bool, String> {
        match self.program.execute(variables) {
            Ok(cel::Value::Bool(holds)) => Ok(holds),
            Ok(other) => Err(format!("is {other:?}; allowed is true or false")),
            Err(problem) => Err(format!("has no value: {problem}")),
        }
    }

    /// Evaluates the expression to a finite number of 0 or more.
    pub(super) fn number(&self, variables: &Context<'static, 'static>) -> Result<f64, String> {
        let number = match self.program.execute(variables) {
            Ok(cel::Value::Float(number)) => number,
            Ok(cel::Value::Int(number)) => number as f64,
            Ok(cel::Value::UInt(number)) => number as f64,
            Ok(other) => return Err(format!("`{}` is {other:?}; allowed is a number", self.text)),
            Err(problem) => {
                return Err(format!("`{}`: {problem}; numbers are written with a decimal point, as in 2.0", self.text));
            }
        };
        match number.is_finite() && number >= 0.0 {
            true => Ok(number),
            false => Err(format!("`{}` is {number}; allowed are finite numbers of 0 or more", self.text)),
        }
    }
}
