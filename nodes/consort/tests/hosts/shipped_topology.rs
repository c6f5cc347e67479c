//! Machines of a shipped topology: each with the addresses of the documentation, and with a node
//! started from the shipped file and unit.
//!
//! ```text
//!   north-1 ── 10.1.0.1 ── north ── 10.1.0.4 ── ada        a network is a bridge, without forwarding between networks
//!      └───── 192.0.2.1 ── between ── 192.0.2.101 ── gate-south ── 10.2.0.1 ── south
//! ```
//!
//! `/etc/consort` of a machine is a folder of the test with copies of the files, `/var/lib/consort`
//! is another folder; host names are in `/etc/hosts`.

use crate::support::{Ended, Folder, LONG, Program, until};
use consort_tests::host_network::{ip, run, within};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Folder of the shipped deployment files.
const DEPLOY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy");

/// Log filter of the nodes: the default, and all published events.
const LOG: &str =
    "CONSORT_LOG=info,zenoh=error,openraft=error,openraft::replication=off,ractor=warn,consort::events=debug";

/// The machines and their networks.
pub(crate) struct ShippedTopology {
    topology: PathBuf,
    networks: BTreeSet<String>,
    /// Port of a machine in a network.
    ports: BTreeMap<(String, String), String>,
    cables: usize,
    nodes: BTreeMap<String, Program>,
    started: usize,
    folder: Folder,
}

impl ShippedTopology {
    /// Loads a topology with these host names.
    pub(crate) fn new(topology: &str, names: &[(&str, &str)]) -> ShippedTopology {
        let folder = Folder::new();
        ip("link set lo up");
        let lines = names.iter().map(|(address, name)| format!("{address} {name}\n")).collect::<String>();
        let hosts = folder.write("hosts", &format!("127.0.0.1 localhost\n{lines}"));
        run("mount", &["--bind", &hosts.display().to_string(), "/etc/hosts"]);
        ShippedTopology {
            topology: Path::new(DEPLOY).join("topologies").join(topology),
            networks: BTreeSet::new(),
            ports: BTreeMap::new(),
            cables: 0,
            nodes: BTreeMap::new(),
            started: 0,
            folder,
        }
    }

    /// Runs commands of the documentation in a copy of the topology's folder. Machines get the files of the copy.
    pub(crate) fn prepare(&mut self, commands: &str) {
        let copy = self.path("topology");
        std::fs::create_dir_all(&copy).expect("the folder can be written to");
        for file in std::fs::read_dir(&self.topology).expect("a topology that is shipped") {
            let file = file.expect("an entry");
            std::fs::copy(file.path(), copy.join(file.file_name())).expect("a file that is shipped");
        }
        run("sh", &["-ec", &format!("cd '{}'\n{commands}", copy.display())]);
        self.topology = copy;
    }

    /// Creates a machine with a cable and an address in each of these networks. Copies the fleet
    /// file, its own file and its certificate, if there is one, to the places that its unit
    /// expects.
    pub(crate) fn machine(&mut self, name: &str, cables: &[(&str, &str)]) {
        ip(&format!("netns add {name}"));
        ip(&format!("-n {name} link set lo up"));
        std::fs::create_dir_all(self.etc(name)).expect("the folder can be written to");
        for file in ["fleet.toml".to_owned(), format!("{name}.toml")] {
            std::fs::copy(self.topology.join(&file), self.etc(name).join(&file)).expect("a file that is shipped");
        }
        let own = Path::new("certs").join(name);
        if let Ok(papers) = std::fs::read_dir(self.path("").join(&own)) {
            let certs = self.etc(name).join(own);
            std::fs::create_dir_all(&certs).expect("the folder can be written to");
            for paper in papers.map(|paper| paper.expect("an entry")) {
                std::fs::copy(paper.path(), certs.join(paper.file_name())).expect("a file that `consort cert` made");
            }
        }
        for (network, address) in cables {
            self.cable(name, network, address);
        }
    }

    /// Returns the configuration folder of a machine.
    fn etc(&self, name: &str) -> PathBuf {
        self.folder.path().join(name).join("etc")
    }

    /// Returns a path in the folder of the test.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Connects a machine to a network with a 24-bit prefix.
    pub(crate) fn cable(&mut self, name: &str, network: &str, address: &str) {
        if self.networks.insert(network.to_owned()) {
            ip(&format!("link add {network} type bridge"));
            ip(&format!("link set {network} up"));
        }
        self.cables += 1;
        let number = self.cables;
        let (port, end) = (format!("port{number}"), format!("cable{number}"));
        ip(&format!("link add {port} type veth peer name {end} netns {name}"));
        ip(&format!("link set {port} master {network} up"));
        ip(&format!("-n {name} addr add {address}/24 dev {end}"));
        ip(&format!("-n {name} link set {end} up"));
        self.ports.insert((name.to_owned(), network.to_owned()), port);
    }

    fn port(&self, name: &str, network: &str) -> &str {
        &self.ports[&(name.to_owned(), network.to_owned())]
    }

    /// Cuts the cable of a machine to a network: neither end is notified that its packets are lost.
    pub(crate) fn unplug(&self, name: &str, network: &str) {
        ip(&format!("link set {} down", self.port(name, network)));
    }

    /// Restores the cable.
    pub(crate) fn plug(&self, name: &str, network: &str) {
        ip(&format!("link set {} up", self.port(name, network)));
    }

    /// Moves a machine from a network to another, with a new address.
    pub(crate) fn move_to_network(&mut self, name: &str, from: &str, to: &str, address: &str) {
        let port = self.ports.remove(&(name.to_owned(), from.to_owned())).expect("a cable");
        ip(&format!("link del {port}"));
        self.cable(name, to, address);
    }

    /// Starts the node of a machine as its unit does, with additional environment variables.
    pub(crate) fn start(&mut self, kind: &str, name: &str, besides: &[&str]) {
        self.started += 1;
        let (arguments, variables) = self.unit(kind, name);
        let by: Vec<&str> = variables.iter().map(String::as_str).chain([LOG]).chain(besides.iter().copied()).collect();
        let by = [&within(name)[..], &["env"], &by].concat();
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let program = Program::start_by(&by, &self.folder, &format!("{name}-{}", self.started), &arguments);
        self.nodes.insert(name.to_owned(), program);
    }

    /// Returns the arguments and environment variables of the unit of a node.
    fn unit(&self, kind: &str, name: &str) -> (Vec<String>, Vec<String>) {
        let read = |file: &str| std::fs::read_to_string(Path::new(DEPLOY).join("systemd").join(file)).expect("a unit");
        let (unit, common) = (read(&format!("consort-{kind}@.service")), read("consort-.service.d/node.conf"));
        let filled = |text: &str| {
            let text = text.replace("%i", name).replace("/etc/consort", &self.etc(name).display().to_string());
            text.replace("/var/lib/consort", &self.folder.path().join(name).join("var").display().to_string())
        };
        let values = |text: &str, key: &str| -> Vec<String> {
            text.lines().filter_map(|line| line.strip_prefix(key)).map(filled).collect()
        };
        let start = values(&unit, "ExecStart=/usr/bin/consort ").pop().expect("a unit starts the program");
        (start.split(' ').map(str::to_owned).collect(), values(&common, "Environment="))
    }

    /// Waits until every node has logged its start.
    pub(crate) fn await_started(&mut self) {
        for (name, node) in &mut self.nodes {
            until(&format!("{name} has started"), LONG, || {
                assert!(!node.has_ended(), "{name} has ended:\n{}", node.stderr());
                node.stderr().contains(" started node=").then_some(())
            });
        }
    }

    /// Ends a node with SIGKILL.
    pub(crate) fn kill(&mut self, name: &str) {
        self.nodes.remove(name).expect("a node that runs").kill();
    }

    /// Starts a command on a machine. It queries the local node by default.
    pub(crate) fn begin(&mut self, arguments: &[&str], on: &str) -> Program {
        self.started += 1;
        Program::start_by(&within(on), &self.folder, &format!("command-{}", self.started), arguments)
    }

    /// Runs a command on a machine to its end.
    pub(crate) fn run(&mut self, arguments: &[&str], on: &str) -> Ended {
        self.begin(arguments, on).end(LONG)
    }

    /// Runs a command outside the topology, without a connection.
    pub(crate) fn tool(&mut self, arguments: &[&str]) -> Ended {
        self.started += 1;
        Program::start(&self.folder, &format!("tool-{}", self.started), arguments).end(LONG)
    }

    /// Waits until a command succeeds and `look` finds a value in its JSON output.
    #[track_caller]
    pub(crate) fn wait_for_json<T>(
        &mut self,
        what: &str,
        arguments: &[&str],
        on: &str,
        look: impl Fn(&serde_json::Value) -> Option<T>,
    ) -> T {
        until(what, LONG, || {
            let ended = self.run(arguments, on);
            ended.status.success().then(|| look(&ended.json())).flatten()
        })
    }

    /// Returns the log of a node since its latest start.
    pub(crate) fn log(&self, name: &str) -> String {
        self.nodes.get(name).map(Program::stderr).unwrap_or_default()
    }

    /// Waits until a node is linked to exactly these other nodes.
    #[track_caller]
    pub(crate) fn wait_for_links(&self, name: &str, others: &[&str]) {
        let id = |other: &str| {
            let log = self.log(other);
            let (_, rest) = log.split_once(" id=\"")?;
            Some(rest.split_once('"')?.0.to_owned())
        };
        until(&format!("{name} is linked with {others:?} alone"), LONG, || {
            let ids: BTreeSet<String> = others.iter().map(|other| id(other)).collect::<Option<_>>()?;
            let log = self.log(name);
            let line = log.lines().rfind(|line| line.contains(" linked ") || line.contains(" no links"))?;
            let links = line.split_once("links=\"").map_or("", |(_, links)| links.trim_end_matches('"'));
            let linked = links.split(", ").filter_map(|link| link.split_once(" ("));
            (linked.map(|(id, _)| id.to_owned()).collect::<BTreeSet<_>>() == ids).then_some(())
        });
    }

    /// Waits until a robot has begun a task.
    #[track_caller]
    pub(crate) fn wait_for_task(&self, robot: &str, task: &str) {
        until(&format!("{robot} begins {task}"), LONG, || {
            let task = format!("task=\"{task}\"");
            self.log(robot).lines().any(|line| line.contains("task_began") && line.contains(&task)).then_some(())
        });
    }
}

/// Prints the logs of the nodes if the test fails.
impl Drop for ShippedTopology {
    #[expect(clippy::print_stderr, reason = "a failed test prints the logs")]
    fn drop(&mut self) {
        if std::thread::panicking() {
            for name in self.nodes.keys() {
                eprintln!("--- {name}\n{}", self.log(name));
            }
        }
    }
}
