//! How commands end.

use crate::config::{Diagnostic, Diagnostics};
use std::process::ExitCode;

/// Why a command did not do what it was asked; the exit code says which kind it is.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// 1: what was asked for did not succeed: a mission failed, a check found problems, an actor failed.
    #[error("{0}")]
    Unsuccessful(String),
    /// 2: the flags or the files are wrong.
    #[error("{0}")]
    Usage(String),
    /// 3: nothing was reached, or nobody coordinates.
    #[error("{0}")]
    Unreachable(String),
    /// 130: somebody pressed Ctrl-C, or sent SIGTERM.
    #[error("interrupted")]
    Interrupted,
    /// 0: whoever read our output has closed it, as `head` does.
    #[error("the output was closed")]
    OutputClosed,
}

impl Failure {
    /// The exit code.
    pub fn code(&self) -> ExitCode {
        ExitCode::from(match self {
            Failure::OutputClosed => 0,
            Failure::Unsuccessful(_) => 1,
            Failure::Usage(_) => 2,
            Failure::Unreachable(_) => 3,
            Failure::Interrupted => 130,
        })
    }
}

impl From<Diagnostics> for Failure {
    fn from(problems: Diagnostics) -> Failure {
        Failure::Usage(problems.to_string())
    }
}

impl From<Diagnostic> for Failure {
    fn from(problem: Diagnostic) -> Failure {
        Failure::Usage(problem.to_string())
    }
}
