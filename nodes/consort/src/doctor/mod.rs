//! Checks for the reasons why a node does not reach its fleet: files, clock, disk, ports,
//! certificates, links, and the health of the fleet itself. Each finding has advice.

mod credentials;
mod fleet;
mod links;
mod machine;
mod relay;

use crate::check::{self, FileKind};
use crate::client::ClientFlags;
use crate::config::{BusConfig, RobotConfig, StationConfig, WorldConfig};
use crate::diagnostic::Diagnostics;
use consort_protocol::ids::{FleetId, NodeId};
use consort_skills::extensions::Extensions;
use relay::RoleTarget;
use serde::Serialize;
use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Severity {
    /// No problem.
    Ok,
    /// A future or possible problem.
    Warning,
    /// A problem that keeps the node from its fleet, or the fleet from its work.
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

/// Result of a check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Finding {
    /// Severity.
    pub state: Severity,
    /// Subject of the check: `clock`, `link tls/192.0.2.7:7447`.
    pub about: String,
    /// Result.
    pub text: String,
    /// Advice, if any action is needed.
    pub advice: Option<String>,
}

impl Finding {
    fn ok(about: impl fmt::Display, text: impl fmt::Display) -> Finding {
        Finding { state: Severity::Ok, about: about.to_string(), text: text.to_string(), advice: None }
    }

    fn warning(about: impl fmt::Display, text: impl fmt::Display, advice: impl fmt::Display) -> Finding {
        let advice = Some(advice.to_string());
        Finding { state: Severity::Warning, about: about.to_string(), text: text.to_string(), advice }
    }

    fn error(about: impl fmt::Display, text: impl fmt::Display, advice: impl fmt::Display) -> Finding {
        Finding { state: Severity::Error, ..Finding::warning(about, text, advice) }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:7}  {}: {}", self.state, self.about, self.text)?;
        match &self.advice {
            Some(advice) => write!(f, "\n         → {advice}"),
            None => Ok(()),
        }
    }
}

/// Target of the checks: a node by its file, or a client by its flags.
pub(crate) struct DiagnosisTarget {
    /// The node's name; `None` for a client.
    node: Option<NodeId>,
    fleet: FleetId,
    bus: BusConfig,
    /// The node's role towards its neighbours; `None` for a client.
    role: Option<RoleTarget>,
    data_dir: Option<PathBuf>,
    /// Addresses of its HTTP pages, with their names.
    pages: Vec<(&'static str, SocketAddr)>,
    client_flags: ClientFlags,
}

impl DiagnosisTarget {
    /// Creates the target of a client, by its flags.
    ///
    /// # Errors
    /// [`crate::exit::Failure::Usage`] of the flags.
    pub(crate) fn client(client_flags: ClientFlags) -> Result<DiagnosisTarget, crate::exit::Failure> {
        let bus = BusConfig {
            connect: client_flags.addresses().to_vec(),
            certs: client_flags.certs().cloned(),
            ..BusConfig::default()
        };
        Ok(DiagnosisTarget {
            node: None,
            fleet: client_flags.fleet()?,
            bus,
            role: None,
            data_dir: None,
            pages: vec![],
            client_flags,
        })
    }

    /// Creates the target of a node, by its file.
    ///
    /// # Errors
    /// [`Diagnostics`] of the file, or of files that it references.
    pub(crate) fn node(
        file: &Path,
        client_flags: &ClientFlags,
        extensions: Extensions,
    ) -> Result<DiagnosisTarget, Diagnostics> {
        match check::detect_kind(file)? {
            FileKind::Robot => DiagnosisTarget::of::<RobotConfig>(file, client_flags, extensions),
            FileKind::World => DiagnosisTarget::of::<WorldConfig>(file, client_flags, extensions),
            _ => DiagnosisTarget::of::<StationConfig>(file, client_flags, extensions),
        }
    }

    fn of<C: crate::config::NodeFile>(
        file: &Path,
        client_flags: &ClientFlags,
        extensions: Extensions,
    ) -> Result<DiagnosisTarget, Diagnostics> {
        let (mut file, fleet, _): (C, _, _) = check::node_file(file, extensions)?;
        let node = file.node();
        let common = file.common_mut();
        let role = RoleTarget {
            role: common.link_role(&node, &fleet),
            may_vote: common.may_vote,
            planned_nodes: fleet.planned_nodes,
        };
        let fleet = fleet.name;
        let pages = [("dashboard", *common.dashboard), ("metrics", common.telemetry.metrics)];
        let pages = pages.into_iter().filter_map(|(what, at)| at.map(|at| (what, at))).collect();
        let mut bus = common.bus.clone();
        bus.certs = client_flags.certs().cloned().or(bus.certs);
        // The fleet is queried as the node itself would reach it: by its neighbours, or by itself
        // if it runs.
        let addresses: Vec<String> =
            bus.listen_addresses().iter().filter(|at| !at.ends_with(":0")).chain(&bus.connect).cloned().collect();
        let client_flags = client_flags.with_target(addresses, bus.certs.clone(), &fleet);
        let data_dir = common.data_dir.clone();
        Ok(DiagnosisTarget { node: Some(node), fleet, bus, role: Some(role), data_dir, pages, client_flags })
    }
}

/// Runs all checks, and passes each finding to `report` as soon as it is available.
pub(crate) fn run_checks(target: &DiagnosisTarget, mut report: impl FnMut(&Finding)) -> Vec<Finding> {
    let mut all = Vec::new();
    let mut add = |findings: Vec<Finding>| {
        findings.iter().for_each(&mut report);
        all.extend(findings);
    };
    add(machine::check_clock());
    add(machine::check_data_dir(target.data_dir.as_deref()));
    let listening = target.role.as_ref().filter(|role| role.accepts_links());
    add(machine::check_ports(listening.map(|_| target.bus.listen_addresses()), &target.pages));
    add(target.role.as_ref().map(RoleTarget::check).unwrap_or_default());
    add(credentials::check_addresses(target));
    add(credentials::check_certificates(target));
    add(links::check_links(target));
    add(fleet::check_fleet(target));
    all
}
