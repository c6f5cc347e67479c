//! Whole-fleet stories: the harness that they are told with.

mod checks;
mod chronicle;
mod client;
mod fleet;
mod look;
mod member;

pub use chronicle::{Chronicle, Entry, Spell};
pub use fleet::Fleet;
pub use member::Member;

use std::fmt;

/// A name or another slug that the test itself wrote.
pub fn slug<T: std::str::FromStr<Err: fmt::Debug>>(text: &str) -> T {
    text.parse().expect("a test's own name")
}
