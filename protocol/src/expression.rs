//! Expressions in CEL that people write in files: their limits, and the values that they use.

use crate::loop_depth::{LOOP_DEPTH_MAX, loop_depth, parts};
use crate::scalar::Scalar;
use cel::common::ast::Expr;
use cel::{Context, Env, IdedExpr, Program, Value};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, LazyLock};

/// Maximum size of an expression, in bytes.
pub(crate) const EXPRESSION_BYTES_MAX: usize = 1024;

/// Maximum number of compiled expressions that a thread keeps. Beyond that all are dropped and compiled again. Default: a
/// guess, more than the conditions of the missions and the fleet file at a time.
const COMPILED_MAX: usize = 128;

thread_local! {
    /// Expressions that were compiled lately, by text: the same conditions are evaluated for each bid and each report.
    static COMPILED: RefCell<BTreeMap<String, Arc<Program>>> = const { RefCell::new(BTreeMap::new()) };
}

/// Compiles an expression, unless its text was compiled lately.
///
/// # Errors
/// Description of the problem: the text is not an expression, or it is too long or too complex.
pub fn compile(text: &str) -> Result<Arc<Program>, String> {
    if let Some(known) = COMPILED.with_borrow(|compiled| compiled.get(text).cloned()) {
        return Ok(known);
    }
    let program = Arc::new(compile_anew(text)?);
    COMPILED.with_borrow_mut(|compiled| {
        if compiled.len() >= COMPILED_MAX {
            compiled.clear();
        }
        compiled.insert(text.to_owned(), Arc::clone(&program));
    });
    Ok(program)
}

fn compile_anew(text: &str) -> Result<Program, String> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_expression_is_compiled_once_and_their_number_is_bounded() {
        let first = compile("1 < 2").unwrap();
        assert!(Arc::ptr_eq(&first, &compile("1 < 2").unwrap()));
        for number in 0..COMPILED_MAX {
            compile(&format!("{number} < 3")).unwrap();
            assert!(COMPILED.with_borrow(BTreeMap::len) <= COMPILED_MAX);
        }
        assert!(!Arc::ptr_eq(&first, &compile("1 < 2").unwrap()), "it was dropped meanwhile");
        assert!(compile("1 <").is_err() && compile("1 <").is_err());
    }
}
