//! A bus on which every message of a node carries its author's signature.

use super::certificates::{CertificateExchange, unix_time};
use super::keyring::{Keyring, VerifiedCertificate};
use super::record_signer::KeyringSigner;
use super::rejections::RejectionLog;
use crate::bus::{BusError, Encoding, Query, Replier, Reply, Sample, SharedBus, Stream};
use crate::clock::Clock;
use crate::layer::{Layer, MessageContent, refuse_in_background};
use crate::record_signer::SharedRecordSigner;
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::keys::Keys;
use consort_protocol::trust::{
    EnvelopeError, Fingerprint, Freshness, MessageKind, Operation, ReplayWindow, authorize, decode_envelope,
    decode_requester, encode_requester, signed_attachment, signed_part,
};
use std::collections::BTreeMap;
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
    keys: Keys,
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

/// State for verifying messages.
struct Verifier {
    keyring: Arc<Keyring>,
    certificates: Arc<CertificateExchange>,
    rejections: Arc<RejectionLog>,
    clock: Clock,
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
        let (inner, ring, log) = (Arc::clone(&bus), Arc::clone(&keyring), Arc::clone(&rejections));
        let certificates = Arc::new(CertificateExchange::open(inner, keys.clone(), ring, revoked, clock, log).await?);
        Ok(SigningBus { bus, keys, verifier: Arc::new(Verifier { keyring, certificates, rejections, clock }) })
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
        match self.keys.strip_fleet(key).and_then(|suffix| suffix.split_once('/')) {
            Some(("wire", rest)) if rest.starts_with("certificate/") => SignaturePlace::Absent,
            Some(("wire", _)) => SignaturePlace::Envelope,
            Some(("view" | "seen" | "api" | "events", _)) => SignaturePlace::Attachment,
            _ => SignaturePlace::Absent,
        }
    }

    fn samples(&self, samples: Stream<Sample>, place: SignaturePlace) -> Stream<Sample> {
        let (verifier, keys, mut windows) = (Arc::clone(&self.verifier), self.keys.clone(), Windows::default());
        samples.filter_map(move |sample| {
            let message = ReceivedMessage {
                kind: MessageKind::Publication,
                key: &sample.key,
                bytes: &sample.payload,
                detached: (place == SignaturePlace::Attachment)
                    .then_some(DetachedSignature { signature: &sample.attachment, query: &[] }),
            };
            let verified = verifier.verify(&keys, Operation::Publish, message, Some(&mut windows)).ok()?;
            let payload = verified.payload(&sample.payload);
            Some(Sample { payload, attachment: Bytes::new(), ..sample })
        })
    }

    /// Verifies queries between nodes, and signs the replies to them.
    fn sign_replies_to_nodes(&self, queries: Stream<Query>) -> Stream<Query> {
        let (verifier, keys, mut windows) = (Arc::clone(&self.verifier), self.keys.clone(), Windows::default());
        queries.filter_map(move |query| {
            let message =
                ReceivedMessage { kind: MessageKind::Query, key: &query.key, bytes: &query.payload, detached: None };
            match verifier.verify(&keys, Operation::Query, message, Some(&mut windows)) {
                Ok(verified) => {
                    let payload = verified.payload(&query.payload);
                    let kind = MessageKind::Reply(verified.signer, verified.number);
                    let keyring = Arc::clone(&verifier.keyring);
                    let replier =
                        Box::new(SigningReplier { replier: query.replier, keyring, kind, query_payload: None });
                    Some(Query { payload, replier, ..query })
                }
                Err(reason) => {
                    refuse_in_background(query, reason);
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
        let (verifier, keys) = (Arc::clone(&self.verifier), self.keys.clone());
        let kind = MessageKind::Reply(self.verifier.keyring.fingerprint(), number);
        replies.filter_map(move |reply| {
            let detached = query.as_ref().map(|query| DetachedSignature { signature: &reply.attachment, query });
            let bytes = match &reply.payload {
                Ok(bytes) => bytes,
                // Nodes of this fleet refuse with signed JSON.
                Err(_) if detached.is_some() => return verifier.reject_unsigned(&keys, &reply.key),
                Err(_) => return Some(reply),
            };
            let message = ReceivedMessage { kind, key: &reply.key, bytes, detached };
            let verified = verifier.verify(&keys, Operation::Reply, message, None).ok()?;
            let payload = Ok(verified.payload(bytes));
            Some(Reply { payload, attachment: Bytes::new(), ..reply })
        })
    }
}

/// A received message.
struct ReceivedMessage<'a> {
    kind: MessageKind,
    key: &'a str,
    bytes: &'a Bytes,
    /// Detached signature, if the key uses attachments.
    detached: Option<DetachedSignature<'a>>,
}

/// A detached signature.
struct DetachedSignature<'a> {
    signature: &'a [u8],
    /// Payload of the query that the message replies to.
    query: &'a [u8],
}

/// A verified message.
struct VerifiedMessage {
    signer: Fingerprint,
    number: u64,
    length: usize,
}

impl VerifiedMessage {
    /// Returns the message itself, which is at the end of the received bytes.
    fn payload(&self, bytes: &Bytes) -> Bytes {
        bytes.slice(bytes.len() - self.length..)
    }
}

/// Replay windows per author, for a single subscription or service.
type Windows = BTreeMap<Fingerprint, ReplayWindow>;

impl Verifier {
    /// Verifies the signature and the authorization of a received message and, unless it is a
    /// reply, that it is new.
    fn verify(
        &self,
        keys: &Keys,
        operation: Operation,
        message: ReceivedMessage<'_>,
        windows: Option<&mut Windows>,
    ) -> Result<VerifiedMessage, String> {
        let ReceivedMessage { kind, key, bytes, detached } = message;
        let suffix = keys.strip_fleet(key).unwrap_or(key);
        let envelope = match decode_envelope(kind, detached.as_ref().map_or(bytes, |detached| detached.signature)) {
            Ok(envelope) => envelope,
            Err(problem) => return self.refuse(format!("message on {suffix} rejected: {problem}")),
        };
        let (payload, signed, attached) = match &detached {
            None => {
                (envelope.payload, signed_part(kind, envelope.signer, envelope.number, key, envelope.payload), None)
            }
            Some(detached) => {
                let signed = signed_attachment(kind, envelope.signer, envelope.number, key, detached.query, bytes);
                (&bytes[..], signed, Some(envelope.payload))
            }
        };
        let certificate = match (self.keyring.certificate(envelope.signer), attached) {
            (Some(certificate), _) => certificate,
            (None, Some(certificate)) => match self.keyring.add_certificate(certificate, unix_time(self.clock)) {
                Ok(certificate) if certificate.fingerprint() == envelope.signer => certificate,
                Ok(certificate) => {
                    let principal = &certificate.identity.principal;
                    return self.refuse(format!("message on {suffix} rejected: the attached certificate belongs to {principal}, not to the signer"));
                }
                Err(problem) => {
                    return self.refuse(format!("message on {suffix} rejected: invalid certificate: {problem}"));
                }
            },
            (None, None) => {
                self.certificates.request(envelope.signer);
                return Err(format!("certificate {} is not yet known to this node; retry", envelope.signer));
            }
        };
        if !certificate.verify(&signed, envelope.signature) {
            return self.refuse(format!(
                "message on {suffix} rejected: the signature is not by {}",
                certificate.identity.principal
            ));
        }
        if let Err(denied) = authorize(&certificate.identity, operation, suffix, payload) {
            return self.refuse(denied.to_string());
        }
        if let Some(windows) = windows {
            match windows.entry(envelope.signer).or_default().accept(envelope.number) {
                Freshness::New => {}
                Freshness::Repeated => return Err("the message was received before".to_owned()),
                Freshness::Old => return self.refuse(outdated(&certificate, suffix)),
            }
        }
        Ok(VerifiedMessage { signer: envelope.signer, number: envelope.number, length: payload.len() })
    }

    /// Records a rejection.
    fn refuse<T>(&self, reason: String) -> Result<T, String> {
        self.rejections.record(reason.clone());
        Err(reason)
    }

    /// Records the rejection of an unsigned message.
    fn reject_unsigned<T>(&self, keys: &Keys, key: &str) -> Option<T> {
        let suffix = keys.strip_fleet(key).unwrap_or(key);
        self.refuse(format!("message on {suffix} rejected: {}", EnvelopeError::Unsigned)).ok()
    }
}

fn outdated(certificate: &VerifiedCertificate, suffix: &str) -> String {
    let principal = &certificate.identity.principal;
    format!(
        "message on {suffix} rejected: it is older than earlier messages of {principal}; it was replayed, or the clock of {principal} was set back"
    )
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
