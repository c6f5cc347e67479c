//! A bus on which every message of a node carries its author's signature.

use super::certificates::{CertificateExchange, ExchangeContext};
use super::executed_requests::ExecutedRequests;
use super::files::RevokedFiles;
use super::keyring::Keyring;
use super::record_signer::KeyringSigner;
use super::rejections::RejectionLog;
use super::verifier::{DetachedSignature, ReceivedMessage, Verifier, Windows};
use crate::bus::{
    BusError, Encoding, Query, QueryRefused, Replier, Reply, RequestAuthority, Sample, SharedBus, Stream,
};
use crate::clock::Clock;
use crate::layer::{Layer, MessageContent, refuse_in_background};
use crate::record_signer::SharedRecordSigner;
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::access::{Operation, scope_to_sign};
use consort_protocol::codec;
use consort_protocol::keys::Keys;
use consort_protocol::trust::{
    MessageKind, RequestProof, SignedEnvelope, decode_envelope, decode_requester, encode_requester, is_refusal,
};
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
    /// Signs the messages on `bus` with `keyring`. `revoked` are the files with the list of revoked
    /// certificates; it is read again periodically.
    ///
    /// # Errors
    /// [`BusError`] if the node's own certificate cannot be served.
    pub async fn open(
        bus: SharedBus,
        keys: Keys,
        keyring: Arc<Keyring>,
        revoked: RevokedFiles,
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
        let executed_requests = ExecutedRequests::default();
        let verifier = Verifier { keys, keyring, certificates, rejections, clock, executed_requests };
        Ok(SigningBus { bus, verifier: Arc::new(verifier) })
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

    /// Returns the number of messages rejected so far.
    pub fn rejection_count(&self) -> u64 {
        self.verifier.rejections.count()
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
            Some(Sample { payload, attachment: Bytes::new(), author: verified.author, ..sample })
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
                    let query = Query { payload, author: verified.author, ..query };
                    Some(SigningReplier::wrap(query, &verifier.keyring, kind, None))
                }
                Err(rejected) => {
                    // Also nodes whose certificate is not yet known here get a signed refusal.
                    let query = match decode_envelope(MessageKind::Query, &query.payload) {
                        Ok(SignedEnvelope { signer, number, .. }) => {
                            SigningReplier::wrap(query, &verifier.keyring, MessageKind::Reply(signer, number), None)
                        }
                        Err(_) => query,
                    };
                    refuse_in_background(query, rejected.to_string());
                    None
                }
            }
        })
    }

    /// Passes client queries. Those that change the fleet are verified; the links have authorized
    /// the others. Replies are signed if the requester will verify them.
    fn sign_replies_to_clients(&self, queries: Stream<Query>) -> Stream<Query> {
        let verifier = Arc::clone(&self.verifier);
        queries.filter_map(move |query| {
            let authority = match scope_to_sign(verifier.suffix(&query.key)) {
                Some(scope) => verifier.verify_request(&query, scope)?,
                None => RequestAuthority::Unchecked,
            };
            let query = Query { authority, ..query };
            Some(match decode_requester(&query.attachment) {
                Some(kind) => {
                    let query_payload = Some(query.payload.clone());
                    let query = Query { attachment: Bytes::new(), ..query };
                    SigningReplier::wrap(query, &verifier.keyring, kind, query_payload)
                }
                None => query,
            })
        })
    }

    /// Signs a request that changes the fleet. A forwarded token is the attachment of its caller.
    fn sign_request(&self, number: u64, key: &str, content: &MessageContent) -> Result<Vec<u8>, BusError> {
        let Verifier { keyring, clock, .. } = &*self.verifier;
        let failed = |problem: String| BusError::Failed { operation: format!("sign {key}"), problem };
        let token = std::str::from_utf8(&content.attachment).map_err(|problem| failed(problem.to_string()))?;
        let proof = RequestProof {
            signed_at_ms: clock.wall_ms(),
            certificate: keyring.own_certificate(),
            token: (!token.is_empty()).then(|| token.to_owned()),
        };
        let proof = codec::encode(&proof).map_err(|problem| failed(problem.to_string()))?;
        Ok(keyring.sign_request(number, key, &proof, &content.payload))
    }

    /// Returns the replies that pass verification. For detached signatures, `query` is the payload
    /// of the query.
    fn replies(&self, replies: Stream<Reply>, number: u64, query: Option<Bytes>) -> Stream<Reply> {
        let verifier = Arc::clone(&self.verifier);
        let own = self.verifier.keyring.fingerprint();
        replies.filter_map(move |reply| {
            let detached = query.as_ref().map(|query| DetachedSignature { signature: &reply.attachment, query });
            // Nodes of this fleet sign their refusals: as JSON, or in an envelope.
            let Ok(bytes) = &reply.payload else {
                verifier.reject_unsigned(&reply.key);
                return None;
            };
            let is_refusal = detached.is_none() && is_refusal(bytes);
            let (kind, operation) = match is_refusal {
                true => (MessageKind::Refusal(own, number), Operation::Refuse),
                false => (MessageKind::Reply(own, number), Operation::Reply),
            };
            let message = ReceivedMessage { kind, operation, key: &reply.key, bytes, detached };
            let verified = verifier.verify(&message, None).ok()?;
            let content = verified.payload(bytes);
            let payload = match is_refusal {
                true => Err(QueryRefused(String::from_utf8_lossy(&content).into_owned())),
                false => Ok(content),
            };
            Some(Reply { payload, attachment: Bytes::new(), author: verified.author, ..reply })
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
                let attachment = match scope_to_sign(self.verifier.suffix(key)) {
                    Some(_) => self.sign_request(number, key, &content)?,
                    None => encode_requester(keyring.fingerprint(), number),
                };
                let query = content.payload.clone();
                (MessageContent { attachment: attachment.into(), ..content }, Some((number, Some(query))))
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
    query_key: String,
    keyring: Arc<Keyring>,
    kind: MessageKind,
    /// Payload of the query, if the reply carries a detached signature.
    query_payload: Option<Bytes>,
}

impl SigningReplier {
    /// Returns the query with a replier that signs.
    fn wrap(query: Query, keyring: &Arc<Keyring>, kind: MessageKind, query_payload: Option<Bytes>) -> Query {
        let (replier, query_key, keyring) = (query.replier, query.key.clone(), Arc::clone(keyring));
        Query { replier: Box::new(SigningReplier { replier, query_key, keyring, kind, query_payload }), ..query }
    }
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
        if self.query_payload.is_some() {
            // Stock clients read plain text. Nodes and commands ignore it.
            return self.replier.refuse(reason).await;
        }
        let (kind, number) = (self.kind.as_refusal(), self.keyring.next_number());
        // A reply has a key of its own, also to a query of all nodes (`wire/bid/*`).
        let key = self.query_key.replace('*', self.keyring.identity().principal.name());
        let payload = self.keyring.sign_envelope(kind, number, &key, reason.as_bytes());
        self.replier.reply_with_attachment(&key, payload.into(), Bytes::new(), Encoding::Wire).await
    }
}
