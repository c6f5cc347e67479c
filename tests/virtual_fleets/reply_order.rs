//! Order of the reply to a submission, and of the call for bids for its mission.

use async_trait::async_trait;
use bytes::Bytes;
use consort_bus::{BusError, Encoding, Layer, MessageContent, Query, Replier, SharedBus, Stream};
use consort_fleet::node::NodeSettings;
use consort_protocol::keys::{Key, Keys};
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::Value;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::sleep;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// Time that a node needs to send a reply to a request. An auction waits longer.
const REPLY_TIME: Duration = Duration::from_millis(3);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sent {
    Acknowledgement,
    Call,
}

/// What the nodes have sent, in order.
#[derive(Clone, Default)]
struct SentLog(Arc<Mutex<Vec<Sent>>>);

impl SentLog {
    fn push(&self, sent: Sent) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(sent);
    }

    /// Returns the entries, and removes them.
    fn take(&self) -> Vec<Sent> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn contains(&self, sent: Sent) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).contains(&sent)
    }
}

/// Bus of a node that needs a while to send a reply to a request.
struct SlowReplies {
    inner: SharedBus,
    keys: Keys,
    sent: SentLog,
}

impl Layer for SlowReplies {
    type QueryState = ();

    fn inner(&self) -> &SharedBus {
        &self.inner
    }

    fn outgoing_query(&self, key_expr: &str, content: MessageContent) -> Result<(MessageContent, ()), BusError> {
        if key_expr == self.keys.any_bid() || matches!(self.keys.read(key_expr), Some(Key::Bid(_))) {
            self.sent.push(Sent::Call);
        }
        Ok((content, ()))
    }

    fn incoming_queries(&self, key_expr: &str, queries: Stream<Query>) -> Stream<Query> {
        if key_expr != self.keys.any_api() {
            return queries;
        }
        let sent = self.sent.clone();
        queries.map(move |query| {
            let replier = Box::new(SlowReplier { inner: query.replier, sent: sent.clone() });
            Query { replier, ..query }
        })
    }
}

struct SlowReplier {
    inner: Box<dyn Replier>,
    sent: SentLog,
}

#[async_trait]
impl Replier for SlowReplier {
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError> {
        sleep(REPLY_TIME).await;
        if serde_json::from_slice::<Value>(&payload).is_ok_and(|reply| reply["mission"].is_string()) {
            self.sent.push(Sent::Acknowledgement);
        }
        self.inner.reply_with_attachment(key, payload, attachment, encoding).await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.inner.refuse(reason).await
    }
}

/// The call wakes all robots. On a machine that runs several of them the reply would wait for their bids.
#[test]
fn a_submission_is_acknowledged_before_its_auction_begins() {
    for_each_seed([94, 95], async |seed| {
        let sent = SentLog::default();
        let (keys, of_nodes) = (Keys::new(&slug("ward")), sent.clone());
        let robots = vec![RobotSpec::carrier("fern", "Dock"), RobotSpec::carrier("gorse", "IC Room 4")];
        let wrap = Box::new(move |_: &NodeSettings, inner: SharedBus| -> SharedBus {
            Arc::new(SlowReplies { inner, keys: keys.clone(), sent: of_nodes.clone() })
        });
        let mut fleet = Fleet::hospital_with_layer(seed, robots, &["aster"], &[ROOM], wrap).await;
        fleet.wait_for_coordinator().await;
        sent.take();
        fleet.submit("a", ROOM).await;
        fleet.wait_until("a call for bids", SOON, |_| sent.contains(Sent::Call)).await;
        assert_eq!(sent.take()[..2], [Sent::Acknowledgement, Sent::Call], "seed {seed}");
    });
}
