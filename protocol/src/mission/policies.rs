//! Check of the policies of a mission: its ensembles, and the conditions of its roles.

use super::diagnostic::{MissionDiagnostic, MissionErrorKind};
use super::domain::Domain;
use super::limits::ENSEMBLES_MAX;
use super::model::{Mission, RoleKind};
use super::structure::at;
use crate::ensemble::Eligibility;
use consort_text::AllowedNames;

pub(super) fn policy_problems(mission: &Mission, domain: &Domain) -> Vec<MissionDiagnostic> {
    let mut found = vec![];
    if mission.ensembles.len() > ENSEMBLES_MAX {
        let kind = MissionErrorKind::TooManyEnsembles { found: mission.ensembles.len(), max: ENSEMBLES_MAX };
        found.push(at("ensembles", kind));
    }
    if let Some(known) = domain.ensembles() {
        for name in mission.ensembles.iter().filter(|name| !known.contains(name)) {
            let allowed = AllowedNames::suggest_for(name.as_str(), known);
            found.push(at("ensembles", MissionErrorKind::UnknownEnsemble { name: name.clone(), allowed }));
        }
    }
    for (id, role) in &mission.roles {
        let Some(text) = &role.eligible else { continue };
        let problem = match role.kind {
            RoleKind::Unmanaged => Err("only a managed role has a condition on its robot".to_owned()),
            RoleKind::Managed => Eligibility::compile(text).map(drop),
        };
        let expression = |problem| MissionErrorKind::Expression { text: text.clone(), problem };
        found.extend(problem.err().map(|problem| at(&format!("roles/{id}/eligible"), expression(problem))));
    }
    found
}
