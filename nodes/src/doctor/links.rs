//! Whether neighbours are reached, and believe each other.

use super::{DiagnosisTarget, Finding};
use crate::config::trust_files;
use consort_actors::trust::ProbeError;
use std::io::Read;
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// How long each step may take.
const LIMIT: Duration = Duration::from_secs(2);

/// Tries every neighbour.
pub(super) fn check_links(patient: &DiagnosisTarget) -> Vec<Finding> {
    patient.bus.connect.iter().map(|address| reach(patient, address)).collect()
}

fn reach(patient: &DiagnosisTarget, address: &str) -> Finding {
    let about = format!("link {address}");
    let (protocol, place) = address.split_once('/').unwrap_or(("", address));
    let at = match place.to_socket_addrs().map(|mut all| all.next()) {
        Ok(Some(at)) => at,
        Ok(None) | Err(_) => {
            return Finding::error(
                about,
                "there is no such host",
                "look at the name, and at who resolves it (getent hosts NAME)",
            );
        }
    };
    let down = "is the node up, does it listen on that address and not on loopback alone, does a firewall let the port through?";
    match (protocol, &patient.bus.certs) {
        ("tls", Some(folder)) => match trust_files(folder).probe(at, &patient.fleet, LIMIT) {
            Ok(identity) => Finding::ok(about, format!("{} answers, and each believes the other", identity.principal)),
            Err(problem @ ProbeError::Unreachable(_)) => Finding::error(about, problem, down),
            Err(problem @ ProbeError::NoTls(_)) => {
                Finding::error(about, problem, "give that node certificates too, or use tcp/ and none")
            }
            Err(problem @ ProbeError::OwnFiles(_)) => Finding::error(about, problem, "mend the certificates first"),
            Err(problem @ (ProbeError::UntrustedPeer(_) | ProbeError::RejectedByPeer(_))) => {
                let advice = "both ends need certificates of one authority (consort cert show) that have not expired, and clocks that are right";
                Finding::error(about, problem, advice)
            }
        },
        ("tls", None) => {
            Finding::error(about, "it takes a certificate to get in there", "name the folder with yours: --certs DIR")
        }
        _ => match TcpStream::connect_timeout(&at, LIMIT) {
            Err(problem) => Finding::error(about, format!("no connection: {problem}"), down),
            Ok(stream) if wants_tls(&stream) => {
                Finding::error(about, "it hangs up: it may want a certificate", "try tls/ and --certs DIR")
            }
            Ok(_) => Finding::ok(about, format!("something answers at {at}")),
        },
    }
}

/// Whoever speaks TLS closes the connection at what is no greeting of its kind; Zenoh on TCP waits for more.
fn wants_tls(mut stream: &TcpStream) -> bool {
    use std::io::Write;
    let _ = stream.set_read_timeout(Some(Duration::from_millis(500)));
    // The first bytes of a frame of Zenoh's, whose rest never comes.
    let said = stream.write_all(&[4, 0]).and_then(|()| stream.read(&mut [0; 8]));
    matches!(said, Ok(1..))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn nobody_is_taken_for_a_node_that_wants_certificates_because_it_is_silent() {
        let silent = TcpListener::bind("127.0.0.1:0").unwrap();
        let at = silent.local_addr().unwrap();
        assert!(!wants_tls(&TcpStream::connect(at).unwrap()));
    }
}
