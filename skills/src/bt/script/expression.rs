//! Compilation of an expression: the parser of `cel`, then a check and a translation of the syntax
//! tree, so that the interpreter of `cel` follows the rules of scripts.

use super::compare::COMPARE;
use super::error::ScriptError;
use cel::IdedExpr;
use cel::common::ast::{CallExpr, Expr, LiteralValue, operators};
use cel::parser::Parser;
use std::collections::BTreeSet;

/// Greatest nesting depth of an expression. Evaluation recurses once per level, which the stack
/// must hold.
const MAX_DEPTH: usize = 64;

/// Parses and translates an expression, and adds its names to `keys`.
///
/// - A whole number becomes a double.
/// - `a < b` becomes `compare(a, b) < 0.0`, and likewise for every comparison.
/// - `!a` becomes `a ? false : true`, `a && b` becomes `a ? (b ? true : false) : false`, and
///   `a || b` becomes `a ? true : (b ? true : false)`: CEL would drop an error of one operand if the
///   other decides the result, and its `!` allocates an error before it needs one.
///
/// # Errors
/// [`ScriptError`] if the parser rejects the text, or it uses another part of CEL.
pub(super) fn compile(text: &str, keys: &mut BTreeSet<String>) -> Result<IdedExpr, ScriptError> {
    let parsed = Parser::default().parse(text).map_err(|errors| {
        let messages: Vec<String> = errors.errors.into_iter().map(|error| error.msg).collect();
        ScriptError::Syntax { expression: text.to_owned(), message: messages.join("; ") }
    })?;
    let translated = translate(parsed, keys, MAX_DEPTH);
    translated.map_err(|found| ScriptError::NotAllowed { expression: text.to_owned(), found })
}

/// `levels_left` bounds the depth. `Err` describes a part of CEL that scripts do not have.
fn translate(expression: IdedExpr, keys: &mut BTreeSet<String>, levels_left: usize) -> Result<IdedExpr, String> {
    let IdedExpr { id, expr } = expression;
    let expr = match expr {
        _ if levels_left == 0 => return Err(format!("a nesting of more than {MAX_DEPTH} operators")),
        Expr::Ident(name) => {
            keys.insert(name.clone());
            Expr::Ident(name)
        }
        Expr::Literal(LiteralValue::Int(number)) => {
            Expr::Literal(LiteralValue::Double((*number.inner() as f64).into()))
        }
        Expr::Literal(literal @ (LiteralValue::Double(_) | LiteralValue::Boolean(_) | LiteralValue::String(_))) => {
            Expr::Literal(literal)
        }
        Expr::Call(CallExpr { func_name, target: None, args }) => {
            let args = args.into_iter().map(|arg| translate(arg, keys, levels_left - 1));
            translate_call(func_name, args.collect::<Result<_, _>>()?)?
        }
        Expr::Call(call) => return Err(format!("the call of `{}`", call.func_name)),
        Expr::Literal(LiteralValue::UInt(_)) => return Err("a number that ends with u".to_owned()),
        Expr::Literal(LiteralValue::Bytes(_)) => return Err("a literal of bytes".to_owned()),
        Expr::Literal(LiteralValue::Null) => return Err("null".to_owned()),
        Expr::Select(select) => return Err(format!("the field `.{}`", select.field)),
        Expr::List(_) => return Err("a list".to_owned()),
        Expr::Map(_) | Expr::Struct(_) => return Err("a map".to_owned()),
        Expr::Comprehension(_) | Expr::Unspecified => return Err("a loop over a list".to_owned()),
    };
    Ok(IdedExpr { id, expr })
}

fn translate_call(operator: String, args: Vec<IdedExpr>) -> Result<Expr, String> {
    let args = match <[IdedExpr; 2]>::try_from(args) {
        Ok(pair) => return translate_pair(operator, pair),
        Err(args) => args,
    };
    let args = match <[IdedExpr; 1]>::try_from(args) {
        Ok([value]) if operator == operators::LOGICAL_NOT => {
            return Ok(choose(value, boolean(false), boolean(true)).expr);
        }
        Ok(value) => Vec::from(value),
        Err(args) => args,
    };
    match operator.as_str() {
        operators::NEGATE | operators::CONDITIONAL => Ok(call(&operator, args).expr),
        other => Err(format!("the call of `{other}`")),
    }
}

fn translate_pair(operator: String, [left, right]: [IdedExpr; 2]) -> Result<Expr, String> {
    // Fails unless the value is true or false.
    let checked = |value| choose(value, boolean(true), boolean(false));
    let translated = match operator.as_str() {
        operators::ADD | operators::SUBSTRACT | operators::MULTIPLY | operators::DIVIDE => {
            call(&operator, vec![left, right])
        }
        operators::LOGICAL_AND => choose(left, checked(right), boolean(false)),
        operators::LOGICAL_OR => choose(left, boolean(true), checked(right)),
        operators::EQUALS
        | operators::NOT_EQUALS
        | operators::LESS
        | operators::LESS_EQUALS
        | operators::GREATER
        | operators::GREATER_EQUALS => {
            let zero = node(Expr::Literal(LiteralValue::Double(0.0.into())));
            call(&operator, vec![call(COMPARE, vec![left, right]), zero])
        }
        operators::MODULO => return Err("the operator `%`".to_owned()),
        operators::IN => return Err("the operator `in`".to_owned()),
        operators::INDEX => return Err("an index".to_owned()),
        other => return Err(format!("the call of `{other}`")),
    };
    Ok(translated.expr)
}

/// Combines the value of `key` with an expression; `operator` is one of `+ - * /`.
pub(super) fn combine(key: &str, operator: u8, expression: IdedExpr) -> IdedExpr {
    let operator = match operator {
        b'+' => operators::ADD,
        b'-' => operators::SUBSTRACT,
        b'*' => operators::MULTIPLY,
        _ => operators::DIVIDE,
    };
    call(operator, vec![node(Expr::Ident(key.to_owned())), expression])
}

/// `condition ? yes : no`.
fn choose(condition: IdedExpr, yes: IdedExpr, no: IdedExpr) -> IdedExpr {
    call(operators::CONDITIONAL, vec![condition, yes, no])
}

fn boolean(value: bool) -> IdedExpr {
    node(Expr::Literal(LiteralValue::Boolean(value.into())))
}

fn call(operator: &str, args: Vec<IdedExpr>) -> IdedExpr {
    node(Expr::Call(CallExpr { func_name: operator.to_owned(), target: None, args }))
}

/// A node without a position in the text. The interpreter does not use positions.
fn node(expr: Expr) -> IdedExpr {
    IdedExpr { id: 0, expr }
}
