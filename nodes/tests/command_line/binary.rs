//! The program under test.

use std::ffi::OsStr;
use std::process::Command;

/// The binary, without what the environment of the tests might tell it.
pub(crate) fn consort<A: AsRef<OsStr>>(args: &[A]) -> Command {
    program(env!("CARGO_BIN_EXE_consort"), args)
}

/// Another program of ours, likewise.
pub(crate) fn program<A: AsRef<OsStr>>(path: impl AsRef<OsStr>, args: &[A]) -> Command {
    let mut command = Command::new(path);
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("CONSORT_")) {
        command.env_remove(name);
    }
    command.env_remove("RUST_LOG").args(args);
    command
}
