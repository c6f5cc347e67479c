//! Every node as a process: the program `consort`, started once for each node, communicating over
//! Zenoh on loopback only.
//!
//! A child process ends with its parent in any case: it is killed when its handle is dropped, and
//! ends by itself when its standard input is closed.

use super::fleet::DemoFleet;
use super::scenario::DemoScenario;
use crate::config::{BusConfig, RobotConfig, StationConfig, WorldConfig, to_toml};
use crate::exit::Failure;
use crate::shutdown_signals::ShutdownSignals;
use consort_bus::zenoh_bus::Mode;
use consort_bus::{SharedBus, ZenohBus, ZenohSettings};
use consort_protocol::ids::NodeId;
use consort_skills::extensions::LoadedDomain;
use consort_text::count;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::future::Future;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::process::{Child, Command};

/// Time limit for connecting to the world's node.
const CONNECT_LIMIT: Duration = Duration::from_secs(20);

/// A fleet of processes.
pub struct ProcessFleet {
    folder: Folder,
    program: PathBuf,
    domains: &'static [LoadedDomain],
    kinds: BTreeMap<NodeId, &'static str>,
    children: BTreeMap<NodeId, Child>,
    bus: Arc<ZenohBus>,
    endpoint: String,
    speed: f64,
    started: Instant,
    signals: ShutdownSignals,
}

/// A folder that is removed on drop.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        // Leftovers lie in the system's folder for temporary files.
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn failed(what: impl std::fmt::Display) -> impl FnOnce(std::io::Error) -> Failure {
    move |problem| Failure::Unsuccessful(format!("{what}: {problem}"))
}

impl ProcessFleet {
    /// Starts every node of the scenario as a process of `program` with these domain files, listening on ports from
    /// `first_port` up, or on free ports.
    ///
    /// # Errors
    /// [`Failure`] with the resource that was not available, the process that did not start, or the
    /// last output of a node before it ended.
    pub async fn start(
        scenario: &DemoScenario,
        program: &Path,
        domains: &'static [LoadedDomain],
        first_port: Option<u16>,
    ) -> Result<ProcessFleet, Failure> {
        let started = Instant::now();
        let mut signals = ShutdownSignals::open()?;
        let name = format!("consort-demo-{}", std::process::id());
        let folder = Folder(std::env::temp_dir().join(name));
        fs::create_dir_all(&folder.0).map_err(failed(format_args!("{}", folder.0.display())))?;
        let ports = ports(scenario.voters().len() + 1, first_port)?;
        let endpoint = |index: usize| format!("tcp/127.0.0.1:{}", ports[index]);
        let kinds = write_files(scenario, &folder.0, &endpoint)?;
        let endpoint = endpoint(0);
        let mut children = BTreeMap::new();
        for (node, kind) in &kinds {
            children.insert(node.clone(), spawn(program, domains, &folder.0, node, kind)?);
        }
        let connected = tokio::select! {
            biased;
            _ = signals.wait() => return Err(Failure::Interrupted),
            connected = connect(&endpoint) => connected,
        };
        let bus = match connected {
            Ok(bus) => bus,
            Err(problem) => {
                // The last output of the child that ended most likely contains the reason.
                let ended = children.iter_mut().find_map(|(node, child)| last_output(&folder.0, node, child));
                return Err(ended.map_or(problem, Failure::Unreachable));
            }
        };
        let speed = scenario.world.speed;
        let program = program.to_owned();
        Ok(ProcessFleet {
            folder,
            program,
            domains,
            kinds,
            children,
            bus: Arc::new(bus),
            endpoint,
            speed,
            started,
            signals,
        })
    }
}

/// Writes a file for each node of the scenario into a folder, and returns the kind of each node.
/// The world's node has the first endpoint, voters have the next.
fn write_files(
    scenario: &DemoScenario,
    folder: &Path,
    endpoint: &impl Fn(usize) -> String,
) -> Result<BTreeMap<NodeId, &'static str>, Failure> {
    let voters = scenario.voters();
    // Each node is linked to the world's node and to the next two in a ring: no single failure
    // partitions the fleet.
    let bus = |index: usize| BusConfig {
        listen: vec![endpoint(index)],
        connect: match index {
            0 => vec![],
            _ => {
                let next = |step: usize| endpoint((index - 1 + step) % voters.len() + 1);
                let mut connect = vec![endpoint(0), next(1), next(2)];
                connect.retain(|other| *other != endpoint(index));
                connect.dedup();
                connect
            }
        },
        ..BusConfig::default()
    };
    let mut kinds = BTreeMap::new();
    let mut write = |node: &NodeId, kind: &'static str, toml: String| {
        kinds.insert(node.clone(), kind);
        let path = folder.join(format!("{node}.toml"));
        fs::write(&path, toml).map_err(failed(format_args!("{}", path.display())))
    };
    let world = WorldConfig { bus: bus(0), ..scenario.world.clone() };
    write(&world.name, "world", to_toml(&world))?;
    for (index, node) in (1..).zip(&voters) {
        let (bus, data_dir) = (bus(index), Some(folder.join(node.as_str())));
        if let Some(robot) = scenario.robots.iter().find(|robot| robot.name.as_str() == node.as_str()) {
            let robot = RobotConfig { bus: bus.clone(), data_dir: data_dir.clone(), ..robot.clone() };
            write(node, "robot", to_toml(&robot))?;
        }
        if let Some(station) = scenario.stations.iter().find(|station| station.name == *node) {
            let station = StationConfig { bus, data_dir, ..station.clone() };
            write(node, "station", to_toml(&station))?;
        }
    }
    Ok(kinds)
}

impl ProcessFleet {
    /// Asks a node to end, as a service manager would: it transfers the leadership first. Returns a
    /// future that completes when it has ended.
    pub fn request_shutdown(&mut self, node: &NodeId) -> Option<impl Future<Output = ()> + Send + use<>> {
        let mut child = self.children.remove(node)?;
        // The node was started to end when this is closed, as on SIGTERM.
        drop(child.stdin.take());
        Some(async move {
            // The exit status does not matter.
            let _ = child.wait().await;
        })
    }

    /// Stops a node (SIGSTOP), and with it its links.
    pub async fn freeze(&mut self, node: &NodeId) -> Result<(), Failure> {
        let Some(id) = self.children.get(node).and_then(Child::id) else { return Ok(()) };
        let sent = Command::new("kill").arg("-STOP").arg(id.to_string()).status().await;
        sent.map(drop).map_err(failed(format_args!("{node} could not be stopped")))
    }
}

impl DemoFleet for ProcessFleet {
    fn bus(&self) -> SharedBus {
        Arc::clone(&self.bus) as SharedBus
    }

    fn description(&self) -> String {
        format!(
            "{} on loopback ({} world seconds a second); inspect it with: consort fleet --fleet demo --connect {}",
            count(self.children.len(), "process", "processes"),
            self.speed,
            self.endpoint
        )
    }

    async fn kill(&mut self, node: &NodeId) -> Result<(), Failure> {
        let Some(mut child) = self.children.remove(node) else { return Ok(()) };
        // SIGKILL on Unix; then the child is reaped.
        child.kill().await.map_err(failed(format_args!("{node} could not be killed")))
    }

    async fn restart(&mut self, node: &NodeId) -> Result<(), Failure> {
        let Some(kind) = self.kinds.get(node) else { return Ok(()) };
        let child = spawn(&self.program, self.domains, &self.folder.0, node, kind)?;
        self.children.insert(node.clone(), child);
        Ok(())
    }

    fn unexpected_exit(&mut self) -> Option<String> {
        let folder = &self.folder.0;
        let (node, words) = self
            .children
            .iter_mut()
            .find_map(|(node, child)| Some((node.clone(), last_output(folder, node, child)?)))?;
        self.children.remove(&node);
        Some(words)
    }

    async fn interrupted(&mut self) {
        self.signals.wait().await;
    }

    async fn shut_down(mut self) {
        for child in self.children.values_mut() {
            // A child that has ended already cannot be killed.
            let _ = child.start_kill();
        }
        for child in self.children.values_mut() {
            let _ = child.wait().await;
        }
        if let Err(problem) = self.bus.close().await {
            tracing::debug!(%problem, "the bus did not close");
        }
    }

    fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }
}

fn ports(count: usize, first: Option<u16>) -> Result<Vec<u16>, Failure> {
    match first {
        Some(first) => {
            let last = usize::from(first) + count - 1;
            let Ok(last) = u16::try_from(last) else {
                return Err(Failure::Usage(format!(
                    "--port {first}: {count} ports are needed, up to {last}; allowed is up to 65535"
                )));
            };
            let ports: Vec<u16> = (first..=last).collect();
            for port in &ports {
                if let Err(problem) = TcpListener::bind(("127.0.0.1", *port)) {
                    let help = "choose other ports with --port, or leave it out to use free ports";
                    return Err(Failure::Usage(format!(
                        "port {port} of {first} to {last} is not available: {problem}; {help}"
                    )));
                }
            }
            Ok(ports)
        }
        None => {
            // All ports stay bound until all are found, so that none is returned twice.
            let held: Vec<TcpListener> = (0..count)
                .map(|_| TcpListener::bind(("127.0.0.1", 0)))
                .collect::<Result<_, _>>()
                .map_err(failed("no free port on loopback"))?;
            held.iter()
                .map(|port| port.local_addr().map(|address| address.port()))
                .collect::<Result<_, _>>()
                .map_err(failed("a port"))
        }
    }
}

fn spawn(program: &Path, domains: &[LoadedDomain], folder: &Path, node: &NodeId, kind: &str) -> Result<Child, Failure> {
    let log = folder.join(format!("{node}.log"));
    let log =
        File::options().create(true).append(true).open(&log).map_err(failed(format_args!("{}", log.display())))?;
    Command::new(program)
        .arg(kind)
        .arg("--config")
        .arg(folder.join(format!("{node}.toml")))
        .arg("--until-stdin-closes")
        .args(domains.iter().flat_map(|loaded| ["--domain".as_ref(), loaded.path.as_os_str()]))
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(log)
        .kill_on_drop(true)
        // Ctrl-C on the terminal reaches the demo only, which then ends its children.
        .process_group(0)
        .spawn()
        .map_err(failed(format_args!("{node} could not be started")))
}

async fn connect(endpoint: &str) -> Result<ZenohBus, Failure> {
    let deadline = Instant::now() + CONNECT_LIMIT;
    loop {
        let settings = ZenohSettings {
            mode: Mode::Client,
            listen: vec![],
            connect: vec![endpoint.to_owned()],
            ..ZenohSettings::default()
        };
        match ZenohBus::open(settings).await {
            Ok(bus) => return Ok(bus),
            Err(problem) if Instant::now() >= deadline => {
                let what = format!("no connection to the world at {endpoint} within {CONNECT_LIMIT:?}: {problem}");
                return Err(Failure::Unreachable(what));
            }
            Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
        }
    }
}

/// Returns the last output of a child that has ended by itself.
fn last_output(folder: &Path, node: &NodeId, child: &mut Child) -> Option<String> {
    let status = child.try_wait().ok()??;
    let log = fs::read_to_string(folder.join(format!("{node}.log"))).unwrap_or_default();
    let lines: Vec<&str> = log.lines().collect();
    let last = lines[lines.len().saturating_sub(5)..].join("\n  ");
    Some(format!("{node} ended by itself ({status}); its last output:\n  {last}"))
}
