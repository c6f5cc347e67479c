//! The lines between the node and this driver, as `docs/reference/driver.md` describes them.

use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::io::{BufRead as _, Write as _};
use std::sync::mpsc;
use std::time::Duration;
use std::{io, thread};
use tokio::sync::mpsc::{Receiver, channel};

/// Maximum size of a line.
const LINE_BYTES_MAX: usize = 64 * 1024;

/// A message of the node. Unknown messages and unknown fields are ignored.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(crate) enum NodeLine {
    Start {},
    Goal {
        id: String,
        action: String,
        #[serde(default)]
        parameters: Map<String, Value>,
        keep_for_ms: u64,
        /// True if an earlier process of the driver ended during the goal.
        #[serde(default)]
        resumed: bool,
        /// First goal with which an earlier process of the node may have begun this goal.
        #[serde(default)]
        since: Option<String>,
    },
    Keep {
        id: String,
        keep_for_ms: u64,
    },
    Cancel {
        id: String,
    },
    Heartbeat {
        sequence: u64,
    },
    Shutdown {},
    #[serde(other)]
    Unknown,
}

/// What arrives on the input.
#[derive(Debug)]
pub(crate) enum Input {
    Line(NodeLine),
    /// A line that is no message.
    Wrong(String),
    End,
}

/// Returns a permission.
pub(crate) fn permission(keep_for_ms: u64) -> Duration {
    // A day is longer than any permission, and short enough to be added to a time.
    Duration::from_millis(keep_for_ms.min(86_400_000))
}

/// Reads the standard input in a thread of its own.
pub(crate) fn read_input() -> Receiver<Input> {
    let (sender, receiver) = channel(64);
    thread::spawn(move || {
        let mut input = io::stdin().lock();
        let mut line = vec![];
        loop {
            line.clear();
            let message = match input.read_until(b'\n', &mut line) {
                Ok(0) | Err(_) => Input::End,
                Ok(_) => match parse(&line) {
                    Some(input) => input,
                    None => continue,
                },
            };
            let is_end = matches!(message, Input::End);
            if sender.blocking_send(message).is_err() || is_end {
                return;
            }
        }
    });
    receiver
}

fn parse(line: &[u8]) -> Option<Input> {
    if line.len() > LINE_BYTES_MAX {
        return Some(Input::Wrong(format!("a line of {} bytes; at most {LINE_BYTES_MAX} are allowed", line.len())));
    }
    let line = line.trim_ascii();
    (!line.is_empty()).then(|| match serde_json::from_slice(line) {
        Ok(message) => Input::Line(message),
        Err(problem) => Input::Wrong(problem.to_string()),
    })
}

/// Writes lines to the standard output in a thread of its own, so that a slow reader delays nothing
/// else.
#[derive(Debug, Clone)]
pub(crate) struct Output(mpsc::Sender<Value>);

impl Output {
    pub(crate) fn start() -> Output {
        let (sender, receiver) = mpsc::channel::<Value>();
        thread::spawn(move || {
            let mut output = io::stdout().lock();
            for message in receiver {
                // A node that is gone reads nothing; the end of the input ends this process.
                let _ = writeln!(output, "{message}").and_then(|()| output.flush());
            }
        });
        Output(sender)
    }

    pub(crate) fn send(&self, kind: &str, mut message: Value) {
        message["type"] = json!(kind);
        // The writer lives as long as the process.
        let _ = self.0.send(message);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_as_the_reference_describes() {
        let read = |text: &str| parse(text.as_bytes());
        let goal = r#"{"type":"goal","id":"7","action":"dock","keep_for_ms":900,"resumed":true,"later":1}"#;
        assert!(matches!(read(goal), Some(Input::Line(NodeLine::Goal { keep_for_ms: 900, resumed: true, .. }))));
        let goal = r#"{"type":"goal","id":"7","action":"dock","keep_for_ms":900,"since":"5"}"#;
        let since = |since: &Option<String>| since.as_deref() == Some("5");
        assert!(matches!(read(goal), Some(Input::Line(NodeLine::Goal { since: first, .. })) if since(&first)));
        assert!(matches!(read(r#"{"type":"sing"}"#), Some(Input::Line(NodeLine::Unknown))));
        assert!(matches!(read("{"), Some(Input::Wrong(_))));
        assert!(matches!(parse(b"\xff\xfe\n"), Some(Input::Wrong(_))));
        assert!(read(" \n").is_none());
        assert!(matches!(parse(&vec![b' '; LINE_BYTES_MAX + 1]), Some(Input::Wrong(_))));
        assert_eq!(permission(u64::MAX), Duration::from_secs(86_400));
    }
}
