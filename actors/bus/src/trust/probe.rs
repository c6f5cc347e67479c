//! A test link that reports the reason of a failure. Zenoh itself only reports that a link failed.

use super::files::{TrustError, TrustFiles, read_pem};
use super::keyring::{Authority, CertificateError};
use consort_protocol::ids::FleetId;
use consort_protocol::trust::Identity;
use pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, ServerName, UnixTime};
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature};
use rustls::{AlertDescription, ClientConfig, ClientConnection, DigitallySignedStruct, SignatureScheme};
use std::io::{ErrorKind, Read};
use std::net::{SocketAddr, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// A link cannot be opened.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProbeError {
    /// The node's own files cannot be used.
    #[error("{0}")]
    OwnFiles(#[from] TrustError),
    /// No program listens at the address, or the network drops the packets.
    #[error("no connection: {0}")]
    Unreachable(String),
    /// The certificate of the listening program is invalid for this node.
    #[error("the certificate of the other side is invalid: {0}")]
    UntrustedPeer(CertificateError),
    /// The listening program rejected this node's certificate.
    #[error(
        "the other side rejected our certificate ({0}): check that it belongs to this fleet and that its clock is right"
    )]
    RejectedByPeer(String),
    /// The listening program does not use TLS.
    #[error("the other side does not use TLS: it may be a node without certificates ({0})")]
    NoTls(String),
}

/// Verifier that records the certificate of the other side.
#[derive(Debug)]
struct RecordingVerifier {
    authority: Authority,
    provider: Arc<CryptoProvider>,
    result: Mutex<Option<Result<Identity, CertificateError>>>,
}

impl ServerCertVerifier for RecordingVerifier {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        let now = Duration::from_secs(now.as_secs());
        let result = self
            .authority
            .verify_server(end_entity.clone().into_owned(), now)
            .map(|certificate| Identity::clone(&certificate.identity));
        let accepted = result.is_ok();
        *self.result.lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
        match accepted {
            true => Ok(ServerCertVerified::assertion()),
            false => Err(rustls::CertificateError::ApplicationVerificationFailure.into()),
        }
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls12_signature(message, certificate, signed, &self.provider.signature_verification_algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(message, certificate, signed, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}

impl TrustFiles {
    /// Opens a link to an address as a node would, and closes it again. Returns the identity of the
    /// other side. Blocks, for at most `limit` per step.
    ///
    /// # Errors
    /// [`ProbeError`] states which side rejects the other, and the reason.
    pub fn probe(&self, address: SocketAddr, fleet: &FleetId, limit: Duration) -> Result<Identity, ProbeError> {
        let authority = read_pem::<CertificateDer<'static>>(&self.authority, "certificate")?;
        let authority = Authority::new(fleet.clone(), &authority).map_err(TrustError::of(&self.authority))?;
        let provider = Arc::new(ring::default_provider());
        let verifier =
            Arc::new(RecordingVerifier { authority, provider: Arc::clone(&provider), result: Mutex::default() });
        let certificate = read_pem::<CertificateDer<'static>>(&self.certificate, "certificate")?;
        let key = read_pem::<PrivatePkcs8KeyDer<'static>>(&self.key, "private key in PKCS #8")?;
        let config = ClientConfig::builder_with_provider(provider).with_protocol_versions(&[&rustls::version::TLS13]);
        let config = config.map_err(|problem| ProbeError::NoTls(problem.to_string()))?.dangerous();
        let config = config.with_custom_certificate_verifier(Arc::<RecordingVerifier>::clone(&verifier));
        let config = config.with_client_auth_cert(vec![certificate], PrivateKeyDer::Pkcs8(key));
        let config = config.map_err(TrustError::of(&self.key))?;

        let unreachable = |problem: std::io::Error| ProbeError::Unreachable(problem.to_string());
        let mut stream = TcpStream::connect_timeout(&address, limit).map_err(unreachable)?;
        stream.set_read_timeout(Some(limit)).map_err(unreachable)?;
        stream.set_write_timeout(Some(limit)).map_err(unreachable)?;
        let mut tls = ClientConnection::new(Arc::new(config), ServerName::IpAddress(address.ip().into()))
            .map_err(|problem| ProbeError::NoTls(problem.to_string()))?;
        let opened = shake_hands(&mut tls, &mut stream).map_err(|problem| problem.to_string());
        let result = verifier.result.lock().unwrap_or_else(PoisonError::into_inner).take();
        match (result, opened) {
            (Some(Err(distrust)), _) => Err(ProbeError::UntrustedPeer(distrust)),
            (Some(Ok(identity)), Ok(())) => Ok(identity),
            (Some(Ok(_)), Err(problem)) => Err(ProbeError::RejectedByPeer(problem)),
            (None, Err(problem)) => Err(ProbeError::NoTls(problem)),
            (None, Ok(())) => Err(ProbeError::NoTls("it sent no certificate".to_owned())),
        }
    }
}

/// The handshake failed.
#[derive(Debug, thiserror::Error)]
enum HandshakeError {
    /// The connection failed, or the other side does not use TLS.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The other side sent no reason.
    #[error("it closed the connection")]
    Closed,
    /// Reason that the other side sent.
    #[error("{0}")]
    Alert(String),
}

/// Performs the handshake. In TLS 1.3 the client finishes before the server has verified the
/// client's certificate, so a rejection arrives only in a later read. Otherwise that read returns
/// nothing until the timeout.
fn shake_hands(tls: &mut ClientConnection, stream: &mut TcpStream) -> Result<(), HandshakeError> {
    while tls.is_handshaking() {
        tls.complete_io(stream)?;
    }
    let received = rustls::Stream::new(tls, stream).read(&mut [0; 1]);
    match received {
        Ok(0) => Err(HandshakeError::Closed),
        Ok(_) => Ok(()),
        Err(error) if [ErrorKind::WouldBlock, ErrorKind::TimedOut].contains(&error.kind()) => Ok(()),
        Err(problem) => Err(alert(&problem).map_or(HandshakeError::Io(problem), HandshakeError::Alert)),
    }
}

/// Returns the reason that the other side sent before closing, as text.
fn alert(problem: &std::io::Error) -> Option<String> {
    let inner = problem.get_ref()?.downcast_ref::<rustls::Error>()?;
    let rustls::Error::AlertReceived(alert) = inner else { return None };
    Some(match alert {
        AlertDescription::UnknownCA => "it does not accept the authority of our certificate".to_owned(),
        AlertDescription::CertificateRequired => "it requires a certificate".to_owned(),
        AlertDescription::CertificateExpired => "our certificate has expired".to_owned(),
        AlertDescription::DecryptError => "our certificate was not signed by its authority".to_owned(),
        other => format!("it sent the alert {other:?}"),
    })
}
