//! The files that trust is kept in: PEM, as `consort cert` writes it and as everybody's tools read it.

use super::issue::IssuedCertificate;
use super::keyring::{Authority, Keyring, VerifiedCertificate};
use consort_protocol::ids::FleetId;
use consort_protocol::trust::Identity;
use pki_types::pem::PemObject;
use pki_types::{CertificateDer, CertificateRevocationListDer, PrivatePkcs8KeyDer};
use ring::signature::Ed25519KeyPair;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Where a node's, or a person's, certificate and key are, and whom it trusts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TrustFiles {
    /// The certificate of the fleet's authority.
    pub authority: PathBuf,
    /// The bearer's certificate.
    pub certificate: PathBuf,
    /// Its key, in PKCS #8. Whoever can read this file is the bearer.
    pub key: PathBuf,
    /// The list of revoked certificates, if there is one. It is read again while the node runs.
    pub revoked: Option<PathBuf>,
}

/// Why the files are of no use.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}: {problem}", file.display())]
pub struct TrustError {
    /// Which file.
    pub file: PathBuf,
    /// What is wrong with it.
    pub problem: String,
}

impl TrustError {
    pub(super) fn of<E: Display>(file: &Path) -> impl Fn(E) -> TrustError {
        move |problem| TrustError { file: file.to_owned(), problem: problem.to_string() }
    }
}

impl TrustFiles {
    /// Reads them all, and sees to it that they belong together: the authority signed the certificate, for this fleet and for now
    /// (`now` in time since 1970), and the key is the certificate's. `life`: see [`Keyring`].
    ///
    /// # Errors
    /// [`TrustError`] names the file and what is wrong with it.
    pub fn open(&self, fleet: &FleetId, now: Duration, life: u64) -> Result<Keyring, TrustError> {
        let authority = read_pem::<CertificateDer<'static>>(&self.authority, "certificate")?;
        let authority = Authority::new(fleet.clone(), &authority).map_err(TrustError::of(&self.authority))?;
        let revoked = self.read_revoked()?;
        let certificate = read_pem::<CertificateDer<'static>>(&self.certificate, "certificate")?;
        let own = authority.verify(certificate, revoked.as_deref(), now).map_err(TrustError::of(&self.certificate))?;
        let key = read_pem::<PrivatePkcs8KeyDer<'static>>(&self.key, "private key in PKCS #8")?;
        let of = self.certificate.display().to_string();
        let key = key_of(&own, &key, &of).map_err(TrustError::of(&self.key))?;
        Ok(Keyring::new(authority, own, key, revoked, life))
    }

    /// Whose certificate it is, if the files are right.
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

/// The list of what is revoked, in DER.
pub(super) fn read_revoked(file: &Path) -> Result<Vec<u8>, TrustError> {
    let list = read_pem::<CertificateRevocationListDer<'static>>(file, "list of revoked certificates")?;
    Ok(list.to_vec())
}

impl Keyring {
    /// What was just issued, for a bearer that has it in no file; `life` as in [`TrustFiles::open`].
    ///
    /// # Errors
    /// What is wrong with it, in words.
    pub fn from_issued(
        fleet: FleetId,
        authority: &str,
        issued: &IssuedCertificate,
        now: Duration,
        life: u64,
    ) -> Result<Keyring, String> {
        let unread = |problem: pki_types::pem::Error| problem.to_string();
        let authority = CertificateDer::from_pem_slice(authority.as_bytes()).map_err(unread)?;
        let authority = Authority::new(fleet, &authority).map_err(|distrust| distrust.to_string())?;
        let own = CertificateDer::from_pem_slice(issued.certificate.as_bytes()).map_err(unread)?;
        let own = authority.verify(own, None, now).map_err(|distrust| distrust.to_string())?;
        let key = PrivatePkcs8KeyDer::from_pem_slice(issued.key.as_bytes()).map_err(unread)?;
        let key = key_of(&own, &key, "the certificate")?;
        Ok(Keyring::new(authority, own, key, None, life))
    }
}

/// The key of a certificate, if it is that.
fn key_of(own: &VerifiedCertificate, key: &PrivatePkcs8KeyDer<'_>, of: &str) -> Result<Ed25519KeyPair, String> {
    let key = Ed25519KeyPair::from_pkcs8_maybe_unchecked(key.secret_pkcs8_der());
    let key = key.map_err(|problem| format!("it is no key for Ed25519: {problem}"))?;
    match own.verify(b"whose key is it", key.sign(b"whose key is it").as_ref()) {
        true => Ok(key),
        false => Err(format!("it is not the key of {of}")),
    }
}

pub(super) fn read_pem<T: PemObject>(file: &Path, what: &str) -> Result<T, TrustError> {
    let text = std::fs::read(file).map_err(TrustError::of(file))?;
    T::from_pem_slice(&text).map_err(|problem| TrustError::of(file)(format!("there is no {what} in it: {problem}")))
}
