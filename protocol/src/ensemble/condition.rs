//! Conditions of ensembles: compilation and evaluation.

use super::spec::EnsembleSpec;
use crate::ids::EnsembleId;
use crate::loop_depth::{LOOP_DEPTH_MAX, loop_depth};
use cel::{Context, Program, Value};

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

/// Maximum length of a condition, in bytes.
const CONDITION_MAX: usize = 1024;

/// Compiled condition.
#[derive(Debug)]
pub(super) struct Condition {
    pub(super) text: String,
    program: Program,
}

/// Error: a condition has no result for a node.
#[derive(Debug, Clone, thiserror::Error)]
pub(super) enum EvaluationError {
    /// The value is not a boolean.
    #[error("evaluates to {value}; it must be true or false")]
    NotBoolean {
        /// The value.
        value: String,
    },
    /// The evaluation failed.
    #[error("{message}")]
    Failed {
        /// Message of the interpreter.
        message: String,
    },
}

impl Condition {
    /// Evaluates the condition.
    pub(super) fn holds(&self, facts: &Context<'static, 'static>) -> Result<bool, EvaluationError> {
        match self.program.execute(facts) {
            Ok(Value::Bool(holds)) => Ok(holds),
            Ok(other) => Err(EvaluationError::NotBoolean { value: format!("{other:?}") }),
            Err(problem) => Err(EvaluationError::Failed { message: problem.to_string() }),
        }
    }
}

/// Compiles conditions of an ensemble.
pub(super) fn compile_all(spec: &EnsembleSpec, texts: &[String]) -> Result<Vec<Condition>, ConditionError> {
    let refuse = |condition: &String, problem| ConditionError {
        ensemble: spec.name.clone(),
        condition: condition.clone(),
        problem,
    };
    let compile = |text: &String| {
        if text.len() > CONDITION_MAX {
            return Err(refuse(text, format!("is {} bytes long; at most {CONDITION_MAX} are allowed", text.len())));
        }
        let program = Program::compile(text).map_err(|e| refuse(text, e.to_string()))?;
        let loops = loop_depth(program.expression());
        if loops > LOOP_DEPTH_MAX {
            return Err(refuse(
                text,
                format!("loops are nested {loops} deep; at most {LOOP_DEPTH_MAX} levels are allowed"),
            ));
        }
        Ok(Condition { text: text.clone(), program })
    };
    texts.iter().map(compile).collect()
}
