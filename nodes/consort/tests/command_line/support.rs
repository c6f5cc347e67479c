//! Helpers that run the binary.

pub(crate) use super::binary::command;
use super::free_port::free_port;
use std::path::PathBuf;
use std::process::{Child, Output};

/// Exit code and output of a command.
pub(crate) struct CommandOutput {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

pub(crate) fn run(args: &[&str]) -> CommandOutput {
    let Output { status, stdout, stderr } = command(args).output().expect("the binary starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("the binary writes UTF-8");
    CommandOutput { code: status.code(), out: text(stdout), err: text(stderr) }
}

/// Returns a free address of the loopback.
pub(crate) fn free_address() -> String {
    format!("tcp/127.0.0.1:{}", free_port())
}

/// Returns the path of a file of this crate.
pub(crate) fn crate_file(path: &str) -> String {
    format!("{}/{path}", env!("CARGO_MANIFEST_DIR"))
}

/// Writes a file for a test and returns its path.
pub(crate) fn test_file(name: &str, text: &str) -> String {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("command_line");
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    let path = folder.join(name);
    std::fs::write(&path, text).expect("cargo's own folder");
    path.display().to_string()
}

/// A process, killed on drop.
pub(crate) struct Running(pub(crate) Child);

impl Drop for Running {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
