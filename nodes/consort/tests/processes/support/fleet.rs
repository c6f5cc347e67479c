//! A fleet with a process per node, from the example files.

use super::{Client, Ended, Folder, LONG, Program, example, until};
use std::collections::BTreeMap;
use toml::Table;

/// Program prefix and arguments of a node.
type Line = (Vec<String>, Vec<String>);

/// Node processes. Each listens on a free port chosen by the system.
pub(crate) struct Fleet {
    name: String,
    nodes: BTreeMap<String, Program>,
    addresses: BTreeMap<String, String>,
    /// Command line of each node.
    lines: BTreeMap<String, Line>,
    commands: u32,
    /// Additional router of each node.
    router: Option<String>,
    folder: Folder,
}

impl Fleet {
    /// Creates a fleet without nodes.
    pub(crate) fn new(fleet: &Table) -> Fleet {
        let folder = Folder::new();
        folder.write("fleet.toml", &fleet.to_string());
        let name = fleet["name"].as_str().expect("a fleet has a name").to_owned();
        let (nodes, addresses, lines) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        Fleet { name, nodes, addresses, lines, commands: 0, router: None, folder }
    }

    /// Same, with every node also linked to an external router.
    pub(crate) fn linked_with(router: &str, fleet: &Table) -> Fleet {
        let mut linked = Fleet::new(fleet);
        linked.router = Some(router.to_owned());
        linked
    }

    /// Starts a node with `consort KIND --config FILE`, linked to running nodes.
    pub(crate) fn start(&mut self, kind: &str, node: Table, neighbours: &[&str]) {
        self.start_by(&[], kind, node, neighbours);
    }

    /// Same, through another program that replaces itself by `consort`.
    pub(crate) fn start_by(&mut self, by: &[&str], kind: &str, mut node: Table, neighbours: &[&str]) {
        let name = node["name"].as_str().expect("a node has a name").to_owned();
        let mut connect: Vec<String> = neighbours.iter().map(|neighbour| self.address(neighbour)).collect();
        connect.extend(self.router.clone());
        // A node with certificates contains their path in its bus settings.
        let mut bus = node.get("bus").and_then(toml::Value::as_table).cloned().unwrap_or_default();
        bus.retain(|key, _| key == "certs");
        let listen = if bus.is_empty() { "tcp/127.0.0.1:0" } else { "tls/127.0.0.1:0" };
        bus.insert("listen".to_owned(), vec![listen].into());
        bus.insert("connect".to_owned(), connect.into());
        node.insert("bus".to_owned(), bus.into());
        let file = self.folder.write(&format!("{name}.toml"), &node.to_string());
        let file = file.display().to_string();
        let owned = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        let line = (owned(by), owned(&[kind, "--config", &file, "--until-stdin-closes"]));
        self.lines.insert(name.clone(), line);
        self.start_again(&name);
    }

    /// Restarts a stopped node with the same command line. It may listen on another port.
    pub(crate) fn start_again(&mut self, name: &str) {
        let (by, arguments) = self.lines.get(name).expect("a node of this fleet");
        let by: Vec<&str> = by.iter().map(String::as_str).collect();
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        self.addresses.remove(name);
        let program = Program::start_by(&by, &self.folder, name, &arguments);
        self.nodes.insert(name.to_owned(), program);
    }

    /// Returns a path in the folder of the fleet, for the data of a node or other files.
    pub(crate) fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    /// Returns a running node.
    pub(crate) fn node(&mut self, name: &str) -> &mut Program {
        self.nodes.get_mut(name).unwrap_or_else(|| panic!("{name} does not run"))
    }

    /// Removes a node that ends by itself.
    pub(crate) fn take(&mut self, name: &str) -> Program {
        self.nodes.remove(name).unwrap_or_else(|| panic!("{name} does not run"))
    }

    /// Returns the address of a node from its log.
    pub(crate) fn address(&mut self, name: &str) -> String {
        if let Some(address) = self.addresses.get(name) {
            return address.clone();
        }
        let node = self.nodes.get_mut(name).expect("a node of this fleet");
        let address = until(&format!("{name} logs its address"), LONG, || {
            let log = node.stderr();
            assert!(!node.has_ended(), "{name} has ended:\n{log}");
            let (_, rest) = log.split_once("listening=\"")?;
            let (address, _) = rest.split_once(['"', ','])?;
            Some(address.to_owned())
        });
        self.addresses.insert(name.to_owned(), address.clone());
        address
    }

    /// Removes a node that was told to end, and waits for its clean shutdown.
    pub(crate) fn ends(&mut self, name: &str) -> Ended {
        check_clean_shutdown(self.take(name))
    }

    /// Ends the process of a node with SIGKILL.
    pub(crate) fn kill(&mut self, name: &str) {
        self.nodes.remove(name).unwrap_or_else(|| panic!("{name} does not run")).kill();
    }

    /// Returns the names of the running nodes.
    pub(crate) fn names(&self) -> Vec<&str> {
        self.nodes.keys().map(String::as_str).collect()
    }

    /// Starts a command that queries the fleet.
    pub(crate) fn begin(&mut self, arguments: &[&str], by: &str) -> Program {
        self.begin_by(&[], arguments, by)
    }

    /// Same, through another program that replaces itself by `consort`.
    pub(crate) fn begin_by(&mut self, program: &[&str], arguments: &[&str], by: &str) -> Program {
        self.commands += 1;
        let (address, fleet) = (self.address(by), self.name.clone());
        let mut all = arguments.to_vec();
        all.extend(["--connect", &address, "--fleet", &fleet, "--timeout", "30"]);
        Program::start_by(program, &self.folder, &format!("command-{}", self.commands), &all)
    }

    /// Runs a command without a connection.
    pub(crate) fn tool(&mut self, arguments: &[&str]) -> Ended {
        self.commands += 1;
        Program::start(&self.folder, &format!("tool-{}", self.commands), arguments).end(LONG)
    }

    /// Runs a command that queries the fleet.
    pub(crate) fn run(&mut self, arguments: &[&str], by: &str) -> Ended {
        self.begin(arguments, by).end(LONG)
    }

    /// Stops all nodes and waits for their clean shutdown.
    pub(crate) fn stop(mut self) {
        // A node that has just started does not handle signals yet and would be killed by this one.
        for name in self.nodes.keys().cloned().collect::<Vec<_>>() {
            self.address(&name);
        }
        for node in self.nodes.values() {
            node.signal("TERM");
        }
        for (_, node) in std::mem::take(&mut self.nodes) {
            check_clean_shutdown(node);
        }
        self.folder.await_no_process();
    }

    /// Waits until the presence tokens of a dead node are removed.
    ///
    /// Zenoh 1.10.2 keeps a token, and logs it, if a router has removed the dead node from its graph
    /// before a router that does not know of the death announces the token again. Tokens are hints.
    pub(crate) fn wait_for_removed_tokens(&self, client: &Client, node: &str) {
        until(&format!("the tokens of {node} are removed, or Zenoh logs that it keeps them"), LONG, || {
            let present = client.present();
            let mut left = present.iter().filter(|token| token.ends_with(&format!("/{node}"))).peekable();
            let logs = if left.peek().is_some() { self.logs() } else { String::new() };
            left.all(|token| logs.contains(&format!("/alive/{token}: cannot get index of"))).then_some(())
        });
    }

    /// Returns the logs of all nodes, for the message of a failed test.
    pub(crate) fn logs(&self) -> String {
        self.nodes.iter().map(|(name, node)| format!("--- {name}\n{}", node.stderr())).collect()
    }
}

/// Prints the logs of the nodes if the test fails.
impl Drop for Fleet {
    #[expect(clippy::print_stderr, reason = "a failed test prints the logs")]
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("{}", self.logs());
        }
    }
}

/// Names of all views of [`hospital`] without missions.
pub(crate) const VIEWS: [&str; 13] = [
    "auctions",
    "audit",
    "coordinator",
    "ensembles",
    "fleet",
    "health",
    "map",
    "missions",
    "requests",
    "robot/ada",
    "robot/lab-arm",
    "schedules",
    "world",
];

/// Starts three stations as voters, so that the coordinator has no other task and can be killed.
pub(crate) fn hospital(name: &str) -> Fleet {
    start_hospital(Fleet::new(&named_fleet(name)))
}

/// Same, with every node also linked to an external router.
pub(crate) fn hospital_by(name: &str, router: &str) -> Fleet {
    start_hospital(Fleet::linked_with(router, &named_fleet(name)))
}

fn named_fleet(name: &str) -> Table {
    let mut file = example("fleet");
    file.insert("name".to_owned(), name.into());
    file
}

fn start_hospital(mut fleet: Fleet) -> Fleet {
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

/// Waits until a node has ended with exit code 0 and checks its log for problems.
#[track_caller]
fn check_clean_shutdown(node: Program) -> Ended {
    let ended = node.end(LONG).expect(0);
    // Zenoh 1.10.2 has a race when neighbours leave at once: while a session is closed, one of its
    // threads may panic about a closed peer (similar to its issue 2624). Everything of ours has
    // finished by then.
    let (lived, goodbye) = ended.stderr.split_once(" stops node=").expect("it logs its stop");
    let trouble = |line: &&str| line.contains(" ERROR consort") || line.contains("panicked at");
    let ours = |line: &&str| trouble(line) && !line.contains("/zenoh-");
    let found = lived.lines().find(trouble).or_else(|| goodbye.lines().find(ours));
    assert_eq!(found, None, "\n{}", ended.stderr);
    ended
}
