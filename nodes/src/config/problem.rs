//! What is wrong with a file, said so that its writer can mend it.

use std::fmt;

/// One thing that is wrong, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// The file as it was named; empty for flags.
    pub file: String,
    /// Line and column, from 1, where they are known.
    pub at: Option<(usize, usize)>,
    /// What is wrong, and what is allowed.
    pub what: String,
}

impl Problem {
    /// A problem of a file as a whole, or of a place in it that the text names.
    pub fn of(file: impl fmt::Display, what: impl fmt::Display) -> Problem {
        Problem { file: file.to_string(), at: None, what: what.to_string() }
    }
}

impl fmt::Display for Problem {
    /// `fleet.toml:3:1: unknown key …`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.file.as_str(), self.at) {
            ("", _) => write!(f, "{}", self.what),
            (file, None) => write!(f, "{file}: {}", self.what),
            (file, Some((line, column))) => write!(f, "{file}:{line}:{column}: {}", self.what),
        }
    }
}

/// All that is wrong, in the order of the file; never empty. Ordinary with hand-written files; nothing was taken over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problems(pub Vec<Problem>);

impl From<Problem> for Problems {
    fn from(problem: Problem) -> Problems {
        Problems(vec![problem])
    }
}

impl Problems {
    /// `Ok` if there is none.
    ///
    /// # Errors
    /// The problems, if there are any.
    pub fn unless_none(problems: Vec<Problem>) -> Result<(), Problems> {
        if problems.is_empty() { Ok(()) } else { Err(Problems(problems)) }
    }
}

impl fmt::Display for Problems {
    /// One line a problem.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}

impl std::error::Error for Problems {}
