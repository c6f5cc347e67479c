//! Executes the actions of a schedule on a fleet.

use super::alarms;
use super::chaos_fleet::{ChaosFleet, WORLD};
use super::closures;
use super::dates::date_ms;
use super::fault_injector::FaultInjector;
use super::hostile::{HOSTILE, HostileNode};
use super::mission_changes;
use super::orders;
use super::recurring;
use super::request_ids::dated_id;
use super::revocation::{revoke, role_of};
use super::rolling_upgrade::{self, RollingUpgrade};
use super::schedule::{CARRIER_OF, ChaosAction, DiskAfterCrash};
use super::speed_limits;
use crate::disk::{DiskFault, LogWrites};
use crate::history::{Acknowledged, EndedMissions, History, Reader, RecordingClient};
use crate::{Fleet, Observation, slug};
use consort_bus::LinkModel;
use consort_protocol::api::SubmitRequest;
use consort_protocol::ids::{MissionId, NodeId, RequestId};
use consort_protocol::ledger::Ledger;
use consort_protocol::units::BatteryShare;
use consort_protocol::versions::VersionRange;
use consort_skills::actions::RobotBackend as _;
use consort_skills::workload::Workload;
use consort_world::SharedWorld;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Interval at which people look for missions that need intervention.
pub(super) const RESOLVE_INTERVAL: Duration = Duration::from_secs(10);

/// Time after which a robot whose driver server is gone stops by itself, as the watchdog of its base requires.
const BASE_WATCHDOG: Duration = Duration::from_millis(500);

/// Share of the named requests that a client repeats although they were acknowledged, and the pause before
/// each repetition.
const REPEATED: f64 = 0.5;
const REPEATED_AFTER_S: RangeInclusive<u64> = 10..=120;

/// The same pause if the ledger forgets outcomes: then clients repeat all of these requests, until they are refused.
const REPEATED_SOON_S: RangeInclusive<u64> = 10..=30;

/// Executor of actions, with the active faults and the state that ends each of them.
pub(super) struct ActionExecutor {
    composition: ChaosFleet,
    workload: Workload,
    injector: FaultInjector,
    acknowledged: Acknowledged,
    /// Acknowledged requests whose repetition was refused, because the ledger has forgotten their outcomes.
    refused: watch::Sender<BTreeSet<String>>,
    history: History,
    /// Stopped nodes, by the action that will restart them.
    down: BTreeMap<usize, Vec<String>>,
    partitions: BTreeMap<usize, Vec<Vec<String>>>,
    cuts: BTreeMap<usize, Vec<(String, String)>>,
    weather: BTreeMap<usize, LinkModel>,
    slow: BTreeMap<usize, (String, u64)>,
    disk_faults: BTreeMap<usize, (String, DiskFault)>,
    /// Paused nodes, and nodes of suspended machines.
    paused: BTreeMap<usize, String>,
    /// Nodes with a blocked bus.
    blocked: BTreeMap<usize, String>,
    suspended: BTreeSet<usize>,
    hostile: BTreeMap<usize, HostileNode>,
    /// Time at which the certificate of a hostile node is revoked.
    revocation: Option<Duration>,
    /// Robots, by name or by request, whose certificates are revoked as soon as they hold a role.
    to_revoke: BTreeMap<usize, String>,
    /// Running nodes with a revoked certificate.
    revoked: BTreeMap<usize, String>,
    /// Nodes that were asked to leave, and whether they have left.
    leaving: BTreeMap<usize, (String, bool)>,
    /// Nodes that are gone for good.
    removed: BTreeSet<String>,
    upgrade: Option<RollingUpgrade>,
    /// Time at which the robots stop, because the driver server is gone.
    bodies_stop_at: Option<Duration>,
    /// Robots with a drained battery.
    flat: BTreeSet<String>,
    /// All faults have ended.
    are_faults_over: bool,
    /// Clients repeat some requests that were acknowledged.
    repeats: bool,
}

impl ActionExecutor {
    pub(super) fn new(composition: ChaosFleet, injector: FaultInjector, workload: Workload) -> ActionExecutor {
        ActionExecutor {
            composition,
            workload,
            acknowledged: watch::Sender::default(),
            refused: watch::Sender::default(),
            history: History::new(EndedMissions {
                listed_max: injector.ended_missions_max(),
                are_forgotten: injector.forgets_outcomes(),
            }),
            injector,
            down: BTreeMap::new(),
            partitions: BTreeMap::new(),
            cuts: BTreeMap::new(),
            weather: BTreeMap::new(),
            slow: BTreeMap::new(),
            disk_faults: BTreeMap::new(),
            paused: BTreeMap::new(),
            blocked: BTreeMap::new(),
            suspended: BTreeSet::new(),
            hostile: BTreeMap::new(),
            revocation: None,
            to_revoke: BTreeMap::new(),
            revoked: BTreeMap::new(),
            leaving: BTreeMap::new(),
            removed: BTreeSet::new(),
            upgrade: None,
            bodies_stop_at: None,
            flat: BTreeSet::new(),
            are_faults_over: false,
            repeats: true,
        }
    }

    /// Lets no client repeat a request that was acknowledged: in a long run there would be more and more of them.
    #[must_use]
    pub(super) fn without_repetitions(self) -> ActionExecutor {
        ActionExecutor { repeats: false, ..self }
    }

    /// Returns the acknowledged requests.
    pub(super) fn acknowledged(&self) -> BTreeMap<String, String> {
        self.acknowledged.borrow().clone()
    }

    /// Returns the history of all clients.
    pub(super) fn history(&self) -> &History {
        &self.history
    }

    /// Returns the numbers of writes of all disks.
    pub(super) fn log_writes(&self) -> LogWrites {
        self.injector.log_writes()
    }

    /// Returns a receiver for changes of the acknowledged requests.
    pub(super) fn acknowledged_receiver(&self) -> watch::Receiver<BTreeMap<String, String>> {
        self.acknowledged.subscribe()
    }

    /// Returns the acknowledged requests whose repetition was refused.
    pub(super) fn refused(&self) -> BTreeSet<String> {
        self.refused.borrow().clone()
    }

    /// Returns a receiver for changes of these requests.
    pub(super) fn refused_receiver(&self) -> watch::Receiver<BTreeSet<String>> {
        self.refused.subscribe()
    }

    /// Begins action `number`.
    pub(super) async fn begin(&mut self, fleet: &mut Fleet, number: usize, act: &ChaosAction) {
        let Some(act) = act.resolved(|name| self.carrier(fleet, name)) else { return };
        match &act {
            ChaosAction::Submit { request, unnamed, mission, room, priority, deadline_s } => {
                let parameters = self.workload.parameters_in(mission, room);
                let body = SubmitRequest {
                    request: (!unnamed).then(|| self.request_id(fleet, request)),
                    priority: *priority,
                    deadline_s: deadline_s.map(f64::from),
                    ..self.workload.request(mission, parameters)
                };
                self.submit(fleet, request, body);
            }
            ChaosAction::Cancel { request } => self.cancel(fleet, request),
            ChaosAction::ChangeSchedule { change, missed } => {
                let (client, request) = (self.client(fleet), recurring::request(*change, *missed));
                tokio::spawn(async move { client.change_schedule(&request).await });
            }
            ChaosAction::Order { robot, change } => self.order(fleet, number, orders::request(robot, *change)),
            ChaosAction::Closure { part, change } => self.order(fleet, number, closures::request(part, *change)),
            ChaosAction::Alarm { alarm, change } => self.order(fleet, number, alarms::request(alarm, *change)),
            ChaosAction::SpeedLimit { part, change } => self.order(fleet, number, speed_limits::request(part, *change)),
            ChaosAction::ChangeMission { request, change } => self.change_mission(fleet, number, request, change),
            ChaosAction::CancelMissions { selection } => {
                let known = self.acknowledged();
                let request = mission_changes::cancelation(selection, |request| known.get(request).cloned());
                if let Some(request) = request {
                    self.order(fleet, number, request);
                }
            }
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
            ChaosAction::Pause { node, .. } => self.pause(fleet, number, node),
            ChaosAction::Block { node, .. } if fleet.nodes.contains_key(node) => {
                fleet.network.block(&slug(node));
                self.history.begin_pause(slug(node));
                self.blocked.insert(number, node.clone());
            }
            ChaosAction::Block { .. } => {} // it is down
            ChaosAction::Suspend { node, .. } => {
                self.pause(fleet, number, node);
                self.suspended.insert(number);
            }
            ChaosAction::Remove { node } => {
                self.crash(fleet, number, std::slice::from_ref(node), DiskAfterCrash::Kept).await;
                self.removed.insert(node.clone());
            }
            ChaosAction::Leave { node, .. } if fleet.nodes.contains_key(node) => {
                let (client, node) = (self.client(fleet), node.clone());
                fleet.asked_to_leave.insert(slug(&node));
                self.leaving.insert(number, (node.clone(), false));
                tokio::spawn(async move { client.leave(&slug(&node)).await });
            }
            ChaosAction::Leave { .. } => {} // it is down
            ChaosAction::Revoke { node, .. } => drop(self.to_revoke.insert(number, node.clone())),
            ChaosAction::Upgrade { interval_ms } => {
                self.injector.upgrade();
                let (nodes, interval) = (fleet.running(), Duration::from_millis(*interval_ms));
                self.upgrade = Some(RollingUpgrade::new(nodes, interval, fleet.elapsed()));
            }
            ChaosAction::WrongDate { .. } => {} // in effect by the clock of the node: see `FaultInjector`
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
            ChaosAction::Hostile { role, revoked, for_ms } => {
                let halfway = fleet.elapsed() + Duration::from_millis(for_ms / 2);
                self.revocation = revoked.then_some(halfway);
                let (seed, date_ms) = (fleet.seed ^ number as u64, date_ms(fleet.elapsed()));
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
            let is_up = fleet.nodes.contains_key(&node);
            if self.suspended.remove(&number) && is_up && self.injector.notices_suspension(&node) {
                self.restart(fleet, number, &node).await;
            }
        }
        if let Some(node) = self.blocked.remove(&number) {
            self.unblock(fleet, &node);
        }
        if let Some((node, has_left)) = self.leaving.remove(&number) {
            if has_left {
                self.injector.lose_disk(&node);
                self.start(fleet, &node).await;
            } else if fleet.nodes.contains_key(&node) {
                self.restart(fleet, number, &node).await;
            }
        }
        self.to_revoke.remove(&number);
        if let Some(node) = self.revoked.remove(&number) {
            self.crash(fleet, number, &[node], DiskAfterCrash::Kept).await;
            self.down.remove(&number);
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
        let numbers: BTreeSet<usize> = (self.down.keys().chain(self.paused.keys()).chain(self.blocked.keys()))
            .chain(self.partitions.keys().chain(self.cuts.keys()))
            .chain(self.weather.keys().chain(self.slow.keys()))
            .chain(self.hostile.keys().chain(self.disk_faults.keys()).chain(self.leaving.keys()))
            .chain(self.to_revoke.keys().chain(self.revoked.keys()))
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
        self.are_faults_over = true;
    }

    /// Performs what is due between the actions of the schedule: the ends of nodes that have left, the
    /// restarts of an upgrade, revocations, and new batteries of stranded robots after all faults.
    pub(super) async fn advance(&mut self, fleet: &mut Fleet) {
        if self.are_faults_over && fleet.chargers().next().is_some() {
            replace_empty_batteries(&fleet.world);
        }
        for (node, has_left) in self.leaving.values_mut() {
            *has_left |= fleet.finish_decommission(node).await;
        }
        if let Some(upgrade) = &mut self.upgrade {
            let next = upgrade.next(fleet.elapsed());
            if upgrade.is_complete() {
                self.upgrade = None;
                rolling_upgrade::spawn_finish(self.client(fleet));
            }
            if let Some(node) = next.filter(|node| fleet.nodes.contains_key(node)) {
                self.restart(fleet, usize::MAX, &node).await;
            }
        }
        if self.bodies_stop_at.is_some_and(|due| due <= fleet.elapsed()) {
            self.bodies_stop_at = None;
            if !fleet.nodes.contains_key(WORLD) {
                stop_bodies(fleet);
            }
        }
        if self.revocation.is_some_and(|due| due <= fleet.elapsed()) {
            self.revocation = None;
            revoke(fleet, HOSTILE, None, self.injector.reads_revocations());
        }
        self.revoke_robots_at_work(fleet);
    }

    /// Revokes the certificates of the robots of a closed fleet that hold a role by now. Their nodes do not start again.
    fn revoke_robots_at_work(&mut self, fleet: &Fleet) {
        for (number, name) in std::mem::take(&mut self.to_revoke) {
            let node = if name.starts_with(CARRIER_OF) { self.carrier(fleet, &name) } else { Some(name.clone()) };
            match node.and_then(|node| Some((role_of(fleet, &node)?, node))) {
                Some((role, node)) => {
                    revoke(fleet, &node, Some(role), self.injector.reads_revocations());
                    self.removed.insert(node.clone());
                    self.revoked.insert(number, node);
                }
                None => drop(self.to_revoke.insert(number, name)),
            }
        }
    }

    /// Returns a check whether the fleet writes the version that it should write at the end.
    pub(super) fn upgrade_check(&self) -> impl Fn(&Fleet) -> bool + use<> {
        let newest = VersionRange::OWN.newest;
        move |fleet| fleet.ledger(Ledger::wire).flatten() == Some(newest)
    }

    /// Restarts a running node as after a crash of its process.
    async fn restart(&mut self, fleet: &mut Fleet, number: usize, node: &str) {
        self.crash(fleet, number, &[node.to_owned()], DiskAfterCrash::Kept).await;
        self.down.remove(&number);
        self.start(fleet, node).await;
    }

    /// Unblocks the bus of a node, unless another fault blocks it.
    fn unblock(&mut self, fleet: &Fleet, node: &str) {
        if !self.blocked.values().any(|other| other == node) {
            fleet.network.unblock(&slug(node));
            self.history.end_pause(&slug(node));
        }
    }

    fn pause(&mut self, fleet: &Fleet, number: usize, node: &str) {
        fleet.network.pause(&slug(node));
        self.history.begin_pause(slug(node));
        self.paused.insert(number, node.to_owned());
    }

    /// Returns the carrier of an acknowledged request.
    fn carrier(&self, fleet: &Fleet, name: &str) -> Option<String> {
        let mission: MissionId = slug(self.acknowledged.borrow().get(name.strip_prefix(CARRIER_OF)?)?);
        let holders = fleet.ledger(|ledger| Some(ledger.mission(&mission)?.holders())).flatten()?;
        let mut robots = holders.into_values().map(|robot| robot.to_string());
        robots.find(|robot| self.composition.carriers.contains(&robot.as_str()))
    }

    pub(super) async fn crash(&mut self, fleet: &mut Fleet, number: usize, nodes: &[String], disk: DiskAfterCrash) {
        for node in nodes {
            if !fleet.nodes.contains_key(node) {
                continue; // down already
            }
            fleet.kill(node).await;
            if self.blocked.values().any(|blocked| blocked == node) {
                self.blocked.retain(|_, blocked| blocked != node); // a new process has empty buffers
                self.unblock(fleet, node);
            }
            if node == WORLD {
                self.bodies_stop_at = Some(fleet.elapsed() + BASE_WATCHDOG);
            }
            self.injector.disk(node).crash(disk.effect());
            self.disk_faults.retain(|_, (faulty, _)| faulty != node);
            if disk == DiskAfterCrash::Empty {
                self.injector.lose_disk(node);
            }
            self.down.entry(number).or_default().push(node.clone());
        }
    }

    /// Ends the fault of a disk, and restarts its node unless its store can still be written.
    async fn end_disk_fault(&mut self, fleet: &mut Fleet, number: usize, node: &str, fault: DiskFault) {
        let other = self.disk_faults.values().rev().find(|(other, _)| other == node).map(|(_, fault)| *fault);
        let after = match fault {
            DiskFault::Hangs => return self.injector.disk(node).set_fault(other),
            DiskFault::Fails | DiskFault::Full => DiskAfterCrash::Kept,
            DiskFault::Lies => DiskAfterCrash::Torn,
        };
        let is_faulty = self.injector.disk(node).has_fault() || fleet.unwritable.contains(node);
        if is_faulty && fleet.nodes.contains_key(node) {
            self.crash(fleet, number, &[node.to_owned()], after).await;
            self.down.remove(&number);
            self.start(fleet, node).await;
        }
    }

    /// Starts or restarts a node and records its leadership view.
    pub(super) async fn start(&mut self, fleet: &mut Fleet, node: &str) {
        if self.removed.contains(node) || fleet.nodes.contains_key(node) {
            return;
        }
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

    pub(super) fn client(&self, fleet: &Fleet) -> RecordingClient {
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

    /// Returns the id of a named request that is sent now: its name, unless the ledger forgets outcomes.
    fn request_id(&self, fleet: &Fleet, name: &str) -> RequestId {
        if self.injector.forgets_outcomes() { dated_id(name, fleet.elapsed()) } else { slug(name) }
    }

    fn submit(&self, fleet: &Fleet, request: &str, mut body: SubmitRequest) {
        let (client, event_log) = (self.client(fleet), fleet.event_log.clone());
        let (acknowledged, refused, request) = (self.acknowledged.clone(), self.refused.clone(), request.to_owned());
        let mut chance = ChaCha8Rng::seed_from_u64(fleet.seed ^ fleet.elapsed().as_nanos() as u64);
        let pause_s = match self.injector.forgets_outcomes() {
            true => Some(REPEATED_SOON_S),
            false => chance.random_bool(REPEATED).then_some(REPEATED_AFTER_S),
        };
        let repetition = pause_s.map(|pause_s| Duration::from_secs(chance.random_range(pause_s)));
        let repetition = repetition.filter(|_| self.repeats && body.request.is_some());
        tokio::spawn(async move {
            let mut is_acknowledged = false;
            loop {
                match client.submit_new(&json!(body)).await {
                    Some(mission) => {
                        event_log.add(Observation::RequestAcknowledged {
                            node: slug("client"),
                            request: body.request.as_ref().map(RequestId::to_string),
                            mission: mission.clone(),
                        });
                        acknowledged
                            .send_if_modified(|known| known.insert(request.clone(), mission.to_string()).is_none());
                        is_acknowledged = true;
                    }
                    None if is_acknowledged => {
                        refused.send_if_modified(|refused| refused.insert(request.clone()));
                        return;
                    }
                    None => {}
                }
                let Some(pause) = repetition else { return };
                tokio::time::sleep(pause).await;
                if !is_acknowledged {
                    // The client does not know whether the request was executed, and sends it under another id.
                    body.request = Some(dated_id(&request, event_log.elapsed()));
                }
            }
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

/// Gives the stranded robots new batteries, as a person would. Faults may have prolonged their tasks beyond their
/// estimates.
pub(super) fn replace_empty_batteries(world: &SharedWorld) {
    for robot in world.robots() {
        if world.telemetry(&robot).is_some_and(|telemetry| !telemetry.able) {
            world.with(|world| world.replace_battery(&robot));
        }
    }
}

/// Ends all goals in the world.
fn stop_bodies(fleet: &Fleet) {
    let mut world = fleet.world.clone();
    for robot in world.robots() {
        for goal in world.goals(&robot) {
            world.cancel(&robot, goal);
        }
    }
}
