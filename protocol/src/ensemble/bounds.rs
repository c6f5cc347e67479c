//! How much work a condition may be, told from what it says.
//!
//! The length of a condition and the depth to which it is read are limited elsewhere. What is left are loops within loops: each
//! multiplies the work, and what one makes another may go over.

use cel::IdedExpr;
use cel::common::ast::{EntryExpr, Expr};

/// How deep loops (`exists`, `all`, `filter`, `map` …) may stand within one another. Two are a few hundred thousand steps at most,
/// in a condition of the greatest length.
pub(super) const LOOP_DEPTH_MAX: usize = 2;

/// How deep loops stand within one another, what they go over included.
pub(super) fn loop_depth(expression: &IdedExpr) -> usize {
    let deepest = |parts: &mut dyn Iterator<Item = &IdedExpr>| parts.map(loop_depth).max().unwrap_or(0);
    match &expression.expr {
        Expr::Unspecified | Expr::Ident(_) | Expr::Literal(_) => 0,
        Expr::Call(call) => deepest(&mut call.target.iter().map(|target| &**target).chain(&call.args)),
        Expr::List(list) => deepest(&mut list.elements.iter()),
        Expr::Select(select) => loop_depth(&select.operand),
        Expr::Map(map) => map.entries.iter().map(|entry| of_entry(&entry.expr)).max().unwrap_or(0),
        Expr::Struct(value) => value.entries.iter().map(|entry| of_entry(&entry.expr)).max().unwrap_or(0),
        Expr::Comprehension(each) => {
            let parts = [&each.iter_range, &each.accu_init, &each.loop_cond, &each.loop_step, &each.result];
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
