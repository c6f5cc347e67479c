//! Recordings of fleets: written, read back, cut short, and looked at from all sides.

mod files;
mod scrubbing;
mod support;
