//! The program under test.

use std::ffi::OsStr;
use std::process::Command;

/// Returns a command for the binary, without Consort variables from the environment of the tests.
pub(crate) fn command<A: AsRef<OsStr>>(args: &[A]) -> Command {
    program(env!("CARGO_BIN_EXE_consort"), args)
}

/// Returns a command for another program of this project, with the same environment.
pub(crate) fn program<A: AsRef<OsStr>>(path: impl AsRef<OsStr>, args: &[A]) -> Command {
    let mut command = Command::new(path);
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("CONSORT_")) {
        command.env_remove(name);
    }
    command.env_remove("RUST_LOG").args(args);
    command
}
