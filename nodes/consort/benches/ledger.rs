//! Throughput and latency of the ledger: requests committed by three voters on loopback over Zenoh,
//! each with its ledger on disk.
//!
//! ```text
//! cargo bench -p consort --bench ledger [-- REQUESTS [CLIENTS [MISSIONS]]]
//! ```
//!
//! Each voter has a runtime, a bus and a store of its own; they share the machine and its disk.
//! Each client sends the leader a request at a time over Zenoh: to submit a mission (of some
//! kilobytes), and then to cancel it. A request counts when its reply has arrived, which is after
//! its commit: its entry was synced by the leader and by another voter.
//!
//! The disk is measured in the same run and folder, right before and right after. Three concurrent
//! writers, like the voters, each write as many bytes as the average entry to a file of their own,
//! in place, and sync it, as often as possible. With group commit each sync writes an entry with
//! all its requests. So the disk allows its syncs per second times the requests per entry. A ratio
//! near 1 shows that the disk is the limit; a small ratio shows that it is not.
//!
//! Latencies across snapshots (`across_snapshots`) are those of a single client of other voters, whose
//! ledger contains MISSIONS active missions meanwhile, at most 1398. A voter takes a snapshot every
//! `SNAPSHOT_EVERY` entries, so `p999` is the latency of commits during snapshots.

#[path = "support/figures.rs"]
mod support;

use bytes::Bytes;
use consort_bus::zenoh_bus::Mode;
use consort_bus::{Encoding, SharedBus, ZenohBus, ZenohSettings};
use consort_protocol::codec;
use consort_protocol::ids::{FleetId, MissionId, NodeId, RequestId};
use consort_protocol::ledger::{Command, CommandOutcome, Ledger, Submission};
use consort_protocol::plan::divide_and_check;
use consort_raft::store::{DurableStore, LEDGER_FILE, StoreOwner};
use consort_raft::{LeadershipView, RaftId, RaftSettings, Replica, StoreIdentity};
use consort_skills::domain::hospital;
use consort_skills::missions::shipped;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use support::{BenchError, figures, ms};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep};

const VOTERS: usize = 3;

/// Time limit of a reply.
const LIMIT: Duration = Duration::from_secs(5);

/// Duration of each disk measurement.
const MEASURED: Duration = Duration::from_secs(2);

/// Bytes of the files of the disk measurement: about the size of the ledger files.
const MEASURED_FILE: usize = 16 << 20;

/// Bytes of an entry before the first measurement: the most that requests share.
const ENTRY_BYTES: usize = 16 << 10;

/// Number of parts of the requests, in the order of their replies, to show whether they become
/// slower.
const PARTS: usize = 5;

/// Number of entries between two snapshots while latencies are measured across them.
const SNAPSHOT_EVERY: u64 = 500;

/// Number of commits that are measured across snapshots: several of them in the slowest thousandth.
const COMMITS: usize = 5000;

/// Number of clients that submit the missions of the measurement across snapshots.
const FILLING_CLIENTS: usize = 16;

fn main() -> ExitCode {
    let mut numbers = std::env::args().filter_map(|argument| argument.parse().ok());
    let requests = numbers.next().unwrap_or(10_000);
    let clients = numbers.next().unwrap_or(64);
    let missions = numbers.next().unwrap_or(1000);
    support::main("ledger", measure(requests, clients, missions))
}

async fn measure(requests: usize, clients: usize, missions: usize) -> Result<Value, BenchError> {
    let mut figures = measure_throughput(requests, clients).await?;
    figures["across_snapshots"] = measure_across_snapshots(missions).await?;
    Ok(figures)
}

/// A folder that is removed when dropped.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A voter with its runtime.
struct Voter {
    replica: Replica<Ledger>,
    endpoint: String,
    runtime: Option<Runtime>,
}

impl Drop for Voter {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// Voters, and a client of the voter that leads.
struct Cluster {
    voters: BTreeMap<NodeId, Voter>,
    leader: NodeId,
    client: Client,
    /// Folder of the stores. It is dropped last.
    folder: Folder,
}

impl Cluster {
    /// Starts the voters, and waits until one of them leads. The folder has this name.
    async fn start(name: &str, snapshot_every: u64) -> Result<Cluster, BenchError> {
        let folder = Folder(std::env::temp_dir().join(format!("consort-ledger-{name}-{}", std::process::id())));
        let mut voters: BTreeMap<NodeId, Voter> = BTreeMap::new();
        for number in 1..=VOTERS {
            let name = NodeId::new(format!("voter-{number}")).expect("a slug");
            let connect = voters.values().map(|voter| voter.endpoint.clone()).collect();
            let voter = start(name.clone(), folder.0.join(name.as_str()), connect, snapshot_every).await?;
            voters.insert(name, voter);
        }
        let members: BTreeMap<RaftId, NodeId> =
            voters.iter().map(|(name, voter)| (voter.replica.id(), name.clone())).collect();
        let first = voters.values().next().ok_or("no voters")?;
        first.replica.bootstrap(members).await.map_err(|error| error.to_string())?;
        let began = Instant::now();
        let leader = loop {
            let leads = |voter: &Voter| voter.replica.leadership().borrow().is_leader;
            match voters.iter().find(|(_, voter)| leads(voter)) {
                Some((name, _)) => break name.clone(),
                None if began.elapsed() > LIMIT => return Err("no voter leads".to_owned()),
                None => sleep(Duration::from_millis(10)).await,
            }
        };
        let settings = ZenohSettings {
            mode: Mode::Client,
            connect: vec![voters[&leader].endpoint.clone()],
            ..ZenohSettings::default()
        };
        let bus = ZenohBus::open(settings).await.map_err(|error| error.to_string())?;
        let leaders = voters.iter().map(|(name, voter)| (name.clone(), voter.replica.leadership())).collect();
        Ok(Cluster { voters, leader, client: Client { bus: Arc::new(bus), leaders }, folder })
    }

    /// Returns the number of entries so far.
    fn entries(&self) -> u64 {
        self.voters[&self.leader].replica.applied().borrow().index
    }
}

/// Measures the throughput with many clients.
async fn measure_throughput(requests: usize, clients: usize) -> Result<Value, BenchError> {
    let cluster = Cluster::start("throughput", consort_raft::SNAPSHOT_EVERY).await?;
    let before = syncs_per_s(&cluster.folder.0, ENTRY_BYTES)?;
    let load = Load { name: "client", requests, clients, cancels: true };
    let Replies { took, latencies, at, again, bytes } = run_clients(&cluster.client, load).await?;
    let rate = requests as f64 / took.as_secs_f64();

    let entries = cluster.entries();
    let Cluster { voters, leader, client, folder } = cluster;
    let ledger =
        fs::metadata(folder.0.join(leader.as_str()).join(LEDGER_FILE)).map_err(|error| error.to_string())?.len();
    drop((client, voters));
    let shared = requests as f64 / entries as f64;
    let entry_bytes = bytes / usize::try_from(entries).unwrap_or(usize::MAX).max(1);
    let after = syncs_per_s(&folder.0, entry_bytes)?;
    let bound = (before + after) / 2.0 * shared;
    Ok(json!({
        "voters": VOTERS, "clients": clients, "requests": requests, "repeated_requests": again,
        "requests_per_s": rate.round(), "requests_per_s_by_parts": rates(at), "latency": figures(latencies),
        "entries": entries, "requests_per_entry": hundredths(shared), "bytes_per_entry": entry_bytes,
        "ledger_bytes": ledger, "syncs_per_s_of_each_of_three": [before.round(), after.round()],
        "disk_allows_per_s": bound.round(), "ratio": hundredths(rate / bound),
    }))
}

/// Measures the latency of commits while missions are active and voters take snapshots.
async fn measure_across_snapshots(missions: usize) -> Result<Value, BenchError> {
    let cluster = Cluster::start("snapshots", SNAPSHOT_EVERY).await?;
    let filling = Load { name: "active", requests: missions, clients: FILLING_CLIENTS, cancels: false };
    run_clients(&cluster.client, filling).await?;
    let before = cluster.entries();
    let load = Load { name: "client", requests: COMMITS, clients: 1, cancels: true };
    let Replies { latencies, again, .. } = run_clients(&cluster.client, load).await?;
    let entries = cluster.entries() - before;
    Ok(json!({
        "missions": missions, "commits": COMMITS, "repeated_requests": again, "latency": figures(latencies),
        "entries": entries, "snapshots_min": entries / SNAPSHOT_EVERY,
    }))
}

fn hundredths(number: f64) -> f64 {
    (number * 100.0).round() / 100.0
}

/// Returns the requests answered per second, part by part, given the time of each reply.
fn rates(mut at: Vec<Duration>) -> Vec<f64> {
    at.sort();
    let mut began = Duration::ZERO;
    let part = at.len().div_ceil(PARTS).max(1);
    let parts = at.chunks(part).map(|part| {
        let ended = part.last().copied().unwrap_or(began);
        let rate = part.len() as f64 / (ended - began).as_secs_f64();
        began = ended;
        rate.round()
    });
    parts.collect()
}

async fn start(name: NodeId, folder: PathBuf, connect: Vec<String>, snapshot_every: u64) -> Result<Voter, BenchError> {
    let runtime = Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(|error| error.to_string())?;
    let started = runtime.spawn(async move {
        let bus = ZenohBus::open(ZenohSettings { connect, ..ZenohSettings::default() }).await;
        let bus = bus.map_err(|error| error.to_string())?;
        let endpoint = bus.listen_addresses().await.into_iter().next().ok_or("the bus has no listen address")?;
        let fleet = FleetId::new("bench").expect("a slug");
        let owner = StoreOwner { fleet: fleet.clone(), node: name.clone() };
        let fresh = StoreIdentity(u128::from(name.as_str().bytes().last().unwrap_or(0)));
        let store = DurableStore::open(&folder, &owner, fresh).map_err(|error| error.to_string())?;
        let shared: SharedBus = Arc::new(bus);
        let seed = u64::from(endpoint.bytes().last().unwrap_or(0));
        let settings = RaftSettings { snapshot_every, ..RaftSettings::new(fleet, name.clone()) };
        let replica = Replica::<Ledger>::start(settings, shared.clone(), Arc::new(store), seed).await;
        let replica = replica.map_err(|error| error.to_string())?;
        tokio::spawn(serve(shared, key(&name), replica.clone()));
        Ok::<_, BenchError>((replica, endpoint))
    });
    let (replica, endpoint) = started.await.map_err(|error| error.to_string())??;
    Ok(Voter { replica, endpoint, runtime: Some(runtime) })
}

fn key(voter: &NodeId) -> String {
    format!("consort/bench/propose/{voter}")
}

/// Proposes the commands of clients to the voter.
async fn serve(bus: SharedBus, key: String, replica: Replica<Ledger>) -> Result<(), BenchError> {
    let mut queries = bus.serve(&key).await.map_err(|error| error.to_string())?;
    while let Some(query) = queries.recv().await {
        let replica = replica.clone();
        tokio::spawn(async move {
            let Ok(command) = codec::decode::<Command>(&query.payload) else { return };
            // The client detects a missing reply.
            let _ = match replica.propose(command, LIMIT * 4 / 5).await {
                Ok(outcome) => {
                    let bytes = codec::encode(&outcome).expect("outcomes are small");
                    query.replier.reply(&query.key, bytes.into(), Encoding::Wire).await
                }
                Err(error) => query.replier.refuse(&error.to_string()).await,
            };
        });
    }
    Ok(())
}

/// The replies to all requests.
#[derive(Default)]
struct Replies {
    /// Total duration.
    took: Duration,
    /// Duration of each request in milliseconds.
    latencies: Vec<f64>,
    /// Time of each reply since the first request.
    at: Vec<Duration>,
    /// Number of repeated requests.
    again: usize,
    /// Total size of the requests.
    bytes: usize,
}

/// Session that sends requests to the leader.
#[derive(Clone)]
struct Client {
    bus: SharedBus,
    leaders: Vec<(NodeId, watch::Receiver<LeadershipView>)>,
}

/// Requests of concurrent clients.
#[derive(Clone, Copy)]
struct Load {
    /// Prefix of the names of the requests. Each load of a cluster has another.
    name: &'static str,
    /// Total number of requests.
    requests: usize,
    /// Number of clients.
    clients: usize,
    /// A client cancels each mission before it submits the next.
    cancels: bool,
}

/// Sends all requests and collects their replies.
async fn run_clients(client: &Client, load: Load) -> Result<Replies, BenchError> {
    let Load { name, requests, clients, cancels } = load;
    let template = shipped().get("lab-samples").ok_or("no such mission")?;
    let mission = template.instantiate(&BTreeMap::new(), &hospital()).map_err(|error| error.to_string())?;
    let division = divide_and_check(&mission).map_err(|error| error.to_string())?;
    let left = Arc::new(AtomicUsize::new(requests));
    let began = Instant::now();
    let mut all = JoinSet::new();
    for number in 0..clients {
        let (Client { bus, leaders }, left) = (client.clone(), Arc::clone(&left));
        let (mission, division) = (mission.clone(), division.clone());
        all.spawn(async move {
            let (mut replies, mut open) = (Replies::default(), None::<MissionId>);
            let take = |left: usize| left.checked_sub(1);
            while left.fetch_update(Ordering::SeqCst, Ordering::SeqCst, take).is_ok() {
                let command = match open.take() {
                    Some(mission) => {
                        Command::Cancel { mission, by: "a client".to_owned(), places: BTreeMap::new(), at_ms: 0 }
                    }
                    None => {
                        let request = RequestId::new(format!("{name}-{number}-{}", replies.at.len())).expect("a slug");
                        Command::Submit(Box::new(Submission::of(request, mission.clone(), division.clone())))
                    }
                };
                let sent_at = Instant::now();
                let request_bytes = Bytes::from(codec::encode(&command).expect("the command is small"));
                replies.bytes += request_bytes.len();
                // On a busy machine the leader may change; a repeated request is executed once.
                let outcome = loop {
                    let leader = leaders.iter().find(|(_, leadership)| leadership.borrow().is_leader);
                    let Some((leader, _)) = leader else {
                        sleep(Duration::from_millis(5)).await;
                        continue;
                    };
                    match send_request(&bus, &key(leader), request_bytes.clone()).await {
                        Ok(outcome) => break outcome,
                        Err(_) if sent_at.elapsed() < LIMIT => {
                            replies.again += 1;
                            sleep(Duration::from_millis(5)).await;
                        }
                        Err(error) => return Err(error),
                    }
                };
                replies.latencies.push(ms(sent_at, Instant::now()));
                replies.at.push(began.elapsed());
                match outcome {
                    CommandOutcome::Submitted { mission, .. } => open = cancels.then_some(mission),
                    // A repeated cancel finds the mission already canceled.
                    CommandOutcome::Done | CommandOutcome::Refused(_) if matches!(command, Command::Cancel { .. }) => {}
                    other => return Err(format!("the ledger replied {other:?}")),
                }
            }
            Ok::<_, BenchError>(replies)
        });
    }
    let mut total = Replies::default();
    for ended in all.join_all().await {
        let Replies { latencies, at, again, bytes, .. } = ended?;
        total.latencies.extend(latencies);
        total.at.extend(at);
        total.again += again;
        total.bytes += bytes;
    }
    Ok(Replies { took: began.elapsed(), ..total })
}

async fn send_request(bus: &SharedBus, key: &str, request_bytes: Bytes) -> Result<CommandOutcome, BenchError> {
    let mut replies = bus.query(key, request_bytes, LIMIT).await.map_err(|error| error.to_string())?;
    let reply = replies.recv().await.ok_or("no reply")?;
    codec::decode(&reply.payload.map_err(|refused| refused.0)?).map_err(|error| error.to_string())
}

/// Returns how many times per second each of three concurrent writers can write some bytes in place
/// and sync them.
fn syncs_per_s(folder: &Path, bytes: usize) -> Result<f64, BenchError> {
    let writers = (0..VOTERS).map(|writer| {
        let path = folder.join(format!("syncs-{writer}"));
        std::thread::spawn(move || -> std::io::Result<f64> {
            let mut file = File::create(path)?;
            file.write_all(&vec![7; MEASURED_FILE])?;
            file.sync_all()?;
            let (began, mut syncs) = (std::time::Instant::now(), 0_usize);
            while began.elapsed() < MEASURED {
                let place = syncs * bytes % (MEASURED_FILE - bytes);
                file.seek(SeekFrom::Start(place as u64))?;
                file.write_all(&vec![7; bytes])?;
                file.sync_data()?;
                syncs += 1;
            }
            Ok(syncs as f64 / began.elapsed().as_secs_f64())
        })
    });
    let writers: Vec<_> = writers.collect();
    let mut sum = 0.0;
    for writer in writers {
        sum += writer.join().map_err(|_| "a writer panicked")?.map_err(|error| error.to_string())?;
    }
    Ok(sum / VOTERS as f64)
}
