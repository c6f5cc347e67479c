//! A plain Zenoh client with default settings and the address of a node.

use super::{LONG, until};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;
use zenoh::bytes::Encoding;
use zenoh::handlers::FifoChannelHandler;
use zenoh::pubsub::Subscriber;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::Sample;
use zenoh::{Config, Session, Wait};

/// A session in client mode with the received events.
pub(crate) struct Client {
    session: Session,
    events: Subscriber<FifoChannelHandler<Sample>>,
    received: Vec<Value>,
    fleet: &'static str,
}

/// Returns the settings of a Zenoh client of a node, with or without a certificate.
pub(crate) fn config(address: &str, certs: Option<&Path>) -> Config {
    let mut config = Config::default();
    let mut set = |path: &str, value: Value| {
        config.insert_json5(path, &value.to_string()).expect("a setting of Zenoh's");
    };
    set("mode", json!("client"));
    set("connect/endpoints", json!([address]));
    if let Some(certs) = certs {
        set("transport/link/tls/verify_name_on_connect", json!(false));
        set("transport/link/tls/root_ca_certificate", json!(certs.join("ca.pem")));
        set("transport/link/tls/connect_certificate", json!(certs.join("cert.pem")));
        set("transport/link/tls/connect_private_key", json!(certs.join("key.pem")));
        set("transport/link/tls/enable_mtls", json!(true));
    }
    config
}

impl Client {
    /// Connects to a node and subscribes to the events of a fleet.
    pub(crate) fn open(address: &str, fleet: &'static str) -> Client {
        Client::open_with(address, fleet, None)
    }

    /// Same, with a certificate for a closed fleet.
    pub(crate) fn open_with(address: &str, fleet: &'static str, certs: Option<&Path>) -> Client {
        let config = config(address, certs);
        let session = until(&format!("a connection to {address}"), LONG, || zenoh::open(config.clone()).wait().ok());
        // Zenoh's default queue holds 256 samples and blocks the sender when it is full.
        let events = session.declare_subscriber(format!("consort/{fleet}/events/**"));
        let events = events.with(zenoh::handlers::FifoChannel::new(8192)).wait().expect("events can be followed");
        Client { session, events, received: vec![], fleet }
    }

    /// Returns the replies on `consort/{fleet}/{key}` by their keys without `consort/{fleet}/`.
    /// Views use the default query target of Zenoh; requests return the replies of all nodes.
    pub(crate) fn all(&self, key: &str, payload: &str) -> Vec<(String, Value)> {
        let prefix = format!("consort/{}/", self.fleet);
        let query = self.session.get(format!("{prefix}{key}")).payload(payload).timeout(Duration::from_secs(5));
        let query = match key.starts_with("view/") {
            true => query,
            false => query.target(QueryTarget::All).consolidation(ConsolidationMode::None),
        };
        self.collect_json(key, query.wait().expect("a query can be sent"))
    }

    /// Queries all nodes with otherwise default settings.
    pub(crate) fn query_all_nodes(&self, key: &str) -> Vec<(String, Value)> {
        let query = self.session.get(format!("consort/{}/{key}", self.fleet)).target(QueryTarget::All);
        self.collect_json(key, query.wait().expect("a query can be sent"))
    }

    fn collect_json(&self, key: &str, replies: FifoChannelHandler<Reply>) -> Vec<(String, Value)> {
        let prefix = format!("consort/{}/", self.fleet);
        let mut all = vec![];
        while let Ok(reply) = replies.recv() {
            // A query to a node that is being killed may time out; this is no reply.
            let Ok(sample) = reply.into_result() else { continue };
            assert_eq!(
                *sample.encoding(),
                Encoding::APPLICATION_JSON,
                "encoding of the reply on {}",
                sample.key_expr()
            );
            let text = sample.payload().try_to_string().expect("a reply is text");
            let value = serde_json::from_str(&text).unwrap_or_else(|problem| panic!("{key}: {problem}: {text}"));
            let key = sample.key_expr().as_str().strip_prefix(&prefix).expect("a key of the fleet").to_owned();
            all.push((key, value));
        }
        all
    }

    /// Waits for the reply to a query: a single reply, on the same key. Replies that ask for a
    /// retry are ignored.
    pub(crate) fn request(&self, key: &str, payload: &str) -> Value {
        let replies = until(&format!("a reply on {key}"), LONG, || {
            let mut all = self.all(key, payload);
            all.retain(|(_, value)| value.get("retry_after_ms").is_none());
            (!all.is_empty()).then_some(all)
        });
        let [(from, value)] = &replies[..] else { panic!("{key} has more than one reply: {replies:#?}") };
        assert_eq!(from, key);
        value.clone()
    }

    /// Returns a view.
    pub(crate) fn view(&self, key: &str) -> Value {
        self.request(&format!("view/{key}"), "")
    }

    /// Returns a view with default query settings.
    pub(crate) fn view_by_default(&self, key: &str) -> Value {
        let replies = self.session.get(format!("consort/{}/view/{key}", self.fleet)).wait().expect("a question");
        let replies: Vec<_> = std::iter::from_fn(|| replies.recv().ok()).collect();
        let [reply] = &replies[..] else { panic!("{} replies on view/{key}", replies.len()) };
        let sample = reply.result().unwrap_or_else(|problem| panic!("view/{key}: {problem:?}"));
        serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON")
    }

    /// Returns the presence tokens below `alive/`.
    pub(crate) fn present(&self) -> BTreeSet<String> {
        let prefix = format!("consort/{}/alive/", self.fleet);
        let tokens = self.session.liveliness().get(format!("{prefix}**")).timeout(Duration::from_secs(5)).wait();
        let tokens = tokens.expect("presence can be queried");
        let tokens = std::iter::from_fn(|| tokens.recv().ok()).filter_map(|token| token.into_result().ok());
        tokens.filter_map(|token| Some(token.key_expr().as_str().strip_prefix(&prefix)?.to_owned())).collect()
    }

    /// Returns all events received so far, in order.
    pub(crate) fn events(&mut self) -> &[Value] {
        while let Ok(Some(sample)) = self.events.try_recv() {
            assert_eq!(*sample.encoding(), Encoding::APPLICATION_JSON, "of an event");
            self.received.push(serde_json::from_slice(&sample.payload().to_bytes()).expect("an event is JSON"));
        }
        &self.received
    }

    /// Waits for the first matching event.
    pub(crate) fn wait_for_event(&mut self, what: &str, limit: Duration, is_match: impl Fn(&Value) -> bool) -> Value {
        until(what, limit, || self.events().iter().find(|event| is_match(event)).cloned())
    }

    /// Counts, by `ROLE/TASK`, how often each task of a mission began and ended.
    pub(crate) fn tasks(&mut self, mission: &str) -> BTreeMap<String, (u32, u32)> {
        tasks(self.events(), mission)
    }
}

/// Prints the last events and the views of the fleet if the test fails.
impl Drop for Client {
    #[expect(clippy::print_stderr, reason = "a failed test prints the logs")]
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.events();
            let last = self.received.iter().rev().take(40).rev().map(Value::to_string);
            eprintln!("--- the last events received\n{}", last.collect::<Vec<_>>().join("\n"));
            for (key, view) in self.all("view/**", "") {
                eprintln!("--- {key}\n{view}");
            }
        }
    }
}

/// Counts, by `ROLE/TASK`, how often each task of a mission began and ended.
pub(crate) fn tasks(events: &[Value], mission: &str) -> BTreeMap<String, (u32, u32)> {
    let mut tasks: BTreeMap<String, (u32, u32)> = BTreeMap::new();
    for event in events.iter().filter(|event| event["mission"] == mission) {
        let text = |key: &str| event[key].as_str().unwrap_or("?");
        let counts = |tasks: &mut BTreeMap<String, (u32, u32)>, begun, ended| {
            let entry = tasks.entry(format!("{}/{}", text("role"), text("task"))).or_default();
            *entry = (entry.0 + begun, entry.1 + ended);
        };
        match text("event") {
            "task_began" => counts(&mut tasks, 1, 0),
            "task_ended" => counts(&mut tasks, 0, 1),
            "task_failed" => panic!("a task failed: {event}"),
            _ => {}
        }
    }
    tasks
}
