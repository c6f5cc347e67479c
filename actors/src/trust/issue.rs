//! Certificates made: the fleet's authority, and what it signs. Values in, PEM out; where it is kept is the caller's.
//!
//! All keys are Ed25519: what seals are made with, and TLS 1.3 takes them too.

use consort_protocol::ids::FleetId;
use consort_protocol::trust::access::common_name;
use consort_protocol::trust::{Identity, Principal};
use pki_types::PrivatePkcs8KeyDer;
use rcgen::{
    BasicConstraints, CertificateParams, CertificateRevocationListParams, DnType, ExtendedKeyUsagePurpose, IsCa,
    KeyIdMethod, KeyPair, KeyUsagePurpose, PKCS_ED25519, RevocationReason, RevokedCertParams, SanType, SerialNumber,
};
use ring::rand::{SecureRandom, SystemRandom};
use std::net::IpAddr;
use std::time::Duration;
use time::OffsetDateTime;

/// A certificate and its key, both in PEM.
pub struct IssuedCertificate {
    /// For everybody to see.
    pub certificate: String,
    /// For the bearer alone.
    pub key: String,
}

/// What a certificate and its key are drawn from where chance is given from outside: in virtual fleets, in which everything follows
/// from a seed. Whoever knows it has the key.
#[derive(Clone, Copy)]
pub struct KeyMaterial {
    /// The secret half of an Ed25519 key (RFC 8032).
    pub key: [u8; 32],
    /// The certificate's number.
    pub serial: [u8; 16],
}

impl KeyMaterial {
    fn key_pair(&self) -> Result<KeyPair, IssueError> {
        // RFC 8410: a version, Ed25519's number, and the key within two octet strings.
        const HEAD: [u8; 16] = [0x30, 0x2e, 2, 1, 0, 0x30, 5, 6, 3, 0x2b, 0x65, 0x70, 4, 0x22, 4, 0x20];
        let der = PrivatePkcs8KeyDer::from([&HEAD[..], &self.key].concat());
        Ok(KeyPair::from_pkcs8_der_and_sign_algo(&der, &PKCS_ED25519)?)
    }
}

/// Why nothing was issued.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct IssueError(String);

impl From<rcgen::Error> for IssueError {
    fn from(problem: rcgen::Error) -> Self {
        IssueError(problem.to_string())
    }
}

/// From when until when something is valid, in time since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Validity {
    /// From when. Some minutes before it is issued, or the first node whose clock is slow refuses it.
    pub from: Duration,
    /// Until when.
    pub until: Duration,
}

/// A certificate that has been revoked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RevokedCertificate {
    /// Its serial number.
    pub serial: Vec<u8>,
    /// Since when, in time since 1970.
    pub since: Duration,
}

/// A fleet's authority, which signs.
pub struct CertificateAuthority {
    issuer: rcgen::Issuer<'static, KeyPair>,
}

const AUTHORITY_OF: &str = "Consort fleet ";

/// The fleet's name in the common name of its authority.
pub fn fleet_of_authority(common_name: &str) -> Option<&str> {
    common_name.strip_prefix(AUTHORITY_OF)
}

/// A new authority for a fleet.
///
/// # Errors
/// [`IssueError`] if the system gives no random numbers, or the dates are none.
pub fn create_authority(fleet: &FleetId, validity: Validity) -> Result<IssuedCertificate, IssueError> {
    found_with(fleet, validity, KeyPair::generate_for(&PKCS_ED25519)?, by_chance()?)
}

/// The same of a given draw.
///
/// # Errors
/// As [`found`].
pub fn create_authority_from(
    fleet: &FleetId,
    validity: Validity,
    draw: KeyMaterial,
) -> Result<IssuedCertificate, IssueError> {
    found_with(fleet, validity, draw.key_pair()?, draw.serial)
}

fn found_with(
    fleet: &FleetId,
    validity: Validity,
    key: KeyPair,
    serial: [u8; 16],
) -> Result<IssuedCertificate, IssueError> {
    let mut authority = params(validity, serial)?;
    authority.distinguished_name.push(DnType::CommonName, format!("{AUTHORITY_OF}{fleet}"));
    authority.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    authority.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let certificate = authority.self_signed(&key)?;
    Ok(IssuedCertificate { certificate: certificate.pem(), key: key.serialize_pem() })
}

impl CertificateAuthority {
    /// The authority of this certificate and key, both in PEM.
    ///
    /// # Errors
    /// [`IssueError`] if they are none.
    pub fn from_pem(certificate: &str, key: &str) -> Result<CertificateAuthority, IssueError> {
        let key = KeyPair::from_pem(key)?;
        Ok(CertificateAuthority { issuer: rcgen::Issuer::from_ca_cert_pem(certificate, key)? })
    }

    /// A certificate for a bearer; `addresses` are names and addresses under which a node is reached, for clients that compare.
    ///
    /// # Errors
    /// [`IssueError`] if an address cannot stand in a certificate, or the dates are none.
    pub fn issue(
        &self,
        to: &Identity,
        addresses: &[String],
        validity: Validity,
    ) -> Result<IssuedCertificate, IssueError> {
        self.issue_with(to, addresses, validity, KeyPair::generate_for(&PKCS_ED25519)?, by_chance()?)
    }

    /// The same of a given draw, without addresses.
    ///
    /// # Errors
    /// As [`issue`](Self::issue).
    pub fn issue_from(
        &self,
        to: &Identity,
        validity: Validity,
        draw: KeyMaterial,
    ) -> Result<IssuedCertificate, IssueError> {
        self.issue_with(to, &[], validity, draw.key_pair()?, draw.serial)
    }

    fn issue_with(
        &self,
        to: &Identity,
        addresses: &[String],
        validity: Validity,
        key: KeyPair,
        serial: [u8; 16],
    ) -> Result<IssuedCertificate, IssueError> {
        let mut subject = params(validity, serial)?;
        subject.distinguished_name.push(DnType::CommonName, common_name(to));
        subject.subject_alt_names.push(SanType::URI(to.to_string().try_into()?));
        for address in addresses {
            subject.subject_alt_names.push(match address.parse::<IpAddr>() {
                Ok(address) => SanType::IpAddress(address),
                Err(_) => SanType::DnsName(address.as_str().try_into()?),
            });
        }
        subject.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        subject.use_authority_key_identifier_extension = true;
        subject.extended_key_usages = match to.principal {
            Principal::Node { .. } => vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth],
            // A person's certificate opens connections, and is not believed by who opens one to it.
            Principal::Person { .. } => vec![ExtendedKeyUsagePurpose::ClientAuth],
        };
        let certificate = subject.signed_by(&key, &self.issuer)?;
        Ok(IssuedCertificate { certificate: certificate.pem(), key: key.serialize_pem() })
    }

    /// The list of all that is revoked, in PEM; `number` is larger than that of any former list.
    ///
    /// # Errors
    /// [`IssueError`] if the dates are none.
    pub fn revocation_list(
        &self,
        revoked: &[RevokedCertificate],
        number: u64,
        validity: Validity,
    ) -> Result<String, IssueError> {
        let certs = revoked.iter().map(|revoked| {
            Ok(RevokedCertParams {
                serial_number: SerialNumber::from_slice(&revoked.serial),
                revocation_time: date(revoked.since)?,
                reason_code: Some(RevocationReason::Unspecified),
                invalidity_date: None,
            })
        });
        let list = CertificateRevocationListParams {
            this_update: date(validity.from)?,
            next_update: date(validity.until)?,
            crl_number: SerialNumber::from(number),
            issuing_distribution_point: None,
            revoked_certs: certs.collect::<Result<_, IssueError>>()?,
            key_identifier_method: KeyIdMethod::Sha256,
        };
        Ok(list.signed_by(&self.issuer)?.pem()?)
    }
}

fn by_chance() -> Result<[u8; 16], IssueError> {
    let mut serial = [0; 16];
    let random = SystemRandom::new().fill(&mut serial);
    random.map_err(|_| IssueError("the system gives no random numbers".to_owned()))?;
    Ok(serial)
}

fn params(validity: Validity, mut serial: [u8; 16]) -> Result<CertificateParams, IssueError> {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    (params.not_before, params.not_after) = (date(validity.from)?, date(validity.until)?);
    serial[0] &= 0x7f; // a positive number, in as many bytes
    params.serial_number = Some(SerialNumber::from_slice(&serial));
    Ok(params)
}

fn date(since_1970: Duration) -> Result<OffsetDateTime, IssueError> {
    let seconds = i64::try_from(since_1970.as_secs()).ok();
    let date = seconds.and_then(|seconds| OffsetDateTime::from_unix_timestamp(seconds).ok());
    date.ok_or_else(|| IssueError(format!("{} s after 1970 is no date", since_1970.as_secs())))
}
