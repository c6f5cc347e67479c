//! Whole-fleet stories: the harness that they are told with.

mod fleet;

pub use fleet::{Fleet, Member, slug, topology};
