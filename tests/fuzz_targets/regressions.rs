//! Named regression tests of former findings. Small inputs are also in `tests/fuzz/corpus/`.

use super::{SOON, STACK};
use consort_dashboard::address::BoundAddress;
use consort_dashboard::fleet_model::{FleetModel, FloorPlan};
use consort_dashboard::recording::RecordingReader;
use consort_dashboard::server::{Dashboard, FramePublisher};
use consort_nodes::config::{FleetConfig, WorldConfig, from_text};
use consort_nodes::diagnostic::Diagnostics;
use consort_skills::bt::xml::read_xml;
use consort_skills::extensions::Extensions;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

/// Reads an input on the stack of a worker and checks the time limit.
#[track_caller]
fn soon<T: Send>(read: impl FnOnce() -> T + Send) -> T {
    let began = Instant::now();
    let done = thread::scope(|scope| {
        let reading = thread::Builder::new().stack_size(STACK).spawn_scoped(scope, read);
        reading.expect("a thread").join().expect("no panic")
    });
    assert!(began.elapsed() < SOON, "it took {:?}", began.elapsed());
    done
}

fn attributes(count: usize) -> String {
    (0..count).map(|nth| format!(" a{nth:x}=\"\"")).collect()
}

#[test]
fn a_drawing_with_too_many_attributes_is_rejected() {
    let text = format!("<mxGraphModel>\n<root{}/></mxGraphModel>", attributes(400_000));
    let why = soon(|| consort_map_import::read(&text, "a.drawio")).unwrap_err().to_string();
    assert!(why.contains("the element in line 2 has more than the 256 attributes allowed"), "{why}");
}

#[test]
fn a_tree_with_too_many_attributes_is_rejected() {
    let text = format!("<root BTCPP_format=\"4\">\n<BehaviorTree ID=\"a\"{}/></root>", attributes(100_000));
    let why = soon(|| read_xml("a.xml", &text)).unwrap_err().to_string();
    assert!(why.starts_with("a.xml:2: "), "{why}");
}

#[test]
fn a_drawing_with_too_many_namespaces_is_rejected() {
    let open: String = (0..5000).map(|nth| format!("<a xmlns:n{nth}=\"u{nth}\">")).collect();
    let text = format!("<mxGraphModel>{open}{}</mxGraphModel>", "</a>".repeat(5000));
    let why = soon(|| consort_map_import::read(&text, "a.drawio")).unwrap_err().to_string();
    assert!(why.contains("more than the 64 allowed namespaces are declared"), "{why}");
}

#[test]
fn a_drawing_that_inflates_to_many_nodes_is_rejected() {
    let text = include_str!("../fuzz/corpus/drawing/nodes_that_are_many_when_inflated");
    let why = soon(|| consort_map_import::read(text, "a.drawio")).unwrap_err().to_string();
    assert!(why.contains("nodes limit reached"), "{why}");
}

#[test]
fn a_file_with_many_unknown_keys_reports_fifty() {
    let text: String = (0..20_000).map(|nth| format!("a{nth} = 1\n")).collect();
    let Diagnostics(problems) =
        soon(|| from_text::<FleetConfig>(&text, "a.toml", &Extensions::default().domain())).unwrap_err();
    assert_eq!(problems.len(), 50);
    assert!(problems[0].to_string().starts_with("a.toml:1:1: unknown key `a0` in a fleet file; allowed: name, "));
}

#[test]
fn a_deeply_nested_file_is_rejected() {
    let deep = "a.".repeat(50_000);
    for text in [format!("[{deep}a]\n"), format!("{deep}a = 1\n"), format!("a = {}", "{ b = ".repeat(50_000))] {
        assert!(soon(|| from_text::<WorldConfig>(&text, "a.toml", &Extensions::default().domain()).is_err()));
    }
}

/// The dashboard allocates memory for the stated length of a frame, so it must limit that length.
#[test]
fn a_large_web_socket_frame_is_rejected() {
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().expect("a runtime");
    let dashboard = runtime.block_on(async {
        let address =
            BoundAddress::bind("--dashboard", SocketAddr::from(([127, 0, 0, 1], 0))).await.expect("a free port");
        let picture = FleetModel::new("ward", "ada", FloorPlan::default(), 1000);
        Dashboard::serve_view_only(address, Arc::new(FramePublisher::new(picture, consort_bus::clock::Clock::real())))
    });
    let address = dashboard.address();
    let mut stream = TcpStream::connect(address).expect("the dashboard takes connections");
    stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a socket");
    let hello = format!(
        "GET /ws HTTP/1.1\r\nhost: {address}\r\nconnection: upgrade\r\nupgrade: websocket\r\nsec-websocket-version: 13\r\n\
         sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    stream.write_all(hello.as_bytes()).expect("a connection");
    let mut head = [0; 12];
    stream.read_exact(&mut head).expect("a reply");
    assert_eq!(&head, b"HTTP/1.1 101");
    // A masked binary frame with a stated length of a megabyte and no content.
    let mut frame = vec![0x82, 0x80 | 127];
    frame.extend((1_u64 << 20).to_be_bytes());
    frame.extend([0; 4]);
    stream.write_all(&frame).expect("a connection");
    // The server closes the connection; until then it sends the state of the fleet.
    let began = Instant::now();
    let mut buffer = [0; 4096];
    while stream.read(&mut buffer).expect("it hangs up before long") > 0 {
        assert!(began.elapsed() < SOON, "it still waits for the rest of the frame");
    }
}

#[test]
fn a_record_longer_than_its_chunk_is_reported() {
    let recording = include_bytes!("../fuzz/corpus/recording/chunk_whose_last_record_is_longer_than_it");
    let file = std::env::temp_dir().join(format!("consort-fuzz-long-{}.mcap", std::process::id()));
    std::fs::write(&file, recording).expect("a file");
    let opened = soon(|| RecordingReader::open(&file));
    std::fs::remove_file(&file).expect("the same file");
    let problem = match opened {
        Ok(recording) => recording.damage().unwrap_or_default(),
        Err(problem) => problem.to_string(),
    };
    assert!(problem.contains("it has no end"), "{problem:?}");
}
