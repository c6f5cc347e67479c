//! Views of a fleet as seen by a single node.
//!
//! A view is drawn from copies of what it needs from the knowledge and the ledger, so gossip and the
//! ledger go on meanwhile.

use super::Views;
use super::cluster_status::ClusterStatus;
use super::health::{Blocking, HealthInputs, health};
use super::mission::{auctions, auctions_shown, ended_mission, mission, missions, schedules};
use crate::charger_users::charger_users;
use crate::device_reports::device_reports;
use crate::robot_driver::RobotDriver;
use consort_gossip::MemberStatus;
use consort_protocol::api::ErrorReply;
use consort_protocol::auction::AuctionRecord;
use consort_protocol::chargers::ChargerQueue;
use consort_protocol::ensemble::{Ensemble, KnowledgeExchange, MemberValues, Membership};
use consort_protocol::ids::{ClusterId, EnsembleId, MissionId, NodeId, PlaceId, RobotId};
use consort_protocol::keys::Key;
use consort_protocol::knowledge::{Availability, KnowledgeBase, KnownRecord};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Ledger, MissionState, ResourceLease, RobotOrders};
use consort_protocol::mission::DomainReference;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{NodeTime, Seconds};
use consort_protocol::view::{
    AuditView, ChargerLeaseView, ChargerView, Contact, CoordinatorView, EnsembleKnowledgeView, EnsembleMember,
    EnsembleView, EnsemblesView, FleetView, HealthView, HeldRole, LedgerCopy, MemberKnowledge, MissionView,
    MissionsView, NodeStatus, NodeTraits, NodeView, PersonRequestView, PromisedRoleView, Provenance, PublishedRecord,
    RequestsView, RobotView, SchedulesView, WithProvenance,
};
use consort_raft::Replica;
use serde::Serialize;
use serde_json::Value;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;
use std::time::Duration;

/// Maximum number of closed requests to people in the view.
const CLOSED_REQUESTS_SHOWN: usize = 50;

/// Inputs of all views at a single moment.
pub(super) struct ViewContext<'a> {
    pub(super) views: &'a Views,
    pub(super) status: ClusterStatus,
    /// A majority has confirmed this node's copy of the ledger for this request.
    pub(super) linearizable: bool,
    /// Values of the drivers of the robots of other nodes, from these nodes.
    pub(super) received_values: BTreeMap<NodeId, DriverValues>,
    /// Copies, once they are needed.
    pub(super) copies: Copies,
    pub(super) now: NodeTime,
}

/// Copies of what views are drawn from.
#[derive(Default)]
pub(super) struct Copies {
    base: OnceLock<KnowledgeBase>,
    statuses: OnceLock<BTreeMap<NodeId, MemberStatus>>,
    /// `None` without a copy of the ledger.
    robots: OnceLock<Option<(LedgerCopy, RobotsInLedger)>>,
}

/// The part of the ledger about each robot, from a single pass over the missions.
struct RobotsInLedger {
    held: BTreeMap<RobotId, HeldRole>,
    orders: BTreeMap<RobotId, RobotOrders>,
    /// Promised roles in their order.
    promised: BTreeMap<RobotId, Vec<PromisedRoleView>>,
}

/// A view of the ledger, or what it is drawn from. Its JSON is written while the ledger is not locked.
enum LedgerView {
    Missions(MissionsView),
    Requests(RequestsView),
    Schedules(SchedulesView),
    Audit(AuditView),
    Auctions(Vec<AuctionRecord>),
    Mission(Box<MissionView>),
}

impl LedgerView {
    fn draw(self, provenance: &Provenance) -> Value {
        match self {
            LedgerView::Missions(view) => with(provenance, view),
            LedgerView::Requests(view) => with(provenance, view),
            LedgerView::Schedules(view) => with(provenance, view),
            LedgerView::Audit(view) => with(provenance, view),
            LedgerView::Auctions(records) => with(provenance, auctions(records)),
            LedgerView::Mission(view) => with(provenance, view),
        }
    }
}

/// Values that the driver of a robot has published, by name; `None` if they are not known.
#[derive(Clone, Default)]
pub(super) struct DriverValues {
    /// Latest readings.
    pub(super) readings: Option<BTreeMap<String, Scalar>>,
    /// Latest feedback of the goal in progress.
    pub(super) feedback: Option<BTreeMap<String, Scalar>>,
}

impl ViewContext<'_> {
    /// Returns all `wanted` views that this node can compute by itself. A mission that ended long ago
    /// has a view only if it is `named`.
    pub(super) fn draw(&self, wanted: &impl Fn(&Key) -> bool, named: Option<&MissionId>) -> Vec<(Key, Value)> {
        let mut views = vec![];
        for key in [Key::ViewFleet, Key::ViewEnsembles, Key::ViewCoordinator, Key::ViewMap, Key::ViewHealth] {
            if wanted(&key) {
                let value = match &key {
                    Key::ViewFleet => self.with_provenance(self.fleet()),
                    Key::ViewEnsembles => self.with_provenance(EnsemblesView { ensembles: self.ensembles() }),
                    Key::ViewCoordinator => self.with_provenance(self.coordinator()),
                    Key::ViewMap => self.map(),
                    _ => self.with_provenance(self.health()),
                };
                views.push((key, value));
            }
        }
        let robots = self.views.robot_nodes().into_iter();
        let robots = robots.map(|node| (Key::ViewRobot(RobotId::from(node.clone())), node));
        views.extend(robots.filter(|(key, _)| wanted(key)).filter_map(|(key, node)| {
            let stored = self.views.knowledge.read(|base| base.get(&node).cloned())?;
            Some((key, self.robot(&node, &stored)))
        }));
        views.extend(self.exchanged(wanted));
        views.extend(self.ledger_views(wanted, named));
        views
    }

    /// Returns the values that the members of ensembles exchange, of the ensembles that this node
    /// belongs to.
    fn exchanged(&self, wanted: &impl Fn(&Key) -> bool) -> Vec<(Key, Value)> {
        let view = |(key, name, exchange): (Key, &EnsembleId, &KnowledgeExchange)| {
            let member = |(robot, (MemberValues { attributes, readings }, age))| {
                (robot, MemberKnowledge { age_ms: millis(age), attributes, readings })
            };
            let robots = exchange.latest(self.now)?.into_iter().map(member).collect();
            Some((key, EnsembleKnowledgeView { ensemble: name.clone(), member: self.views.node.clone(), robots }))
        };
        let copied: Vec<_> = {
            let exchanges = self.views.exchanges.lock();
            let keys = exchanges.iter().map(|(name, exchange)| (Key::ViewEnsemble(name.clone()), name, exchange));
            keys.filter(|(key, ..)| wanted(key)).filter_map(view).collect()
        };
        copied.into_iter().map(|(key, content)| (key, self.with_provenance(content))).collect()
    }

    /// Returns the views of the ledger, if this node has a copy.
    fn ledger_views(&self, wanted: &impl Fn(&Key) -> bool, named: Option<&MissionId>) -> Vec<(Key, Value)> {
        let Some(replica) = self.own_copy() else { return vec![] };
        let (copy, views) = self.read_copy(replica, |ledger| {
            let mut views = vec![];
            if wanted(&Key::ViewMissions) {
                views.push((Key::ViewMissions, LedgerView::Missions(missions(ledger))));
            }
            if wanted(&Key::ViewRequests) {
                views.push((Key::ViewRequests, LedgerView::Requests(self.requests(ledger))));
            }
            if wanted(&Key::ViewSchedules) {
                views.push((Key::ViewSchedules, LedgerView::Schedules(schedules(ledger))));
            }
            if wanted(&Key::ViewAudit) {
                let entries = ledger.audit_trail().cloned().collect();
                views.push((Key::ViewAudit, LedgerView::Audit(AuditView { entries })));
            }
            if wanted(&Key::ViewAuctions) {
                views.push((Key::ViewAuctions, LedgerView::Auctions(auctions_shown(ledger))));
            }
            let entries = ledger.missions().map(|entry| (Key::ViewMission(entry.id.clone()), entry));
            let wanted = entries.filter(|(key, _)| wanted(key));
            views.extend(wanted.map(|(key, entry)| (key, LedgerView::Mission(Box::new(mission(ledger, entry))))));
            let ended = named.filter(|id| ledger.mission(id).is_none());
            if let Some((id, tombstone)) = ended.and_then(|id| Some((id, ledger.tombstone(id)?))) {
                let view = LedgerView::Mission(Box::new(ended_mission(id.clone(), tombstone)));
                views.push((Key::ViewMission(id.clone()), view));
            }
            views
        });
        let provenance = Provenance { ledger: Some(copy), ..self.provenance() };
        views.into_iter().map(|(key, view)| (key, view.draw(&provenance))).collect()
    }

    /// Returns the requests to people.
    fn requests(&self, ledger: &Ledger) -> RequestsView {
        let place_of = |robot: &RobotId| crate::coordinator::last_known_place(&self.views.knowledge, robot);
        let view = |(entry, request)| PersonRequestView::of(entry, request, place_of);
        let closed = ledger.missions().flat_map(|entry| {
            let requests = entry.person_requests().map(move |(_, request)| (entry, request));
            requests.filter(|(_, request)| !request.is_open())
        });
        let mut closed: Vec<_> = closed.collect();
        closed.sort_by_key(|(entry, request)| Reverse((request.asked_ms, entry.number, request.number)));
        closed.truncate(CLOSED_REQUESTS_SHOWN);
        let open = ledger.open_person_requests().into_iter();
        RequestsView { requests: open.chain(closed).map(view).collect() }
    }

    /// Returns this node's copy of the ledger, if it is up to date as far as the node knows.
    fn own_copy(&self) -> Option<&Replica<Ledger>> {
        self.views.replica.as_ref().filter(|_| self.status.has_ledger)
    }

    /// Reads a copy of the ledger, with its revision and age.
    fn read_copy<T>(&self, replica: &Replica<Ledger>, look: impl FnOnce(&Ledger) -> T) -> (LedgerCopy, T) {
        // Before the state is read: it may become newer in between, but not older.
        let age_ms = if self.linearizable { Some(0) } else { replica.staleness().map(millis) };
        replica.read_with_position(|Epoch { index: revision, .. }, ledger| {
            (LedgerCopy { revision, age_ms, linearizable: self.linearizable }, look(ledger))
        })
    }

    /// Reads the ledger, if this node has a copy.
    fn ledger<T>(&self, look: impl FnOnce(&Ledger) -> T) -> Option<T> {
        Some(self.own_copy()?.read(look))
    }

    /// Returns a copy of the records of all nodes.
    fn base(&self) -> &KnowledgeBase {
        self.copies.base.get_or_init(|| self.views.knowledge.read(KnowledgeBase::clone))
    }

    /// Returns a copy of the statuses of all nodes.
    fn statuses(&self) -> &BTreeMap<NodeId, MemberStatus> {
        self.copies.statuses.get_or_init(|| self.views.knowledge.statuses())
    }

    /// Returns the part of the ledger about each robot, if this node has a copy of the ledger.
    fn robots_in_ledger(&self) -> Option<&(LedgerCopy, RobotsInLedger)> {
        let read = || Some(self.read_copy(self.own_copy()?, RobotsInLedger::of));
        self.copies.robots.get_or_init(read).as_ref()
    }

    /// Returns the JSON of a view with its provenance. The fields of `view/world` and `view/map`
    /// take precedence over fields of the provenance.
    pub(super) fn with_provenance<T: Serialize>(&self, content: T) -> Value {
        with(&self.provenance(), content)
    }

    fn provenance(&self) -> Provenance {
        self.status.provenance(&self.views.node, self.views.clock.wall_ms())
    }

    fn coordinator(&self) -> CoordinatorView {
        let status = self.status.clone();
        CoordinatorView {
            node: status.coordinator,
            since_ms: status.since_ms,
            quorum_age_ms: status.quorum_age_ms,
            voters: status.voters,
            voters_lost: status.voters_lost,
            learners: status.learners,
            cluster: self.views.membership.cluster(),
            foreign: self.foreign(),
            autopilot: status.autopilot,
        }
    }

    fn foreign(&self) -> BTreeMap<ClusterId, NodeId> {
        crate::coordinator::foreign_clusters(&self.views.knowledge, self.views.membership.cluster())
    }

    fn fleet(&self) -> FleetView {
        FleetView {
            cluster: self.views.membership.cluster(),
            nodes: self.base().iter().map(|(node, stored)| self.node(node, stored)).collect(),
            ensembles: self.ensembles(),
            closures: self.ledger(|ledger| ledger.closures().collect()),
            speed_limits: self.ledger(|ledger| ledger.speed_limits().collect()),
            alarms: self.ledger(|ledger| ledger.alarms().cloned().collect()),
            charging: self.views.charging.clone(),
            chargers: self.chargers(),
            declared: self.views.declared.clone(),
        }
    }

    /// Returns the chargers that are leased, or for which robots wait.
    fn chargers(&self) -> Vec<ChargerView> {
        let leases = self.ledger(Ledger::charger_leases).unwrap_or_default();
        let mut waiting = ChargerQueue::waiting(&charger_users(&self.views.knowledge, &self.views.node));
        let chargers: BTreeSet<PlaceId> = leases.keys().chain(waiting.keys()).cloned().collect();
        let lease_view = |ResourceLease { robot, epoch, since_ms }: &ResourceLease| ChargerLeaseView {
            robot: robot.clone(),
            epoch: epoch.to_string(),
            since_ms: *since_ms,
        };
        let view = |charger: PlaceId| {
            let (lease, waiting) = (leases.get(&charger).map(lease_view), waiting.remove(&charger).unwrap_or_default());
            ChargerView { charger, lease, waiting }
        };
        chargers.into_iter().map(view).collect()
    }

    fn ensembles(&self) -> Vec<EnsembleView> {
        self.views.ensembles.iter().map(|ensemble| self.ensemble(ensemble)).collect()
    }

    /// Returns an ensemble: its requirements and its members.
    fn ensemble(&self, ensemble: &Ensemble) -> EnsembleView {
        let (spec, base, statuses) = (ensemble.spec(), self.base(), self.statuses());
        // Evaluated like the coordinator does, from the records received here.
        let coordinator = self.status.coordinator.as_ref().unwrap_or(&self.views.node);
        let mut not_members = BTreeMap::new();
        let mut members = vec![];
        let judge = |(node, _): (&NodeId, &KnownRecord)| {
            let verdict = ensemble.membership_of(node, coordinator, base, self.now);
            // A node that is down gets no call for bids, however recent its last record is.
            let down = verdict.member && !statuses.get(node).is_some_and(MemberStatus::is_alive);
            let membership = match down {
                true => Membership { member: false, reason: "judged down".to_owned(), ..verdict },
                false => verdict,
            };
            if membership.member {
                members.push(node.clone());
            } else {
                not_members.insert(node.clone(), membership.reason.clone());
            }
            EnsembleMember { node: node.clone(), membership }
        };
        let nodes = base.iter().map(judge).collect();
        EnsembleView {
            name: spec.name.clone(),
            membership: spec.membership.clone(),
            skills: spec.skills.clone(),
            stale_after_ms: spec.stale_after_ms,
            exchange: spec.exchange.clone(),
            nodes,
            members,
            not_members,
        }
    }

    /// Returns the JSON of a robot's node. The age and the version are those of its record.
    fn robot(&self, node: &NodeId, stored: &KnownRecord) -> Value {
        let Provenance { coordinator, term, at_ms, .. } = self.provenance();
        let DriverValues { readings, feedback } = self.driver_values(node);
        let ledger = self.robots_in_ledger().map(|(copy, _)| copy.clone());
        json(RobotView { node: self.node(node, stored), coordinator, term, at_ms, readings, feedback, ledger })
    }

    /// Returns the values of the driver of a node's robot, if they are known here.
    fn driver_values(&self, node: &NodeId) -> DriverValues {
        if *node == self.views.node {
            let driver = self.views.driver.get();
            let (readings, feedback) = (driver.and_then(RobotDriver::readings), driver.and_then(RobotDriver::feedback));
            return DriverValues { readings, feedback };
        }
        self.received_values.get(node).cloned().unwrap_or_default()
    }

    /// Returns a single node.
    fn node(&self, node: &NodeId, stored: &KnownRecord) -> NodeView {
        let (record, status, robot_id) = (&stored.record, self.statuses().get(node), RobotId::from(node.clone()));
        let alive = status.is_some_and(MemberStatus::is_alive);
        let in_ledger = self.robots_in_ledger().map(|(_, robots)| robots);
        let by_ledger = in_ledger.map(|robots| robots.held.get(&robot_id).cloned());
        let mut robot = stored.knowledge().robot.clone();
        if let (false, Some(worker)) = (alive, &mut robot) {
            worker.availability =
                availability_when_down(&worker.availability, by_ledger.as_ref().and_then(Option::as_ref));
            worker.charging = None;
        }
        // Without the ledger, use the robot's own record.
        let holds = by_ledger.unwrap_or_else(|| match robot.as_ref().map(|worker| &worker.availability) {
            Some(Availability::Holding { mission, role, .. }) => {
                Some(HeldRole { mission: mission.clone(), role: role.clone(), epoch: None })
            }
            Some(Availability::Free | Availability::OutOfService { .. }) | None => None,
        });
        NodeView {
            node: node.clone(),
            contact: Contact {
                seen_by: self.views.node.clone(),
                alive,
                status: node_status(status),
                age_ms: millis(stored.age(self.now)),
            },
            record: PublishedRecord {
                incarnation: record.stamp.incarnation,
                version: record.stamp.version,
                cluster: record.knowledge.cluster,
                leaving: record.knowledge.leaving,
                robot,
            },
            traits: NodeTraits {
                may_vote: record.knowledge.may_vote,
                stationary: record.knowledge.stationary,
                mains_powered: record.knowledge.mains_powered,
            },
            holds,
            orders: in_ledger.and_then(|robots| robots.orders.get(&robot_id)).cloned().unwrap_or_default(),
            promised: in_ledger.and_then(|robots| robots.promised.get(&robot_id)).cloned().unwrap_or_default(),
        }
    }

    /// Returns the JSON of the fleet's map, if this node has a map.
    fn map(&self) -> Value {
        match self.views.map.as_deref() {
            Some(map) => self.with_provenance(map),
            None => self.with_provenance(ErrorReply::rejected(format!("{} has no map", self.views.node))),
        }
    }

    fn health(&self) -> HealthView {
        health(&self.health_inputs())
    }

    fn health_inputs(&self) -> HealthInputs {
        let statuses = self.statuses();
        let alive = |node: &NodeId| *node == self.views.node || statuses.get(node).is_some_and(MemberStatus::is_alive);
        let mut inputs = HealthInputs {
            coordinator: self.status.coordinator.clone().map(|node| (node, self.status.term)),
            coordinator_age_ms: self.status.age_ms,
            foreign: self.foreign().into_iter().collect(),
            alive: statuses.values().filter(|status| status.is_alive()).count(),
            knows_missions: self.status.has_ledger,
            ..HealthInputs::default()
        };
        let lost = |node: &NodeId| self.status.voters_lost.contains(node);
        inputs.voters = self.status.voters.iter().map(|node| (node.clone(), alive(node) && !lost(node))).collect();
        for (node, stored) in self.base().iter() {
            let status = statuses.get(node).copied().unwrap_or(MemberStatus::Unknown);
            let age_ms = millis(stored.age(self.now));
            if matches!(status, MemberStatus::Down { .. } | MemberStatus::Suspect { .. })
                && !stored.record.knowledge.leaving
            {
                inputs.unreachable.push((node.clone(), status.as_str(), age_ms));
            }
            for DomainReference { name, hash } in stored.record.knowledge.domains.iter().filter(|_| alive(node)) {
                let contents = inputs.domains.entry(name.clone()).or_default();
                contents.entry(*hash).or_default().insert(node.clone());
            }
            match stored.record.knowledge.robot.as_ref().map(|worker| &worker.availability) {
                Some(Availability::OutOfService { problem }) => {
                    inputs.out_of_service.push((node.clone(), problem.clone()));
                }
                Some(Availability::Holding { mission, role, suspended: true }) if alive(node) => {
                    inputs.suspended.push((node.clone(), format!("{role} of {mission}")));
                }
                Some(Availability::Holding { .. } | Availability::Free) | None => {}
            }
        }
        let reports = device_reports(&self.views.knowledge, &self.views.devices, &self.views.node);
        for device in self.views.devices.iter() {
            let report = reports.get(&device.name);
            let problem = report.map_or_else(|| Some("no node reports it".to_owned()), |report| report.problem(device));
            inputs.devices.extend(problem.map(|problem| (device.name.clone(), problem)));
        }
        self.ledger(|ledger| {
            for (device, ResourceLease { robot, .. }) in ledger.device_leases() {
                if !alive(&NodeId::from(robot.clone())) {
                    let problem = format!(
                        "it waits for {robot}, which is lost and may be inside; once it is not, use \
                         `consort maintenance {robot}`"
                    );
                    inputs.devices.retain(|(other, _)| *other != device);
                    inputs.devices.push((device, problem));
                }
            }
            inputs.blocking = Blocking::of(ledger);
            inputs.alarms = ledger.alarms().map(|alarm| (alarm.alarm.clone(), alarm.text())).collect();
            for (robot, orders) in ledger.robot_orders().filter(|(robot, _)| ledger.held_by(robot).is_some()) {
                inputs.held.extend(orders.hold.as_ref().map(|hold| (robot.clone(), hold.hold_text())));
            }
            for entry in ledger.missions() {
                match (&entry.state, &entry.auction) {
                    (MissionState::NeedsIntervention { cause, .. }, _) => {
                        inputs.needs_intervention.push((entry.id.to_string(), cause.clone()));
                    }
                    (MissionState::Pending, Some(auction)) => {
                        let reason = auction.failure.clone().map(|reason| (entry.id.to_string(), reason));
                        inputs.pending.extend(reason);
                    }
                    _ => {}
                }
            }
        });
        inputs
    }
}

impl RobotsInLedger {
    fn of(ledger: &Ledger) -> RobotsInLedger {
        let mut held = BTreeMap::new();
        for entry in ledger.missions().filter(|entry| !entry.state.is_final()) {
            for (role, _, holder) in entry.held_roles() {
                let (mission, epoch) = (entry.id.clone(), Some(holder.epoch.to_string()));
                held.entry(holder.robot.clone()).or_insert(HeldRole { mission, role: role.clone(), epoch });
            }
        }
        let mut promised: BTreeMap<RobotId, Vec<PromisedRoleView>> = BTreeMap::new();
        for (entry, role, promise) in ledger.promises_in_order() {
            promised.entry(promise.robot.clone()).or_default().push(PromisedRoleView {
                mission: entry.id.clone(),
                role: role.clone(),
                planned_at_ms: promise.planned_ms,
                // Zero if the bid was stored without its parts.
                time_s: Some(promise.time).filter(|time| *time > Seconds::ZERO),
            });
        }
        let orders = ledger.robot_orders().map(|(robot, orders)| (robot.clone(), orders.clone())).collect();
        RobotsInLedger { held, orders, promised }
    }
}

fn with<T: Serialize>(provenance: &Provenance, content: T) -> Value {
    json(WithProvenance { provenance: provenance.clone(), content })
}

pub(super) fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

/// Returns the JSON of a view.
pub(super) fn json(view: impl Serialize) -> Value {
    serde_json::to_value(view).expect("a view serializes to JSON")
}

fn node_status(status: Option<&MemberStatus>) -> NodeStatus {
    match status {
        None | Some(MemberStatus::Unknown) => NodeStatus::Unknown,
        Some(MemberStatus::Alive { .. }) => NodeStatus::Alive,
        Some(MemberStatus::Suspect { .. }) => NodeStatus::Suspect,
        Some(MemberStatus::Down { .. }) => NodeStatus::Down,
    }
}

/// Returns the availability of a robot that is down. Its last record may be outdated: the role it
/// holds is taken from the ledger, and without a ledger no role is known.
fn availability_when_down(published: &Availability, held: Option<&HeldRole>) -> Availability {
    match (published, held) {
        (Availability::OutOfService { .. }, _) => published.clone(),
        (_, Some(HeldRole { mission, role, .. })) => {
            let suspended = matches!(published, Availability::Holding { suspended: true, .. });
            Availability::Holding { mission: mission.clone(), role: role.clone(), suspended }
        }
        (_, None) => Availability::Free,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coordinator::test_ledger::Log;

    #[test]
    fn a_single_pass_finds_the_roles_that_the_ledger_states_for_each_robot() {
        let mut log = Log::default();
        let first = log.add_mission("cart-1");
        log.add_mission("cart-2");
        log.add_mission("cart-3");
        log.end_cart(&first);
        let robots = RobotsInLedger::of(&log.0);
        for robot in ["lab-arm", "cart-1", "cart-2", "cart-3"].map(|name| RobotId::new(name).unwrap()) {
            let stated = log.0.held_by(&robot).map(|(entry, role, epoch)| HeldRole {
                mission: entry.id.clone(),
                role: role.clone(),
                epoch: Some(epoch.to_string()),
            });
            assert_eq!(robots.held.get(&robot), stated.as_ref(), "{robot}");
        }
        assert!(robots.held.contains_key(&RobotId::new("cart-2").unwrap()), "{:?}", robots.held);
        let promised: usize = robots.promised.values().map(Vec::len).sum();
        assert_eq!(promised, log.0.promises_in_order().len());
        assert!(promised > 0);
    }
}
