//! Flags that several commands share.

use crate::config::{
    BusConfig, ConfigFile, Diagnostics, FleetConfig, FleetRef, LogFormat, NodeFile, TelemetryConfig, load, to_toml,
};
use crate::exit::Failure;
use crate::wiring::NodeIncarnation;
use crate::{node_runtime, output};
use consort_actors::node::NodeSettings;
use consort_actors::timing::Timing;
use consort_protocol::ids::FleetId;
use consort_protocol::units::{BatteryShare, Seconds};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// Reads `NAME=VALUE`.
pub(super) fn key_value(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("expected NAME=VALUE, as room='IC Room 6'".to_owned()),
    }
}

/// Reads a quantity or name of the protocol's.
pub(super) fn share(text: &str) -> Result<BatteryShare, String> {
    quantity(text, BatteryShare::new)
}

pub(super) fn seconds(text: &str) -> Result<Seconds, String> {
    quantity(text, Seconds::new)
}

pub(super) fn quantity<Q>(
    text: &str,
    new: impl Fn(f64) -> Result<Q, consort_protocol::units::UnitError>,
) -> Result<Q, String> {
    let number: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    new(number).map_err(|problem| problem.to_string())
}

fn timing(text: &str) -> Result<Timing, String> {
    match text {
        "lan" => Ok(Timing::Lan),
        "wifi" => Ok(Timing::Wifi),
        _ => Err("allowed is lan or wifi".to_owned()),
    }
}

/// How a node is run.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Running")]
pub struct RunFlags {
    /// What to log on the standard error: error, warn, info, debug or trace, also by module (info,consort_actors=debug)
    #[arg(long, env = "CONSORT_LOG", value_name = "FILTER")]
    pub log: Option<String>,
    /// How to write the log: for people, or an object a line for programs. Default: for people
    #[arg(long, env = "CONSORT_LOG_FORMAT", value_enum, value_name = "FORMAT")]
    pub log_format: Option<LogFormat>,
    /// Serve metrics for Prometheus at this address, as 127.0.0.1:9464; the page is /metrics. Default: none
    #[arg(long, env = "CONSORT_METRICS", value_name = "ADDRESS")]
    pub metrics: Option<SocketAddr>,
    /// Send spans of missions to this OpenTelemetry collector, by OTLP over HTTP, as http://127.0.0.1:4318; needs a program
    /// that was built with the feature `otlp`
    #[arg(long, env = "CONSORT_OTLP", value_name = "URL")]
    pub otlp: Option<String>,
    /// Print the effective configuration as TOML that can be read back, and do nothing else
    #[arg(long)]
    pub print_config: bool,
    /// End when the standard input is closed: for whoever starts nodes as children and must not leave any behind
    #[arg(long, hide = true)]
    pub until_stdin_closes: bool,
}

impl RunFlags {
    /// Puts what was given in the place of what the file says.
    fn apply(&self, telemetry: &mut TelemetryConfig) {
        let TelemetryConfig { log, log_format, metrics, otlp } = telemetry;
        *log = self.log.clone().or_else(node_runtime::rust_log).or(log.take());
        set(log_format, self.log_format);
        *metrics = self.metrics.or(*metrics);
        *otlp = self.otlp.clone().or(otlp.take());
    }
}

/// What the autopilot is told of a node.
#[derive(Debug, clap::Args)]
pub(super) struct VoterFlags {
    /// Whether it stays where it is
    #[arg(long, env = "CONSORT_STATIONARY", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    pub(super) stationary: Option<bool>,
    /// Whether it lives on mains power
    #[arg(long, env = "CONSORT_MAINS_POWERED", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    pub(super) mains_powered: Option<bool>,
    #[command(flatten)]
    pub(super) vote: MayVoteFlag,
}

/// Whether a node may be a keeper of the ledger at all.
#[derive(Debug, clap::Args)]
pub(super) struct MayVoteFlag {
    /// Whether it may keep a copy of the ledger, and coordinate
    #[arg(long, env = "CONSORT_MAY_VOTE", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    pub(super) may_vote: Option<bool>,
}

/// What the commands of all nodes take.
#[derive(Debug, clap::Args)]
pub(super) struct NodeFlags {
    #[command(flatten)]
    store: StoreFlags,
    #[command(flatten)]
    bus: BusFlags,
    #[command(flatten)]
    page: PageFlags,
    #[command(flatten)]
    fleet: FleetFlags,
    #[command(flatten)]
    run: RunFlags,
}

impl NodeFlags {
    /// Runs the node of a file, with what was given in the place of what the file says; or prints what it would be run with.
    /// `wire` makes its parts, within the runtime.
    ///
    /// # Errors
    /// [`Failure::Usage`] for wrong configuration; [`Failure::Unsuccessful`] if the node fails.
    pub(super) fn run<C: NodeFile + Clone>(
        self,
        mut file: C,
        wire: impl FnOnce(&C, &FleetConfig, NodeIncarnation) -> Result<NodeSettings, Diagnostics>,
    ) -> Result<(), Failure> {
        let surroundings = file.common_mut();
        self.store.apply(surroundings.data_dir);
        self.bus.apply(surroundings.bus);
        self.run.apply(surroundings.telemetry);
        *surroundings.dashboard = self.page.dashboard.or(*surroundings.dashboard);
        let fleet = self.fleet.resolve(surroundings.fleet)?;
        *surroundings.fleet = FleetRef::from(fleet.clone());
        settled(&mut file)?;
        if self.run.print_config {
            return output::line(to_toml(&file).trim_end());
        }
        let wired = file.clone();
        let surroundings = file.common_mut();
        node_runtime::run_node(self.run.until_stdin_closes, &surroundings, &fleet, || {
            let data_dir = surroundings.data_dir.as_deref();
            wire(&wired, &fleet, NodeIncarnation::start(&wired.node(), &fleet, data_dir)?)
        })
    }
}

/// Where a node can be looked into.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Looking in")]
struct PageFlags {
    /// Serve the dashboard at this address, as 127.0.0.1:8088; port 0 for any free one. The address is printed. Whoever can
    /// reach it may submit and cancel missions
    #[arg(long, env = "CONSORT_DASHBOARD", value_name = "HOST:PORT")]
    dashboard: Option<SocketAddr>,
}

/// What a node remembers.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Memory")]
struct StoreFlags {
    /// Directory in which the node keeps its copy of the ledger, its vote, and what its robot is at; created if need be.
    /// Without one it forgets all when it ends, and comes back as a new member
    #[arg(long, env = "CONSORT_DATA_DIR", value_name = "DIR")]
    data_dir: Option<PathBuf>,
}

impl StoreFlags {
    /// Puts what was given in the place of what the file says.
    fn apply(self, data_dir: &mut Option<PathBuf>) {
        *data_dir = self.data_dir.or(data_dir.take());
    }
}

/// Where a node is on the network.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Network")]
struct BusFlags {
    /// Address to listen on, as tcp/0.0.0.0:7447 (tls/… with --certs); may be repeated. Default: loopback, any free port
    #[arg(long, env = "CONSORT_LISTEN", value_delimiter = ',', value_name = "ADDRESS")]
    listen: Vec<String>,
    /// Neighbour to connect to, as tcp/192.0.2.7:7447; may be repeated. Two to four serve well
    #[arg(long, env = "CONSORT_CONNECT", value_delimiter = ',', value_name = "ADDRESS")]
    connect: Vec<String>,
    /// Folder with the node's certificate and key, as `consort cert` makes it. Links are then encrypted (tls/…), and whoever
    /// has no certificate of the fleet gets nowhere
    #[arg(long, env = "CONSORT_CERTS", value_name = "DIR")]
    certs: Option<PathBuf>,
}

impl BusFlags {
    /// Puts what was given in the place of what the file says.
    fn apply(self, bus: &mut BusConfig) {
        if !self.listen.is_empty() {
            bus.listen = self.listen;
        }
        if !self.connect.is_empty() {
            bus.connect = self.connect;
        }
        bus.certs = self.certs.or(bus.certs.take());
    }
}

/// What all nodes of a fleet agree on.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Fleet (the same for all its nodes)")]
struct FleetFlags {
    /// The fleet file
    #[arg(long, env = "CONSORT_FLEET", value_name = "FILE")]
    fleet: Option<PathBuf>,
    /// The fleet's name
    #[arg(long, env = "CONSORT_FLEET_NAME", value_name = "NAME")]
    fleet_name: Option<FleetId>,
    /// The map: the name of one that is shipped (hospital), or a file
    #[arg(long, env = "CONSORT_MAP", value_name = "NAME|FILE")]
    map: Option<String>,
    /// Nodes that may vote and must have met before the ledger is founded
    #[arg(long, env = "CONSORT_BOOTSTRAP_EXPECT", value_name = "COUNT")]
    bootstrap_expect: Option<usize>,
    /// How fast the fleet notices and reacts: lan or wifi
    #[arg(long, env = "CONSORT_TIMING", value_name = "PRESET", value_parser = timing)]
    timing: Option<Timing>,
    /// Voters that the autopilot aims at: 1, 3, 5, 7 or 9
    #[arg(long, env = "CONSORT_VOTERS", value_name = "COUNT")]
    voters: Option<usize>,
    /// How long a voter must be gone until another takes its place
    #[arg(long, env = "CONSORT_DEAD_AFTER_MS", value_name = "MS")]
    dead_after_ms: Option<u64>,
    /// How long a neighbour that says nothing counts as linked
    #[arg(long, env = "CONSORT_LINK_LEASE_MS", value_name = "MS")]
    link_lease_ms: Option<u64>,
    /// After how many seconds a role none of whose steps ends is taken from its robot; 0 for never
    #[arg(long, env = "CONSORT_STALL_AFTER_S", value_name = "SECONDS")]
    stall_after_s: Option<u64>,
    /// Longest time that a robot's part may take by its own estimate
    #[arg(long, env = "CONSORT_TIME_LIMIT_S", value_name = "SECONDS", value_parser = seconds)]
    time_limit_s: Option<Seconds>,
    /// Charge that must be left after a mission, as a share
    #[arg(long, env = "CONSORT_CHARGE_MIN", value_name = "SHARE", value_parser = share)]
    charge_min: Option<BatteryShare>,
    /// Missions that are taken on at once; 0 for no limit
    #[arg(long, env = "CONSORT_MISSIONS_MAX", value_name = "COUNT")]
    missions_max: Option<usize>,
    /// Requests that are taken in a second, in the long run; 0 for no limit
    #[arg(long, env = "CONSORT_REQUESTS_PER_S", value_name = "COUNT")]
    requests_per_s: Option<u32>,
    /// A robot suspends its role this long after its last contact with the coordinator
    #[arg(long, env = "CONSORT_LEASE_MS", value_name = "MS")]
    lease_ms: Option<u64>,
    /// The coordinator waits this much longer before it gives the role to another
    #[arg(long, env = "CONSORT_GRACE_MS", value_name = "MS")]
    grace_ms: Option<u64>,
    /// How long an auction waits for a member that does not answer
    #[arg(long, env = "CONSORT_WINDOW_MS", value_name = "MS")]
    window_ms: Option<u64>,
}

impl FleetFlags {
    /// The fleet that flags and a node's file name together.
    ///
    /// # Errors
    /// [`Failure::Usage`] for what is wrong with it.
    fn resolve(self, named: &FleetRef) -> Result<FleetConfig, Failure> {
        let mut fleet = match &self.fleet {
            Some(path) => load(path)?,
            None => named.resolve()?,
        };
        set(&mut fleet.name, self.fleet_name);
        set(&mut fleet.map, self.map);
        set(&mut fleet.bootstrap_expect, self.bootstrap_expect);
        set(&mut fleet.timing, self.timing);
        set(&mut fleet.voters, self.voters);
        fleet.dead_after_ms = self.dead_after_ms.or(fleet.dead_after_ms);
        fleet.link_lease_ms = self.link_lease_ms.or(fleet.link_lease_ms);
        set(&mut fleet.stall_after_s, self.stall_after_s);
        fleet.limits.time_s = self.time_limit_s.or(fleet.limits.time_s);
        set(&mut fleet.limits.charge_min, self.charge_min);
        set(&mut fleet.requests.missions, self.missions_max);
        set(&mut fleet.requests.per_s, self.requests_per_s);
        set(&mut fleet.lease.lease_ms, self.lease_ms);
        set(&mut fleet.lease.grace_ms, self.grace_ms);
        fleet.auction.window_ms = self.window_ms.or(fleet.auction.window_ms);
        settled(&mut fleet)?;
        Ok(fleet)
    }
}

/// Puts what was given in the place of what was there.
pub(super) fn set<T>(place: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *place = given;
    }
}

/// Makes paths that flags gave relative to where the command runs, and checks the whole once more.
///
/// # Errors
/// [`Failure::Usage`] for what is wrong.
fn settled<C: ConfigFile>(config: &mut C) -> Result<(), Failure> {
    let here = std::env::current_dir().unwrap_or_else(|_| PathBuf::from("/"));
    config.resolve_paths(Path::new(&here));
    let problems = config.validate();
    if problems.is_empty() { Ok(()) } else { Err(Failure::Usage(problems.join("\n"))) }
}
