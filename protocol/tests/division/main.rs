//! Division of missions into local plans, and what comes of it when the plans are carried out.

mod known;
mod moved_items;
mod other_methods;
mod properties;
mod support;
