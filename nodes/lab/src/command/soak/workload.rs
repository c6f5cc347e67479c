//! The clients of the fleet.

use super::fleet::ProcessFleet;
use super::mission_log::MissionLog;
use super::names::{ROOMS, STATIONS};
use super::occurrences::{self, Occurrences};
use super::supervisors::{Followed, Supervisors};
use consort_bus::{SharedBus, Stream};
use consort_nodes::exit::Failure;
use consort_protocol::ids::NodeId;
use consort_skills::workload::Workload as UserWorkload;
use consort_tests::history::{Acknowledged, History, Reader, RecordingClient};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::task::{JoinHandle, JoinSet};

/// Milliseconds between two missions.
const SUBMIT_INTERVAL_MS: std::ops::Range<u64> = 5_000..20_000;

/// Share of the missions that are canceled.
const CANCELED_SHARE: f64 = 0.2;

/// Share of the missions of the user.
const OWN_SHARE: f64 = 0.5;

/// Beginning of the names of requests for missions of the user.
pub(super) const OWN_REQUEST: &str = "soak-own-";

/// Interval at which a person resolves missions that need intervention.
const RESOLVE_INTERVAL: Duration = Duration::from_secs(5);

/// Clients at work.
pub(super) struct Workload {
    pub(super) acknowledged: Acknowledged,
    pub(super) client: RecordingClient,
    pub(super) missions: MissionLog,
    /// Nodes that were elected, by term.
    elected: JoinHandle<BTreeMap<u64, Vec<NodeId>>>,
    end_elected: tokio::sync::oneshot::Sender<()>,
    submitter: JoinHandle<JoinSet<()>>,
    end_submitter: tokio::sync::watch::Sender<bool>,
    readers: JoinSet<()>,
    supervisors: Supervisors,
    /// Time of the first occurrence of the schedule, in milliseconds since 1970.
    first_occurrence_ms: u64,
    /// The occurrences, once the schedule is paused.
    occurrences: Result<Occurrences, String>,
}

/// What the clients have seen besides the replies in their history.
pub(super) struct Observed {
    /// Nodes that were elected, by term.
    pub(super) elected: BTreeMap<u64, Vec<NodeId>>,
    /// How the robots followed orders, and charged.
    pub(super) followed: Followed,
    /// The occurrences of the schedule.
    pub(super) occurrences: Result<Occurrences, String>,
}

impl Workload {
    /// Starts the clients: one that submits and cancels, a reader of each kind at its own station, a person who
    /// resolves missions, people who give orders, and a schedule.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if a client cannot be opened, or the schedule is refused.
    pub(super) async fn start(
        fleet: &ProcessFleet,
        history: &History,
        own: UserWorkload,
        seed: u64,
    ) -> Result<Workload, Failure> {
        let client = |bus: SharedBus| RecordingClient { bus, keys: fleet.keys.clone(), history: history.clone() };
        let acknowledged = Acknowledged::default();
        let mut readers = JoinSet::new();
        for (reader, station) in Reader::ALL.into_iter().zip(STATIONS) {
            let bus = fleet.client(&[station]).await?;
            readers.spawn(client(bus).read(reader, acknowledged.clone(), seed));
        }
        let bus = fleet.client(&STATIONS).await?;
        let client = client(bus.clone());
        let resolver = client.clone();
        readers.spawn(async move {
            loop {
                resolver.resolve_all().await;
                tokio::time::sleep(RESOLVE_INTERVAL).await;
            }
        });
        let missions = MissionLog::default();
        readers.spawn(missions.clone().record(client.clone()));
        let events = bus.subscribe(&fleet.keys.any_events()).await;
        let events = events.map_err(|problem| Failure::Unsuccessful(problem.to_string()))?;
        let (end_elected, end) = tokio::sync::oneshot::channel();
        let elected = tokio::spawn(record_elected(events, end));
        let first_occurrence_ms = occurrences::add(&client, &own).await.map_err(Failure::Unsuccessful)?;
        let (end_submitter, end) = tokio::sync::watch::channel(false);
        let supervisors = Supervisors::start(fleet, client.clone(), seed, &end).await?;
        let submitter = tokio::spawn(submit(client.clone(), acknowledged.clone(), own, seed, end));
        Ok(Workload {
            acknowledged,
            client,
            missions,
            elected,
            end_elected,
            submitter,
            end_submitter,
            readers,
            supervisors,
            first_occurrence_ms,
            occurrences: Err("the schedule was not paused".to_owned()),
        })
    }

    /// Submits nothing more, ends all orders and the schedule, and waits until everything is acknowledged.
    pub(super) async fn end_submissions(&mut self) {
        self.end_submitter.send_replace(true);
        if let Ok(open) = (&mut self.submitter).await {
            open.join_all().await;
        }
        self.supervisors.finish().await;
        self.occurrences = occurrences::pause(&self.client, self.first_occurrence_ms).await;
    }

    /// Ends all clients, and returns what they have seen.
    pub(super) async fn end(mut self) -> Observed {
        self.readers.shutdown().await;
        let _ = self.end_elected.send(());
        let elected = self.elected.await.unwrap_or_default();
        Observed { elected, followed: self.supervisors.end().await, occurrences: self.occurrences }
    }
}

/// Submits missions, and cancels some of them, until the end. About half of them are `own` missions of the user, if
/// there are any. Returns the requests under way.
async fn submit(
    client: RecordingClient,
    acknowledged: Acknowledged,
    own: UserWorkload,
    seed: u64,
    mut end: tokio::sync::watch::Receiver<bool>,
) -> JoinSet<()> {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x50a7);
    let names: Vec<&str> = own.own_missions().collect();
    let mut requests = JoinSet::new();
    for number in 1_u64.. {
        let (room, canceled) = (ROOMS[chance.random_range(0..ROOMS.len())], chance.random_bool(CANCELED_SHARE));
        let cancel_after = canceled.then(|| Duration::from_millis(chance.random_range(0..10_000)));
        let is_own = !names.is_empty() && chance.random_bool(OWN_SHARE);
        let name = if is_own { names[chance.random_range(0..names.len())] } else { "lab-samples" };
        let request = format!("{}{number}", if is_own { OWN_REQUEST } else { "soak-" });
        let mut body = json!(own.request(name, own.parameters_in(name, room)));
        body["request"] = json!(request);
        let (client, acknowledged) = (client.clone(), acknowledged.clone());
        requests.spawn(async move {
            let mission = client.submit(&body).await;
            acknowledged.send_modify(|known| drop(known.insert(request, mission.to_string())));
            if let Some(after) = cancel_after {
                tokio::time::sleep(after).await;
                client.cancel(&mission).await;
            }
        });
        let interval = Duration::from_millis(chance.random_range(SUBMIT_INTERVAL_MS));
        if tokio::time::timeout(interval, end.wait_for(|end| *end)).await.is_ok() {
            break;
        }
    }
    requests
}

/// Records the nodes that were elected in each term, until the end.
async fn record_elected(
    mut events: Stream<consort_bus::Sample>,
    mut end: tokio::sync::oneshot::Receiver<()>,
) -> BTreeMap<u64, Vec<NodeId>> {
    let mut elected: BTreeMap<u64, Vec<NodeId>> = BTreeMap::new();
    loop {
        let sample = tokio::select! {
            sample = events.recv() => sample,
            _ = &mut end => None,
        };
        let Some(sample) = sample else { return elected };
        let event: Value = serde_json::from_slice(&sample.payload).unwrap_or_default();
        if let ("elected", Some(term), Some(node)) = (
            event["event"].as_str().unwrap_or_default(),
            event["term"].as_u64(),
            event["node"].as_str().and_then(|node| node.parse::<NodeId>().ok()),
        ) {
            let nodes = elected.entry(term).or_default();
            if !nodes.contains(&node) {
                nodes.push(node);
            }
        }
    }
}
