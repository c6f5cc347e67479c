//! Background tasks that end with the actor that owns them.

use crate::bus::{Query, Sample, SharedBus, Stream};
use ractor::{ActorRef, Message};
use std::future::Future;
use std::ops::Deref;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;
use tracing::warn;

/// Forwards each query of a stream to an actor's mailbox, until either ends. The bus limits the queries that have not
/// ended.
pub async fn forward_queries<M: Message>(mut queries: Stream<Query>, to: ActorRef<M>, wrap: impl Fn(Query) -> M) {
    while let Some(query) = queries.recv().await {
        if to.cast(wrap(query)).is_err() {
            return;
        }
    }
}

/// Maximum number of samples of a stream in the mailbox of an actor, which itself has no limit. Further samples wait in the
/// stream, where the newest on a key displaces the oldest.
const FORWARDED_MAX: usize = 64;

/// A message in the mailbox of an actor. When it is dropped, the mailbox has room for another.
pub struct Forwarded<T> {
    content: T,
    _room: OwnedSemaphorePermit,
}

impl<T> Forwarded<T> {
    /// Returns the content.
    pub fn into_inner(self) -> T {
        self.content
    }
}

impl<T> Deref for Forwarded<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.content
    }
}

/// Forwards each item of a stream of samples or changes of presence to an actor's mailbox, until either ends. Only few
/// are in the mailbox at a time.
pub async fn forward_samples<T: 'static, M: Message>(
    mut stream: Stream<T>,
    to: ActorRef<M>,
    wrap: impl Fn(Forwarded<T>) -> M,
) {
    let room = Arc::new(Semaphore::new(FORWARDED_MAX));
    while let Ok(room) = Arc::clone(&room).acquire_owned().await {
        let Some(content) = stream.recv().await else { return };
        if to.cast(wrap(Forwarded { content, _room: room })).is_err() {
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

    /// Forwards each query of a stream to an actor's mailbox, as [`forward_queries`] does. The declaration behind the
    /// stream lives as long as the task.
    pub fn forward_queries<M: Message>(
        &mut self,
        queries: Stream<Query>,
        to: &ActorRef<M>,
        wrap: impl Fn(Query) -> M + Send + 'static,
    ) {
        self.spawn(forward_queries(queries, to.clone(), wrap));
    }

    /// Forwards each sample of a stream to an actor's mailbox, as [`forward_samples`] does. The declaration behind the
    /// stream lives as long as the task.
    pub fn forward_samples<M: Message>(
        &mut self,
        samples: Stream<Sample>,
        to: &ActorRef<M>,
        wrap: impl Fn(Forwarded<Sample>) -> M + Send + 'static,
    ) {
        self.spawn(forward_samples(samples, to.clone(), wrap));
    }

    /// Subscribes to a key and forwards the samples to an actor's mailbox. Returns at once, even
    /// while the bus is blocked. A failed subscription is logged.
    pub fn subscribe<M: Message>(
        &mut self,
        bus: SharedBus,
        key: String,
        to: &ActorRef<M>,
        wrap: impl Fn(Forwarded<Sample>) -> M + Send + 'static,
    ) {
        let to = to.clone();
        self.spawn(async move {
            match bus.subscribe(&key).await {
                Ok(samples) => forward_samples(samples, to, wrap).await,
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

    /// Sends a message to an actor on every change of the watched value. Changes while the actor has not handled the
    /// last message are a single message.
    pub fn on_change<T, M>(
        &mut self,
        mut watched: watch::Receiver<T>,
        to: &ActorRef<M>,
        make: impl Fn(Forwarded<()>) -> M + Send + 'static,
    ) where
        T: Send + Sync + 'static,
        M: Message,
    {
        let to = to.clone();
        self.spawn(async move {
            let room = Arc::new(Semaphore::new(1));
            while watched.changed().await.is_ok()
                && let Ok(room) = Arc::clone(&room).acquire_owned().await
            {
                // The actor sees all changes until it handles the message.
                watched.mark_unchanged();
                if to.cast(make(Forwarded { content: (), _room: room })).is_err() {
                    return;
                }
            }
        });
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::author::Author;
    use crate::bus::Encoding;
    use crate::mailbox::mailbox;
    use bytes::Bytes;
    use ractor::{Actor, ActorProcessingErr};
    use std::any::Any;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use tokio::time::sleep;

    /// An actor that never ends the handling of its first message.
    struct Stuck;

    #[ractor::async_trait]
    impl Actor for Stuck {
        type Msg = Box<dyn Any + Send>;
        type State = ();
        type Arguments = ();

        async fn pre_start(&self, _: ActorRef<Self::Msg>, _: ()) -> Result<(), ActorProcessingErr> {
            Ok(())
        }

        async fn handle(
            &self,
            _: ActorRef<Self::Msg>,
            _message: Self::Msg,
            _: &mut (),
        ) -> Result<(), ActorProcessingErr> {
            std::future::pending().await
        }
    }

    /// Counts the messages to an actor.
    fn counting<T: Send + 'static>(count: Arc<AtomicUsize>) -> impl Fn(T) -> Box<dyn Any + Send> + Send + 'static {
        move |message| {
            count.fetch_add(1, Ordering::Relaxed);
            Box::new(message)
        }
    }

    #[tokio::test(start_paused = true)]
    async fn few_samples_are_in_the_mailbox_of_a_slow_actor() {
        let (actor, _) = Actor::spawn(None, Stuck, ()).await.unwrap();
        let (sender, receiver) = mailbox();
        for _ in 0..3 * FORWARDED_MAX {
            let (key, payload, attachment) = ("key".to_owned(), Bytes::new(), Bytes::new());
            sender.send(Sample { key, payload, encoding: Encoding::Wire, attachment, author: Author::UNKNOWN });
        }
        let (count, mut tasks) = (Arc::default(), Tasks::default());
        tasks.forward_samples(
            Stream::of_mailbox(receiver, Box::new(())),
            &actor,
            counting::<Forwarded<Sample>>(Arc::clone(&count)),
        );
        sleep(Duration::from_secs(1)).await;
        assert_eq!(count.load(Ordering::Relaxed), FORWARDED_MAX);
    }

    #[tokio::test(start_paused = true)]
    async fn changes_while_an_actor_is_busy_are_a_single_message() {
        let (actor, _) = Actor::spawn(None, Stuck, ()).await.unwrap();
        let (value, watched) = watch::channel(0);
        let (count, mut tasks) = (Arc::default(), Tasks::default());
        tasks.on_change(watched, &actor, counting::<Forwarded<()>>(Arc::clone(&count)));
        for number in 1..10 {
            value.send_replace(number);
            sleep(Duration::from_secs(1)).await;
        }
        assert_eq!(count.load(Ordering::Relaxed), 1);
    }
}
