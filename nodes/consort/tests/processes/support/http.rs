//! Plain HTTP client.

use serde_json::Value;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::Duration;

/// Limit for a server to respond.
const LIMIT: Duration = Duration::from_secs(30);

/// Response of a server.
pub(crate) struct Answer {
    pub(crate) status: u16,
    /// The headers, each on its own line.
    pub(crate) heads: String,
    pub(crate) body: String,
}

impl Answer {
    #[track_caller]
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|problem| panic!("{problem}: {}", self.body))
    }
}

/// Sends a request such as `GET /api/fleet` to the server at `address`.
#[track_caller]
pub(crate) fn http(address: &str, request: &str, heads: &[(&str, &str)], body: &str) -> Answer {
    let mut stream = TcpStream::connect(address).expect("it listens");
    stream.set_read_timeout(Some(LIMIT)).expect("a limit can be set");
    let close = [("Host", address), ("Connection", "close")];
    let own = close.iter().filter(|(name, _)| heads.iter().all(|(given, _)| given != name)).chain(heads);
    let own: String = own.map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    write!(stream, "{request} HTTP/1.1\r\n{own}Content-Length: {}\r\n\r\n{body}", body.len()).expect("it reads");
    let mut text = String::new();
    stream.read_to_string(&mut text).expect("a text response");
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{request}: {text}"));
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).expect("a status");
    Answer { status, heads: head.replace("\r\n", "\n"), body: body.to_owned() }
}
