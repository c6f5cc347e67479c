//! Separation of a script into statements, and of an assignment into its two sides.

use super::error::ScriptError;

/// A statement, as text.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Statement<'t> {
    /// The whole statement, for messages.
    pub(super) text: &'t str,
    pub(super) assignment: Option<(&'t str, Assign)>,
    /// The right side of an assignment, or the whole statement.
    pub(super) expression: &'t str,
}

/// Operator of an assignment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Assign {
    /// `:=` declares or changes an entry.
    Declare,
    /// `=` changes an entry.
    Set,
    /// `+=`, `-=`, `*=`, `/=` combine the value of an entry with the right side. Contains the
    /// arithmetic operator.
    Combine(u8),
}

/// Separates the statements of a script. Empty statements are left out.
///
/// # Errors
/// [`ScriptError`] for a text without an end, a token that CEL accepts and scripts do not have, a
/// left side that is not a name, and a script without a statement.
pub(super) fn split(script: &str) -> Result<Vec<Statement<'_>>, ScriptError> {
    let mut statements = Vec::new();
    let mut begin = 0;
    for (at, byte) in plain_bytes(script)? {
        if byte == b';' {
            statements.push(&script[begin..at]);
            begin = at + 1;
        }
    }
    statements.push(&script[begin..]);
    let statements = statements.into_iter().map(str::trim).filter(|text| !text.is_empty());
    let statements: Vec<_> = statements.map(statement).collect::<Result<_, _>>()?;
    if statements.is_empty() { Err(ScriptError::NoStatement) } else { Ok(statements) }
}

fn statement(text: &str) -> Result<Statement<'_>, ScriptError> {
    let bytes = text.as_bytes();
    let mut after_comparison = 0;
    for (at, byte) in plain_bytes(text)? {
        if byte != b'=' || at < after_comparison {
            continue;
        }
        let before = at.checked_sub(1).map(|index| bytes[index]);
        let (assign, length) = match before {
            _ if bytes.get(at + 1) == Some(&b'=') => {
                after_comparison = at + 2;
                continue;
            }
            Some(b'!' | b'<' | b'>') => continue,
            Some(b':') => (Assign::Declare, 2),
            Some(operator @ (b'+' | b'-' | b'*' | b'/')) => (Assign::Combine(operator), 2),
            _ => (Assign::Set, 1),
        };
        let target = text[..at + 1 - length].trim();
        if !is_name(target) {
            return Err(ScriptError::Target { target: target.to_owned() });
        }
        return Ok(Statement { text, assignment: Some((target, assign)), expression: text[at + 1..].trim() });
    }
    Ok(Statement { text, assignment: None, expression: text })
}

fn is_name(text: &str) -> bool {
    let is_letter = |byte: u8| byte.is_ascii_alphabetic() || byte == b'_';
    let mut bytes = text.bytes();
    bytes.next().is_some_and(is_letter) && bytes.all(|byte| is_letter(byte) || byte.is_ascii_digit())
}

/// Returns the bytes outside of texts, with their positions.
fn plain_bytes(script: &str) -> Result<Vec<(usize, u8)>, ScriptError> {
    let bytes = script.as_bytes();
    let mut plain = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while let Some(&byte) = bytes.get(at) {
        match byte {
            b'\'' => {
                let end = text_end(bytes, at + 1);
                at = end.ok_or(ScriptError::Token { found: "'", allowed: "a text ends with another `'`" })?;
            }
            b'"' => {
                return Err(ScriptError::Token { found: "\"", allowed: "a text is enclosed in single quotes: 'text'" });
            }
            b'/' if bytes.get(at + 1) == Some(&b'/') => {
                return Err(ScriptError::Token { found: "//", allowed: "a script has no comments" });
            }
            _ => plain.push((at, byte)),
        }
        at += 1;
    }
    Ok(plain)
}

/// Returns the position of the quote that ends the text from `begin`. A backslash escapes the byte
/// after it.
fn text_end(bytes: &[u8], begin: usize) -> Option<usize> {
    let mut at = begin;
    loop {
        match bytes.get(at)? {
            b'\'' => return Some(at),
            b'\\' => at += 2,
            _ => at += 1,
        }
    }
}
