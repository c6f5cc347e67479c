//! A bus on which every message of a node carries its author's signature.

use super::certificates::{CertificateExchange, ExchangeContext};
use super::keyring::Keyring;
use super::record_signer::KeyringSigner;
use super::rejections::RejectionLog;
use super::verifier::{DetachedSignature, ReceivedMessage, Verifier, Windows};
use crate::bus::{BusError, Encoding, Query, Replier, Reply, Sample, SharedBus, Stream};
use crate::clock::Clock;
use crate::layer::{Layer, MessageContent, refuse_in_background};
use crate::record_signer::SharedRecordSigner;
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::access::Operation;
use consort_protocol::keys::Keys;
use consort_protocol::trust::{MessageKind, decode_requester, encode_requester};
use std::path::PathBuf;
use std::sync::Arc;

/// Bus that signs outgoing messages, and delivers only messages that are signed, authorized and
/// new.
///
/// Messages below `wire/` are wrapped in a signed envelope. Messages that clients read (views,
/// replies to requests, events) stay plain, with the signature as attachment. Other messages pass
/// unchanged: certificates prove themselves, and presence has no content.
pub struct SigningBus {
    bus: SharedBus,
    verifier: Arc<Verifier>,
}

/// Location of a message's signature.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SignaturePlace {
    /// Signed envelope around the message.
    Envelope,
    /// Detached signature in the attachment.
    Attachment,
    /// No signature.
    Absent,
}

impl SigningBus {
    /// Signs the messages on `bus` with `keyring`. `revoked` is the file with the list of revoked
    /// certificates; it is read again periodically.
    ///
    /// # Errors
    /// [`BusError`] if the node's own certificate cannot be served.
    pub async fn open(
        bus: SharedBus,
        keys: Keys,
        keyring: Arc<Keyring>,
        revoked: Option<PathBuf>,
        clock: Clock,
    ) -> Result<SigningBus, BusError> {
        let rejections = Arc::new(RejectionLog::default());
        let context = ExchangeContext {
            bus: Arc::clone(&bus),
            keys: keys.clone(),
            keyring: Arc::clone(&keyring),
            clock,
            rejections: Arc::clone(&rejections),
        };
        let certificates = Arc::new(CertificateExchange::open(context, revoked).await?);
        Ok(SigningBus { bus, verifier: Arc::new(Verifier { keys, keyring, certificates, rejections, clock }) })
    }

    /// Returns the signer of this node's records, which also verifies records of other nodes.
    pub fn record_signer(&self) -> SharedRecordSigner {
        let Verifier { keyring, certificates, .. } = &*self.verifier;
        Arc::new(KeyringSigner { keyring: Arc::clone(keyring), certificates: Arc::clone(certificates) })
    }

    /// Returns the reasons of recent rejections, as text.
    pub fn rejections(&self) -> Vec<String> {
        self.verifier.rejections.recent()
    }

    /// Returns the location of the signature for a key or key expression.
    fn signature_place(&self, key: &str) -> SignaturePlace {
        match self.verifier.keys.strip_fleet(key).and_then(|suffix| suffix.split_once('/')) {
            Some(("wire", rest)) if rest.starts_with("certificate/") => SignaturePlace::Absent,
            Some(("wire", _)) => SignaturePlace::Envelope,
            Some(("view" | "seen" | "api" | "events", _)) => SignaturePlace::Attachment,
            _ => SignaturePlace::Absent,
        }
    }

    fn samples(&self, samples: Stream<Sample>, place: SignaturePlace) -> Stream<Sample> {
        let (verifier, mut windows) = (Arc::clone(&self.verifier), Windows::default());
        samples.filter_map(move |sample| {
            let message = ReceivedMessage {
                kind: MessageKind::Publication,
                operation: Operation::Publish,
                key: &sample.key,
                bytes: &sample.payload,
                detached: (place == SignaturePlace::Attachment)
                    .then_some(DetachedSignature { signature: &sample.attachment, query: &[] }),
            };
            let verified = verifier.verify(&message, Some(&mut windows)).ok()?;
            let payload = verified.payload(&sample.payload);
            Some(Sample { payload, attachment: Bytes::new(), ..sample })
        })
    }

    /// Verifies queries between nodes, and signs the replies to them.
    fn sign_replies_to_nodes(&self, queries: Stream<Query>) -> Stream<Query> {
        let (verifier, mut windows) = (Arc::clone(&self.verifier), Windows::default());
        queries.filter_map(move |query| {
            let message = ReceivedMessage {
                kind: MessageKind::Query,
                operation: Operation::Query,
                key: &query.key,
                bytes: &query.payload,
                detached: None,
            };
            match verifier.verify(&message, Some(&mut windows)) {
                Ok(verified) => {
                    let payload = verified.payload(&query.payload);
                    let kind = MessageKind::Reply(verified.signer, verified.number);
                    let keyring = Arc::clone(&verifier.keyring);
                    let replier =
                        Box::new(SigningReplier { replier: query.replier, keyring, kind, query_payload: None });
                    Some(Query { payload, replier, ..query })
                }
                Err(rejected) => {
                    refuse_in_background(query, rejected.to_string());
                    None
                }
            }
        })
    }

    /// Passes client queries: the links have authorized them. Replies are signed if the requester
    /// will verify them.
    fn sign_replies_to_clients(&self, queries: Stream<Query>) -> Stream<Query> {
        let keyring = Arc::clone(&self.verifier.keyring);
        queries.map(move |query| match decode_requester(&query.attachment) {
            Some(kind) => {
                let (keyring, query_payload) = (Arc::clone(&keyring), Some(query.payload.clone()));
                let replier = Box::new(SigningReplier { replier: query.replier, keyring, kind, query_payload });
                Query { replier, attachment: Bytes::new(), ..query }
            }
            None => query,
        })
    }

    /// Returns the replies that pass verification. For detached signatures, `query` is the payload
    /// of the query.
    fn replies(&self, replies: Stream<Reply>, number: u64, query: Option<Bytes>) -> Stream<Reply> {
        let verifier = Arc::clone(&self.verifier);
        let kind = MessageKind::Reply(self.verifier.keyring.fingerprint(), number);
        replies.filter_map(move |reply| {
            let detached = query.as_ref().map(|query| DetachedSignature { signature: &reply.attachment, query });
            let bytes = match &reply.payload {
                Ok(bytes) => bytes,
                // Nodes of this fleet refuse with signed JSON.
                Err(_) if detached.is_some() => {
                    verifier.reject_unsigned(&reply.key);
                    return None;
                }
                Err(_) => return Some(reply),
            };
            let message = ReceivedMessage { kind, operation: Operation::Reply, key: &reply.key, bytes, detached };
            let verified = verifier.verify(&message, None).ok()?;
            let payload = Ok(verified.payload(bytes));
            Some(Reply { payload, attachment: Bytes::new(), ..reply })
        })
    }
}

impl Layer for SigningBus {
    /// Number of a signed query, and its payload if the replies carry detached signatures.
    type QueryState = Option<(u64, Option<Bytes>)>;

    fn inner(&self) -> &SharedBus {
        &self.bus
    }

    fn outgoing_publication(&self, key: &str, content: MessageContent) -> Result<MessageContent, BusError> {
        let keyring = &self.verifier.keyring;
        Ok(match self.signature_place(key) {
            SignaturePlace::Envelope => {
                let payload = keyring
                    .sign_envelope(MessageKind::Publication, keyring.next_number(), key, &content.payload)
                    .into();
                MessageContent { payload, ..content }
            }
            SignaturePlace::Attachment => {
                let attachment = keyring.sign_detached(MessageKind::Publication, key, &[], &content.payload).into();
                MessageContent { attachment, ..content }
            }
            SignaturePlace::Absent => content,
        })
    }

    fn incoming_publications(&self, key_expr: &str, samples: Stream<Sample>) -> Stream<Sample> {
        match self.signature_place(key_expr) {
            SignaturePlace::Absent => samples,
            place => self.samples(samples, place),
        }
    }

    fn outgoing_query(
        &self,
        key_expr: &str,
        content: MessageContent,
    ) -> Result<(MessageContent, Self::QueryState), BusError> {
        let keyring = &self.verifier.keyring;
        // The service receives the query's key without its parameters.
        let key = key_expr.split('?').next().unwrap_or_default();
        Ok(match self.signature_place(key) {
            SignaturePlace::Absent => (content, None),
            SignaturePlace::Envelope => {
                let number = keyring.next_number();
                let payload = keyring.sign_envelope(MessageKind::Query, number, key, &content.payload).into();
                (MessageContent { payload, ..content }, Some((number, None)))
            }
            SignaturePlace::Attachment => {
                let number = keyring.next_number();
                let (attachment, query) =
                    (encode_requester(keyring.fingerprint(), number).into(), content.payload.clone());
                (MessageContent { attachment, ..content }, Some((number, Some(query))))
            }
        })
    }

    fn incoming_replies(&self, state: Self::QueryState, replies: Stream<Reply>) -> Stream<Reply> {
        match state {
            Some((number, query)) => self.replies(replies, number, query),
            None => replies,
        }
    }

    fn incoming_queries(&self, key_expr: &str, queries: Stream<Query>) -> Stream<Query> {
        match self.signature_place(key_expr) {
            SignaturePlace::Envelope => self.sign_replies_to_nodes(queries),
            SignaturePlace::Attachment => self.sign_replies_to_clients(queries),
            SignaturePlace::Absent => queries,
        }
    }
}

/// Sends the signed replies to a query.
struct SigningReplier {
    replier: Box<dyn Replier>,
    keyring: Arc<Keyring>,
    kind: MessageKind,
    /// Payload of the query, if the reply carries a detached signature.
    query_payload: Option<Bytes>,
}

#[async_trait]
impl Replier for SigningReplier {
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError> {
        let (payload, attachment) = match &self.query_payload {
            None => {
                (self.keyring.sign_envelope(self.kind, self.keyring.next_number(), key, &payload).into(), attachment)
            }
            Some(query) => {
                let signature = self.keyring.sign_detached(self.kind, key, query, &payload);
                (payload, signature.into())
            }
        };
        self.replier.reply_with_attachment(key, payload, attachment, encoding).await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.replier.refuse(reason).await
    }
}
