//! Text for people: counts with their nouns, limits of length, and suggestions for misspelt names.
//! Used by every crate that words a message.

mod allowed_names;

pub use allowed_names::AllowedNames;

use std::borrow::Cow;
use std::fmt::Display;

/// Formats a count with its noun: `1 robot`, `0 robots`, `2 people`. A verb that depends on the
/// number belongs to the noun (`robot is`, `robots are`).
pub fn count<N: Display + PartialEq + From<u8>>(number: N, singular: &str, plural: &str) -> String {
    let noun = if number == N::from(1) { singular } else { plural };
    format!("{number} {noun}")
}

/// Sign in place of the omitted end of a text.
const OMITTED: &str = "…";

/// Shortens a text to at most `bytes_max` bytes: its end is replaced by `…`.
pub fn shorten(text: &str, bytes_max: usize) -> Cow<'_, str> {
    if text.len() <= bytes_max {
        return Cow::Borrowed(text);
    }
    let kept = (0..=bytes_max.saturating_sub(OMITTED.len())).rev().find(|at| text.is_char_boundary(*at));
    Cow::Owned([&text[..kept.unwrap_or(0)], OMITTED].concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_text_is_shortened_between_two_characters() {
        assert_eq!(shorten("no route", 8), "no route");
        assert_eq!(shorten("no route!", 8), "no ro…");
        assert_eq!(shorten("nööööö", 8), "nöö…");
    }

    #[test]
    fn the_singular_is_used_only_for_the_number_1() {
        assert_eq!(count(0_usize, "person is", "people are"), "0 people are");
        assert_eq!(count(1_u64, "person is", "people are"), "1 person is");
        assert_eq!(count(21_u32, "person is", "people are"), "21 people are");
    }
}
