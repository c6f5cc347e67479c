//! Runs a node on Zenoh, from its start to its end.

use crate::archive::{self, ArchiveFiles};
use crate::config::{ArchiveConfig, CommonConfig, FleetConfig, LogFormat};
use crate::diagnostic::Diagnostics;
use crate::exit::Failure;
use crate::metrics::{MetricSources, Metrics, serve};
use crate::shutdown_signals::ShutdownSignals;
use crate::telemetry::Telemetry;
use crate::trust::NodeCredentials;
use crate::wiring::bus_settings;
use crate::zenoh_panic::{abort_on_zenoh_panic, accept_zenoh_panics};
use crate::{map_loader, output, service_manager};
use consort_bus::clock::Clock;
use consort_bus::trust::SigningBus;
use consort_bus::{Bus, Link, MeteredBus, SharedBus, ZenohBus, suspended};
use consort_dashboard::address::BoundAddress;
use consort_dashboard::admission::Admission;
use consort_dashboard::fleet_model::FloorPlan;
use consort_dashboard::server::{Dashboard, FleetContents};
use consort_fleet::autopilot::DecommissionReport;
use consort_fleet::node::{NodeEnded, NodeHandle, NodeSettings};
use consort_fleet::observe::SharedObserver;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Keys;
use consort_text::count;
use std::io::IsTerminal;
use std::net::SocketAddr;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use tracing::{info, warn};
use tracing_subscriber::EnvFilter;

/// Default log filter: the node's own actions, and only errors and warnings of libraries.
const LOG: &str = "info,zenoh=error,openraft=error,openraft::replication=off,ractor=warn";

/// Interval of the checks whether the machine was suspended.
const SUSPENSION_CHECK_INTERVAL: Duration = Duration::from_millis(100);

/// Poll interval for links.
const LOOK: Duration = Duration::from_millis(500);

/// Time limit for the leadership transfer and the announcement of the departure.
const SHUTDOWN_LIMIT: Duration = Duration::from_secs(5);

/// Creates a multi-threaded runtime, as needed by Zenoh.
///
/// # Errors
/// [`Failure::Unsuccessful`] if the system cannot create threads.
pub(crate) fn build_runtime() -> Result<Runtime, Failure> {
    let runtime = Builder::new_multi_thread().enable_all().build();
    runtime.map_err(|problem| Failure::Unsuccessful(format!("the runtime could not start: {problem}")))
}

/// Returns the log filter of the variable `RUST_LOG`, which Rust programs share.
pub(crate) fn rust_log() -> Option<String> {
    std::env::var("RUST_LOG").ok()
}

/// Starts logging to the standard error with a filter.
///
/// # Errors
/// [`Failure::Usage`] if the filter is invalid.
pub(crate) fn start_log(text: &str, format: LogFormat) -> Result<(), Failure> {
    let filter = EnvFilter::try_new(text).map_err(|problem| {
        let allowed = "allowed is error, warn, info, debug or trace, also by module, as info,consort_fleet=debug";
        Failure::Usage(format!("{text:?} is not a filter for the log: {problem}; {allowed}"))
    })?;
    // A second call, as in tests, keeps the first log. If the reader of the log has gone, a log
    // line is lost and nothing else: reporting it in the log would end the node.
    let log = tracing_subscriber::fmt().log_internal_errors(false);
    let log = log.with_env_filter(filter).with_writer(std::io::stderr);
    let _ = match format {
        LogFormat::Human => log.with_ansi(std::io::stderr().is_terminal()).try_init(),
        LogFormat::Json => log.json().flatten_event(true).with_span_list(false).try_init(),
    };
    Ok(())
}

/// Runs a node until Ctrl-C or SIGTERM, until it has left the fleet, until its standard input
/// closes if requested, or until an actor fails. A coordinator transfers the leadership before it
/// ends. `settings` is called once, within the runtime; `fleet` is the resolved fleet of `common`.
///
/// # Errors
/// [`Failure::Usage`] if it cannot start as configured, [`Failure::Unsuccessful`] if it fails.
pub fn run_node(
    until_stdin_closes: bool,
    common: &CommonConfig<'_>,
    fleet: &FleetConfig,
    settings: impl FnOnce() -> Result<NodeSettings, Diagnostics>,
) -> Result<(), Failure> {
    let telemetry = &common.telemetry;
    start_log(telemetry.log.as_deref().unwrap_or(LOG), telemetry.log_format)?;
    abort_on_zenoh_panic();
    let runtime = build_runtime()?;
    let ended = runtime.block_on(run_until_end(until_stdin_closes, common, fleet, settings));
    // Tasks that still run or hang end with the process.
    runtime.shutdown_background();
    ended
}

async fn run_until_end(
    until_stdin_closes: bool,
    common: &CommonConfig<'_>,
    fleet: &FleetConfig,
    settings: impl FnOnce() -> Result<NodeSettings, Diagnostics>,
) -> Result<(), Failure> {
    let CommonConfig { data_dir, telemetry: telemetry_config, bus, dashboard, archive, .. } = common;
    // Created before everything else, so that an early signal is not lost.
    let mut signals = ShutdownSignals::open()?;
    let page = match dashboard {
        Some(at) => Some((bind("--dashboard", *at).await?, FloorPlan::new(&map_loader::load(&fleet.map)?))),
        None => None,
    };
    let metrics = match telemetry_config.metrics {
        Some(at) => Some(bind("--metrics", at).await?),
        None => None,
    };
    let mut settings = settings()?;
    let archive = open_archive(*archive, data_dir.as_deref())?;
    let metrics = NodeMetrics::new(metrics, &settings);
    let (telemetry, mut observers) = Telemetry::open(telemetry_config.otlp.as_deref(), &settings)
        .map_err(|problem| Failure::Usage(problem.to_string()))?;
    observers.extend(metrics.observer());
    settings.observer = Some(Arc::new(observers));
    let clock = settings.clock;
    let trust = NodeCredentials::open(bus, data_dir.as_deref(), &settings)?;
    let admission = Admission::for_fleet(&fleet.name, trust.keyring(), clock);
    let name = settings.node.clone();
    let role = common.link_role(&name, fleet).map_err(|problem| Failure::Usage(problem.to_string()))?;
    info!(node = %name, %role, "role towards neighbours");
    let zenoh = ZenohBus::open(bus_settings(bus, fleet, role)).await;
    let zenoh = zenoh.map_err(|problem| Failure::Usage(problem.to_string()))?;
    info!(node = %name, fleet = %fleet.name, id = zenoh.id(), listening = zenoh.listen_addresses().await.join(", "), "open");
    let mut watch = tokio::task::JoinSet::new();
    watch.spawn(log_links(zenoh.clone(), bus.connect.clone()));
    if page.is_some() {
        trust.warn_of_read_only_dashboard();
    }
    let bus = metrics.metered(Arc::new(zenoh.clone()));
    let signing = trust.signing_bus(Arc::clone(&bus), &mut settings).await?;
    let bus = signing.clone().map_or(bus, |signing| -> SharedBus { signing });
    let (on_page, archived, missions) = (Arc::clone(&bus), Arc::clone(&bus), Arc::clone(&settings.fleet.missions));
    let started = NodeHandle::start(settings, bus).await;
    let mut node = started.map_err(|problem| Failure::Unsuccessful(format!("{name} did not start: {problem}")))?;
    info!(node = %name, "started");
    let _dashboard = match page {
        Some((address, plan)) => {
            let contents = FleetContents { plan, dashboards: fleet.dashboards.clone(), missions };
            let dashboard = Dashboard::open(address, admission.clone(), on_page, &fleet.name, name.as_str(), contents);
            output::line(format_args!("dashboard: {}", dashboard.url()))?;
            Some(dashboard)
        }
        None => None,
    };
    if let Some(files) = archive {
        watch.spawn(archive::follow(files, archived, Keys::new(&fleet.name), node.replica.clone(), clock));
    }
    metrics.serve(&node, signing, clock, admission, &mut watch);
    telemetry.set_cluster(node.membership.clone());
    service_manager::ready();
    watch.spawn(service_manager::run_watchdog(zenoh.clone(), Keys::new(&fleet.name), name.clone()));

    let end = tokio::select! {
        end = wait_for_end(&mut node, &mut signals, until_stdin_closes) => end,
        time = machine_suspended() => {
            warn!(node = %name, "the machine was suspended for {:.1} s; restarting", time.as_secs_f64());
            return Err(restart());
        }
    };
    service_manager::stopping();
    let end = end.map_err(|cause| Failure::Unsuccessful(format!("{name} stopped: {cause}")))?;
    info!(node = %name, signal = end.word(), "stops");
    let shutdown = async {
        end.of(node, &name).await;
        telemetry.shut_down().await;
        accept_zenoh_panics();
        zenoh.close().await
    };
    match tokio::time::timeout(SHUTDOWN_LIMIT, shutdown).await {
        Ok(Ok(())) => info!(node = %name, "stopped"),
        Ok(Err(problem)) => warn!(node = %name, %problem, "stopped; the bus did not close cleanly"),
        Err(_) => warn!(node = %name, "stopped; the departure was not announced within {SHUTDOWN_LIMIT:?}"),
    }
    Ok(())
}

/// Reason for the end of a running node.
enum End {
    /// A signal or the end of input, with its name.
    Signal(&'static str),
    /// The node has been decommissioned.
    Left(DecommissionReport),
}

impl End {
    fn word(&self) -> &'static str {
        match self {
            End::Signal(how) => how,
            End::Left(_) => "decommissioned",
        }
    }

    async fn of(self, node: NodeHandle, name: &NodeId) {
        match self {
            End::Signal(_) => node.stop().await,
            End::Left(decommission) => {
                info!(node = %name, successor = decommission.successor.map(tracing::field::display), vote_released = decommission.vote_released,
                    role_released = decommission.role_released, "left");
                node.shut_down().await;
            }
        }
    }
}

/// Waits until the node is to end; an error with the cause if an actor failed.
async fn wait_for_end(
    node: &mut NodeHandle,
    signals: &mut ShutdownSignals,
    until_stdin_closes: bool,
) -> Result<End, NodeEnded> {
    tokio::select! {
        signal = signals.wait() => Ok(End::Signal(signal)),
        () = stdin_closed(until_stdin_closes) => Ok(End::Signal("end of input")),
        ended = node.ended_or_decommissioned() => ended.map(End::Left),
    }
}

/// Waits until the machine was suspended; returns for how long.
async fn machine_suspended() -> Duration {
    loop {
        tokio::time::sleep(SUSPENSION_CHECK_INTERVAL).await;
        let time = suspended();
        if !time.is_zero() {
            return time;
        }
    }
}

/// Replaces this process by a new run of the program with the same arguments, as if it had been
/// killed: to the rest of the fleet this node was dead, and nothing that it remembers may still hold.
fn restart() -> Failure {
    let arguments = std::env::args_os().skip(1);
    let problem = match std::env::current_exe() {
        Ok(program) => std::process::Command::new(program).args(arguments).exec(),
        Err(problem) => problem,
    };
    Failure::Unsuccessful(format!("the node could not restart after a suspension of the machine: {problem}"))
}

/// Opens the archive of a station in its data directory, if the station keeps one.
fn open_archive(limits: Option<ArchiveConfig>, data_dir: Option<&Path>) -> Result<Option<ArchiveFiles>, Failure> {
    let Some(limits) = limits else { return Ok(None) };
    let Some(data_dir) = data_dir else {
        warn!("[archive] needs --data-dir: there is no archive");
        return Ok(None);
    };
    let folder = data_dir.join(archive::FOLDER);
    let opened = ArchiveFiles::open(folder.clone(), limits);
    opened.map(Some).map_err(|problem| Failure::Usage(format!("{}: {problem}", folder.display())))
}

async fn bind(flag: &'static str, at: SocketAddr) -> Result<BoundAddress, Failure> {
    Ok(BoundAddress::bind(flag, at).await?)
}

/// The metrics of a node, if requested.
struct NodeMetrics(Option<(BoundAddress, Arc<Metrics>)>);

impl NodeMetrics {
    /// Creates the metrics of a node, served at an address.
    fn new(address: Option<BoundAddress>, settings: &NodeSettings) -> NodeMetrics {
        NodeMetrics(address.map(|address| (address, Metrics::new(&settings.fleet.fleet, &settings.node))))
    }

    fn observer(&self) -> Option<SharedObserver> {
        self.0.as_ref().map(|(_, metrics)| -> SharedObserver { metrics.clone() })
    }

    fn metered(&self, bus: SharedBus) -> SharedBus {
        match &self.0 {
            Some((_, metrics)) => Arc::new(MeteredBus::new(bus, metrics.clone())),
            None => bus,
        }
    }

    fn serve(
        self,
        node: &NodeHandle,
        signing: Option<Arc<SigningBus>>,
        clock: Clock,
        admission: Admission,
        tasks: &mut tokio::task::JoinSet<()>,
    ) {
        let Some((address, metrics)) = self.0 else { return };
        let (replica, knowledge) = (node.replica.clone(), node.knowledge.clone());
        metrics.set_sources(MetricSources { replica, knowledge, signing, clock, since_ms: clock.wall_ms() });
        info!("metrics at http://{}/metrics", address.local_addr());
        tasks.spawn(async move {
            if let Err(problem) = serve(address.with_connection_limit(), metrics, admission).await {
                warn!(%problem, "metrics are no longer served");
            }
        });
    }
}

/// Waits until the standard input is closed, if requested.
async fn stdin_closed(enabled: bool) {
    if !enabled {
        return std::future::pending().await;
    }
    let (closed, closed_rx) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        // A failed read counts as the end of input.
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        let _ = closed.send(());
    });
    let _ = closed_rx.await;
}

/// Logs the node's links whenever they change; without links, logs the tried addresses.
async fn log_links(bus: ZenohBus, connect: Vec<String>) {
    let mut logged: Option<Vec<Link>> = None;
    loop {
        let mut links = bus.links().await;
        links.retain(|link| link.kind != "client"); // clients come and go with every command
        if logged.as_ref() != Some(&links) {
            let status = match (links.len(), connect.is_empty()) {
                (0, true) => {
                    info!("no links yet; waiting for connections");
                    "no links; waiting for connections".to_owned()
                }
                (0, false) => {
                    let trying = connect.join(", ");
                    warn!(trying, "no links; retrying");
                    format!("no links; retrying {trying}")
                }
                (neighbours, _) => {
                    info!(links = describe_links(&links), "linked");
                    format!("linked with {}", count(neighbours, "neighbour", "neighbours"))
                }
            };
            service_manager::status(&status);
            logged = Some(links);
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// Formats the links.
pub(crate) fn describe_links(links: &[Link]) -> String {
    links.iter().map(|link| format!("{} ({})", link.peer, link.kind)).collect::<Vec<_>>().join(", ")
}
