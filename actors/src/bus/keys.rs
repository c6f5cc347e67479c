//! Keys and payloads as both buses take them, so that what is wrong on one is wrong on the other, and in the same words.

use super::BusError;
use zenoh_keyexpr::{OwnedKeyExpr, keyexpr};

fn wrong(key: &str, problem: impl ToString) -> BusError {
    BusError::Key { key: key.to_owned(), problem: problem.to_string() }
}

/// A key expression, wildcards allowed. It must be canonical: `a/**/*`, and not `a/*/**`.
pub(super) fn key_expression(text: &str) -> Result<OwnedKeyExpr, BusError> {
    OwnedKeyExpr::new(text).map_err(|problem| wrong(text, problem))
}

/// One key, without wildcards: what is published, announced or answered has exactly one name.
pub(super) fn single_key(text: &str) -> Result<OwnedKeyExpr, BusError> {
    let key = key_expression(text)?;
    if key.as_str().contains('*') { Err(wrong(text, "it holds a wildcard where one key is needed")) } else { Ok(key) }
}

/// A selector: a key expression, and after the first `?`, if there is one, the parameters.
pub(super) fn selector(text: &str) -> Result<(OwnedKeyExpr, &str), BusError> {
    let (key, parameters) = text.split_once('?').unwrap_or((text, ""));
    Ok((key_expression(key)?, parameters))
}

/// The key of an answer, which must be one that was asked for.
pub(super) fn reply_key(text: &str, asked: &keyexpr) -> Result<OwnedKeyExpr, BusError> {
    let key = single_key(text)?;
    if asked.intersects(&key) { Ok(key) } else { Err(wrong(text, format!("it answers a query for `{asked}`"))) }
}

/// Refuses a payload that would not pass the receivers' limit for a whole message.
pub(super) fn check_payload_size(what: &str, payload: &[u8], message_max: usize) -> Result<(), BusError> {
    let payload_max = message_max.saturating_sub(ENVELOPE_MAX);
    if payload.len() <= payload_max {
        return Ok(());
    }
    let problem = format!("a payload of {} bytes exceeds the limit of {payload_max}", payload.len());
    Err(BusError::Failed { operation: what.to_owned(), problem })
}

/// What a message may hold beside its payload: key, encoding, parameters and the protocol's own.
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
    fn what_is_published_or_answered_has_one_name() {
        assert!(single_key("fleet/**").is_err());
        let asked = key_expression("fleet/*/bid").unwrap();
        assert!(reply_key("fleet/ada/bid", &asked).is_ok());
        let error = reply_key("fleet/ada/state", &asked).unwrap_err().to_string();
        assert_eq!(error, "\"fleet/ada/state\" is no key expression: it answers a query for `fleet/*/bid`");
    }

    #[test]
    fn an_expression_must_be_canonical() {
        for text in ["", "/a", "a/", "a//b", "a/**/**", "a/*/**/**", "a?b", "a#b", "a/b*"] {
            assert!(key_expression(text).is_err(), "{text:?}");
        }
    }
}
