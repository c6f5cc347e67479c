//! The real bus, on a single Zenoh session.
//!
//! Zenoh runs callbacks inside its own receive and send paths. Therefore every callback here only
//! puts a message into a mailbox, which never waits. A query goes to all matching services and its replies are not
//! consolidated, unless the nearest service is selected. Every query has its own timeout.

mod conversion;
mod current_session;
mod error;
mod failover;
mod link_check;
mod presence;
mod session;
mod settings;
mod transmission;

pub use settings::{LinkTrust, Mode, ZenohSettings};

use crate::bus::{
    Bus, BusError, Delivery, Encoding, Link, Presence, PresenceToken, Query, Reply, Sample, ServiceSelection, Stream,
};
use crate::keys;
use crate::mailbox::mailbox;
use crate::open_queries::query_mailbox;
use async_trait::async_trait;
use bytes::Bytes;
use conversion::{reply, to_attachment, to_zenoh};
use error::failed;
use presence::PresentTokens;
use session::{Declaration, SessionManager};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::time::{Instant, sleep};
use transmission::priority_of;
use zenoh::Wait;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, QueryTarget};

/// Poll interval while waiting for a condition.
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// A node's session on a Zenoh network. It needs a multi-threaded tokio runtime. Clones share the
/// session, which closes with the last clone.
#[derive(Clone)]
pub struct ZenohBus {
    manager: Arc<SessionManager>,
}

impl ZenohBus {
    /// Opens a session. All but [`Mode::Client`] open even if no neighbour can be reached, and keep
    /// trying: see [`wait_connected`](Self::wait_connected).
    ///
    /// # Errors
    /// [`BusError::Failed`] if the runtime is not multi-threaded, a setting is invalid, an address
    /// cannot be listened on (the error names it, and whether the port is taken), or a
    /// [`Mode::Client`] reaches no router.
    pub async fn open(settings: ZenohSettings) -> Result<ZenohBus, BusError> {
        let multi_threaded =
            Handle::try_current().is_ok_and(|runtime| runtime.runtime_flavor() != RuntimeFlavor::CurrentThread);
        if !multi_threaded {
            return Err(failed("open", "Zenoh needs a multi-threaded tokio runtime"));
        }
        let manager = SessionManager::open(settings).await?;
        if manager.settings().mode == Mode::NodeClient {
            tokio::spawn(failover::run(Arc::downgrade(&manager)));
        }
        Ok(ZenohBus { manager })
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

impl ZenohBus {
    async fn declare_queryable(&self, key_expr: &str, complete: bool) -> Result<Stream<Query>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = query_mailbox();
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
        let priority = priority_of(key);
        let key = keys::single_key(key)?;
        keys::check_payload_size("publish", &payload, self.manager.settings().message_max)?;
        let control = match delivery {
            Delivery::Drop => CongestionControl::Drop,
            Delivery::Block => CongestionControl::Block,
        };
        let session = self.manager.session();
        let send = move || {
            let put = session.put(key, payload).encoding(to_zenoh(encoding));
            let put = put.congestion_control(control).priority(priority);
            put.attachment(to_attachment(attachment)).wait()
        };
        self.manager.senders().send("publish", priority, send).await
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mailbox();
        let declared = self.manager.declare(Declaration::Subscriber(key_expr, mailbox)).await?;
        Ok(Stream::of_mailbox(receiver, Box::new(declared)))
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
        let (replies, receiver) = mailbox();
        let key = query_key.clone();
        let on_reply = move |answer: zenoh::query::Reply| {
            if let Some(reply) = reply(answer, &key) {
                replies.send(reply);
            }
        };
        let (session, priority) = (self.manager.session(), priority_of(query_key.as_str()));
        let parameters = parameters.to_owned();
        let send = move || {
            let get = session.get((query_key, parameters)).target(target).consolidation(consolidation).timeout(timeout);
            // A dropped query or reply would be awaited until the timeout.
            let mut get = get.congestion_control(CongestionControl::Block).priority(priority);
            if !payload.is_empty() {
                get = get.payload(payload).encoding(to_zenoh(Encoding::Wire));
            }
            get.attachment(to_attachment(attachment)).callback(on_reply).wait()
        };
        let sent = self.manager.senders().send("query", priority, send);
        match tokio::time::timeout(timeout, sent).await {
            Ok(sent) => sent?,
            // It waits for a slow link. Its replies would be late.
            Err(_) => return Ok(Stream::of_mailbox(mailbox().1, Box::new(()))),
        }
        Ok(Stream::of_mailbox(receiver, Box::new(())))
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
        let (mailbox, receiver) = mailbox();
        let present = Arc::new(Mutex::new(PresentTokens::new(self.manager.settings().presence_hold())));
        let declared = self.manager.declare(Declaration::PresenceSubscriber(key_expr, mailbox, present)).await?;
        Ok(Stream::of_mailbox(receiver, Box::new(declared)))
    }

    async fn links(&self) -> Vec<Link> {
        let transports = self.manager.session().info().transports().await;
        let links = transports.map(|link| Link { peer: link.zid().to_string(), kind: link.whatami().to_string() });
        links.collect::<BTreeSet<Link>>().into_iter().collect()
    }
}
