use super::support::{Running, command, free_address, run};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[test]
fn a_client_without_a_connection_reports_a_remedy() {
    let address = free_address();
    for command in [&["missions"][..], &["fleet"], &["submit", "lab-samples"], &["cancel", "m-1"]] {
        let ran = run(&[command, &["--connect", &address, "--timeout", "0.3"]].concat());
        assert_eq!(ran.code, Some(3), "{command:?}: {}", ran.err);
        let expected = format!("consort: not connected: no node answers at {address}");
        assert!(ran.err.contains(&expected), "{command:?}: {}", ran.err);
        assert!(ran.err.contains("--connect tcp/HOST:PORT"), "{command:?}: {}", ran.err);
    }
}

#[test]
fn the_key_list_matches_the_key_module() {
    use consort_protocol::keys::TABLE;
    let ran = run(&["keys", "--fleet", "north"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let lines: Vec<&str> = ran.out.lines().skip(1).collect();
    assert_eq!(lines.len(), TABLE.len(), "{}", ran.out);
    for (line, about) in lines.iter().zip(TABLE) {
        let key = format!("consort/north/{}", about.pattern);
        assert_eq!(line.split_whitespace().next(), Some(key.as_str()), "{line}");
        assert!(line.contains(about.owner) && line.contains(about.what), "{line}");
    }
    let ran = run(&["keys", "--json"]);
    let keys: serde_json::Value = serde_json::from_str(&ran.out).expect("JSON");
    let submit = keys["keys"].as_array().expect("a list").iter().find(|key| key["key"] == "consort/ward/api/submit");
    let submit = submit.expect("it is listed");
    assert_eq!((&submit["usage"], &submit["encoding"]), (&"answers".into(), &"application/json".into()), "{submit}");
    let ran = run(&["keys", "--fleet", "a b"]);
    assert_eq!(ran.code, Some(2), "{}", ran.out);
}

#[test]
fn a_single_station_coordinates_accepts_missions_and_stops() {
    let address = free_address();
    let station = command(&["station", "--name", "s1", "--listen", &address])
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary starts");
    let mut station = Running(station);

    let ran = run(&["submit", "lab-samples", "--request", "r-1", "--connect", &address]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), "lab-samples-1\n"), "{}", ran.err);
    let ran = run(&["submit", "lab-samples", "--request", "r-1", "--connect", &address]);
    assert_eq!(ran.out, "lab-samples-1 (requested before)\n", "{}", ran.err);
    let ran = run(&["submit", "lab-samples", "--set", "rom=x", "--connect", &address]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("did you mean `room`?"), "{}", ran.err);
    let ran = run(&["fleet", "--connect", &address]);
    assert!(ran.out.starts_with("s1 is the coordinator for "), "{}{}", ran.out, ran.err);
    let ran = run(&["missions", "--connect", &address]);
    assert!(ran.out.contains("lab-samples-1  pending  0/16"), "{}{}", ran.out, ran.err);
    let ran = run(&["explain", "lab-samples-1", "--connect", &address]);
    assert!(ran.out.starts_with("lab-samples-1 is pending; "), "{}{}", ran.out, ran.err);
    let ran = run(&["explain", "lab-samples-9", "--connect", &address]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("no mission lab-samples-9 is known at s1"), "{}", ran.err);
    let ran = run(&["priority", "lab-samples-1", "-7", "--connect", &address]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), "lab-samples-1 has priority -7\n"), "{}", ran.err);
    let ran = run(&["missions", "--connect", &address]);
    assert!(ran.out.contains("priority -7"), "{}{}", ran.out, ran.err);
    let cases: [(&[&str], &str); 3] = [
        (&["r1"], "r1 of lab-samples-1 has no robot; name the robot that should get it"),
        (&["r1", "--to", "amber"], "there is no robot amber"),
        (&["nurse"], "nurse of lab-samples-1 is a role of people"),
    ];
    for (more, expected) in cases {
        let ran = run(&[&["reassign", "lab-samples-1"][..], more, &["--connect", &address]].concat());
        assert_eq!(ran.code, Some(1), "{more:?}: {}", ran.err);
        assert!(ran.err.contains(expected), "{more:?}: {}", ran.err);
    }
    let ran = run(&["cancel", "lab-samples-1", "--by", "Nia", "--connect", &address]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), "lab-samples-1 canceled: by Nia\n"), "{}", ran.err);
    let ran = run(&["fleet", "--fleet", "another", "--timeout", "0.5", "--connect", &address]);
    assert_eq!(ran.code, Some(3));
    assert!(ran.err.contains("no node of fleet another answers"), "{}", ran.err);

    // The port is in use: a second node on it reports that.
    let ran = run(&["station", "--name", "s2", "--listen", &address]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    assert!(ran.err.contains(&format!("listen on {address}")), "{}", ran.err);

    let kill = Command::new("kill").args(["-TERM", &station.0.id().to_string()]).status().expect("kill is there");
    assert!(kill.success());
    let end = Instant::now() + Duration::from_secs(60);
    let status = loop {
        if let Some(status) = station.0.try_wait().expect("a child of ours") {
            break status;
        }
        assert!(Instant::now() < end, "the station has not stopped 60 s after SIGTERM");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(0));
}

/// Returns the whole HTTP response of a page.
fn get(address: &str, page: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("the address is open");
    write!(stream, "GET {page} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").expect("it reads");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("the response is text");
    answer
}

#[test]
fn a_node_serves_metrics_and_logs_json() {
    let address = free_address();
    let mut station = command(&["station", "--name", "s1", "--listen", &address, "--metrics", "127.0.0.1:0"])
        .args(["--log-format", "json"])
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary starts");
    let log = BufReader::new(station.stderr.take().expect("piped"));
    let _station = Running(station);
    let lines = log.lines().map(|line| line.expect("text"));
    let objects =
        lines.map(|line| serde_json::from_str::<serde_json::Value>(&line).unwrap_or_else(|_| panic!("{line}")));
    let at = objects.filter_map(|object| {
        let message = object["message"].as_str()?;
        Some(message.strip_prefix("metrics at http://")?.strip_suffix("/metrics")?.to_owned())
    });
    // From here on the log has no reader, which does not affect the node.
    let at = { at }.next().expect("it logs the address");

    let ran = run(&["submit", "lab-samples", "--connect", &address]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let answer = get(&at, "/metrics");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert!(answer.contains("content-type: application/openmetrics-text; version=1.0.0; charset=utf-8"), "{answer}");
    for line in [
        r#"consort_is_leader{fleet="ward",node="s1"} 1"#,
        r#"consort_missions{fleet="ward",node="s1",state="pending"} 1"#,
        r#"consort_missions_submitted_total{fleet="ward",node="s1"} 1"#,
        r#"process_resident_memory_bytes{fleet="ward",node="s1"} "#,
    ] {
        assert!(answer.lines().any(|text| text.starts_with(line)), "{line} in {answer}");
    }
    assert!(answer.contains(r#"kind="people",direction="received"}"#), "the request was counted: {answer}");
    assert!(get(&at, "/other").starts_with("HTTP/1.1 404"));
}

#[test]
fn an_occupied_address_is_reported_before_anything_starts() {
    let taken = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let at = taken.local_addr().expect("its address").to_string();
    for line in [
        &["station", "--name", "s2", "--metrics", &at][..],
        &["station", "--name", "s2", "--dashboard", &at],
        &["demo", "--json", "--dashboard", &at],
    ] {
        let ran = run(line);
        assert_eq!(ran.code, Some(2), "{line:?}: {}", ran.err);
        let flag = line[line.len() - 2];
        let expected = format!("consort: {flag} {at}: this address is not available: ");
        assert!(ran.err.starts_with(&expected), "{line:?}: {}", ran.err);
        assert_eq!((ran.err.lines().count(), ran.out.as_str()), (1, ""), "nothing was opened before: {}", ran.err);
    }
}

#[cfg(not(feature = "otlp"))]
#[test]
fn a_build_without_opentelemetry_reports_how_to_enable_it() {
    let ran = run(&["station", "--name", "s1", "--otlp", "http://127.0.0.1:4318"]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    assert!(ran.err.contains("s1 was built without OpenTelemetry: build it with --features otlp"), "{}", ran.err);
}

/// Accepts a request at a collector and returns its header and body.
#[cfg(feature = "otlp")]
fn accept_request(listener: &TcpListener) -> (String, Vec<u8>) {
    let (stream, _) = listener.accept().expect("the node connects");
    let mut reader = BufReader::new(stream);
    let (mut head, mut length) = (String::new(), 0);
    loop {
        let mut line = String::new();
        assert_ne!(reader.read_line(&mut line).expect("a head"), 0, "it hung up: {head}");
        if let Some(text) = line.to_ascii_lowercase().strip_prefix("content-length:") {
            length = text.trim().parse().expect("a number");
        }
        if line.trim().is_empty() {
            break;
        }
        head += &line;
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).expect("a body of the stated length");
    let answer =
        "HTTP/1.1 200 OK\r\nContent-Type: application/x-protobuf\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
    reader.get_mut().write_all(answer.as_bytes()).expect("it listens");
    (head, body)
}

#[cfg(feature = "otlp")]
#[test]
fn the_spans_of_a_mission_reach_a_collector() {
    let collector = TcpListener::bind("127.0.0.1:0").expect("a port");
    let at = format!("http://{}", collector.local_addr().expect("it listens"));
    let address = free_address();
    let station = command(&["station", "--name", "s1", "--listen", &address, "--otlp", &at])
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary starts");
    let _station = Running(station);
    let ran = run(&["submit", "lab-samples", "--connect", &address]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let ran = run(&["cancel", "lab-samples-1", "--connect", &address]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);

    let has = |body: &[u8], text: &str| body.windows(text.len()).any(|part| part == text.as_bytes());
    let (head, body) = loop {
        let (head, body) = accept_request(&collector);
        if has(&body, "mission lab-samples-1") {
            break (head, body);
        }
        assert!(has(&body, "auction lab-samples-1"), "auctions may come first: {}", String::from_utf8_lossy(&body));
    };
    assert!(head.starts_with("POST /v1/traces HTTP/1.1"), "{head}");
    for text in ["service.name", "consort", "service.instance.id", "s1", "canceled"] {
        assert!(has(&body, text), "{text}: {}", String::from_utf8_lossy(&body));
    }
}
