//! Files of certificates and keys: PEM, as written by `consort cert` and readable by common tools.

use super::issue::IssuedCertificate;
use super::keyring::{Authority, CertificateError, Keyring, VerifiedCertificate};
use super::revocation::RevocationList;
use consort_protocol::ids::FleetId;
use consort_protocol::trust::Identity;
use pki_types::pem::PemObject;
use pki_types::{CertificateDer, CertificateRevocationListDer, PrivatePkcs8KeyDer};
use ring::error::KeyRejected;
use ring::signature::Ed25519KeyPair;
use std::fmt::Display;
use std::fs::OpenOptions;
use std::io::{ErrorKind, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
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
    /// List of revoked certificates.
    pub revoked: RevokedFiles,
}

/// Files with the list of revoked certificates.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RevokedFiles {
    /// List of the authority. It may be missing, and is read again while the node runs.
    pub list: Option<PathBuf>,
    /// The latest list that the node has read, written by the node. So an earlier list is not used
    /// after a restart either.
    pub kept: Option<PathBuf>,
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
        let certificate = read_pem::<CertificateDer<'static>>(&self.certificate, "certificate")?;
        let own = authority.verify(certificate, None, now).map_err(TrustError::of(&self.certificate))?;
        let revoked = self.read_revoked(&authority, &own, now)?;
        let own = authority
            .verify(own.certificate(), revoked.as_ref().map(RevocationList::der), now)
            .map_err(TrustError::of(&self.certificate))?;
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

    /// Reads the latest list of revoked certificates.
    fn read_revoked(
        &self,
        authority: &Authority,
        own: &VerifiedCertificate,
        now: Duration,
    ) -> Result<Option<RevocationList>, TrustError> {
        let mut latest = None;
        for file in [&self.revoked.list, &self.revoked.kept].into_iter().flatten() {
            let Some(RevokedFile { der, .. }) = RevokedFile::read(file)? else { continue };
            let list = authority.verify_list(der, own, now).map_err(TrustError::of(file))?;
            if list.check_replaces(latest.as_ref()).is_ok() {
                latest = Some(list);
            }
        }
        Ok(latest)
    }
}

/// File with a list of revoked certificates.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RevokedFile {
    text: Vec<u8>,
    /// The list, in DER.
    pub(super) der: Vec<u8>,
}

impl RevokedFile {
    /// Reads a file; `None` if there is no such file.
    pub(super) fn read(file: &Path) -> Result<Option<RevokedFile>, TrustError> {
        let text = match std::fs::read(file) {
            Ok(text) => text,
            Err(problem) if problem.kind() == ErrorKind::NotFound => return Ok(None),
            Err(problem) => return Err(TrustError::of(file)(problem)),
        };
        let der = from_pem::<CertificateRevocationListDer<'static>>(file, &text, "list of revoked certificates")?;
        Ok(Some(RevokedFile { der: der.to_vec(), text }))
    }

    /// Writes the list to another file.
    pub(super) fn write(&self, file: &Path) -> std::io::Result<()> {
        write_atomically(file, &self.text, 0o644)
    }
}

/// Writes a file atomically, with these permissions: a concurrent reader finds the former content.
///
/// # Errors
/// The error of the system; the former content is unchanged.
pub fn write_atomically(file: &Path, content: &[u8], mode: u32) -> std::io::Result<()> {
    let unfinished = file.with_extension("new");
    // A leftover of a former attempt may have other permissions.
    let _ = std::fs::remove_file(&unfinished);
    let mut to = OpenOptions::new().write(true).create_new(true).mode(mode).open(&unfinished)?;
    to.write_all(content)?;
    to.sync_all()?;
    std::fs::rename(&unfinished, file)
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
    from_pem(file, &std::fs::read(file).map_err(TrustError::of(file))?, what)
}

fn from_pem<T: PemObject>(file: &Path, text: &[u8], what: &str) -> Result<T, TrustError> {
    T::from_pem_slice(text).map_err(|problem| TrustError::of(file)(format!("no {what} found: {problem}")))
}
