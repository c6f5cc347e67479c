//! A client of a fleet. It queries the coordinator, and reports on the standard error what it waits
//! for.

use crate::config::{DEFAULT_FLEET, FleetConfig, LogFormat, load_unchecked};
use crate::exit::Failure;
use crate::node_runtime::{build_runtime, describe_links, rust_log, start_log};
use crate::output::{self, Progress, note};
use crate::trust;
use crate::wiring::link_trust;
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::trust::SigningBus;
use consort_bus::zenoh_bus::Mode;
use consort_bus::{SharedBus, ZenohBus, ZenohSettings};
use consort_dashboard::query::{QueryError, QueryTarget, RETRY_DELAY, query_once};
use consort_protocol::access;
use consort_protocol::api::ReadOptions;
use consort_protocol::ids::{FleetId, NodeId, RequestId};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::trust::Principal;
use rand::TryRng;
use rand::rngs::SysRng;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// Limit of a single query. The coordinator itself gives up on the ledger after 2 s.
const ONE_QUERY: Duration = Duration::from_secs(3);

/// Flags for reaching a fleet.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Reaching the fleet")]
pub struct ClientFlags {
    /// The fleet: its name or its file. Default: ward
    #[arg(long, env = "CONSORT_FLEET", value_name = "NAME|FILE", default_value = DEFAULT_FLEET)]
    fleet: String,
    /// Address of any node or router of the fleet; may be repeated, the first reachable address is
    /// used
    #[arg(
        long,
        env = "CONSORT_CONNECT",
        value_delimiter = ',',
        value_name = "ADDRESS",
        default_value = "tcp/127.0.0.1:7447"
    )]
    connect: Vec<String>,
    /// Folder with your certificate and key, as written by `consort cert person`, for a closed
    /// fleet (tls/…)
    #[arg(long, env = "CONSORT_CERTS", value_name = "DIR")]
    certs: Option<PathBuf>,
    /// Time limit for reaching the fleet and its coordinator, in seconds
    #[arg(long, env = "CONSORT_TIMEOUT", value_name = "SECONDS", default_value_t = 10.0)]
    timeout: f64,
}

impl ClientFlags {
    /// Returns the addresses of nodes to connect to.
    pub(crate) fn addresses(&self) -> &[String] {
        &self.connect
    }

    /// Returns the folder with certificates, if any.
    pub(crate) fn certs(&self) -> Option<&PathBuf> {
        self.certs.as_ref()
    }

    /// Returns the fleet's name.
    ///
    /// # Errors
    /// [`Failure::Usage`] if it is not a name, or its file is not valid.
    pub fn fleet(&self) -> Result<FleetId, Failure> {
        fleet_name(&self.fleet)
    }

    /// Returns the same flags with other addresses, certificates and fleet.
    #[must_use]
    pub(crate) fn with_target(&self, connect: Vec<String>, certs: Option<PathBuf>, fleet: &FleetId) -> ClientFlags {
        ClientFlags { fleet: fleet.to_string(), connect, certs, timeout: self.timeout }
    }

    /// Connects, runs `work` with the connection, and closes it.
    ///
    /// # Errors
    /// See [`Client::open`], and the errors of `work`.
    pub(crate) fn with_client<T>(
        &self,
        work: impl AsyncFnOnce(&mut Client) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        build_runtime()?.block_on(async {
            let mut client = Client::open(self).await?;
            let done = work(&mut client).await;
            client.close().await;
            done
        })
    }
}

/// Flag of a read.
#[derive(Debug, clap::Args)]
pub(crate) struct ReadFlags {
    /// Show everything acknowledged before now, confirmed by a majority of the voters
    #[arg(long)]
    linearizable: bool,
}

impl ReadFlags {
    /// Returns the options of the read.
    pub(crate) fn options(&self) -> ReadOptions {
        ReadOptions { linearizable: self.linearizable }
    }
}

/// Flags of a query and of its output.
#[derive(Debug, clap::Args)]
pub(crate) struct QueryFlags {
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

impl QueryFlags {
    /// Runs a query and prints the answer as JSON or as text.
    ///
    /// # Errors
    /// See [`Client::open`] and [`read_answer`], and the errors of `query`;
    /// [`Failure::OutputClosed`].
    pub(crate) fn print<T: for<'de> Deserialize<'de>>(
        &self,
        query: impl AsyncFnOnce(&mut Client) -> Result<Value, Failure>,
        words: impl FnOnce(&T) -> String,
    ) -> Result<(), Failure> {
        let answer = self.client.with_client(query)?;
        if self.json { output::line(answer) } else { output::line(words(&read_answer(&answer)?)) }
    }

    /// Same as [`print`](Self::print), and returns the answer. An empty text is not printed.
    ///
    /// # Errors
    /// See [`print`](Self::print).
    pub(crate) fn print_and_read<T: for<'de> Deserialize<'de>>(
        &self,
        query: impl AsyncFnOnce(&mut Client) -> Result<Value, Failure>,
        words: impl FnOnce(&T) -> String,
    ) -> Result<T, Failure> {
        let answer = self.client.with_client(query)?;
        let read = read_answer(&answer)?;
        let text = if self.json { answer.to_string() } else { words(&read) };
        if !text.is_empty() {
            output::line(text)?;
        }
        Ok(read)
    }
}

/// Reads a view or a reply.
///
/// # Errors
/// [`Failure::Unsuccessful`] if this release cannot read it.
pub(crate) fn read_answer<T: for<'de> Deserialize<'de>>(answer: &Value) -> Result<T, Failure> {
    T::deserialize(answer)
        .map_err(|problem| Failure::Unsuccessful(format!("the answer cannot be read: {problem}: {answer}")))
}

/// Creates an id that contains the time: a fleet rejects it once it no longer knows the outcome.
pub(crate) fn new_request_id() -> RequestId {
    let half = || u128::from(SysRng.try_next_u64().expect("the system has random numbers"));
    RequestId::generate(Clock::real().wall_ms(), half() << 64 | half())
}

/// A connected client.
pub struct Client {
    session: ZenohBus,
    /// Principal of the client's certificate, if it has a certificate.
    person: Option<Principal>,
    /// Verifies signatures of the fleet's nodes, if there is a certificate.
    signing: Option<Arc<SigningBus>>,
    bus: SharedBus,
    keys: Keys,
    fleet: FleetId,
    to: String,
    timeout: Duration,
    waiting: Progress,
}

impl Client {
    /// Connects, retrying until the time limit.
    ///
    /// # Errors
    /// [`Failure::Unreachable`] if no node answers, [`Failure::Usage`] for wrong flags.
    pub async fn open(flags: &ClientFlags) -> Result<Client, Failure> {
        start_log(rust_log().as_deref().unwrap_or("off"), LogFormat::Human)?;
        let fleet = fleet_name(&flags.fleet)?;
        let timeout = Duration::try_from_secs_f64(flags.timeout)
            .map_err(|_| Failure::Usage(format!("--timeout: {} is not a number of seconds", flags.timeout)))?;
        let mut waiting = Progress::new();
        let until = Instant::now() + timeout;
        let clock = Clock::real();
        let credentials =
            flags.certs.as_deref().map(|certs| trust::person_keyring(certs, &fleet, clock)).transpose()?;
        let settings = ZenohSettings {
            mode: Mode::Client,
            connect: flags.connect.clone(),
            link_trust: flags.certs.as_deref().map(|certs| link_trust(certs, &fleet)),
            ..ZenohSettings::default()
        };
        let addresses = flags.connect.join(", ");
        let (session, links) = loop {
            let problem = match ZenohBus::open(settings.clone()).await {
                Ok(bus) => {
                    let links = bus.wait_connected(Duration::from_secs(1)).await;
                    if !links.is_empty() {
                        break (bus, links);
                    }
                    "no link was established".to_owned()
                }
                Err(problem) => problem.to_string(),
            };
            if Instant::now() + RETRY_DELAY >= until {
                drop(waiting);
                return Err(Failure::Unreachable(format!(
                    "not connected: no node answers at {addresses} ({problem})\n\
                     Start a node that listens there (consort station --name s1 --listen tcp/127.0.0.1:7447), or name \
                     a running node: --connect tcp/HOST:PORT. A closed fleet answers only clients with a \
                     certificate (--certs DIR, --connect tls/HOST:PORT); `consort doctor` finds the cause"
                )));
            }
            waiting.show(format_args!("no node answers at {addresses} yet; trying for {} s", timeout.as_secs_f64()));
            sleep(RETRY_DELAY).await;
        };
        waiting.clear();
        let keys = Keys::new(&fleet);
        let plain: SharedBus = Arc::new(session.clone());
        let person = credentials.as_ref().map(|(keyring, _)| keyring.identity().principal.clone());
        let signing = match credentials {
            None => None,
            Some((keyring, files)) => {
                let signing =
                    SigningBus::open(Arc::clone(&plain), keys.clone(), Arc::new(keyring), files.revoked, clock).await;
                Some(Arc::new(signing.map_err(|problem| Failure::Unsuccessful(problem.to_string()))?))
            }
        };
        let bus = signing.clone().map_or(plain, |signing| signing as SharedBus);
        Ok(Client { session, person, signing, bus, keys, fleet, to: describe_links(&links), timeout, waiting })
    }

    /// Sends a request: to the coordinator, or to the nearest node if it changes nothing.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if it is rejected; [`Failure::Unreachable`] if there is no
    /// coordinator.
    pub(crate) async fn api(&mut self, call: ApiCall, request: &impl Serialize) -> Result<Value, Failure> {
        self.check_scope(call)?;
        let target = if call.is_read_only() { QueryTarget::Nearest } else { QueryTarget::All };
        let payload = serde_json::to_string(request).expect("a request serializes to JSON");
        self.query(&Key::Api(call), payload, target).await
    }

    /// Checks whether the person's certificate allows a call. Nodes drop the request otherwise, and
    /// Zenoh gives no error.
    fn check_scope(&self, call: ApiCall) -> Result<(), Failure> {
        let Some(Principal::Person { name, scope, .. }) = &self.person else { return Ok(()) };
        let needed = access::required_scope(call);
        if *scope >= needed {
            return Ok(());
        }
        let word = call.as_str();
        Err(Failure::Usage(format!("the certificate of {name} has scope {scope}, and {word} needs scope {needed}")))
    }

    /// Queries a view of the nearest node.
    ///
    /// # Errors
    /// See [`api`](Self::api).
    pub(crate) async fn query_view(&mut self, key: &Key) -> Result<Value, Failure> {
        self.query(key, String::new(), QueryTarget::Nearest).await
    }

    /// Queries the views that match a key expression, once. Returns those that arrive: the nearest node
    /// replies with all that it has.
    pub(crate) async fn query_views(&self, key_expr: &str) -> Vec<Value> {
        let Ok(mut replies) = self.bus.query_nearest(key_expr, Bytes::new(), ONE_QUERY).await else { return vec![] };
        let mut views = vec![];
        while let Some(reply) = replies.recv().await {
            views.extend(reply.payload.ok().and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok()));
        }
        views
    }

    /// Sends a node a request that it executes at most once, and waits for its reply.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if it is rejected; [`Failure::Unreachable`] if the node does not
    /// reply.
    pub(crate) async fn query_node(&mut self, key: &Key, node: &NodeId, limit: Duration) -> Result<Value, Failure> {
        match query_once(&*self.bus, &self.keys.write(key), "", limit, QueryTarget::All).await {
            Ok(value) => Ok(value),
            Err(QueryError::Rejected(problem)) => Err(Failure::Unsuccessful(problem)),
            Err(QueryError::Retryable(problem, _)) => Err(Failure::Unreachable(format!("{node}: {problem}"))),
            Err(QueryError::NoReply) => Err(Failure::Unreachable(format!(
                "no node {node} answers in fleet {}; linked to {}. `consort fleet` lists the nodes",
                self.fleet, self.to
            ))),
        }
    }

    /// Checks whether the client has no certificate.
    pub(crate) fn is_anonymous(&self) -> bool {
        self.person.is_none()
    }

    /// Returns the fleet.
    pub fn fleet(&self) -> &FleetId {
        &self.fleet
    }

    /// Returns the fleet's keys.
    pub fn keys(&self) -> &Keys {
        &self.keys
    }

    /// Returns the connection, for subscriptions.
    pub fn bus(&self) -> SharedBus {
        Arc::clone(&self.bus)
    }

    /// Returns the progress output on the standard error.
    pub fn progress(&mut self) -> &mut Progress {
        &mut self.waiting
    }

    /// Closes the connection, and reports rejected messages on the standard error.
    pub(crate) async fn close(mut self) {
        let refused = self.refused();
        if !refused.is_empty() {
            self.waiting.clear();
            note(format_args!(
                "{}\nA node of the fleet, or a relay on the path, sends messages that it is not allowed to send. If the message \
                 names the node and there is no explanation: `consort cert revoke NAME`. Otherwise check that all nodes have this version",
                refused.iter().map(|reason| format!("rejected: {reason}")).collect::<Vec<_>>().join("\n")
            ));
        }
        // The answer has been printed. An error of the session's end does not matter.
        let _ = self.session.close().await;
    }

    /// Returns descriptions of the rejected messages.
    fn refused(&self) -> Vec<String> {
        self.signing.as_ref().map(|signing| signing.rejections()).unwrap_or_default()
    }

    async fn query(&mut self, key: &Key, payload: String, mut target: QueryTarget) -> Result<Value, Failure> {
        let until = Instant::now() + self.timeout;
        let key = self.keys.write(key);
        let mut waited = false;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let limit = ONE_QUERY.min(left.max(RETRY_DELAY));
            let obstacle = match query_once(&*self.bus, &key, &payload, limit, target).await {
                Ok(value) => {
                    if waited {
                        self.waiting.clear();
                    }
                    return Ok(value);
                }
                Err(QueryError::Rejected(problem)) => return Err(Failure::Unsuccessful(problem)),
                Err(QueryError::Retryable(problem, after)) => (problem, after.max(RETRY_DELAY)),
                Err(QueryError::NoReply) if self.bus.links().await.is_empty() => {
                    ("the link is down".to_owned(), RETRY_DELAY)
                }
                Err(QueryError::NoReply) => {
                    (format!("no {} of fleet {} answers yet", target.responder(), self.fleet), RETRY_DELAY)
                }
            };
            let (obstacle, after) = obstacle;
            if !self.refused().is_empty() {
                // The nearest node may be the forger of answers.
                target = QueryTarget::All;
            }
            if Instant::now() + after >= until {
                let obstacle = obstacle.trim_end_matches(" yet");
                return Err(Failure::Unreachable(format!(
                    "{obstacle}, and none did in {} s; linked to {}\n\
                     Is the fleet's name right (--fleet)? Are at least bootstrap_expect nodes with may_vote running \
                     and linked with each other? Is a majority of the voters alive?",
                    self.timeout.as_secs_f64(),
                    self.to
                )));
            }
            self.waiting.show(format_args!("{obstacle}: trying again in {:.1} s", after.as_secs_f64()));
            waited = true;
            sleep(after).await;
        }
    }
}

fn fleet_name(text: &str) -> Result<FleetId, Failure> {
    if text.ends_with(".toml") || text.contains('/') {
        return Ok(load_unchecked::<FleetConfig>(Path::new(text))?.name);
    }
    FleetId::new(text).map_err(|problem| Failure::Usage(format!("--fleet: {problem}")))
}
