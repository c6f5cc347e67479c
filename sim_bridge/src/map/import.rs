//! What the readers of foreign formats share.

use super::{MapDiagnostic, MapError};

/// Why a file of a foreign format is not read.
pub(super) enum ImportError {
    /// It is not of the format.
    Syntax(String),
    /// It says what cannot be.
    Problems(Vec<MapDiagnostic>),
}

impl ImportError {
    pub(super) fn of(self, file: &str) -> MapError {
        let file = file.to_owned();
        match self {
            ImportError::Syntax(message) => MapError::Syntax { file, message },
            ImportError::Problems(problems) => MapError::Invalid { file, problems },
        }
    }
}

/// A text as the name of a map: what may not stand in one becomes `-`.
pub(super) fn to_map_name(text: &str) -> String {
    let known = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '_' | '.' | '-');
    let name: String = text.trim().chars().map(|letter| if known(letter) { letter } else { '-' }).take(64).collect();
    if name.is_empty() { "map".to_owned() } else { name }
}

/// The name of a map of which only the file's name is known.
pub(super) fn map_name_from_path(file: &str) -> String {
    let last = file.rsplit(['/', '\\']).next().unwrap_or(file);
    to_map_name(last.split('.').next().unwrap_or(last))
}

/// To a tenth of a millimetre: no drawing is finer, and files stay legible. Never a negative zero.
pub(super) fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
