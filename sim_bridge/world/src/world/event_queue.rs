//! The event queue.

use std::cmp::Ordering;
use std::collections::BTreeMap;

/// Identifies a scheduled entry, so that it can be canceled. Ordered by time, then by the order of
/// scheduling.
#[derive(Debug, Clone, Copy)]
pub struct TimerId {
    pub(crate) time: f64,
    number: u64,
}

impl Ord for TimerId {
    fn cmp(&self, other: &Self) -> Ordering {
        self.time.total_cmp(&other.time).then(self.number.cmp(&other.number))
    }
}

impl PartialOrd for TimerId {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for TimerId {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for TimerId {}

/// Entries by time. Entries of the same instant keep the order of scheduling.
pub(crate) struct EventQueue<T> {
    entries: BTreeMap<TimerId, T>,
    next: u64,
}

impl<T> EventQueue<T> {
    pub(crate) fn new() -> Self {
        Self { entries: BTreeMap::new(), next: 0 }
    }

    pub(crate) fn schedule(&mut self, time: f64, entry: T) -> TimerId {
        let timer = TimerId { time, number: self.next };
        self.next += 1;
        self.entries.insert(timer, entry);
        timer
    }

    pub(crate) fn cancel(&mut self, timer: TimerId) {
        self.entries.remove(&timer);
    }

    pub(crate) fn next_time(&self) -> Option<f64> {
        self.entries.first_key_value().map(|(timer, _)| timer.time)
    }

    /// Removes and returns the first entry due up to and including `to`, with its time.
    pub(crate) fn pop_due(&mut self, to: f64) -> Option<(f64, T)> {
        let first = self.entries.first_entry().filter(|first| first.key().time <= to)?;
        let (timer, entry) = first.remove_entry();
        Some((timer.time, entry))
    }

    pub(crate) fn len(&self) -> usize {
        self.entries.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_of_an_instant_keep_the_order_of_scheduling() {
        let mut queue = EventQueue::new();
        queue.schedule(2.0, "third");
        queue.schedule(1.0, "first");
        let canceled = queue.schedule(1.0, "never");
        queue.schedule(1.0, "second");
        queue.cancel(canceled);
        let due: Vec<_> = std::iter::from_fn(|| queue.pop_due(2.0)).collect();
        assert_eq!(due, [(1.0, "first"), (1.0, "second"), (2.0, "third")]);
    }

    #[test]
    fn later_entries_stay_in_the_queue() {
        let mut queue = EventQueue::new();
        queue.schedule(2.0, ());
        assert_eq!(queue.pop_due(1.999), None);
        assert_eq!((queue.next_time(), queue.len()), (Some(2.0), 1));
    }
}
