//! Flags shared by several commands.

use super::flag_values::{deadline, key_value, priority, seconds, share, timing};
use crate::config::{
    BusConfig, ConfigFile, FleetConfig, FleetRef, LogFormat, NodeFile, RelaySetting, TelemetryConfig, load_unchecked,
    to_toml,
};
use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::domains;
use crate::exit::Failure;
use crate::wiring::NodeIncarnation;
use crate::{inputs, node_runtime, output};
use consort_fleet::node::NodeSettings;
use consort_protocol::api::SubmitRequest;
use consort_protocol::ids::{FleetId, RoleId};
use consort_protocol::ledger::Priority;
use consort_protocol::mission::Domain;
use consort_protocol::timing::Timing;
use consort_protocol::units::{BatteryShare, Seconds};
use consort_protocol::versions::VersionRange;
use consort_skills::extensions::Extensions;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// Flags for running a node.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Running")]
pub(crate) struct RunFlags {
    /// Log filter for the standard error, warn, info, debug or trace, also by module
    /// (info,consort_fleet=debug)
    #[arg(long, env = "CONSORT_LOG", value_name = "FILTER")]
    pub log: Option<String>,
    /// Log format: text for people, or a JSON object per line for programs. Default: text
    #[arg(long, env = "CONSORT_LOG_FORMAT", value_enum, value_name = "FORMAT")]
    pub log_format: Option<LogFormat>,
    /// Serve metrics for Prometheus at this address, as 127.0.0.1:9464; the page is /metrics.
    /// Default: none
    #[arg(long, env = "CONSORT_METRICS", value_name = "ADDRESS")]
    pub metrics: Option<SocketAddr>,
    /// Send spans of missions to this OpenTelemetry collector, by OTLP over HTTP, as
    /// http://127.0.0.1:4318; needs a program built with the feature `otlp`
    #[arg(long, env = "CONSORT_OTLP", value_name = "URL")]
    pub otlp: Option<String>,
    /// Print the effective configuration as TOML that can be read back, and exit
    #[arg(long)]
    pub print_config: bool,
    /// Exit when the standard input is closed: for a parent process that must not leave child nodes
    /// behind
    #[arg(long, hide = true)]
    pub until_stdin_closes: bool,
}

impl RunFlags {
    /// Overrides the file's values with the given flags.
    fn apply(&self, telemetry: &mut TelemetryConfig) {
        let TelemetryConfig { log, log_format, metrics, otlp } = telemetry;
        *log = self.log.clone().or_else(node_runtime::rust_log).or(log.take());
        set(log_format, self.log_format);
        *metrics = self.metrics.or(*metrics);
        *otlp = self.otlp.clone().or(otlp.take());
    }
}

/// Flags of a requested mission.
#[derive(Debug, clap::Args)]
pub(super) struct MissionFlags {
    /// The mission: the name of a bundled mission (lab-samples, …), a mission file, a file in the flat iHTN form (JSON),
    /// or else the name of a mission that the fleet file of the nodes names
    #[arg(value_name = "FILE|NAME")]
    mission: String,
    /// A parameter of the mission; may be repeated
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = key_value)]
    parameters: Vec<(String, String)>,
    /// Priority among waiting missions: -100 to 100, higher first
    #[arg(long, value_name = "NUMBER", default_value = "0", allow_negative_numbers = true, value_parser = priority)]
    priority: Priority,
    /// Fail the mission if it is not done after so many seconds, by the coordinators' wall clocks.
    /// Default: never
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = deadline)]
    deadline: Option<f64>,
    #[command(flatten)]
    people: PeopleFlags,
}

impl MissionFlags {
    /// Returns the request for the mission.
    ///
    /// # Errors
    /// [`Failure::Usage`] if the mission cannot be read.
    pub(super) fn request(&self) -> Result<SubmitRequest, Failure> {
        Ok(SubmitRequest {
            parameters: self.parameters.iter().cloned().collect(),
            priority: self.priority.get().into(),
            deadline_s: self.deadline,
            ..inputs::mission_request(&self.mission, &self.people.people)?
        })
    }
}

/// Properties of a node that the autopilot uses.
#[derive(Debug, clap::Args)]
pub(super) struct VoterFlags {
    /// The node does not move
    #[arg(long, env = "CONSORT_STATIONARY", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    pub(super) stationary: Option<bool>,
    /// The node runs on mains power
    #[arg(long, env = "CONSORT_MAINS_POWERED", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    pub(super) mains_powered: Option<bool>,
    #[command(flatten)]
    pub(super) vote: MayVoteFlag,
}

/// Flag that permits a node to become a voter.
#[derive(Debug, clap::Args)]
pub(super) struct MayVoteFlag {
    /// The node may keep a copy of the ledger, and coordinate
    #[arg(long, env = "CONSORT_MAY_VOTE", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    pub(super) may_vote: Option<bool>,
}

/// Flags of all node commands.
#[derive(Debug, clap::Args)]
pub(super) struct NodeFlags {
    #[command(flatten)]
    store: StoreFlags,
    #[command(flatten)]
    bus: BusFlags,
    #[command(flatten)]
    dashboard_flags: DashboardFlags,
    #[command(flatten)]
    fleet: FleetFlags,
    #[command(flatten)]
    run: RunFlags,
    /// Read and write wire versions only up to this version, as an earlier release does: for tests
    /// of rolling upgrades
    #[arg(
        long,
        env = "CONSORT_NEWEST_WIRE_VERSION",
        hide = true,
        default_value_t = VersionRange::OWN.newest,
        value_parser = clap::value_parser!(u8).range(i64::from(VersionRange::OWN.oldest)..=i64::from(VersionRange::OWN.newest))
    )]
    newest_wire_version: u8,
}

impl NodeFlags {
    /// Runs the node of a file, with flags overriding the file's values, or prints the effective
    /// configuration. Only the combined values are validated; `path` is the file in messages.
    /// `wire` builds the node's parts, within the runtime, with the fleet's domains.
    ///
    /// # Errors
    /// [`Failure::Usage`] for wrong configuration; [`Failure::Unsuccessful`] if the node fails.
    pub(super) fn run<C: NodeFile + Clone>(
        self,
        path: Option<&Path>,
        mut file: C,
        extensions: Extensions,
        wire: impl FnOnce(&C, &FleetConfig, Extensions, NodeIncarnation) -> Result<NodeSettings, Diagnostics>,
    ) -> Result<(), Failure> {
        let surroundings = file.common_mut();
        self.store.apply(surroundings.data_dir);
        self.bus.apply(surroundings.bus);
        self.run.apply(surroundings.telemetry);
        *surroundings.dashboard = self.dashboard_flags.dashboard.or(*surroundings.dashboard);
        let (fleet, extensions) = self.fleet.resolve(path, surroundings.fleet, extensions)?;
        let domain = &extensions.domain();
        *surroundings.fleet = FleetRef::from(fleet.clone());
        finish_config(path, &mut file, domain)?;
        if self.run.print_config {
            return output::line(to_toml(&file).trim_end());
        }
        let config_for_node = file.clone();
        let surroundings = file.common_mut();
        node_runtime::run_node(self.run.until_stdin_closes, &surroundings, &fleet, || {
            let data_dir = surroundings.data_dir.as_deref();
            let incarnation = NodeIncarnation::start(&config_for_node.node(), &fleet, data_dir)?;
            let settings = wire(&config_for_node, &fleet, extensions, incarnation)?;
            let supported_versions = settings.supported_versions.up_to(self.newest_wire_version);
            Ok(NodeSettings { supported_versions, ..settings })
        })
    }
}

/// Flag of missions in the flat iHTN form.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct PeopleFlags {
    /// For a mission in the flat iHTN form (JSON): an agent that is a person, in addition to those of
    /// the domain; may be repeated. All other agents are robots
    #[arg(long = "person", value_name = "NAME")]
    pub(crate) people: Vec<RoleId>,
}

/// Flags of the dashboard.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Dashboard")]
struct DashboardFlags {
    /// Serve the dashboard at this address, as 127.0.0.1:8088; port 0 selects any free port. The
    /// address is printed. In an open fleet every client that reaches the address may submit and
    /// cancel missions
    #[arg(long, env = "CONSORT_DASHBOARD", value_name = "HOST:PORT")]
    dashboard: Option<SocketAddr>,
}

/// Flags of the node's store.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Store")]
struct StoreFlags {
    /// Directory for the node's copy of the ledger, its vote, and its robot's checkpoint; created
    /// if it does not exist. Without it all state is lost when the node ends, and the node returns
    /// as a new member
    #[arg(long, env = "CONSORT_DATA_DIR", value_name = "DIR")]
    data_dir: Option<PathBuf>,
}

impl StoreFlags {
    /// Overrides the file's value with the given flag.
    fn apply(self, data_dir: &mut Option<PathBuf>) {
        *data_dir = self.data_dir.or(data_dir.take());
    }
}

/// Flags of the network.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Network")]
struct BusFlags {
    /// Address to listen on, as tcp/0.0.0.0:7447 (tls/… with --certs); may be repeated. Default:
    /// loopback, any free port
    #[arg(long, env = "CONSORT_LISTEN", value_delimiter = ',', value_name = "ADDRESS")]
    listen: Vec<String>,
    /// Neighbour to connect to, as tcp/192.0.2.7:7447; may be repeated. Two to four are recommended
    #[arg(long, env = "CONSORT_CONNECT", value_delimiter = ',', value_name = "ADDRESS")]
    connect: Vec<String>,
    /// Folder with the node's certificate and key, as written by `consort cert`. Links are then
    /// encrypted (tls/…), and nodes without a certificate of the fleet are rejected
    #[arg(long, env = "CONSORT_CERTS", value_name = "DIR")]
    certs: Option<PathBuf>,
    /// Relay messages for other nodes, or be a client of the neighbours. Default: auto
    #[arg(long, env = "CONSORT_RELAY", value_enum, value_name = "WHEN")]
    relay: Option<RelaySetting>,
}

impl BusFlags {
    /// Overrides the file's values with the given flags.
    fn apply(self, bus: &mut BusConfig) {
        if !self.listen.is_empty() {
            bus.listen = self.listen;
        }
        if !self.connect.is_empty() {
            bus.connect = self.connect;
        }
        bus.certs = self.certs.or(bus.certs.take());
        set(&mut bus.relay, self.relay);
    }
}

/// Flags that must be the same for all nodes of a fleet.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Fleet (the same for all its nodes)")]
struct FleetFlags {
    /// The fleet file
    #[arg(long, env = "CONSORT_FLEET", value_name = "FILE")]
    fleet: Option<PathBuf>,
    /// The fleet's name
    #[arg(long, env = "CONSORT_FLEET_NAME", value_name = "NAME")]
    fleet_name: Option<FleetId>,
    /// The map: the name of a bundled map (hospital), or a file
    #[arg(long, env = "CONSORT_MAP", value_name = "NAME|FILE")]
    map: Option<String>,
    /// Number of nodes with may_vote that must have met before the ledger is created
    #[arg(long, env = "CONSORT_BOOTSTRAP_EXPECT", value_name = "COUNT")]
    bootstrap_expect: Option<usize>,
    /// Timing preset of failure detection and elections: lan or wifi
    #[arg(long, env = "CONSORT_TIMING", value_name = "PRESET", value_parser = timing)]
    timing: Option<Timing>,
    /// Target number of voters: 1, 3, 5, 7 or 9
    #[arg(long, env = "CONSORT_VOTERS", value_name = "COUNT")]
    voters: Option<usize>,
    /// Planned number of nodes. From 30 on only stations, worlds and nodes on mains power relay
    #[arg(long, env = "CONSORT_PLANNED_NODES", value_name = "COUNT")]
    planned_nodes: Option<usize>,
    /// Time that a voter must be unreachable until another replaces it
    #[arg(long, env = "CONSORT_DEAD_AFTER_MS", value_name = "MS")]
    dead_after_ms: Option<u64>,
    /// Time that a silent neighbour still counts as linked
    #[arg(long, env = "CONSORT_LINK_LEASE_MS", value_name = "MS")]
    link_lease_ms: Option<u64>,
    /// Time without a finished step after which a role is taken from its robot, in seconds; 0 for
    /// never
    #[arg(long, env = "CONSORT_STALL_AFTER_S", value_name = "SECONDS")]
    stall_after_s: Option<u64>,
    /// Maximum time of a robot's part by its own estimate
    #[arg(long, env = "CONSORT_TIME_LIMIT_S", value_name = "SECONDS", value_parser = seconds)]
    time_limit_s: Option<Seconds>,
    /// Charge that must be left after a mission, as a share
    #[arg(long, env = "CONSORT_CHARGE_MIN", value_name = "SHARE", value_parser = share)]
    charge_min: Option<BatteryShare>,
    /// Maximum number of active missions; 0 for no limit
    #[arg(long, env = "CONSORT_MISSIONS_MAX", value_name = "COUNT")]
    missions_max: Option<usize>,
    /// Maximum sustained number of requests per second; 0 for no limit
    #[arg(long, env = "CONSORT_REQUESTS_PER_S", value_name = "COUNT")]
    requests_per_s: Option<u32>,
    /// Time after its last contact with the coordinator at which a robot suspends its role
    #[arg(long, env = "CONSORT_LEASE_MS", value_name = "MS")]
    lease_ms: Option<u64>,
    /// Additional time that the coordinator waits before it gives the role to another robot
    #[arg(long, env = "CONSORT_GRACE_MS", value_name = "MS")]
    grace_ms: Option<u64>,
    /// Time that an auction waits for a member that does not answer
    #[arg(long, env = "CONSORT_WINDOW_MS", value_name = "MS")]
    window_ms: Option<u64>,
}

impl FleetFlags {
    /// Combines the fleet of the flags and of a node's file at `path`, and reads its domains.
    ///
    /// # Errors
    /// [`Failure::Usage`] for an invalid fleet.
    fn resolve(
        self,
        path: Option<&Path>,
        named: &FleetRef,
        extensions: Extensions,
    ) -> Result<(FleetConfig, Extensions), Failure> {
        let mut fleet = match &self.fleet {
            Some(path) => load_unchecked(path)?,
            None => named.resolve_unchecked()?,
        };
        let extensions = domains::with_files(extensions, &fleet.domains)?;
        set(&mut fleet.name, self.fleet_name);
        set(&mut fleet.map, self.map);
        set(&mut fleet.bootstrap_expect, self.bootstrap_expect);
        set(&mut fleet.timing, self.timing);
        set(&mut fleet.voters, self.voters);
        fleet.planned_nodes = self.planned_nodes.or(fleet.planned_nodes);
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
        finish_config(self.fleet.as_deref().or(path), &mut fleet, &extensions.domain())?;
        Ok((fleet, extensions))
    }
}

/// Replaces a value if another is given.
pub(super) fn set<T>(place: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *place = given;
    }
}

/// Resolves paths of flags relative to the current directory, and validates the result. `path` is
/// the file that the flags override.
///
/// # Errors
/// [`Failure::Usage`] for an invalid configuration.
fn finish_config<C: ConfigFile>(path: Option<&Path>, config: &mut C, domain: &Domain) -> Result<(), Failure> {
    let here = std::env::current_dir().unwrap_or_else(|_| PathBuf::from("/"));
    config.resolve_paths(Path::new(&here));
    let file = path.map(|path| path.display().to_string()).unwrap_or_default();
    let problems = config.validate(domain).into_iter().map(|problem| Diagnostic::for_file(&file, problem)).collect();
    Ok(Diagnostics::into_result(problems)?)
}
