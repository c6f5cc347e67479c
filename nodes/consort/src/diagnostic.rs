//! Diagnostics of configuration files, with position and allowed values.

use std::fmt;

/// A problem in a file, with its position.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// The file as given by the user; empty for flags.
    pub file: String,
    /// Line and column, counted from 1, if known.
    pub position: Option<(usize, usize)>,
    /// The problem, and the allowed values.
    pub message: String,
}

impl Diagnostic {
    /// Creates a diagnostic of a whole file, or of a position that the text contains.
    pub fn for_file(file: impl fmt::Display, what: impl fmt::Display) -> Diagnostic {
        Diagnostic { file: file.to_string(), position: None, message: what.to_string() }
    }
}

impl fmt::Display for Diagnostic {
    /// `fleet.toml:3:1: unknown key …`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.file.as_str(), self.position) {
            ("", _) => write!(f, "{}", self.message),
            (file, None) => write!(f, "{file}: {}", self.message),
            (file, Some((line, column))) => write!(f, "{file}:{line}:{column}: {}", self.message),
        }
    }
}

/// All problems, in the order of the file; never empty. Common with hand-written files; nothing was
/// applied.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostics(pub Vec<Diagnostic>);

impl From<Diagnostic> for Diagnostics {
    fn from(problem: Diagnostic) -> Diagnostics {
        Diagnostics(vec![problem])
    }
}

impl Diagnostics {
    /// Returns `Ok` if there are no problems.
    ///
    /// # Errors
    /// The problems, if there are any.
    pub fn into_result(problems: Vec<Diagnostic>) -> Result<(), Diagnostics> {
        if problems.is_empty() { Ok(()) } else { Err(Diagnostics(problems)) }
    }

    /// Names the file in diagnostics without a file: those of an object that the file refers to.
    #[must_use]
    pub fn with_file(mut self, file: impl fmt::Display) -> Diagnostics {
        for problem in self.0.iter_mut().filter(|problem| problem.file.is_empty()) {
            problem.file = file.to_string();
        }
        self
    }
}

impl fmt::Display for Diagnostics {
    /// Prints a line for each problem.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}

impl std::error::Error for Diagnostics {}
