//! A fleet of stations on virtual time, for tests of voters and the coordinator.

use crate::disk::{CrashEffect, VirtualDisk};
use crate::slug;
use crate::ward::{logistics, ward};
use consort_bus::clock::Clock;
use consort_bus::{Bus as _, LinkModel, VirtualBus, VirtualNetwork};
use consort_fleet::autopilot::VOTERS;
use consort_fleet::node::{FleetSettings, NodeHandle, NodeSettings};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::versions::VersionRange;
use consort_raft::LeadershipView;
use consort_raft::store::NodeStore;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::Instant;

/// Stations, each with a store that outlives its node.
pub struct StationFleet {
    /// Source of all randomness. Every failed assertion must name it.
    pub seed: u64,
    /// The network; tests inject network faults here.
    pub network: VirtualNetwork,
    /// The running nodes.
    pub nodes: BTreeMap<String, NodeHandle>,
    keys: Keys,
    settings: FleetSettings,
    stores: BTreeMap<String, NodeStore>,
    /// Disks of the stations of a fleet on disks.
    disks: BTreeMap<String, VirtualDisk>,
    events: Arc<Mutex<Vec<Event>>>,
    lives: u64,
}

impl StationFleet {
    /// Creates a network without nodes. A cluster is created once `expect` nodes have met.
    pub fn empty(seed: u64, expect: usize) -> StationFleet {
        let settings = ward(vec![logistics(&["pick_up"])], expect);
        StationFleet {
            seed,
            network: VirtualNetwork::new(seed, LinkModel::LAN),
            nodes: BTreeMap::new(),
            keys: Keys::new(&settings.fleet),
            settings,
            stores: BTreeMap::new(),
            disks: BTreeMap::new(),
            events: Arc::default(),
            lives: 0,
        }
    }

    /// Starts these stations, which create a cluster together.
    pub async fn founded(seed: u64, names: &[&str]) -> StationFleet {
        let mut fleet = StationFleet::empty(seed, names.len());
        fleet.found(names).await;
        fleet
    }

    /// Same, with durable stores on simulated disks. Snapshots are frequent and logs are short, so that a station
    /// without a ledger receives a snapshot.
    pub async fn founded_on_disks(seed: u64, names: &[&str]) -> StationFleet {
        let mut fleet = StationFleet::empty(seed, names.len());
        (fleet.settings.snapshot_every, fleet.settings.log_entries_kept) = (5, 2);
        let disk = |(name, number): (&&str, u64)| {
            ((*name).to_owned(), VirtualDisk::new(seed.wrapping_mul(1_000).wrapping_add(number)))
        };
        fleet.disks = names.iter().zip(0..).map(disk).collect();
        fleet.found(names).await;
        fleet
    }

    async fn found(&mut self, names: &[&str]) {
        for name in names {
            self.start(name).await;
        }
        let voters = if names.len().is_multiple_of(2) { names.len() - 1 } else { names.len() }.min(VOTERS);
        self.wait_until("the first voters to agree", |fleet| fleet.voters().len() == voters).await;
    }

    /// Sets the target number of voters for nodes that start from now on.
    pub fn set_voter_target(&mut self, voters: usize) {
        self.settings.voters = voters;
    }

    /// Starts a station: with the store of its last run, or with an empty one.
    pub async fn start(&mut self, name: &str) {
        self.start_as(name, true).await;
    }

    /// Starts a battery-powered mobile node with its store.
    pub async fn start_mobile(&mut self, name: &str) {
        self.start_as(name, false).await;
    }

    /// Starts a station with an empty store.
    pub async fn start_empty(&mut self, name: &str) {
        self.stores.remove(name);
        self.start(name).await;
    }

    /// Starts a station with an empty store, after damage to its store.
    pub async fn start_with_replaced_store(&mut self, name: &str) {
        self.stores.insert(name.to_owned(), NodeStore::replacing_damaged(self.seed_of_life(self.lives + 1)));
        self.start(name).await;
    }

    fn seed_of_life(&self, life: u64) -> u64 {
        self.seed.wrapping_mul(1_000_003).wrapping_add(life)
    }

    async fn start_as(&mut self, name: &str, fixed: bool) {
        self.lives += 1;
        let seed = self.seed_of_life(self.lives);
        let store = match self.disks.get(name) {
            Some(disk) => disk.store(),
            None => self.stores.entry(name.to_owned()).or_insert_with(|| NodeStore::in_memory(seed)).clone(),
        };
        let settings = NodeSettings {
            fleet: self.settings.clone(),
            node: slug(name),
            incarnation: self.lives,
            seed,
            store,
            clock: Clock::virtual_at(0),
            supported_versions: VersionRange::OWN,
            may_vote: true,
            stationary: fixed,
            mains_powered: fixed,
            robot: None,
            driver_server: None,
            devices: vec![],
            observer: None,
            record_signer: None,
        };
        let bus = Arc::new(self.network.bus(slug(name)));
        self.listen_at(&bus).await;
        let node = NodeHandle::start(settings, bus).await.expect("a virtual node starts");
        self.nodes.insert(name.to_owned(), node);
    }

    async fn listen_at(&self, bus: &VirtualBus) {
        let mut samples =
            bus.subscribe(&self.keys.write(&Key::Events(bus.node().clone()))).await.expect("a virtual bus");
        let (events, node) = (Arc::clone(&self.events), bus.node().clone());
        tokio::spawn(async move {
            while let Some(sample) = samples.recv().await {
                let event: Event = serde_json::from_slice(&sample.payload).expect("an event");
                if event.node == node {
                    events.lock().expect("no panic while it is locked").push(event);
                }
            }
        });
    }

    /// Ends a node as SIGKILL does.
    pub async fn kill(&mut self, name: &str) {
        self.kill_with(name, CrashEffect::Kill).await;
    }

    /// Same, and damages the file with its log and its snapshot.
    ///
    /// # Panics
    /// If the station has no disk.
    pub async fn kill_and_damage(&mut self, name: &str) {
        assert!(self.disks.contains_key(name), "{name} has no disk");
        self.kill_with(name, CrashEffect::Damage).await;
    }

    async fn kill_with(&mut self, name: &str, effect: CrashEffect) {
        self.network.crash(&slug(name));
        self.nodes.remove(name).expect("a node that runs").kill().await;
        if let Some(disk) = self.disks.get(name) {
            disk.crash(effect);
        }
    }

    /// Returns the number of damaged stores that were replaced on the disk of a station.
    pub fn replaced_stores(&self, name: &str) -> u32 {
        self.disks[name].replaced()
    }

    /// Returns the number of snapshots that a station has received from leaders and stored on its disk.
    pub fn installed_snapshots(&self, name: &str) -> usize {
        self.disks[name].log_writes().installations
    }

    /// Returns the leadership view of a node.
    pub fn leadership_view(&self, name: &str) -> LeadershipView {
        self.nodes[name].replica.as_ref().expect("a station has a replica").leadership().borrow().clone()
    }

    /// Returns the nodes that currently count themselves leader.
    pub fn leaders(&self) -> Vec<String> {
        self.nodes.keys().filter(|name| self.leadership_view(name).is_leader).cloned().collect()
    }

    /// Returns the names of the voters from the view of the only leader; empty without a leader or
    /// during a membership change.
    pub fn voters(&self) -> BTreeSet<String> {
        let [leader] = &self.leaders()[..] else { return BTreeSet::new() };
        let believed = self.leadership_view(leader);
        if believed.pending_voters.is_some() {
            return BTreeSet::new();
        }
        believed.voters.values().map(ToString::to_string).collect()
    }

    /// Returns the cluster of a node.
    pub fn cluster(&self, name: &str) -> Option<ClusterId> {
        self.nodes[name].membership.cluster()
    }

    /// Waits until a single node coordinates and returns its name.
    pub async fn wait_for_coordinator(&self) -> String {
        self.wait_until("there is a single coordinator", |fleet| fleet.leaders().len() == 1).await;
        self.leaders().remove(0)
    }

    /// Waits until `done` returns true and checks every two virtual milliseconds. A cluster may
    /// never have two leaders.
    ///
    /// # Panics
    /// If `done` stays false for two minutes, or if a cluster has two leaders.
    pub async fn wait_until(&self, what: &str, mut done: impl FnMut(&StationFleet) -> bool) {
        let began = Instant::now();
        while !done(self) {
            let waited = began.elapsed();
            assert!(
                waited < Duration::from_secs(120),
                "seed {}: timeout waiting for {what}; voters {:?}\n{:#?}",
                self.seed,
                self.voters(),
                self.events()
            );
            self.one_leader_per_cluster();
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    }

    /// Lets virtual time pass.
    pub async fn advance(&self, time: Duration) {
        let end = Instant::now() + time;
        self.wait_until("time to pass", |_| Instant::now() >= end).await;
    }

    fn one_leader_per_cluster(&self) {
        let leaders = self.leaders();
        // The cluster id is unknown until the first command of the ledger is committed.
        let clusters: Vec<_> = leaders.iter().filter_map(|name| self.cluster(name)).collect();
        let distinct: BTreeSet<_> = clusters.iter().collect();
        assert_eq!(distinct.len(), clusters.len(), "seed {}: {leaders:?} lead at once", self.seed);
    }

    /// Returns all published events in order.
    pub fn events(&self) -> Vec<EventKind> {
        self.events.lock().expect("no panic while it is locked").iter().map(|event| event.kind.clone()).collect()
    }

    /// Returns the reason of each voter change.
    pub fn voter_change_reasons(&self) -> Vec<String> {
        let reason = |what: EventKind| match what {
            EventKind::Voters { reason, .. } => Some(reason),
            _ => None,
        };
        self.events().into_iter().filter_map(reason).collect()
    }

    /// Submits a mission on the bus of `at` until it is acknowledged.
    pub async fn submit(&self, at: &str, request: &str) -> Value {
        let request = json!({ "mission": "lab-samples", "parameters": { "room": "IC Room 6" }, "request": request });
        for _ in 0..400 {
            let answers = self.query(at, &Key::Api(ApiCall::Submit), &request, Duration::from_secs(1)).await;
            if let Some(answer) = answers.into_iter().find(|answer| answer["mission"].is_string()) {
                return answer;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        panic!("seed {}: request {request} was not acknowledged", self.seed);
    }

    /// Sends a query on the bus of `at` and returns all replies.
    pub async fn query(&self, at: &str, key: &Key, request: &Value, limit: Duration) -> Vec<Value> {
        let bus = self.network.bus(slug(at));
        let payload = request.to_string().into_bytes().into();
        let mut replies = bus.query(&self.keys.write(key), payload, limit).await.expect("a virtual bus");
        let mut answers = vec![];
        while let Some(reply) = replies.recv().await {
            answers.push(serde_json::from_slice(&reply.payload.expect("a reply")).expect("JSON"));
        }
        answers
    }

    /// Returns the decommission key of a node.
    pub fn leave_key(name: &str) -> Key {
        Key::Leave(slug::<NodeId>(name))
    }
}
