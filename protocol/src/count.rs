//! Numbers of things, in words for people.

use std::fmt::Display;

/// So many of something: `1 robot`, `0 robots`, `2 people`. A verb that goes with the number stands with the noun
/// (`robot is`, `robots are`).
pub fn count<N: Display + PartialEq + From<u8>>(number: N, one: &str, many: &str) -> String {
    let what = if number == N::from(1) { one } else { many };
    format!("{number} {what}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_is_one() {
        assert_eq!(count(0_usize, "person is", "people are"), "0 people are");
        assert_eq!(count(1_u64, "person is", "people are"), "1 person is");
        assert_eq!(count(21_u32, "person is", "people are"), "21 people are");
    }
}
