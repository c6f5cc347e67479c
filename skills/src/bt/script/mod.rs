//! The script language of BehaviorTree.CPP 4: `count += 1; done := count >= 3 && !busy`.
//!
//! A script is a list of statements separated by `;`. A statement is an expression or an
//! assignment: `name := expression` declares or changes an entry, `=`, `+=`, `-=`, `*=` and `/=`
//! change an entry that has a value. The `cel` crate parses and evaluates the expressions. They
//! consist of names of entries, numbers, `'texts'`, `true`, `false`, parentheses, `+ - * /`,
//! `== != < <= > >=`, `&& || !` and `a ? b : c`.
//!
//! Rules of BehaviorTree.CPP that CEL does not have: every number is a double; a comparison of a
//! text with a number or a boolean converts the text; an error in the left operand of `&&` and `||`
//! is an error of the expression. Unlike in BehaviorTree.CPP, a number is not a condition. Bit
//! operators, `..`, enums and `@` are not supported.

mod compare;
mod error;
mod expression;
mod program;
mod statement;

pub use error::ScriptError;
pub(crate) use program::Script;
