//! Values for the unit tests of the ledger.

use super::submission::Submission;
use crate::ids::RoleId;
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
