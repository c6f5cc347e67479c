//! Refusals without a signature, which the signing bus drops: a bus below it passes them to the bus above.

use consort_bus::{BusError, Layer, MessageContent, Reply, SharedBus, Stream};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// Passage for the refusals of the next query. The signing bus between its ends does not wait before it
/// passes on a query.
#[derive(Clone, Default)]
pub(super) struct RefusalPassage(Arc<Mutex<Option<UnboundedSender<Reply>>>>);

impl RefusalPassage {
    /// Opens the passage for the query that follows.
    pub(super) fn open(&self) -> UnboundedReceiver<Reply> {
        let (sender, receiver) = unbounded_channel();
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(sender);
        receiver
    }

    fn take(&self) -> Option<UnboundedSender<Reply>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// Returns the replies to a query together with its refusals, in the order of arrival.
pub(super) fn merged(mut replies: Stream<Reply>, mut refusals: UnboundedReceiver<Reply>) -> Stream<Reply> {
    let (sender, receiver) = unbounded_channel();
    tokio::spawn(async move {
        loop {
            let next = tokio::select! {
                biased;
                Some(refusal) = refusals.recv() => Some(refusal),
                reply = replies.recv() => reply,
            };
            let Some(reply) = next else { return };
            if sender.send(reply).is_err() {
                return;
            }
        }
    });
    Stream::new(receiver, Box::new(()))
}

/// Bus below the signatures of a node.
pub(super) struct RefusalTap {
    pub(super) passage: RefusalPassage,
    pub(super) inner: SharedBus,
}

impl Layer for RefusalTap {
    /// The passage, if it was opened for the query.
    type QueryState = Option<UnboundedSender<Reply>>;

    fn inner(&self) -> &SharedBus {
        &self.inner
    }

    fn outgoing_query(&self, _: &str, content: MessageContent) -> Result<(MessageContent, Self::QueryState), BusError> {
        Ok((content, self.passage.take()))
    }

    fn incoming_replies(&self, passage: Self::QueryState, replies: Stream<Reply>) -> Stream<Reply> {
        replies.map(move |reply| {
            if let (Some(passage), Err(_)) = (&passage, &reply.payload) {
                // The requester may have enough replies.
                let _ = passage.send(reply.clone());
            }
            reply
        })
    }
}
