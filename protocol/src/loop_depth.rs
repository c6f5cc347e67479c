//! Bound on the work of evaluating a condition, computed from its expression.
//!
//! Length and parse depth of a condition are limited elsewhere. Nested loops remain: each level
//! multiplies the work, and an inner loop may iterate over a list that an outer loop has produced.

use cel::IdedExpr;
use cel::common::ast::{EntryExpr, Expr};

/// Maximum nesting depth of loops (`exists`, `all`, `filter`, `map` …). Two levels are a few
/// hundred thousand steps at most, in a condition of maximum length.
pub(crate) const LOOP_DEPTH_MAX: usize = 2;

/// Returns the nesting depth of loops, including the loops in the lists that they iterate over.
pub(crate) fn loop_depth(expression: &IdedExpr) -> usize {
    let own = usize::from(matches!(expression.expr, Expr::Comprehension(_)));
    own + parts(expression).into_iter().map(loop_depth).max().unwrap_or(0)
}

/// Returns the direct parts of an expression.
pub(crate) fn parts(expression: &IdedExpr) -> Vec<&IdedExpr> {
    match &expression.expr {
        Expr::Unspecified | Expr::Ident(_) | Expr::Literal(_) => vec![],
        Expr::Call(call) => call.target.iter().map(|target| &**target).chain(&call.args).collect(),
        Expr::List(list) => list.elements.iter().collect(),
        Expr::Select(select) => vec![&select.operand],
        Expr::Map(map) => map.entries.iter().flat_map(|entry| parts_of_entry(&entry.expr)).collect(),
        Expr::Struct(value) => value.entries.iter().flat_map(|entry| parts_of_entry(&entry.expr)).collect(),
        Expr::Comprehension(comprehension) => vec![
            &comprehension.iter_range,
            &comprehension.accu_init,
            &comprehension.loop_cond,
            &comprehension.loop_step,
            &comprehension.result,
        ],
    }
}

fn parts_of_entry(entry: &EntryExpr) -> Vec<&IdedExpr> {
    match entry {
        EntryExpr::StructField(field) => vec![&field.value],
        EntryExpr::MapEntry(entry) => vec![&entry.key, &entry.value],
    }
}
