//! Shared functions of the readers of foreign formats.

use super::{MapDiagnostic, MapError};

/// A file of a foreign format could not be read.
pub(super) enum ImportError {
    /// The text has another format.
    Syntax(String),
    /// The content is invalid.
    Invalid(Vec<MapDiagnostic>),
}

impl ImportError {
    pub(super) fn of(self, file: &str) -> MapError {
        let file = file.to_owned();
        match self {
            ImportError::Syntax(message) => MapError::Syntax { file, message },
            ImportError::Invalid(diagnostics) => MapError::Invalid { file, diagnostics },
        }
    }
}

/// Returns a text as a map name: characters that are not allowed become `-`.
pub(super) fn to_map_name(text: &str) -> String {
    let allowed = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '_' | '.' | '-');
    let name: String = text.trim().chars().map(|letter| if allowed(letter) { letter } else { '-' }).take(64).collect();
    if name.is_empty() { "map".to_owned() } else { name }
}

/// Returns a map name made from the name of the file.
pub(super) fn map_name_from_path(file: &str) -> String {
    let last = file.rsplit(['/', '\\']).next().unwrap_or(file);
    to_map_name(last.split('.').next().unwrap_or(last))
}

/// Rounds to 0.1 mm: no drawing is finer, and files stay readable. Never returns a negative zero.
pub(super) fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
