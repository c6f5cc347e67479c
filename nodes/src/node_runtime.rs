//! A node on Zenoh, from its start until it is told to end.

use crate::address::BoundAddress;
use crate::admission::Admission;
use crate::config::{CommonConfig, Diagnostics, FleetConfig, LogFormat};
use crate::dashboard::Dashboard;
use crate::exit::Failure;
use crate::fleet_model::FloorPlan;
use crate::metrics::{MetricSources, Metrics, serve};
use crate::shutdown_signals::ShutdownSignals;
use crate::telemetry::Telemetry;
use crate::trust::NodeCredentials;
use crate::wiring::bus_settings;
use crate::{map_loader, output, service_manager};
use consort_actors::autopilot::DecommissionReport;
use consort_actors::bus::{Bus, Link, MeteredBus, SharedBus, ZenohBus};
use consort_actors::clock::Clock;
use consort_actors::node::{NodeHandle, NodeSettings};
use consort_actors::observe::SharedObserver;
use consort_protocol::count::count;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Keys;
use std::io::IsTerminal;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use tracing::{info, warn};
use tracing_subscriber::EnvFilter;

/// What is logged where nothing else is said: our own doings, and only the troubles of others.
const LOG: &str = "info,zenoh=error,openraft=error,openraft::replication=off,ractor=warn";

/// How often a node looks at its links.
const LOOK: Duration = Duration::from_millis(500);

/// How long a node may take to hand over and say goodbye.
const GOODBYE: Duration = Duration::from_secs(5);

/// A runtime such as Zenoh needs.
///
/// # Errors
/// [`Failure::Unsuccessful`] if the system gives no threads.
pub fn build_runtime() -> Result<Runtime, Failure> {
    let runtime = Builder::new_multi_thread().enable_all().build();
    runtime.map_err(|problem| Failure::Unsuccessful(format!("the runtime could not start: {problem}")))
}

/// What is to be logged by the variable that programs in Rust share, if it is set.
pub fn rust_log() -> Option<String> {
    std::env::var("RUST_LOG").ok()
}

/// Sends what passes a filter to the standard error.
///
/// # Errors
/// [`Failure::Usage`] if the filter is none.
pub fn start_log(text: &str, format: LogFormat) -> Result<(), Failure> {
    let filter = EnvFilter::try_new(text).map_err(|problem| {
        let allowed = "allowed is error, warn, info, debug or trace, also by module, as info,consort_actors=debug";
        Failure::Usage(format!("{text:?} is not a filter for the log: {problem}; {allowed}"))
    })?;
    // A second call, as tests may make, keeps the first log.
    // Where nobody reads the log any more a line of it is lost, and nothing else: to say so there too would end the node.
    let log = tracing_subscriber::fmt().log_internal_errors(false);
    let log = log.with_env_filter(filter).with_writer(std::io::stderr);
    let _ = match format {
        LogFormat::Human => log.with_ansi(std::io::stderr().is_terminal()).try_init(),
        LogFormat::Json => log.json().flatten_event(true).with_span_list(false).try_init(),
    };
    Ok(())
}

/// Runs a node until Ctrl-C or SIGTERM, until it has left the fleet, until its standard input closes if that is asked for,
/// or until an actor of it fails. If it coordinates, it hands over before it goes. `settings` is called once, within the runtime;
/// the fleet is the one that `surroundings` name.
///
/// # Errors
/// [`Failure::Usage`] if it cannot start as configured, [`Failure::Unsuccessful`] if it fails.
pub fn run_node(
    until_stdin_closes: bool,
    surroundings: &CommonConfig<'_>,
    fleet: &FleetConfig,
    settings: impl FnOnce() -> Result<NodeSettings, Diagnostics>,
) -> Result<(), Failure> {
    let telemetry = &surroundings.telemetry;
    start_log(telemetry.log.as_deref().unwrap_or(LOG), telemetry.log_format)?;
    let runtime = build_runtime()?;
    let ended = runtime.block_on(until_told(until_stdin_closes, surroundings, fleet, settings));
    // Whatever still runs, or hangs, ends with the process.
    runtime.shutdown_background();
    ended
}

async fn until_told(
    until_stdin_closes: bool,
    surroundings: &CommonConfig<'_>,
    fleet: &FleetConfig,
    settings: impl FnOnce() -> Result<NodeSettings, Diagnostics>,
) -> Result<(), Failure> {
    let CommonConfig { telemetry: told, bus, dashboard, .. } = surroundings;
    // Before anything is started: a signal that comes early is not lost.
    let mut signals = ShutdownSignals::open()?;
    let page = match dashboard {
        Some(at) => Some((take("--dashboard", *at).await?, FloorPlan::new(&map_loader::load(&fleet.map)?))),
        None => None,
    };
    let metrics = match told.metrics {
        Some(at) => Some(take("--metrics", at).await?),
        None => None,
    };
    let mut settings = settings()?;
    let metrics = Metering::new(metrics, &settings);
    let (telemetry, mut observers) = Telemetry::open(told.otlp.as_deref(), &settings).map_err(Failure::Usage)?;
    observers.extend(metrics.observer());
    settings.observer = Some(Arc::new(observers));
    let clock = settings.clock;
    let trust = NodeCredentials::open(bus, &settings)?;
    let admission = Admission::for_fleet(&fleet.name, trust.keyring(), clock);
    let zenoh = ZenohBus::open(bus_settings(bus, fleet)).await;
    let zenoh = zenoh.map_err(|problem| Failure::Usage(problem.to_string()))?;
    let name = settings.node.clone();
    info!(node = %name, fleet = %fleet.name, id = zenoh.id(), listening = zenoh.listen_addresses().await.join(", "), "open");
    let mut watch = tokio::task::JoinSet::new();
    watch.spawn(say_links(zenoh.clone(), bus.connect.clone()));
    let bus = trust.signing_bus(metrics.metered(Arc::new(zenoh.clone())), &mut settings).await?;
    let on_page = Arc::clone(&bus);
    let started = NodeHandle::start(settings, bus).await;
    let mut node = started.map_err(|problem| Failure::Unsuccessful(format!("{name} did not start: {problem}")))?;
    info!(node = %name, "started");
    let _dashboard = match page {
        Some((address, plan)) => {
            let dashboard = Dashboard::open(address, admission.clone(), on_page, &fleet.name, name.as_str(), plan);
            output::line(format_args!("dashboard: {}", dashboard.url()))?;
            Some(dashboard)
        }
        None => None,
    };
    metrics.serve(&node, clock, admission, &mut watch);
    telemetry.set_cluster(node.membership.clone());
    service_manager::ready();
    watch.spawn(service_manager::run_watchdog(zenoh.clone(), Keys::new(&fleet.name), name.clone()));

    let end = told_to_end(&mut node, &mut signals, until_stdin_closes).await;
    service_manager::stopping();
    let end = end.map_err(|cause| Failure::Unsuccessful(format!("{name} stopped: {cause}")))?;
    info!(node = %name, signal = end.word(), "stops");
    let goodbye = async {
        end.of(node, &name).await;
        telemetry.shut_down().await;
        zenoh.close().await
    };
    match tokio::time::timeout(GOODBYE, goodbye).await {
        Ok(Ok(())) => info!(node = %name, "stopped"),
        Ok(Err(problem)) => warn!(node = %name, %problem, "stopped; the bus did not close well"),
        Err(_) => warn!(node = %name, "stopped without having told everybody in {GOODBYE:?}"),
    }
    Ok(())
}

/// How a node that works comes to its end.
enum End {
    /// Somebody told it to, in this way.
    Told(&'static str),
    /// It has left the fleet.
    Left(DecommissionReport),
}

impl End {
    fn word(&self) -> &'static str {
        match self {
            End::Told(how) => how,
            End::Left(_) => "it has left the fleet for good",
        }
    }

    async fn of(self, node: NodeHandle, name: &NodeId) {
        match self {
            End::Told(_) => node.stop().await,
            End::Left(farewell) => {
                info!(node = %name, successor = farewell.successor.map(tracing::field::display), released = farewell.released,
                    role_given_back = farewell.role_given_back, "left");
                node.shut_down().await;
            }
        }
    }
}

/// Waits until the node is to end; an error if it has by itself, and why.
async fn told_to_end(
    node: &mut NodeHandle,
    signals: &mut ShutdownSignals,
    until_stdin_closes: bool,
) -> Result<End, String> {
    tokio::select! {
        signal = signals.wait() => Ok(End::Told(signal)),
        () = stdin_closed(until_stdin_closes) => Ok(End::Told("end of input")),
        ended = node.ended_or_decommissioned() => ended.map(End::Left),
    }
}

async fn take(flag: &str, at: SocketAddr) -> Result<BoundAddress, Failure> {
    BoundAddress::bind(flag, at).await.map_err(Failure::Usage)
}

/// The metrics of a node, if they are asked for.
struct Metering(Option<(BoundAddress, Arc<Metrics>)>);

impl Metering {
    /// Those of this node, to be served at this address.
    fn new(address: Option<BoundAddress>, settings: &NodeSettings) -> Metering {
        Metering(address.map(|address| (address, Metrics::new(&settings.fleet.fleet, &settings.node))))
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

    fn serve(self, node: &NodeHandle, clock: Clock, admission: Admission, tasks: &mut tokio::task::JoinSet<()>) {
        let Some((address, metrics)) = self.0 else { return };
        let (replica, knowledge) = (node.replica.clone(), node.knowledge.clone());
        metrics.set_sources(MetricSources { replica, knowledge, clock, since_ms: clock.wall_ms() });
        info!("metrics at http://{}/metrics", address.local_addr());
        tasks.spawn(async move {
            if let Err(problem) = serve(address.with_connection_limit(), metrics, admission).await {
                warn!(%problem, "metrics are no longer served");
            }
        });
    }
}

/// Waits until the standard input is closed, if that is of interest.
async fn stdin_closed(of_interest: bool) {
    if !of_interest {
        return std::future::pending().await;
    }
    let (closed, heard) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        // A read that fails says as much as an end.
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        let _ = closed.send(());
    });
    let _ = heard.await;
}

/// Says to whom the node is linked, whenever that changes, and when it is linked to nobody, whom it tries.
async fn say_links(bus: ZenohBus, connect: Vec<String>) {
    let mut said: Option<Vec<Link>> = None;
    loop {
        let mut links = bus.links().await;
        links.retain(|link| link.kind != "client"); // they come and go with every command
        if said.as_ref() != Some(&links) {
            let status = match (links.len(), connect.is_empty()) {
                (0, true) => {
                    info!("linked to nobody yet; waits for others to connect");
                    "linked to nobody; waits for others to connect".to_owned()
                }
                (0, false) => {
                    let trying = connect.join(", ");
                    warn!(trying, "linked to nobody; keeps trying");
                    format!("linked to nobody; keeps trying {trying}")
                }
                (neighbours, _) => {
                    info!(links = describe_links(&links), "linked");
                    format!("linked with {}", count(neighbours, "neighbour", "neighbours"))
                }
            };
            service_manager::status(&status);
            said = Some(links);
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// The neighbours, in words.
pub fn describe_links(links: &[Link]) -> String {
    links.iter().map(|link| format!("{} ({})", link.peer, link.kind)).collect::<Vec<_>>().join(", ")
}
