//! A laboratory: hosts with a cable, an address and a process each.

use crate::slots::Slot;
use crate::support::{Client, Ended, Folder, LONG, Program, skip, until};
use consort_tests::host_network::{HostNetwork, Way, is_inside, run, run_inside, within};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use toml::Table;

/// Runs a test in its own namespaces by restarting the test binary with the name of the test. Where
/// that is not allowed or a tool is missing, the test is skipped.
pub(crate) fn inside(name: &str, tools: &[&str], test: impl FnOnce()) {
    inside_again(&["--exact", name, "--nocapture"], tools, test);
}

/// Same for a program other than a test, restarted with these arguments.
pub(crate) fn inside_again(arguments: &[&str], tools: &[&str], test: impl FnOnce()) {
    if is_inside() {
        return test();
    }
    let _slot = Slot::take();
    static TESTS: AtomicU32 = AtomicU32::new(0);
    let own = format!("{}-{}", std::process::id(), TESTS.fetch_add(1, Ordering::Relaxed));
    match run_inside(arguments, tools, &own) {
        Ok(status) => assert!(status.success(), "inside its namespaces, {} failed", arguments.join(" ")),
        Err(reason) => skip(&reason),
    }
}

/// The hosts, their network and their nodes.
pub(crate) struct Lab {
    fleet: String,
    network: HostNetwork,
    programs: BTreeMap<String, Program>,
    commands: usize,
    folder: Folder,
    /// Nodes have certificates.
    closed: bool,
}

impl Lab {
    /// Creates a switch without hosts.
    pub(crate) fn new(fleet: &Table) -> Lab {
        let folder = Folder::new();
        folder.write("fleet.toml", &fleet.to_string());
        let fleet = fleet["name"].as_str().expect("a fleet has a name").to_owned();
        let network = HostNetwork::new();
        Lab { fleet, network, programs: BTreeMap::new(), commands: 0, folder, closed: false }
    }

    /// Creates certificates for these nodes with their roles, and for a person with the read scope and one who may submit
    /// missions. Nodes and commands have certificates from now on.
    pub(crate) fn close(&mut self, nodes: &[(&str, &str)]) {
        let dir = self.certs("").display().to_string();
        let cert = |words: &[&str]| run(env!("CARGO_BIN_EXE_consort"), &[&["cert", "--dir", &dir], words].concat());
        cert(&["init", "--fleet", &self.fleet]);
        for (node, roles) in nodes {
            let serves: &[&str] = if roles.contains("host") { &["--serves", "*"] } else { &[] };
            cert(&[&["node", node, "--roles", roles], serves].concat());
        }
        cert(&["person", "looker", "--scope", "read"]);
        cert(&["person", "submitter", "--scope", "submit"]);
        self.closed = true;
    }

    fn certs(&self, of: &str) -> PathBuf {
        self.folder.path().join("certs").join(of)
    }

    /// Connects a client to the node of a host.
    pub(crate) fn client(&self, of: &str, fleet: &'static str) -> Client {
        let certs = self.closed.then(|| self.certs("looker"));
        Client::open_with(&self.address(of, ""), fleet, certs.as_deref())
    }

    fn protocol(&self) -> &'static str {
        if self.closed { "tls" } else { "tcp" }
    }

    /// Adds a host without a cable.
    pub(crate) fn add_apart(&mut self, name: &str) {
        self.network.add_apart(name);
    }

    /// Adds a host with a cable to the switch.
    pub(crate) fn add(&mut self, name: &str) {
        self.network.add(name);
    }

    /// Joins two hosts by a direct cable.
    pub(crate) fn link(&mut self, a: &str, b: &str) {
        self.network.link(a, b);
    }

    /// Limits the direct cable of two hosts to a rate in each direction, such as `1mbit`.
    pub(crate) fn limit(&self, a: &str, b: &str, rate: &str) {
        self.network.limit(a, b, rate);
    }

    /// Cuts the direct cable of two hosts: both ends see the link go down.
    pub(crate) fn cut(&self, a: &str, b: &str) {
        self.network.cut(a, b);
    }

    /// Restores a direct cable that was cut.
    pub(crate) fn restore(&self, a: &str, b: &str) {
        self.network.restore(a, b);
    }

    /// Returns the address of `to`, as seen by `from` if they have a direct cable.
    pub(crate) fn address(&self, to: &str, from: &str) -> String {
        format!("{}/{}:7447", self.protocol(), self.network.address(to, from))
    }

    /// Starts the node of a host with `consort KIND --config FILE`, linked to these hosts. It listens on
    /// all its addresses, unless its file says that it does not relay.
    pub(crate) fn start(&mut self, kind: &str, mut node: Table, neighbours: &[&str]) {
        let name = node["name"].as_str().expect("a node has a name").to_owned();
        let connect: Vec<String> = neighbours.iter().map(|other| self.address(other, &name)).collect();
        let mut bus = Table::new();
        let relay = node.get("bus").and_then(|bus| bus.get("relay")).and_then(toml::Value::as_str).unwrap_or("auto");
        bus.insert("relay".to_owned(), relay.into());
        if relay != "no" {
            bus.insert("listen".to_owned(), vec![format!("{}/0.0.0.0:7447", self.protocol())].into());
        }
        if self.closed {
            bus.insert("certs".to_owned(), self.certs(&name).display().to_string().into());
        }
        bus.insert("connect".to_owned(), connect.into());
        node.insert("bus".to_owned(), bus.into());
        let file = self.folder.write(&format!("{name}.toml"), &node.to_string()).display().to_string();
        let arguments = [kind, "--config", &file, "--until-stdin-closes"];
        let program = Program::start_by(&within(&name), &self.folder, &name, &arguments);
        self.programs.insert(name, program);
    }

    /// Waits until the nodes listen.
    pub(crate) fn await_open(&mut self) {
        for (name, program) in &mut self.programs {
            until(&format!("{name} is open"), LONG, || {
                assert!(!program.has_ended(), "{name} has ended:\n{}", program.stderr());
                program.stderr().contains("listening=\"").then_some(())
            });
        }
    }

    /// Runs a command on a host against the node of that host, with `timeout` as its timeout.
    pub(crate) fn run(&mut self, arguments: &[&str], on: &str, timeout: Duration) -> Ended {
        self.commands += 1;
        let (name, timeout) = (format!("command-{}", self.commands), timeout.as_secs().to_string());
        let address = format!("{}/127.0.0.1:7447", self.protocol());
        let certs = self.certs("submitter").display().to_string();
        let certs: &[&str] = if self.closed { &["--certs", &certs] } else { &[] };
        let more = ["--connect", &address, "--fleet", &self.fleet, "--timeout", &timeout];
        let program = Program::start_by(&within(on), &self.folder, &name, &[arguments, &more, certs].concat());
        program.end(LONG)
    }

    /// Removes the cable of a host from the switch: both ends see the link go down.
    pub(crate) fn unplug(&self, name: &str) {
        self.network.unplug(name);
    }

    /// Plugs the cable of a host into a bridge.
    pub(crate) fn plug(&self, name: &str, bridge: &str) {
        self.network.plug(name, bridge);
    }

    /// Drops a percentage of the packets of a host, in addition to previous rules. Its loopback is
    /// unaffected.
    pub(crate) fn lose(&self, name: &str, way: Way, percent: u32) {
        self.network.lose(name, way, percent);
    }

    /// Ends all packet loss at a host.
    pub(crate) fn lose_nothing(&self, name: &str) {
        self.network.lose_nothing(name);
    }

    /// Returns the bytes on the cable of a host: sent and received.
    pub(crate) fn bytes(&self, name: &str) -> (u64, u64) {
        self.network.bytes(name)
    }

    /// Returns the process id of the node of a host.
    pub(crate) fn process(&self, name: &str) -> u32 {
        self.programs[name].id()
    }

    /// Ends the process of a node with SIGKILL.
    pub(crate) fn kill(&mut self, name: &str) {
        self.programs.remove(name).expect("a node that runs").kill();
    }

    /// Returns the log of a node.
    pub(crate) fn log(&self, name: &str) -> String {
        self.programs.get(name).map(Program::stderr).unwrap_or_default()
    }

    /// Returns all logs, for the message of a failed test.
    pub(crate) fn logs(&self) -> String {
        self.programs.keys().map(|name| format!("--- {name}\n{}", self.log(name))).collect()
    }
}
