//! A fleet whose nodes have certificates works like any other fleet. Clients and nodes of other
//! fleets, and nodes that exceed their permissions, are rejected and logged.

use crate::support::{Answer, Closed, Folder, LONG, Program, config, example, http, until};
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::trust::SigningBus;
use consort_bus::zenoh_bus::{LinkTrust, Mode};
use consort_bus::{Bus, Delivery, Encoding, ZenohBus, ZenohSettings};
use consort_nodes::config::trust_files;
use consort_protocol::codec;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::RecordStamp;
use consort_protocol::message::{Beacon, ClusterEnvelope, RecordUpdate};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

fn ward() -> FleetId {
    FleetId::new("ward").expect("a name")
}

/// Opens a plain Zenoh client with or without a certificate.
pub(crate) fn session(address: &str, certs: Option<&Path>) -> zenoh::Result<zenoh::Session> {
    use zenoh::Wait;
    zenoh::open(config(address, certs)).wait()
}

fn threads() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("threads")
}

/// Opens the bus of a node with its certificate and a link. Returns the plain bus and the signing
/// bus.
async fn member(address: &str, certs: &Path) -> (ZenohBus, SigningBus) {
    let files = trust_files(certs);
    let links = Some(LinkTrust { files: files.clone(), fleet: ward() });
    let connect = vec![address.to_owned()];
    let settings = ZenohSettings { mode: Mode::Client, connect, link_trust: links, ..ZenohSettings::default() };
    let bus = ZenohBus::open(settings).await.expect("it is of the fleet");
    let clock = Clock::real();
    let life = clock.wall_ms();
    let keyring = files.open(&ward(), Duration::from_millis(life), life).expect("its files are right");
    let signing =
        SigningBus::open(Arc::new(bus.clone()), Keys::new(&ward()), Arc::new(keyring), files.revoked, clock).await;
    (bus, signing.expect("it shows its certificate"))
}

/// Sends a query with plain Zenoh and returns the replies.
fn query(session: &zenoh::Session, key: &str, payload: &str) -> Vec<Value> {
    use zenoh::Wait;
    use zenoh::query::QueryTarget;
    let query = session.get(key).payload(payload).target(QueryTarget::All).timeout(Duration::from_secs(5));
    let answers = query.wait().expect("a query can be sent");
    let samples = std::iter::from_fn(|| answers.recv().ok()).filter_map(|answer| answer.into_result().ok());
    samples.map(|sample| serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON")).collect()
}

#[test]
fn a_closed_fleet_completes_missions_after_a_takeover() {
    let mut closed = Closed::new();
    closed.start_all();
    let operator = closed.of("operate").display().to_string();
    let submit = ["submit", "lab-samples", "--set", "room=IC Room 6", "--wait", "--certs", &operator];
    let waiting = closed.fleet.begin(&submit, "world");
    let coordinator = until("a robot holds a role", LONG, || {
        let seen = closed.fleet.run(&["fleet", "--json", "--certs", &operator], "world").expect(0).json();
        let nodes = seen["fleet"]["nodes"].as_array()?.clone();
        nodes.iter().any(|node| node["holds"].is_object()).then(|| seen["coordinator"]["node"].clone())
    });
    closed.fleet.kill(coordinator.as_str().expect("a name"));
    // A robot that coordinates stops its simulated robot with it. The other robots continue, or the
    // mission waits for it.
    closed.fleet.start_again(coordinator.as_str().expect("a name"));
    let ended = waiting.end(LONG).expect(0);
    assert!(ended.stdout.ends_with("completed\n"), "{}", ended.stdout);
    for name in ["station-1", "world", "ada", "lab-arm"] {
        assert_eq!(closed.refused(name), "", "{name} rejects messages of its own fleet");
    }
    closed.fleet.stop();
}

#[test]
fn a_client_without_a_valid_certificate_gets_no_link() {
    let mut closed = Closed::new();
    closed.start("station", example("station"), &[]);
    let address = closed.fleet.address("station-1");
    let mut other = Closed::new();
    assert!(session(&address, None).is_err(), "no certificate");
    assert!(session(&address, Some(&other.of("operate"))).is_err(), "another fleet's");
    assert!(session(&address.replace("tls/", "tcp/"), None).is_err(), "no TLS");
    let own = session(&address, Some(&closed.of("read"))).expect("the fleet's own");
    until("the station replies", LONG, || query(&own, "consort/ward/view/fleet", "").pop());
    // The same with the commands: the command reports that nothing answers, and where to find the
    // reason.
    let stranger = other.of("operate").display().to_string();
    let missions = ["missions", "--certs", &stranger, "--connect", &address, "--timeout", "2"];
    let ended = other.fleet.tool(&missions).expect(3);
    assert!(ended.stderr.contains("`consort doctor` finds the cause"), "{}", ended.stderr);
    drop(own);
    closed.fleet.stop();
}

#[test]
fn the_doctor_reports_why_a_link_fails_and_what_to_do() {
    let mut closed = Closed::new();
    closed.start_all();
    let (address, mut other) = (closed.fleet.address("station-1"), Closed::new());
    closed.cert(&["person", "late", "--days", "1"]);
    closed.cert(&["revoke", "late"]);
    let mut examined = |certs: Option<PathBuf>, address: &str| -> (i32, Vec<(String, String, String)>) {
        let certs = certs.map(|certs| certs.display().to_string());
        let mut flags = vec!["doctor", "--json", "--timeout", "5", "--connect", address];
        flags.extend(certs.iter().flat_map(|certs| ["--certs", certs]));
        let ended = other.fleet.tool(&flags);
        let text = |finding: &Value, key: &str| finding[key].as_str().unwrap_or_default().to_owned();
        let report = ended.json();
        let findings = report.as_array().expect("a list").iter();
        let findings = findings.map(|of| (text(of, "state"), text(of, "about"), text(of, "text")));
        (ended.code(), findings.collect())
    };
    let foreign = Closed::new();
    let plain = address.replace("tls/", "tcp/");
    let link = format!("link {address}");
    let of = |findings: &[(String, String, String)], about: &str| {
        let finding = findings.iter().find(|(_, of, _)| of == about).unwrap_or_else(|| panic!("{about}: {findings:?}"));
        (finding.0.clone(), finding.2.clone())
    };
    let findings = until("nothing is the matter", LONG, || {
        let (code, findings) = examined(Some(closed.of("read")), &address);
        (code == 0).then_some(findings)
    });
    let (state, found) = of(&findings, &link);
    assert_eq!(
        (state.as_str(), found.as_str()),
        ("ok", "node station-1 (voter, dashboard) answers, and both ends accept each other's certificate")
    );
    assert!(
        findings.iter().any(|(_, about, text)| about == "node station-1" && text.contains("as here")),
        "{findings:?}"
    );
    for (certs, at, about, expected) in [
        (Some(foreign.of("operate")), &address, &link, "it was not signed by this fleet's authority"),
        (None, &address, &link, "the node requires a certificate"),
        (None, &plain, &format!("link {plain}"), "it closes the connection: it may require a certificate"),
    ] {
        let (code, findings) = examined(certs, at);
        let (state, found) = of(&findings, about);
        assert!(state == "error" && found.contains(expected), "{found}");
        assert_eq!(code, 1);
    }
    let late = closed.of("late");
    let (_, findings) = examined(Some(late.clone()), &address);
    let (state, found) = of(&findings, &format!("certificates {}", late.display()));
    assert!(state == "error" && found.ends_with("it has been revoked"), "{found}");
    closed.fleet.stop();
}

#[test]
fn the_link_of_a_person_permits_only_the_scope() {
    use zenoh::Wait;
    let mut closed = Closed::new();
    closed.start_all();
    let address = closed.fleet.address("station-1");
    let [reads, submits] = ["read", "submit"].map(|scope| session(&address, Some(&closed.of(scope))).expect("a link"));
    let events = submits.declare_subscriber("consort/ward/events/**").wait().expect("events can be followed");
    until("all are there", LONG, || {
        let fleet = query(&reads, "consort/ward/view/fleet", "").pop()?;
        let nodes = fleet["nodes"].as_array()?;
        (nodes.len() == 4 && fleet["coordinator"].is_string()).then_some(())
    });
    let request = json!({ "mission": "lab-samples", "parameters": { "room": "IC Room 6" } }).to_string();
    assert_eq!(
        query(&reads, "consort/ward/api/submit", &request),
        [] as [Value; 0],
        "the read scope does not permit to submit"
    );
    let commands = closed.of("read").display().to_string();
    let refused = closed.fleet.run(&["submit", "lab-samples", "--certs", &commands], "station-1").expect(2);
    assert!(refused.stderr.contains("read has scope read, and submit needs scope submit"), "{}", refused.stderr);
    // A stock client signs nothing; a command does.
    let unsigned = until("the coordinator rejects it", LONG, || {
        query(&submits, "consort/ward/api/submit", &request).into_iter().find(|answer| !answer["error"].is_null())
    });
    let problem = unsigned["error"].as_str().expect("a text");
    assert!(problem.starts_with("it is not signed: this fleet is closed") && problem.contains("--certs"), "{problem}");
    let certs = closed.of("submit").display().to_string();
    let submit = ["submit", "lab-samples", "--set", "room=IC Room 6", "--certs", &certs];
    let answer = closed.fleet.run(&submit, "station-1").expect(0);
    assert!(answer.stdout.contains("lab-samples-1"), "{}", answer.stdout);
    assert_eq!(
        query(&submits, "consort/ward/api/leave/ada", "{}"),
        [] as [Value; 0],
        "the submit scope does not permit to operate"
    );
    until("an event of the mission arrives", LONG, || {
        let event = events.recv_timeout(Duration::from_secs(5)).ok()??;
        let text = event.payload().try_to_string().ok()?.into_owned();
        text.contains("lab-samples-1").then_some(())
    });
    let log = closed.refused("station-1");
    assert!(log.lines().all(|line| line.contains("request api/submit rejected: it is not signed")), "{log}");
    // Zenoh drops a message of a person below wire/ before it reaches a node, so no node logs a
    // rejection.
    submits.put("consort/ward/wire/beacon", vec![1, 2, 3]).wait().expect("Zenoh stays silent");
    assert_eq!(query(&submits, "consort/ward/wire/report/ada", ""), [] as [Value; 0]);
    assert_eq!(closed.refused("station-1"), log);
    drop((events, reads, submits));
    closed.fleet.stop();
}

#[test]
fn a_long_running_client_keeps_its_first_session() {
    let mut closed = Closed::new();
    closed.start("station", example("station"), &[]);
    let (address, certs) = (closed.fleet.address("station-1"), closed.of("read").display().to_string());
    let folder = Folder::new();
    // Longer than the check for a silent link takes.
    let record = ["record", "--out", "run.mcap", "--for", "6s", "--certs", &certs, "--connect", &address];
    let ended = Program::start_by(&["env", "RUST_LOG=info"], &folder, "record", &record).end(LONG).expect(0);
    assert!(ended.stdout.contains("6 s, ") && !ended.stderr.contains("anew"), "{}{}", ended.stdout, ended.stderr);
    closed.fleet.stop();
}

#[test]
fn a_robot_that_forges_messages_is_rejected_and_logged() {
    let mut closed = Closed::new();
    closed.cert(&["node", "eve", "--roles", "robot"]);
    closed.start_all();
    let (runtime, keys) = (threads(), Keys::new(&ward()));
    let eve = runtime.block_on(member(&closed.fleet.address("station-1"), &closed.of("eve")));
    let arm = NodeId::new("lab-arm").expect("a name");
    let knowledge = keys.write(&Key::Knowledge(arm.clone()));
    let still =
        RecordUpdate::Refresh { stamp: RecordStamp { incarnation: u64::MAX, version: 1 }, since: 1, proof: None };
    let beacon = Beacon { node: arm, term: 1_000_000, voters: BTreeSet::new(), since_ms: 0, cluster: None, wire: None };
    let beacon = ClusterEnvelope { cluster: None, payload: codec::encode(&beacon).expect("a beacon") };
    let forgeries = [
        (
            knowledge.clone(),
            codec::encode_for_version(2, still).expect("a statement"),
            "may not publish on wire/knowledge/lab-arm",
        ),
        (keys.write(&Key::Beacon), codec::encode(&beacon).expect("a message"), "may not publish on wire/beacon"),
    ];
    for (key, payload, expected) in forgeries {
        until(&format!("the station notes it: {expected}"), LONG, || {
            let payload = Bytes::from(payload.clone());
            let published = eve.1.publish(&key, payload, Encoding::Wire, Delivery::Block);
            runtime.block_on(published).expect("eve publishes it");
            closed.refused("station-1").contains(&format!("node eve (robot) {expected}")).then_some(())
        });
    }
    // An unsigned message has no verified sender.
    until("the unsigned message is logged", LONG, || {
        let published = eve.0.publish(&knowledge, Bytes::from_static(b"?"), Encoding::Wire, Delivery::Block);
        runtime.block_on(published).expect("eve publishes it");
        closed
            .refused("station-1")
            .contains("message on wire/knowledge/lab-arm rejected: it is not signed")
            .then_some(())
    });
    // The beacon of eve has no effect, and lab-arm is unchanged.
    let reads = closed.of("read").display().to_string();
    let seen = closed.fleet.run(&["fleet", "--json", "--certs", &reads], "station-1").expect(0).json();
    assert_ne!(seen["coordinator"]["term"], 1_000_000, "{seen}");
    runtime.block_on(eve.0.close()).expect("the bus can be closed");
    closed.fleet.stop();
}

/// Replies to all queries on a key with the same text, for as long as the runtime lives.
async fn answer_on(bus: &dyn Bus, key: &str, text: &'static str) {
    let mut queries = bus.serve_complete(key).await.expect("a queryable can be declared");
    tokio::spawn(async move {
        while let Some(query) = queries.recv().await {
            let answer = Bytes::from_static(text.as_bytes());
            query.replier.reply(&query.key, answer, Encoding::Json).await.expect("the reply can be sent");
        }
    });
}

#[test]
fn the_key_of_a_robot_submits_nothing_and_makes_no_node_leave() {
    let mut closed = Closed::new();
    closed.cert(&["node", "eve", "--roles", "robot"]);
    closed.start_all();
    let (runtime, address) = (threads(), closed.fleet.address("station-1"));
    let reads = closed.of("read").display().to_string();
    until("there is a coordinator", LONG, || {
        let seen = closed.fleet.run(&["fleet", "--json", "--certs", &reads], "station-1").expect(0).json();
        (seen["coordinator"]["node"].is_string() && seen["fleet"]["nodes"].as_array()?.len() == 4).then_some(())
    });
    let request = json!({ "mission": "lab-samples", "parameters": { "room": "IC Room 6" } }).to_string();
    let stock = session(&address, Some(&closed.of("eve"))).expect("a link");
    let eve = runtime.block_on(member(&address, &closed.of("eve")));
    for (key, payload) in [("api/submit", request.as_str()), ("api/leave/station-1", "{}")] {
        let key = format!("consort/ward/{key}");
        let unsigned = until("a stock client is refused", LONG, || query(&stock, &key, payload).pop());
        assert!(unsigned["error"].as_str().is_some_and(|text| text.contains("it is not signed")), "{unsigned}");
        let signed = until("a node is refused", LONG, || {
            let asked = eve.1.query(&key, Bytes::from(payload.to_owned()), Duration::from_secs(5));
            let reply = runtime.block_on(async { asked.await.expect("a link").recv().await })?;
            serde_json::from_slice::<Value>(&reply.payload.ok()?).ok()
        });
        let problem = signed["error"].as_str().unwrap_or_default();
        assert_eq!(problem, "node eve (robot) may not make requests; a person signs them", "{signed}");
    }
    let missions = closed.fleet.run(&["missions", "--json", "--certs", &reads], "station-1").expect(0).json();
    assert_eq!(missions["missions"], json!([]), "{missions}");
    let nodes = closed.fleet.run(&["fleet", "--json", "--certs", &reads], "station-1").expect(0).json();
    assert_eq!(nodes["fleet"]["nodes"].as_array().map(Vec::len), Some(4), "{nodes}");
    runtime.block_on(eve.0.close()).expect("the bus can be closed");
    drop(stock);
    closed.fleet.stop();
}

#[test]
fn commands_reject_forged_replies_and_name_the_forger() {
    let mut closed = Closed::new();
    closed.cert(&["node", "eve", "--roles", "robot"]);
    closed.start_all();
    let (runtime, address) = (threads(), closed.fleet.address("station-1"));
    let [submits, reads] = ["submit", "read"].map(|who| closed.of(who).display().to_string());
    until("there is a coordinator", LONG, || {
        let seen = closed.fleet.run(&["fleet", "--json", "--certs", &reads], "station-1").expect(0);
        assert!(!seen.stderr.contains("rejected:"), "{}", seen.stderr);
        seen.json()["coordinator"]["node"].is_string().then_some(())
    });
    let eve = runtime.block_on(async {
        let eve = member(&address, &closed.of("eve")).await;
        // On the key of the coordinator she signs without the permission. On the key of any node
        // she has the permission but does not sign.
        answer_on(&eve.1, "consort/ward/api/submit", r#"{"mission": "forged-1", "again": false}"#).await;
        answer_on(&eve.0, "consort/ward/view/fleet", r#"{"nodes": [], "coordinator": "forged-1"}"#).await;
        eve
    });
    let stock = session(&address, Some(&closed.of("submit"))).expect("a link");
    until("a plain Zenoh client receives the forged reply of eve", LONG, || {
        query(&stock, "consort/ward/api/submit", "{}").into_iter().find(|answer| answer["mission"] == "forged-1")
    });
    // A command reports her only if her reply arrives first; it ignores replies after the valid
    // one.
    let submit = ["submit", "lab-samples", "--set", "room=IC Room 6", "--request", "one", "--certs", &submits];
    until("the forged reply arrives first and is reported", LONG, || {
        let ended = closed.fleet.run(&submit, "station-1").expect(0);
        assert!(ended.stdout.contains("lab-samples-1") && !ended.stdout.contains("forged-1"), "{}", ended.stdout);
        let expected = "rejected: node eve (robot) may not reply on api/submit";
        (ended.stderr.contains(expected) && ended.stderr.contains("`consort cert revoke NAME`")).then_some(())
    });
    until("the same of a view", LONG, || {
        let ended = closed.fleet.run(&["fleet", "--json", "--certs", &reads], "station-1").expect(0);
        assert_eq!(ended.json()["fleet"]["nodes"].as_array().map(Vec::len), Some(4), "{}", ended.stdout);
        ended.stderr.contains("rejected: message on view/fleet rejected: it is not signed").then_some(())
    });

    // Forged events of another node during a recording.
    let folder = Folder::new();
    let record = ["record", "--out", "run.mcap", "--for", "8s", "--certs", &reads, "--connect", &address];
    let mut recording = Program::start(&folder, "record", &record);
    let forged =
        json!({ "node": "station-1", "sequence": 1, "at_ms": 1, "event": "elected", "term": 77_777 }).to_string();
    until("the recording ends", LONG, || {
        let forged = Bytes::from(forged.clone());
        let published = eve.1.publish("consort/ward/events/station-1", forged, Encoding::Json, Delivery::Block);
        runtime.block_on(published).expect("eve publishes it");
        recording.has_ended().then_some(())
    });
    let ended = recording.end(LONG).expect(0);
    assert!(
        ended.stderr.contains("rejected: node eve (robot) may not publish on events/station-1"),
        "{}",
        ended.stderr
    );
    let recorded = std::fs::read(folder.path().join("run.mcap")).expect("a recording");
    let holds = |text: &str| recorded.windows(text.len()).any(|part| part == text.as_bytes());
    assert!(
        holds("lab-samples-1") && !holds("77777"),
        "the recording must contain the valid events and no forged event"
    );
    runtime.block_on(eve.0.close()).expect("the bus can be closed");
    drop(stock);
    closed.fleet.stop();
}

#[test]
fn links_of_a_revoked_certificate_end_and_stay_closed() {
    let mut closed = Closed::new();
    closed.cert(&["node", "station-2", "--roles", "voter"]);
    closed.cert(&["person", "late", "--scope", "read"]);
    closed.start("station", example("station"), &[]);
    let mut second = example("station");
    second.insert("name".to_owned(), "station-2".into());
    closed.start("station", second, &["station-1"]);
    let mut world = example("world");
    world.insert("speed".to_owned(), 20.0.into());
    closed.start("world", world, &["station-1"]);
    // It opens a link to the node that will be revoked; station-1 accepts a link from that node.
    closed.start("robot", example("robot"), &["station-1", "station-2"]);
    let reads = closed.of("read").display().to_string();
    let alive = |closed: &mut Closed| -> Vec<String> {
        let seen = closed.fleet.run(&["fleet", "--json", "--certs", &reads], "station-1").expect(0).json();
        let nodes = seen["fleet"]["nodes"].as_array().cloned().unwrap_or_default();
        let alive = nodes.iter().filter(|node| node["alive"] == true);
        alive.map(|node| node["node"].as_str().expect("a name").to_owned()).collect()
    };
    let all = ["ada", "station-1", "station-2", "world"];
    until("all are there", LONG, || (alive(&mut closed) == all).then_some(()));
    let (runtime, address) = (threads(), closed.fleet.address("station-1"));
    let late = runtime.block_on(member(&address, &closed.of("late"))).0;
    let linked = |bus: &ZenohBus| !runtime.block_on(bus.links()).is_empty();
    assert!(linked(&late));
    closed.cert(&["revoke", "station-2"]);
    closed.cert(&["revoke", "late"]);
    // Long before a lease expires or a certificate is rechecked: nodes read the revocation list
    // every two seconds.
    until("the person's link has ended", Duration::from_secs(20), || (!linked(&late)).then_some(()));
    until("the node is out", LONG, || (alive(&mut closed) == ["ada", "station-1", "world"]).then_some(()));
    for node in ["station-1", "ada"] {
        until(&format!("{node} logs the rejected link"), LONG, || {
            let log = closed.refused(node);
            log.contains("link to node station-2 (voter) rejected: its certificate has been revoked").then_some(())
        });
    }
    // They keep trying without success.
    let tried = closed.refused("station-1").lines().count();
    until("they are turned away once more", LONG, || {
        (closed.refused("station-1").lines().count() > tried).then_some(())
    });
    assert!(!linked(&late), "a client that was cut off comes back by itself, if it is let in");
    assert!(session(&address, Some(&closed.of("late"))).is_err(), "nor with a session of its own");
    assert_eq!(alive(&mut closed), ["ada", "station-1", "world"]);
    closed.fleet.stop();
}

#[test]
fn a_command_leaves_no_errors_in_the_log_of_its_node() {
    let mut closed = Closed::new();
    closed.start("station", example("station"), &[]);
    let reads = closed.of("read").display().to_string();
    for _ in 0..3 {
        closed.fleet.run(&["fleet", "--certs", &reads], "station-1").expect(0);
    }
    let log = closed.fleet.node("station-1").stderr();
    assert!(!log.contains("ERROR"), "{log}");
    closed.fleet.stop();
}

#[test]
fn a_node_with_a_wrong_certificate_does_not_start() {
    let mut closed = Closed::new();
    for (certs, expected) in [
        ("ada", "it belongs to node ada, and this is station-1"),
        ("read", "it belongs to person read (read), and nodes have certificates of their own"),
        ("unknown", "ca.pem: "),
    ] {
        let certs = closed.of(certs).display().to_string();
        let ended = closed.fleet.tool(&["station", "--name", "station-1", "--certs", &certs]).expect(2);
        assert!(ended.stderr.contains(expected), "{}", ended.stderr);
    }
    let certs = closed.of("world").display().to_string();
    let ended = closed.fleet.tool(&["station", "--name", "world", "--certs", &certs]).expect(2);
    assert!(ended.stderr.contains("it does not permit world to be a voter, and may_vote is true"), "{}", ended.stderr);
    let listens = ["station", "--name", "world", "--certs", &certs, "--listen", "tcp/127.0.0.1:0"];
    let ended = closed.fleet.tool(&listens).expect(2);
    assert!(ended.stderr.contains("the protocol is tls for a node that has certificates"), "{}", ended.stderr);
}

/// Returns the address of a service from the output of a node.
pub(crate) fn served(closed: &mut Closed, by: &str, before: &str) -> String {
    until(&format!("{by} prints: {before}"), LONG, || {
        let node = closed.fleet.node(by);
        let output = [node.stdout(), node.stderr()].concat();
        let (_, rest) = output.split_once(before)?;
        Some(rest.split(['/', '\n', '"']).next()?.to_owned())
    })
}

#[test]
fn an_http_token_determines_identity_and_permissions() {
    let mut closed = Closed::new();
    let mut station = example("station");
    station.insert("dashboard".to_owned(), "127.0.0.1:0".into());
    station["telemetry"].as_table_mut().expect("a table").insert("metrics".to_owned(), "127.0.0.1:0".into());
    closed.start("station", station, &[]);
    closed.start_others();
    let [page, metrics] =
        ["dashboard: http://", "metrics at http://"].map(|what| served(&mut closed, "station-1", what));
    let error = |answer: &Answer| answer.json()["error"].as_str().unwrap_or_default().to_owned();

    // The page itself is public and contains no data.
    for open in ["GET /", "GET /session.js", "GET /healthz"] {
        assert_eq!(http(&page, open, &[], "").status, 200, "{open}");
    }
    let shut = ["GET /api/fleet", "GET /api/history.csv", "GET /api/audit", "GET /api/audit.jsonl"];
    for (at, shut) in shut.map(|shut| (&page, shut)).into_iter().chain([(&metrics, "GET /metrics")]) {
        let answer = http(at, shut, &[], "");
        assert_eq!(answer.status, 401, "{shut}");
        assert!(error(&answer).contains("`consort token --certs DIR` makes a token"), "{}", answer.body);
        assert!(answer.heads.contains("www-authenticate: Bearer"), "{}", answer.heads);
    }
    let upgrade_headers = [
        ("Connection", "Upgrade, close"),
        ("Upgrade", "websocket"),
        ("Sec-WebSocket-Version", "13"),
        ("Sec-WebSocket-Key", "AAAAAAAAAAAAAAAAAAAAAA=="),
    ];
    assert_eq!(http(&page, "GET /ws", &upgrade_headers, "").status, 401);

    let [reads, submits, operates] = ["read", "submit", "operate"].map(|who| closed.token(who, &[]));
    let with = |token: &str, request: &str, body: &str| {
        let bearer = format!("Bearer {token}");
        http(&page, request, &[("Authorization", &bearer), ("Content-Type", "application/json")], body)
    };
    assert_eq!(with(&reads, "GET /api/fleet", "").json()["full"]["fleet"], "ward");
    assert_eq!(http(&metrics, "GET /metrics", &[("Authorization", &format!("Bearer {reads}"))], "").status, 200);
    let order = json!({ "mission": "lab-samples", "parameters": { "room": "IC Room 6" } }).to_string();
    let refused = with(&reads, "POST /api/missions", &order);
    assert_eq!(
        (refused.status, error(&refused)),
        (403, "the token of read has scope read; this request needs scope submit".to_owned())
    );
    let taken = until("a coordinator accepts the mission", LONG, || {
        let answer = with(&submits, "POST /api/missions", &order);
        (answer.status == 200).then(|| answer.json())
    });
    assert_eq!(taken["mission"], "lab-samples-1");
    let rescued = "POST /api/missions/lab-samples-1/resolve";
    assert_eq!(with(&submits, rescued, "{}").status, 403);
    let refused = error(&with(&operates, rescued, "{}"));
    assert!(refused.ends_with("only a mission that needs intervention can be resolved"), "{refused}");
    let withdrawn = with(&submits, "POST /api/missions/lab-samples-1/cancel", "{}");
    assert_eq!(withdrawn.status, 200, "{}", withdrawn.body);
    until("the event names the person", LONG, || {
        let events = with(&reads, "GET /api/events?mission=lab-samples-1", "").body;
        events.contains("by submit").then_some(())
    });

    let rounds = "POST /api/schedules/rounds";
    let submit: Value = serde_json::from_str(&order).expect("JSON");
    let adds = json!({ "action": "add", "cron": "0 8 * * *", "submit": submit }).to_string();
    assert_eq!(with(&reads, rounds, &adds).status, 403);
    let added = with(&submits, rounds, &adds);
    assert_eq!(added.status, 200, "{}", added.body);
    let by = added.json()["schedule"]["by"].clone();
    assert!(by.as_str().is_some_and(|by| by.starts_with("submit")), "{by}");
    let hold = json!({ "robots": "all", "for_s": 60 }).to_string();
    let refused = with(&reads, "POST /api/hold", &hold);
    assert_eq!(
        (refused.status, error(&refused)),
        (403, "the token of read has scope read; this request needs scope submit".to_owned())
    );
    for path in ["limit", "alarm", "priority", "reassign", "missions/cancel", "robots/select"] {
        assert_eq!(with(&reads, &format!("POST /api/{path}"), "{}").status, 403, "{path}");
        let empty = with(&submits, &format!("POST /api/{path}"), "{}");
        assert_eq!(empty.status, 400, "it is read: {path}: {}", empty.body);
    }
    let group = json!({ "robots": { "where": "robot.name == \"ada\"" } }).to_string();
    until("a preview of a group", LONG, || {
        (with(&submits, "POST /api/robots/select", &group).json()["robots"] == json!(["ada"])).then_some(())
    });
    let by = until("ada is held", LONG, || {
        let held = with(&submits, "POST /api/hold", &hold);
        Some(held.json()["robots"]["ada"]["hold"]["by"].as_str()?.to_owned())
    });
    assert!(by.starts_with("submit"), "{by}");
    until("the robots are released", LONG, || {
        (with(&submits, "POST /api/release", r#"{ "robots": "all" }"#).status == 200).then_some(())
    });
    until("the trail names the signer of each order", LONG, || {
        let trail = with(&reads, "GET /api/audit", "").json();
        let entries = trail["entries"].as_array()?;
        let is_there = |action: &str| entries.iter().any(|entry| entry["action"] == action && entry["by"] == by);
        (is_there("hold") && is_there("release")).then_some(())
    });
    assert!(with(&reads, "GET /api/audit.jsonl", "").body.contains(&format!("{by:?}")));

    // A person who may submit some missions is offered these alone, and no other is executed.
    closed.cert(&["person", "lee", "--scope", "submit", "--missions", "vital-signs"]);
    let lee = closed.token("lee", &[]);
    let offered = with(&lee, "GET /api/named-missions", "").json();
    let names: Vec<&Value> =
        offered["missions"].as_array().expect("a list").iter().map(|one| &one["mission"]).collect();
    assert_eq!(names, [&json!("vital-signs")]);
    let all = with(&submits, "GET /api/named-missions", "").json();
    assert!(all["missions"].as_array().is_some_and(|missions| missions.len() > 1), "{all}");
    let allowed = "the right `missions` of the certificate allows vital-signs, by name";
    let refused = with(&lee, "POST /api/missions", &order);
    assert_eq!((refused.status, error(&refused)), (400, format!("lee may not submit \"lab-samples\": {allowed}")));
    let raised = json!({ "mission": "lab-samples-1", "priority": 5 }).to_string();
    let refused = error(&with(&lee, "POST /api/priority", &raised));
    assert!(refused.starts_with("only people who may submit a mission change it: lee may not submit"), "{refused}");
    let file = json!({ "mission": { "mission": "vital-signs", "roles": {}, "root": {} } }).to_string();
    assert_eq!(
        error(&with(&lee, "POST /api/missions", &file)),
        format!("lee may not submit a mission file: {allowed}")
    );
    let certs = closed.of("lee").display().to_string();
    let add = ["schedule", "add", "daily", "--cron", "0 8 * * *", "lab-samples", "--certs", &certs];
    let refused = closed.fleet.run(&add, "station-1").expect(1).stderr;
    assert!(refused.contains(&format!("lee may not submit \"lab-samples\": {allowed}")), "{refused}");
    let permitted = json!({ "mission": "vital-signs" }).to_string();
    let taken = with(&lee, "POST /api/missions", &permitted);
    assert!(taken.json()["mission"].as_str().is_some_and(|id| id.starts_with("vital-signs-")), "{}", taken.body);

    // A session stores the token in a cookie that scripts cannot read.
    let session = http(
        &page,
        "POST /api/session",
        &[("Content-Type", "application/json")],
        &json!({ "token": reads }).to_string(),
    );
    assert_eq!(
        (session.status, &session.json()["name"], &session.json()["scope"]),
        (200, &json!("read"), &json!("read"))
    );
    let cookie = session.heads.lines().find_map(|line| line.strip_prefix("set-cookie: ")).expect("a cookie");
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
    let session_cookie = cookie.split(';').next().expect("its name and value");
    assert_eq!(http(&page, "GET /api/fleet", &[("Cookie", session_cookie)], "").status, 200);

    // All of these tokens are invalid.
    let mut other = Closed::new();
    let foreign = other.token("operate", &[]);
    let mut parts: Vec<&str> = reads.split('.').collect();
    let claims = submits.split('.').nth(1).expect("three parts").to_owned();
    parts[1] = &claims;
    for (token, why) in [
        (foreign, "it was not signed by this fleet's authority"),
        (parts.join("."), "the token was not signed with the key of its certificate"),
        ("abc".to_owned(), "malformed token: it does not consist of three parts"),
    ] {
        let answer = with(&token, "GET /api/fleet", "");
        assert!(answer.status == 401 && error(&answer).contains(why), "{}", answer.body);
    }
    let brief = closed.token("read", &["--for", "1s"]);
    until("a token ends", LONG, || error(&with(&brief, "GET /api/fleet", "")).contains("ago").then_some(()));
    closed.cert(&["revoke", "operate"]);
    until("the station has the new list", LONG, || {
        error(&with(&operates, "GET /api/fleet", "")).contains("it has been revoked").then_some(())
    });
    closed.fleet.stop();
}

#[test]
fn a_token_is_limited_to_people_and_their_scope() {
    let mut closed = Closed::new();
    for (name, more, expected) in [
        ("station-1", &[][..], "it belongs to node station-1 (voter, dashboard), and only people have tokens"),
        ("submit", &["--scope", "operate"], "the token claims scope operate, but submit has scope submit"),
        ("unknown", &[], "ca.pem: "),
    ] {
        let certs = closed.of(name).display().to_string();
        let ended = closed.fleet.tool(&[&["token", "--certs", &certs], more].concat()).expect(2);
        assert!(ended.stderr.contains(expected), "{}", ended.stderr);
    }
}
