//! The bus: all messages between nodes pass through [`Bus`].
//!
//! `ZenohBus` is the real bus. `VirtualBus` runs a whole fleet in one process on virtual time, with
//! faults. Both match keys by the same rules (crate `zenoh-keyexpr`) and pass the same conformance
//! suite, so an actor cannot distinguish them.
//!
//! Guarantees and their limits:
//! - Samples of a publisher on a key arrive in the order sent, or not at all. Nothing else is
//!   ordered.
//! - A publication may be lost. Anything that must arrive is acknowledged by the application (use a
//!   query).
//! - A query streams the replies of all matching services. It ends when all have finished, or at
//!   its timeout.
//! - A query to the nearest service returns a single reply per key, from any service.
//! - The disappearance of a token suggests that its node is gone. It is not a proof.
//!
//! ```
//! use consort_bus::{Bus, Delivery, Encoding, LinkModel, VirtualNetwork};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // The seed determines the run: the losses and the latencies follow from it.
//! let network = VirtualNetwork::new(7, LinkModel::LAN);
//! let (ada, bob) = (network.bus("ada".parse()?), network.bus("bob".parse()?));
//! let mut samples = bob.subscribe("consort/ward/events/*").await?;
//! ada.publish("consort/ward/events/ada", "{}".into(), Encoding::Json, Delivery::Drop).await?;
//! assert_eq!(samples.recv().await.map(|sample| sample.key).as_deref(), Some("consort/ward/events/ada"));
//!
//! network.isolate("ada".parse()?); // cuts the links of ada in both directions
//! ada.publish("consort/ward/events/ada", "{}".into(), Encoding::Json, Delivery::Drop).await?;
//! tokio::time::sleep(std::time::Duration::from_secs(60)).await; // virtual time: returns at once
//! assert!(samples.try_recv().is_none());
//! # Ok(())
//! # }
//! ```

use crate::author::Author;
use crate::mailbox::{Item, MailboxReceiver};
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::api::ErrorReply;
use consort_protocol::ids::{NodeId, PersonId};
use consort_protocol::trust::MissionRights;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedReceiver;

/// Maximum size of a message on either bus, in bytes, including a few kilobytes of overhead around
/// its payload. Sending a larger payload is an error.
pub const MESSAGE_MAX: usize = 4 * 1024 * 1024;

/// Encoding of a payload. It is set on every sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// `application/octet-stream`: the project's own wire format.
    Wire,
    /// `application/json`.
    Json,
}

/// Treatment of a publication when a receiver is slow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// The publication may be dropped: for messages that are repeated or repaired.
    Drop,
    /// The publisher waits rather than lose the publication. A single frozen receiver delays all
    /// others for seconds.
    Block,
}

/// A publication as received.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    /// Key of the publication.
    pub key: String,
    /// Content.
    pub payload: Bytes,
    /// Encoding of the payload.
    pub encoding: Encoding,
    /// Attachment, empty if absent. A receiver unaware of it ignores it (Zenoh's attachments).
    pub attachment: Bytes,
    /// Author of the publication.
    pub author: Author,
}

/// A reply to a query.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// Key of the reply: each service replies on its own key.
    pub key: String,
    /// Content, or the refusal of the service.
    pub payload: Result<Bytes, QueryRefused>,
    /// Attachment, empty if absent.
    pub attachment: Bytes,
    /// Author of the reply.
    pub author: Author,
}

/// A service has refused a query, with its reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct QueryRefused(pub String);

/// An appearance or disappearance of a presence token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Presence {
    /// Key of the token.
    pub key: String,
    /// True if the token appeared, false if it vanished.
    pub alive: bool,
}

impl Item for Sample {
    fn key(&self) -> &str {
        &self.key
    }

    fn bytes(&self) -> usize {
        self.payload.len() + self.attachment.len()
    }
}

impl Item for Reply {
    fn key(&self) -> &str {
        &self.key
    }

    fn bytes(&self) -> usize {
        self.payload.as_ref().map_or_else(|refused| refused.0.len(), Bytes::len) + self.attachment.len()
    }
}

impl Item for Presence {
    fn key(&self) -> &str {
        &self.key
    }

    fn bytes(&self) -> usize {
        0
    }
}

/// The bus failed to perform an operation. Nothing was sent or declared.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// An invalid key: an error of this program, or of a name that should have been validated
    /// earlier.
    #[error("{key:?} is not a valid key: {problem}")]
    Key {
        /// The invalid text.
        key: String,
        /// Reason why it is invalid.
        problem: String,
    },
    /// The bus is closed or broken. Expected while a node shuts down.
    #[error("the bus failed to {operation}: {problem}")]
    Failed {
        /// Operation that failed.
        operation: String,
        /// Error reported by the bus.
        problem: String,
    },
}

/// Transformation of a stream's item on removal. It returns `None` for an item that the stream
/// drops.
type Transform<T> = Box<dyn FnMut(T) -> Option<T> + Send + Sync>;

/// Source of the items of a stream.
enum Source<T> {
    Channel(UnboundedReceiver<T>),
    Mailbox(MailboxReceiver<T>),
}

/// A stream of received items. Dropping it ends the declaration behind it.
pub struct Stream<T> {
    source: Source<T>,
    /// Applied to each item before it is returned.
    transform: Option<Transform<T>>,
    /// Keeps the declaration alive.
    _guard: Box<dyn Send + Sync>,
}

impl<T: 'static> Stream<T> {
    /// Creates a stream fed through `receiver`. Its declaration lives as long as `guard`.
    pub fn new(receiver: UnboundedReceiver<T>, guard: Box<dyn Send + Sync>) -> Self {
        Stream { source: Source::Channel(receiver), transform: None, _guard: guard }
    }

    /// Creates a stream of the items of a mailbox. Its declaration lives as long as `guard`.
    pub(crate) fn of_mailbox(receiver: MailboxReceiver<T>, guard: Box<dyn Send + Sync>) -> Self {
        Stream { source: Source::Mailbox(receiver), transform: None, _guard: guard }
    }

    /// Returns this stream with `transform` applied to each item on removal, after all earlier
    /// transformations.
    #[must_use]
    pub fn map(self, mut transform: impl FnMut(T) -> T + Send + Sync + 'static) -> Self {
        self.filter_map(move |item| Some(transform(item)))
    }

    /// Returns this stream with `transform` applied to each item on removal, after all earlier
    /// transformations. Items mapped to `None` are dropped.
    #[must_use]
    pub fn filter_map(self, mut transform: impl FnMut(T) -> Option<T> + Send + Sync + 'static) -> Self {
        let transform: Transform<T> = match self.transform {
            Some(mut before) => Box::new(move |item| before(item).and_then(&mut transform)),
            None => Box::new(transform),
        };
        Stream { transform: Some(transform), ..self }
    }

    /// Returns the next item, or `None` after the end of the stream.
    pub async fn recv(&mut self) -> Option<T> {
        loop {
            let next = match &mut self.source {
                Source::Channel(receiver) => receiver.recv().await?,
                Source::Mailbox(receiver) => receiver.recv().await?,
            };
            if let Some(item) = self.transformed(next) {
                return Some(item);
            }
        }
    }

    /// Returns the next item if it has already arrived.
    pub fn try_recv(&mut self) -> Option<T> {
        loop {
            let next = match &mut self.source {
                Source::Channel(receiver) => receiver.try_recv().ok()?,
                Source::Mailbox(receiver) => receiver.try_recv()?,
            };
            if let Some(item) = self.transformed(next) {
                return Some(item);
            }
        }
    }

    fn transformed(&mut self, item: T) -> Option<T> {
        match &mut self.transform {
            Some(transform) => transform(item),
            None => Some(item),
        }
    }
}

/// A query received from a node or a client. Dropping it ends this service's part of the reply.
pub struct Query {
    /// Key expression of the query.
    pub key: String,
    /// Parameters of the selector, as text (`a=1;b=2`), empty if absent.
    pub parameters: String,
    /// Payload of the query, empty if absent.
    pub payload: Bytes,
    /// Attachment, empty if absent.
    pub attachment: Bytes,
    /// Author of a query between nodes.
    pub author: Author,
    /// Authority of a request that changes the fleet.
    pub authority: RequestAuthority,
    /// Sends the replies.
    pub replier: Box<dyn Replier>,
}

/// Authority of a request. The service that executes a request decides by it; a service of plain
/// data ignores it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RequestAuthority {
    /// The request was not checked: the fleet is open, or the query changes nothing.
    Unchecked,
    /// The request is signed by this requester, with the necessary scope.
    Verified(Requester),
    /// Nobody with the necessary scope has signed the request. It must not be executed; this is the
    /// reply.
    Rejected(ErrorReply),
}

/// Verified author of a request that changes a closed fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Requester {
    /// The author.
    pub author: RequestAuthor,
    /// Id of this request: a repetition of the same signed message has the same.
    pub request: String,
    /// Time of signing, in milliseconds since 1970.
    pub signed_at_ms: u64,
}

/// Author of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestAuthor {
    /// Person that signed the request, or whose token was forwarded.
    pub name: PersonId,
    /// Missions that the person may submit. The node that executes a request checks them.
    pub missions: MissionRights,
    /// Node of the dashboard that forwarded the token.
    pub through: Option<NodeId>,
}

impl fmt::Display for RequestAuthor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.through {
            None => write!(f, "{}", self.name),
            Some(node) => write!(f, "{} through {node}", self.name),
        }
    }
}

/// Sends a service's replies to a query.
#[async_trait]
pub trait Replier: Send + Sync {
    /// Replies on `key`, which must match the query's key expression.
    ///
    /// # Errors
    /// [`BusError`] if `key` does not match the query, the payload is larger than [`MESSAGE_MAX`],
    /// or the bus is closed.
    async fn reply(&self, key: &str, payload: Bytes, encoding: Encoding) -> Result<(), BusError> {
        self.reply_with_attachment(key, payload, Bytes::new(), encoding).await
    }

    /// Replies with an attachment of at most a kilobyte or two.
    ///
    /// # Errors
    /// As [`reply`](Self::reply).
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError>;

    /// Replies with an error and its reason.
    ///
    /// # Errors
    /// [`BusError::Failed`] if the bus is closed.
    async fn refuse(&self, reason: &str) -> Result<(), BusError>;
}

/// Guard of a presence token: the token exists until the guard is dropped.
pub struct PresenceToken {
    _guard: Box<dyn Send + Sync>,
}

impl PresenceToken {
    /// Creates a token. Its declaration lives as long as `guard`.
    pub fn new(guard: Box<dyn Send + Sync>) -> Self {
        PresenceToken { _guard: guard }
    }
}

/// A link from this node to a neighbour.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Link {
    /// Id of the neighbour on the bus.
    pub peer: String,
    /// Kind of the neighbour: `router`, `peer` or `client`.
    pub kind: String,
}

/// Selection of the services that receive a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ServiceSelection {
    /// Every matching service.
    All,
    /// The nearest of the matching services that are [complete](Bus::serve_complete). If there is
    /// none, every matching service, and a single reply is returned per key.
    Nearest,
}

/// The interface of a bus, as used by actors.
#[async_trait]
pub trait Bus: Send + Sync + 'static {
    /// Publishes on a key.
    ///
    /// # Errors
    /// [`BusError`] if `key` is invalid, the payload is larger than [`MESSAGE_MAX`], or the bus is
    /// closed. A publication without subscribers is no error.
    async fn publish(&self, key: &str, payload: Bytes, encoding: Encoding, delivery: Delivery) -> Result<(), BusError> {
        self.publish_with_attachment(key, payload, Bytes::new(), encoding, delivery).await
    }

    /// Publishes with an attachment of at most a kilobyte or two.
    ///
    /// # Errors
    /// As [`publish`](Self::publish).
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError>;

    /// Subscribes to publications on matching keys.
    ///
    /// # Errors
    /// [`BusError`] if the text is not a key expression, or the bus is closed.
    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError>;

    /// Queries all matching services. The stream ends when all have replied, or at the timeout.
    ///
    /// # Errors
    /// [`BusError`] if `key_expr` is not a key expression, the payload is larger than
    /// [`MESSAGE_MAX`], or the bus is closed. A query without replies is no error.
    async fn query(&self, key_expr: &str, payload: Bytes, timeout: Duration) -> Result<Stream<Reply>, BusError> {
        self.query_with(key_expr, payload, Bytes::new(), timeout, ServiceSelection::All).await
    }

    /// Queries for a single reply per key.
    ///
    /// If matching services are [complete](Self::serve_complete) for the whole query, only the
    /// nearest is queried (on Zenoh the nearest on this node and the nearest elsewhere). Of several
    /// replies on a key a single one is returned; of two services that reply on the same keys, all
    /// replies come from the same service. Replies are returned when the query ends, or at the
    /// timeout. This is Zenoh's default kind of query.
    ///
    /// # Errors
    /// As [`query`](Self::query).
    async fn query_nearest(
        &self,
        key_expr: &str,
        payload: Bytes,
        timeout: Duration,
    ) -> Result<Stream<Reply>, BusError> {
        self.query_with(key_expr, payload, Bytes::new(), timeout, ServiceSelection::Nearest).await
    }

    /// Queries the selected services, with an attachment of at most a kilobyte or two.
    ///
    /// # Errors
    /// As [`query`](Self::query).
    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        attachment: Bytes,
        timeout: Duration,
        target: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError>;

    /// Serves matching queries.
    ///
    /// # Errors
    /// [`BusError`] if the text is not a key expression, or the bus is closed.
    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError>;

    /// Serves matching queries as a complete service: it has every value below `key_expr`, like all
    /// other complete services of that expression. [`query_nearest`](Self::query_nearest) queries a
    /// single complete service.
    ///
    /// # Errors
    /// [`BusError`] if the text is not a key expression, or the bus is closed.
    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError>;

    /// Declares a presence token on a key.
    ///
    /// # Errors
    /// [`BusError`] if the text is not a key expression, or the bus is closed.
    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError>;

    /// Watches presence tokens: first reports the existing tokens, then each change.
    ///
    /// # Errors
    /// [`BusError`] if the text is not a key expression, or the bus is closed.
    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError>;

    /// Returns the neighbours that this node is connected to at this moment, in order.
    async fn links(&self) -> Vec<Link>;
}

/// A bus shared by the actors of a node.
pub type SharedBus = Arc<dyn Bus>;
