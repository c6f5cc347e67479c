//! What commands say: answers on the standard output, everything else on the standard error.

use crate::exit::Failure;
use indicatif::{ProgressBar, ProgressStyle};
use std::fmt::Display;
use std::io::{ErrorKind, IsTerminal, Write, stderr, stdout};
use std::time::Duration;

/// Writes a line, or several, to the standard output.
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

/// Writes a line to the standard error. Nobody to hear it is no problem.
pub fn note(text: impl Display) {
    let _ = writeln!(stderr().lock(), "{text}");
}

/// Says on the standard error what is waited for: on a terminal in one line that is overwritten, else a line for each
/// change.
pub struct Progress {
    /// What turns on a terminal while something is waited for.
    bar: Option<ProgressBar>,
    /// Whether lines are written where there is no terminal.
    in_lines: bool,
    said: String,
}

impl Default for Progress {
    fn default() -> Self {
        Progress::new()
    }
}

impl Progress {
    /// Says nothing yet.
    pub fn new() -> Progress {
        Progress { bar: None, in_lines: true, said: String::new() }
    }

    /// Says nothing yet, and nothing at all where there is no terminal: for what changes all the time.
    pub fn on_terminal() -> Progress {
        let mut waiting = Progress::new();
        waiting.in_lines = false;
        waiting
    }

    /// Says what is waited for now.
    pub fn show(&mut self, text: impl Display) {
        let text = text.to_string();
        if text == self.said {
            return;
        }
        if stderr().is_terminal() {
            self.bar.get_or_insert_with(spinner).set_message(text.clone());
        } else if self.in_lines {
            note(&text);
        }
        self.said = text;
    }

    /// Says how something goes on that goes on by itself: on a terminal alone, where it is overwritten.
    pub fn show_on_terminal(&mut self, text: impl Display) {
        if stderr().is_terminal() {
            self.show(text);
        }
    }

    /// Takes back what is on the terminal, so that something lasting can be written.
    pub fn clear(&mut self) {
        self.said.clear();
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

/// Lines in columns, each as wide as its widest entry; the last is left as it is.
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
