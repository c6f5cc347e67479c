//! The program `consort-lab`, which this program starts for `consort lab` and for files that only
//! the laboratory reads.

use crate::exit::Failure;
use std::env;
use std::ffi::OsStr;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

const NAME: &str = "consort-lab";

/// Returns a command for `consort-lab`: the file beside this program, or else the first in `PATH`.
pub(crate) fn command<A: AsRef<OsStr>>(args: impl IntoIterator<Item = A>) -> Command {
    let beside = env::current_exe().ok().map(|program| program.with_file_name(NAME)).filter(|file| file.is_file());
    let mut command = Command::new(beside.unwrap_or_else(|| PathBuf::from(NAME)));
    command.args(args);
    command
}

/// Returns the failure to start `consort-lab`.
pub(crate) fn not_started(problem: &std::io::Error) -> Failure {
    Failure::Usage(format!(
        "{NAME} cannot be started: {problem}; it is a program of its own, expected beside this program or in PATH. From the \
         sources: cargo build --release -p {NAME}"
    ))
}

/// Replaces this process by `consort-lab`.
///
/// # Errors
/// Returns only if the program cannot be started: [`Failure::Usage`].
pub(crate) fn replace_process<A: AsRef<OsStr>>(args: impl IntoIterator<Item = A>) -> Failure {
    not_started(&command(args).exec())
}
