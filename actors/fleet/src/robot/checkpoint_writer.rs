//! Output that waits for a checkpoint: everything that a robot has sent is contained in the
//! checkpoint that its next incarnation restores.
//!
//! ```text
//!  a step ended ──▶ queue ──▶ [write due] ── start_write ──▶ store ── finish_write ──▶ outputs to send now
//! ```

use consort_protocol::event::EventKind;
use consort_protocol::plan::Signal;

/// Output to be sent once a checkpoint contains its step.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum PendingOutput {
    /// A signal to another role.
    Signal(Signal),
    /// An event for subscribers.
    Event(EventKind),
}

/// Order of checkpoint writes. At most 1 write is in progress; output queued meanwhile waits for
/// the next write.
#[derive(Debug, Default)]
pub(super) struct CheckpointWriter {
    due: bool,
    waiting: Vec<PendingOutput>,
    writing: Option<Vec<PendingOutput>>,
    written: Vec<PendingOutput>,
}

impl CheckpointWriter {
    /// Marks the stored checkpoint as outdated.
    pub(super) fn mark_outdated(&mut self) {
        self.due = true;
    }

    /// Marks the stored checkpoint as outdated and queues an output until the next write has
    /// finished.
    pub(super) fn queue(&mut self, output: PendingOutput) {
        self.due = true;
        self.waiting.push(output);
    }

    /// Checks whether all output is stored and sent, so that a new task may start.
    pub(super) fn is_idle(&self) -> bool {
        !self.due && self.writing.is_none() && self.written.is_empty()
    }

    /// Starts a write if it is due. If this returns true, the caller writes the checkpoint and then
    /// calls [`finish_write`](CheckpointWriter::finish_write).
    pub(super) fn start_write(&mut self) -> bool {
        if !self.due || self.writing.is_some() {
            return false;
        }
        self.due = false;
        self.writing = Some(std::mem::take(&mut self.waiting));
        true
    }

    /// Checks whether a write is in progress.
    pub(super) fn is_writing(&self) -> bool {
        self.writing.is_some()
    }

    /// Marks the write in progress as finished.
    pub(super) fn finish_write(&mut self) {
        self.written.extend(self.writing.take().into_iter().flatten());
    }

    /// Takes the outputs that may be sent now, in order. The caller sends them.
    pub(super) fn take_ready(&mut self) -> Vec<PendingOutput> {
        std::mem::take(&mut self.written)
    }

    /// Returns all unsent outputs in order.
    pub(super) fn into_pending(mut self) -> Vec<PendingOutput> {
        self.finish_write();
        self.written.extend(self.waiting);
        self.written
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn output(task: &str) -> PendingOutput {
        let signal = serde_json::json!({ "kind": "done", "task": task, "from": "r1", "to": "arm" });
        PendingOutput::Signal(serde_json::from_value(signal).unwrap())
    }

    #[test]
    fn each_output_is_released_once_and_only_after_its_write() {
        let mut writer = CheckpointWriter::default();
        assert!(writer.is_idle() && !writer.start_write());
        writer.queue(output("one"));
        assert!(!writer.is_idle());
        assert!(writer.start_write());
        writer.queue(output("two"));
        assert!(!writer.start_write(), "one write at a time");
        assert_eq!(writer.take_ready(), []);
        writer.finish_write();
        assert_eq!(writer.take_ready(), [output("one")]);
        assert!(!writer.is_idle());
        assert!(writer.start_write());
        writer.finish_write();
        assert!(!writer.is_idle(), "it is still to be sent");
        assert_eq!(writer.take_ready(), [output("two")]);
        assert!(writer.is_idle());
        assert_eq!(writer.take_ready(), []);
    }

    #[test]
    fn unsent_outputs_are_returned_in_order() {
        let mut writer = CheckpointWriter::default();
        writer.queue(output("one"));
        writer.start_write();
        writer.queue(output("two"));
        assert_eq!(writer.into_pending(), [output("one"), output("two")]);
    }
}
