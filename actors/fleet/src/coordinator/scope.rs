//! What a reconciliation examines.

use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::ledger::{Ledger, MissionEntry, RoleAssignment, service_order};
use std::collections::BTreeSet;

/// The missions and robots of a computation of actions.
#[derive(Clone, Copy)]
pub(super) enum Scope<'a> {
    /// All.
    All,
    /// Those of the latest commits.
    Changed {
        /// Missions that may have changed.
        missions: &'a BTreeSet<MissionId>,
        /// Robots that had, have or will get roles of these missions.
        robots: &'a BTreeSet<RobotId>,
    },
}

impl Scope<'_> {
    /// Returns the active missions, in the order in which they are served.
    pub(super) fn missions<'l>(&self, ledger: &'l Ledger) -> Vec<&'l MissionEntry> {
        let Scope::Changed { missions, .. } = self else { return ledger.active_missions() };
        let missions = missions.iter().filter_map(|mission| ledger.mission(mission));
        service_order(missions.filter(|entry| !entry.state.is_final()))
    }

    /// Returns the promised roles of the robots, those of each robot in their order.
    pub(super) fn promises<'l>(&self, ledger: &'l Ledger) -> Vec<(&'l MissionEntry, &'l RoleId, &'l RoleAssignment)> {
        match self {
            Scope::All => ledger.promises_in_order(),
            Scope::Changed { robots, .. } => robots.iter().flat_map(|robot| ledger.promises_of(robot)).collect(),
        }
    }
}
