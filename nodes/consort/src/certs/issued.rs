//! Reads issued certificates and revocation lists back from their files.

use super::{file_error, unix_time};
use crate::diagnostic::Diagnostic;
use consort_bus::trust::issue::{RevokedCertificate, fleet_of_authority};
use consort_protocol::ids::FleetId;
use consort_protocol::trust::{Identity, IdentityError};
use std::fs;
use std::net::IpAddr;
use std::path::Path;
use std::time::Duration;
use x509_parser::error::X509Error;
use x509_parser::extensions::GeneralName;
use x509_parser::pem::{Pem, parse_x509_pem};
use x509_parser::prelude::{FromDer, X509Certificate};
use x509_parser::revocation_list::CertificateRevocationList;

/// An issued certificate.
#[derive(Debug, Clone, PartialEq)]
pub struct CertificateEntry {
    /// The name, equal to the name of its folder.
    pub name: String,
    /// Identity of the principal.
    pub identity: Identity,
    /// Names and addresses of the node.
    pub addresses: Vec<String>,
    /// The serial number.
    pub serial: Vec<u8>,
    /// Expiry, in time since 1970.
    pub expires: Duration,
    /// Validity.
    pub state: CertificateState,
}

/// Validity of a certificate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CertificateState {
    /// Valid for some more days.
    Valid {
        /// Number of days.
        days: u64,
    },
    /// Expired.
    Expired,
    /// Revoked.
    Revoked,
}

impl CertificateEntry {
    /// Reads a certificate. `revoked` is the current revocation list.
    ///
    /// # Errors
    /// [`Diagnostic`] if the file is not a certificate, or has no identity.
    pub fn read(file: &Path, revoked: &[RevokedCertificate]) -> Result<CertificateEntry, Diagnostic> {
        let pem = pem(file)?;
        let certificate = pem.parse_x509().map_err(|problem| file_error(file, problem))?;
        let (identity, addresses) = names(&certificate).map_err(|problem| file_error(file, problem))?;
        let until = certificate.validity().not_after.timestamp();
        let until = Duration::from_secs(u64::try_from(until).unwrap_or(0));
        let serial = certificate.raw_serial().to_vec();
        let state = if revoked.iter().any(|revoked| revoked.serial == serial) {
            CertificateState::Revoked
        } else {
            until
                .checked_sub(unix_time())
                .map_or(CertificateState::Expired, |left| CertificateState::Valid { days: left.as_secs() / 86_400 })
        };
        let name = file.parent().and_then(Path::file_name).unwrap_or_default();
        Ok(CertificateEntry {
            name: name.to_string_lossy().into_owned(),
            identity,
            addresses,
            serial,
            expires: until,
            state,
        })
    }
}

/// The names in a certificate are not those of a node or person.
#[derive(Debug, thiserror::Error)]
enum NamesError {
    #[error(transparent)]
    Form(#[from] X509Error),
    #[error(transparent)]
    Identity(#[from] IdentityError),
    #[error("it has no identity: there is no name of the form consort://… in it")]
    NoIdentity,
}

/// Returns the identity in a certificate, and the addresses of its node.
fn names(certificate: &X509Certificate<'_>) -> Result<(Identity, Vec<String>), NamesError> {
    let names = certificate.subject_alternative_name()?;
    let names = names.map(|names| names.value.general_names.as_slice()).unwrap_or_default();
    let (mut identity, mut addresses) = (None, Vec::new());
    for name in names {
        match name {
            GeneralName::URI(text) => identity = Some(text.parse::<Identity>()?),
            GeneralName::DNSName(name) => addresses.push((*name).to_owned()),
            GeneralName::IPAddress(bytes) => addresses.extend(address(bytes)),
            _ => {}
        }
    }
    let identity = identity.ok_or(NamesError::NoIdentity)?;
    Ok((identity, addresses))
}

/// Formats an address from its 4 or 16 bytes.
fn address(bytes: &[u8]) -> Option<String> {
    let short = <[u8; 4]>::try_from(bytes).map(|bytes| IpAddr::from(bytes).to_string());
    short.or_else(|_| <[u8; 16]>::try_from(bytes).map(|bytes| IpAddr::from(bytes).to_string())).ok()
}

/// Returns the fleet of an authority, from the authority's certificate.
///
/// # Errors
/// [`Diagnostic`] if it is not the certificate of a fleet's authority.
pub(crate) fn read_fleet_of_authority(file: &Path) -> Result<FleetId, Diagnostic> {
    let pem = pem(file)?;
    let certificate = pem.parse_x509().map_err(|problem| file_error(file, problem))?;
    let mut names = certificate.subject().iter_common_name().filter_map(|name| name.as_str().ok());
    let fleet = names
        .find_map(fleet_of_authority)
        .ok_or_else(|| file_error(file, "it is not the certificate of a fleet's authority"))?;
    fleet.parse().map_err(|problem| file_error(file, problem))
}

/// Reads a revocation list.
pub(super) fn read_revocation_list(file: &Path) -> Result<Vec<RevokedCertificate>, Diagnostic> {
    let pem = pem(file)?;
    let (_, list) = CertificateRevocationList::from_der(&pem.contents).map_err(|problem| file_error(file, problem))?;
    let revoked = list.iter_revoked_certificates().map(|revoked| {
        let since = u64::try_from(revoked.revocation_date.timestamp()).unwrap_or(0);
        RevokedCertificate { serial: revoked.raw_serial().to_vec(), since: Duration::from_secs(since) }
    });
    Ok(revoked.collect())
}

fn pem(file: &Path) -> Result<Pem, Diagnostic> {
    let text = fs::read(file).map_err(|problem| file_error(file, problem))?;
    parse_x509_pem(&text)
        .map(|(_, pem)| pem)
        .map_err(|problem| file_error(file, format!("it is not in PEM: {problem}")))
}
