//! The real bus: one Zenoh session.
//!
//! Zenoh calls back inside its own receiving and sending, so every callback here only pushes into a mailbox without
//! limit. A query goes to all matching services, and its replies are not consolidated, unless the nearest is asked; every
//! query has its own limit.

mod current_session;
mod link_check;
mod session;
mod settings;

pub use settings::{LinkTrust, Mode, ZenohSettings};

use super::{
    Bus, BusError, Delivery, Encoding, Link, Presence, PresenceToken, Query, Replier, Reply, Sample, ServiceSelection,
    Stream, keys,
};
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

/// How often a condition is looked at while it is awaited.
const LOOK_AGAIN: Duration = Duration::from_millis(10);

/// One node's session on a Zenoh network. It needs a multi-threaded tokio runtime. Clones are the same session, which
/// closes with the last of them.
#[derive(Clone)]
pub struct ZenohBus {
    life: Arc<SessionManager>,
}

impl ZenohBus {
    /// Opens a session. A router or peer opens even when none of its neighbours can be reached, and goes on trying: see
    /// [`wait_connected`](Self::wait_connected).
    ///
    /// # Errors
    /// [`BusError::Failed`] if the runtime is not multi-threaded, a setting is wrong, an address cannot be listened on
    /// (it says which, and whether the port is taken), or a client reaches no router.
    pub async fn open(settings: ZenohSettings) -> Result<ZenohBus, BusError> {
        let multi_threaded =
            Handle::try_current().is_ok_and(|runtime| runtime.runtime_flavor() != RuntimeFlavor::CurrentThread);
        if !multi_threaded {
            return Err(failed("open", "Zenoh needs a multi-threaded tokio runtime"));
        }
        Ok(ZenohBus { life: SessionManager::open(settings).await? })
    }

    /// This node's id on the bus, as its neighbours see it in [`Bus::links`]. It changes when a session is opened anew.
    pub fn id(&self) -> String {
        self.life.session().zid().to_string()
    }

    /// Where this node listens, with the ports it was given.
    pub async fn listen_addresses(&self) -> Vec<String> {
        session::listen_addresses(&self.life.session()).await
    }

    /// Waits until there is a neighbour, at most for `limit`; returns all there are. None is no error: this node goes on
    /// trying, and works alone meanwhile.
    pub async fn wait_connected(&self, limit: Duration) -> Vec<Link> {
        let end = Instant::now() + limit;
        loop {
            let links = self.links().await;
            if !links.is_empty() || Instant::now() >= end {
                return links;
            }
            sleep(LOOK_AGAIN.min(limit)).await;
        }
    }

    /// Closes the session for all its clones: every stream ends, and the neighbours know at once.
    ///
    /// # Errors
    /// [`BusError::Failed`] if Zenoh says so; the session is of no further use in either case.
    pub async fn close(&self) -> Result<(), BusError> {
        self.life.close().await
    }
}

fn failed(what: impl Into<String>, problem: impl ToString) -> BusError {
    BusError::Failed { operation: what.into(), problem: problem.to_string() }
}

/// Zenoh's errors name its source lines; people want to know which address is the matter.
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

/// What is not marked as JSON is for those who know what to expect.
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

/// What is said beside a payload.
fn attachment_bytes(attachment: Option<&ZBytes>) -> Bytes {
    attachment.map(to_bytes).unwrap_or_default()
}

/// What is sent beside a payload; nothing, if there is nothing to be said.
fn attach(beside: Bytes) -> Option<Bytes> {
    (!beside.is_empty()).then_some(beside)
}

/// A query that reaches its limit ends for Zenoh with an error which no service gave. The two are told apart by the
/// encoding: ours are plain text.
fn is_the_limit(error: &ReplyError) -> bool {
    let unmarked = [ZenohEncoding::ZENOH_STRING, ZenohEncoding::ZENOH_BYTES].contains(error.encoding());
    unmarked && error.payload().to_bytes() == b"Timeout".as_slice()
}

fn reply(from: zenoh::query::Reply, asked: &OwnedKeyExpr) -> Option<Reply> {
    match from.into_result() {
        Ok(sample) => Some(Reply {
            key: sample.key_expr().to_string(),
            payload: Ok(to_bytes(sample.payload())),
            attachment: attachment_bytes(sample.attachment()),
        }),
        Err(error) if is_the_limit(&error) => None,
        Err(error) => {
            let reason = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
            Some(Reply { key: asked.to_string(), payload: Err(reason), attachment: Bytes::new() })
        }
    }
}

impl ZenohBus {
    async fn answer(&self, key_expr: &str, complete: bool) -> Result<Stream<Query>, BusError> {
        let wanted = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let declared = self.life.declare(Declaration::Queryable { key: wanted, mailbox, complete }).await?;
        Ok(Stream::new(receiver, Box::new(declared)))
    }
}

#[async_trait]
impl Bus for ZenohBus {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        beside: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError> {
        let key = keys::single_key(key)?;
        keys::check_payload_size("publish", &payload, self.life.settings().message_max)?;
        let control = match delivery {
            Delivery::Drop => CongestionControl::Drop,
            Delivery::Block => CongestionControl::Block,
        };
        let session = self.life.session();
        let put = session.put(key, payload).encoding(to_zenoh(encoding)).congestion_control(control);
        put.attachment(attach(beside)).await.map_err(|problem| failed("publish", problem))
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        let wanted = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let declared = self.life.declare(Declaration::Subscriber(wanted, mailbox)).await?;
        Ok(Stream::new(receiver, Box::new(declared)))
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        beside: Bytes,
        limit: Duration,
        whom: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        let (asked, parameters) = keys::selector(key_expr)?;
        keys::check_payload_size("query", &payload, self.life.settings().message_max)?;
        let (target, consolidation) = match whom {
            ServiceSelection::All => (QueryTarget::All, ConsolidationMode::None),
            ServiceSelection::Nearest => (QueryTarget::BestMatching, ConsolidationMode::Latest),
        };
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let key = asked.clone();
        let hear = move |answer: zenoh::query::Reply| {
            if let Some(reply) = reply(answer, &key) {
                let _ = mailbox.send(reply);
            }
        };
        let session = self.life.session();
        let mut get = session.get((asked, parameters)).target(target).consolidation(consolidation).timeout(limit);
        if !payload.is_empty() {
            get = get.payload(payload).encoding(to_zenoh(Encoding::Wire));
        }
        get.attachment(attach(beside)).callback(hear).await.map_err(|problem| failed("query", problem))?;
        Ok(Stream::new(receiver, Box::new(())))
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.answer(key_expr, false).await
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.answer(key_expr, true).await
    }

    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError> {
        let declared = self.life.declare(Declaration::Token(keys::single_key(key)?)).await?;
        Ok(PresenceToken::new(Box::new(declared)))
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        let wanted = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let declared = self.life.declare(Declaration::PresenceSubscriber(wanted, mailbox, Arc::default())).await?;
        Ok(Stream::new(receiver, Box::new(declared)))
    }

    async fn links(&self) -> Vec<Link> {
        let transports = self.life.session().info().transports().await;
        let links = transports.map(|link| Link { peer: link.zid().to_string(), kind: link.whatami().to_string() });
        links.collect::<BTreeSet<Link>>().into_iter().collect()
    }
}

/// What Zenoh calls with questions: they go into a mailbox. `own` is the id of the session.
fn query_callback(
    mailbox: mpsc::UnboundedSender<Query>,
    own: ZenohId,
    message_max: usize,
) -> impl Fn(zenoh::query::Query) + Send + Sync {
    move |query| {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let at = Timestamp::new(NTP64::from(since_1970), TimestampId::from(own));
        // Nobody answers any more: the declaration is about to end.
        let _ = mailbox.send(Query {
            key: query.key_expr().to_string(),
            parameters: query.parameters().to_string(),
            payload: query.payload().map(to_bytes).unwrap_or_default(),
            attachment: attachment_bytes(query.attachment()),
            replier: Box::new(ZenohReplier {
                asked: OwnedKeyExpr::from(query.key_expr().clone()),
                query,
                at,
                message_max,
            }),
        });
    }
}

/// Answers one query of Zenoh's, which ends when this is dropped.
struct ZenohReplier {
    query: zenoh::query::Query,
    asked: OwnedKeyExpr,
    /// When it was asked, in the sense of Zenoh, for which two nodes' times are never the same. All its answers bear this one
    /// time: of several answers on a key Zenoh gives the latest, and so, of two nodes that answer on the same keys, those of one.
    at: Timestamp,
    message_max: usize,
}

#[async_trait]
impl Replier for ZenohReplier {
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        beside: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError> {
        let key = keys::reply_key(key, &self.asked)?;
        keys::check_payload_size("answer a query", &payload, self.message_max)?;
        let reply = self.query.reply(key, payload).encoding(to_zenoh(encoding)).timestamp(self.at);
        reply.attachment(attach(beside)).await.map_err(|problem| failed("answer a query", problem))
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        let refusal = self.query.reply_err(reason).encoding(ZenohEncoding::TEXT_PLAIN);
        refusal.await.map_err(|problem| failed("answer a query", problem))
    }
}
