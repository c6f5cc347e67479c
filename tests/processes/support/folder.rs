//! A folder of a test's own, by which its processes are known.

use super::within;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// A folder that is removed at the end, and with it every process that bears its name.
pub(crate) struct Folder(PathBuf);

impl Folder {
    /// An empty folder.
    pub(crate) fn new() -> Folder {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        // The stroke at the end keeps `…-1` from being part of `…-10`.
        // In a namespace of its own every test is process 1 or 2.
        let outside = std::env::var("CONSORT_HOSTS_INSIDE").map(|id| format!("{id}-")).unwrap_or_default();
        let own = format!("story-{outside}{}-{number}-", std::process::id());
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(own);
        fs::create_dir_all(&path).expect("the folder for tests can be written to");
        Folder(path)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// Writes a file, and says where it is.
    pub(crate) fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.join(name);
        fs::write(&path, text).expect("the folder can be written to");
        path
    }

    /// A folder in it, which programs take for the system's folder for temporary files.
    pub(crate) fn temporary(&self) -> PathBuf {
        let path = self.0.join("tmp");
        fs::create_dir_all(&path).expect("the folder can be written to");
        path
    }

    /// What lies in the folder for temporary files.
    pub(crate) fn temporary_files(&self) -> Vec<String> {
        let entries = fs::read_dir(self.temporary()).expect("the folder can be read");
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect()
    }

    /// The processes that carry the folder's path on their command line or in their environment, with their command lines.
    pub(crate) fn processes(&self) -> Vec<(u32, String)> {
        let mark = self.0.display().to_string();
        let bears = |text: &[u8]| String::from_utf8_lossy(text).contains(&mark);
        let pids = fs::read_dir("/proc").expect("Linux tells of its processes");
        let pids = pids.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<u32>().ok());
        // Whoever ends meanwhile, and whoever is another user's, cannot be read and is not ours. One that has ended and
        // only waits to be reaped has neither line nor environment.
        let ours = pids.filter(|pid| *pid != std::process::id()).filter_map(|pid| {
            let line = fs::read(format!("/proc/{pid}/cmdline")).ok()?;
            let environment = fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
            let line_text = String::from_utf8_lossy(&line).replace('\0', " ");
            (bears(&line) || bears(&environment)).then_some((pid, line_text))
        });
        ours.collect()
    }

    /// Waits until no process is left.
    #[track_caller]
    pub(crate) fn await_no_process(&self, limit: Duration) {
        let ended = within(limit, || self.processes().is_empty().then_some(()));
        assert!(ended.is_some(), "processes are left after {limit:?}: {:#?}", self.processes());
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        for (pid, _) in self.processes() {
            // One that has ended meanwhile cannot be killed.
            let _ = Command::new("kill").arg("-KILL").arg(pid.to_string()).status();
        }
        let _ = fs::remove_dir_all(&self.0);
    }
}
