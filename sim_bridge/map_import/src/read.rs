//! Reads map files of any form.

use crate::drawing::{Drawing, map_name_from_path};
use crate::read_error::ReadError;
use crate::settings::{ImportOptions, MapFormat};
use crate::{drawio, lif, rmf};
use consort_world::map::{Map, MapError, MapFile, limits};
use std::path::Path;

/// A map file of any form could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The file cannot be read, has another form, or describes an invalid map.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The file has the right foreign form, but its content is invalid.
    #[error("{}", lines(file, diagnostics))]
    Invalid {
        /// The file as named.
        file: String,
        /// All errors, in the order of the file.
        diagnostics: Vec<ImportDiagnostic>,
    },
}

/// An error in a file of a foreign form.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ImportDiagnostic {
    /// An error in a drawing.
    #[error(transparent)]
    Drawing(#[from] drawio::DrawioDiagnostic),
    /// An error in a building of Open-RMF.
    #[error(transparent)]
    Building(#[from] rmf::RmfDiagnostic),
    /// An error in a layout.
    #[error(transparent)]
    Layout(#[from] lif::LifDiagnostic),
}

fn lines(file: &str, diagnostics: &[ImportDiagnostic]) -> String {
    diagnostics.iter().map(|error| format!("map {file}: {error}")).collect::<Vec<_>>().join("\n")
}

impl ImportError {
    /// Returns the errors in the content of the file, without its name. Empty if the content could
    /// not be read.
    pub fn in_content(&self) -> Vec<String> {
        match self {
            ImportError::Map(MapError::Invalid { diagnostics, .. }) => {
                diagnostics.iter().map(ToString::to_string).collect()
            }
            ImportError::Map(MapError::Syntax { message, .. }) => vec![message.clone()],
            ImportError::Map(_) => Vec::new(),
            ImportError::Invalid { diagnostics, .. } => diagnostics.iter().map(ToString::to_string).collect(),
        }
    }

    fn foreign<D: Into<ImportDiagnostic>>(file: &str, error: ReadError<D>) -> ImportError {
        let file = file.to_owned();
        match error {
            ReadError::Syntax(message) => MapError::Syntax { file, message }.into(),
            ReadError::Invalid(diagnostics) => {
                ImportError::Invalid { file, diagnostics: diagnostics.into_iter().map(Into::into).collect() }
            }
        }
    }
}

/// Reads a map from the text of a file. `file` names the file in errors; its ending gives the form
/// ([`MapFormat`]).
///
/// # Errors
/// [`ImportError`] with all errors of the file.
pub fn read(text: &str, file: &str) -> Result<Map, ImportError> {
    Ok(parse(text, file, &ImportOptions::default())?.map.check(file)?)
}

/// Reads a map and the items drawn on it from the text of a file. The map is not checked. The
/// ending of `file` gives the form, as in [`read`].
///
/// # Errors
/// [`MapError::TooLarge`] and [`MapError::Syntax`]; [`ImportError::Invalid`] for errors in a
/// drawing, a building or a layout.
pub fn parse(text: &str, file: &str, options: &ImportOptions) -> Result<Drawing, ImportError> {
    if text.len() > limits::FILE_BYTES {
        return Err(MapError::TooLarge { file: file.to_owned(), bytes: text.len() as u64 }.into());
    }
    let name = map_name_from_path(file);
    match MapFormat::of(file) {
        MapFormat::Drawing => drawio::read(text, &name, options).map_err(|error| ImportError::foreign(file, error)),
        MapFormat::Building => rmf::read(text, &name, options).map_err(|error| ImportError::foreign(file, error)),
        MapFormat::Layout => lif::read(text, &name).map_err(|error| ImportError::foreign(file, error)),
        MapFormat::Json | MapFormat::Yaml => Ok(MapFile::parse(text, file)?.into()),
    }
}

/// Reads a map file.
///
/// # Errors
/// [`MapError::Unreadable`], and all errors of the file as in [`read`].
pub fn load(path: &Path) -> Result<Map, ImportError> {
    let file = path.display().to_string();
    let unreadable = |source| MapError::Unreadable { file: file.clone(), source };
    let bytes = std::fs::metadata(path).map_err(unreadable)?.len();
    if bytes > limits::FILE_BYTES as u64 {
        return Err(MapError::TooLarge { file, bytes }.into());
    }
    read(&std::fs::read_to_string(path).map_err(unreadable)?, &file)
}
