//! The bus: everything that nodes say to one another goes through [`Bus`].
//!
//! `ZenohBus` is the real one; `VirtualBus` keeps a whole fleet in one process on virtual time, with faults. Both
//! match keys by the same rules (crate `zenoh-keyexpr`) and pass one conformance suite, so that an actor cannot tell
//! which it is on.
//!
//! What is promised, and what is not:
//! - Samples of one publisher on one key arrive in the order sent, or not at all. Nothing else is ordered.
//! - A publication may be lost: what must arrive is acknowledged by the application (use a query).
//! - A query streams the replies of all matching services and ends when all have finished, or at its limit.
//! - A query of the nearest gives one answer on each key, whoever gives it.
//! - A token's disappearance is a hint that its node is gone, never a proof.
//!
//! ```
//! use consort_actors::bus::{Bus, Delivery, Encoding, LinkModel, VirtualNetwork};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // A seed is a run: what is lost, and how long the rest takes, follow from it.
//! let network = VirtualNetwork::new(7, LinkModel::LAN);
//! let (ada, bob) = (network.bus("ada".parse()?), network.bus("bob".parse()?));
//! let mut heard = bob.subscribe("consort/ward/events/*").await?;
//! ada.publish("consort/ward/events/ada", "{}".into(), Encoding::Json, Delivery::Drop).await?;
//! assert_eq!(heard.recv().await.map(|sample| sample.key).as_deref(), Some("consort/ward/events/ada"));
//!
//! network.isolate("ada".parse()?); // her cable is cut, both ways
//! ada.publish("consort/ward/events/ada", "{}".into(), Encoding::Json, Delivery::Drop).await?;
//! tokio::time::sleep(std::time::Duration::from_secs(60)).await; // virtual: no time passes
//! assert!(heard.try_recv().is_none());
//! # Ok(())
//! # }
//! ```

mod keys;
mod layer;
mod metered;
pub mod virtual_bus;
pub mod zenoh_bus;

pub(crate) use layer::{Layer, MessageContent, refuse_in_background};
pub use metered::{Direction, Meter, MeteredBus};
pub use virtual_bus::{LinkModel, Traffic, TrafficByKind, VirtualBus, VirtualNetwork};
pub use zenoh_bus::{ZenohBus, ZenohSettings};

use async_trait::async_trait;
use bytes::Bytes;
use std::sync::Arc;
use std::time::Duration;

/// Largest message on either bus, in bytes, the few kilobytes around its payload included. A larger payload is an error
/// where it is sent.
pub const MESSAGE_MAX: usize = 4 * 1024 * 1024;

/// How a payload is to be read. It is set on every sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// `application/octet-stream`: our own wire format.
    Wire,
    /// `application/json`.
    Json,
}

/// What happens to a publication when a receiver is slow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// It may be dropped: for what repeats or repairs itself.
    Drop,
    /// The publisher is held up rather than lose it. One frozen receiver holds up everybody for seconds.
    Block,
}

/// Something published.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    /// The key it was published on.
    pub key: String,
    /// Its content.
    pub payload: Bytes,
    /// How to read it.
    pub encoding: Encoding,
    /// What is said beside the content, empty if nothing: whoever does not know of it does not see it (Zenoh's attachments).
    pub attachment: Bytes,
}

/// An answer to a query.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// The key it answers on: every service answers on its own.
    pub key: String,
    /// Content, or the error that the service gave instead.
    pub payload: Result<Bytes, String>,
    /// What is said beside the content, empty if nothing.
    pub attachment: Bytes,
}

/// A change in who is there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Presence {
    /// The token's key.
    pub key: String,
    /// Whether it appeared or vanished.
    pub alive: bool,
}

/// Why the bus did not do as asked. Nothing was sent or declared.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// Our own mistake, or a name that should have been checked before.
    #[error("{key:?} is no key expression: {problem}")]
    Key {
        /// The text given.
        key: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The bus is closed or broken; ordinary while a node shuts down.
    #[error("the bus failed to {operation}: {problem}")]
    Failed {
        /// What was attempted.
        operation: String,
        /// What the bus said.
        problem: String,
    },
}

/// What an item of a stream becomes when it is taken out; nothing, if it is not handed out.
type Sift<T> = Box<dyn FnMut(T) -> Option<T> + Send + Sync>;

/// A stream of what arrives; dropping it ends the declaration behind it.
pub struct Stream<T> {
    receiver: tokio::sync::mpsc::UnboundedReceiver<T>,
    /// What each passes through before it is handed out.
    sift: Option<Sift<T>>,
    /// Whatever keeps the declaration alive.
    _guard: Box<dyn Send + Sync>,
}

impl<T: 'static> Stream<T> {
    /// A stream fed through `receiver`, whose declaration lives as long as `guard`.
    pub fn new(receiver: tokio::sync::mpsc::UnboundedReceiver<T>, guard: Box<dyn Send + Sync>) -> Self {
        Stream { receiver, sift: None, _guard: guard }
    }

    /// This stream, each of whose items passes through `pass` when it is taken out, after whatever it passed through before.
    #[must_use]
    pub fn map(self, mut pass: impl FnMut(T) -> T + Send + Sync + 'static) -> Self {
        self.filter_map(move |item| Some(pass(item)))
    }

    /// This stream, of which only those items are handed out that pass `sift`, after whatever they passed through before.
    #[must_use]
    pub fn filter_map(self, mut sift: impl FnMut(T) -> Option<T> + Send + Sync + 'static) -> Self {
        let sift: Sift<T> = match self.sift {
            Some(mut before) => Box::new(move |item| before(item).and_then(&mut sift)),
            None => Box::new(sift),
        };
        Stream { sift: Some(sift), ..self }
    }

    /// The next one; `None` once there will be no more.
    pub async fn recv(&mut self) -> Option<T> {
        loop {
            let next = self.receiver.recv().await?;
            if let Some(item) = self.sifted(next) {
                return Some(item);
            }
        }
    }

    /// The next one if it is already here.
    pub fn try_recv(&mut self) -> Option<T> {
        loop {
            let next = self.receiver.try_recv().ok()?;
            if let Some(item) = self.sifted(next) {
                return Some(item);
            }
        }
    }

    fn sifted(&mut self, item: T) -> Option<T> {
        match &mut self.sift {
            Some(sift) => sift(item),
            None => Some(item),
        }
    }
}

/// A question from some node or client. Dropping it ends the answer.
pub struct Query {
    /// The key expression that was asked.
    pub key: String,
    /// The selector's parameters, as text (`a=1;b=2`), empty if none.
    pub parameters: String,
    /// The question's content, empty if none.
    pub payload: Bytes,
    /// What is said beside the content, empty if nothing.
    pub attachment: Bytes,
    /// How to answer.
    pub replier: Box<dyn Replier>,
}

/// How a service answers one query.
#[async_trait]
pub trait Replier: Send + Sync {
    /// Answers on `key`, which must match the query's key expression.
    ///
    /// # Errors
    /// [`BusError`] if `key` does not match the query, the payload is larger than [`MESSAGE_MAX`], or the bus is closed.
    async fn reply(&self, key: &str, payload: Bytes, encoding: Encoding) -> Result<(), BusError> {
        self.reply_with_attachment(key, payload, Bytes::new(), encoding).await
    }

    /// The same with something beside the content, of a kilobyte or two.
    ///
    /// # Errors
    /// As [`reply`](Self::reply).
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        beside: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError>;

    /// Answers that it cannot answer, and why.
    ///
    /// # Errors
    /// [`BusError::Failed`] if the bus is closed.
    async fn refuse(&self, reason: &str) -> Result<(), BusError>;
}

/// Keeps a presence token alive.
pub struct PresenceToken {
    _guard: Box<dyn Send + Sync>,
}

impl PresenceToken {
    /// A token whose declaration lives as long as `guard`.
    pub fn new(guard: Box<dyn Send + Sync>) -> Self {
        PresenceToken { _guard: guard }
    }
}

/// A neighbour this node has a link to.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Link {
    /// The neighbour's id on the bus.
    pub peer: String,
    /// `router`, `peer` or `client`.
    pub kind: String,
}

/// Who is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ServiceSelection {
    /// Every service that matches.
    All,
    /// The nearest of those that are [complete](Bus::serve_complete); if there is none, as above, with one answer on each key.
    Nearest,
}

/// The bus as actors see it.
#[async_trait]
pub trait Bus: Send + Sync + 'static {
    /// Publishes on a key.
    ///
    /// # Errors
    /// [`BusError`] if `key` is no key, the payload is larger than [`MESSAGE_MAX`], or the bus is closed. That nobody hears
    /// it is none.
    async fn publish(&self, key: &str, payload: Bytes, encoding: Encoding, delivery: Delivery) -> Result<(), BusError> {
        self.publish_with_attachment(key, payload, Bytes::new(), encoding, delivery).await
    }

    /// The same with something beside the content, of a kilobyte or two.
    ///
    /// # Errors
    /// As [`publish`](Self::publish).
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        beside: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError>;

    /// Hears what is published on keys that match.
    ///
    /// # Errors
    /// [`BusError`] if the text is no key expression, or the bus is closed.
    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError>;

    /// Asks all services that match; the stream ends when all have answered, or at the limit.
    ///
    /// # Errors
    /// [`BusError`] if `key_expr` is none, the payload is larger than [`MESSAGE_MAX`], or the bus is closed. That nobody
    /// answers is none.
    async fn query(&self, key_expr: &str, payload: Bytes, limit: Duration) -> Result<Stream<Reply>, BusError> {
        self.query_with(key_expr, payload, Bytes::new(), limit, ServiceSelection::All).await
    }

    /// Asks for one answer on each key. If services that match are [complete](Self::serve_complete) for all that is asked,
    /// the nearest is asked instead of all (on Zenoh the nearest here and the nearest elsewhere). Of several answers on one key
    /// one is given, and of two services that answer on the same keys those of one. All that was answered is given when the
    /// query ends, or at the limit. That is how Zenoh asks unless it is told otherwise.
    ///
    /// # Errors
    /// As [`query`](Self::query).
    async fn query_nearest(&self, key_expr: &str, payload: Bytes, limit: Duration) -> Result<Stream<Reply>, BusError> {
        self.query_with(key_expr, payload, Bytes::new(), limit, ServiceSelection::Nearest).await
    }

    /// Either of these, with something beside the content, of a kilobyte or two.
    ///
    /// # Errors
    /// As [`query`](Self::query).
    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        beside: Bytes,
        limit: Duration,
        whom: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError>;

    /// Answers queries that match.
    ///
    /// # Errors
    /// [`BusError`] if the text is no key expression, or the bus is closed.
    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError>;

    /// Answers queries that match, and knows everything there is below `key_expr`, as others do that serve the same:
    /// [`query_nearest`](Self::query_nearest) asks one of them.
    ///
    /// # Errors
    /// [`BusError`] if the text is no key expression, or the bus is closed.
    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError>;

    /// Declares presence under a key.
    ///
    /// # Errors
    /// [`BusError`] if the text is no key expression, or the bus is closed.
    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError>;

    /// Hears of presence: what is there already, then every change.
    ///
    /// # Errors
    /// [`BusError`] if the text is no key expression, or the bus is closed.
    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError>;

    /// The neighbours this node is connected to at this moment, in order.
    async fn links(&self) -> Vec<Link>;
}

/// A bus that is shared by the actors of a node.
pub type SharedBus = Arc<dyn Bus>;
