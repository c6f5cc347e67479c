//! Replies to submitted missions that are not sent yet.
//!
//! The commit of a mission starts its auction, and the reply to its requester. The call for bids
//! wakes the processes of all robots, so on a machine that runs several of them the reply would wait
//! for their bids. The call therefore follows the reply, which is ready at once.

use consort_protocol::ids::RequestId;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::timeout;

/// Maximum time for which an auction waits for a reply. A reply is passed to the bus within a
/// millisecond, unless its link is congested, and that must delay no auction. A guess.
const REPLY_LIMIT: Duration = Duration::from_millis(10);

/// Replies to requests that are not sent yet, shared between their handlers and the auctions.
#[derive(Debug, Clone, Default)]
pub(super) struct OpenReplies(Arc<Mutex<BTreeMap<RequestId, watch::Receiver<()>>>>);

/// A reply that counts as sent when it is dropped.
#[derive(Debug)]
pub(super) struct OpenReply {
    all: OpenReplies,
    request: RequestId,
    _sender: watch::Sender<()>,
}

impl OpenReplies {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<RequestId, watch::Receiver<()>>> {
        // Each change of the map is a single step, so a poisoned lock still guards a valid map.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Records a reply as not sent yet; `None` for a repetition of a request whose reply is open.
    pub(super) fn begin(&self, request: &RequestId) -> Option<OpenReply> {
        let mut open = self.lock();
        if open.contains_key(request) {
            return None;
        }
        let (sender, sent) = watch::channel(());
        open.insert(request.clone(), sent);
        Some(OpenReply { all: self.clone(), request: request.clone(), _sender: sender })
    }

    /// Waits until no reply to a request is open, at most [`REPLY_LIMIT`].
    pub(super) async fn wait_sent(&self, request: &RequestId) {
        let open = self.lock().get(request).cloned();
        if let Some(mut sent) = open {
            // It changes only by the end of its sender.
            let _ = timeout(REPLY_LIMIT, sent.changed()).await;
        }
    }
}

impl Drop for OpenReply {
    fn drop(&mut self) {
        self.all.lock().remove(&self.request);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::Instant;

    #[tokio::test(start_paused = true)]
    async fn an_auction_follows_the_reply_but_waits_for_a_limited_time() {
        let (replies, request) = (OpenReplies::default(), "my-7".parse::<RequestId>().unwrap());
        let started = Instant::now();
        replies.wait_sent(&request).await;
        assert_eq!(started.elapsed(), Duration::ZERO, "no reply is open");

        let open = replies.begin(&request).unwrap();
        assert!(replies.begin(&request).is_none(), "a repetition");
        let reply = async {
            tokio::time::sleep(Duration::from_millis(3)).await;
            drop(open);
        };
        tokio::join!(replies.wait_sent(&request), reply);
        assert!(started.elapsed() < REPLY_LIMIT);

        let _stuck = replies.begin(&request).unwrap();
        replies.wait_sent(&request).await;
        assert!((REPLY_LIMIT..REPLY_LIMIT * 2).contains(&started.elapsed()));
    }
}
