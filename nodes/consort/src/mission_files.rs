//! Checks missions, and reads the mission files of a fleet at the start of a node.

use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::inputs;
use crate::people_asked::question_problems;
use consort_protocol::ids::PlaceId;
use consort_protocol::mission::{Domain, Mission, MissionDocument, TemplateKind};
use consort_protocol::plan::divide_and_check;
use consort_skills::library::SkillLibrary;
use consort_skills::missions::NamedMissions;
use consort_text::count;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Reads and checks the mission files of a fleet. `domain` contains the task types, places and ensembles of the
/// fleet, `library` its skills.
///
/// # Errors
/// [`Diagnostics`] of all files: problems of each mission, and names that are taken.
pub(crate) fn of_fleet(
    paths: &[PathBuf],
    domain: &Domain,
    library: &SkillLibrary,
) -> Result<NamedMissions, Diagnostics> {
    let mut missions = NamedMissions::default();
    let mut problems = vec![];
    for path in paths {
        if let Err(Diagnostics(found)) = add(&mut missions, path, domain, library) {
            problems.extend(found);
        }
    }
    Diagnostics::into_result(problems).map(|()| missions)
}

fn add(missions: &mut NamedMissions, path: &Path, domain: &Domain, library: &SkillLibrary) -> Result<(), Diagnostics> {
    let file = path.display().to_string();
    let document = inputs::mission_file(path, &[])?;
    describe(&document, &file, domain, library)?;
    let name = document.name().clone();
    missions.add(document).map_err(|taken| Diagnostic::for_file(&file, format!("mission {name}: {taken}")).into())
}

/// Checks a mission with its defaults, and describes its size. A parameter without a default gets a value of its
/// kind.
///
/// # Errors
/// [`Diagnostics`] with the problems of the mission.
pub(crate) fn describe(
    document: &MissionDocument,
    file: &str,
    domain: &Domain,
    library: &SkillLibrary,
) -> Result<String, Diagnostics> {
    let place = domain.places().and_then(|places| places.first()).map_or("Some Place", PlaceId::as_str);
    let sample = |kind: TemplateKind| match kind {
        TemplateKind::Place | TemplateKind::Places => place,
        TemplateKind::Seconds | TemplateKind::Number => "1",
        TemplateKind::Text | TemplateKind::Texts => "some text",
    };
    let open = document.parameters().iter().filter(|(_, parameter)| parameter.default.is_none());
    let given: BTreeMap<String, String> =
        open.map(|(name, parameter)| (name.clone(), sample(parameter.kind).to_owned())).collect();
    let (mission, recovery) = document
        .instantiate_with_recovery(&given, domain)
        .map_err(|errors| inputs::mission_diagnostics(file, &errors))?;
    let recovery = recovery.map(|recovery| size(&recovery, file, library)).transpose()?;
    let of_recovery = recovery.map(|size| format!(", recovery with {size}"));
    Ok(format!("{}{}", size(&mission, file, library)?, of_recovery.unwrap_or_default()))
}

/// Describes the size of a mission, after checking that it can be carried out.
fn size(mission: &Mission, file: &str, library: &SkillLibrary) -> Result<String, Diagnostics> {
    let questions = question_problems(mission, library).into_iter();
    Diagnostics::into_result(questions.map(|problem| Diagnostic::for_file(file, problem)).collect())?;
    let division = divide_and_check(mission).map_err(|error| Diagnostics::from(Diagnostic::for_file(file, error)))?;
    let steps = division.plans.values().map(|plan| plan.steps.len()).sum();
    let roles = count(mission.roles.len(), "role", "roles");
    Ok(format!("{roles}, {}", count::<usize>(steps, "step", "steps")))
}
