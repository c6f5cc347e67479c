//! Background tasks that end with the actor that owns them.

use crate::bus::{Sample, SharedBus, Stream};
use ractor::{ActorRef, Message};
use std::future::Future;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tracing::warn;

/// Forwards each item of a stream to an actor's mailbox, until either ends.
async fn forward_all<T: 'static, M: Message>(mut stream: Stream<T>, to: ActorRef<M>, wrap: impl Fn(T) -> M) {
    while let Some(item) = stream.recv().await {
        if to.cast(wrap(item)).is_err() {
            return;
        }
    }
}

/// A set of tasks, aborted when the set is dropped. An actor keeps it in its state.
#[derive(Debug, Default)]
pub struct Tasks(JoinSet<()>);

impl Tasks {
    /// Runs a task until it ends or the set is dropped.
    pub fn spawn(&mut self, task: impl Future<Output = ()> + Send + 'static) {
        while self.0.try_join_next().is_some() {}
        self.0.spawn(task);
    }

    /// Forwards each item of a stream to an actor's mailbox. The declaration behind the stream
    /// lives as long as the task.
    pub fn forward<T, M>(&mut self, stream: Stream<T>, to: &ActorRef<M>, wrap: impl Fn(T) -> M + Send + 'static)
    where
        T: Send + 'static,
        M: Message,
    {
        self.spawn(forward_all(stream, to.clone(), wrap));
    }

    /// Subscribes to a key and forwards the samples to an actor's mailbox. Returns at once, even
    /// while the bus is blocked. A failed subscription is logged.
    pub fn subscribe<M: Message>(
        &mut self,
        bus: SharedBus,
        key: String,
        to: &ActorRef<M>,
        wrap: impl Fn(Sample) -> M + Send + 'static,
    ) {
        let to = to.clone();
        self.spawn(async move {
            match bus.subscribe(&key).await {
                Ok(samples) => forward_all(samples, to, wrap).await,
                Err(problem) => warn!(key, %problem, "no subscription"),
            }
        });
    }

    /// Sends a message to an actor once per period, first after one period.
    pub fn send_every<M: Message>(
        &mut self,
        period: Duration,
        to: &ActorRef<M>,
        make: impl Fn() -> M + Send + 'static,
    ) {
        let to = to.clone();
        self.spawn(async move {
            loop {
                tokio::time::sleep(period).await;
                if to.cast(make()).is_err() {
                    return;
                }
            }
        });
    }

    /// Sends a message to an actor on every change of the watched value.
    pub fn on_change<T, M>(
        &mut self,
        mut watched: watch::Receiver<T>,
        to: &ActorRef<M>,
        make: impl Fn() -> M + Send + 'static,
    ) where
        T: Send + Sync + 'static,
        M: Message,
    {
        let to = to.clone();
        self.spawn(async move { while watched.changed().await.is_ok() && to.cast(make()).is_ok() {} });
    }

    /// Sends a single message to an actor after a delay.
    pub fn send_after<M: Message>(&mut self, delay: Duration, to: &ActorRef<M>, message: M) {
        let to = to.clone();
        self.spawn(async move {
            tokio::time::sleep(delay).await;
            // A stopped actor needs no messages: ignore the error.
            let _ = to.cast(message);
        });
    }
}
