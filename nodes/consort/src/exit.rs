//! Errors and exit codes of commands.

use crate::diagnostic::{Diagnostic, Diagnostics};
use consort_dashboard::address::AddressUnavailable;
use std::process::ExitCode;

/// Failure of a command; its kind determines the exit code.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// 1: the operation failed: a mission failed, a check found problems, an actor failed.
    #[error("{0}")]
    Unsuccessful(String),
    /// 2: the flags or the files are wrong.
    #[error("{0}")]
    Usage(String),
    /// 3: no node was reached, or there is no coordinator.
    #[error("{0}")]
    Unreachable(String),
    /// 130: interrupted by Ctrl-C or SIGTERM.
    #[error("interrupted")]
    Interrupted,
    /// 0: the reader of the output has closed it, as `head` does.
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

impl From<AddressUnavailable> for Failure {
    fn from(problem: AddressUnavailable) -> Failure {
        Failure::Usage(problem.to_string())
    }
}

impl From<Diagnostic> for Failure {
    fn from(problem: Diagnostic) -> Failure {
        Failure::Usage(problem.to_string())
    }
}
