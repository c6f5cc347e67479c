//! Verification of requests that change the fleet: the person on whose behalf they are made.

use super::executed_requests::NotAccepted;
use super::keyring::CertificateError;
use super::token::TokenError;
use super::verifier::Verifier;
use crate::bus::{Query, RequestAuthor, RequestAuthority, Requester};
use consort_protocol::api::ErrorReply;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::PersonId;
use consort_protocol::trust::{
    AccessScope, EnvelopeError, Identity, MessageKind, NodeRole, Principal, REQUEST_SKEW_MAX_MS, RequestProof,
    decode_envelope, signed_request,
};
use std::sync::Arc;

/// Suggested delay before a retry, in milliseconds.
const RETRY_AFTER_MS: u64 = 1000;

/// A request is not executed.
#[derive(Debug, thiserror::Error)]
pub(super) enum RequestRejected {
    /// Stock Zenoh clients sign nothing.
    #[error(
        "{problem}: this fleet is closed, and a request that changes it is signed by a person: use `consort --certs DIR`, or the HTTP API with a token"
    )]
    Unsigned { problem: EnvelopeError },
    #[error("its signature cannot be decoded: {0}")]
    Malformed(#[from] CodecError),
    #[error("invalid certificate: {0}")]
    Certificate(#[from] CertificateError),
    #[error("the attached certificate belongs to {0}, not to the signer")]
    ForeignCertificate(Principal),
    #[error("the signature is not by {0}")]
    Signature(Principal),
    #[error(
        "it was signed {seconds} s {direction} by the clock of this node; {max} s are allowed: compare the clocks",
        max = REQUEST_SKEW_MAX_MS / 1000
    )]
    Time { seconds: u64, direction: &'static str },
    #[error("the certificate of {name} has scope {has}; this request needs scope {needed}")]
    Scope { name: PersonId, has: AccessScope, needed: AccessScope },
    /// Nodes make no requests of their own, but those of a driver server for its people.
    #[error("{0} may not make requests; a person signs them")]
    Node(Principal),
    #[error(
        "{0} may not forward requests of people; `consort cert node NAME --roles …,dashboard` makes a certificate that permits it"
    )]
    Forwarder(Principal),
    #[error("invalid token: {0}")]
    Token(#[from] TokenError),
    #[error(transparent)]
    NotAccepted(#[from] NotAccepted),
}

impl RequestRejected {
    /// Checks whether the request is repeated, and so is not answered again.
    fn is_repetition(&self) -> bool {
        matches!(self, RequestRejected::NotAccepted(NotAccepted::Repeated))
    }

    /// Returns the reply. Another node, or the same node later, may accept what depends on clocks
    /// and on lists of revoked certificates.
    fn reply(&self) -> ErrorReply {
        match self {
            RequestRejected::Certificate(_)
            | RequestRejected::Time { .. }
            | RequestRejected::Token(_)
            | RequestRejected::NotAccepted(NotAccepted::Full) => {
                ErrorReply::retry_after(self.to_string(), RETRY_AFTER_MS)
            }
            _ => ErrorReply::rejected(self.to_string()),
        }
    }
}

impl Verifier {
    /// Verifies a request that needs this scope: the signature, its time, the person and that it is
    /// new. Records rejections. Returns `None` for a repetition.
    pub(super) fn verify_request(&self, query: &Query, needed: AccessScope) -> Option<RequestAuthority> {
        match self.check_request(query, needed) {
            Ok(requester) => Some(RequestAuthority::Verified(requester)),
            Err(rejected) if rejected.is_repetition() => None,
            Err(rejected) => {
                self.rejections.record(format!("request {} rejected: {rejected}", self.suffix(&query.key)));
                Some(RequestAuthority::Rejected(rejected.reply()))
            }
        }
    }

    fn check_request(&self, query: &Query, needed: AccessScope) -> Result<Requester, RequestRejected> {
        let envelope = decode_envelope(MessageKind::Query, &query.attachment)
            .map_err(|problem| RequestRejected::Unsigned { problem })?;
        let proof: RequestProof = codec::decode(envelope.payload)?;
        let now_ms = self.clock.wall_ms();
        let certificate = self.keyring.verify_certificate(&proof.certificate, self.clock.unix_time())?;
        let principal = &certificate.identity.principal;
        if certificate.fingerprint() != envelope.signer {
            return Err(RequestRejected::ForeignCertificate(principal.clone()));
        }
        let signed = signed_request(envelope.signer, envelope.number, &query.key, envelope.payload, &query.payload);
        if !certificate.verify(&signed, envelope.signature) {
            return Err(RequestRejected::Signature(principal.clone()));
        }
        check_time(proof.signed_at_ms, now_ms)?;
        let author = self.author(&certificate.identity, proof.token.as_deref(), needed)?;
        let id = (envelope.signer, envelope.number);
        let signed_at_ms = proof.signed_at_ms;
        self.executed_requests.accept(id, signed_at_ms.saturating_add(REQUEST_SKEW_MAX_MS), now_ms)?;
        Ok(Requester { author, request: format!("{}-{:x}", envelope.signer, envelope.number), signed_at_ms })
    }

    /// Returns the author of a request with this signer.
    fn author(
        &self,
        signer: &Arc<Identity>,
        token: Option<&str>,
        needed: AccessScope,
    ) -> Result<RequestAuthor, RequestRejected> {
        let principal = &signer.principal;
        let (name, has, missions, through) = match (principal, token) {
            (Principal::Person { name, scope, missions }, _) => (name.clone(), *scope, missions.clone(), None),
            (Principal::Node { name, roles, .. }, Some(token)) if roles.contains(&NodeRole::Dashboard) => {
                let claims = self.keyring.verify_forwarded_token(token, self.clock.unix_time())?;
                (claims.name, claims.scope, claims.missions, Some(name.clone()))
            }
            (Principal::Node { .. }, Some(_)) => return Err(RequestRejected::Forwarder(principal.clone())),
            (Principal::Node { .. }, None) => return Err(RequestRejected::Node(principal.clone())),
        };
        match has < needed {
            true => Err(RequestRejected::Scope { name, has, needed }),
            false => Ok(RequestAuthor { name, missions, through }),
        }
    }
}

fn check_time(signed_at_ms: u64, now_ms: u64) -> Result<(), RequestRejected> {
    let seconds = signed_at_ms.abs_diff(now_ms) / 1000;
    let direction = if signed_at_ms > now_ms { "ahead" } else { "ago" };
    match signed_at_ms.abs_diff(now_ms) > REQUEST_SKEW_MAX_MS {
        true => Err(RequestRejected::Time { seconds, direction }),
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_valid_for_five_minutes_before_and_after() {
        let ok = |signed_at_ms, now_ms| check_time(signed_at_ms, now_ms).is_ok();
        assert!(ok(0, 300_000) && ok(300_000, 0) && !ok(0, 300_001) && !ok(300_001, 0));
        let text = check_time(0, 400_000).unwrap_err().to_string();
        assert_eq!(text, "it was signed 400 s ago by the clock of this node; 300 s are allowed: compare the clocks");
    }
}
