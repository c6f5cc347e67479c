//! Division of missions into local plans, and what comes of it when the plans are carried out.

mod known;
mod properties;
mod support;
