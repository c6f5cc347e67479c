//! Files of certificates and keys: PEM, as written by `consort cert` and readable by common tools.

use super::issue::IssuedCertificate;
use super::keyring::{Authority, CertificateError, Keyring, VerifiedCertificate};
use consort_protocol::ids::FleetId;
use consort_protocol::trust::Identity;
use pki_types::pem::PemObject;
use pki_types::{CertificateDer, CertificateRevocationListDer, PrivatePkcs8KeyDer};
use ring::error::KeyRejected;
use ring::signature::Ed25519KeyPair;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// An issued certificate and its key make no keyring.
#[derive(Debug, thiserror::Error)]
pub enum KeyringError {
    /// A text is no PEM of the expected kind.
    #[error(transparent)]
    Pem(#[from] pki_types::pem::Error),
    /// The authority did not sign the certificate, or it is not valid now.
    #[error(transparent)]
    Certificate(#[from] CertificateError),
    /// The key cannot be used.
    #[error(transparent)]
    Key(#[from] KeyError),
}

/// A private key cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The key has another algorithm or form.
    #[error("not an Ed25519 key: {0}")]
    NotEd25519(KeyRejected),
    /// The certificate was issued for another key.
    #[error("the key does not belong to {of}")]
    Foreign {
        /// File of the certificate.
        of: String,
    },
}

/// Paths of the certificates and the key of a node or a person.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TrustFiles {
    /// Certificate of the fleet's authority.
    pub authority: PathBuf,
    /// Certificate of the principal.
    pub certificate: PathBuf,
    /// Private key of the certificate, in PKCS #8. Every reader of this file can act as the
    /// principal.
    pub key: PathBuf,
    /// List of revoked certificates, if any. It is read again while the node runs.
    pub revoked: Option<PathBuf>,
}

/// A file cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}: {problem}", file.display())]
pub struct TrustError {
    /// The file.
    pub file: PathBuf,
    /// Reason.
    pub problem: String,
}

impl TrustError {
    pub(super) fn of<E: Display>(file: &Path) -> impl Fn(E) -> TrustError {
        move |problem| TrustError { file: file.to_owned(), problem: problem.to_string() }
    }
}

impl TrustFiles {
    /// Reads all files and checks their consistency: the authority signed the certificate, for this
    /// fleet and valid now (`now` in time since 1970), and the key belongs to the certificate. For
    /// `incarnation` see [`Keyring`].
    ///
    /// # Errors
    /// [`TrustError`] names the file and the reason.
    pub fn open(&self, fleet: &FleetId, now: Duration, incarnation: u64) -> Result<Keyring, TrustError> {
        let authority = read_pem::<CertificateDer<'static>>(&self.authority, "certificate")?;
        let authority = Authority::new(fleet.clone(), &authority).map_err(TrustError::of(&self.authority))?;
        let revoked = self.read_revoked()?;
        let certificate = read_pem::<CertificateDer<'static>>(&self.certificate, "certificate")?;
        let own = authority.verify(certificate, revoked.as_deref(), now).map_err(TrustError::of(&self.certificate))?;
        let key = read_pem::<PrivatePkcs8KeyDer<'static>>(&self.key, "private key in PKCS #8")?;
        let of = self.certificate.display().to_string();
        let key = key_of(&own, &key, &of).map_err(TrustError::of(&self.key))?;
        Ok(Keyring::new(authority, own, key, revoked, incarnation))
    }

    /// Returns the identity in the certificate, if the files are consistent.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn identity(&self, fleet: &FleetId, now: Duration) -> Result<Identity, TrustError> {
        self.open(fleet, now, 0).map(|keyring| keyring.identity().clone())
    }

    fn read_revoked(&self) -> Result<Option<Vec<u8>>, TrustError> {
        self.revoked.as_deref().map(read_revoked).transpose()
    }
}

/// Reads the list of revoked certificates, in DER.
pub(super) fn read_revoked(file: &Path) -> Result<Vec<u8>, TrustError> {
    let list = read_pem::<CertificateRevocationListDer<'static>>(file, "list of revoked certificates")?;
    Ok(list.to_vec())
}

impl Keyring {
    /// Creates a keyring from an issued certificate and key that are stored in no file. For
    /// `incarnation` see [`TrustFiles::open`].
    ///
    /// # Errors
    /// [`KeyringError`] states the reason.
    pub fn from_issued(
        fleet: FleetId,
        authority: &str,
        issued: &IssuedCertificate,
        now: Duration,
        incarnation: u64,
    ) -> Result<Keyring, KeyringError> {
        let authority = CertificateDer::from_pem_slice(authority.as_bytes())?;
        let authority = Authority::new(fleet, &authority)?;
        let own = authority.verify(CertificateDer::from_pem_slice(issued.certificate.as_bytes())?, None, now)?;
        let key = PrivatePkcs8KeyDer::from_pem_slice(issued.key.as_bytes())?;
        let key = key_of(&own, &key, "the certificate")?;
        Ok(Keyring::new(authority, own, key, None, incarnation))
    }
}

/// Parses a key, and checks that it belongs to the certificate.
fn key_of(own: &VerifiedCertificate, key: &PrivatePkcs8KeyDer<'_>, of: &str) -> Result<Ed25519KeyPair, KeyError> {
    let key = Ed25519KeyPair::from_pkcs8_maybe_unchecked(key.secret_pkcs8_der()).map_err(KeyError::NotEd25519)?;
    match own.verify(b"proof of possession", key.sign(b"proof of possession").as_ref()) {
        true => Ok(key),
        false => Err(KeyError::Foreign { of: of.to_owned() }),
    }
}

pub(super) fn read_pem<T: PemObject>(file: &Path, what: &str) -> Result<T, TrustError> {
    let text = std::fs::read(file).map_err(TrustError::of(file))?;
    T::from_pem_slice(&text).map_err(|problem| TrustError::of(file)(format!("no {what} found: {problem}")))
}
