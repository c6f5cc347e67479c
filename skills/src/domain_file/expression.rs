//! Expressions of domain files in CEL.

use cel::common::ast::{Expr, LiteralValue, operators};
use cel::{Context, IdedExpr, Program};
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

    /// Checks whether the value never falls with longer drives, as far as its form shows: drives occur in sums, in products without
    /// negative factors, and in dividends only.
    pub(super) fn grows_with_drives(&self) -> bool {
        grows(self.program.expression())
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

fn grows(expression: &IdedExpr) -> bool {
    if !may_use_drives(expression) || is_drive(expression) {
        return true;
    }
    let Expr::Call(call) = &expression.expr else { return false };
    match (call.func_name.as_str(), &call.args[..]) {
        (operators::ADD, terms) => terms.iter().all(grows),
        (operators::SUBSTRACT, [whole, part]) => grows(whole) && !may_use_drives(part),
        (operators::MULTIPLY, factors) => factors.iter().all(|factor| grows(factor) && is_not_negative(factor)),
        (operators::DIVIDE, [dividend, divisor]) => {
            grows(dividend) && !may_use_drives(divisor) && is_not_negative(divisor)
        }
        _ => false,
    }
}

/// Checks whether the expression is the length or the time of a drive.
fn is_drive(expression: &IdedExpr) -> bool {
    match &expression.expr {
        Expr::Select(select) => !select.test && is_variable(&select.operand, &[DISTANCE, TRAVEL_S]),
        _ => false,
    }
}

fn is_variable(expression: &IdedExpr, names: &[&str]) -> bool {
    matches!(&expression.expr, Expr::Ident(name) if names.contains(&name.as_str()))
}

/// Checks whether the expression may contain drives.
fn may_use_drives(expression: &IdedExpr) -> bool {
    match &expression.expr {
        Expr::Ident(_) => is_variable(expression, &[DISTANCE, TRAVEL_S]),
        Expr::Literal(_) => false,
        Expr::Select(select) => may_use_drives(&select.operand),
        Expr::Call(call) => call.target.iter().map(|target| &**target).chain(&call.args).any(may_use_drives),
        _ => true,
    }
}

/// Checks whether the number cannot be negative, as far as the form of the expression shows.
fn is_not_negative(expression: &IdedExpr) -> bool {
    match &expression.expr {
        Expr::Literal(LiteralValue::Double(number)) => *number.inner() >= 0.0,
        Expr::Literal(LiteralValue::Int(number)) => *number.inner() >= 0,
        Expr::Literal(LiteralValue::UInt(_)) => true,
        Expr::Ident(_) => is_variable(expression, &["speed", "discharge"]),
        Expr::Select(_) => is_drive(expression),
        Expr::Call(call) => {
            let keeps_sign = [operators::ADD, operators::MULTIPLY, operators::DIVIDE];
            keeps_sign.contains(&call.func_name.as_str()) && call.args.iter().all(is_not_negative)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_form_of_an_expression_shows_whether_it_grows_with_drives() {
        for (text, expected) in [
            ("travel_s.to + 2.0", true),
            ("distance.to / speed + 8.0 - seconds", true),
            ("2.5 * (travel_s.to + travel_s.from) * discharge", true),
            ("seconds * -1.0", true),
            ("100.0 - travel_s.to", false),
            ("travel_s.to * seconds", false),
            ("travel_s.to * attributes.factor", false),
            ("-1.0 * travel_s.to", false),
            ("60.0 / distance.to", false),
            ("travel_s.to > 9.0 ? 1.0 : 5.0", false),
            ("travel_s[place]", false),
            ("[travel_s.to].map(x, 9.0 - x)[0]", false),
        ] {
            assert_eq!(Expression::compile(text).unwrap().grows_with_drives(), expected, "{text}");
        }
    }
}
