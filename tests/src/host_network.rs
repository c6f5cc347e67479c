//! A network of hosts: network namespaces on a switch, each with a cable and an address.
//!
//! ```text
//!   this process ── 10.77.0.254 ── br0 ──┬── port 1 ~~~cable~~~ eth0 of host 1, 10.77.0.1
//!                                  br1   ├── port 2 ~~~cable~~~ eth0 of host 2, 10.77.0.2
//!                                  br2   └── …          a port may be moved to another bridge, or taken down
//!        host 1 ── 10.78.1.1 ~~~ 10.78.1.2 ── host 2   or hosts are linked directly, without forwarding
//! ```
//!
//! The namespaces belong to a user namespace of the caller, so no privileges are needed where
//! unprivileged user namespaces are allowed. All of it ends with the first process in the
//! namespace.

use std::collections::BTreeMap;
use std::process::{Command, ExitStatus};

/// Set for a program that was started again inside its own namespaces. The value is unique among such
/// programs, which are all process 1 or 2.
pub const INSIDE: &str = "CONSORT_HOSTS_INSIDE";

/// Starts a program in its own namespaces: user, network, mount and process ids. All processes in
/// there end with their parent.
const UNSHARE: [&str; 6] = ["-Urnm", "--pid", "--fork", "--mount-proc", "--kill-child", "--"];

/// Checks whether this program runs inside its own namespaces, and prepares them if so.
pub fn is_inside() -> bool {
    let inside = std::env::var_os(INSIDE).is_some();
    if inside {
        run("mount", &["-t", "tmpfs", "none", "/run"]);
    }
    inside
}

/// Runs this program again with these arguments, in its own namespaces. `id` distinguishes it from
/// others at the same time.
///
/// # Errors
/// The reason why there can be no namespaces here, or no program of `tools`.
pub fn run_inside(arguments: &[&str], tools: &[&str], id: &str) -> Result<ExitStatus, String> {
    if let Some(reason) = hindrance(tools) {
        return Err(reason);
    }
    let program = std::env::current_exe().map_err(|problem| format!("this program has no path: {problem}"))?;
    let mut again = Command::new("unshare");
    again.args(UNSHARE).arg(program).args(arguments).env(INSIDE, id);
    again.status().map_err(|problem| format!("unshare cannot be started: {problem}"))
}

/// Returns the reason why there can be no namespaces here, or the first missing program of `tools`.
pub fn hindrance(tools: &[&str]) -> Option<String> {
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
///
/// # Panics
/// If it fails.
#[track_caller]
pub fn run(program: &str, arguments: &[&str]) {
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
///
/// # Panics
/// If it fails.
#[track_caller]
pub fn ip(line: &str) {
    run("ip", &line.split(' ').collect::<Vec<_>>());
}

/// Direction in which packets of a host are dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// Packets to the host.
    In,
    /// Packets from the host.
    Out,
}

#[derive(Debug)]
struct Host {
    number: usize,
    /// Ends of direct links, by the other host; other hosts use its address on the switch.
    links: BTreeMap<String, LinkEnd>,
}

/// End of a direct link at a host.
#[derive(Debug)]
struct LinkEnd {
    device: String,
    address: String,
}

/// The hosts and the switch between them.
#[derive(Debug)]
pub struct HostNetwork {
    hosts: BTreeMap<String, Host>,
    links: usize,
}

impl HostNetwork {
    /// Creates a switch without hosts.
    #[expect(clippy::new_without_default, reason = "it changes the network namespace")]
    pub fn new() -> HostNetwork {
        ip("link set lo up");
        for bridge in ["br0", "br1", "br2"] {
            ip(&format!("link add {bridge} type bridge"));
            ip(&format!("link set {bridge} up"));
        }
        ip("addr add 10.77.0.254/24 dev br0");
        HostNetwork { hosts: BTreeMap::new(), links: 0 }
    }

    /// Adds a host without a cable.
    pub fn add_apart(&mut self, name: &str) {
        let number = self.hosts.len() + 1;
        ip(&format!("netns add {name}"));
        ip(&format!("-n {name} link set lo up"));
        self.hosts.insert(name.to_owned(), Host { number, links: BTreeMap::new() });
    }

    /// Adds a host with a cable to the switch.
    pub fn add(&mut self, name: &str) {
        self.add_apart(name);
        let number = self.host(name).number;
        ip(&format!("link add port{number} type veth peer name eth0 netns {name}"));
        ip(&format!("link set port{number} master br0 up"));
        ip(&format!("-n {name} addr add 10.77.0.{number}/24 dev eth0"));
        ip(&format!("-n {name} link set eth0 up"));
    }

    /// Joins two hosts by a direct cable.
    pub fn link(&mut self, a: &str, b: &str) {
        self.links += 1;
        let number = self.links;
        ip(&format!("link add l{number} netns {a} type veth peer name l{number} netns {b}"));
        for (host, other, last) in [(a, b, 1), (b, a, 2)] {
            ip(&format!("-n {host} addr add 10.78.{number}.{last}/24 dev l{number}"));
            ip(&format!("-n {host} link set l{number} up"));
            let end = LinkEnd { device: format!("l{number}"), address: format!("10.78.{number}.{last}") };
            self.host_mut(host).links.insert(other.to_owned(), end);
        }
    }

    /// Limits the direct cable of two hosts to a rate in each direction, such as `1mbit` (needs `tc`).
    pub fn limit(&self, a: &str, b: &str, rate: &str) {
        for (host, other) in [(a, b), (b, a)] {
            let device = &self.host(host).links[other].device;
            let limit =
                format!("netns exec {host} tc qdisc add dev {device} root tbf rate {rate} burst 5kb latency 100ms");
            ip(&limit);
        }
    }

    /// Cuts the direct cable of two hosts: both ends see the link go down.
    pub fn cut(&self, a: &str, b: &str) {
        self.set_link(a, b, "down");
    }

    /// Restores a direct cable that was cut.
    pub fn restore(&self, a: &str, b: &str) {
        self.set_link(a, b, "up");
    }

    fn set_link(&self, a: &str, b: &str, state: &str) {
        for (host, other) in [(a, b), (b, a)] {
            let device = &self.host(host).links[other].device;
            ip(&format!("-n {host} link set {device} {state}"));
        }
    }

    /// Returns the address of `to`, as seen by `from` if they have a direct cable.
    pub fn address(&self, to: &str, from: &str) -> String {
        let host = self.host(to);
        host.links.get(from).map_or_else(|| format!("10.77.0.{}", host.number), |end| end.address.clone())
    }

    /// Removes the cable of a host from the switch: both ends see the link go down.
    pub fn unplug(&self, name: &str) {
        ip(&format!("link set port{} down", self.host(name).number));
    }

    /// Plugs the cable of a host into a bridge.
    pub fn plug(&self, name: &str, bridge: &str) {
        let number = self.host(name).number;
        ip(&format!("link set port{number} master {bridge}"));
        ip(&format!("link set port{number} up"));
    }

    /// Drops a percentage of the packets of a host, in addition to previous rules. Its loopback is
    /// unaffected.
    pub fn lose(&self, name: &str, way: Way, percent: u32) {
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
    pub fn lose_nothing(&self, name: &str) {
        run("ip", &["netns", "exec", name, "nft", "add table inet faults; delete table inet faults"]);
    }

    /// Returns the bytes on the cable of a host: sent and received.
    pub fn bytes(&self, name: &str) -> (u64, u64) {
        let port = format!("port{}", self.host(name).number);
        let shown = Command::new("ip").args(["-s", "-j", "link", "show", "dev", &port]).output().expect("ip was there");
        let shown: serde_json::Value = serde_json::from_slice(&shown.stdout).expect("ip writes JSON");
        let count = |way: &str| shown[0]["stats64"][way]["bytes"].as_u64().expect("a number of bytes");
        (count("rx"), count("tx"))
    }

    fn host(&self, name: &str) -> &Host {
        self.hosts.get(name).unwrap_or_else(|| panic!("there is no host {name}"))
    }

    fn host_mut(&mut self, name: &str) -> &mut Host {
        self.hosts.get_mut(name).unwrap_or_else(|| panic!("there is no host {name}"))
    }
}

/// Returns the prefix that runs a program on a host.
pub fn within(host: &str) -> [&str; 4] {
    ["ip", "netns", "exec", host]
}
