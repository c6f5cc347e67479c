//! Domain files of a program, read once at its start.

use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::inputs;
use consort_driver::Contract;
use consort_protocol::mission::FILE_BYTES_MAX;
use consort_protocol::yaml;
use consort_skills::domain_file::{DomainFile, DomainForm};
use consort_skills::environment::Environment;
use consort_skills::extensions::{ExtensionError, Extensions};
use consort_skills::library::SkillLibrary;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Checks the text of a domain file that is used with these extensions, and the trees beside it.
///
/// # Errors
/// [`Diagnostics`] with every problem.
pub(crate) fn parse(path: &Path, text: &str, extensions: Extensions) -> Result<DomainFile, Diagnostics> {
    let file = path.display().to_string();
    if text.len() > FILE_BYTES_MAX {
        let what = format!("the domain file has {} bytes; at most {FILE_BYTES_MAX} are allowed", text.len());
        return Err(Diagnostic::for_file(file, what).into());
    }
    let form: DomainForm = yaml::parse(text).map_err(|problem| Diagnostic::for_file(&file, problem))?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let tree = |name: &str| Ok((name.to_owned(), inputs::read_text(&folder.join(name))?));
    let trees = form.tree_files().map(tree).collect::<Result<BTreeMap<_, _>, Diagnostics>>()?;
    let known: Vec<&DomainFile> = extensions.files().collect();
    DomainFile::check(form, &trees, &known)
        .map_err(|problems| Diagnostics(problems.iter().map(|problem| Diagnostic::for_file(&file, problem)).collect()))
}

/// Returns the extensions with more domain files. Files that are already among them are left out.
///
/// # Errors
/// [`Diagnostics`] of the files.
pub fn with_files(extensions: Extensions, paths: &[PathBuf]) -> Result<Extensions, Diagnostics> {
    paths.iter().try_fold(extensions, |extensions, path| {
        let file = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if extensions.domains.iter().any(|other| file(&other.path) == file(path)) {
            return Ok(extensions);
        }
        let domain = parse(path, &inputs::read_text(path)?, extensions)?;
        Ok(extensions.with_domain(path, domain))
    })
}

/// Returns the skills of the domains, without a map.
///
/// # Errors
/// [`Diagnostics`] of the domains.
pub(crate) fn library(extensions: Extensions) -> Result<SkillLibrary, Diagnostics> {
    extensions.library(Environment::new()).map_err(|problem| diagnostic(problem).into())
}

/// Returns the actions that drivers may offer, and the readings that they may send.
pub(crate) fn driver_contract(extensions: Extensions) -> Contract {
    Contract::new(extensions.files())
}

/// Returns the diagnostic of an extension.
pub(crate) fn diagnostic(error: ExtensionError) -> Diagnostic {
    Diagnostic::for_file(error.source_name, error.problem)
}
