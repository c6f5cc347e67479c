//! What is due, and when.

use std::cmp::Ordering;
use std::collections::BTreeMap;

/// Names an entry, so that it can be taken back. Ordered by time, then by when it was arranged.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ticket {
    pub(crate) time: f64,
    number: u64,
}

impl Ord for Ticket {
    fn cmp(&self, other: &Self) -> Ordering {
        self.time.total_cmp(&other.time).then(self.number.cmp(&other.number))
    }
}

impl PartialOrd for Ticket {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Ticket {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Ticket {}

/// Entries by time; those of one instant in the order in which they were arranged.
pub(crate) struct Queue<T> {
    entries: BTreeMap<Ticket, T>,
    next: u64,
}

impl<T> Queue<T> {
    pub(crate) fn new() -> Self {
        Self { entries: BTreeMap::new(), next: 0 }
    }

    pub(crate) fn arrange(&mut self, time: f64, entry: T) -> Ticket {
        let ticket = Ticket { time, number: self.next };
        self.next += 1;
        self.entries.insert(ticket, entry);
        ticket
    }

    pub(crate) fn take_back(&mut self, ticket: Ticket) {
        self.entries.remove(&ticket);
    }

    pub(crate) fn first_time(&self) -> Option<f64> {
        self.entries.first_key_value().map(|(ticket, _)| ticket.time)
    }

    /// The first entry due up to and including `to`, with its time.
    pub(crate) fn pop_until(&mut self, to: f64) -> Option<(f64, T)> {
        let first = self.entries.first_entry().filter(|first| first.key().time <= to)?;
        let (ticket, entry) = first.remove_entry();
        Some((ticket.time, entry))
    }

    pub(crate) fn len(&self) -> usize {
        self.entries.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_of_one_instant_come_in_the_order_they_were_arranged() {
        let mut queue = Queue::new();
        queue.arrange(2.0, "third");
        queue.arrange(1.0, "first");
        let gone = queue.arrange(1.0, "never");
        queue.arrange(1.0, "second");
        queue.take_back(gone);
        let due: Vec<_> = std::iter::from_fn(|| queue.pop_until(2.0)).collect();
        assert_eq!(due, [(1.0, "first"), (1.0, "second"), (2.0, "third")]);
    }

    #[test]
    fn what_is_due_later_stays() {
        let mut queue = Queue::new();
        queue.arrange(2.0, ());
        assert_eq!(queue.pop_until(1.999), None);
        assert_eq!((queue.first_time(), queue.len()), (Some(2.0), 1));
    }
}
