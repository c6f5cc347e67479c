//! Division of missions into local plans, and the execution of these plans.

mod alternative_methods;
mod known_missions;
mod moved_items;
mod properties;
mod support;
