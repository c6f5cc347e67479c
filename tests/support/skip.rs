//! Report of a skipped test. Each test crate includes this file with `#[path]`.

use std::fs::OpenOptions;
use std::io::Write as _;
use std::panic::Location;
use std::thread;

/// Variable with the file that lists the skipped tests. `.ci/run` sets it and prints a summary.
const LIST: &str = "CONSORT_SKIPPED";

/// Reports that the current test is skipped: on the standard error, also without `--nocapture`, and
/// in the list of skipped tests. The reason names what is missing and how to get it.
#[track_caller]
pub(crate) fn skip(reason: &str) {
    let current = thread::current();
    // The harness names the thread of a test after the test; with a single thread there is no such
    // thread.
    let test = match current.name() {
        Some(name) if name != "main" => name.to_owned(),
        _ => Location::caller().to_string(),
    };
    let reason = reason.lines().next().unwrap_or_default();
    // A test never fails because of its report.
    let _ = writeln!(std::io::stderr(), "skipped: {test}: {reason}");
    if let Some(list) = std::env::var_os(LIST) {
        let line = format!("{test}\t{reason}\n");
        let _ = OpenOptions::new()
            .create(true)
            .append(true)
            .open(list)
            .and_then(|mut file| file.write_all(line.as_bytes()));
    }
}
