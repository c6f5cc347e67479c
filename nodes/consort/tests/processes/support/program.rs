//! Process of the program under test.

use super::{Folder, within};
use serde_json::Value;
use std::fs::{self, File};
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

/// A process of `consort`, killed on drop.
pub(crate) struct Program {
    child: Child,
    what: String,
    stdout: PathBuf,
    stderr: PathBuf,
}

/// Exit status and output of a process.
pub(crate) struct Ended {
    pub(crate) status: ExitStatus,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
    what: String,
}

impl Program {
    /// Starts `consort` with these arguments; `name` is unique in the folder. Its standard input
    /// stays open as long as this value lives.
    pub(crate) fn start(folder: &Folder, name: &str, arguments: &[&str]) -> Program {
        Program::start_by(&[], folder, name, arguments)
    }

    /// Same, through another program that replaces itself by `consort`.
    pub(crate) fn start_by(by: &[&str], folder: &Folder, name: &str, arguments: &[&str]) -> Program {
        let file = |end: &str| folder.path().join(format!("{name}.{end}"));
        let (stdout, stderr) = (file("out"), file("err"));
        let create = |path: &PathBuf| File::create(path).expect("the folder can be written to");
        let line = [by, &[env!("CARGO_BIN_EXE_consort")], arguments].concat();
        let mut command = Command::new(line[0]);
        command.args(&line[1..]).env("TMPDIR", folder.temporary()).current_dir(folder.path());
        command.stdin(Stdio::piped()).stdout(create(&stdout)).stderr(create(&stderr));
        // Settings in the environment of the tests must not reach the program.
        let foreign = std::env::vars_os().map(|(name, _)| name);
        for name in foreign.filter(|name| name.to_string_lossy().starts_with("CONSORT_") || name == "RUST_LOG") {
            command.env_remove(name);
        }
        let child = command.spawn().expect("the program can be started");
        Program { child, what: format!("consort {}", arguments.join(" ")), stdout, stderr }
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal, for example `INT`.
    pub(crate) fn signal(&self, name: &str) {
        let kill = Command::new("kill").arg(format!("-{name}")).arg(self.id().to_string()).status();
        assert!(kill.expect("there is a program `kill`").success(), "{} has ended already", self.what);
    }

    /// Ends the process with SIGKILL and waits for it.
    pub(crate) fn kill(&mut self) {
        self.child.kill().expect("a child can be killed");
        self.child.wait().expect("a child can be waited for");
    }

    /// Returns its standard output so far.
    pub(crate) fn stdout(&self) -> String {
        fs::read_to_string(&self.stdout).unwrap_or_default()
    }

    /// Returns its standard error so far.
    pub(crate) fn stderr(&self) -> String {
        fs::read_to_string(&self.stderr).unwrap_or_default()
    }

    /// Checks whether the process has ended.
    pub(crate) fn has_ended(&mut self) -> bool {
        self.child.try_wait().expect("a child can be polled").is_some()
    }

    /// Waits until the process ends by itself.
    #[track_caller]
    pub(crate) fn end(mut self, limit: Duration) -> Ended {
        let status = within(limit, || self.child.try_wait().expect("a child can be polled"));
        let status = status.unwrap_or_else(|| {
            panic!("{} has not ended after {limit:?}\n{}\n{}", self.what, self.stdout(), self.stderr())
        });
        Ended { status, stdout: self.stdout(), stderr: self.stderr(), what: self.what.clone() }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Ended {
    /// Returns the exit code.
    ///
    /// # Panics
    /// If a signal ended the process.
    #[track_caller]
    pub(crate) fn code(&self) -> i32 {
        let signal = self.status.signal();
        let Ended { what, stderr, .. } = self;
        self.status.code().unwrap_or_else(|| panic!("{what} was ended by signal {signal:?}\n--- its errors\n{stderr}"))
    }

    /// Checks the exit code; panics with the output if it differs.
    #[track_caller]
    pub(crate) fn expect(self, code: i32) -> Ended {
        let Ended { what, stdout, stderr, .. } = &self;
        assert_eq!(self.code(), code, "exit code of {what}\n--- its output\n{stdout}\n--- its errors\n{stderr}");
        self
    }

    /// Parses the output as a JSON value.
    #[track_caller]
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|problem| panic!("{}: no JSON: {problem}\n{}", self.what, self.stdout))
    }

    /// Parses each line of the output as a JSON value.
    #[track_caller]
    pub(crate) fn json_lines(&self) -> Vec<Value> {
        let read = |line: &str| {
            serde_json::from_str(line).unwrap_or_else(|problem| panic!("{}: no JSON: {problem}: {line}", self.what))
        };
        self.stdout.lines().map(read).collect()
    }
}
