//! What is written down before it is told: nothing that a robot has told others may be news to its next life.
//!
//! ```text
//!  a step ended ──▶ note ──▶ [page due] ── begin ──▶ notebook ── done ──▶ what to tell now
//! ```

use consort_protocol::event::EventKind;
use consort_protocol::plan::Signal;

/// Something to be told once the page that holds it is written.
#[derive(Debug, Clone, PartialEq)]
pub enum PendingOutput {
    /// To another role.
    Signal(Signal),
    /// To whoever follows events.
    Event(EventKind),
}

/// One page at a time; what is noted meanwhile goes on the next.
#[derive(Debug, Default)]
pub struct CheckpointWriter {
    due: bool,
    waiting: Vec<PendingOutput>,
    writing: Option<Vec<PendingOutput>>,
    written: Vec<PendingOutput>,
}

impl CheckpointWriter {
    /// The page is out of date.
    pub fn mark_outdated(&mut self) {
        self.due = true;
    }

    /// The page is out of date, and this may be told once it no longer is.
    pub fn queue(&mut self, telling: PendingOutput) {
        self.due = true;
        self.waiting.push(telling);
    }

    /// Whether all is written down and told: something new may be begun.
    pub fn is_idle(&self) -> bool {
        !self.due && self.writing.is_none() && self.written.is_empty()
    }

    /// Whether the page is to be written now. The caller writes it, and says when that is [`done`](Pen::done).
    pub fn start_write(&mut self) -> bool {
        if !self.due || self.writing.is_some() {
            return false;
        }
        self.due = false;
        self.writing = Some(std::mem::take(&mut self.waiting));
        true
    }

    /// Whether a page is being written.
    pub fn is_writing(&self) -> bool {
        self.writing.is_some()
    }

    /// The page has been written.
    pub fn finish_write(&mut self) {
        self.written.extend(self.writing.take().into_iter().flatten());
    }

    /// What may be told now, in order. The caller tells it.
    pub fn take_ready(&mut self) -> Vec<PendingOutput> {
        std::mem::take(&mut self.written)
    }

    /// Lays the pen down for good: what was not told, in order.
    pub fn into_pending(mut self) -> Vec<PendingOutput> {
        self.finish_write();
        self.written.extend(self.waiting);
        self.written
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn telling(task: &str) -> PendingOutput {
        let signal = serde_json::json!({ "kind": "done", "task": task, "from": "r1", "to": "arm" });
        PendingOutput::Signal(serde_json::from_value(signal).unwrap())
    }

    #[test]
    fn nothing_is_told_before_it_is_written_and_nothing_is_told_twice() {
        let mut pen = CheckpointWriter::default();
        assert!(pen.is_idle() && !pen.start_write());
        pen.queue(telling("one"));
        assert!(!pen.is_idle());
        assert!(pen.start_write());
        pen.queue(telling("two"));
        assert!(!pen.start_write(), "one page at a time");
        assert_eq!(pen.take_ready(), []);
        pen.finish_write();
        assert_eq!(pen.take_ready(), [telling("one")]);
        assert!(!pen.is_idle());
        assert!(pen.start_write());
        pen.finish_write();
        assert!(!pen.is_idle(), "it is still to be told");
        assert_eq!(pen.take_ready(), [telling("two")]);
        assert!(pen.is_idle());
        assert_eq!(pen.take_ready(), []);
    }

    #[test]
    fn what_was_not_told_is_there_in_order_when_the_pen_is_laid_down() {
        let mut pen = CheckpointWriter::default();
        pen.queue(telling("one"));
        pen.start_write();
        pen.queue(telling("two"));
        assert_eq!(pen.into_pending(), [telling("one"), telling("two")]);
    }
}
