//! Validation of keys and payloads, shared by both buses. Both reject the same input with the same
//! error text.

use crate::bus::BusError;
use zenoh_keyexpr::{OwnedKeyExpr, keyexpr};

fn key_error(key: &str, problem: impl ToString) -> BusError {
    BusError::Key { key: key.to_owned(), problem: problem.to_string() }
}

/// Parses a key expression. Wildcards are allowed. The expression must be canonical: `a/**/*`, not
/// `a/*/**`.
pub(super) fn key_expression(text: &str) -> Result<OwnedKeyExpr, BusError> {
    OwnedKeyExpr::new(text).map_err(|problem| key_error(text, problem))
}

/// Parses a key without wildcards. Publications, tokens and replies need exactly one key.
pub(super) fn single_key(text: &str) -> Result<OwnedKeyExpr, BusError> {
    let key = key_expression(text)?;
    if key.as_str().contains('*') { Err(key_error(text, "a key without wildcards is required")) } else { Ok(key) }
}

/// Parses a selector: a key expression and, after the first `?`, optional parameters.
pub(super) fn selector(text: &str) -> Result<(OwnedKeyExpr, &str), BusError> {
    let (key, parameters) = text.split_once('?').unwrap_or((text, ""));
    Ok((key_expression(key)?, parameters))
}

/// Parses the key of a reply. It must match the key expression of the query.
pub(super) fn reply_key(text: &str, query: &keyexpr) -> Result<OwnedKeyExpr, BusError> {
    let key = single_key(text)?;
    if query.intersects(&key) {
        Ok(key)
    } else {
        Err(key_error(text, format!("it does not match the query `{query}`")))
    }
}

/// Checks that a payload fits into the receivers' limit for a whole message.
pub(super) fn check_payload_size(operation: &str, payload: &[u8], message_max: usize) -> Result<(), BusError> {
    let payload_max = message_max.saturating_sub(ENVELOPE_MAX);
    if payload.len() <= payload_max {
        return Ok(());
    }
    let problem = format!("a payload of {} bytes exceeds the limit of {payload_max}", payload.len());
    Err(BusError::Failed { operation: operation.to_owned(), problem })
}

/// Bytes reserved per message for key, encoding, parameters, attachment and the protocol's own
/// header.
const ENVELOPE_MAX: usize = 4 * 1024;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_selector_is_split_at_the_first_question_mark() {
        let (key, parameters) = selector("fleet/*?a=1;b=x?y").unwrap();
        assert_eq!((key.as_str(), parameters), ("fleet/*", "a=1;b=x?y"));
        assert_eq!(selector("fleet/*").unwrap().1, "");
    }

    #[test]
    fn publications_and_replies_need_a_single_key() {
        assert!(single_key("fleet/**").is_err());
        let query = key_expression("fleet/*/bid").unwrap();
        assert!(reply_key("fleet/ada/bid", &query).is_ok());
        let error = reply_key("fleet/ada/state", &query).unwrap_err().to_string();
        assert_eq!(error, "\"fleet/ada/state\" is not a valid key: it does not match the query `fleet/*/bid`");
    }

    #[test]
    fn a_key_expression_must_be_canonical() {
        for text in ["", "/a", "a/", "a//b", "a/**/**", "a/*/**/**", "a?b", "a#b", "a/b*"] {
            assert!(key_expression(text).is_err(), "{text:?}");
        }
    }
}
