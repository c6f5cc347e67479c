//! Priorities of messages on Zenoh, and sends that wait for a slow link.
//!
//! A Zenoh link has a queue for each priority, and sends the queue of the highest priority first. Replies, and the
//! message that ends a query, have the priority and the congestion control of the query. Nodes that relay keep both.
//! `express` is not used: it gives each message a batch of its own, and a queue has few batches.
//!
//! A publication is dropped if its queue stays full. Queries and replies are not: Zenoh blocks the calling thread until
//! the queue has space, for half a minute with a backup on a link of 1 Mbit/s. Meanwhile it also blocks the threads that
//! publish with the same priority. So messages that may be late are sent on threads of their own, and the threads of the
//! runtime stay free for heartbeats.

use super::error::failed;
use crate::bus::BusError;
use consort_protocol::keys::Priority;
use std::sync::Arc;
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use zenoh::Wait;
use zenoh::bytes::Encoding as ZenohEncoding;
use zenoh::qos::Priority as ZenohPriority;
use zenoh::query::Query;

/// Number of threads for the messages of each priority that may be late; further messages wait for a thread. Higher: more
/// slow links delay no other link. Lower: fewer threads. A guess: several times the links of a node.
const SENDERS_MAX: usize = 16;

/// Maximum number of refused queries that wait for a thread. Each keeps its payload of up to 4 MiB, so a further refusal
/// blocks the thread of Zenoh that received the query, which slows its sender down.
const REFUSALS_MAX: usize = 8;

/// Returns Zenoh's priority of messages on a key or key expression.
pub(super) fn priority_of(key_expr: &str) -> ZenohPriority {
    zenoh_priority(Priority::of(key_expr))
}

/// Returns Zenoh's name of a priority.
pub(super) fn zenoh_priority(priority: Priority) -> ZenohPriority {
    match priority {
        Priority::Consensus => ZenohPriority::RealTime,
        Priority::Liveness => ZenohPriority::InteractiveHigh,
        Priority::Mission => ZenohPriority::InteractiveLow,
        Priority::Knowledge => ZenohPriority::DataHigh,
        // Also the priority of clients that set none, so they do not delay records.
        Priority::Event => ZenohPriority::Data,
        Priority::View => ZenohPriority::DataLow,
        Priority::Bulk => ZenohPriority::Background,
    }
}

/// The threads for messages that may be late, by priority: downloads delay no record. Clones share them.
#[derive(Clone)]
pub(super) struct Senders {
    threads: [Arc<Semaphore>; 4],
    refusals: Arc<Semaphore>,
}

impl Default for Senders {
    fn default() -> Self {
        Senders {
            threads: std::array::from_fn(|_| Arc::new(Semaphore::new(SENDERS_MAX))),
            refusals: Arc::new(Semaphore::new(REFUSALS_MAX)),
        }
    }
}

impl Senders {
    /// Returns the free threads for messages of a priority; `None` if they must not be late.
    fn threads(&self, priority: ZenohPriority) -> Option<&Arc<Semaphore>> {
        match priority {
            ZenohPriority::RealTime | ZenohPriority::InteractiveHigh | ZenohPriority::InteractiveLow => None,
            ZenohPriority::DataHigh => Some(&self.threads[0]),
            ZenohPriority::Data => Some(&self.threads[1]),
            ZenohPriority::DataLow => Some(&self.threads[2]),
            ZenohPriority::Background => Some(&self.threads[3]),
        }
    }

    /// Sends a message of this priority, and waits until it is in the queue of its links.
    pub(super) async fn send(
        &self,
        operation: &'static str,
        priority: ZenohPriority,
        send: impl FnOnce() -> zenoh::Result<()> + Send + 'static,
    ) -> Result<(), BusError> {
        let Some(threads) = self.threads(priority) else {
            return send().map_err(|problem| failed(operation, problem));
        };
        let permit = Arc::clone(threads).acquire_owned().await.map_err(|closed| failed(operation, closed))?;
        let sending = tokio::task::spawn_blocking(move || {
            let _permit = permit;
            send()
        });
        let sent = sending.await.map_err(|panicked| failed(operation, panicked))?;
        sent.map_err(|problem| failed(operation, problem))
    }

    /// Ends a query by dropping it, which sends a message, too. The query is part of the `open` queries of its service
    /// until then.
    pub(super) fn end(&self, query: Query, open: OwnedSemaphorePermit) {
        self.finish(query, move |query| {
            drop(query);
            drop(open);
        });
    }

    /// Refuses and ends a query.
    pub(super) fn refuse(&self, query: Query, reason: &'static str) {
        let refuse = move |query: Query| {
            // The requester may be gone: ignore the error.
            let _ = query.reply_err(reason).encoding(ZenohEncoding::TEXT_PLAIN).wait();
        };
        match Arc::clone(&self.refusals).try_acquire_owned() {
            Ok(waiting) => self.finish(query, move |query| {
                refuse(query);
                drop(waiting);
            }),
            Err(_) => refuse(query),
        }
    }

    /// Runs the last step of a query, on a thread for its priority if it may be late.
    fn finish(&self, query: Query, step: impl FnOnce(Query) + Send + 'static) {
        let priority = query.priority();
        let runtime = self.threads(priority).and_then(|_| Handle::try_current().ok());
        let Some(runtime) = runtime else { return step(query) };
        let senders = self.clone();
        runtime.spawn(async move {
            let finished = senders.send("end a query", priority, move || {
                step(query);
                Ok(())
            });
            // It fails only if the runtime ends.
            let _ = finished.await;
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::mpsc;
    use std::time::Duration;
    use tokio::task::JoinSet;
    use tokio::time::timeout;

    #[tokio::test]
    async fn a_message_that_waits_for_its_link_stops_no_other_task() {
        let (free, link) = mpsc::channel();
        let senders = Senders::default();
        let sending = senders.send("send", ZenohPriority::Background, move || {
            link.recv_timeout(Duration::from_secs(10)).map_err(Into::into)
        });
        let (sent, freed) = tokio::join!(sending, async { free.send(()) });
        sent.expect("the link becomes free");
        freed.expect("the message waits for its link");
    }

    #[tokio::test]
    async fn a_message_that_finds_no_thread_waits_alone_and_may_give_up() {
        let (senders, mut links, mut sending) = (Senders::default(), vec![], JoinSet::new());
        for _ in 0..SENDERS_MAX {
            let (free, link) = mpsc::channel();
            links.push(free);
            let senders = senders.clone();
            sending.spawn(async move {
                senders.send("send", ZenohPriority::Background, move || link.recv().map_err(Into::into)).await
            });
        }
        while senders.threads[3].available_permits() > 0 {
            tokio::task::yield_now().await;
        }
        let was_sent = Arc::new(AtomicBool::new(false));
        let sent = Arc::clone(&was_sent);
        let late = senders.send("send", ZenohPriority::Background, move || {
            sent.store(true, Ordering::Relaxed);
            Ok(())
        });
        assert!(timeout(Duration::from_millis(1), late).await.is_err());
        for other in [ZenohPriority::DataLow, ZenohPriority::RealTime] {
            senders.send("send", other, || Ok(())).await.expect("a free thread");
        }
        links.iter().for_each(|link| link.send(()).expect("the message waits for its link"));
        while let Some(sent) = sending.join_next().await {
            sent.expect("no panic").expect("the link is free");
        }
        assert!(!was_sent.load(Ordering::Relaxed));
    }

    #[test]
    fn each_priority_has_a_queue_in_the_same_order() {
        let all = [
            Priority::Consensus,
            Priority::Liveness,
            Priority::Mission,
            Priority::Knowledge,
            Priority::Event,
            Priority::View,
            Priority::Bulk,
        ];
        // Zenoh counts from the highest.
        assert!(all.is_sorted() && all.map(|priority| zenoh_priority(priority) as u8).is_sorted_by(|a, b| a < b));
    }
}
