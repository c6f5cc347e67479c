//! Checks of the links to neighbours.

use super::{DiagnosisTarget, Finding};
use crate::config::trust_files;
use consort_bus::trust::ProbeError;
use std::io::Read;
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// Time limit of each step.
const LIMIT: Duration = Duration::from_secs(2);

/// Checks every neighbour.
pub(super) fn check_links(target: &DiagnosisTarget) -> Vec<Finding> {
    target.bus.connect.iter().map(|address| check_link(target, address)).collect()
}

fn check_link(target: &DiagnosisTarget, address: &str) -> Finding {
    let about = format!("link {address}");
    let (protocol, place) = address.split_once('/').unwrap_or(("", address));
    let at = match place.to_socket_addrs().map(|mut all| all.next()) {
        Ok(Some(at)) => at,
        Ok(None) | Err(_) => {
            return Finding::error(
                about,
                "there is no such host",
                "check the name, and its resolution (getent hosts NAME)",
            );
        }
    };
    let down = "is the node up, does it relay (bus.relay), does it listen on that address and not on loopback alone, does a firewall let the port through?";
    match (protocol, &target.bus.certs) {
        ("tls", Some(folder)) => match trust_files(folder).probe(at, &target.fleet, LIMIT) {
            Ok(identity) => Finding::ok(
                about,
                format!("{} answers, and both ends accept each other's certificate", identity.principal),
            ),
            Err(problem @ ProbeError::Unreachable(_)) => Finding::error(about, problem, down),
            Err(problem @ ProbeError::NoTls(_)) => {
                Finding::error(about, problem, "give that node certificates too, or use tcp/ without certificates")
            }
            Err(problem @ ProbeError::OwnFiles(_)) => Finding::error(about, problem, "repair the certificates first"),
            Err(problem @ (ProbeError::UntrustedPeer(_) | ProbeError::RejectedByPeer(_))) => {
                let advice = "both ends need certificates of the same authority (consort cert show) that have not expired, and correct clocks";
                Finding::error(about, problem, advice)
            }
        },
        ("tls", None) => Finding::error(
            about,
            "the node requires a certificate",
            "give the folder with your certificate: --certs DIR",
        ),
        _ => match TcpStream::connect_timeout(&at, LIMIT) {
            Err(problem) => Finding::error(about, format!("no connection: {problem}"), down),
            Ok(stream) if requires_tls(&stream) => Finding::error(
                about,
                "it closes the connection: it may require a certificate",
                "try tls/ and --certs DIR",
            ),
            Ok(_) => Finding::ok(about, format!("a server answers at {at}")),
        },
    }
}

/// A TLS server closes the connection at an invalid greeting; Zenoh on TCP waits for more.
fn requires_tls(mut stream: &TcpStream) -> bool {
    use std::io::Write;
    let _ = stream.set_read_timeout(Some(Duration::from_millis(500)));
    // The first bytes of a Zenoh frame; the rest never comes.
    let reply = stream.write_all(&[4, 0]).and_then(|()| stream.read(&mut [0; 8]));
    matches!(reply, Ok(1..))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn a_silent_server_is_not_taken_for_a_tls_server() {
        let silent = TcpListener::bind("127.0.0.1:0").unwrap();
        let at = silent.local_addr().unwrap();
        assert!(!requires_tls(&TcpStream::connect(at).unwrap()));
    }
}
