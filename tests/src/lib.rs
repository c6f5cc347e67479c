//! Whole-fleet stories: the harness that they are told with.

pub mod behavior;
pub mod chaos;
mod checks;
mod chronicle;
mod client;
pub mod disk;
pub mod experiment;
mod fleet;
mod look;
mod member;
mod papers;
mod stations;
mod ward;

pub use chronicle::{Chronicle, Entry, Spell};
pub use fleet::{Adjust, Fleet};
pub use member::Member;
pub use papers::Papers;
pub use stations::Stations;

use std::fmt;

/// A name or another slug that the test itself wrote.
pub fn slug<T: std::str::FromStr<Err: fmt::Debug>>(text: &str) -> T {
    text.parse().expect("a test's own name")
}

/// Tells a story once for each seed, each time on a paused runtime of its own: nothing of one run is left in the next.
pub fn tell(seeds: impl IntoIterator<Item = u64>, story: impl AsyncFn(u64)) {
    for seed in seeds {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let runtime = builder.enable_time().start_paused(true).build().expect("a runtime");
        runtime.block_on(story(seed));
    }
}
