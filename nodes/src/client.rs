//! A client of a fleet: asks whoever coordinates, and says what it waits for.

use crate::config::{DEFAULT_FLEET, FleetConfig, LogFormat, load};
use crate::exit::Failure;
use crate::node_runtime::{build_runtime, describe_links, rust_log, start_log};
use crate::output::{self, Progress, note};
use crate::query::{QueryError, QueryTarget, RETRY_DELAY, query_once};
use crate::trust;
use crate::wiring::link_trust;
use consort_actors::bus::zenoh_bus::Mode;
use consort_actors::bus::{SharedBus, ZenohBus, ZenohSettings};
use consort_actors::clock::Clock;
use consort_actors::trust::SigningBus;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::trust::{Principal, access};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// How long one question may take. The coordinator itself gives up on the ledger after 2 s.
const ONE_QUERY: Duration = Duration::from_secs(3);

/// How to reach a fleet.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Reaching the fleet")]
pub struct ClientFlags {
    /// The fleet: its name, or its file. Default: ward
    #[arg(long, env = "CONSORT_FLEET", value_name = "NAME|FILE", default_value = DEFAULT_FLEET)]
    fleet: String,
    /// Address of any node or router of the fleet; may be repeated, the first that can be reached is used
    #[arg(
        long,
        env = "CONSORT_CONNECT",
        value_delimiter = ',',
        value_name = "ADDRESS",
        default_value = "tcp/127.0.0.1:7447"
    )]
    connect: Vec<String>,
    /// Folder with your certificate and key, as `consort cert person` makes it, for a fleet that asks who you are (tls/…)
    #[arg(long, env = "CONSORT_CERTS", value_name = "DIR")]
    certs: Option<PathBuf>,
    /// How long to try to reach the fleet and its coordinator, in seconds
    #[arg(long, env = "CONSORT_TIMEOUT", value_name = "SECONDS", default_value_t = 10.0)]
    timeout: f64,
}

impl ClientFlags {
    /// Where nodes are looked for.
    pub fn addresses(&self) -> &[String] {
        &self.connect
    }

    /// The folder with certificates, if there is one.
    pub fn certs(&self) -> Option<&PathBuf> {
        self.certs.as_ref()
    }

    /// The fleet's name.
    ///
    /// # Errors
    /// [`Failure::Usage`] if it is none, or names a file that is not right.
    pub fn fleet(&self) -> Result<FleetId, Failure> {
        fleet_name(&self.fleet)
    }

    /// The same for other addresses, certificates and another fleet.
    #[must_use]
    pub fn with_target(&self, connect: Vec<String>, certs: Option<PathBuf>, fleet: &FleetId) -> ClientFlags {
        ClientFlags { fleet: fleet.to_string(), connect, certs, timeout: self.timeout }
    }

    /// Connects, has something done with the connection, and closes it.
    ///
    /// # Errors
    /// As [`Client::open`], and what `work` fails with.
    pub fn with_client<T>(&self, work: impl AsyncFnOnce(&mut Client) -> Result<T, Failure>) -> Result<T, Failure> {
        build_runtime()?.block_on(async {
            let mut client = Client::open(self).await?;
            let done = work(&mut client).await;
            client.close().await;
            done
        })
    }
}

/// How a fleet is asked something, and how its answer is shown.
#[derive(Debug, clap::Args)]
pub struct QueryFlags {
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

impl QueryFlags {
    /// Asks, and prints the answer: as it is, or in words.
    ///
    /// # Errors
    /// As [`Client::open`], and what `ask` fails with; [`Failure::OutputClosed`].
    pub fn print(
        &self,
        ask: impl AsyncFnOnce(&mut Client) -> Result<Value, Failure>,
        words: impl FnOnce(&Value) -> String,
    ) -> Result<(), Failure> {
        let answer = self.client.with_client(ask)?;
        if self.json { output::line(answer) } else { output::line(words(&answer)) }
    }
}

/// A client that is connected.
pub struct Client {
    session: ZenohBus,
    /// Whose certificate it has, if it has one.
    person: Option<Principal>,
    /// What tells the fleet's nodes from who says to be one, if there is a certificate to tell by.
    sealed: Option<Arc<SigningBus>>,
    bus: SharedBus,
    keys: Keys,
    fleet: FleetId,
    to: String,
    timeout: Duration,
    waiting: Progress,
}

impl Client {
    /// Connects, trying until the time is up.
    ///
    /// # Errors
    /// [`Failure::Unreached`] if nothing answers, [`Failure::Usage`] for wrong flags.
    pub async fn open(flags: &ClientFlags) -> Result<Client, Failure> {
        start_log(rust_log().as_deref().unwrap_or("off"), LogFormat::Human)?;
        let fleet = fleet_name(&flags.fleet)?;
        let timeout = Duration::try_from_secs_f64(flags.timeout)
            .map_err(|_| Failure::Usage(format!("--timeout: {} is not a number of seconds", flags.timeout)))?;
        let mut waiting = Progress::new();
        let until = Instant::now() + timeout;
        let clock = Clock::real();
        let proof = flags.certs.as_deref().map(|certs| trust::person_keyring(certs, &fleet, clock)).transpose()?;
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
                    "no link came about".to_owned()
                }
                Err(problem) => problem.to_string(),
            };
            if Instant::now() + RETRY_DELAY >= until {
                drop(waiting);
                return Err(Failure::Unreachable(format!(
                    "not connected: nothing answers at {addresses} ({problem})\n\
                     Start a node that listens there (consort station --name s1 --listen tcp/127.0.0.1:7447), or name \
                     one that runs: --connect tcp/HOST:PORT. A fleet whose nodes have certificates answers only those who \
                     have one (--certs DIR, --connect tls/HOST:PORT); `consort doctor` says what it is that does not fit"
                )));
            }
            waiting.show(format_args!("nothing answers at {addresses} yet; trying for {} s", timeout.as_secs_f64()));
            sleep(RETRY_DELAY).await;
        };
        waiting.clear();
        let keys = Keys::new(&fleet);
        let plain: SharedBus = Arc::new(session.clone());
        let person = proof.as_ref().map(|(keyring, _)| keyring.identity().principal.clone());
        let sealed = match proof {
            None => None,
            Some((keyring, files)) => {
                let sealed =
                    SigningBus::open(Arc::clone(&plain), keys.clone(), Arc::new(keyring), files.revoked, clock).await;
                Some(Arc::new(sealed.map_err(|problem| Failure::Unsuccessful(problem.to_string()))?))
            }
        };
        let bus = sealed.clone().map_or(plain, |sealed| sealed as SharedBus);
        Ok(Client { session, person, sealed, bus, keys, fleet, to: describe_links(&links), timeout, waiting })
    }

    /// Makes a request: of the coordinator, or of the nearest node if it changes nothing.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] with what it refused; [`Failure::Unreached`] if nobody coordinates.
    pub async fn api(&mut self, call: ApiCall, request: &Value) -> Result<Value, Failure> {
        self.may(call)?;
        let whom = if call.is_read_only() { QueryTarget::Nearest } else { QueryTarget::All };
        self.ask(&Key::Api(call), request.to_string(), whom).await
    }

    /// Whether the person's certificate allows a call. Nodes do not let it in otherwise, and Zenoh does not say so.
    fn may(&self, call: ApiCall) -> Result<(), Failure> {
        let Some(Principal::Person { name, scope }) = &self.person else { return Ok(()) };
        let needed = access::required_scope(call);
        if *scope >= needed {
            return Ok(());
        }
        let word = call.as_str();
        Err(Failure::Usage(format!("the certificate of {name} is for scope {scope}, and {word} needs scope {needed}")))
    }

    /// Looks at what the nearest node shows.
    ///
    /// # Errors
    /// As [`api`](Self::api).
    pub async fn query_view(&mut self, key: &Key) -> Result<Value, Failure> {
        self.ask(key, String::new(), QueryTarget::Nearest).await
    }

    /// Asks one node for something that it does at most once, and waits for its answer.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] with what it refused; [`Failure::Unreached`] if the node does not answer.
    pub async fn query_node(&mut self, key: &Key, node: &NodeId, limit: Duration) -> Result<Value, Failure> {
        match query_once(&*self.bus, &self.keys.write(key), "", limit, QueryTarget::All).await {
            Ok(value) => Ok(value),
            Err(QueryError::Rejected(problem)) => Err(Failure::Unsuccessful(problem)),
            Err(QueryError::Retryable(problem, _)) => Err(Failure::Unreachable(format!("{node}: {problem}"))),
            Err(QueryError::NoReply) => Err(Failure::Unreachable(format!(
                "no node {node} answers in fleet {}; linked to {}. `consort fleet` names those that are there",
                self.fleet, self.to
            ))),
        }
    }

    /// The fleet that is asked.
    pub fn fleet(&self) -> &FleetId {
        &self.fleet
    }

    /// Its keys.
    pub fn keys(&self) -> &Keys {
        &self.keys
    }

    /// The connection, for whoever wants to listen.
    pub fn bus(&self) -> SharedBus {
        Arc::clone(&self.bus)
    }

    /// Says on the standard error what is waited for.
    pub fn progress(&mut self) -> &mut Progress {
        &mut self.waiting
    }

    /// Closes the connection, and says on the standard error what was heard and not believed.
    pub async fn close(mut self) {
        let refused = self.refused();
        if !refused.is_empty() {
            self.waiting.clear();
            note(format_args!(
                "{}\nOne of the fleet's nodes, or one on the way to it, says what it may not. If it is named, and nobody can explain \
                 it: `consort cert revoke NAME`. If it is not: is every node of this version?",
                refused.iter().map(|reason| format!("not believed: {reason}")).collect::<Vec<_>>().join("\n")
            ));
        }
        // The answer is out; how the session ends is of no interest any more.
        let _ = self.session.close().await;
    }

    /// What was not believed, in words.
    fn refused(&self) -> Vec<String> {
        self.sealed.as_ref().map(|sealed| sealed.rejections()).unwrap_or_default()
    }

    async fn ask(&mut self, key: &Key, payload: String, mut whom: QueryTarget) -> Result<Value, Failure> {
        let until = Instant::now() + self.timeout;
        let key = self.keys.write(key);
        let mut waited = false;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let limit = ONE_QUERY.min(left.max(RETRY_DELAY));
            let hindrance = match query_once(&*self.bus, &key, &payload, limit, whom).await {
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
                    (format!("no {} of fleet {} answers yet", whom.responder(), self.fleet), RETRY_DELAY)
                }
            };
            let (hindrance, after) = hindrance;
            if !self.refused().is_empty() {
                // Whoever forges answers may be the nearest.
                whom = QueryTarget::All;
            }
            if Instant::now() + after >= until {
                let hindrance = hindrance.trim_end_matches(" yet");
                return Err(Failure::Unreachable(format!(
                    "{hindrance}, and none did in {} s; linked to {}\n\
                     Is the fleet's name right (--fleet)? Are as many nodes up that may vote as its bootstrap_expect \
                     says, and linked with one another? Is a majority of the ledger's keepers alive?",
                    self.timeout.as_secs_f64(),
                    self.to
                )));
            }
            self.waiting.show(format_args!("{hindrance}: trying again in {:.1} s", after.as_secs_f64()));
            waited = true;
            sleep(after).await;
        }
    }
}

fn fleet_name(text: &str) -> Result<FleetId, Failure> {
    if text.ends_with(".toml") || text.contains('/') {
        return Ok(load::<FleetConfig>(Path::new(text))?.name);
    }
    FleetId::new(text).map_err(|problem| Failure::Usage(format!("--fleet: {problem}")))
}
