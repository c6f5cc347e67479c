//! Errors of scripts.

use crate::bt::blackboard::BlackboardError;

/// Greatest length of a script, in bytes.
pub(super) const MAX_SCRIPT_BYTES: usize = 4096;

/// A script cannot be compiled, or its execution fails.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ScriptError {
    /// The script exceeds the limit.
    #[error("it has {length} bytes; allowed are at most {MAX_SCRIPT_BYTES}")]
    TooLong {
        /// Length in bytes.
        length: usize,
    },
    /// The script has no statement.
    #[error("it is empty; allowed are statements separated by `;`")]
    NoStatement,
    /// A text has no end, or something outside of texts is not part of the language.
    #[error("`{found}` is not allowed here; {allowed}")]
    Token {
        /// The token.
        found: &'static str,
        /// The allowed form.
        allowed: &'static str,
    },
    /// The left side of an assignment is not a name.
    #[error("`{target}` cannot be assigned; allowed is a name of letters, digits and `_`, such as `count`")]
    Target {
        /// The left side.
        target: String,
    },
    /// A condition ends with an assignment.
    #[error("the condition ends with the assignment to `{key}`; allowed is an expression (`==` compares)")]
    AssignmentAsCondition {
        /// The assigned key.
        key: String,
    },
    /// The parser rejects the expression.
    #[error("`{expression}`: {message}")]
    Syntax {
        /// The expression.
        expression: String,
        /// Message of the parser.
        message: String,
    },
    /// The expression uses a part of CEL that scripts do not have.
    #[error(
        "`{expression}`: {found} is not allowed; allowed are names, numbers, 'texts', true, false and the operators \
         + - * / == != < <= > >= && || ! ?:"
    )]
    NotAllowed {
        /// The expression.
        expression: String,
        /// Description of the rejected part.
        found: String,
    },
    /// The expression uses an entry without a value.
    #[error("`{statement}`: {{{key}}} is empty")]
    EmptyKey {
        /// The statement.
        statement: String,
        /// The key.
        key: String,
    },
    /// The expression has no value.
    #[error("`{statement}`: {message}")]
    Evaluation {
        /// The statement.
        statement: String,
        /// Message of the interpreter.
        message: String,
    },
    /// The entry does not accept the value.
    #[error("`{statement}`: {source}")]
    Write {
        /// The statement.
        statement: String,
        /// Cause.
        source: BlackboardError,
    },
}
