//! Recordings of fleets: written, read back, truncated, and replayed.

mod files;
mod scrubbing;
mod support;
