//! Background tasks that live and die with the actor that keeps them.

use crate::bus::Stream;
use ractor::{ActorRef, Message};
use std::future::Future;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Tasks that are aborted when this is dropped: an actor keeps them in its state.
#[derive(Debug, Default)]
pub(crate) struct Tasks(JoinSet<()>);

impl Tasks {
    /// Runs a task until it ends or this is dropped.
    pub(crate) fn spawn(&mut self, task: impl Future<Output = ()> + Send + 'static) {
        while self.0.try_join_next().is_some() {}
        self.0.spawn(task);
    }

    /// Hands what a stream brings to an actor's mailbox. The declaration behind the stream lives as long as this.
    pub(crate) fn forward<T, M>(
        &mut self,
        mut stream: Stream<T>,
        to: &ActorRef<M>,
        wrap: impl Fn(T) -> M + Send + 'static,
    ) where
        T: Send + 'static,
        M: Message,
    {
        let to = to.clone();
        self.spawn(async move {
            while let Some(item) = stream.recv().await {
                if to.cast(wrap(item)).is_err() {
                    return;
                }
            }
        });
    }

    /// Sends an actor a message again and again, the first after one period.
    pub(crate) fn send_every<M: Message>(
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

    /// Sends an actor a message whenever what is watched has changed.
    pub(crate) fn on_change<T, M>(
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

    /// Sends an actor one message later.
    pub(crate) fn send_after<M: Message>(&mut self, delay: Duration, to: &ActorRef<M>, message: M) {
        let to = to.clone();
        self.spawn(async move {
            tokio::time::sleep(delay).await;
            // An actor that has stopped needs no more messages.
            let _ = to.cast(message);
        });
    }
}
