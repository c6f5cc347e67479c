//! Checks of the machine: clock, disk and ports.

use super::Finding;
use crate::certs::unix_time;
use std::fs;
use std::io::{ErrorKind, Write};
use std::net::{SocketAddr, TcpListener, ToSocketAddrs};
use std::path::Path;
use std::time::{Duration, Instant};

/// A correct clock shows no earlier time: 2026-01-01.
const NOT_BEFORE: Duration = Duration::from_secs(1_767_225_600);

/// Minimum free disk space: with less, a growing ledger fills the disk within days. An estimate.
const FREE_MIN: u64 = 1 << 30;

/// Maximum time of a disk sync, because a commit waits for it: a slower disk disturbs elections (a
/// follower answers within half of it on a LAN).
const SYNC_MAX: Duration = Duration::from_millis(50);

/// Checks that the clock is set.
pub(super) fn check_clock() -> Vec<Finding> {
    if unix_time() >= NOT_BEFORE {
        return vec![Finding::ok("clock", "it is set")];
    }
    let text = format!("it shows {} days since 1970", unix_time().as_secs() / 86_400);
    vec![Finding::error("clock", text, "set it, and synchronise it (timedatectl set-ntp true)")]
}

/// Checks that a directory can hold a ledger.
pub(super) fn check_data_dir(folder: Option<&Path>) -> Vec<Finding> {
    let Some(folder) = folder else { return vec![] };
    let about = format!("data directory {}", folder.display());
    // The directory is created when the node starts; until then its nearest existing ancestor is
    // checked.
    let existing = folder.ancestors().find(|ancestor| ancestor.exists()).unwrap_or(Path::new("/"));
    let mut findings = Vec::new();
    match sync_time(existing) {
        Ok(took) if took > SYNC_MAX => {
            let text = format!("a write with a disk sync takes {} ms", took.as_millis());
            let advice =
                "every commit waits for that: use a faster disk, or another node as voter (may_vote = false here)";
            findings.push(Finding::warning(&about, text, advice));
        }
        Ok(took) => findings
            .push(Finding::ok(&about, format!("it can be written; a commit takes {:.1} ms", took.as_secs_f64() * 1e3))),
        Err(problem) => {
            let text = format!("{} cannot be written: {problem}", existing.display());
            findings.push(Finding::error(
                &about,
                text,
                "give it to the node's user (chown), or choose another directory",
            ));
        }
    }
    if let Ok(disk) = rustix::fs::statvfs(existing) {
        let free = disk.f_bavail.saturating_mul(disk.f_frsize);
        let text = format!("{:.1} GB are free", free as f64 / 1e9);
        findings.push(match free < FREE_MIN {
            false => Finding::ok(&about, text),
            true => Finding::warning(
                &about,
                text,
                "free disk space: a node with a full disk keeps no ledger and takes no role",
            ),
        });
    }
    findings
}

/// Measures the time of a small write with a disk sync.
fn sync_time(folder: &Path) -> std::io::Result<Duration> {
    let file = folder.join(format!(".consort-doctor-{}", std::process::id()));
    let began = Instant::now();
    let wrote = || {
        let mut to = fs::OpenOptions::new().write(true).create_new(true).open(&file)?;
        to.write_all(&[0; 4096])?;
        to.sync_all()
    };
    let wrote = wrote();
    let took = began.elapsed();
    let _ = fs::remove_file(&file);
    wrote.map(|()| took)
}

/// Checks that the node's ports are available.
pub(super) fn check_ports(listen: Option<Vec<String>>, pages: &[(&'static str, SocketAddr)]) -> Vec<Finding> {
    let mut findings = Vec::new();
    for address in listen.unwrap_or_default() {
        let place = address.split_once('/').map_or(address.as_str(), |(_, place)| place);
        match place.to_socket_addrs().map(|mut all| all.next()) {
            Ok(Some(at)) => {
                findings.push(port(&format!("listen {address}"), at));
                findings.extend(open_to_all(&address, at));
            }
            Ok(None) | Err(_) => {
                let advice = "use an address of this machine, or 0.0.0.0 for all addresses";
                findings.push(Finding::error(format!("listen {address}"), "there is no such host", advice));
            }
        }
    }
    findings.extend(pages.iter().map(|(what, at)| port(&format!("{what} {at}"), *at)));
    findings
}

fn port(about: &str, at: SocketAddr) -> Finding {
    match TcpListener::bind(at) {
        Ok(_) => Finding::ok(about, "the port is free"),
        Err(problem) if problem.kind() == ErrorKind::AddrInUse => {
            let advice = format!("if it is not this node, find the process (ss -ltnp 'sport = :{}')", at.port());
            Finding::warning(about, "another process listens there", advice)
        }
        Err(problem) => {
            Finding::error(about, problem, "use an address of this machine, and a port that the user may open")
        }
    }
}

/// Without certificates every node that reaches the address becomes part of the fleet.
fn open_to_all(address: &str, at: SocketAddr) -> Option<Finding> {
    (address.starts_with("tcp/") && !at.ip().is_loopback()).then(|| {
        let text = "the fleet is open: every node that reaches this address becomes part of it";
        let advice = "give the fleet certificates (consort cert), or restrict access to this network";
        Finding::warning(format!("listen {address}"), text, advice)
    })
}
