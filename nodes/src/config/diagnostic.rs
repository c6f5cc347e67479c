//! What is wrong with a file, said so that its writer can mend it.

use std::fmt;

/// One thing that is wrong, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// The file as it was named; empty for flags.
    pub file: String,
    /// Line and column, from 1, where they are known.
    pub position: Option<(usize, usize)>,
    /// What is wrong, and what is allowed.
    pub message: String,
}

impl Diagnostic {
    /// A problem of a file as a whole, or of a place in it that the text names.
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

/// All that is wrong, in the order of the file; never empty. Ordinary with hand-written files; nothing was taken over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostics(pub Vec<Diagnostic>);

impl From<Diagnostic> for Diagnostics {
    fn from(problem: Diagnostic) -> Diagnostics {
        Diagnostics(vec![problem])
    }
}

impl Diagnostics {
    /// `Ok` if there is none.
    ///
    /// # Errors
    /// The problems, if there are any.
    pub fn into_result(problems: Vec<Diagnostic>) -> Result<(), Diagnostics> {
        if problems.is_empty() { Ok(()) } else { Err(Diagnostics(problems)) }
    }
}

impl fmt::Display for Diagnostics {
    /// One line a problem.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}

impl std::error::Error for Diagnostics {}
