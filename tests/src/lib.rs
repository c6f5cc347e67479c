//! Whole-fleet stories.
