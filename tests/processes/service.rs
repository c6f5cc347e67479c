//! A node under a service manager: what it tells it, and when.

use crate::support::{Fleet, Folder, Program, example, until};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// How long whatever is certain to happen may take.
const LONG: Duration = Duration::from_secs(60);

/// The ear of a service manager: a socket by which the nodes that it starts reach it.
struct Manager {
    socket: UnixDatagram,
    path: PathBuf,
    heard: Vec<String>,
}

impl Manager {
    fn new() -> Manager {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        // The path of a socket has 107 characters at most, and that of a checkout may have more.
        let name = format!("consort-manager-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        let socket = UnixDatagram::bind(&path).expect("a socket");
        Manager { socket, path, heard: vec![] }
    }

    /// What the environment of its services says.
    fn variables(&self, watchdog: Duration) -> [String; 3] {
        let watchdog = watchdog.as_micros();
        ["env".to_owned(), format!("NOTIFY_SOCKET={}", self.path.display()), format!("WATCHDOG_USEC={watchdog}")]
    }

    /// Waits for the next thing that is said, at most for the limit.
    fn hears(&mut self, limit: Duration) -> Option<String> {
        self.socket.set_read_timeout(Some(limit)).expect("a limit");
        let mut buffer = [0; 4096];
        let length = self.socket.recv(&mut buffer).ok()?;
        let said = String::from_utf8(buffer[..length].to_vec()).expect("text");
        self.heard.push(said.clone());
        Some(said)
    }

    /// Waits until something is said that contains a line.
    #[track_caller]
    fn awaits(&mut self, line: &str) -> String {
        until(&format!("{line} is said; up to then: {:?}", self.heard), LONG, || {
            self.hears(Duration::from_millis(100)).filter(|said| said.lines().any(|of| of.starts_with(line)))
        })
    }
}

impl Drop for Manager {
    fn drop(&mut self) {
        // Nobody misses it if it has gone.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// More than any test takes.
const PATIENT: Duration = Duration::from_secs(600);

fn by(variables: &[String; 3]) -> [&str; 3] {
    variables.each_ref().map(String::as_str)
}

#[test]
fn a_node_says_that_it_is_there_once_it_is_how_it_is_linked_and_that_it_stops() {
    let mut manager = Manager::new();
    let mut fleet = Fleet::new(&example("fleet"));
    fleet.start("world", example("world"), &[]);
    fleet.address("world");
    fleet.start_by(&by(&manager.variables(PATIENT)), "station", example("station"), &["world"]);
    manager.awaits("READY=1");
    let log = fleet.node("station-1").stderr();
    assert!(log.contains(" open node=station-1") && log.contains(" started node=station-1"), "too early:\n{log}");
    assert!(!manager.heard.iter().any(|said| said.contains("STOPPING")), "{:?}", manager.heard);
    fleet.run(&["fleet"], "station-1").expect(0);
    let linked = "STATUS=linked with 1 neighbour";
    if !manager.heard.iter().any(|said| said.contains(linked)) {
        manager.awaits(linked);
    }
    fleet.kill("world");
    manager.awaits("STATUS=linked to nobody; keeps trying tcp/127.0.0.1:");
    fleet.node("station-1").signal("TERM");
    manager.awaits("STOPPING=1");
    fleet.ends("station-1");
    let told = |line: &str| manager.heard.iter().filter(|said| said.lines().any(|of| of == line)).count();
    assert_eq!((told("READY=1"), told("STOPPING=1")), (1, 1), "{:?}", manager.heard);
    fleet.stop();
}

#[test]
fn a_node_that_cannot_start_never_says_that_it_is_there() {
    let mut manager = Manager::new();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = format!("tcp/{}", taken.local_addr().expect("its address"));
    let folder = Folder::new();
    let arguments = ["station", "--name", "late", "--listen", &address];
    let ended = Program::start_by(&by(&manager.variables(PATIENT)), &folder, "late", &arguments).end(LONG).expect(2);
    assert!(ended.stderr.contains("the port is taken"), "{}", ended.stderr);
    assert_eq!(manager.hears(Duration::from_millis(100)), None);
}

#[test]
fn a_node_gives_signs_of_life_in_time_and_none_while_it_stands_still() {
    let mut manager = Manager::new();
    let mut fleet = Fleet::new(&example("fleet"));
    let patience = Duration::from_secs(3);
    fleet.start_by(&by(&manager.variables(patience)), "station", example("station"), &[]);
    manager.awaits("READY=1");
    for _ in 0..3 {
        manager.awaits("WATCHDOG=1");
    }
    fleet.node("station-1").signal("STOP");
    // What was on its way is heard still.
    while manager.hears(Duration::from_millis(50)).is_some() {}
    assert_eq!(manager.hears(patience), None, "it stands still");
    fleet.node("station-1").signal("CONT");
    manager.awaits("WATCHDOG=1");
    fleet.stop();
}
