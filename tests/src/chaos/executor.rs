//! Executes the actions of a schedule on a fleet.

use super::chaos_fleet::{ChaosFleet, WORLD};
use super::fault_injector::{DATE_MS, FaultInjector};
use super::hostile::HostileNode;
use super::run_counters::millis;
use super::schedule::{ChaosAction, DiskAfterCrash};
use crate::disk::DiskFault;
use crate::history::{Acknowledged, History, Reader, RecordingClient};
use crate::{Fleet, Observation, slug};
use consort_bus::LinkModel;
use consort_protocol::ids::NodeId;
use consort_protocol::units::BatteryShare;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Interval at which people look for missions that need intervention.
const RESOLVE_INTERVAL: Duration = Duration::from_secs(10);

/// Executor of actions, with the active faults and the state that ends each of them.
pub(super) struct ActionExecutor {
    composition: ChaosFleet,
    injector: FaultInjector,
    acknowledged: Acknowledged,
    history: History,
    /// Stopped nodes, by the action that will restart them.
    down: BTreeMap<usize, Vec<String>>,
    partitions: BTreeMap<usize, Vec<Vec<String>>>,
    cuts: BTreeMap<usize, Vec<(String, String)>>,
    weather: BTreeMap<usize, LinkModel>,
    slow: BTreeMap<usize, (String, u64)>,
    disk_faults: BTreeMap<usize, (String, DiskFault)>,
    paused: BTreeMap<usize, String>,
    hostile: BTreeMap<usize, HostileNode>,
    /// Robots with a drained battery.
    flat: BTreeSet<String>,
}

impl ActionExecutor {
    pub(super) fn new(composition: ChaosFleet, injector: FaultInjector) -> ActionExecutor {
        ActionExecutor {
            composition,
            injector,
            acknowledged: watch::Sender::default(),
            history: History::default(),
            down: BTreeMap::new(),
            partitions: BTreeMap::new(),
            cuts: BTreeMap::new(),
            weather: BTreeMap::new(),
            slow: BTreeMap::new(),
            disk_faults: BTreeMap::new(),
            paused: BTreeMap::new(),
            hostile: BTreeMap::new(),
            flat: BTreeSet::new(),
        }
    }

    /// Returns the acknowledged requests.
    pub(super) fn acknowledged(&self) -> BTreeMap<String, String> {
        self.acknowledged.borrow().clone()
    }

    /// Returns the history of all clients.
    pub(super) fn history(&self) -> &History {
        &self.history
    }

    /// Returns a receiver for changes of the acknowledged requests.
    pub(super) fn acknowledged_receiver(&self) -> watch::Receiver<BTreeMap<String, String>> {
        self.acknowledged.subscribe()
    }

    /// Begins action `number`.
    pub(super) async fn begin(&mut self, fleet: &mut Fleet, number: usize, act: &ChaosAction) {
        match act {
            ChaosAction::Submit { request, unnamed, mission, room, priority, deadline_s } => {
                let mut request_body =
                    json!({ "mission": mission, "parameters": { "room": room }, "priority": priority });
                if !unnamed {
                    request_body["request"] = json!(request);
                }
                if let Some(seconds) = deadline_s {
                    request_body["deadline_s"] = json!(seconds);
                }
                self.submit(fleet, request, request_body);
            }
            ChaosAction::Cancel { request } => self.cancel(fleet, request),
            ChaosAction::Crash { node, disk, .. } => {
                let node = if node == "coordinator" {
                    let Some(coordinator) = fleet.coordinating() else { return };
                    coordinator.to_string()
                } else {
                    node.clone()
                };
                self.crash(fleet, number, &[node], *disk).await;
            }
            ChaosAction::Blackout { disk, .. } => {
                let nodes = fleet.running();
                self.crash(fleet, number, &nodes, *disk).await;
            }
            ChaosAction::Pause { node, .. } => {
                fleet.network.pause(&slug(node));
                self.history.begin_pause(slug(node));
                self.paused.insert(number, node.clone());
            }
            ChaosAction::Partition { groups, .. } => {
                self.partitions.insert(number, groups.clone());
                self.apply_partition(fleet);
            }
            ChaosAction::Cut { from, to, .. } => {
                let links = self.links(from, to);
                for (from, to) in &links {
                    fleet.network.cut(slug(from), slug(to));
                }
                self.cuts.insert(number, links);
            }
            ChaosAction::Weather { loss, duplication, reordering, delay_ms, .. } => {
                let slowest = Duration::from_millis(*delay_ms);
                let model = LinkModel {
                    latency_max: slowest.max(LinkModel::LAN.latency_max),
                    loss: *loss,
                    duplication: *duplication,
                    reordering: *reordering,
                    reordering_delay: slowest.max(LinkModel::LAN.latency_max) * 2,
                    ..LinkModel::LAN
                };
                self.weather.insert(number, model);
                self.change_weather(fleet);
            }
            ChaosAction::SlowDisk { node, write_ms, .. } => {
                self.slow.insert(number, (node.clone(), *write_ms));
                self.change_disks();
            }
            // The disk of a node that is down is healthy when it starts again.
            ChaosAction::Disk { node, fault, .. } if fleet.nodes.contains_key(node) => {
                self.injector.disk(node).set_fault(Some(*fault));
                if matches!(fault, DiskFault::Fails | DiskFault::Full) {
                    fleet.unwritable.insert(node.clone());
                }
                self.disk_faults.insert(number, (node.clone(), *fault));
            }
            ChaosAction::Disk { .. } => {}
            ChaosAction::Drift { .. } => {} // in effect from the start: see `FaultInjector`
            ChaosAction::Battery { robot } => {
                let charge = BatteryShare::new(0.04).expect("a share");
                fleet.world.with(|world| world.set_charge(&slug(robot), charge));
                self.flat.insert(robot.clone());
            }
            ChaosAction::Hostile { role, .. } => {
                let (seed, date_ms) = (fleet.seed ^ number as u64, DATE_MS + millis(fleet.elapsed()));
                let attack = HostileNode::start(fleet, *role, seed, date_ms).await;
                attack.map(|attack| self.hostile.insert(number, attack));
            }
            ChaosAction::Skill { robot, how, times } => self.injector.inject_skill_fault(robot, *how, *times),
        }
    }

    /// Ends action `number`, if it was begun and has an end.
    pub(super) async fn end(&mut self, fleet: &mut Fleet, number: usize) {
        if let Some(nodes) = self.down.remove(&number) {
            for node in nodes {
                self.start(fleet, &node).await;
            }
        }
        if let Some(node) = self.paused.remove(&number)
            && !self.paused.values().any(|other| *other == node)
        {
            fleet.network.resume(&slug(&node));
            self.history.end_pause(&slug(&node));
        }
        if self.partitions.remove(&number).is_some() {
            self.apply_partition(fleet);
        }
        if let Some(links) = self.cuts.remove(&number) {
            let still: BTreeSet<_> = self.cuts.values().flatten().collect();
            for (from, to) in links.iter().filter(|link| !still.contains(link)) {
                fleet.network.restore(slug(from), slug(to));
            }
        }
        self.hostile.remove(&number);
        if self.weather.remove(&number).is_some() {
            self.change_weather(fleet);
        }
        if let Some((node, fault)) = self.disk_faults.remove(&number) {
            self.end_disk_fault(fleet, number, &node, fault).await;
        }
        if let Some((node, _)) = self.slow.remove(&number) {
            self.injector.disk(&node).set_slow(None);
            self.change_disks();
        }
    }

    /// Ends all active faults and starts all stopped nodes.
    pub(super) async fn end_all_faults(&mut self, fleet: &mut Fleet) {
        let numbers: BTreeSet<usize> = (self.down.keys().chain(self.paused.keys()))
            .chain(self.partitions.keys().chain(self.cuts.keys()))
            .chain(self.weather.keys().chain(self.slow.keys()))
            .chain(self.hostile.keys().chain(self.disk_faults.keys()))
            .copied()
            .collect();
        for number in numbers {
            self.end(fleet, number).await;
        }
        self.injector.clear_skill_faults();
        // Otherwise a mission may wait forever for a robot with an empty battery.
        for robot in std::mem::take(&mut self.flat) {
            fleet.world.with(|world| world.replace_battery(&slug(&robot)));
        }
    }

    pub(super) async fn crash(&mut self, fleet: &mut Fleet, number: usize, nodes: &[String], disk: DiskAfterCrash) {
        for node in nodes {
            if !fleet.nodes.contains_key(node) {
                continue; // down already
            }
            fleet.kill(node).await;
            self.injector.disk(node).crash(disk.effect());
            if disk == DiskAfterCrash::Empty {
                self.injector.lose_disk(node);
            }
            self.down.entry(number).or_default().push(node.clone());
        }
    }

    /// Ends the fault of a disk, and restarts its node unless its store can still be written.
    async fn end_disk_fault(&mut self, fleet: &mut Fleet, number: usize, node: &str, fault: DiskFault) {
        let after = match fault {
            DiskFault::Hangs => return self.injector.disk(node).set_fault(None),
            DiskFault::Fails | DiskFault::Full => DiskAfterCrash::Kept,
            DiskFault::Lies => DiskAfterCrash::Torn,
        };
        if self.injector.disk(node).has_fault() && fleet.nodes.contains_key(node) {
            self.crash(fleet, number, &[node.to_owned()], after).await;
            self.down.remove(&number);
            self.start(fleet, node).await;
        }
    }

    /// Starts or restarts a node and records its leadership view.
    pub(super) async fn start(&mut self, fleet: &mut Fleet, node: &str) {
        fleet.event_log.add(Observation::TestAction { node: slug(node), action: "starts again" });
        fleet.unwritable.remove(node);
        let known = self.composition.nodes().into_iter().find(|known| *known == node).expect("a node of the fleet");
        if known == WORLD {
            fleet.start_world().await;
        } else if self.composition.stations.contains(&known) {
            fleet.start_station(known).await;
        } else {
            fleet.start_robot(known).await;
        }
        // A paused node stays paused across a restart.
        if self.paused.values().any(|paused| paused == node) {
            fleet.network.pause(&slug(node));
        }
        fleet.record_leadership(node);
    }

    fn links(&self, from: &str, to: &str) -> Vec<(String, String)> {
        let all = || self.composition.nodes().into_iter().map(str::to_owned).chain(["client".to_owned()]);
        let named = |name: &str| if name == "*" { all().collect() } else { vec![name.to_owned()] };
        let (from, to) = (named(from), named(to));
        let pairs = from.iter().flat_map(|from| to.iter().map(move |to| (from.clone(), to.clone())));
        pairs.filter(|(from, to)| from != to).collect()
    }

    /// The latest partition is in force.
    fn apply_partition(&self, fleet: &Fleet) {
        let groups = self.partitions.values().last().cloned().unwrap_or_default();
        let named = |group: Vec<String>| group.iter().map(|name| slug(name)).collect::<Vec<NodeId>>();
        fleet.network.partition(groups.into_iter().map(named));
    }

    fn change_weather(&self, fleet: &Fleet) {
        fleet.network.set_link_model(self.weather.values().last().cloned().unwrap_or(LinkModel::LAN));
    }

    fn change_disks(&self) {
        for (node, most) in self.slow.values() {
            let most = Duration::from_millis(*most);
            self.injector.disk(node).set_slow(Some((most / 4, most)));
        }
    }

    fn client(&self, fleet: &Fleet) -> RecordingClient {
        RecordingClient { bus: Arc::clone(&fleet.requests), keys: fleet.keys.clone(), history: self.history.clone() }
    }

    /// Starts the clients that read missions.
    pub(super) fn spawn_readers(&self, fleet: &Fleet) {
        for reader in Reader::ALL {
            tokio::spawn(self.client(fleet).read(reader, self.acknowledged.clone(), fleet.seed));
        }
    }

    /// Starts a person who resolves missions that need intervention, including those of unnamed
    /// requests that were never acknowledged.
    pub(super) fn spawn_resolver(&self, fleet: &Fleet) {
        let client = self.client(fleet);
        tokio::spawn(async move {
            loop {
                client.resolve_all().await;
                tokio::time::sleep(RESOLVE_INTERVAL).await;
            }
        });
    }

    fn submit(&self, fleet: &Fleet, request: &str, request_body: Value) {
        let (client, event_log) = (self.client(fleet), fleet.event_log.clone());
        let (acknowledged, request) = (self.acknowledged.clone(), request.to_owned());
        let name = request_body.get("request").is_some().then(|| request.clone());
        tokio::spawn(async move {
            let mission = client.submit(&request_body).await;
            let node = slug("client");
            event_log.add(Observation::RequestAcknowledged { node, request: name, mission: mission.clone() });
            acknowledged.send_modify(|known| drop(known.insert(request, mission.to_string())));
        });
    }

    fn cancel(&self, fleet: &Fleet, request: &str) {
        let (client, request) = (self.client(fleet), request.to_owned());
        let mut acknowledged = self.acknowledged.subscribe();
        tokio::spawn(async move {
            if let Ok(known) =
                acknowledged.wait_for(|known| known.contains_key(&request)).await.map(|m| m[&request].clone())
            {
                client.cancel(&slug(&known)).await;
            }
        });
    }
}
