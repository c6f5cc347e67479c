//! Third-party clients: Zenoh's Python library and `zenoh` of `zenoh-cli`. Recordings are read with
//! the library of the MCAP authors.
//!
//! `pip` installs them once into a folder of the build, over the network. Where that fails, the
//! tests are skipped.

use crate::support::{Client, LONG, hospital, skip, until};
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::io::{self, BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;

/// The installed packages.
const PACKAGES: [&str; 3] = ["eclipse-zenoh==1.10.2", "zenoh-cli==0.7.0", "mcap==1.6.0"];

/// Returns the folder with the programs of the clients, or the reason why there is none.
fn clients() -> &'static io::Result<PathBuf> {
    static CLIENTS: OnceLock<io::Result<PathBuf>> = OnceLock::new();
    CLIENTS.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("foreign-clients");
        let done = folder.join(PACKAGES.join("+"));
        if !done.exists() {
            run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&folder))?;
            let mut pip = Command::new(folder.join("bin/pip"));
            run(pip
                .args(["install", "--quiet", "--disable-pip-version-check", "--timeout", "20", "--retries", "1"])
                .args(PACKAGES))?;
            fs::write(&done, "")?;
        }
        Ok(folder.join("bin"))
    })
}

fn run(command: &mut Command) -> io::Result<String> {
    let what = format!("{command:?}");
    let ended = command
        .stdin(Stdio::null())
        .output()
        .map_err(|problem| io::Error::new(problem.kind(), format!("{what}: {problem}")))?;
    match ended.status.success() {
        true => Ok(String::from_utf8_lossy(&ended.stdout).into_owned()),
        false => Err(io::Error::other(format!("{what}: {}", String::from_utf8_lossy(&ended.stderr).trim()))),
    }
}

/// Returns the program of a client, if it is available.
fn program(name: &str) -> Option<PathBuf> {
    match clients() {
        Ok(bin) => Some(bin.join(name)),
        Err(why) => {
            skip(&format!("pip cannot install the third-party clients: {why}"));
            None
        }
    }
}

/// Process of a client, killed on drop.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_python_client_follows_a_mission_through_a_takeover() {
    let Some(python) = program("python") else { return };
    let mut fleet = hospital("python");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/processes/foreign/follow.py");
    let mut command = Command::new(python);
    command.arg(script).args([&fleet.address("world"), "python"]).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut client = Running(command.spawn().expect("python can be started"));
    let mut output = String::new();
    let (mut coordinator, mut elected) = (String::new(), String::new());
    let stdout = client.0.stdout.take().expect("it is piped");
    // The script has its own limits.
    for line in BufReader::new(stdout).lines() {
        let line = line.expect("text");
        writeln!(output, "{line}").expect("a string takes text");
        match line.split_once(' ').unwrap_or((line.as_str(), "")) {
            ("coordinator", node) => coordinator = node.to_owned(),
            ("running", _) => fleet.kill(&coordinator),
            ("completed", node) => elected = node.to_owned(),
            _ => {}
        }
    }
    let status = until("the script ends", LONG, || client.0.try_wait().expect("a child of ours"));
    let mut errors = String::new();
    if let Some(stderr) = client.0.stderr.take() {
        io::Read::read_to_string(&mut BufReader::new(stderr), &mut errors).expect("text");
    }
    assert!(status.success(), "{status}\n{output}\n{errors}\n{}", fleet.logs());
    assert!(elected.starts_with("station-") && elected != coordinator, "{output}");
    assert!(output.contains("explain r1: ada gets the role with "), "{output}");
    fleet.stop();
}

#[test]
fn the_zenoh_command_shows_each_view_once() {
    let Some(zenoh) = program("zenoh") else { return };
    let mut fleet = hospital("command");
    let address = fleet.address("world");
    let get = |what: &str, value: Option<&str>| {
        let mut command = Command::new(&zenoh);
        command.args([
            "--mode",
            "client",
            "--connect",
            &address,
            "get",
            "--encoder",
            "text",
            "--decoder",
            "text",
            "-s",
        ]);
        command.arg(format!("consort/command/{what}"));
        if let Some(value) = value {
            command.args(["--value", value]);
        }
        let lines = run(&mut command).unwrap_or_else(|problem| panic!("{problem}"));
        lines.lines().filter_map(|line| serde_json::from_str(line).ok()).collect::<Vec<Value>>()
    };
    until("there is a coordinator", LONG, || {
        let views = get("view/coordinator", None);
        views.first().filter(|view| view["node"].is_string()).map(|_| assert_eq!(views.len(), 1, "{views:?}"))
    });
    // Five nodes answer, and each view appears once.
    let views = get("view/**", None);
    assert_eq!(views.iter().filter(|view| view["missions"].is_array()).count(), 1, "{views:#?}");
    assert!(views.iter().all(|view| view["seen_by"].is_string()), "{views:#?}");
    let payload = r#"{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}, "request": "command-1"}"#;
    until("the mission is acknowledged", LONG, || {
        let answers = get("api/submit", Some(payload));
        answers.first().and_then(|answer| answer["mission"].as_str().map(|id| assert_eq!(id, "lab-samples-1")))
    });
    let seen = get("api/get", Some(r#"{"mission": "lab-samples-1"}"#));
    assert_eq!(seen.len(), 1, "{seen:?}");
    assert_eq!(seen[0]["request"], "command-1", "{seen:?}");
    let mut tokens = Command::new(&zenoh);
    tokens.args(["--mode", "client", "--connect", &address, "liveliness", "get", "-k", "consort/command/alive/**"]);
    let tokens = run(&mut tokens).unwrap_or_else(|problem| panic!("{problem}"));
    assert!(tokens.contains("consort/command/alive/robot/ada"), "{tokens}");
    fleet.stop();
}

#[test]
fn the_mcap_library_reads_a_recording() {
    let Some(python) = program("python") else { return };
    let mut fleet = hospital("foreign-reader");
    let file = fleet.path("run.mcap").display().to_string();
    let recorder = fleet.begin(&["record", "--out", &file, "--json"], "world");
    let payload = r#"{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}}"#;
    let mut client = Client::open(&fleet.address("world"), "foreign-reader");
    until("the mission is acknowledged", LONG, || {
        client.request("api/submit", payload)["mission"].as_str().map(|_| ())
    });
    client.wait_for_event("a task ends", LONG, |event| event["event"] == "task_ended");
    recorder.signal("TERM");
    let summary = recorder.end(LONG).expect(0).json();
    // An existing file is not overwritten.
    let again = fleet.run(&["record", "--out", &file], "world").expect(2);
    assert!(again.stderr.contains("this file exists already; --force replaces it"), "{}", again.stderr);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/processes/foreign/read_mcap.py");
    let contents = run(Command::new(python).arg(script).arg(&file)).unwrap_or_else(|problem| panic!("{problem}"));
    let contents: Value = serde_json::from_str(&contents).expect("JSON");
    assert_eq!(contents["metadata"]["consort.fleet"]["fleet"], "foreign-reader", "{contents:#}");
    assert_eq!(contents["topics"]["/events"]["messages"], summary["recorded"]["events"], "{contents:#}");
    for (topic, schema) in [
        ("/events", "consort.Event"),
        ("/coordinator", "consort.Beacon"),
        ("/view/missions", "consort.View"),
        ("/robots/ada/body", "consort.Body"),
        ("/robots/ada/pose", "foxglove.PoseInFrame"),
        ("/tf", "foxglove.FrameTransforms"),
        ("/map", "foxglove.SceneUpdate"),
        ("/robots", "foxglove.SceneUpdate"),
        ("/people", "foxglove.SceneUpdate"),
        ("/log", "foxglove.Log"),
    ] {
        assert_eq!(contents["topics"][topic]["schema"], schema, "{contents:#}");
    }
    fleet.stop();
}
