//! A fleet over plain HTTP: Zenoh's own router with its REST plug-in, both unmodified.
//!
//! `tests/foreign/run.sh zenoh` builds both in some minutes, and runs this test. It is skipped without the programs.

use crate::support::{Folder, LONG, VIEWS, free_port, hospital_by, skip, until};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Returns the folder with the router and its plug-in, if available.
fn programs() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("foreign-router");
    if folder.join("zenohd").exists() {
        return Some(folder);
    }
    skip("no zenohd with REST plug-in (tests/foreign/run.sh zenoh builds them)");
    None
}

/// A router with the plug-in, killed on drop.
struct Router {
    child: Child,
    /// Its Zenoh address.
    address: String,
    /// Its HTTP address.
    http: String,
    _folder: Folder,
}

impl Router {
    fn start(programs: &Path) -> Router {
        let folder = Folder::new();
        // The plug-in does not print its port, so the test chooses a port.
        let http = format!("127.0.0.1:{}", free_port());
        let log = folder.path().join("zenohd.out");
        let mut command = Command::new(programs.join("zenohd"));
        command.args(["--no-multicast-scouting", "--listen", "tcp/127.0.0.1:0", "--rest-http-port", &http]);
        command.arg("--plugin-search-dir").arg(programs).env("TMPDIR", folder.temporary()).env_remove("RUST_LOG");
        let out = File::create(&log).expect("the folder can be written to");
        let err = out.try_clone().expect("a file can be had twice");
        let mut child =
            command.stdin(Stdio::null()).stdout(out).stderr(err).spawn().expect("the router can be started");
        let address = until("the router logs its address", LONG, || {
            let log = fs::read_to_string(&log).ok()?;
            assert!(child.try_wait().expect("a child of ours").is_none(), "the router has ended:\n{log}");
            let (_, rest) = log.split_once("can be reached at: ")?;
            let (address, _) = rest.split_once('\n')?;
            TcpStream::connect(&http).ok()?;
            Some(address.trim().to_owned())
        });
        Router { child, address, http, _folder: folder }
    }

    /// Sends a request and returns a reader of the response body.
    fn request_stream(&self, request: &str, headers: &str, body: &str) -> BufReader<TcpStream> {
        let mut stream = TcpStream::connect(&self.http).expect("the router listens");
        stream.set_read_timeout(Some(LONG)).expect("a limit can be set");
        // HTTP/1.0 has no chunked encoding.
        write!(stream, "{request} HTTP/1.0\r\n{headers}Content-Length: {}\r\n\r\n{body}", body.len())
            .expect("it reads");
        let mut answer = BufReader::new(stream);
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            assert_ne!(answer.read_line(&mut head).expect("text"), 0, "{request}: {head}");
        }
        assert!(head.split(' ').nth(1) == Some("200"), "{request}: {head}");
        answer
    }

    /// Returns the replies by key. Each key may appear only once.
    fn answers(&self, request: &str, body: &str) -> BTreeMap<String, Value> {
        let mut text = String::new();
        let json = "Content-Type: application/json\r\n";
        self.request_stream(request, if body.is_empty() { "" } else { json }, body)
            .read_to_string(&mut text)
            .expect("text");
        let answers: Vec<Value> = serde_json::from_str(&text).unwrap_or_else(|problem| panic!("{problem}: {text}"));
        let mut by_key = BTreeMap::new();
        for answer in answers {
            assert_eq!(answer["encoding"], "application/json", "{answer}");
            let key = answer["key"].as_str().expect("a key").strip_prefix("consort/rest/").expect("of the fleet");
            assert_eq!(
                by_key.insert(key.to_owned(), answer["value"].clone()),
                None,
                "{key} was answered twice: {text}"
            );
        }
        by_key
    }

    fn get(&self, key: &str) -> BTreeMap<String, Value> {
        self.answers(&format!("GET /consort/rest/{key}"), "")
    }

    /// Repeats a request until a coordinator answers it.
    fn call(&self, call: &str, body: &Value) -> Value {
        until(&format!("a reply to {call}"), LONG, || {
            let mut answers = self.answers(&format!("POST /consort/rest/api/{call}"), &body.to_string());
            answers.remove(&format!("api/{call}")).filter(|answer| answer["retry_after_ms"].is_null())
        })
    }

    /// Subscribes to the events as server-sent events.
    fn follow(&self) -> Receiver<Value> {
        let stream = self.request_stream("GET /consort/rest/events/**", "Accept: text/event-stream\r\n", "");
        let (to, events) = channel();
        std::thread::spawn(move || {
            for line in stream.lines().map_while(Result::ok) {
                let Some(sample) = line.strip_prefix("data: ") else { continue };
                let sample: Value = serde_json::from_str(sample).expect("JSON");
                if to.send(sample["value"].clone()).is_err() {
                    break;
                }
            }
        });
        events
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn an_http_client_follows_a_mission_through_a_takeover() {
    let Some(programs) = programs() else { return };
    let router = Router::start(&programs);
    let mut fleet = hospital_by("rest", &router.address);
    let events = router.follow();
    let coordinator = until("there is a coordinator and the robots are members", LONG, || {
        let members = router.get("view/ensembles").remove("view/ensembles")?["ensembles"][0]["members"].clone();
        let view = router.get("view/coordinator").remove("view/coordinator")?;
        let node = view["node"].as_str()?.to_owned();
        (members.as_array()?.len() == 2).then_some(node)
    });

    // Six nodes could answer.
    let views = router.get("view/**");
    assert_eq!(views.keys().map(String::as_str).collect::<Vec<_>>(), VIEWS.map(|name| format!("view/{name}")));
    assert!(views.values().all(|view| view["seen_by"].is_string()), "{views:#?}");
    assert_eq!(views["view/coordinator"]["node"], coordinator.as_str());
    assert_eq!(views["view/robot/ada"]["robot"]["place"], "Dock");
    let seen = router.get("seen/*/coordinator");
    assert_eq!(seen.len(), 6, "each node has its own view: {seen:#?}");
    assert_eq!(router.get("api/submit/help")["api/submit/help"]["payload_schema"]["required"], json!(["mission"]));

    let refused = router.call("submit", &json!({ "mission": "lab-samples", "priority": "high" }));
    let error = refused["error"].as_str().expect("an error");
    assert!(error.starts_with("priority is a string; allowed is integer"), "{error}");
    let request = json!({ "mission": "lab-samples", "parameters": { "room": "IC Room 6" }, "request": "rest-1" });
    assert_eq!(router.call("submit", &request), json!({ "mission": "lab-samples-1", "again": false }));

    let (mut killed, mut elected, mut state) = (false, None, String::new());
    let (mut last, mut slowest) = (BTreeMap::new(), Duration::ZERO);
    let end = Instant::now() + LONG;
    while state != "completed" {
        assert!(Instant::now() < end, "lab-samples-1 is {state}\n{}", fleet.logs());
        let event = events.recv_timeout(Duration::from_millis(100));
        if let Ok(event) = event {
            let (node, sequence) = (event["node"].to_string(), event["sequence"].as_u64().expect("a number"));
            let before = last.insert(node, sequence);
            assert!(before.is_none_or(|before| before + 1 == sequence), "after {before:?} came {event}");
            match event["event"].as_str().expect("a name") {
                "task_began" if !killed => {
                    fleet.kill(&coordinator);
                    killed = true;
                }
                "elected" if event["node"] != coordinator.as_str() => {
                    elected = event["node"].as_str().map(str::to_owned);
                }
                "mission" if event["mission"] == "lab-samples-1" => {
                    state = event["state"].as_str().expect("a state").to_owned();
                }
                _ => {}
            }
        }
        // A node answers, whatever happens to the coordinator. Zenoh returns a query without a
        // reply if its target dies meanwhile; another node answers the next query.
        let began = Instant::now();
        let missions = until("a view of the missions", LONG, || {
            let answer = router.get("view/missions").remove("view/missions");
            assert!(killed || answer.is_some(), "no node replies, although all nodes run\n{}", fleet.logs());
            answer
        });
        slowest = slowest.max(began.elapsed());
        assert_eq!(missions["missions"][0]["mission"], "lab-samples-1", "{missions}");
    }
    let elected = elected.expect("a new coordinator was elected");
    assert!(slowest < Duration::from_secs(5), "a view took {slowest:?}");
    let again = json!({ "mission": "lab-samples-1", "again": true, "outcome": "completed" });
    assert_eq!(router.call("submit", &request), again);
    let explained = router.call("explain", &json!({ "mission": "lab-samples-1" }));
    assert!(explained["text"].to_string().contains("r1: ada gets the role with "), "{explained}");
    let now = router.get("view/coordinator").remove("view/coordinator").expect("a reply");
    assert_eq!(now["node"], elected.as_str(), "{now}");
    fleet.stop();
}
