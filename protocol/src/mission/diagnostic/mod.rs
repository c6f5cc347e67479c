//! Diagnostics of missions, worded so that the author can correct the mission.

mod ihtn;
mod kind;

pub use ihtn::IhtnError;
pub use kind::MissionErrorKind;

use consort_text::count;
use std::fmt;

/// Error: a mission is invalid, with all diagnostics. Common for a mission written by hand; nothing
/// was changed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissionErrors {
    /// Name of the mission, as given in it.
    pub mission: String,
    /// Diagnostics in the order of the file. Never empty.
    pub diagnostics: Vec<MissionDiagnostic>,
}

impl fmt::Display for MissionErrors {
    /// Writes 1 line for the mission, then 1 line per diagnostic.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "mission {} has {}:", self.mission, count(self.diagnostics.len(), "problem", "problems"))?;
        self.diagnostics.iter().try_for_each(|problem| write!(f, "\n  {problem}"))
    }
}

impl std::error::Error for MissionErrors {}

impl MissionErrors {
    /// Returns `Ok` if there are no diagnostics.
    pub(in crate::mission) fn ok_if_empty(
        mission: impl fmt::Display,
        problems: Vec<MissionDiagnostic>,
    ) -> Result<(), Self> {
        if problems.is_empty() { Ok(()) } else { Err(Self { mission: mission.to_string(), diagnostics: problems }) }
    }
}

/// Problem with its place in the mission.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissionDiagnostic {
    /// Place: the tasks from the root down (`root/meet_clerk/navto_room`), or another part of the
    /// file (`roles/clerk`, `parameters/room`).
    pub path: String,
    /// Kind of problem.
    pub kind: MissionErrorKind,
}

impl fmt::Display for MissionDiagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path, self.kind)
    }
}
