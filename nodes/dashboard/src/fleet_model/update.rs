//! Applies views, beacons, links and telemetry to the model.

use super::charge_trend::ChargeTrend;
use super::state::{
    CoordinatorModel, EnsembleModel, NextRole, NodeModel, PersonModel, ReachabilityState, RobotModel, Takeover,
};
use super::{FleetModel, FloorPlan, NO_COORDINATOR_AFTER_MS, bounds};
use crate::loaded_map::LoadedMap;
use consort_protocol::ids::{NodeId, RobotId};
use consort_protocol::keys::Key;
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::ledger::RobotOrders;
use consort_protocol::message::Beacon;
use consort_protocol::mission::{TaskBody, TaskNode};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::view::{
    AuctionsView, CoordinatorView, DeclarationsView, EnsembleView, FleetView, HealthView, MissionView, MissionsView,
    NodeView, Provenance, SchedulesView, WithProvenance,
};
use consort_skills::actions::Telemetry;
use consort_world::world::WorldReport;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use tracing::debug;

/// Number of consecutive views with other declarations than the known ones after which the latest count. Raised: a
/// changed fleet file is shown later, and files of two nodes alternate less often. A guess: some seconds.
const OTHER_DECLARATIONS: u32 = 5;

impl FleetModel {
    /// Applies a view, as returned by any node. A view that cannot be read changes nothing.
    pub fn apply_view(&mut self, key: &Key, view: &Value, now_ms: u64) {
        let age_ms = Provenance::deserialize(view).ok().and_then(|provenance| provenance.age_ms);
        let published_ms = now_ms.saturating_sub(age_ms.unwrap_or(0));
        let applied = match key {
            Key::ViewFleet => FleetView::deserialize(view).map(|view| self.take_fleet(view, published_ms)),
            Key::ViewCoordinator => {
                WithProvenance::deserialize(view).map(|view| self.take_coordinator(view, published_ms))
            }
            Key::ViewMissions => MissionsView::deserialize(view).map(|view| self.apply_missions(view, now_ms)),
            Key::ViewMission(_) => MissionView::deserialize(view).map(|view| self.apply_mission(view, now_ms)),
            Key::ViewSchedules => SchedulesView::deserialize(view).map(|view| self.take_schedules(view)),
            Key::ViewAuctions => AuctionsView::deserialize(view).map(|view| self.apply_auctions(&view)),
            Key::ViewWorld => WorldReport::deserialize(view).map(|view| self.take_world(view)),
            Key::ViewHealth => HealthView::deserialize(view).map(|view| self.take_health(view)),
            Key::ViewMap => {
                self.take_map(view);
                return;
            }
            _ => return,
        };
        if let Err(problem) = applied {
            debug!(%key, %problem, "a view cannot be read");
            return;
        }
        // A mission's time comes with the list of all missions.
        if !matches!(key, Key::ViewMission(_)) {
            self.views.insert(key.to_string(), published_ms);
        }
    }

    /// Applies a coordinator's beacon.
    pub fn apply_beacon(&mut self, beacon: &Beacon, now_ms: u64) {
        if self.coordinator.as_ref().is_some_and(|known| known.term > beacon.term) && !self.has_no_coordinator(now_ms) {
            return;
        }
        let since_ms = now_ms.saturating_sub(beacon.since_ms);
        self.update_coordinator(&beacon.node, beacon.term, since_ms, now_ms);
        if let Some(shown) = &mut self.coordinator {
            shown.voters = beacon.voters.iter().map(NodeId::to_string).collect();
        }
        self.reachability.last_contact_ms = Some(now_ms);
    }

    /// Applies the number of links to other nodes, and updates time-dependent values. To be called
    /// several times per second.
    pub fn apply_links(&mut self, links: usize, now_ms: u64) {
        self.utilization.advance(&self.robots, now_ms);
        self.update_planned_times();
        let state = match (self.has_no_coordinator(now_ms), links) {
            (false, _) => ReachabilityState::Connected,
            (true, 0) => ReachabilityState::Isolated,
            (true, _) => ReachabilityState::NoCoordinator,
        };
        self.reachability.links = links;
        if state != self.reachability.state {
            self.reachability.state = state;
            self.reachability.since_ms = now_ms;
        }
    }

    /// Applies the telemetry of a robot.
    pub fn apply_telemetry(&mut self, robot: &str, telemetry: &Telemetry, now_ms: u64) {
        if !self.robots.contains_key(robot) && self.robots.len() >= bounds::NODES {
            return;
        }
        self.world_rate.observe(robot, telemetry.time.as_secs(), now_ms);
        let shown = self.robots.get_or_insert_with(robot.to_owned(), RobotModel::default);
        (shown.x, shown.y, shown.yaw) = (round(telemetry.pose.x), round(telemetry.pose.y), round(telemetry.pose.yaw));
        let passed = shown.place != telemetry.place.as_str();
        shown.place = telemetry.place.to_string();
        shown.battery = round(telemetry.battery.get());
        shown.can_move = telemetry.able;
        shown.readings.clone_from(&telemetry.readings);
        shown.telemetry_ms = Some(now_ms);
        if shown.charge_trend.observe(shown.battery, now_ms) {
            shown.forecast = shown.charge_trend.forecast(shown.useful_charge, self.charging.as_ref());
        }
        // Between two places the rest of the route does not change.
        if passed {
            self.update_route(robot);
        }
    }

    /// Applies the feedback of a robot's goal in progress. Without such a goal it is empty.
    pub fn apply_feedback(&mut self, robot: &str, feedback: &BTreeMap<String, Scalar>) {
        if let Some(shown) = self.robots.get_mut(&robot.to_owned()) {
            shown.feedback.clone_from(feedback);
        }
    }

    fn has_no_coordinator(&self, now_ms: u64) -> bool {
        self.reachability.last_contact_ms.is_none_or(|contact| now_ms.saturating_sub(contact) > NO_COORDINATOR_AFTER_MS)
    }

    /// Updates the coordinator; a change is recorded as a takeover.
    pub(super) fn update_coordinator(&mut self, node: &NodeId, term: u64, since_ms: u64, now_ms: u64) {
        let known = self.coordinator.as_ref().filter(|known| known.node == node.as_str() && known.term == term);
        if known.is_some() {
            return;
        }
        let former = self.coordinator.take();
        let gap_ms = self
            .reachability
            .last_contact_ms
            .filter(|_| former.is_some())
            .map(|contact| now_ms.saturating_sub(contact));
        let from = former.map(|former| former.node).filter(|former| former != node.as_str());
        let shown = CoordinatorModel { node: node.to_string(), term, since_ms, ..CoordinatorModel::default() };
        self.coordinator = Some(shown);
        if !self.takeovers.iter().any(|known| known.term == term && known.node == node.as_str()) {
            self.takeovers.push(Takeover { at_ms: since_ms, node: node.to_string(), term, from, gap_ms });
            if self.takeovers.len() > bounds::TAKEOVERS {
                self.takeovers.remove(0);
            }
        }
    }

    fn take_coordinator(&mut self, view: WithProvenance<CoordinatorView>, published_ms: u64) {
        let WithProvenance { provenance, content: view } = view;
        let (Some(node), term) = (view.node, provenance.term) else { return };
        // Beacons come more often than views, and show if a view is outdated.
        if self.coordinator.as_ref().is_some_and(|known| known.term > term) {
            return;
        }
        let since_ms = published_ms.saturating_sub(view.since_ms.unwrap_or(0));
        self.update_coordinator(&node, term, since_ms, published_ms);
        let quorum = view.quorum_age_ms.map(|age| published_ms.saturating_sub(age));
        if let Some(shown) = &mut self.coordinator {
            shown.quorum_ms = quorum.or(shown.quorum_ms);
            shown.voters = names(view.voters);
            shown.learners = names(view.learners);
            shown.voters_lost = names(view.voters_lost);
        }
    }

    fn take_fleet(&mut self, view: FleetView, published_ms: u64) {
        // A node without a ledger, such as a node that restarts, does not know what it states. That stays as it was.
        let has_ledger = view.closures.is_some();
        self.knows_orders |= has_ledger;
        let (mut present, mut records) = (vec![], BTreeMap::new());
        for NodeView { node: name, contact, record, traits, orders, promised, .. } in
            view.nodes.into_iter().take(bounds::NODES)
        {
            let node = NodeModel {
                alive: contact.alive,
                status: contact.status,
                last_contact_ms: published_ms.saturating_sub(contact.age_ms),
                may_vote: traits.may_vote,
                stationary: traits.stationary,
                mains_powered: traits.mains_powered,
                leaving: record.leaving,
                robot: record.robot.is_some(),
            };
            if let Some(robot) = record.robot {
                records.insert(RobotId::from(name.clone()), robot.clone());
                let by_ledger = has_ledger.then(|| (orders, self.next_roles(promised)));
                self.take_robot(name.as_str(), robot, by_ledger, &node);
            }
            present.push(name.to_string());
            self.nodes.insert(name.to_string(), node);
        }
        if !present.is_empty() {
            self.nodes.retain(|name, _| present.contains(name));
            self.robots.retain(|name, _| present.contains(name));
            self.records = records;
        }
        self.ensembles.replace(view.ensembles.into_iter().map(ensemble_model).collect());
        self.charging = view.charging;
        if let Some(charging) = &mut self.charging {
            charging.chargers.truncate(bounds::NODES);
        }
        if let Some(closures) = view.closures {
            let closures = closures.into_iter().take(bounds::CLOSURES);
            self.closures.replace(closures.map(|closure| (closure.part.to_string(), closure)).collect());
        }
        if let Some(limits) = view.speed_limits {
            let limits = limits.into_iter().take(bounds::CLOSURES);
            self.speed_limits.replace(limits.map(|limit| (limit.part.to_string(), limit)).collect());
        }
        if let Some(alarms) = view.alarms {
            let alarms = alarms.into_iter().take(bounds::ALARMS);
            self.alarms.replace(alarms.map(|alarm| (alarm.alarm.to_string(), alarm)).collect());
        }
        self.take_declarations(view.declared);
    }

    /// Adopts what a fleet file declares. While nodes with different files reply in turn, the first declarations stay.
    fn take_declarations(&mut self, DeclarationsView { alarms, zones, hash }: DeclarationsView) {
        let is_other = self.declared_hash.as_ref().is_some_and(|known| *known != hash);
        self.other_declarations = if is_other { self.other_declarations + 1 } else { 0 };
        if is_other && self.other_declarations < OTHER_DECLARATIONS {
            return;
        }
        (self.declared_hash, self.other_declarations) = (Some(hash), 0);
        let declared = alarms.into_iter().take(bounds::ALARMS);
        self.declared_alarms.replace(declared.map(|(name, plan)| (name.to_string(), plan)).collect());
        let zones = zones.into_iter().take(bounds::ZONES);
        self.zones.replace(zones.collect());
    }

    /// Applies the record of a robot, and, if the ledger is known, the orders of people to it and the roles that it gets
    /// later.
    fn take_robot(
        &mut self,
        name: &str,
        robot: RobotKnowledge,
        by_ledger: Option<(RobotOrders, Vec<NextRole>)>,
        node: &NodeModel,
    ) {
        let shown = self.robots.get_or_insert_with(name.to_owned(), RobotModel::default);
        shown.alive = node.alive;
        shown.last_contact_ms = node.last_contact_ms;
        let is_charging = robot.is_charging();
        shown.charging = robot.charging;
        shown.skills = names(robot.skills);
        shown.speed = robot.speed.map(|speed| speed.get());
        shown.useful_charge = robot.useful_charge.get();
        // The driver's telemetry is more frequent than the node's own record.
        if shown.telemetry_ms.is_none_or(|body| body < node.last_contact_ms) {
            (shown.x, shown.y, shown.yaw) = (round(robot.pose.x), round(robot.pose.y), round(robot.pose.yaw));
            shown.place = robot.place.to_string();
            shown.battery = round(robot.battery.get());
            shown.can_move = true;
        }
        let (word, held, problem) = match robot.availability {
            Availability::Holding { mission, role, suspended: true } => ("suspended", Some((mission, role)), None),
            Availability::Holding { mission, role, suspended: false } => ("holding", Some((mission, role)), None),
            Availability::OutOfService { problem } => ("out_of_service", None, Some(problem)),
            Availability::Free if is_charging => ("charging", None, None),
            Availability::Free => ("free", None, None),
        };
        if shown.availability != word {
            word.clone_into(&mut shown.availability);
            // The rate of the charge is another.
            (shown.charge_trend, shown.forecast) = (ChargeTrend::default(), None);
        }
        if let Some((orders, next)) = by_ledger {
            (shown.orders, shown.next) = (orders, next);
        }
        shown.problem = problem.or_else(|| shown.orders.problem());
        let (mission, role) = held.map(|(mission, role)| (mission.to_string(), role.to_string())).unzip();
        let before = std::mem::replace(&mut shown.mission, mission);
        shown.role = role;
        if shown.mission.is_none() {
            shown.task = None;
        }
        if shown.mission != before {
            self.update_route(name);
        }
    }

    fn take_map(&mut self, view: &Value) {
        if let Ok(floor) = LoadedMap::from_view(view) {
            self.plan = FloorPlan::new(&floor);
            self.static_fields_changed = true;
        }
    }

    fn take_world(&mut self, view: WorldReport) {
        let people = view.people.into_iter().take(bounds::NODES).map(|person| {
            let pose = self.plan.pose_of(person.place.as_str());
            let shown = PersonModel {
                role: person.role.to_string(),
                place: person.place.to_string(),
                away: person.away,
                samples: names(person.samples),
                x: pose.map(|pose| pose.x),
                y: pose.map(|pose| pose.y),
            };
            (person.name.to_string(), shown)
        });
        let people = people.collect();
        self.people.replace(people);
        let doors = view.doors.into_iter().take(bounds::NODES);
        self.doors.replace(doors.map(|door| (door.name, door.state)).collect());
    }

    fn take_health(&mut self, view: HealthView) {
        self.health = view.findings;
        self.health.truncate(bounds::FINDINGS);
    }

    /// Updates the destination of a robot, and its route.
    pub(super) fn update_route(&mut self, robot: &str) {
        let Some(shown) = self.robots.get(robot) else { return };
        let destination = shown.mission.as_ref().zip(shown.task.as_ref()).and_then(|(mission, task)| {
            let tasks = self.missions.get(mission)?.tasks.as_deref()?;
            destination(tasks, task).map(str::to_owned)
        });
        let pose = Pose::new(shown.x, shown.y, shown.yaw);
        let route = names(destination.as_ref().map_or(vec![], |to| self.plan.route(&shown.place, pose, to)));
        if (&shown.destination, &shown.route) != (&destination, &route)
            && let Some(shown) = self.robots.get_mut(&robot.to_owned())
        {
            (shown.destination, shown.route) = (destination, route);
        }
    }
}

fn ensemble_model(view: EnsembleView) -> (String, EnsembleModel) {
    let mut shown = EnsembleModel {
        membership: view.membership,
        skills: names(view.skills),
        stale_after_ms: Some(view.stale_after_ms),
        ..EnsembleModel::default()
    };
    for node in view.nodes {
        match node.membership.member {
            true => shown.members.push(node.node.to_string()),
            false => {
                shown.non_members.insert(node.node.to_string(), node.membership.reason);
            }
        }
    }
    (view.name.to_string(), shown)
}

/// Returns the destination of a task in a mission's tree: its parameter `to`.
fn destination<'a>(tasks: &'a [TaskNode], task: &str) -> Option<&'a str> {
    match &tasks.iter().find(|node| node.id.as_str() == task)?.body {
        TaskBody::Elementary(spec) => spec.parameters.get("to").map(String::as_str),
        TaskBody::Abstract(_) => None,
    }
}

fn names<T: ToString>(names: impl IntoIterator<Item = T>) -> Vec<String> {
    names.into_iter().map(|name| name.to_string()).collect()
}

/// Rounds to a tenth of a millimetre, or of a thousandth: finer digits are noise, and cost bytes.
fn round(number: f64) -> f64 {
    (number * 1e4).round() / 1e4
}
