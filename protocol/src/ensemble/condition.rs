//! Conditions of ensembles and of roles, and on missions: compilation and evaluation.

use crate::expression::{self, fields_used};
use crate::ids::EnsembleId;
use crate::loop_depth::parts;
use cel::common::ast::Expr;
use cel::objects::Key;
use cel::{Context, ExecutionError, IdedExpr, Program, Value};
use consort_text::AllowedNames;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Error: a condition cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("ensemble {ensemble}: condition `{condition}`: {problem}")]
pub struct ConditionError {
    /// The ensemble.
    pub ensemble: EnsembleId,
    /// Text of the condition.
    pub condition: String,
    /// Description of the problem.
    pub problem: String,
}

/// Variables of a condition, with their values.
pub(crate) type Variables = Vec<(&'static str, Value)>;

/// Returns the variables for evaluations.
pub(crate) fn context_of(variables: Variables) -> Context<'static, 'static> {
    let mut context = expression::variables();
    for (name, value) in variables {
        context.add_variable_from_value(name, value);
    }
    context
}

/// Field of a node that contains its attributes, which are not known beforehand.
const ATTRIBUTES: &str = "attributes";

/// Fields whose content is not known beforehand: the attributes of a node, and the parameters of a mission.
const OPEN_FIELDS: [&str; 2] = [ATTRIBUTES, "parameters"];

/// Compiled condition.
#[derive(Debug)]
pub(crate) struct Condition {
    pub(super) text: String,
    program: Arc<Program>,
    /// Fields that it uses, each with its variable.
    fields: BTreeSet<(String, String)>,
}

/// Error: a condition has no result for a node.
#[derive(Debug, Clone, thiserror::Error)]
pub(crate) enum EvaluationError {
    /// The value is not a boolean.
    #[error("evaluates to {value}; it must be true or false")]
    NotBoolean {
        /// The value.
        value: String,
    },
    /// A variable does not exist.
    #[error("there is no variable `{name}`")]
    UnknownVariable {
        /// The variable.
        name: String,
    },
    /// The robot lacks an attribute, or the mission a parameter; all other fields are checked when the condition is
    /// compiled.
    #[error("there is no attribute `{name}`")]
    NoAttribute {
        /// The attribute or parameter.
        name: String,
    },
    /// The evaluation failed.
    #[error("{message}")]
    Failed {
        /// Message of the interpreter.
        message: String,
    },
}

impl Condition {
    /// Compiles a condition. `example` has values for all variables and fields: a wrong name or type is
    /// found now and not at run time, except for attributes and parameters, which differ between robots and missions.
    ///
    /// # Errors
    /// Description of the problem.
    pub(crate) fn compile(text: &str, example: &Variables) -> Result<Condition, String> {
        let program = expression::compile(text)?;
        let fields = fields_used(program.expression());
        for (name, field) in &fields {
            let value = example.iter().find(|(variable, _)| variable == name).map(|(_, value)| value);
            let Some(Value::Map(known)) = value else { continue };
            let known: BTreeSet<String> = known.map.keys().map(Key::to_string).collect();
            if !known.contains(field) {
                let allowed = AllowedNames::suggest_for(field, &known);
                return Err(format!("`{name}` has no field `{field}`; {allowed}"));
            }
        }
        let condition = Condition { text: text.to_owned(), program, fields };
        match condition.holds(&context_of(example.clone())) {
            Err(problem @ EvaluationError::UnknownVariable { .. }) => {
                let names = example.iter().map(|(name, _)| format!("`{name}`")).collect::<Vec<_>>().join(", ");
                Err(format!("{problem}; allowed: {names}"))
            }
            Err(problem) if !condition.uses(|field| OPEN_FIELDS.contains(&field)) => Err(problem.to_string()),
            Ok(_) | Err(_) => Ok(condition),
        }
    }

    /// Checks whether the condition uses one of these fields of a node.
    pub(super) fn uses(&self, is_meant: impl Fn(&str) -> bool) -> bool {
        self.fields.iter().any(|(_, field)| is_meant(field))
    }

    /// Checks whether the result may depend on this attribute of a node. The condition may select it by
    /// name, or use all attributes or a whole node.
    pub(super) fn may_use_attribute(&self, name: &str) -> bool {
        may_use_attribute(self.program.expression(), name)
    }

    /// Evaluates the condition.
    pub(crate) fn holds(&self, variables: &Context<'static, 'static>) -> Result<bool, EvaluationError> {
        match self.program.execute(variables) {
            Ok(Value::Bool(holds)) => Ok(holds),
            Ok(other) => Err(EvaluationError::NotBoolean { value: format!("{other:?}") }),
            Err(ExecutionError::UndeclaredReference(name)) => {
                Err(EvaluationError::UnknownVariable { name: name.to_string() })
            }
            Err(ExecutionError::NoSuchKey(name)) => Err(EvaluationError::NoAttribute { name: name.to_string() }),
            Err(problem) => Err(EvaluationError::Failed { message: problem.to_string() }),
        }
    }
}

fn may_use_attribute(expression: &IdedExpr, name: &str) -> bool {
    match &expression.expr {
        Expr::Ident(variable) => ["member", "coordinator", "robot"].contains(&variable.as_str()),
        Expr::Select(select) if select.field == ATTRIBUTES => true,
        Expr::Select(select) => {
            let mut operand: &IdedExpr = &select.operand;
            if let Expr::Select(inner) = &operand.expr
                && inner.field == ATTRIBUTES
            {
                if select.field == name {
                    return true;
                }
                operand = &inner.operand;
            }
            // Another field of a node is no attribute.
            !matches!(operand.expr, Expr::Ident(_)) && may_use_attribute(operand, name)
        }
        _ => parts(expression).into_iter().any(|part| may_use_attribute(part, name)),
    }
}
