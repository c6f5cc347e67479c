//! Expressions in CEL that people write in files: their limits, and the values that they use.

use crate::loop_depth::{LOOP_DEPTH_MAX, loop_depth, parts};
use crate::scalar::Scalar;
use cel::common::ast::Expr;
use cel::{Context, Env, IdedExpr, Program, Value};
use std::collections::BTreeSet;
use std::sync::{Arc, LazyLock};

/// Maximum size of an expression, in bytes.
pub(crate) const EXPRESSION_BYTES_MAX: usize = 1024;

/// Compiles an expression.
///
/// # Errors
/// Description of the problem: the text is not an expression, or it is too long or too complex.
pub fn compile(text: &str) -> Result<Program, String> {
    if text.len() > EXPRESSION_BYTES_MAX {
        return Err(format!("it has {} bytes; at most {EXPRESSION_BYTES_MAX} are allowed", text.len()));
    }
    let program = Program::compile(text).map_err(|problem| problem.to_string())?;
    match loop_depth(program.expression()) {
        0..=LOOP_DEPTH_MAX => Ok(program),
        loops => Err(format!("loops are nested {loops} deep; at most {LOOP_DEPTH_MAX} levels are allowed")),
    }
}

/// Returns variables of an expression, without any yet.
pub fn variables() -> Context<'static, 'static> {
    /// Standard functions of CEL. Their setup takes longer than the evaluation of any expression.
    static FUNCTIONS: LazyLock<Arc<Env>> = LazyLock::new(|| Arc::new(Env::stdlib()));
    Context::with_env(Arc::clone(&FUNCTIONS))
}

/// Returns the fields that an expression selects directly from variables, each with its variable.
pub fn fields_used(expression: &IdedExpr) -> BTreeSet<(String, String)> {
    let mut fields: BTreeSet<_> = parts(expression).into_iter().flat_map(fields_used).collect();
    if let Expr::Select(select) = &expression.expr
        && let Expr::Ident(name) = &select.operand.expr
    {
        fields.insert((name.clone(), select.field.clone()));
    }
    fields
}

/// Returns a scalar as a value of expressions.
pub fn cel_value(value: &Scalar) -> Value {
    match value {
        Scalar::Bool(value) => Value::Bool(*value),
        Scalar::Integer(number) => Value::Int(*number),
        Scalar::Number(number) => Value::Float(*number),
        Scalar::Text(text) => Value::String(Arc::new(text.clone())),
    }
}
