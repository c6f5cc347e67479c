//! Issuing of certificates: the fleet's authority and the certificates that it signs. Input and
//! output are values (PEM); the caller stores them.
//!
//! All keys are Ed25519: message signatures need it, and TLS 1.3 accepts it.

use consort_protocol::access::common_name;
use consort_protocol::ids::FleetId;
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

/// A certificate and its private key, both in PEM.
pub struct IssuedCertificate {
    /// Certificate, public.
    pub certificate: String,
    /// Private key, for the principal only.
    pub key: String,
}

/// Key and serial number supplied by the caller instead of drawn at random, for virtual fleets, in
/// which everything follows from a seed. The seed reveals the key.
#[derive(Clone, Copy)]
pub struct KeyMaterial {
    /// Private half of an Ed25519 key (RFC 8032).
    pub key: [u8; 32],
    /// Serial number of the certificate.
    pub serial: [u8; 16],
}

impl KeyMaterial {
    fn key_pair(&self) -> Result<KeyPair, IssueError> {
        // RFC 8410: version, the algorithm id of Ed25519, and the key within two octet strings.
        const HEAD: [u8; 16] = [0x30, 0x2e, 2, 1, 0, 0x30, 5, 6, 3, 0x2b, 0x65, 0x70, 4, 0x22, 4, 0x20];
        let der = PrivatePkcs8KeyDer::from([&HEAD[..], &self.key].concat());
        Ok(KeyPair::from_pkcs8_der_and_sign_algo(&der, &PKCS_ED25519)?)
    }
}

/// A certificate or list could not be issued.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct IssueError(String);

impl From<rcgen::Error> for IssueError {
    fn from(problem: rcgen::Error) -> Self {
        IssueError(problem.to_string())
    }
}

/// Validity period, in time since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Validity {
    /// Start. It should lie some minutes before the issuing; otherwise nodes with slow clocks
    /// reject the certificate.
    pub from: Duration,
    /// End.
    pub until: Duration,
}

/// A revoked certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RevokedCertificate {
    /// Serial number.
    pub serial: Vec<u8>,
    /// Time of the revocation, since 1970.
    pub since: Duration,
}

/// Certificate authority of a fleet.
pub struct CertificateAuthority {
    issuer: rcgen::Issuer<'static, KeyPair>,
}

const AUTHORITY_NAME_PREFIX: &str = "Consort fleet ";

/// Returns the fleet's name in the common name of an authority.
pub fn fleet_of_authority(common_name: &str) -> Option<&str> {
    common_name.strip_prefix(AUTHORITY_NAME_PREFIX)
}

/// Creates the authority of a fleet.
///
/// # Errors
/// [`IssueError`] if the system provides no random numbers, or a date is out of range.
pub fn create_authority(fleet: &FleetId, validity: Validity) -> Result<IssuedCertificate, IssueError> {
    create_authority_with(fleet, validity, KeyPair::generate_for(&PKCS_ED25519)?, random_serial()?)
}

/// Creates the authority of a fleet from the given key material.
///
/// # Errors
/// As [`create_authority`].
pub fn create_authority_from(
    fleet: &FleetId,
    validity: Validity,
    material: KeyMaterial,
) -> Result<IssuedCertificate, IssueError> {
    create_authority_with(fleet, validity, material.key_pair()?, material.serial)
}

fn create_authority_with(
    fleet: &FleetId,
    validity: Validity,
    key: KeyPair,
    serial: [u8; 16],
) -> Result<IssuedCertificate, IssueError> {
    let mut authority = params(validity, serial)?;
    authority.distinguished_name.push(DnType::CommonName, format!("{AUTHORITY_NAME_PREFIX}{fleet}"));
    authority.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    authority.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let certificate = authority.self_signed(&key)?;
    Ok(IssuedCertificate { certificate: certificate.pem(), key: key.serialize_pem() })
}

impl CertificateAuthority {
    /// Parses the authority's certificate and key, both in PEM.
    ///
    /// # Errors
    /// [`IssueError`] if either is invalid.
    pub fn from_pem(certificate: &str, key: &str) -> Result<CertificateAuthority, IssueError> {
        let key = KeyPair::from_pem(key)?;
        Ok(CertificateAuthority { issuer: rcgen::Issuer::from_ca_cert_pem(certificate, key)? })
    }

    /// Issues a certificate for a principal. `addresses` are names and addresses of a node, for
    /// clients that verify them.
    ///
    /// # Errors
    /// [`IssueError`] if an address is not allowed in a certificate, or a date is out of range.
    pub fn issue(
        &self,
        to: &Identity,
        addresses: &[String],
        validity: Validity,
    ) -> Result<IssuedCertificate, IssueError> {
        self.issue_with(to, addresses, validity, KeyPair::generate_for(&PKCS_ED25519)?, random_serial()?)
    }

    /// Issues a certificate from the given key material, without addresses.
    ///
    /// # Errors
    /// As [`issue`](Self::issue).
    pub fn issue_from(
        &self,
        to: &Identity,
        validity: Validity,
        material: KeyMaterial,
    ) -> Result<IssuedCertificate, IssueError> {
        self.issue_with(to, &[], validity, material.key_pair()?, material.serial)
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
            // A person's certificate is valid for clients only.
            Principal::Person { .. } => vec![ExtendedKeyUsagePurpose::ClientAuth],
        };
        let certificate = subject.signed_by(&key, &self.issuer)?;
        Ok(IssuedCertificate { certificate: certificate.pem(), key: key.serialize_pem() })
    }

    /// Signs the list of all revoked certificates, in PEM. `number` must be larger than in all
    /// earlier lists.
    ///
    /// # Errors
    /// [`IssueError`] if a date is out of range.
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

fn random_serial() -> Result<[u8; 16], IssueError> {
    let mut serial = [0; 16];
    let random = SystemRandom::new().fill(&mut serial);
    random.map_err(|_| IssueError("the system provides no random numbers".to_owned()))?;
    Ok(serial)
}

fn params(validity: Validity, mut serial: [u8; 16]) -> Result<CertificateParams, IssueError> {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    (params.not_before, params.not_after) = (date(validity.from)?, date(validity.until)?);
    serial[0] &= 0x7f; // positive, with the same number of bytes
    params.serial_number = Some(SerialNumber::from_slice(&serial));
    Ok(params)
}

fn date(since_1970: Duration) -> Result<OffsetDateTime, IssueError> {
    let seconds = i64::try_from(since_1970.as_secs()).ok();
    let date = seconds.and_then(|seconds| OffsetDateTime::from_unix_timestamp(seconds).ok());
    date.ok_or_else(|| IssueError(format!("{} s since 1970 is not a valid date", since_1970.as_secs())))
}
