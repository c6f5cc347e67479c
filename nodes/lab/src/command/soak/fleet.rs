//! The processes of the fleet, each on its own host.

use super::certificates::Certificates;
use super::names::{CARRIERS, ROBOTS, ROOMS, STATIONS, WORLD};
use super::{charging, orders};
use consort_bus::zenoh_bus::Mode;
use consort_bus::{SharedBus, ZenohBus, ZenohSettings};
use consort_nodes::exit::Failure;
use consort_protocol::ids::FleetId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::trust::NodeRole;
use consort_skills::extensions::LoadedDomain;
use consort_tests::chaos::UserParticipants;
use consort_tests::example_files::example;
use consort_tests::host_network::{HostNetwork, run, within};
use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use toml::Table;

/// Name of the fleet.
const FLEET: &str = "soak";

/// Simulated seconds per second: missions end within a fraction of a minute.
const WORLD_SPEED: f64 = 8.0;

/// Samples of each nurse. A world has at most 10,000 in all.
const SAMPLES: usize = 1_500;

/// Samples that a drawer can hold.
const DRAWER_SLOTS: i64 = 1_000;

/// Limit for the fleet to be complete at the start.
const START_LIMIT: Duration = Duration::from_secs(120);

/// Interval at which a condition is checked at the start.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);

/// Signal of a process that ends after a panic in Zenoh.
const SIGABRT: i32 = 6;

/// Maximum number of robots that an auction of a large fleet asks first: fewer than there are robots.
const CANDIDATES: i64 = 2;

/// Planned nodes of a large fleet: with as many, nodes on battery power do not relay.
const PLANNED_NODES: i64 = 30;

/// Kind of a fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) struct FleetKind {
    /// The nodes have no certificates.
    pub(in super::super) open: bool,
    /// The fleet has the settings of a large one: carriers are clients of the stations, which relay for them, and
    /// auctions ask candidates first.
    pub(in super::super) large: bool,
    /// The carriers use their batteries, and a charger.
    pub(in super::super) charging: bool,
}

impl FleetKind {
    /// Returns the fleet file.
    fn fleet_file(self) -> Table {
        let mut fleet = example("fleet");
        fleet.insert("name".to_owned(), FLEET.into());
        fleet.insert("bootstrap_expect".to_owned(), (STATIONS.len() as i64).into());
        if self.large {
            fleet.insert("planned_nodes".to_owned(), PLANNED_NODES.into());
            if let Some(auction) = fleet.get_mut("auction").and_then(toml::Value::as_table_mut) {
                auction.insert("candidates".to_owned(), CANDIDATES.into());
            }
        }
        if self.charging {
            charging::change_fleet(&mut fleet);
        }
        orders::change_fleet(&mut fleet);
        fleet
    }
}

/// Fleet with a process for each node.
pub(in super::super) struct ProcessFleet {
    pub(in super::super) network: HostNetwork,
    pub(in super::super) keys: Keys,
    kind: FleetKind,
    /// Certificates of a closed fleet.
    certificates: Option<Certificates>,
    processes: BTreeMap<String, Child>,
    /// Processes that ended after a panic in Zenoh, and were started again.
    pub(super) failures_of_zenoh: u32,
    program: PathBuf,
    folder: PathBuf,
    domains: &'static [LoadedDomain],
}

fn unsuccessful(problem: impl std::fmt::Display) -> Failure {
    Failure::Unsuccessful(problem.to_string())
}

impl ProcessFleet {
    /// Starts all nodes of a fleet of this kind with these domains, and waits until the robots are members of the
    /// ensemble. The carriers and the people are also those of the missions of the user.
    ///
    /// # Errors
    /// [`Failure`]: a process cannot be started, or the fleet is not complete in time.
    pub(in super::super) async fn start(
        folder: &Path,
        kind: FleetKind,
        domains: &'static [LoadedDomain],
        participants: &UserParticipants,
    ) -> Result<ProcessFleet, Failure> {
        let program = std::env::current_exe().map_err(unsuccessful)?.with_file_name("consort");
        if !program.is_file() {
            return Err(Failure::Usage(format!(
                "{} does not exist; build it: cargo build --release",
                program.display()
            )));
        }
        let mut network = HostNetwork::new();
        for host in STATIONS.into_iter().chain(ROBOTS).chain([WORLD]) {
            network.add(host);
        }
        let id: FleetId = FLEET.parse().map_err(unsuccessful)?;
        let keys = Keys::new(&id);
        let certificates = if kind.open {
            None
        } else {
            let nodes = STATIONS.map(|name| (name, NodeRole::Voter)).into_iter();
            let nodes = nodes.chain(ROBOTS.map(|name| (name, NodeRole::Robot))).chain([(WORLD, NodeRole::Host)]);
            Some(Certificates::issue(&folder.join("certs"), &keys, nodes)?)
        };
        let mut fleet = ProcessFleet {
            network,
            keys,
            kind,
            certificates,
            processes: BTreeMap::new(),
            failures_of_zenoh: 0,
            program,
            folder: folder.to_owned(),
            domains,
        };
        fleet.write_files(participants)?;
        for node in STATIONS.into_iter().chain([WORLD]).chain(ROBOTS) {
            fleet.start_node(node)?;
        }
        fleet.wait_complete().await?;
        Ok(fleet)
    }

    fn write_files(&self, participants: &UserParticipants) -> Result<(), Failure> {
        self.write("fleet", &self.kind.fleet_file())?;
        for station in STATIONS {
            self.write_node(station, example("station"), &STATIONS)?;
        }
        let mut world = example("world");
        world.insert("speed".to_owned(), WORLD_SPEED.into());
        if let Some(bodies) = world.get_mut("robot").and_then(toml::Value::as_array_mut)
            && let Some(mut second) = bodies.first().and_then(toml::Value::as_table).cloned()
        {
            second.insert("id".to_owned(), "bob".into());
            second.insert("place".to_owned(), "PC Room 4".into());
            bodies.push(second.into());
            for body in bodies.iter_mut().filter_map(toml::Value::as_table_mut) {
                if self.kind.charging {
                    charging::change_body(body);
                } else {
                    charging::remove_discharge(body);
                }
            }
        }
        // The drawers are not emptied after a failed mission.
        if let Some(limits) = world.get_mut("limits").and_then(toml::Value::as_table_mut) {
            limits.insert("drawer_slots".to_owned(), DRAWER_SLOTS.into());
        }
        let on_call = participants.people.iter().map(toml::Value::try_from).collect::<Result<Vec<_>, _>>();
        let nurses = ROOMS.iter().map(|room| toml::Value::from(nurse(room)));
        let people = nurses.chain(on_call.map_err(unsuccessful)?).collect();
        world.insert("person".to_owned(), toml::Value::Array(people));
        self.write_node(WORLD, world, &STATIONS)?;
        for robot in ROBOTS {
            let is_arm = robot == "lab-arm";
            let mut node = example(if is_arm { "arm" } else { "robot" });
            if !is_arm && let Some(skills) = node.get_mut("skills").and_then(toml::Value::as_array_mut) {
                let more = participants.skills.iter().map(|skill| toml::Value::from(skill.as_str()));
                let more: Vec<_> = more.filter(|skill| !skills.contains(skill)).collect();
                skills.extend(more);
            }
            node.insert("may_vote".to_owned(), false.into());
            if is_arm || !self.kind.charging {
                charging::remove_discharge(&mut node);
            } else {
                charging::change_robot(&mut node);
            }
            let mut neighbours = STATIONS.to_vec();
            if !self.is_client(robot) {
                neighbours.push(WORLD);
            }
            self.write_node(robot, node, &neighbours)?;
        }
        Ok(())
    }

    fn write_node(&self, name: &str, mut node: Table, neighbours: &[&str]) -> Result<(), Failure> {
        let others = neighbours.iter().filter(|other| **other != name);
        let connect: Vec<String> = others.map(|other| self.address(other)).collect();
        let mut bus = Table::new();
        if !self.is_client(name) {
            bus.insert("listen".to_owned(), vec![format!("{}/0.0.0.0:7447", self.protocol())].into());
        }
        if let Some(certificates) = &self.certificates {
            bus.insert("certs".to_owned(), certificates.of_node(name).display().to_string().into());
        }
        bus.insert("connect".to_owned(), connect.into());
        node.insert("name".to_owned(), name.into());
        node.insert("bus".to_owned(), bus.into());
        node.insert("data_dir".to_owned(), format!("data-{name}").into());
        self.write(name, &node)
    }

    /// Checks whether a node is a client of the stations.
    fn is_client(&self, name: &str) -> bool {
        self.kind.large && CARRIERS.contains(&name)
    }

    fn protocol(&self) -> &'static str {
        if self.kind.open { "tcp" } else { "tls" }
    }

    fn address(&self, host: &str) -> String {
        format!("{}/{}:7447", self.protocol(), self.network.address(host, ""))
    }

    fn write(&self, name: &str, table: &Table) -> Result<(), Failure> {
        let file = self.folder.join(format!("{name}.toml"));
        std::fs::write(&file, table.to_string())
            .map_err(|problem| unsuccessful(format_args!("{}: {problem}", file.display())))
    }

    /// Starts the process of a node. Its log is appended to that of the process before.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if it cannot be started.
    pub(in super::super) fn start_node(&mut self, name: &str) -> Result<(), Failure> {
        let kind = match name {
            WORLD => "world",
            name if STATIONS.contains(&name) => "station",
            _ => "robot",
        };
        let log = File::options().create(true).append(true).open(self.folder.join(format!("{name}.log")));
        let file = self.folder.join(format!("{name}.toml"));
        let [program, prefix @ ..] = within(name);
        let mut command = Command::new(program);
        command.args(prefix).arg(&self.program).args([kind, "--config"]).arg(file).arg("--until-stdin-closes");
        command.args(self.domains.iter().flat_map(|loaded| ["--domain".as_ref(), loaded.path.as_os_str()]));
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(log.map_err(unsuccessful)?);
        for (variable, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("CONSORT_")) {
            command.env_remove(variable);
        }
        let child = command.spawn().map_err(|problem| unsuccessful(format_args!("{name}: {problem}")))?;
        self.processes.insert(name.to_owned(), child);
        Ok(())
    }

    /// Opens a client of these hosts: it uses the first that it reaches, and changes to another when it
    /// loses the link. In a closed fleet it signs its requests as a person.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if none is reached in time.
    pub(in super::super) async fn client(&self, hosts: &[&str]) -> Result<SharedBus, Failure> {
        let connect: Vec<String> = hosts.iter().map(|host| self.address(host)).collect();
        let link_trust = self.certificates.as_ref().map(Certificates::link_trust);
        let settings = ZenohSettings { mode: Mode::Client, connect, link_trust, ..ZenohSettings::default() };
        let deadline = Instant::now() + START_LIMIT;
        let bus = loop {
            match ZenohBus::open(settings.clone()).await {
                Ok(bus) => break bus,
                Err(problem) if Instant::now() >= deadline => return Err(unsuccessful(problem)),
                Err(_) => tokio::time::sleep(LOOK_INTERVAL).await,
            }
        };
        let bus: SharedBus = Arc::new(bus);
        match &self.certificates {
            Some(certificates) => certificates.signing_bus(bus).await,
            None => Ok(bus),
        }
    }

    /// Ends the process of a node with SIGKILL.
    pub(in super::super) fn kill(&mut self, name: &str) {
        if let Some(mut child) = self.processes.remove(name) {
            // It may have ended by itself; the verdict depends on the log then.
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    /// Sends a signal, such as `STOP`, to the process of a node.
    pub(super) fn signal(&self, name: &str, signal: &str) {
        if let Some(child) = self.processes.get(name) {
            run("kill", &[&format!("-{signal}"), &child.id().to_string()]);
        }
    }

    /// Starts processes again that have ended after a panic in Zenoh, as a service manager does.
    ///
    /// # Errors
    /// A description of the first process that has ended for another reason.
    pub(in super::super) fn restart_ended(&mut self) -> Result<(), String> {
        let ended = |(name, child): (&String, &mut Child)| Some((name.clone(), child.try_wait().ok().flatten()?));
        let ended: Vec<(String, ExitStatus)> = self.processes.iter_mut().filter_map(ended).collect();
        for (name, status) in ended {
            if status.signal() != Some(SIGABRT) {
                self.processes.remove(&name);
                return Err(format!("the process of {name} has ended by itself: {status}"));
            }
            self.failures_of_zenoh += 1;
            self.start_node(&name).map_err(|problem| problem.to_string())?;
        }
        Ok(())
    }

    /// Returns the panics in the logs outside of Zenoh.
    pub(super) fn panics(&self) -> Vec<String> {
        let nodes = STATIONS.into_iter().chain(ROBOTS).chain([WORLD]);
        let is_own = |line: &&str| line.contains("panicked at") && !line.contains("/zenoh");
        let of = |node: &str| {
            let log = std::fs::read_to_string(self.folder.join(format!("{node}.log"))).unwrap_or_default();
            log.lines().find(is_own).map(|line| format!("{node}: {line}"))
        };
        nodes.filter_map(of).collect()
    }

    /// Ends all processes.
    pub(in super::super) fn stop(&mut self) {
        for name in self.processes.keys().cloned().collect::<Vec<_>>() {
            self.kill(&name);
        }
    }

    async fn wait_complete(&mut self) -> Result<(), Failure> {
        let key = self.keys.write(&Key::ViewEnsembles);
        let bus = self.client(&STATIONS).await?;
        let is_complete = async || {
            let limit = Duration::from_secs(2);
            let mut replies = bus.query_nearest(&key, vec![].into(), limit).await.ok()?;
            let view: serde_json::Value = serde_json::from_slice(&replies.recv().await?.payload.ok()?).ok()?;
            let members = view["ensembles"][0]["members"].as_array()?.len();
            (members == ROBOTS.len()).then_some(())
        };
        let deadline = Instant::now() + START_LIMIT;
        while is_complete().await.is_none() {
            self.restart_ended().map_err(unsuccessful)?;
            if Instant::now() >= deadline {
                let folder = self.folder.display();
                return Err(unsuccessful(format_args!(
                    "the fleet is not complete within {START_LIMIT:?}; see {folder}"
                )));
            }
            tokio::time::sleep(LOOK_INTERVAL).await;
        }
        Ok(())
    }
}

impl Drop for ProcessFleet {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Returns the table of a nurse with samples.
fn nurse(room: &str) -> Table {
    let samples: Vec<String> = (0..SAMPLES).map(|number| format!("{room}-{number}")).collect();
    let mut nurse = Table::new();
    nurse.insert("name".to_owned(), format!("nurse of {room}").into());
    nurse.insert("role".to_owned(), "nurse".into());
    nurse.insert("place".to_owned(), room.into());
    nurse.insert("samples".to_owned(), samples.into());
    nurse
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_nodes::config::{FleetConfig, from_text};
    use consort_skills::extensions::Extensions;

    #[test]
    fn fleet_files_can_be_read() {
        let domain = Extensions::default().domain();
        for (large, charging) in [(false, false), (true, true)] {
            let file = FleetKind { open: false, large, charging }.fleet_file().to_string();
            let fleet: FleetConfig = from_text(&file, "fleet.toml", &domain).expect("a fleet file");
            assert_eq!((fleet.planned_nodes == Some(30), fleet.alarms.len()), (large, 2));
            assert_eq!(fleet.charging.is_some_and(|settings| !settings.parking.is_empty()), charging);
        }
    }
}
