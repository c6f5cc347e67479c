//! Values for the unit tests of the ledger.

use super::apply::Ledger;
use super::command::{Command, CommandOutcome};
use super::history::HISTORY_SINCE;
use super::submission::Submission;
use crate::ids::RoleId;
use crate::lease::Epoch;
use crate::mission::{Mission, Role, RoleKind};
use crate::plan::{Division, LocalPlan};
use std::collections::BTreeMap;

/// Returns a submission of the mission `rounds`, whose only role `r1` has nothing to do.
pub(super) fn rounds(request: &str) -> Submission {
    let role: RoleId = "r1".parse().unwrap();
    let mission = Mission {
        name: "rounds".parse().unwrap(),
        roles: BTreeMap::from([(role.clone(), Role::of(RoleKind::Managed))]),
        ensembles: vec![],
        energy_max: None,
        tasks: vec![],
        results: BTreeMap::new(),
    };
    let plans = BTreeMap::from([(role.clone(), LocalPlan::of(role, vec![]))]);
    Submission::of(request.parse().unwrap(), mission, Division { plans })
}

/// A ledger and the index of its next entry.
pub(super) struct Log(pub(super) Ledger, pub(super) u64);

impl Log {
    /// A ledger of the wire version that has a history.
    pub(super) fn new() -> Log {
        let mut log = Log(Ledger::default(), 1);
        log.apply(Command::first_wire_version(HISTORY_SINCE));
        log
    }

    pub(super) fn apply(&mut self, command: Command) -> CommandOutcome {
        let at = Epoch { term: 1, index: self.1 };
        self.1 += 1;
        self.0.apply(at, command)
    }
}
