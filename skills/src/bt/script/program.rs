//! A compiled script, and its execution on a blackboard.

use super::compare::{COMPARE, compare};
use super::error::{MAX_SCRIPT_BYTES, ScriptError};
use super::expression::{combine, compile};
use super::statement::{Assign, Statement, split};
use crate::bt::blackboard::{Blackboard, BlackboardError, EntryId};
use crate::bt::value::{PortType, Value};
use cel::common::types::{CelBool, CelDouble, CelString};
use cel::common::value::CowVal;
use cel::context::VariableResolver;
use cel::{Context, Env, ExecutionError, IdedExpr};
use std::collections::BTreeSet;
use std::sync::{Arc, LazyLock};

/// A compiled script. Its keys are names; the node that executes it has their entries.
#[derive(Debug)]
pub(crate) struct Script {
    statements: Vec<CompiledStatement>,
}

#[derive(Debug)]
struct CompiledStatement {
    text: String,
    assignment: Option<(String, Assign)>,
    expression: IdedExpr,
    /// Keys that the statement reads.
    reads: BTreeSet<String>,
}

/// Greatest length of a text that a statement computes, in bytes: a script of a few statements
/// could otherwise double a text beyond the memory.
const MAX_TEXT_BYTES: usize = 4096;

/// The only function that expressions call.
static FUNCTIONS: LazyLock<Context<'static, 'static>> = LazyLock::new(|| {
    let mut context = Context::with_env(Arc::new(Env::default()));
    context.add_function(COMPARE, compare).expect("an empty environment declares no functions");
    context
});

impl Script {
    /// Compiles a script.
    ///
    /// # Errors
    /// [`ScriptError`] for the first mistake.
    pub(crate) fn compile(text: &str) -> Result<Script, ScriptError> {
        if text.len() > MAX_SCRIPT_BYTES {
            return Err(ScriptError::TooLong { length: text.len() });
        }
        let statements = split(text)?.iter().map(CompiledStatement::compile).collect::<Result<_, _>>()?;
        Ok(Script { statements })
    }

    /// Compiles a script whose last statement is the condition.
    ///
    /// # Errors
    /// As for [`Script::compile`], and if the last statement is an assignment.
    pub(crate) fn compile_condition(text: &str) -> Result<Script, ScriptError> {
        let script = Script::compile(text)?;
        match script.statements.last().and_then(|last| last.assignment.as_ref()) {
            Some((key, _)) => Err(ScriptError::AssignmentAsCondition { key: key.clone() }),
            None => Ok(script),
        }
    }

    /// Keys that must have a value, in the order of statements.
    pub(crate) fn reads(&self) -> impl Iterator<Item = &str> {
        self.statements.iter().flat_map(|statement| statement.reads.iter().map(String::as_str))
    }

    /// Keys that the script declares.
    pub(crate) fn declares(&self) -> impl Iterator<Item = &str> {
        self.statements.iter().filter_map(|statement| match &statement.assignment {
            Some((key, Assign::Declare)) => Some(key.as_str()),
            _ => None,
        })
    }

    /// Executes the script and returns the value of its last statement. `entries` contains the
    /// entry of every key.
    ///
    /// # Errors
    /// [`ScriptError`] if an expression has no value, or an entry does not accept it. The
    /// statements before keep their effect.
    pub(crate) fn run(&self, entries: &[(String, EntryId)], blackboard: &mut Blackboard) -> Result<Value, ScriptError> {
        let mut result = Value::Bool(true);
        for statement in &self.statements {
            result = statement.run(entries, blackboard)?;
        }
        Ok(result)
    }

    /// Executes the script and returns whether its last statement is true.
    ///
    /// # Errors
    /// As for [`Script::run`], and if the value is neither true nor false.
    pub(crate) fn holds(
        &self,
        entries: &[(String, EntryId)],
        blackboard: &mut Blackboard,
    ) -> Result<bool, ScriptError> {
        let value = self.run(entries, blackboard)?;
        value.convert(PortType::Bool).map(|value| value == Value::Bool(true)).map_err(|error| {
            let statement = self.statements.last().map_or_else(String::new, |last| last.text.clone());
            ScriptError::Evaluation { statement, message: error.to_string() }
        })
    }
}

impl CompiledStatement {
    fn compile(statement: &Statement<'_>) -> Result<CompiledStatement, ScriptError> {
        let mut reads = BTreeSet::new();
        let mut expression = compile(statement.expression, &mut reads)?;
        if let Some((key, assign)) = statement.assignment {
            if let Assign::Combine(operator) = assign {
                expression = combine(key, operator, expression);
            }
            if assign != Assign::Declare {
                reads.insert(key.to_owned());
            }
        }
        let assignment = statement.assignment.map(|(key, assign)| (key.to_owned(), assign));
        Ok(CompiledStatement { text: statement.text.to_owned(), assignment, expression, reads })
    }

    fn run(&self, entries: &[(String, EntryId)], blackboard: &mut Blackboard) -> Result<Value, ScriptError> {
        let value = self.evaluate(&Entries { entries, blackboard })?;
        let Some((key, assign)) = &self.assignment else { return Ok(value) };
        let id = entry(entries, key).expect("the entries of all keys are bound");
        if *assign == Assign::Set && blackboard.value(id).is_none() {
            return Err(self.empty(key));
        }
        let written = blackboard.write(id, value.clone());
        written.map_err(|source: BlackboardError| ScriptError::Write { statement: self.text.clone(), source })?;
        Ok(value)
    }

    fn evaluate(&self, entries: &Entries<'_>) -> Result<Value, ScriptError> {
        let functions: &Context<'_, '_> = &FUNCTIONS;
        let mut context = functions.new_inner_scope();
        context.set_variable_resolver(entries);
        let result = context.resolve(&self.expression);
        let message = match result {
            Ok(cel::Value::Bool(value)) => return Ok(Value::Bool(value)),
            Ok(cel::Value::Float(value)) if value.is_finite() => return Ok(Value::Number(value)),
            Ok(cel::Value::String(value)) if value.len() > MAX_TEXT_BYTES => {
                format!("it evaluates to a text of {} bytes; allowed are at most {MAX_TEXT_BYTES}", value.len())
            }
            Ok(cel::Value::String(value)) => return Ok(Value::Text(Arc::unwrap_or_clone(value))),
            Ok(cel::Value::Float(value)) => format!("it evaluates to {value}; allowed is a finite number"),
            Ok(other) => format!("it evaluates to {other:?}; allowed are numbers, texts, true and false"),
            Err(ExecutionError::UndeclaredReference(key)) => return Err(self.empty(&key)),
            Err(ExecutionError::FunctionError { message, .. }) => message,
            Err(error) => error.to_string(),
        };
        Err(ScriptError::Evaluation { statement: self.text.clone(), message })
    }

    fn empty(&self, key: &str) -> ScriptError {
        ScriptError::EmptyKey { statement: self.text.clone(), key: key.to_owned() }
    }
}

/// The values of the keys, for the interpreter.
struct Entries<'a> {
    entries: &'a [(String, EntryId)],
    blackboard: &'a Blackboard,
}

impl VariableResolver for Entries<'_> {
    fn resolve<'b>(&'b self, key: &str) -> Option<CowVal<'b, 'b>> {
        Some(match self.blackboard.value(entry(self.entries, key)?)? {
            Value::Bool(value) => CowVal::owned(CelBool::from(*value)),
            Value::Number(value) => CowVal::owned(CelDouble::from(*value)),
            // Exact up to 2^53, far above any count in a tree.
            Value::Integer(value) => CowVal::owned(CelDouble::from(*value as f64)),
            Value::Seconds(value) => CowVal::owned(CelDouble::from(value.get())),
            Value::Text(value) => CowVal::owned(CelString::from(value.as_str())),
            other => CowVal::owned(CelString::from(other.to_string())),
        })
    }
}

fn entry(entries: &[(String, EntryId)], key: &str) -> Option<EntryId> {
    entries.iter().find(|(name, _)| name == key).map(|(_, id)| *id)
}
