//! Values of flags that are more than a number or a text.

use consort_protocol::ledger::{Priority, time_until_deadline};
use consort_protocol::timing::Timing;
use consort_protocol::units::{BatteryShare, Seconds, UnitError};
use std::fmt::Display;
use std::time::Duration;

/// The value of a flag is not allowed; the text says which values are.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InvalidValue(String);

impl InvalidValue {
    /// Creates the error with a text for people.
    pub fn new(text: impl Display) -> InvalidValue {
        InvalidValue(text.to_string())
    }
}

/// Reads `NAME=VALUE`.
pub(super) fn key_value(text: &str) -> Result<(String, String), InvalidValue> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err(InvalidValue::new("expected NAME=VALUE, as room='IC Room 6'")),
    }
}

/// Reads a priority.
pub(super) fn priority(text: &str) -> Result<Priority, InvalidValue> {
    let number = text
        .parse()
        .map_err(|_| InvalidValue::new(format_args!("{text:?} is not a whole number; allowed are -100 to 100")))?;
    Priority::new(number).map_err(InvalidValue::new)
}

/// Reads the time until a deadline, in seconds.
pub(super) fn deadline(text: &str) -> Result<f64, InvalidValue> {
    let number =
        text.parse().map_err(|_| InvalidValue::new(format_args!("{text:?} is not a number of seconds from now")))?;
    time_until_deadline(number).map(|_| number).map_err(InvalidValue::new)
}

/// Reads a battery share.
pub(super) fn share(text: &str) -> Result<BatteryShare, InvalidValue> {
    quantity(text, BatteryShare::new)
}

/// Reads seconds.
pub(super) fn seconds(text: &str) -> Result<Seconds, InvalidValue> {
    quantity(text, Seconds::new)
}

/// Reads a number with a unit.
pub(super) fn quantity<Q>(text: &str, new: impl Fn(f64) -> Result<Q, UnitError>) -> Result<Q, InvalidValue> {
    let number: f64 = text.parse().map_err(|_| InvalidValue::new(format_args!("{text:?} is not a number")))?;
    new(number).map_err(InvalidValue::new)
}

/// Reads the name of a timing preset.
pub(super) fn timing(text: &str) -> Result<Timing, InvalidValue> {
    match text {
        "lan" => Ok(Timing::Lan),
        "wifi" => Ok(Timing::Wifi),
        _ => Err(InvalidValue::new("allowed is lan or wifi")),
    }
}

/// Parses a duration: a number with `s`, `m`, `h` or `d`; without a unit, seconds.
///
/// # Errors
/// [`InvalidValue`] with the expected format.
pub(super) fn parse_duration(text: &str) -> Result<Duration, InvalidValue> {
    let (number, unit_s) = match text.trim().char_indices().last() {
        Some((at, 's')) => (&text[..at], 1.0),
        Some((at, 'm')) => (&text[..at], 60.0),
        Some((at, 'h')) => (&text[..at], 3600.0),
        Some((at, 'd')) => (&text[..at], 86_400.0),
        _ => (text, 1.0),
    };
    let seconds = number.trim().parse::<f64>().ok().filter(|number| *number > 0.0).map(|number| number * unit_s);
    let length = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    length.ok_or_else(|| InvalidValue::new("expected a duration above 0, as 60s, 5m, 2h or 30d"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_duration_has_a_unit_or_is_in_seconds() {
        for (text, seconds) in
            [("60s", 60.0), ("1.5m", 90.0), ("2h", 7200.0), ("30d", 2_592_000.0), ("90", 90.0), ("0.5 s", 0.5)]
        {
            assert_eq!(parse_duration(text).unwrap().as_secs_f64(), seconds, "{text}");
        }
        for text in ["", "s", "0", "-3s", "1e300h", "NaN", "5 weeks", "5w", "é"] {
            assert!(parse_duration(text).unwrap_err().to_string().contains("as 60s, 5m, 2h or 30d"), "{text}");
        }
    }
}
