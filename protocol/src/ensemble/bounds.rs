//! Bound on the work of evaluating a condition, computed from its expression.
//!
//! Length and parse depth of a condition are limited elsewhere. Nested loops remain: each level
//! multiplies the work, and an inner loop may iterate over a list that an outer loop has produced.

use cel::IdedExpr;
use cel::common::ast::{EntryExpr, Expr};

/// Maximum nesting depth of loops (`exists`, `all`, `filter`, `map` …). Two levels are a few
/// hundred thousand steps at most, in a condition of maximum length.
pub(super) const LOOP_DEPTH_MAX: usize = 2;

/// Returns the nesting depth of loops, including the loops in the lists that they iterate over.
pub(super) fn loop_depth(expression: &IdedExpr) -> usize {
    let deepest = |parts: &mut dyn Iterator<Item = &IdedExpr>| parts.map(loop_depth).max().unwrap_or(0);
    match &expression.expr {
        Expr::Unspecified | Expr::Ident(_) | Expr::Literal(_) => 0,
        Expr::Call(call) => deepest(&mut call.target.iter().map(|target| &**target).chain(&call.args)),
        Expr::List(list) => deepest(&mut list.elements.iter()),
        Expr::Select(select) => loop_depth(&select.operand),
        Expr::Map(map) => map.entries.iter().map(|entry| of_entry(&entry.expr)).max().unwrap_or(0),
        Expr::Struct(value) => value.entries.iter().map(|entry| of_entry(&entry.expr)).max().unwrap_or(0),
        Expr::Comprehension(comprehension) => {
            let parts = [
                &comprehension.iter_range,
                &comprehension.accu_init,
                &comprehension.loop_cond,
                &comprehension.loop_step,
                &comprehension.result,
            ];
            1 + deepest(&mut parts.into_iter())
        }
    }
}

fn of_entry(entry: &EntryExpr) -> usize {
    match entry {
        EntryExpr::StructField(field) => loop_depth(&field.value),
        EntryExpr::MapEntry(entry) => loop_depth(&entry.key).max(loop_depth(&entry.value)),
    }
}
