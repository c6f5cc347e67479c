//! What is written down before it is told: nothing that a robot has told others may be news to its next life.
//!
//! ```text
//!  a step ended ──▶ note ──▶ [page due] ── begin ──▶ notebook ── done ──▶ what to tell now
//! ```

use consort_protocol::event::Happening;
use consort_protocol::plan::Signal;

/// Something to be told once the page that holds it is written.
#[derive(Debug, Clone, PartialEq)]
pub enum Telling {
    /// To another role.
    Signal(Signal),
    /// To whoever follows events.
    Event(Happening),
}

/// One page at a time; what is noted meanwhile goes on the next.
#[derive(Debug, Default)]
pub struct Pen {
    due: bool,
    waiting: Vec<Telling>,
    writing: Option<Vec<Telling>>,
    written: Vec<Telling>,
}

impl Pen {
    /// The page is out of date.
    pub fn soil(&mut self) {
        self.due = true;
    }

    /// The page is out of date, and this may be told once it no longer is.
    pub fn note(&mut self, telling: Telling) {
        self.due = true;
        self.waiting.push(telling);
    }

    /// Whether all is written down and told: something new may be begun.
    pub fn is_idle(&self) -> bool {
        !self.due && self.writing.is_none() && self.written.is_empty()
    }

    /// Whether the page is to be written now. The caller writes it, and says when that is [`done`](Pen::done).
    pub fn begin(&mut self) -> bool {
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
    pub fn done(&mut self) {
        self.written.extend(self.writing.take().into_iter().flatten());
    }

    /// What may be told now, in order. The caller tells it.
    pub fn take_written(&mut self) -> Vec<Telling> {
        std::mem::take(&mut self.written)
    }

    /// Lays the pen down for good: what was not told, in order.
    pub fn abandon(mut self) -> Vec<Telling> {
        self.done();
        self.written.extend(self.waiting);
        self.written
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn telling(task: &str) -> Telling {
        let signal = serde_json::json!({ "kind": "done", "task": task, "from": "r1", "to": "arm" });
        Telling::Signal(serde_json::from_value(signal).unwrap())
    }

    #[test]
    fn nothing_is_told_before_it_is_written_and_nothing_is_told_twice() {
        let mut pen = Pen::default();
        assert!(pen.is_idle() && !pen.begin());
        pen.note(telling("one"));
        assert!(!pen.is_idle());
        assert!(pen.begin());
        pen.note(telling("two"));
        assert!(!pen.begin(), "one page at a time");
        assert_eq!(pen.take_written(), []);
        pen.done();
        assert_eq!(pen.take_written(), [telling("one")]);
        assert!(!pen.is_idle());
        assert!(pen.begin());
        pen.done();
        assert!(!pen.is_idle(), "it is still to be told");
        assert_eq!(pen.take_written(), [telling("two")]);
        assert!(pen.is_idle());
        assert_eq!(pen.take_written(), []);
    }

    #[test]
    fn what_was_not_told_is_there_in_order_when_the_pen_is_laid_down() {
        let mut pen = Pen::default();
        pen.note(telling("one"));
        pen.begin();
        pen.note(telling("two"));
        assert_eq!(pen.abandon(), [telling("one"), telling("two")]);
    }
}
