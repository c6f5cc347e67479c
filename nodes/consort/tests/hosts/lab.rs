//! A laboratory of hosts: network namespaces on a switch, each with a cable, an address and a
//! process.
//!
//! ```text
//!   this process ── 10.77.0.254 ── br0 ──┬── port 1 ~~~cable~~~ eth0 of host 1, 10.77.0.1
//!                                  br1   ├── port 2 ~~~cable~~~ eth0 of host 2, 10.77.0.2
//!                                  br2   └── …          a port may be moved to another bridge, or taken down
//!        host 1 ── 10.78.1.1 ~~~ 10.78.1.2 ── host 2   or hosts are linked directly, without forwarding
//! ```
//!
//! The namespaces belong to a user namespace of the test, so no privileges are needed where
//! unprivileged user namespaces are allowed. All of it ends with the first process in the
//! namespace.

use crate::slots::Slot;
use crate::support::{Client, Ended, Folder, LONG, Program, skip, until};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use toml::Table;

/// Set for a test that was restarted inside the namespaces.
const INSIDE: &str = "CONSORT_HOSTS_INSIDE";

/// Starts a program in its own namespaces: user, network, mount and process ids. All processes in
/// there end with their parent.
const UNSHARE: [&str; 6] = ["-Urnm", "--pid", "--fork", "--mount-proc", "--kill-child", "--"];

/// Runs a test in its own namespaces by restarting the test binary with the name of the test. Where
/// that is not allowed or a tool is missing, the test is skipped.
pub(crate) fn inside(name: &str, tools: &[&str], test: impl FnOnce()) {
    inside_again(&["--exact", name, "--nocapture"], tools, test);
}

/// Same for a program other than a test, restarted with these arguments.
pub(crate) fn inside_again(arguments: &[&str], tools: &[&str], test: impl FnOnce()) {
    let what = arguments.join(" ");
    if std::env::var_os(INSIDE).is_some() {
        run("mount", &["-t", "tmpfs", "none", "/run"]);
        return test();
    }
    if let Some(reason) = hindrance(tools) {
        return skip(&reason);
    }
    let _slot = Slot::take();
    let program = std::env::current_exe().expect("a test has a path");
    let mut again = Command::new("unshare");
    again.args(UNSHARE).arg(program).args(arguments);
    // In a namespace every test is process 1 or 2; this id distinguishes their folders.
    static TESTS: AtomicU32 = AtomicU32::new(0);
    let own = format!("{}-{}", std::process::id(), TESTS.fetch_add(1, Ordering::Relaxed));
    let status = again.env(INSIDE, own).status().expect("unshare was there a moment ago");
    assert!(status.success(), "inside its namespaces, {what} failed");
}

/// Returns the reason why there can be no laboratory here.
fn hindrance(tools: &[&str]) -> Option<String> {
    let mut script = String::from("set -e; ip link add br0 type bridge; ip link add v0 type veth peer name v1");
    for tool in tools {
        script += &format!("; command -v {tool} || {{ echo 'no program {tool}' >&2; exit 1; }}");
    }
    match Command::new("unshare").args(UNSHARE).args(["sh", "-c", &script]).output() {
        Ok(tried) if tried.status.success() => None,
        Ok(tried) => Some(String::from_utf8_lossy(&tried.stderr).trim().to_owned()),
        Err(problem) => Some(format!("no program unshare: {problem}")),
    }
}

/// Runs a program that must succeed.
#[track_caller]
pub(crate) fn run(program: &str, arguments: &[&str]) {
    let ended = Command::new(program).args(arguments).output();
    let ended = ended.unwrap_or_else(|problem| panic!("{program}: {problem}"));
    assert!(
        ended.status.success(),
        "{program} {}: {}",
        arguments.join(" "),
        String::from_utf8_lossy(&ended.stderr).trim()
    );
}

/// Runs `ip` with the arguments of a line.
#[track_caller]
pub(crate) fn ip(line: &str) {
    run("ip", &line.split(' ').collect::<Vec<_>>());
}

/// Direction in which packets of a host are dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Way {
    /// Packets to the host.
    In,
    /// Packets from the host.
    Out,
}

struct Host {
    number: usize,
    /// Addresses on direct links, by the other host; other hosts use its address on the switch.
    links: BTreeMap<String, String>,
    program: Option<Program>,
}

/// The hosts and the switch between them.
pub(crate) struct Lab {
    fleet: String,
    hosts: BTreeMap<String, Host>,
    links: usize,
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
        ip("link set lo up");
        for bridge in ["br0", "br1", "br2"] {
            ip(&format!("link add {bridge} type bridge"));
            ip(&format!("link set {bridge} up"));
        }
        ip("addr add 10.77.0.254/24 dev br0");
        let fleet = fleet["name"].as_str().expect("a fleet has a name").to_owned();
        Lab { fleet, hosts: BTreeMap::new(), links: 0, commands: 0, folder, closed: false }
    }

    /// Creates certificates for these nodes with their roles, and for a person with the read scope.
    /// Nodes start with certificates from now on.
    pub(crate) fn close(&mut self, nodes: &[(&str, &str)]) {
        let dir = self.certs("").display().to_string();
        let cert = |words: &[&str]| run(env!("CARGO_BIN_EXE_consort"), &[&["cert", "--dir", &dir], words].concat());
        cert(&["init", "--fleet", &self.fleet]);
        for (node, roles) in nodes {
            let serves: &[&str] = if roles.contains("host") { &["--serves", "*"] } else { &[] };
            cert(&[&["node", node, "--roles", roles], serves].concat());
        }
        cert(&["person", "looker", "--scope", "read"]);
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
        let number = self.hosts.len() + 1;
        ip(&format!("netns add {name}"));
        ip(&format!("-n {name} link set lo up"));
        self.hosts.insert(name.to_owned(), Host { number, links: BTreeMap::new(), program: None });
    }

    /// Adds a host with a cable to the switch.
    pub(crate) fn add(&mut self, name: &str) {
        self.add_apart(name);
        let number = self.hosts[name].number;
        ip(&format!("link add port{number} type veth peer name eth0 netns {name}"));
        ip(&format!("link set port{number} master br0 up"));
        ip(&format!("-n {name} addr add 10.77.0.{number}/24 dev eth0"));
        ip(&format!("-n {name} link set eth0 up"));
    }

    /// Joins two hosts by a direct cable.
    pub(crate) fn link(&mut self, a: &str, b: &str) {
        self.links += 1;
        let number = self.links;
        ip(&format!("link add l{number} netns {a} type veth peer name l{number} netns {b}"));
        for (host, other, last) in [(a, b, 1), (b, a, 2)] {
            ip(&format!("-n {host} addr add 10.78.{number}.{last}/24 dev l{number}"));
            ip(&format!("-n {host} link set l{number} up"));
            let address = format!("{}/10.78.{number}.{last}:7447", self.protocol());
            self.hosts.get_mut(host).expect("a host").links.insert(other.to_owned(), address);
        }
    }

    /// Returns the address of `to`, as seen by `from` if they have a direct cable.
    pub(crate) fn address(&self, to: &str, from: &str) -> String {
        let host = &self.hosts[to];
        host.links.get(from).cloned().unwrap_or_else(|| format!("{}/10.77.0.{}:7447", self.protocol(), host.number))
    }

    /// Starts the node of a host with `consort KIND --config FILE`, on all its addresses, linked to
    /// these hosts.
    pub(crate) fn start(&mut self, kind: &str, mut node: Table, neighbours: &[&str]) {
        let name = node["name"].as_str().expect("a node has a name").to_owned();
        let connect: Vec<String> = neighbours.iter().map(|other| self.address(other, &name)).collect();
        let mut bus = Table::new();
        bus.insert("listen".to_owned(), vec![format!("{}/0.0.0.0:7447", self.protocol())].into());
        if self.closed {
            bus.insert("certs".to_owned(), self.certs(&name).display().to_string().into());
        }
        bus.insert("connect".to_owned(), connect.into());
        node.insert("bus".to_owned(), bus.into());
        let file = self.folder.write(&format!("{name}.toml"), &node.to_string()).display().to_string();
        let arguments = [kind, "--config", &file, "--until-stdin-closes"];
        let program = Program::start_by(&within(&name), &self.folder, &name, &arguments);
        self.hosts.get_mut(&name).expect("a host").program = Some(program);
    }

    /// Waits until the nodes listen.
    pub(crate) fn await_open(&mut self) {
        for (name, host) in &mut self.hosts {
            let Some(program) = &mut host.program else { continue };
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
        let more = ["--connect", "tcp/127.0.0.1:7447", "--fleet", &self.fleet, "--timeout", &timeout];
        let program = Program::start_by(&within(on), &self.folder, &name, &[arguments, &more].concat());
        program.end(LONG)
    }

    /// Removes the cable of a host from the switch: both ends see the link go down.
    pub(crate) fn unplug(&self, name: &str) {
        ip(&format!("link set port{} down", self.hosts[name].number));
    }

    /// Plugs the cable of a host into a bridge.
    pub(crate) fn plug(&self, name: &str, bridge: &str) {
        let number = self.hosts[name].number;
        ip(&format!("link set port{number} master {bridge}"));
        ip(&format!("link set port{number} up"));
    }

    /// Drops a percentage of the packets of a host, in addition to previous rules. Its loopback is
    /// unaffected.
    pub(crate) fn lose(&self, name: &str, way: Way, percent: u32) {
        let (hook, device) = match way {
            Way::In => ("input", "iifname"),
            Way::Out => ("output", "oifname"),
        };
        let some = if percent < 100 { format!("numgen random mod 100 < {percent} ") } else { String::new() };
        let rules = format!(
            "add table inet faults; add chain inet faults {hook} {{ type filter hook {hook} priority 0; }}; \
             add rule inet faults {hook} {device} != lo {some}drop"
        );
        run("ip", &["netns", "exec", name, "nft", &rules]);
    }

    /// Ends all packet loss at a host.
    pub(crate) fn lose_nothing(&self, name: &str) {
        run("ip", &["netns", "exec", name, "nft", "add table inet faults; delete table inet faults"]);
    }

    /// Returns the process id of the node of a host.
    pub(crate) fn process(&self, name: &str) -> u32 {
        self.hosts[name].program.as_ref().expect("a node that runs").id()
    }

    /// Returns the bytes on the cable of a host: sent and received.
    pub(crate) fn bytes(&self, name: &str) -> (u64, u64) {
        let port = format!("port{}", self.hosts[name].number);
        let shown = Command::new("ip").args(["-s", "-j", "link", "show", "dev", &port]).output().expect("ip was there");
        let shown: serde_json::Value = serde_json::from_slice(&shown.stdout).expect("ip writes JSON");
        let count = |way: &str| shown[0]["stats64"][way]["bytes"].as_u64().expect("a number of bytes");
        (count("rx"), count("tx"))
    }

    /// Ends the process of a node with SIGKILL.
    pub(crate) fn kill(&mut self, name: &str) {
        self.hosts.get_mut(name).and_then(|host| host.program.take()).expect("a node that runs").kill();
    }

    /// Returns the log of a node.
    pub(crate) fn log(&self, name: &str) -> String {
        self.hosts[name].program.as_ref().map(Program::stderr).unwrap_or_default()
    }

    /// Returns all logs, for the message of a failed test.
    pub(crate) fn logs(&self) -> String {
        self.hosts.keys().map(|name| format!("--- {name}\n{}", self.log(name))).collect()
    }
}

/// Returns the prefix that runs a program on a host.
pub(crate) fn within(host: &str) -> [&str; 4] {
    ["ip", "netns", "exec", host]
}
