//! A fleet with certificates.

use super::{Fleet, example};
use std::path::PathBuf;
use toml::Table;

/// A fleet with a certificate authority and no running nodes yet.
pub(crate) struct Closed {
    pub(crate) fleet: Fleet,
    certs: PathBuf,
}

impl Closed {
    pub(crate) fn new() -> Closed {
        Closed::with_fleet(&example("fleet"))
    }

    /// Same, with this fleet file of the fleet `ward`.
    pub(crate) fn with_fleet(file: &Table) -> Closed {
        let fleet = Fleet::new(file);
        let certs = fleet.path("certs");
        let mut closed = Closed { fleet, certs };
        closed.cert(&["init", "--fleet", "ward"]);
        closed.cert(&["node", "world", "--roles", "host", "--serves", "ada,lab-arm,nurse"]);
        for (name, roles) in [("station-1", "voter,dashboard"), ("ada", "robot,voter"), ("lab-arm", "robot,voter")] {
            closed.cert(&["node", name, "--roles", roles]);
        }
        for scope in ["read", "submit", "operate"] {
            closed.cert(&["person", scope, "--scope", scope]);
        }
        closed
    }

    pub(crate) fn cert(&mut self, arguments: &[&str]) {
        let dir = self.certs.display().to_string();
        self.fleet.tool(&[&["cert", "--dir", &dir][..], arguments].concat()).expect(0);
    }

    pub(crate) fn of(&self, who: &str) -> PathBuf {
        self.certs.join(who)
    }

    pub(crate) fn start(&mut self, kind: &str, node: Table, neighbours: &[&str]) {
        self.start_by(&[], kind, node, neighbours);
    }

    /// Same, through another program that replaces itself by `consort`.
    pub(crate) fn start_by(&mut self, by: &[&str], kind: &str, mut node: Table, neighbours: &[&str]) {
        let name = node["name"].as_str().expect("a name").to_owned();
        let certs = self.of(&name).display().to_string();
        node["bus"].as_table_mut().expect("the examples contain bus settings").insert("certs".to_owned(), certs.into());
        self.fleet.start_by(by, kind, node, neighbours);
    }

    pub(crate) fn start_all(&mut self) {
        self.start("station", example("station"), &[]);
        self.start_others();
    }

    /// Starts all nodes except the station.
    pub(crate) fn start_others(&mut self) {
        let mut world = example("world");
        world.insert("speed".to_owned(), 20.0.into());
        self.start("world", world, &["station-1"]);
        self.start("robot", example("robot"), &["station-1", "world"]);
        self.start("robot", example("arm"), &["station-1", "world"]);
    }

    /// Creates a token of a person.
    pub(crate) fn token(&mut self, of: &str, more: &[&str]) -> String {
        let certs = self.of(of).display().to_string();
        let made = self.fleet.tool(&[&["token", "--certs", &certs], more].concat()).expect(0);
        made.stdout.trim().to_owned()
    }

    /// Returns the lines about rejected messages in the log of a node.
    pub(crate) fn refused(&mut self, by: &str) -> String {
        let log = self.fleet.node(by).stderr();
        log.lines().filter(|line| line.contains("rejected a message")).collect::<Vec<_>>().join("\n")
    }
}
