//! Output of commands: answers on the standard output, everything else on the standard error.

use crate::exit::Failure;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::Value;
use std::fmt::Display;
use std::io::{ErrorKind, IsTerminal, Write, stderr, stdout};
use std::process::ExitCode;
use std::time::Duration;

/// Writes text and a newline to the standard output.
///
/// # Errors
/// [`Failure::OutputClosed`] when its reader has gone, which ends the command quietly.
pub fn line(text: impl Display) -> Result<(), Failure> {
    let mut out = stdout().lock();
    writeln!(out, "{text}").and_then(|()| out.flush()).map_err(|problem| match problem.kind() {
        ErrorKind::BrokenPipe => Failure::OutputClosed,
        _ => Failure::Unsuccessful(format!("the standard output cannot be written to: {problem}")),
    })
}

/// Writes a value as a line of JSON to the standard output.
///
/// # Errors
/// See [`line()`].
///
/// # Panics
/// The value has no JSON form: its maps have keys that are no strings.
pub fn json(value: &impl Serialize) -> Result<(), Failure> {
    line(serde_json::to_string(value).expect("results of commands have a JSON form"))
}

/// Returns the JSON form of a value.
///
/// # Panics
/// See [`json`].
pub fn to_value(value: &impl Serialize) -> Value {
    serde_json::to_value(value).expect("results of commands have a JSON form")
}

/// Writes a line to the standard error. A closed standard error is ignored.
pub fn note(text: impl Display) {
    let _ = writeln!(stderr().lock(), "{text}");
}

/// Prints the failure of a command, if any, after the name of the program, and returns its exit
/// code.
pub fn exit_code(program: &str, done: Result<(), Failure>) -> ExitCode {
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if !matches!(failure, Failure::OutputClosed) {
                note(format_args!("{program}: {failure}"));
            }
            failure.code()
        }
    }
}

/// Shows progress on the standard error: on a terminal in a line that is overwritten, else a line
/// for each change.
pub struct Progress {
    /// The spinner on a terminal.
    bar: Option<ProgressBar>,
    /// True if lines are written without a terminal.
    in_lines: bool,
    is_muted: bool,
    shown: String,
}

impl Default for Progress {
    fn default() -> Self {
        Progress::new()
    }
}

impl Progress {
    /// Creates a progress output without text.
    pub fn new() -> Progress {
        Progress { bar: None, in_lines: true, is_muted: false, shown: String::new() }
    }

    /// Creates a progress output that writes to terminals only: for text that changes all the time.
    pub fn on_terminal() -> Progress {
        let mut waiting = Progress::new();
        waiting.in_lines = false;
        waiting
    }

    /// Shows the current activity.
    pub fn show(&mut self, text: impl Display) {
        let text = text.to_string();
        if self.is_muted || text == self.shown {
            return;
        }
        if stderr().is_terminal() {
            self.bar.get_or_insert_with(spinner).set_message(text.clone());
        } else if self.in_lines {
            note(&text);
        }
        self.shown = text;
    }

    /// Shows nothing from now on: the command draws on the whole terminal.
    pub(crate) fn mute(&mut self) {
        self.clear();
        self.is_muted = true;
    }

    /// Shows a frequently changing text: on a terminal only, where it is overwritten.
    pub(crate) fn show_on_terminal(&mut self, text: impl Display) {
        if stderr().is_terminal() {
            self.show(text);
        }
    }

    /// Clears the terminal line, so that permanent output can be written.
    pub fn clear(&mut self) {
        self.shown.clear();
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

fn spinner() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {msg}").expect("the template is sound"));
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.clear();
    }
}

/// Formats rows in columns, each as wide as its widest cell; the last column is not padded.
pub fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max();
    let widths: Vec<usize> = (0..columns).map(|column| width(column).unwrap_or(0)).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}"));
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}
