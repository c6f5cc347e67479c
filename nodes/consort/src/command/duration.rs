//! Durations on the command line.

use std::time::Duration;

/// Parses a duration: a number with `s`, `m`, `h` or `d`; without a unit, seconds.
///
/// # Errors
/// A message with the expected format.
pub(super) fn parse_duration(text: &str) -> Result<Duration, String> {
    let (number, unit_s) = match text.trim().char_indices().last() {
        Some((at, 's')) => (&text[..at], 1.0),
        Some((at, 'm')) => (&text[..at], 60.0),
        Some((at, 'h')) => (&text[..at], 3600.0),
        Some((at, 'd')) => (&text[..at], 86_400.0),
        _ => (text, 1.0),
    };
    let seconds = number.trim().parse::<f64>().ok().filter(|number| *number > 0.0).map(|number| number * unit_s);
    let length = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    length.ok_or_else(|| "expected a duration above 0, as 60s, 5m, 2h or 30d".to_owned())
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
            assert!(parse_duration(text).unwrap_err().contains("as 60s, 5m, 2h or 30d"), "{text}");
        }
    }
}
