//! Folder of a test, which also identifies its processes.

use super::within;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Limit for processes to end after the process that started them.
const END_LIMIT: Duration = Duration::from_secs(30);

/// A folder that is removed on drop. Every process with the path of the folder is killed then.
pub(crate) struct Folder(PathBuf);

impl Folder {
    /// Creates an empty folder.
    pub(crate) fn new() -> Folder {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        // The final hyphen keeps `…-1` from matching `…-10`. In its own namespace every test is
        // process 1 or 2.
        let outside = std::env::var("CONSORT_HOSTS_INSIDE").map(|id| format!("{id}-")).unwrap_or_default();
        let own = format!("story-{outside}{}-{number}-", std::process::id());
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(own);
        fs::create_dir_all(&path).expect("the folder for tests can be written to");
        Folder(path)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// Writes a file and returns its path.
    pub(crate) fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.join(name);
        fs::write(&path, text).expect("the folder can be written to");
        path
    }

    /// Returns a subfolder that processes use for temporary files.
    pub(crate) fn temporary(&self) -> PathBuf {
        let path = self.0.join("tmp");
        fs::create_dir_all(&path).expect("the folder can be written to");
        path
    }

    /// Returns the names of the temporary files.
    pub(crate) fn temporary_files(&self) -> Vec<String> {
        let entries = fs::read_dir(self.temporary()).expect("the folder can be read");
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect()
    }

    /// Returns the processes with the path of the folder on their command line or in their
    /// environment, with their command lines.
    pub(crate) fn processes(&self) -> Vec<(u32, String)> {
        let mark = self.0.display().to_string();
        let bears = |text: &[u8]| String::from_utf8_lossy(text).contains(&mark);
        let pids = fs::read_dir("/proc").expect("Linux lists its processes");
        let pids = pids.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<u32>().ok());
        // Processes that end meanwhile and processes of other users are unreadable, and do not
        // belong to this test. A process that has ended but is not reaped has neither a command
        // line nor an environment.
        let ours = pids.filter(|pid| *pid != std::process::id()).filter_map(|pid| {
            let line = fs::read(format!("/proc/{pid}/cmdline")).ok()?;
            let environment = fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
            let line_text = String::from_utf8_lossy(&line).replace('\0', " ");
            (bears(&line) || bears(&environment)).then_some((pid, line_text))
        });
        ours.collect()
    }

    /// Waits until no process remains.
    #[track_caller]
    pub(crate) fn await_no_process(&self) {
        let ended = within(END_LIMIT, || self.processes().is_empty().then_some(()));
        assert!(ended.is_some(), "processes are left after {END_LIMIT:?}: {:#?}", self.processes());
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        for (pid, _) in self.processes() {
            // The process may have ended already.
            let _ = Command::new("kill").arg("-KILL").arg(pid.to_string()).status();
        }
        let _ = fs::remove_dir_all(&self.0);
    }
}
