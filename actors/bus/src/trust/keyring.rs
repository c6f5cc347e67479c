//! Keys and certificates: the fleet's authority, a node's own certificate and key, and received
//! certificates.

use super::revocation::{RevocationList, RevocationListError};
use super::signature::{SIGNATURE, SignatureScheme};
use bytes::Bytes;
use consort_protocol::ids::FleetId;
use consort_protocol::trust::{
    Fingerprint, Identity, MessageKind, SignedEnvelope, encode_envelope, signed_attachment, signed_part, signed_request,
};
use pki_types::{CertificateDer, TrustAnchor, UnixTime};
use ring::digest::{SHA256, digest};
use ring::signature::Ed25519KeyPair;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;
use webpki::ring::ED25519;
use webpki::{
    BorrowedCertRevocationList, CertRevocationList, EndEntityCert, KeyUsage, RevocationOptionsBuilder,
    UnknownStatusPolicy, anchor_from_trusted_cert,
};
use x509_parser::prelude::{FromDer as _, X509Certificate};

/// Maximum number of stored certificates, for a fleet of thousands. Beyond that all are dropped and
/// queried again.
const CERTIFICATES_MAX: usize = 4096;

/// A certificate that the fleet's authority has signed.
#[derive(Debug)]
pub struct VerifiedCertificate {
    /// Identity in the certificate.
    pub identity: Arc<Identity>,
    fingerprint: Fingerprint,
    certificate: CertificateDer<'static>,
    /// First and last second since 1970 in which it is valid.
    valid_s: RangeInclusive<u64>,
    scheme: SignatureScheme,
}

/// A certificate is rejected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CertificateError {
    /// Malformed, not signed by this fleet's authority, or not valid now.
    #[error("{0}")]
    Invalid(String),
    /// Revoked by the authority.
    #[error("it has been revoked")]
    Revoked,
    /// Contains no identity.
    #[error("it contains no identity: {0}")]
    NoIdentity(String),
    /// Issued for another fleet by an authority that several fleets share.
    #[error("it is for fleet {other}, but this fleet is {own}")]
    OtherFleet {
        /// Fleet of the certificate.
        other: FleetId,
        /// Fleet of this node.
        own: FleetId,
    },
}

impl VerifiedCertificate {
    /// Returns the fingerprint of the certificate.
    pub fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    /// Returns the certificate.
    pub(super) fn certificate(&self) -> CertificateDer<'static> {
        self.certificate.clone()
    }

    /// Returns the certificate, in DER.
    pub(super) fn bytes(&self) -> Bytes {
        Bytes::copy_from_slice(&self.certificate)
    }

    /// Checks a signature with the key of the certificate.
    pub fn verify(&self, message: &[u8], signature: &[u8]) -> bool {
        match self.scheme {
            SignatureScheme::Ed25519 => {
                let certificate = EndEntityCert::try_from(&self.certificate);
                certificate.is_ok_and(|certificate| certificate.verify_signature(ED25519, message, signature).is_ok())
            }
            #[cfg(feature = "test-util")]
            SignatureScheme::Simulated => signature == super::signature::simulated(self.fingerprint, message),
        }
    }
}

/// Returns the first half of the SHA-256 of a certificate.
fn fingerprint(certificate: &CertificateDer<'_>) -> Fingerprint {
    let hash = digest(&SHA256, certificate);
    let half = hash.as_ref().first_chunk().expect("a SHA-256 has 32 bytes");
    Fingerprint(*half)
}

/// The authority that certificates are verified against.
#[derive(Debug)]
pub(super) struct Authority {
    pub(super) fleet: FleetId,
    anchor: TrustAnchor<'static>,
    scheme: SignatureScheme,
}

impl Authority {
    /// Creates the authority of a fleet from the authority's own certificate.
    pub(super) fn new(fleet: FleetId, certificate: &CertificateDer<'_>) -> Result<Authority, CertificateError> {
        let anchor =
            anchor_from_trusted_cert(certificate).map_err(|problem| CertificateError::Invalid(problem.to_string()))?;
        Ok(Authority { fleet, anchor: anchor.to_owned(), scheme: SignatureScheme::Ed25519 })
    }

    /// Verifies the certificate of a message's author or of a client, at a time since 1970.
    pub(super) fn verify(
        &self,
        certificate: CertificateDer<'static>,
        revoked: Option<&[u8]>,
        now: Duration,
    ) -> Result<VerifiedCertificate, CertificateError> {
        self.verify_for(KeyUsage::client_auth(), certificate, revoked, UnknownStatusPolicy::Allow, now)
    }

    /// Decodes a list of revoked certificates, and verifies that the authority signed it, with a
    /// certificate of the authority, at a time since 1970.
    pub(super) fn verify_list(
        &self,
        list: Vec<u8>,
        certificate: &VerifiedCertificate,
        now: Duration,
    ) -> Result<RevocationList, RevocationListError> {
        let list = RevocationList::decode(list)?;
        let (usage, certificate) = (KeyUsage::client_auth(), certificate.certificate.clone());
        match self.verify_for(usage, certificate, Some(list.der()), UnknownStatusPolicy::Deny, now) {
            // The list may contain this certificate.
            Ok(_) | Err(CertificateError::Revoked) => Ok(list),
            Err(problem) => Err(RevocationListError::NotSigned(problem.to_string())),
        }
    }

    /// Verifies the certificate of a node that a link is opened to.
    pub(super) fn verify_server(
        &self,
        certificate: CertificateDer<'static>,
        now: Duration,
    ) -> Result<VerifiedCertificate, CertificateError> {
        self.verify_for(KeyUsage::server_auth(), certificate, None, UnknownStatusPolicy::Allow, now)
    }

    fn verify_for(
        &self,
        usage: KeyUsage,
        certificate: CertificateDer<'static>,
        revoked: Option<&[u8]>,
        unlisted: UnknownStatusPolicy,
        now: Duration,
    ) -> Result<VerifiedCertificate, CertificateError> {
        let rejection = |problem: webpki::Error| match problem {
            webpki::Error::CertRevoked => CertificateError::Revoked,
            webpki::Error::UnknownIssuer | webpki::Error::InvalidSignatureForPublicKey => {
                CertificateError::Invalid("it was not signed by this fleet's authority".to_owned())
            }
            webpki::Error::CertExpired { time, not_after } => {
                let ago = time.as_secs().saturating_sub(not_after.as_secs());
                CertificateError::Invalid(format!("it expired {} ago", format_span(ago)))
            }
            webpki::Error::CertNotValidYet { time, not_before } => {
                let ahead = not_before.as_secs().saturating_sub(time.as_secs());
                CertificateError::Invalid(format!("it is valid only in {}; check the clock", format_span(ahead)))
            }
            webpki::Error::UnknownRevocationStatus | webpki::Error::InvalidCrlSignatureForPublicKey => {
                CertificateError::Invalid(
                    "the list of revoked certificates was not signed by this fleet's authority".to_owned(),
                )
            }
            other => CertificateError::Invalid(format!("it is not a valid certificate: {other}")),
        };
        let list = match revoked {
            Some(bytes) => {
                let list = BorrowedCertRevocationList::from_der(bytes).and_then(|list| list.to_owned());
                Some(CertRevocationList::from(list.map_err(|problem| {
                    CertificateError::Invalid(format!("the list of revoked certificates is malformed: {problem}"))
                })?))
            }
            None => None,
        };
        let lists: Vec<&CertRevocationList<'_>> = list.iter().collect();
        let revocation = RevocationOptionsBuilder::new(&lists).ok();
        let revocation = revocation.map(|options| options.with_status_policy(unlisted).build());
        let identity = {
            let read = EndEntityCert::try_from(&certificate).map_err(rejection)?;
            let anchors = [self.anchor.clone()];
            let at = UnixTime::since_unix_epoch(now);
            read.verify_for_usage(&[ED25519], &anchors, &[], at, usage, revocation, None).map_err(rejection)?;
            identity_in(&read)?
        };
        if identity.fleet != self.fleet {
            return Err(CertificateError::OtherFleet { other: identity.fleet, own: self.fleet.clone() });
        }
        Ok(VerifiedCertificate {
            identity: Arc::new(identity),
            fingerprint: fingerprint(&certificate),
            valid_s: valid_seconds(&certificate)?,
            certificate,
            scheme: self.scheme,
        })
    }
}

/// Returns the first and the last second since 1970 in which a certificate is valid.
fn valid_seconds(certificate: &CertificateDer<'_>) -> Result<RangeInclusive<u64>, CertificateError> {
    let (_, read) = X509Certificate::from_der(certificate)
        .map_err(|problem| CertificateError::Invalid(format!("it is not a valid certificate: {problem}")))?;
    let since_1970 = |timestamp: i64| u64::try_from(timestamp).unwrap_or(0);
    Ok(since_1970(read.validity().not_before.timestamp())..=since_1970(read.validity().not_after.timestamp()))
}

/// Returns the identity contained in a certificate.
fn identity_in(certificate: &EndEntityCert<'_>) -> Result<Identity, CertificateError> {
    let mut names = certificate.valid_uri_names();
    let Some(name) = names.find(|name| name.starts_with("consort://")) else {
        return Err(CertificateError::NoIdentity("it has no name of the form consort://…".to_owned()));
    };
    name.parse()
        .map_err(|problem: consort_protocol::trust::IdentityError| CertificateError::NoIdentity(problem.to_string()))
}

/// Formats a span of seconds, rounded.
pub(super) fn format_span(seconds: u64) -> String {
    match seconds {
        0..120 => format!("{seconds} s"),
        120..7200 => format!("{} min", seconds / 60),
        7200..172_800 => format!("{} h", seconds / 3600),
        _ => format!("{} days", seconds / 86_400),
    }
}

/// Key and certificate of a node, and the certificates that it accepts. Shared by everything that
/// the node sends and receives.
pub struct Keyring {
    authority: Authority,
    own: Arc<VerifiedCertificate>,
    key: Ed25519KeyPair,
    numbers: AtomicU64,
    received: RwLock<ReceivedCertificates>,
}

#[derive(Default)]
struct ReceivedCertificates {
    revoked: Option<RevocationList>,
    /// Each was verified with the list `revoked`, unless that is new.
    certificates: BTreeMap<Fingerprint, Arc<VerifiedCertificate>>,
    /// The list `revoked` has been replaced since the latest recheck.
    is_list_new: bool,
}

impl ReceivedCertificates {
    fn revoked_der(&self) -> Option<&[u8]> {
        self.revoked.as_ref().map(RevocationList::der)
    }
}

impl Keyring {
    /// Creates a keyring from a certificate and its key. `incarnation` is in milliseconds and
    /// larger than at any earlier start of the principal: message numbers begin there.
    pub(super) fn new(
        authority: Authority,
        own: VerifiedCertificate,
        key: Ed25519KeyPair,
        revoked: Option<RevocationList>,
        incarnation: u64,
    ) -> Keyring {
        let received = RwLock::new(ReceivedCertificates { revoked, ..ReceivedCertificates::default() });
        Keyring { authority, own: Arc::new(own), key, numbers: AtomicU64::new(incarnation << 20), received }
    }

    /// Replaces the signatures of the whole fleet by simulated ones, which take a hundredth of the time.
    /// Certificates are still signed by the authority.
    #[cfg(feature = "test-util")]
    #[must_use]
    pub fn with_simulated_signatures(mut self) -> Keyring {
        self.authority.scheme = SignatureScheme::Simulated;
        let VerifiedCertificate { identity, fingerprint, certificate, valid_s, .. } = &*self.own;
        self.own = Arc::new(VerifiedCertificate {
            identity: Arc::clone(identity),
            fingerprint: *fingerprint,
            certificate: certificate.clone(),
            valid_s: valid_s.clone(),
            scheme: SignatureScheme::Simulated,
        });
        self
    }

    /// Returns the identity of the keyring's principal.
    pub fn identity(&self) -> &Identity {
        &self.own.identity
    }

    /// Returns the fingerprint of its own certificate.
    pub fn fingerprint(&self) -> Fingerprint {
        self.own.fingerprint()
    }

    /// Returns its own certificate, in DER.
    pub(super) fn own_certificate(&self) -> Vec<u8> {
        self.own.certificate.to_vec()
    }

    /// Returns the number of the next message.
    pub fn next_number(&self) -> u64 {
        self.numbers.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// Signs a message and returns the envelope.
    pub fn sign_envelope(&self, kind: MessageKind, number: u64, key: &str, payload: &[u8]) -> Vec<u8> {
        let signer = self.fingerprint();
        let signature = self.sign(&signed_part(kind, signer, number, key, payload));
        encode_envelope(kind, SignedEnvelope { signer, number, signature: &signature, payload })
    }

    /// Signs a message and returns the detached signature, with the own certificate. `query` is the
    /// payload of the query that the message replies to.
    pub(super) fn sign_detached(&self, kind: MessageKind, key: &str, query: &[u8], payload: &[u8]) -> Vec<u8> {
        let (signer, number) = (self.fingerprint(), self.next_number());
        let signature = self.sign(&signed_attachment(kind, signer, number, key, query, payload));
        encode_envelope(kind, SignedEnvelope { signer, number, signature: &signature, payload: &self.own.certificate })
    }

    /// Signs a request that changes the fleet, and returns the attachment of its query. `proof` is
    /// the encoded `RequestProof`.
    pub(super) fn sign_request(&self, number: u64, key: &str, proof: &[u8], payload: &[u8]) -> Vec<u8> {
        let signer = self.fingerprint();
        let signature = self.sign(&signed_request(signer, number, key, proof, payload));
        encode_envelope(MessageKind::Query, SignedEnvelope { signer, number, signature: &signature, payload: proof })
    }

    /// Returns the principal's signature of a message.
    pub(super) fn sign(&self, message: &[u8]) -> [u8; SIGNATURE] {
        self.authority.scheme.sign(&self.key, self.fingerprint(), message)
    }

    /// Verifies a certificate without storing it.
    pub(super) fn verify_certificate(
        &self,
        certificate: &[u8],
        now: Duration,
    ) -> Result<VerifiedCertificate, CertificateError> {
        let certificate = CertificateDer::from(certificate.to_vec());
        let received = self.received.read().unwrap_or_else(PoisonError::into_inner);
        self.authority.verify(certificate, received.revoked_der(), now)
    }

    /// Returns the identity of a certificate if it is revoked.
    pub(super) fn revoked_identity(&self, certificate: &[u8], now: Duration) -> Option<Identity> {
        match self.verify_certificate(certificate, now) {
            Err(CertificateError::Revoked) => {
                identity_in(&EndEntityCert::try_from(&CertificateDer::from(certificate)).ok()?).ok()
            }
            _ => None,
        }
    }

    /// Returns the certificate with this fingerprint, if it has been received.
    pub fn certificate(&self, fingerprint: Fingerprint) -> Option<Arc<VerifiedCertificate>> {
        if fingerprint == self.fingerprint() {
            return Some(Arc::clone(&self.own));
        }
        self.received.read().unwrap_or_else(PoisonError::into_inner).certificates.get(&fingerprint).cloned()
    }

    /// Verifies and stores a received certificate.
    ///
    /// # Errors
    /// [`CertificateError`]: the certificate is rejected, and nothing is stored.
    pub fn add_certificate(
        &self,
        certificate: &[u8],
        now: Duration,
    ) -> Result<Arc<VerifiedCertificate>, CertificateError> {
        let certificate = CertificateDer::from(certificate.to_vec());
        let mut received = self.received.write().unwrap_or_else(PoisonError::into_inner);
        let certificate = Arc::new(self.authority.verify(certificate, received.revoked_der(), now)?);
        if received.certificates.len() >= CERTIFICATES_MAX {
            received.certificates.clear();
        }
        received.certificates.insert(certificate.fingerprint(), Arc::clone(&certificate));
        Ok(certificate)
    }

    /// Replaces the list of revoked certificates, in DER, by a later list.
    pub(super) fn replace_revoked(&self, der: Vec<u8>, now: Duration) -> Result<(), RevocationListError> {
        let list = self.authority.verify_list(der, &self.own, now)?;
        let mut received = self.received.write().unwrap_or_else(PoisonError::into_inner);
        list.check_replaces(received.revoked.as_ref())?;
        received.revoked = Some(list);
        received.is_list_new = true;
        Ok(())
    }

    /// Checks all stored certificates at this time, with the current list of revoked certificates. Removes and returns
    /// the certificates that are no longer valid, with the reasons. While the list is the same and a certificate is within
    /// its period, nothing else can have changed, so its signature is not verified again.
    pub(crate) fn recheck(&self, now: Duration) -> Vec<(Identity, CertificateError)> {
        let mut received = self.received.write().unwrap_or_else(PoisonError::into_inner);
        let ReceivedCertificates { revoked, certificates, is_list_new } = &mut *received;
        let (revoked, is_list_new) = (revoked.as_ref().map(RevocationList::der), std::mem::take(is_list_new));
        let mut removed = Vec::new();
        certificates.retain(|_, certificate| {
            if !is_list_new && certificate.valid_s.contains(&now.as_secs()) {
                return true;
            }
            match self.authority.verify(certificate.certificate.clone(), revoked, now) {
                Ok(_) => true,
                Err(problem) => {
                    removed.push((Identity::clone(&certificate.identity), problem));
                    false
                }
            }
        });
        removed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trust::issue::{CertificateAuthority, Validity, create_authority};
    use pki_types::CertificateRevocationListDer;
    use pki_types::pem::PemObject as _;

    const NOW: Duration = Duration::from_secs(1_750_000_000);
    const BEGAN: Duration = Duration::from_secs(1_749_999_900);

    fn valid_for(seconds: u64) -> Validity {
        Validity { from: BEGAN, until: NOW + Duration::from_secs(seconds) }
    }

    /// Returns the keyring of ada with the certificate of bob, which is valid for 100 s, and their authority.
    fn keyring_of_ada() -> (Keyring, CertificateAuthority) {
        let fleet: FleetId = "ward".parse().unwrap();
        let files = create_authority(&fleet, valid_for(100_000)).unwrap();
        let authority = CertificateAuthority::from_pem(&files.certificate, &files.key).unwrap();
        let issue = |name: &str, seconds| {
            let identity = format!("consort://ward/node/{name}?roles=robot").parse().unwrap();
            authority.issue(&identity, &[], valid_for(seconds)).unwrap()
        };
        let ada = Keyring::from_issued(fleet, &files.certificate, &issue("ada", 100_000), NOW, 1).unwrap();
        let bob = issue("bob", 100);
        ada.add_certificate(&CertificateDer::from_pem_slice(bob.certificate.as_bytes()).unwrap(), NOW).unwrap();
        (ada, authority)
    }

    /// Damages the stored bytes, so that they cannot be verified again.
    fn damage_certificates(keyring: &Keyring) {
        for certificate in keyring.received.write().unwrap().certificates.values_mut() {
            Arc::get_mut(certificate).expect("in no other use").certificate = CertificateDer::from(vec![0]);
        }
    }

    fn problems(keyring: &Keyring, now: Duration) -> Vec<String> {
        keyring.recheck(now).into_iter().map(|(_, problem)| problem.to_string()).collect()
    }

    #[test]
    fn a_signature_is_verified_again_for_a_new_list_only() {
        let (ada, authority) = keyring_of_ada();
        damage_certificates(&ada);
        assert_eq!(problems(&ada, NOW + Duration::from_secs(99)), [] as [String; 0]);
        let list = authority.revocation_list(&[], 1, valid_for(100_000)).unwrap();
        let list = CertificateRevocationListDer::from_pem_slice(list.as_bytes()).unwrap();
        ada.replace_revoked(list.to_vec(), NOW).unwrap();
        assert_eq!(problems(&ada, NOW).len(), 1);
    }

    #[test]
    fn a_certificate_outside_its_period_is_removed() {
        for (now, expected) in [
            (NOW + Duration::from_secs(102), "it expired 2 s ago"),
            (BEGAN - Duration::from_secs(3), "it is valid only in 3 s; check the clock"),
        ] {
            let (ada, _) = keyring_of_ada();
            assert_eq!(problems(&ada, NOW + Duration::from_secs(100)), [] as [String; 0], "its last second");
            assert_eq!(problems(&ada, now), [expected]);
            assert_eq!(problems(&ada, now), [] as [String; 0], "it is gone");
        }
    }
}
