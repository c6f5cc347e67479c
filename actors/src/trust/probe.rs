//! A link opened and closed again, to tell why it does not come about. Zenoh only says that it does not.

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

/// Why a link does not come about.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProbeError {
    /// The own files are of no use.
    #[error("{0}")]
    OwnFiles(#[from] TrustError),
    /// Nothing listens there, or nothing gets through.
    #[error("no connection: {0}")]
    Unreachable(String),
    /// Whoever listens there is not believed here.
    #[error("whoever listens there is not believed: {0}")]
    UntrustedPeer(CertificateError),
    /// Whoever listens there does not believe the bearer of these files.
    #[error("whoever listens there does not believe us ({0}): is it of this fleet, is its clock right?")]
    RejectedByPeer(String),
    /// Whoever listens there does not speak TLS.
    #[error("whoever listens there does not speak TLS: it may be a node without certificates ({0})")]
    NoTls(String),
}

/// What is heard of the other end while the link is opened.
#[derive(Debug)]
struct Judge {
    authority: Authority,
    provider: Arc<CryptoProvider>,
    judged: Mutex<Option<Result<Identity, CertificateError>>>,
}

impl ServerCertVerifier for Judge {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        let now = Duration::from_secs(now.as_secs());
        let judged = self.authority.verify_server(end_entity.clone().into_owned(), now).map(|card| card.identity);
        let believed = judged.is_ok();
        *self.judged.lock().unwrap_or_else(PoisonError::into_inner) = Some(judged);
        match believed {
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
    /// Opens a link to an address as a node would, and closes it again: says who is there. It blocks, each step for `limit` at
    /// most.
    ///
    /// # Errors
    /// [`ProbeError`] says which side does not believe which, and why.
    pub fn probe(&self, address: SocketAddr, fleet: &FleetId, limit: Duration) -> Result<Identity, ProbeError> {
        let authority = read_pem::<CertificateDer<'static>>(&self.authority, "certificate")?;
        let authority = Authority::new(fleet.clone(), &authority).map_err(TrustError::of(&self.authority))?;
        let provider = Arc::new(ring::default_provider());
        let judge = Arc::new(Judge { authority, provider: Arc::clone(&provider), judged: Mutex::default() });
        let certificate = read_pem::<CertificateDer<'static>>(&self.certificate, "certificate")?;
        let key = read_pem::<PrivatePkcs8KeyDer<'static>>(&self.key, "private key in PKCS #8")?;
        let config = ClientConfig::builder_with_provider(provider).with_protocol_versions(&[&rustls::version::TLS13]);
        let config = config.map_err(|problem| ProbeError::NoTls(problem.to_string()))?.dangerous();
        let config = config.with_custom_certificate_verifier(Arc::<Judge>::clone(&judge));
        let config = config.with_client_auth_cert(vec![certificate], PrivateKeyDer::Pkcs8(key));
        let config = config.map_err(TrustError::of(&self.key))?;

        let unreached = |problem: std::io::Error| ProbeError::Unreachable(problem.to_string());
        let mut stream = TcpStream::connect_timeout(&address, limit).map_err(unreached)?;
        stream.set_read_timeout(Some(limit)).map_err(unreached)?;
        stream.set_write_timeout(Some(limit)).map_err(unreached)?;
        let mut tls = ClientConnection::new(Arc::new(config), ServerName::IpAddress(address.ip().into()))
            .map_err(|problem| ProbeError::NoTls(problem.to_string()))?;
        let opened = shake_hands(&mut tls, &mut stream);
        let judged = judge.judged.lock().unwrap_or_else(PoisonError::into_inner).take();
        match (judged, opened) {
            (Some(Err(distrust)), _) => Err(ProbeError::UntrustedPeer(distrust)),
            (Some(Ok(identity)), Ok(())) => Ok(identity),
            (Some(Ok(_)), Err(problem)) => Err(ProbeError::RejectedByPeer(problem)),
            (None, Err(problem)) => Err(ProbeError::NoTls(problem)),
            (None, Ok(())) => Err(ProbeError::NoTls("it showed no certificate".to_owned())),
        }
    }
}

/// Opens the link. In TLS 1.3 whoever opens it is done before the other side has judged its certificate: that it was refused is
/// only read afterwards, where else nothing comes until the limit.
fn shake_hands(tls: &mut ClientConnection, stream: &mut TcpStream) -> Result<(), String> {
    while tls.is_handshaking() {
        tls.complete_io(stream).map_err(|problem| problem.to_string())?;
    }
    let said = rustls::Stream::new(tls, stream).read(&mut [0; 1]);
    match said {
        Ok(0) => Err("it closed the connection".to_owned()),
        Ok(_) => Ok(()),
        Err(quiet) if [ErrorKind::WouldBlock, ErrorKind::TimedOut].contains(&quiet.kind()) => Ok(()),
        Err(problem) => Err(alert(&problem).unwrap_or_else(|| problem.to_string())),
    }
}

/// What the other side said before it closed, in words.
fn alert(problem: &std::io::Error) -> Option<String> {
    let inner = problem.get_ref()?.downcast_ref::<rustls::Error>()?;
    let rustls::Error::AlertReceived(alert) = inner else { return None };
    Some(match alert {
        AlertDescription::UnknownCA => "it does not know who signed our certificate".to_owned(),
        AlertDescription::CertificateRequired => "it asks for a certificate".to_owned(),
        AlertDescription::CertificateExpired => "our certificate has expired".to_owned(),
        AlertDescription::DecryptError => "our certificate was not signed by its authority".to_owned(),
        other => format!("it says {other:?}"),
    })
}
