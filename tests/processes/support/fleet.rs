//! A fleet started by hand: a process for each node, from the example files.

use super::{Ended, Folder, Program, until};
use std::collections::BTreeMap;
use std::time::Duration;
use toml::Table;

/// How long a node may take to open its port.
const OPEN_LIMIT: Duration = Duration::from_secs(30);

/// How long a command that asks something may take.
const ANSWER_LIMIT: Duration = Duration::from_secs(60);

/// An example file, to be changed.
pub(crate) fn example(kind: &str) -> Table {
    let text = match kind {
        "fleet" => include_str!("../../../nodes/examples/fleet.toml"),
        "station" => include_str!("../../../nodes/examples/station.toml"),
        "world" => include_str!("../../../nodes/examples/world.toml"),
        "robot" => include_str!("../../../nodes/examples/robot.toml"),
        "arm" => include_str!("../../../nodes/examples/arm.toml"),
        other => panic!("there is no example of a {other}"),
    };
    let mut table: Table = text.parse().expect("the examples are TOML");
    // Stories count the samples that arrive: nothing else is to lie about.
    table.remove("object");
    // What the example has learned is in a file beside it, which is not beside the stories' own.
    table.remove("calibration");
    table
}

/// How long a node that was told to end may take to do so.
const END_LIMIT: Duration = Duration::from_secs(20);

/// How a node is started: by way of which program, and with which arguments.
type Line = (Vec<String>, Vec<String>);

/// Nodes in processes. Each listens on a port that the system gives it; nobody else can have taken it.
pub(crate) struct Fleet {
    name: String,
    nodes: BTreeMap<String, Program>,
    addresses: BTreeMap<String, String>,
    /// How each node was started.
    lines: BTreeMap<String, Line>,
    commands: u32,
    /// Where each node connects to beside its neighbours.
    router: Option<String>,
    folder: Folder,
}

impl Fleet {
    /// A fleet without nodes yet.
    pub(crate) fn new(fleet: &Table) -> Fleet {
        let folder = Folder::new();
        folder.write("fleet.toml", &fleet.to_string());
        let name = fleet["name"].as_str().expect("a fleet has a name").to_owned();
        let (nodes, addresses, lines) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        Fleet { name, nodes, addresses, lines, commands: 0, router: None, folder }
    }

    /// The same, each of whose nodes is linked with a router of somebody else's, too.
    pub(crate) fn linked_with(router: &str, fleet: &Table) -> Fleet {
        let mut linked = Fleet::new(fleet);
        linked.router = Some(router.to_owned());
        linked
    }

    /// Starts a node: `consort KIND --config FILE`, linked with nodes that run.
    pub(crate) fn start(&mut self, kind: &str, node: Table, neighbours: &[&str]) {
        self.start_by(&[], kind, node, neighbours);
    }

    /// The same by way of another program, which puts `consort` in its own place.
    pub(crate) fn start_by(&mut self, by: &[&str], kind: &str, mut node: Table, neighbours: &[&str]) {
        let name = node["name"].as_str().expect("a node has a name").to_owned();
        let mut connect: Vec<String> = neighbours.iter().map(|neighbour| self.address(neighbour)).collect();
        connect.extend(self.router.clone());
        // A node with certificates says where they are.
        let mut bus = node.get("bus").and_then(toml::Value::as_table).cloned().unwrap_or_default();
        bus.retain(|key, _| key == "certs");
        let listen = if bus.is_empty() { "tcp/127.0.0.1:0" } else { "tls/127.0.0.1:0" };
        bus.insert("listen".to_owned(), vec![listen].into());
        bus.insert("connect".to_owned(), connect.into());
        node.insert("bus".to_owned(), bus.into());
        let file = self.folder.write(&format!("{name}.toml"), &node.to_string());
        let file = file.display().to_string();
        let own = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        let line = (own(by), own(&[kind, "--config", &file, "--until-stdin-closes"]));
        self.lines.insert(name.clone(), line);
        self.start_again(&name);
    }

    /// Starts a node that was started before and runs no more, just as then. It may listen elsewhere.
    pub(crate) fn start_again(&mut self, name: &str) {
        let (by, arguments) = self.lines.get(name).expect("a node of this fleet");
        let by: Vec<&str> = by.iter().map(String::as_str).collect();
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        self.addresses.remove(name);
        let program = Program::start_by(&by, &self.folder, name, &arguments);
        self.nodes.insert(name.to_owned(), program);
    }

    /// A folder of this fleet's, for a node's data or whatever else.
    pub(crate) fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    /// A node that runs.
    pub(crate) fn node(&mut self, name: &str) -> &mut Program {
        self.nodes.get_mut(name).unwrap_or_else(|| panic!("{name} does not run"))
    }

    /// Takes a node that ends by itself out of the fleet.
    pub(crate) fn take(&mut self, name: &str) -> Program {
        self.nodes.remove(name).unwrap_or_else(|| panic!("{name} does not run"))
    }

    /// Where a node listens, as it says itself.
    pub(crate) fn address(&mut self, name: &str) -> String {
        if let Some(address) = self.addresses.get(name) {
            return address.clone();
        }
        let node = self.nodes.get_mut(name).expect("a node of this fleet");
        let address = until(&format!("{name} says where it listens"), OPEN_LIMIT, || {
            let said = node.stderr();
            assert!(!node.has_ended(), "{name} has ended:\n{said}");
            let (_, rest) = said.split_once("listening=\"")?;
            let (address, _) = rest.split_once(['"', ','])?;
            Some(address.to_owned())
        });
        self.addresses.insert(name.to_owned(), address.clone());
        address
    }

    /// Takes a node that was told to end out of the fleet, and waits until it has ended, well.
    pub(crate) fn ends(&mut self, name: &str) -> Ended {
        well(self.take(name))
    }

    /// Ends a node's process with SIGKILL.
    pub(crate) fn kill(&mut self, name: &str) {
        self.nodes.remove(name).unwrap_or_else(|| panic!("{name} does not run")).kill();
    }

    /// The names of the nodes that run.
    pub(crate) fn names(&self) -> Vec<&str> {
        self.nodes.keys().map(String::as_str).collect()
    }

    /// Starts a command that asks the fleet.
    pub(crate) fn begin(&mut self, arguments: &[&str], by: &str) -> Program {
        self.begin_by(&[], arguments, by)
    }

    /// The same by way of another program, which puts `consort` in its own place.
    pub(crate) fn begin_by(&mut self, program: &[&str], arguments: &[&str], by: &str) -> Program {
        self.commands += 1;
        let (address, fleet) = (self.address(by), self.name.clone());
        let mut all = arguments.to_vec();
        all.extend(["--connect", &address, "--fleet", &fleet, "--timeout", "30"]);
        Program::start_by(program, &self.folder, &format!("command-{}", self.commands), &all)
    }

    /// Runs a command that asks nobody, to its end.
    pub(crate) fn tool(&mut self, arguments: &[&str]) -> Ended {
        self.commands += 1;
        Program::start(&self.folder, &format!("tool-{}", self.commands), arguments).end(ANSWER_LIMIT)
    }

    /// Runs a command that asks the fleet, to its end.
    pub(crate) fn run(&mut self, arguments: &[&str], by: &str) -> Ended {
        self.begin(arguments, by).end(ANSWER_LIMIT)
    }

    /// Asks every node to end, and waits until all have, well.
    pub(crate) fn stop(mut self) {
        // Whoever was started a moment ago does not hear signals yet, and would die of this one.
        for name in self.nodes.keys().cloned().collect::<Vec<_>>() {
            self.address(&name);
        }
        for node in self.nodes.values() {
            node.signal("TERM");
        }
        for (_, node) in std::mem::take(&mut self.nodes) {
            well(node);
        }
        self.folder.await_no_process(Duration::from_secs(5));
    }

    /// What all nodes have logged, for the message of a failed test.
    pub(crate) fn logs(&self) -> String {
        self.nodes.iter().map(|(name, node)| format!("--- {name}\n{}", node.stderr())).collect()
    }
}

/// A story that fails shows what its nodes had logged.
impl Drop for Fleet {
    #[expect(clippy::print_stderr, reason = "a failed test tells why")]
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("{}", self.logs());
        }
    }
}

/// Three stations keep the ledger, so that whoever coordinates has nothing else to do and can be killed for it.
pub(crate) fn hospital(name: &str) -> Fleet {
    opened(Fleet::new(&named(name)))
}

/// The same, each of its nodes linked with a router that is none of ours, too.
pub(crate) fn hospital_by(name: &str, router: &str) -> Fleet {
    opened(Fleet::linked_with(router, &named(name)))
}

fn named(name: &str) -> Table {
    let mut file = example("fleet");
    file.insert("name".to_owned(), name.into());
    file
}

fn opened(mut fleet: Fleet) -> Fleet {
    let mut world = example("world");
    world.insert("speed".to_owned(), 20.0.into());
    fleet.start("world", world, &[]);
    for number in 1..=3 {
        let mut station = example("station");
        station.insert("name".to_owned(), format!("station-{number}").into());
        fleet.start("station", station, &["world"]);
    }
    for kind in ["robot", "arm"] {
        let mut robot = example(kind);
        robot.insert("may_vote".to_owned(), false.into());
        fleet.start("robot", robot, &["world"]);
    }
    fleet
}

/// Waits until a node has ended with exit code 0, and checks that it had no trouble.
#[track_caller]
fn well(node: Program) -> Ended {
    let ended = node.end(END_LIMIT).expect(0);
    // Zenoh 1.10.2 itself is not at its best when neighbours leave at once: while a session is closed, a thread of its own
    // may panic about what has gone already (like its issue 2624). All is said and done by then.
    let (lived, goodbye) = ended.stderr.split_once(" stops node=").expect("it says that it stops");
    let trouble = |line: &&str| line.contains(" ERROR consort") || line.contains("panicked at");
    let ours = |line: &&str| trouble(line) && !line.contains("/zenoh-");
    let found = lived.lines().find(trouble).or_else(|| goodbye.lines().find(ours));
    assert_eq!(found, None, "\n{}", ended.stderr);
    ended
}
