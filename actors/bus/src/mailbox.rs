//! Mailboxes for received messages, with limits.
//!
//! A peer sends as fast as its link allows, and a receiver may be slow. Without limits the messages would fill the
//! memory of the node. When a mailbox is full, the oldest item on the same key is dropped, else the oldest of all:
//! publications are repeated or repaired, so the newest on a key is the one to keep. It also means that a peer that
//! sends too much on a key displaces its own messages first.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// Maximum number of items of a mailbox: several for each node of a large fleet, which all reply to a query at once.
const ITEMS_MAX: usize = 8192;

/// Maximum size of the items of a mailbox and of the open queries of a service, in bytes: four of the largest messages.
/// Higher: longer bursts pass; a peer can fill more memory.
pub(crate) const BYTES_MAX: usize = 16 * 1024 * 1024;

/// An item of a mailbox.
pub(crate) trait Item {
    /// Returns the key of the message.
    fn key(&self) -> &str;

    /// Returns the size of the content in bytes.
    fn bytes(&self) -> usize;
}

/// Items in the order of their arrival, with their sizes: those of their keys and of their contents.
struct Queue<T> {
    items: VecDeque<(usize, T)>,
    bytes: usize,
    /// Arrivals that were sent to the receiver and not yet taken, at least the number of items.
    announced: usize,
}

impl<T> Queue<T> {
    fn remove(&mut self, position: usize) -> Option<T> {
        let (bytes, item) = self.items.remove(position)?;
        self.bytes -= bytes;
        Some(item)
    }
}

impl<T: Item> Queue<T> {
    /// Adds an item, after it has dropped as many as exceed the limits.
    fn push(&mut self, item: T) {
        let bytes = item.key().len() + item.bytes();
        let mut same_key = Some(0); // each search continues after the last, so a large item needs a single pass
        while !self.items.is_empty() && (self.items.len() >= ITEMS_MAX || self.bytes + bytes > BYTES_MAX) {
            same_key = same_key.and_then(|from| {
                Some(from + self.items.range(from..).position(|(_, other)| other.key() == item.key())?)
            });
            self.remove(same_key.unwrap_or(0));
        }
        self.bytes += bytes;
        self.items.push_back((bytes, item));
    }
}

fn lock<T>(queue: &Mutex<Queue<T>>) -> MutexGuard<'_, Queue<T>> {
    queue.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Creates a mailbox for items. Its end is that of a channel: when all senders or the receiver are gone.
pub(crate) fn mailbox<T: Item>() -> (MailboxSender<T>, MailboxReceiver<T>) {
    let (arrivals, announced_arrivals) = unbounded_channel();
    let queue = Arc::new(Mutex::new(Queue { items: VecDeque::new(), bytes: 0, announced: 0 }));
    (MailboxSender { queue: Arc::clone(&queue), arrivals }, MailboxReceiver { queue, arrivals: announced_arrivals })
}

/// Sending end of a mailbox.
pub(crate) struct MailboxSender<T> {
    queue: Arc<Mutex<Queue<T>>>,
    arrivals: UnboundedSender<()>,
}

impl<T> Clone for MailboxSender<T> {
    fn clone(&self) -> Self {
        MailboxSender { queue: Arc::clone(&self.queue), arrivals: self.arrivals.clone() }
    }
}

impl<T: Item> MailboxSender<T> {
    /// Adds an item. Returns false if the receiver is gone.
    pub(crate) fn send(&self, item: T) -> bool {
        if self.is_closed() {
            return false;
        }
        let mut queue = lock(&self.queue);
        queue.push(item);
        // The arrival of a dropped item stands for the new one.
        if queue.announced < queue.items.len() {
            queue.announced += 1;
            return self.arrivals.send(()).is_ok();
        }
        true
    }

    /// Checks whether the receiver is gone.
    pub(crate) fn is_closed(&self) -> bool {
        self.arrivals.is_closed()
    }
}

/// Receiving end of a mailbox.
pub(crate) struct MailboxReceiver<T> {
    queue: Arc<Mutex<Queue<T>>>,
    arrivals: UnboundedReceiver<()>,
}

impl<T> MailboxReceiver<T> {
    /// Returns the next item, or `None` after the end.
    pub(crate) async fn recv(&mut self) -> Option<T> {
        loop {
            self.arrivals.recv().await?;
            if let Some(item) = self.take() {
                return Some(item);
            }
        }
    }

    /// Returns the next item if it has already arrived.
    pub(crate) fn try_recv(&mut self) -> Option<T> {
        loop {
            self.arrivals.try_recv().ok()?;
            if let Some(item) = self.take() {
                return Some(item);
            }
        }
    }

    /// Takes the item of an arrival; `None` if a larger item has displaced several.
    fn take(&self) -> Option<T> {
        let mut queue = lock(&self.queue);
        queue.announced -= 1;
        queue.remove(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::author::Author;
    use crate::bus::{Encoding, MESSAGE_MAX, Sample};
    use bytes::Bytes;

    fn sample(key: &str, payload: Vec<u8>) -> Sample {
        let (payload, attachment) = (payload.into(), Bytes::new());
        Sample { key: key.to_owned(), payload, encoding: Encoding::Wire, attachment, author: Author::UNKNOWN }
    }

    /// Returns a sample that counts `size` bytes.
    fn sized(key: &str, first: u8, size: usize) -> Sample {
        let mut payload = vec![0; size - key.len()];
        payload[0] = first;
        sample(key, payload)
    }

    /// Returns the items of a mailbox.
    fn rest(receiver: &mut MailboxReceiver<Sample>) -> Vec<Sample> {
        std::iter::from_fn(|| receiver.try_recv()).collect()
    }

    #[test]
    fn a_peer_that_sends_too_much_displaces_its_own_messages() {
        let (sender, mut receiver) = mailbox();
        assert!(sender.send(sample("ada", vec![1])));
        for number in 0..3 * ITEMS_MAX {
            assert!(sender.send(sample("bob", number.to_le_bytes().to_vec())));
        }
        let kept = rest(&mut receiver);
        assert_eq!(kept.len(), ITEMS_MAX);
        assert_eq!(kept[0], sample("ada", vec![1]));
        let first = 3 * ITEMS_MAX - (ITEMS_MAX - 1);
        assert_eq!(kept[1], sample("bob", first.to_le_bytes().to_vec()), "the oldest are dropped, in order");
    }

    #[test]
    fn the_size_of_a_mailbox_is_limited() {
        let (sender, mut receiver) = mailbox();
        for number in 0..10 {
            sender.send(sized(&number.to_string(), 0, MESSAGE_MAX));
        }
        let kept: Vec<String> = rest(&mut receiver).into_iter().map(|sample| sample.key).collect();
        assert_eq!(kept, ["6", "7", "8", "9"]);
    }

    #[test]
    fn long_keys_count_as_contents_do() {
        let (sender, mut receiver) = mailbox();
        let key = "x".repeat(MESSAGE_MAX / 4);
        (0..20).for_each(|_| assert!(sender.send(sample(&key, vec![]))));
        assert_eq!(rest(&mut receiver).len(), 16);
    }

    #[test]
    fn a_large_item_displaces_those_on_its_key_first() {
        let (sender, mut receiver) = mailbox();
        for number in 0..16 {
            let key = if number % 3 == 0 { "ada" } else { "bob" };
            sender.send(sized(key, number, MESSAGE_MAX / 4));
        }
        sender.send(sized("ada", 16, MESSAGE_MAX));
        sender.send(sized("ada", 17, MESSAGE_MAX));
        let kept: Vec<u8> = rest(&mut receiver).into_iter().map(|sample| sample.payload[0]).collect();
        assert_eq!(kept, [1, 2, 4, 5, 7, 8, 10, 11, 13, 14, 17]);
    }

    #[tokio::test]
    async fn a_mailbox_ends_after_its_last_item() {
        let (sender, mut receiver) = mailbox();
        (0..8).for_each(|_| assert!(sender.send(sized("small", 0, MESSAGE_MAX / 2))));
        // The large item displaces two small ones, and the receiver skips them.
        assert!(sender.send(sized("large", 0, MESSAGE_MAX)));
        drop(sender);
        let mut received = 0;
        while receiver.recv().await.is_some() {
            received += 1;
        }
        assert_eq!(received, 7);
    }

    #[test]
    fn a_mailbox_without_receiver_is_closed() {
        let (sender, receiver) = mailbox();
        drop(receiver);
        assert!(sender.is_closed() && !sender.send(sample("ada", vec![])));
    }
}
