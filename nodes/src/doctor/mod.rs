//! What may keep a node from its fleet, looked for one by one: files, clock, disk, ports, certificates, links, and what the
//! fleet itself says. Each finding says what to do about it.

mod credentials;
mod fleet;
mod links;
mod machine;

use crate::check::{self, FileKind};
use crate::client::ClientFlags;
use crate::config::{BusConfig, Diagnostics, RobotConfig, StationConfig, WorldConfig, load};
use consort_protocol::ids::{FleetId, NodeId};
use serde::Serialize;
use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// How a matter stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// It is as it should be.
    Ok,
    /// It will be a problem, or may be one.
    Warning,
    /// It keeps the node from its fleet, or the fleet from its work.
    Error,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Severity::Ok => "ok",
            Severity::Warning => "warning",
            Severity::Error => "error",
        })
    }
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How it stands.
    pub state: Severity,
    /// What was looked at: `clock`, `link tls/192.0.2.7:7447`.
    pub about: String,
    /// What was found.
    pub says: String,
    /// What to do, if anything is to be done.
    pub advice: Option<String>,
}

impl Finding {
    fn ok(about: impl fmt::Display, says: impl fmt::Display) -> Finding {
        Finding { state: Severity::Ok, about: about.to_string(), says: says.to_string(), advice: None }
    }

    fn warning(about: impl fmt::Display, says: impl fmt::Display, advice: impl fmt::Display) -> Finding {
        let advice = Some(advice.to_string());
        Finding { state: Severity::Warning, about: about.to_string(), says: says.to_string(), advice }
    }

    fn error(about: impl fmt::Display, says: impl fmt::Display, advice: impl fmt::Display) -> Finding {
        Finding { state: Severity::Error, ..Finding::warning(about, says, advice) }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:7}  {}: {}", self.state, self.about, self.says)?;
        match &self.advice {
            Some(advice) => write!(f, "\n         → {advice}"),
            None => Ok(()),
        }
    }
}

/// Whose troubles are looked for: a node by its file, or a client by its flags.
pub struct DiagnosisTarget {
    /// The node's name; none for a client.
    node: Option<NodeId>,
    fleet: FleetId,
    bus: BusConfig,
    data_dir: Option<PathBuf>,
    /// Where it serves pages, and what they are.
    pages: Vec<(&'static str, SocketAddr)>,
    client_flags: ClientFlags,
}

impl DiagnosisTarget {
    /// A client, by its flags.
    ///
    /// # Errors
    /// [`crate::exit::Failure::Usage`] of the flags.
    pub fn client(reach: ClientFlags) -> Result<DiagnosisTarget, crate::exit::Failure> {
        let bus = BusConfig { listen: vec![], connect: reach.addresses().to_vec(), certs: reach.certs().cloned() };
        Ok(DiagnosisTarget {
            node: None,
            fleet: reach.fleet()?,
            bus,
            data_dir: None,
            pages: vec![],
            client_flags: reach,
        })
    }

    /// A node, by its file.
    ///
    /// # Errors
    /// [`Problems`] of the file, or of those that it names.
    pub fn node(file: &Path, reach: &ClientFlags) -> Result<DiagnosisTarget, Diagnostics> {
        match check::detect_kind(file)? {
            FileKind::Robot => DiagnosisTarget::of(load::<RobotConfig>(file)?, reach),
            FileKind::World => DiagnosisTarget::of(load::<WorldConfig>(file)?, reach),
            _ => DiagnosisTarget::of(load::<StationConfig>(file)?, reach),
        }
    }

    fn of<C: crate::config::NodeFile>(mut file: C, reach: &ClientFlags) -> Result<DiagnosisTarget, Diagnostics> {
        let node = Some(file.node());
        let around = file.common_mut();
        let fleet = around.fleet.resolve()?.name;
        let pages = [("dashboard", *around.dashboard), ("metrics", around.telemetry.metrics)];
        let pages = pages.into_iter().filter_map(|(what, at)| at.map(|at| (what, at))).collect();
        let mut bus = around.bus.clone();
        bus.certs = reach.certs().cloned().or(bus.certs);
        // The fleet is asked as the node itself would reach it: by its neighbours, or by itself if it runs.
        let asked: Vec<String> =
            bus.listen_addresses().iter().filter(|at| !at.ends_with(":0")).chain(&bus.connect).cloned().collect();
        let reach = reach.with_target(asked, bus.certs.clone(), &fleet);
        Ok(DiagnosisTarget { node, fleet, bus, data_dir: around.data_dir.clone(), pages, client_flags: reach })
    }
}

/// Looks at everything, and tells each finding as soon as it is there.
pub fn run_checks(patient: &DiagnosisTarget, mut tell: impl FnMut(&Finding)) -> Vec<Finding> {
    let mut all = Vec::new();
    let mut note = |findings: Vec<Finding>| {
        findings.iter().for_each(&mut tell);
        all.extend(findings);
    };
    note(machine::check_clock());
    note(machine::check_data_dir(patient.data_dir.as_deref()));
    note(machine::check_ports(patient.node.as_ref().map(|_| patient.bus.listen_addresses()), &patient.pages));
    note(credentials::check_addresses(patient));
    note(credentials::check_certificates(patient));
    note(links::check_links(patient));
    note(fleet::check_fleet(patient));
    all
}
