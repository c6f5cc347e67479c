//! Domain files of a program, read once at its start.

use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::inputs;
use consort_protocol::mission::FILE_BYTES_MAX;
use consort_protocol::yaml;
use consort_skills::domain::shipped_domain;
use consort_skills::domain_file::{DomainFile, DomainForm};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A domain with its file.
#[derive(Debug, Clone)]
pub struct LoadedDomain {
    /// The file.
    pub path: PathBuf,
    /// The domain.
    pub domain: DomainFile,
}

/// Reads a domain file and the trees that it names. It is used with the `known` domains.
///
/// # Errors
/// [`Diagnostics`] with every problem of the files.
fn load(path: &Path, known: &[LoadedDomain]) -> Result<LoadedDomain, Diagnostics> {
    let known: Vec<&DomainFile> = known.iter().map(|loaded| &loaded.domain).collect();
    let domain = parse(path, &inputs::read_text(path)?, &known)?;
    Ok(LoadedDomain { path: path.to_owned(), domain })
}

/// Checks the text of a domain file, with the trees beside it and the `known` domains.
///
/// # Errors
/// [`Diagnostics`] with every problem.
pub(crate) fn parse(path: &Path, text: &str, known: &[&DomainFile]) -> Result<DomainFile, Diagnostics> {
    let file = path.display().to_string();
    if text.len() > FILE_BYTES_MAX {
        let what = format!("the domain file has {} bytes; at most {FILE_BYTES_MAX} are allowed", text.len());
        return Err(Diagnostic::for_file(file, what).into());
    }
    let form: DomainForm = yaml::parse(text).map_err(|problem| Diagnostic::for_file(&file, problem))?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let tree = |name: &str| Ok((name.to_owned(), inputs::read_text(&folder.join(name))?));
    let trees = form.tree_files().map(tree).collect::<Result<BTreeMap<_, _>, Diagnostics>>()?;
    let known: Vec<&DomainFile> = [shipped_domain()].into_iter().chain(known.iter().copied()).collect();
    DomainFile::check(form, &trees, &known)
        .map_err(|problems| Diagnostics(problems.iter().map(|problem| Diagnostic::for_file(&file, problem)).collect()))
}

/// Reads domain files in addition to those already read, unless they are among them. They are kept until
/// the program ends.
///
/// # Errors
/// [`Diagnostics`] of the files.
pub(crate) fn load_more(
    already: &'static [LoadedDomain],
    paths: &[PathBuf],
) -> Result<&'static [LoadedDomain], Diagnostics> {
    let mut loaded = already.to_vec();
    for path in paths {
        let file = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if !loaded.iter().any(|other| file(&other.path) == file(path)) {
            loaded.push(load(path, &loaded)?);
        }
    }
    Ok(loaded.leak())
}
