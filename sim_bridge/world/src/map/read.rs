//! Reads map files of our own form, and the maps shipped with the program.

use super::check::check;
use super::diagnostic::MapDiagnostic;
use super::file::{MapFile, limits};
use super::model::Map;

/// A map could not be read. Common with files written by hand.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The file cannot be read.
    #[error("map {file}: {source}")]
    Unreadable {
        /// The file as named.
        file: String,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is larger than [`limits::FILE_BYTES`].
    #[error("map {file}: {bytes} bytes are more than the {max} allowed", max = limits::FILE_BYTES)]
    TooLarge {
        /// The file as named.
        file: String,
        /// Its size.
        bytes: u64,
    },
    /// The text has another format.
    #[error("map {file}: {message}")]
    Syntax {
        /// The file as named.
        file: String,
        /// The message of the parser, with line and column.
        message: String,
    },
    /// The text has the right format but describes an invalid map.
    #[error("{}", join(file, diagnostics))]
    Invalid {
        /// The file as named.
        file: String,
        /// All errors, in the order of the file.
        diagnostics: Vec<MapDiagnostic>,
    },
    /// No shipped map has this name.
    #[error("no map {name:?} is shipped; there are: {known}", known = SHIPPED.join(", "))]
    NotShipped {
        /// The name as given.
        name: String,
    },
}

fn join(file: &str, diagnostics: &[MapDiagnostic]) -> String {
    diagnostics.iter().map(|error| format!("map {file}: {error}")).collect::<Vec<_>>().join("\n")
}

/// Reads a map of our own form from the text of a file. `file` names the file in errors: the text
/// is JSON if the name ends in `.json`, else YAML.
///
/// # Errors
/// [`MapError`] with all errors of the file.
pub fn read(text: &str, file: &str) -> Result<Map, MapError> {
    MapFile::parse(text, file)?.check(file)
}

impl MapFile {
    /// Parses the text of a file of our own form, as [`read`] does. The map is not checked.
    ///
    /// # Errors
    /// [`MapError::TooLarge`] and [`MapError::Syntax`].
    pub fn parse(text: &str, file: &str) -> Result<MapFile, MapError> {
        if text.len() > limits::FILE_BYTES {
            return Err(MapError::TooLarge { file: file.to_owned(), bytes: text.len() as u64 });
        }
        let syntax = |message: String| MapError::Syntax { file: file.to_owned(), message };
        if file.to_ascii_lowercase().ends_with(".json") {
            serde_json::from_str(text).map_err(|error| syntax(error.to_string()))
        } else {
            serde_saphyr::from_str(text).map_err(|error| syntax(error.to_string()))
        }
    }

    /// Checks the content of the file and builds the map. `file` names the file in errors.
    ///
    /// # Errors
    /// [`MapError::Invalid`] with all errors.
    pub fn check(&self, file: &str) -> Result<Map, MapError> {
        check(self).map_err(|diagnostics| MapError::Invalid { file: file.to_owned(), diagnostics })
    }
}

/// Names of the shipped maps.
pub const SHIPPED: &[&str] = &["hospital", "clinic"];

const HOSPITAL: &str = include_str!("../../maps/hospital.yaml");
const CLINIC: &str = include_str!("../../maps/clinic.yaml");

/// Returns a shipped map.
///
/// # Errors
/// [`MapError::NotShipped`] lists the shipped maps.
pub fn shipped(name: &str) -> Result<Map, MapError> {
    shipped_file(name)?.check(&format!("{name}.yaml"))
}

/// Returns a shipped map as it is written.
///
/// # Errors
/// [`MapError::NotShipped`] lists the shipped maps.
pub fn shipped_file(name: &str) -> Result<MapFile, MapError> {
    match name {
        "hospital" => MapFile::parse(HOSPITAL, "hospital.yaml"),
        "clinic" => MapFile::parse(CLINIC, "clinic.yaml"),
        _ => Err(MapError::NotShipped { name: name.to_owned() }),
    }
}
