//! Fleet models, recordings and dashboard requests.

use super::frames::{frames, text};
use super::scratch;
use consort_bus::clock::Clock;
use consort_dashboard::address::BoundAddress;
use consort_dashboard::fleet_model::{FleetInput, FleetModel, FloorPlan, delta};
use consort_dashboard::loaded_map::LoadedMap;
use consort_dashboard::recording::RecordingReader;
use consort_dashboard::server::{Dashboard, FramePublisher};
use consort_fleet::robot_driver::DriverState;
use consort_protocol::codec;
use consort_protocol::ids::FleetId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::Beacon;
use serde_json::Value;
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::runtime::Runtime;

/// A recording shows the same state at an instant, however the reader reaches it.
pub(super) fn recording(bytes: &[u8]) -> bool {
    let file = scratch::file("a.mcap", bytes);
    let recording = match RecordingReader::open(&file) {
        Ok(recording) => recording,
        Err(problem) => {
            assert!(problem.to_string().contains("a.mcap"), "{problem}");
            return false;
        }
    };
    let (from, to) = (recording.from_ms(), recording.to_ms());
    let middle = from + to.saturating_sub(from) / 2;
    let mut model = recording.model_at(from);
    let mut taken = 0;
    for at in [from, middle, to, middle] {
        taken = recording.seek(&mut model, taken, at);
        assert_eq!(model.to_json(), recording.model_at(at).to_json(), "at {at} ms, of {from} to {to}");
    }
    true
}

/// For any sequence of inputs, the applied patches equal the whole model.
pub(super) fn fleet_model(bytes: &[u8]) -> bool {
    let keys = Keys::new(&FleetId::new("ward").expect("a slug"));
    let mut model = FleetModel::new("ward", "ada", FloorPlan::default(), 1000);
    let mut drawn = Value::Null;
    model.render_patch(&mut drawn);
    let (mut patched, mut now_ms, mut taken) = (drawn.clone(), 1000u64, 0);
    for (kind, piece) in frames(bytes).take(60) {
        let json = || serde_json::from_slice::<Value>(piece).ok();
        let input = match kind % 8 {
            0 => serde_json::from_slice(piece).ok().map(FleetInput::Event),
            1 => codec::decode::<Beacon>(piece).ok().map(FleetInput::Beacon),
            2 => codec::decode::<DriverState>(piece).ok().map(|state| FleetInput::Telemetry {
                robot: state.robot.to_string(),
                feedback: state.feedback(),
                telemetry: state.telemetry,
            }),
            3 => {
                now_ms = now_ms.saturating_add(1 << (kind / 8));
                None
            }
            4 => Some(FleetInput::Links(piece.len())),
            5 => serde_json::from_slice::<Beacon>(piece).ok().map(FleetInput::Beacon),
            _ => json().and_then(|view| Some(FleetInput::View { key: view_key(kind, &keys, &view)?, view })),
        };
        if let Some(FleetInput::View { key: Key::ViewMap, view }) = &input
            && let Ok(floor) = LoadedMap::from_view(view)
        {
            floor.to_view();
        }
        let Some(input) = input else { continue };
        model.apply(&input, now_ms);
        taken += 1;
        if let Some(patch) = model.render_patch(&mut drawn) {
            delta::apply(&mut patched, &patch);
        }
        assert_eq!(patched, drawn, "the changes make another picture");
    }
    assert_eq!(drawn, model.to_json(), "drawn bit by bit it is another picture");
    taken > 0
}

/// Returns the key of a view: the key that the view names, or a key of the queried views.
fn view_key(kind: u8, keys: &Keys, view: &Value) -> Option<Key> {
    if let Some(key) = view["key"].as_str() {
        return keys.read(key);
    }
    let all = [
        Key::ViewFleet,
        Key::ViewCoordinator,
        Key::ViewMissions,
        Key::ViewAuctions,
        Key::ViewWorld,
        Key::ViewHealth,
        Key::ViewMap,
        Key::ViewEnsembles,
        Key::ViewMission("m-1".parse().ok()?),
    ];
    let place = usize::from(kind / 8) % all.len();
    all.into_iter().nth(place)
}

struct Server {
    _runtime: Runtime,
    _dashboard: Dashboard,
    address: SocketAddr,
}

fn server() -> &'static Server {
    static SERVER: OnceLock<Server> = OnceLock::new();
    SERVER.get_or_init(|| {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.expect("a runtime");
        let dashboard = runtime.block_on(async {
            let model = FleetModel::new("ward", "ada", FloorPlan::default(), 1000);
            let taken =
                BoundAddress::bind("--dashboard", SocketAddr::from(([127, 0, 0, 1], 0))).await.expect("a free port");
            Dashboard::serve_view_only(taken, Arc::new(FramePublisher::new(model, Clock::real())))
        });
        let address = dashboard.address();
        Server { _runtime: runtime, _dashboard: dashboard, address }
    })
}

/// The first line is the request line (`GET /api/events?after=1`), the rest is the body. The server
/// answers every request and never with an internal error. Input without a space in the first line
/// is sent unchanged.
pub(super) fn dashboard(bytes: &[u8]) -> bool {
    let address = server().address;
    let (line, body) = match bytes.iter().position(|byte| *byte == b'\n') {
        Some(end) => (&bytes[..end], &bytes[end + 1..]),
        None => (bytes, &b""[..]),
    };
    let whole = text(line).filter(|line| line.contains(' ')).map(|line| {
        let head = format!(
            "{line} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\ncontent-type: application/json\r\n\
             content-length: {}\r\n\r\n",
            body.len()
        );
        [head.as_bytes(), body].concat()
    });
    let mut stream = TcpStream::connect(address).expect("the dashboard takes connections");
    stream.set_read_timeout(Some(Duration::from_secs(5))).expect("a socket");
    // The server may close the connection early.
    let _ = stream.write_all(whole.as_deref().unwrap_or(bytes));
    if whole.is_none() {
        let _ = stream.shutdown(Shutdown::Write);
    }
    let mut answer = [0; 12];
    let answered = stream.read_exact(&mut answer).is_ok();
    if answered {
        let status = String::from_utf8_lossy(&answer[9..]).into_owned();
        assert!(answer.starts_with(b"HTTP/1."), "this is no HTTP response: {answer:?}");
        assert!(status != "500", "a mistake of the server's own");
    }
    let taken = answered && answer[9] == b'2';
    // The server closes the connection on input that is not HTTP, and on bodies that it does not
    // read to the end.
    assert!(answered || !is_http(line) || body.len() > 4096, "it was not answered");
    taken
}

/// Checks whether a line begins a request: a method and a path.
fn is_http(line: &[u8]) -> bool {
    let Some((method, path)) = text(line).and_then(|line| line.split_once(' ')) else { return false };
    let is_method = (3..=7).contains(&method.len()) && method.bytes().all(|byte| byte.is_ascii_uppercase());
    is_method
        && path.starts_with('/')
        && path.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"/?&=._-%".contains(&byte))
}
