//! Division of missions into local plans, and the execution of these plans.

mod alternative_methods;
mod control_flow;
mod control_flow_crew;
mod hard_missions;
mod moved_items;
mod properties;
mod removed_signals;
mod team;
mod team_inspection;
mod trees;

use consort_protocol::mission::Domain;

/// The domain of this crate's tests.
fn domain() -> Domain {
    serde_saphyr::from_str(include_str!("../data/domain.yaml")).expect("a domain")
}
