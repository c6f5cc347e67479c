//! What a node finds on its machine: clock, disk and ports.

use super::Finding;
use crate::certs::unix_time;
use std::fs;
use std::io::{ErrorKind, Write};
use std::net::{SocketAddr, TcpListener, ToSocketAddrs};
use std::path::Path;
use std::time::{Duration, Instant};

/// No clock that is right says it is earlier: 2026-01-01.
const NOT_BEFORE: Duration = Duration::from_secs(1_767_225_600);

/// Below this a ledger that grows fills the disk within days: a guess.
const FREE_MIN: u64 = 1 << 30;

/// A commit waits for the disk: slower than this, elections go wrong (a follower answers within half of it on a LAN).
const SYNC_MAX: Duration = Duration::from_millis(50);

/// Whether the clock can be right.
pub(super) fn check_clock() -> Vec<Finding> {
    if unix_time() >= NOT_BEFORE {
        return vec![Finding::ok("clock", "it is set")];
    }
    let says = format!("it says that {} days have passed since 1970", unix_time().as_secs() / 86_400);
    vec![Finding::error("clock", says, "set it, and have it kept right (timedatectl set-ntp true)")]
}

/// Whether a directory can keep a ledger.
pub(super) fn check_data_dir(folder: Option<&Path>) -> Vec<Finding> {
    let Some(folder) = folder else { return vec![] };
    let about = format!("data directory {}", folder.display());
    // It is made when the node starts: what counts until then is where it will be.
    let there = folder.ancestors().find(|ancestor| ancestor.exists()).unwrap_or(Path::new("/"));
    let mut findings = Vec::new();
    match written(there) {
        Ok(took) if took > SYNC_MAX => {
            let says = format!("a write that is to last takes {} ms", took.as_millis());
            let advice =
                "every commit waits for that: use a faster disk, or a node elsewhere as voter (may_vote = false here)";
            findings.push(Finding::warning(&about, says, advice));
        }
        Ok(took) => findings
            .push(Finding::ok(&about, format!("can be written, a commit takes {:.1} ms", took.as_secs_f64() * 1e3))),
        Err(problem) => {
            let says = format!("{} cannot be written: {problem}", there.display());
            findings.push(Finding::error(
                &about,
                says,
                "give it to the user that the node runs as (chown), or name another",
            ));
        }
    }
    if let Ok(disk) = rustix::fs::statvfs(there) {
        let free = disk.f_bavail.saturating_mul(disk.f_frsize);
        let says = format!("{:.1} GB are free", free as f64 / 1e9);
        findings.push(match free < FREE_MIN {
            false => Finding::ok(&about, says),
            true => {
                Finding::warning(&about, says, "make room: a node whose disk is full keeps no ledger and takes no role")
            }
        });
    }
    findings
}

/// How long a small write takes until it is on the disk.
fn written(folder: &Path) -> std::io::Result<Duration> {
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

/// Whether the ports that a node is to listen on can be had.
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
                let advice = "write an address of this machine, or 0.0.0.0 for all of them";
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
            let advice =
                format!("if it is not this node that runs already, find who it is (ss -ltnp 'sport = :{}')", at.port());
            Finding::warning(about, "somebody listens there", advice)
        }
        Err(problem) => {
            Finding::error(about, problem, "name an address of this machine, and a port that its user may open")
        }
    }
}

/// Whoever reaches a node without certificates is part of the fleet.
fn open_to_all(address: &str, at: SocketAddr) -> Option<Finding> {
    (address.starts_with("tcp/") && !at.ip().is_loopback()).then(|| {
        let says = "whoever can reach this address is part of the fleet: nobody is asked who they are";
        let advice = "give the fleet certificates (consort cert), or see to it that nobody else is on this network";
        Finding::warning(format!("listen {address}"), says, advice)
    })
}
