//! Notifications of a node to its service manager.

use crate::support::{Fleet, Folder, LONG, Program, example, until};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Notification socket of a service manager.
struct Manager {
    socket: UnixDatagram,
    path: PathBuf,
    received: Vec<String>,
}

impl Manager {
    fn new() -> Manager {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        // The path of a socket has at most 107 characters, and a checkout may have a longer path.
        let name = format!("consort-manager-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        let socket = UnixDatagram::bind(&path).expect("a socket");
        Manager { socket, path, received: vec![] }
    }

    /// Returns the environment variables of its services.
    fn variables(&self, watchdog: Duration) -> [String; 3] {
        let watchdog = watchdog.as_micros();
        ["env".to_owned(), format!("NOTIFY_SOCKET={}", self.path.display()), format!("WATCHDOG_USEC={watchdog}")]
    }

    /// Waits at most `limit` for the next notification.
    fn receive(&mut self, limit: Duration) -> Option<String> {
        self.socket.set_read_timeout(Some(limit)).expect("a limit");
        let mut buffer = [0; 4096];
        let length = self.socket.recv(&mut buffer).ok()?;
        let notification = String::from_utf8(buffer[..length].to_vec()).expect("text");
        self.received.push(notification.clone());
        Some(notification)
    }

    /// Waits for a notification that contains a line.
    #[track_caller]
    fn awaits(&mut self, line: &str) -> String {
        until(&format!("notification {line}; received so far: {:?}", self.received), LONG, || {
            self.receive(Duration::from_millis(100))
                .filter(|notification| notification.lines().any(|of| of.starts_with(line)))
        })
    }
}

impl Drop for Manager {
    fn drop(&mut self) {
        // The file may be gone already.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// More than the duration of any test.
const PATIENT: Duration = Duration::from_secs(600);

fn by(variables: &[String; 3]) -> [&str; 3] {
    variables.each_ref().map(String::as_str)
}

#[test]
fn a_node_notifies_its_start_links_and_stop() {
    let mut manager = Manager::new();
    let mut fleet = Fleet::new(&example("fleet"));
    fleet.start("world", example("world"), &[]);
    fleet.address("world");
    fleet.start_by(&by(&manager.variables(PATIENT)), "station", example("station"), &["world"]);
    manager.awaits("READY=1");
    let log = fleet.node("station-1").stderr();
    assert!(log.contains(" open node=station-1") && log.contains(" started node=station-1"), "too early:\n{log}");
    assert!(!manager.received.iter().any(|notification| notification.contains("STOPPING")), "{:?}", manager.received);
    fleet.run(&["fleet"], "station-1").expect(0);
    let linked = "STATUS=linked with 1 neighbour";
    if !manager.received.iter().any(|notification| notification.contains(linked)) {
        manager.awaits(linked);
    }
    fleet.kill("world");
    manager.awaits("STATUS=no links; retrying tcp/127.0.0.1:");
    fleet.node("station-1").signal("TERM");
    manager.awaits("STOPPING=1");
    fleet.ends("station-1");
    let count =
        |line: &str| manager.received.iter().filter(|notification| notification.lines().any(|of| of == line)).count();
    assert_eq!((count("READY=1"), count("STOPPING=1")), (1, 1), "{:?}", manager.received);
    fleet.stop();
}

#[test]
fn a_node_that_cannot_start_never_reports_readiness() {
    let mut manager = Manager::new();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = format!("tcp/{}", taken.local_addr().expect("its address"));
    let folder = Folder::new();
    let arguments = ["station", "--name", "late", "--listen", &address];
    let ended = Program::start_by(&by(&manager.variables(PATIENT)), &folder, "late", &arguments).end(LONG).expect(2);
    assert!(ended.stderr.contains("the port is taken"), "{}", ended.stderr);
    assert_eq!(manager.receive(Duration::from_millis(100)), None);
}

#[test]
fn a_node_feeds_its_watchdog_unless_it_is_stopped() {
    let mut manager = Manager::new();
    let mut fleet = Fleet::new(&example("fleet"));
    let timeout = Duration::from_secs(3);
    fleet.start_by(&by(&manager.variables(timeout)), "station", example("station"), &[]);
    manager.awaits("READY=1");
    for _ in 0..3 {
        manager.awaits("WATCHDOG=1");
    }
    fleet.node("station-1").signal("STOP");
    // Drains notifications that were already on their way.
    while manager.receive(Duration::from_millis(50)).is_some() {}
    assert_eq!(manager.receive(timeout), None, "it stands still");
    fleet.node("station-1").signal("CONT");
    manager.awaits("WATCHDOG=1");
    fleet.stop();
}
