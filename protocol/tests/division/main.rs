//! Division of missions into local plans, and what comes of it when the plans are carried out.

mod alternative_methods;
mod known_missions;
mod moved_items;
mod properties;
mod support;
