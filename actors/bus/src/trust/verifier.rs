//! Verification of received messages: signature, authorization, freshness.

use super::certificates::CertificateExchange;
use super::executed_requests::ExecutedRequests;
use super::keyring::{CertificateError, Keyring, VerifiedCertificate};
use super::rejections::RejectionLog;
use crate::author::Author;
use crate::clock::Clock;
use bytes::Bytes;
use consort_protocol::access::{AccessDenied, Operation, authorize};
use consort_protocol::keys::Keys;
use consort_protocol::trust::{
    EnvelopeError, Fingerprint, Freshness, MessageKind, Principal, ReplayWindow, SignedEnvelope, decode_envelope,
    signed_attachment, signed_part,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A received message.
pub(super) struct ReceivedMessage<'a> {
    pub(super) kind: MessageKind,
    pub(super) operation: Operation,
    pub(super) key: &'a str,
    pub(super) bytes: &'a Bytes,
    /// Detached signature, if the key uses attachments.
    pub(super) detached: Option<DetachedSignature<'a>>,
}

/// A detached signature.
pub(super) struct DetachedSignature<'a> {
    pub(super) signature: &'a [u8],
    /// Payload of the query that the message replies to.
    pub(super) query: &'a [u8],
}

/// A verified message.
pub(super) struct VerifiedMessage {
    pub(super) author: Author,
    pub(super) signer: Fingerprint,
    pub(super) number: u64,
    length: usize,
}

impl VerifiedMessage {
    /// Returns the message itself, which is at the end of the received bytes.
    pub(super) fn payload(&self, bytes: &Bytes) -> Bytes {
        bytes.slice(bytes.len() - self.length..)
    }
}

/// A received message is dropped.
#[derive(Debug, thiserror::Error)]
pub(super) enum MessageRejected {
    /// The message has no valid envelope.
    #[error("message on {key} rejected: {problem}")]
    Envelope { key: String, problem: EnvelopeError },
    /// The attached certificate is invalid.
    #[error("message on {key} rejected: invalid certificate: {problem}")]
    InvalidCertificate { key: String, problem: CertificateError },
    /// The attached certificate is not the signer's.
    #[error("message on {key} rejected: the attached certificate belongs to {principal}, not to the signer")]
    ForeignCertificate { key: String, principal: Principal },
    /// Common after a start: the certificate is being queried.
    #[error("certificate {0} is not yet known to this node; retry")]
    UnknownCertificate(Fingerprint),
    /// The message was changed, or signed with another key.
    #[error("message on {key} rejected: the signature is not by {principal}")]
    Signature { key: String, principal: Principal },
    /// The author may not send this message.
    #[error(transparent)]
    Denied(#[from] AccessDenied),
    /// Common: links may deliver a message twice.
    #[error("the message was received before")]
    Repeated,
    /// The message was replayed, or its author's clock was set back.
    #[error(
        "message on {key} rejected: it is older than earlier messages of {principal}; it was replayed, or the clock of {principal} was set back"
    )]
    Outdated { key: String, principal: Principal },
}

impl MessageRejected {
    /// Checks whether the rejection shows an error or an attack.
    fn is_suspicious(&self) -> bool {
        !matches!(self, MessageRejected::UnknownCertificate(_) | MessageRejected::Repeated)
    }
}

/// Replay windows per author, for a single subscription or service.
pub(super) type Windows = BTreeMap<Fingerprint, ReplayWindow>;

/// State for verifying messages.
pub(super) struct Verifier {
    pub(super) keys: Keys,
    pub(super) keyring: Arc<Keyring>,
    pub(super) certificates: Arc<CertificateExchange>,
    pub(super) rejections: Arc<RejectionLog>,
    pub(super) clock: Clock,
    pub(super) executed_requests: ExecutedRequests,
}

impl Verifier {
    /// Verifies the signature and the authorization of a received message and, unless it is a
    /// reply, that it is new. Records suspicious rejections.
    pub(super) fn verify(
        &self,
        message: &ReceivedMessage<'_>,
        windows: Option<&mut Windows>,
    ) -> Result<VerifiedMessage, MessageRejected> {
        let verified = self.check(message, windows);
        if let Err(rejected) = &verified
            && rejected.is_suspicious()
        {
            self.rejections.record(rejected.to_string());
        }
        verified
    }

    /// Records the rejection of an unsigned message.
    pub(super) fn reject_unsigned(&self, key: &str) {
        let rejected = MessageRejected::Envelope { key: self.suffix(key).to_owned(), problem: EnvelopeError::Unsigned };
        self.rejections.record(rejected.to_string());
    }

    /// Returns the part of a key after the fleet's prefix.
    pub(super) fn suffix<'a>(&self, key: &'a str) -> &'a str {
        self.keys.strip_fleet(key).unwrap_or(key)
    }

    fn check(
        &self,
        message: &ReceivedMessage<'_>,
        windows: Option<&mut Windows>,
    ) -> Result<VerifiedMessage, MessageRejected> {
        let ReceivedMessage { kind, operation, key, bytes, detached } = message;
        let suffix = self.suffix(key);
        let owned_suffix = || suffix.to_owned();
        let envelope = decode_envelope(*kind, detached.as_ref().map_or(bytes, |detached| detached.signature))
            .map_err(|problem| MessageRejected::Envelope { key: owned_suffix(), problem })?;
        let (payload, signed) = match detached {
            None => (envelope.payload, signed_part(*kind, envelope.signer, envelope.number, key, envelope.payload)),
            Some(detached) => {
                let signed = signed_attachment(*kind, envelope.signer, envelope.number, key, detached.query, bytes);
                (&bytes[..], signed)
            }
        };
        let attached = detached.is_some().then_some(envelope.payload);
        let certificate = self.certificate(&envelope, attached, suffix)?;
        let principal = || certificate.identity.principal.clone();
        if !certificate.verify(&signed, envelope.signature) {
            return Err(MessageRejected::Signature { key: owned_suffix(), principal: principal() });
        }
        authorize(&certificate.identity, *operation, suffix, payload)?;
        if let Some(windows) = windows {
            match windows.entry(envelope.signer).or_default().accept(envelope.number) {
                Freshness::New => {}
                Freshness::Repeated => return Err(MessageRejected::Repeated),
                Freshness::Old => {
                    return Err(MessageRejected::Outdated { key: owned_suffix(), principal: principal() });
                }
            }
        }
        let author = Author::verified(Arc::clone(&certificate.identity));
        Ok(VerifiedMessage { author, signer: envelope.signer, number: envelope.number, length: payload.len() })
    }

    /// Returns the certificate of a message's signer: known, or attached to the message. An unknown
    /// certificate is queried.
    fn certificate(
        &self,
        envelope: &SignedEnvelope<'_>,
        attached: Option<&[u8]>,
        key: &str,
    ) -> Result<Arc<VerifiedCertificate>, MessageRejected> {
        if let Some(certificate) = self.keyring.certificate(envelope.signer) {
            return Ok(certificate);
        }
        let Some(attached) = attached else {
            self.certificates.request(envelope.signer);
            return Err(MessageRejected::UnknownCertificate(envelope.signer));
        };
        let certificate = self
            .keyring
            .add_certificate(attached, self.clock.unix_time())
            .map_err(|problem| MessageRejected::InvalidCertificate { key: key.to_owned(), problem })?;
        if certificate.fingerprint() != envelope.signer {
            let principal = certificate.identity.principal.clone();
            return Err(MessageRejected::ForeignCertificate { key: key.to_owned(), principal });
        }
        Ok(certificate)
    }
}
