//! Keys and certificates: the fleet's authority, a node's own, and those that were shown to it.

use consort_protocol::ids::FleetId;
use consort_protocol::trust::{
    Fingerprint, Identity, MessageKind, SignedEnvelope, encode_envelope, signed_attachment, signed_part,
};
use pki_types::{CertificateDer, TrustAnchor, UnixTime};
use ring::digest::{SHA256, digest};
use ring::signature::Ed25519KeyPair;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;
use webpki::ring::ED25519;
use webpki::{
    BorrowedCertRevocationList, CertRevocationList, EndEntityCert, KeyUsage, RevocationOptionsBuilder,
    UnknownStatusPolicy, anchor_from_trusted_cert,
};

/// How many others' certificates are remembered: a fleet of thousands. Beyond that they are asked for again.
const REMEMBERED: usize = 4096;

/// Somebody's certificate, which the fleet's authority has signed.
#[derive(Debug)]
pub struct VerifiedCertificate {
    /// Whose it is.
    pub identity: Identity,
    fingerprint: Fingerprint,
    certificate: CertificateDer<'static>,
}

/// Why a certificate is not believed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CertificateError {
    /// It is none, or none of this fleet's authority, or not valid now.
    #[error("{0}")]
    Invalid(String),
    /// The authority has withdrawn it.
    #[error("it has been revoked")]
    Revoked,
    /// It does not say whose it is.
    #[error("it does not say whose it is: {0}")]
    NoIdentity(String),
    /// The authority signs for several fleets, and this is another's.
    #[error("it is for fleet {other}, where this is {own}")]
    OtherFleet {
        /// Its fleet.
        other: FleetId,
        /// This fleet.
        own: FleetId,
    },
}

impl VerifiedCertificate {
    /// The fingerprint of its certificate.
    pub fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    /// Whether its bearer signed this.
    pub fn verify(&self, message: &[u8], signature: &[u8]) -> bool {
        let certificate = EndEntityCert::try_from(&self.certificate);
        certificate.is_ok_and(|certificate| certificate.verify_signature(ED25519, message, signature).is_ok())
    }
}

/// The first half of the SHA-256 of a certificate.
fn fingerprint(certificate: &CertificateDer<'_>) -> Fingerprint {
    let hash = digest(&SHA256, certificate);
    let half = hash.as_ref().first_chunk().expect("a SHA-256 has 32 bytes");
    Fingerprint(*half)
}

/// What certificates are judged by.
#[derive(Debug)]
pub(super) struct Authority {
    pub(super) fleet: FleetId,
    anchor: TrustAnchor<'static>,
}

impl Authority {
    /// The authority of a fleet, by its own certificate.
    pub(super) fn new(fleet: FleetId, certificate: &CertificateDer<'_>) -> Result<Authority, CertificateError> {
        let anchor =
            anchor_from_trusted_cert(certificate).map_err(|problem| CertificateError::Invalid(problem.to_string()))?;
        Ok(Authority { fleet, anchor: anchor.to_owned() })
    }

    /// Judges the certificate of somebody who speaks, at an instant in time since 1970.
    pub(super) fn verify(
        &self,
        certificate: CertificateDer<'static>,
        revoked: Option<&[u8]>,
        now: Duration,
    ) -> Result<VerifiedCertificate, CertificateError> {
        self.judge_as(KeyUsage::client_auth(), certificate, revoked, now)
    }

    /// The same of somebody to whom a link is opened: a node.
    pub(super) fn verify_server(
        &self,
        certificate: CertificateDer<'static>,
        now: Duration,
    ) -> Result<VerifiedCertificate, CertificateError> {
        self.judge_as(KeyUsage::server_auth(), certificate, None, now)
    }

    fn judge_as(
        &self,
        usage: KeyUsage,
        certificate: CertificateDer<'static>,
        revoked: Option<&[u8]>,
        now: Duration,
    ) -> Result<VerifiedCertificate, CertificateError> {
        let refused = |problem: webpki::Error| match problem {
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
                CertificateError::Invalid(format!("it is valid only in {}: is the clock right?", format_span(ahead)))
            }
            other => CertificateError::Invalid(format!("it is no certificate for a node: {other}")),
        };
        let list = match revoked {
            Some(bytes) => {
                let list = BorrowedCertRevocationList::from_der(bytes).and_then(|list| list.to_owned());
                Some(CertRevocationList::from(list.map_err(|problem| {
                    CertificateError::Invalid(format!("the list of revoked certificates cannot be read: {problem}"))
                })?))
            }
            None => None,
        };
        let lists: Vec<&CertRevocationList<'_>> = list.iter().collect();
        let revocation = RevocationOptionsBuilder::new(&lists).ok();
        let revocation = revocation.map(|options| options.with_status_policy(UnknownStatusPolicy::Allow).build());
        let identity = {
            let read = EndEntityCert::try_from(&certificate).map_err(refused)?;
            let anchors = [self.anchor.clone()];
            let at = UnixTime::since_unix_epoch(now);
            read.verify_for_usage(&[ED25519], &anchors, &[], at, usage, revocation, None).map_err(refused)?;
            whose(&read)?
        };
        if identity.fleet != self.fleet {
            return Err(CertificateError::OtherFleet { other: identity.fleet, own: self.fleet.clone() });
        }
        Ok(VerifiedCertificate { identity, fingerprint: fingerprint(&certificate), certificate })
    }
}

/// Whose certificate it is, as it says itself.
fn whose(certificate: &EndEntityCert<'_>) -> Result<Identity, CertificateError> {
    let mut names = certificate.valid_uri_names();
    let Some(name) = names.find(|name| name.starts_with("consort://")) else {
        return Err(CertificateError::NoIdentity("there is no name of the form consort://… in it".to_owned()));
    };
    name.parse()
        .map_err(|problem: consort_protocol::trust::IdentityError| CertificateError::NoIdentity(problem.to_string()))
}

/// A span of seconds, roughly.
pub(super) fn format_span(seconds: u64) -> String {
    match seconds {
        0..120 => format!("{seconds} s"),
        120..7200 => format!("{} min", seconds / 60),
        7200..172_800 => format!("{} h", seconds / 3600),
        _ => format!("{} days", seconds / 86_400),
    }
}

/// What a node proves itself with, and whom it believes. Shared by all that the node says and hears.
pub struct Keyring {
    authority: Authority,
    own: Arc<VerifiedCertificate>,
    key: Ed25519KeyPair,
    numbers: AtomicU64,
    learned: RwLock<Learned>,
}

#[derive(Default)]
struct Learned {
    /// DER of the list of revoked certificates.
    revoked: Option<Vec<u8>>,
    cards: BTreeMap<Fingerprint, Arc<VerifiedCertificate>>,
}

impl Keyring {
    /// A keyring; `own` and `key` belong together. `life` is larger than in any former life of the bearer, in milliseconds:
    /// numbers of messages begin there.
    pub(super) fn new(
        authority: Authority,
        own: VerifiedCertificate,
        key: Ed25519KeyPair,
        revoked: Option<Vec<u8>>,
        life: u64,
    ) -> Keyring {
        let learned = RwLock::new(Learned { revoked, cards: BTreeMap::new() });
        Keyring { authority, own: Arc::new(own), key, numbers: AtomicU64::new(life << 20), learned }
    }

    /// Whose keyring it is.
    pub fn identity(&self) -> &Identity {
        &self.own.identity
    }

    /// The fingerprint of its own certificate.
    pub fn fingerprint(&self) -> Fingerprint {
        self.own.fingerprint()
    }

    /// Its own certificate, to be shown.
    pub(super) fn own_certificate(&self) -> Vec<u8> {
        self.own.certificate.to_vec()
    }

    /// The number of the next message.
    pub fn next_number(&self) -> u64 {
        self.numbers.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// A message sealed by the bearer.
    pub fn sign_envelope(&self, kind: MessageKind, number: u64, key: &str, payload: &[u8]) -> Vec<u8> {
        let by = self.fingerprint();
        let signature = self.key.sign(&signed_part(kind, by, number, key, payload));
        encode_envelope(kind, SignedEnvelope { signer: by, number, signature: signature.as_ref(), payload })
    }

    /// The bearer's seal of a message, to stand beside it, with its certificate; `asked` is the question that it answers.
    pub(super) fn sign_detached(&self, kind: MessageKind, key: &str, asked: &[u8], payload: &[u8]) -> Vec<u8> {
        let (by, number) = (self.fingerprint(), self.next_number());
        let signature = self.key.sign(&signed_attachment(kind, by, number, key, asked, payload));
        encode_envelope(
            kind,
            SignedEnvelope { signer: by, number, signature: signature.as_ref(), payload: &self.own.certificate },
        )
    }

    /// The bearer's signature.
    pub(super) fn sign(&self, message: &[u8]) -> Vec<u8> {
        self.key.sign(message).as_ref().to_vec()
    }

    /// Judges a certificate that is shown once, and does not remember it.
    pub(super) fn verify_certificate(
        &self,
        certificate: &[u8],
        now: Duration,
    ) -> Result<VerifiedCertificate, CertificateError> {
        let certificate = CertificateDer::from(certificate.to_vec());
        let learned = self.learned.read().unwrap_or_else(PoisonError::into_inner);
        self.authority.verify(certificate, learned.revoked.as_deref(), now)
    }

    /// Whose certificate it is, if it has been revoked.
    pub(super) fn revoked_identity(&self, certificate: &[u8], now: Duration) -> Option<Identity> {
        match self.verify_certificate(certificate, now) {
            Err(CertificateError::Revoked) => {
                whose(&EndEntityCert::try_from(&CertificateDer::from(certificate)).ok()?).ok()
            }
            _ => None,
        }
    }

    /// The card of a fingerprint, if it has been shown.
    pub fn certificate(&self, of: Fingerprint) -> Option<Arc<VerifiedCertificate>> {
        if of == self.fingerprint() {
            return Some(Arc::clone(&self.own));
        }
        self.learned.read().unwrap_or_else(PoisonError::into_inner).cards.get(&of).cloned()
    }

    /// Takes in a certificate that was shown.
    ///
    /// # Errors
    /// [`Distrust`]: it is not believed, and nothing is remembered.
    pub fn add_certificate(
        &self,
        certificate: &[u8],
        now: Duration,
    ) -> Result<Arc<VerifiedCertificate>, CertificateError> {
        let certificate = CertificateDer::from(certificate.to_vec());
        let mut learned = self.learned.write().unwrap_or_else(PoisonError::into_inner);
        let card = Arc::new(self.authority.verify(certificate, learned.revoked.as_deref(), now)?);
        if learned.cards.len() >= REMEMBERED {
            learned.cards.clear();
        }
        learned.cards.insert(card.fingerprint(), Arc::clone(&card));
        Ok(card)
    }

    /// Judges everybody anew, by what is revoked now and at this time; returns who is no longer believed, and why.
    pub fn recheck(&self, revoked: Option<Vec<u8>>, now: Duration) -> Vec<(Identity, CertificateError)> {
        let mut learned = self.learned.write().unwrap_or_else(PoisonError::into_inner);
        if revoked.is_some() {
            learned.revoked = revoked;
        }
        let Learned { revoked, cards } = &mut *learned;
        let mut lost = Vec::new();
        cards.retain(|_, card| match self.authority.verify(card.certificate.clone(), revoked.as_deref(), now) {
            Ok(_) => true,
            Err(problem) => {
                lost.push((card.identity.clone(), problem));
                false
            }
        });
        lost
    }
}
