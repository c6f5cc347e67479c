//! The real bus, on a single Zenoh session.
//!
//! Zenoh runs callbacks inside its own receive and send paths. Therefore every callback here only
//! pushes into an unbounded mailbox. A query goes to all matching services and its replies are not
//! consolidated, unless the nearest service is selected. Every query has its own timeout.

mod current_session;
mod link_check;
mod session;
mod settings;

pub use settings::{LinkTrust, Mode, ZenohSettings};

use crate::bus::{
    Bus, BusError, Delivery, Encoding, Link, Presence, PresenceToken, Query, Replier, Reply, Sample, ServiceSelection,
    Stream,
};
use crate::keys;
use async_trait::async_trait;
use bytes::Bytes;
use session::{Declaration, SessionManager};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep};
use zenoh::bytes::{Encoding as ZenohEncoding, ZBytes};
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyError};
use zenoh::session::ZenohId;
use zenoh::time::{NTP64, Timestamp, TimestampId};
use zenoh_keyexpr::OwnedKeyExpr;

/// Poll interval while waiting for a condition.
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// A node's session on a Zenoh network. It needs a multi-threaded tokio runtime. Clones share the
/// session, which closes with the last clone.
#[derive(Clone)]
pub struct ZenohBus {
    manager: Arc<SessionManager>,
}

impl ZenohBus {
    /// Opens a session. A router or peer opens even if no neighbour can be reached, and keeps
    /// trying: see [`wait_connected`](Self::wait_connected).
    ///
    /// # Errors
    /// [`BusError::Failed`] if the runtime is not multi-threaded, a setting is invalid, an address
    /// cannot be listened on (the error names it, and whether the port is taken), or a client
    /// reaches no router.
    pub async fn open(settings: ZenohSettings) -> Result<ZenohBus, BusError> {
        let multi_threaded =
            Handle::try_current().is_ok_and(|runtime| runtime.runtime_flavor() != RuntimeFlavor::CurrentThread);
        if !multi_threaded {
            return Err(failed("open", "Zenoh needs a multi-threaded tokio runtime"));
        }
        Ok(ZenohBus { manager: SessionManager::open(settings).await? })
    }

    /// Returns this node's id on the bus, as neighbours see it in [`Bus::links`]. It changes when
    /// the session is reopened.
    pub fn id(&self) -> String {
        self.manager.session().zid().to_string()
    }

    /// Returns the addresses that this node listens on, with the assigned ports.
    pub async fn listen_addresses(&self) -> Vec<String> {
        session::listen_addresses(&self.manager.session()).await
    }

    /// Waits for the first neighbour, at most for `timeout`. Returns all neighbours. An empty list
    /// is no error: this node keeps trying, and works alone meanwhile.
    pub async fn wait_connected(&self, timeout: Duration) -> Vec<Link> {
        let end = Instant::now() + timeout;
        loop {
            let links = self.links().await;
            if !links.is_empty() || Instant::now() >= end {
                return links;
            }
            sleep(POLL_INTERVAL.min(timeout)).await;
        }
    }

    /// Closes the session for all its clones. Every stream ends, and the neighbours notice at once.
    ///
    /// # Errors
    /// [`BusError::Failed`] if Zenoh reports an error. The session is unusable in either case.
    pub async fn close(&self) -> Result<(), BusError> {
        self.manager.close().await
    }
}

fn failed(what: impl Into<String>, problem: impl ToString) -> BusError {
    BusError::Failed { operation: what.into(), problem: problem.to_string() }
}

/// Converts an error of opening a session. Zenoh's errors name source lines; operators need the
/// address instead.
fn open_error(settings: &ZenohSettings, problem: &str) -> BusError {
    let problem = problem.split(" at /").next().unwrap_or_default().trim_end();
    let of = |addresses: &[String]| addresses.iter().find(|address| problem.contains(address.as_str())).cloned();
    if settings.mode == Mode::Client {
        return failed(format!("reach a router at {}", settings.connect.join(", ")), problem);
    }
    match of(&settings.listen) {
        Some(address) if problem.contains("in use") => {
            failed(format!("listen on {address}"), format!("the port is taken ({problem})"))
        }
        Some(address) => failed(format!("listen on {address}"), problem),
        None => failed("open", problem),
    }
}

fn to_zenoh(encoding: Encoding) -> ZenohEncoding {
    match encoding {
        Encoding::Wire => ZenohEncoding::APPLICATION_OCTET_STREAM,
        Encoding::Json => ZenohEncoding::APPLICATION_JSON,
    }
}

/// Payloads without a JSON encoding count as wire messages.
fn from_zenoh(encoding: &ZenohEncoding) -> Encoding {
    if *encoding == ZenohEncoding::APPLICATION_OCTET_STREAM {
        return Encoding::Wire;
    }
    let text = encoding.to_string(); // may be followed by parameters: `application/json;charset=utf-8`
    let json = ["application/json", "text/json"].contains(&text.split(';').next().unwrap_or_default());
    if json { Encoding::Json } else { Encoding::Wire }
}

fn to_bytes(payload: &ZBytes) -> Bytes {
    match payload.to_bytes() {
        std::borrow::Cow::Borrowed(bytes) => Bytes::copy_from_slice(bytes),
        std::borrow::Cow::Owned(bytes) => Bytes::from(bytes),
    }
}

/// Copies the attachment; empty if absent.
fn attachment_bytes(attachment: Option<&ZBytes>) -> Bytes {
    attachment.map(to_bytes).unwrap_or_default()
}

/// Returns the attachment to send; `None` if it is empty.
fn to_attachment(attachment: Bytes) -> Option<Bytes> {
    (!attachment.is_empty()).then_some(attachment)
}

/// Checks whether an error is Zenoh's report of a query timeout. Zenoh ends such a query with an
/// error that no service sent. The encoding distinguishes the two: errors of our services are plain
/// text.
fn is_timeout(error: &ReplyError) -> bool {
    let unmarked = [ZenohEncoding::ZENOH_STRING, ZenohEncoding::ZENOH_BYTES].contains(error.encoding());
    unmarked && error.payload().to_bytes() == b"Timeout".as_slice()
}

fn reply(from: zenoh::query::Reply, query_key: &OwnedKeyExpr) -> Option<Reply> {
    match from.into_result() {
        Ok(sample) => Some(Reply {
            key: sample.key_expr().to_string(),
            payload: Ok(to_bytes(sample.payload())),
            attachment: attachment_bytes(sample.attachment()),
        }),
        Err(error) if is_timeout(&error) => None,
        Err(error) => {
            let reason = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
            Some(Reply { key: query_key.to_string(), payload: Err(reason), attachment: Bytes::new() })
        }
    }
}

impl ZenohBus {
    async fn declare_queryable(&self, key_expr: &str, complete: bool) -> Result<Stream<Query>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let declared = self.manager.declare(Declaration::Queryable { key: key_expr, mailbox, complete }).await?;
        Ok(Stream::new(receiver, Box::new(declared)))
    }
}

#[async_trait]
impl Bus for ZenohBus {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError> {
        let key = keys::single_key(key)?;
        keys::check_payload_size("publish", &payload, self.manager.settings().message_max)?;
        let control = match delivery {
            Delivery::Drop => CongestionControl::Drop,
            Delivery::Block => CongestionControl::Block,
        };
        let session = self.manager.session();
        let put = session.put(key, payload).encoding(to_zenoh(encoding)).congestion_control(control);
        put.attachment(to_attachment(attachment)).await.map_err(|problem| failed("publish", problem))
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let declared = self.manager.declare(Declaration::Subscriber(key_expr, mailbox)).await?;
        Ok(Stream::new(receiver, Box::new(declared)))
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        attachment: Bytes,
        timeout: Duration,
        target: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        let (query_key, parameters) = keys::selector(key_expr)?;
        keys::check_payload_size("query", &payload, self.manager.settings().message_max)?;
        let (target, consolidation) = match target {
            ServiceSelection::All => (QueryTarget::All, ConsolidationMode::None),
            ServiceSelection::Nearest => (QueryTarget::BestMatching, ConsolidationMode::Latest),
        };
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let key = query_key.clone();
        let on_reply = move |answer: zenoh::query::Reply| {
            if let Some(reply) = reply(answer, &key) {
                let _ = mailbox.send(reply);
            }
        };
        let session = self.manager.session();
        let mut get = session.get((query_key, parameters)).target(target).consolidation(consolidation).timeout(timeout);
        if !payload.is_empty() {
            get = get.payload(payload).encoding(to_zenoh(Encoding::Wire));
        }
        get.attachment(to_attachment(attachment))
            .callback(on_reply)
            .await
            .map_err(|problem| failed("query", problem))?;
        Ok(Stream::new(receiver, Box::new(())))
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.declare_queryable(key_expr, false).await
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.declare_queryable(key_expr, true).await
    }

    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError> {
        let declared = self.manager.declare(Declaration::Token(keys::single_key(key)?)).await?;
        Ok(PresenceToken::new(Box::new(declared)))
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let declared = self.manager.declare(Declaration::PresenceSubscriber(key_expr, mailbox, Arc::default())).await?;
        Ok(Stream::new(receiver, Box::new(declared)))
    }

    async fn links(&self) -> Vec<Link> {
        let transports = self.manager.session().info().transports().await;
        let links = transports.map(|link| Link { peer: link.zid().to_string(), kind: link.whatami().to_string() });
        links.collect::<BTreeSet<Link>>().into_iter().collect()
    }
}

/// Creates the callback that puts queries into a mailbox. `own` is the id of the session.
fn query_callback(
    mailbox: mpsc::UnboundedSender<Query>,
    own: ZenohId,
    message_max: usize,
) -> impl Fn(zenoh::query::Query) + Send + Sync {
    move |query| {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let at = Timestamp::new(NTP64::from(since_1970), TimestampId::from(own));
        // The receiver is gone: the declaration is about to end.
        let _ = mailbox.send(Query {
            key: query.key_expr().to_string(),
            parameters: query.parameters().to_string(),
            payload: query.payload().map(to_bytes).unwrap_or_default(),
            attachment: attachment_bytes(query.attachment()),
            replier: Box::new(ZenohReplier {
                query_key: OwnedKeyExpr::from(query.key_expr().clone()),
                query,
                at,
                message_max,
            }),
        });
    }
}

/// Replies to a query of Zenoh. The query ends when this is dropped.
struct ZenohReplier {
    query: zenoh::query::Query,
    query_key: OwnedKeyExpr,
    /// Timestamp of the query, in Zenoh's sense, which is unique per node. All replies to the query
    /// have this timestamp. Zenoh returns the latest reply per key, so of two nodes that reply on
    /// the same keys all returned replies come from the same node.
    at: Timestamp,
    message_max: usize,
}

#[async_trait]
impl Replier for ZenohReplier {
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError> {
        let key = keys::reply_key(key, &self.query_key)?;
        keys::check_payload_size("reply to a query", &payload, self.message_max)?;
        let reply = self.query.reply(key, payload).encoding(to_zenoh(encoding)).timestamp(self.at);
        reply.attachment(to_attachment(attachment)).await.map_err(|problem| failed("reply to a query", problem))
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        let refusal = self.query.reply_err(reason).encoding(ZenohEncoding::TEXT_PLAIN);
        refusal.await.map_err(|problem| failed("reply to a query", problem))
    }
}
