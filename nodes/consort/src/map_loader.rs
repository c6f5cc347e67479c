//! Loads maps: as routes for estimators and skills, and as floors for the simulator.

use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::file::{self, BYTES_MAX, FileReadError};
use consort_dashboard::loaded_map::LoadedMap;
use consort_map_import::ImportError;
use consort_skills::environment::TopologicalMap;
use consort_world::map;
use serde_json::Value;
use std::path::Path;

/// Checks whether a map of this name is bundled.
pub fn is_shipped(name: &str) -> bool {
    map::SHIPPED.contains(&name)
}

/// Loads a bundled map by name, or else a file by path.
///
/// # Errors
/// [`Diagnostics`] with all problems.
pub fn load(name: &str) -> Result<LoadedMap, Diagnostics> {
    if is_shipped(name) {
        return map::shipped(name).map(LoadedMap::from).map_err(|error| diagnostics(name, error));
    }
    parse(&read_text(name)?, name)
}

/// Reads the text of a map file.
///
/// # Errors
/// [`Diagnostics`] if it cannot be read, with the bundled maps.
pub fn read_text(name: &str) -> Result<String, Diagnostics> {
    file::read_text(Path::new(name), BYTES_MAX).map_err(|problem| match problem {
        FileReadError::Unreadable(_) => {
            let shipped = map::SHIPPED.join(", ");
            let what = format!("this map {problem}; give the path of a file, or a bundled map: {shipped}");
            Diagnostic::for_file(name, what).into()
        }
        FileReadError::TooLarge(..) | FileReadError::StreamTooLarge(_) => Diagnostic::for_file(name, problem).into(),
    })
}

/// Parses a map from the text of a file: in Consort's own format, as a drawing or a building by the
/// file's extension, or in the format of the published evaluation, which has `nodes` and `edges`.
/// `file` is its name in messages.
///
/// # Errors
/// [`Diagnostics`] with all problems.
pub fn parse(text: &str, file: &str) -> Result<LoadedMap, Diagnostics> {
    if is_published_format(text) {
        let topology = TopologicalMap::from_reference_json(text)
            .map_err(|error| Diagnostics::from(Diagnostic::for_file(file, error)))?;
        return Ok(LoadedMap { topology, map: None });
    }
    consort_map_import::read(text, file).map(LoadedMap::from).map_err(|error| diagnostics(file, error))
}

/// Checks whether a text is JSON with the keys of the published map.
pub fn is_published_format(text: &str) -> bool {
    let value: Result<Value, _> = serde_json::from_str(text);
    value.is_ok_and(|value| value.get("nodes").is_some() && value.get("edges").is_some())
}

/// Converts a map error to diagnostics of its file.
pub fn diagnostics(file: &str, error: impl Into<ImportError>) -> Diagnostics {
    let error = error.into();
    let in_content = error.in_content();
    if in_content.is_empty() {
        return Diagnostic { file: String::new(), position: None, message: error.to_string() }.into();
    }
    Diagnostics(in_content.iter().map(|error| Diagnostic::for_file(file, error)).collect())
}
