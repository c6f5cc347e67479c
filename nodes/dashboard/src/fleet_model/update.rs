//! Applies views, beacons, links and telemetry to the model.

use super::state::{
    CoordinatorModel, EnsembleModel, HealthFinding, NodeModel, PersonModel, ReachabilityState, RobotModel, Takeover,
};
use super::{FleetModel, FloorPlan, NO_COORDINATOR_AFTER_MS, bounds};
use crate::loaded_map::LoadedMap;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use consort_protocol::message::Beacon;
use consort_protocol::pose::Pose;
use consort_skills::actions::Telemetry;
use serde_json::Value;
use std::collections::BTreeMap;

impl FleetModel {
    /// Applies a view, as returned by any node. Missing or unexpected parts change nothing.
    pub fn apply_view(&mut self, key: &Key, view: &Value, now_ms: u64) {
        match key {
            Key::ViewFleet => self.take_fleet(view, now_ms),
            Key::ViewCoordinator => self.take_coordinator(view, now_ms),
            Key::ViewMissions => self.apply_missions(view, now_ms),
            Key::ViewMission(id) => self.apply_mission(id.as_str(), view, now_ms),
            Key::ViewAuctions => self.apply_auctions(view),
            Key::ViewWorld => self.take_world(view),
            Key::ViewHealth => self.take_health(view),
            Key::ViewMap => self.take_map(view),
            _ => return,
        }
        // A mission's time comes with the list of all missions; a map does not age.
        if !matches!(key, Key::ViewMission(_) | Key::ViewMap) {
            let published_ms = now_ms.saturating_sub(number(view, "age_ms").unwrap_or(0));
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
        shown.telemetry_ms = Some(now_ms);
        // Between two places the rest of the route does not change.
        if passed {
            self.update_route(robot);
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

    fn take_coordinator(&mut self, view: &Value, now_ms: u64) {
        let (Some(node), Some(term)) = (text(view, "node").and_then(|node| node.parse().ok()), number(view, "term"))
        else {
            return;
        };
        let published_ms = now_ms.saturating_sub(number(view, "age_ms").unwrap_or(0));
        // Beacons come more often than views, and show if a view is outdated.
        if self.coordinator.as_ref().is_some_and(|known| known.term > term) {
            return;
        }
        let since_ms = published_ms.saturating_sub(number(view, "since_ms").unwrap_or(0));
        self.update_coordinator(&node, term, since_ms, published_ms);
        let quorum = number(view, "quorum_age_ms").map(|age| published_ms.saturating_sub(age));
        if let Some(shown) = &mut self.coordinator {
            shown.quorum_ms = quorum.or(shown.quorum_ms);
            shown.voters = texts(&view["voters"]);
            shown.observers = texts(&view["observers"]);
            shown.voters_lost = texts(&view["voters_lost"]);
        }
    }

    fn take_fleet(&mut self, view: &Value, now_ms: u64) {
        let published_ms = now_ms.saturating_sub(number(view, "age_ms").unwrap_or(0));
        let mut present = vec![];
        for entry in list(&view["nodes"]).take(bounds::NODES) {
            let Some(name) = text(entry, "node") else { continue };
            let last_contact_ms = published_ms.saturating_sub(number(entry, "age_ms").unwrap_or(0));
            let worker = entry.get("robot").filter(|worker| worker.is_object());
            let node = NodeModel {
                alive: flag(entry, "alive"),
                status: text(entry, "status").unwrap_or("unknown").to_owned(),
                last_contact_ms,
                may_vote: flag(entry, "may_vote"),
                stationary: flag(entry, "stationary"),
                mains_powered: flag(entry, "mains_powered"),
                leaving: flag(entry, "leaving"),
                robot: worker.is_some(),
            };
            if let Some(worker) = worker {
                self.take_worker(name, worker, &node);
            }
            present.push(name.to_owned());
            self.nodes.insert(name.to_owned(), node);
        }
        if !present.is_empty() {
            self.nodes.retain(|name, _| present.contains(name));
            self.robots.retain(|name, _| present.contains(name));
        }
        let mut ensembles = BTreeMap::new();
        for ensemble in list(&view["ensembles"]) {
            let Some(name) = text(ensemble, "name") else { continue };
            let mut shown = EnsembleModel {
                membership: texts(&ensemble["membership"]),
                skills: texts(&ensemble["skills"]),
                stale_after_ms: number(ensemble, "stale_after_ms"),
                ..EnsembleModel::default()
            };
            for node in list(&ensemble["nodes"]) {
                let Some(name) = text(node, "node") else { continue };
                match flag(node, "member") {
                    true => shown.members.push(name.to_owned()),
                    false => {
                        let reason = text(node, "reason").unwrap_or("").to_owned();
                        shown.non_members.insert(name.to_owned(), reason);
                    }
                }
            }
            ensembles.insert(name.to_owned(), shown);
        }
        self.ensembles.replace(ensembles);
    }

    fn take_worker(&mut self, name: &str, worker: &Value, node: &NodeModel) {
        let shown = self.robots.get_or_insert_with(name.to_owned(), RobotModel::default);
        shown.alive = node.alive;
        shown.last_contact_ms = node.last_contact_ms;
        shown.skills = texts(&worker["skills"]);
        shown.speed = worker["speed"].as_f64();
        shown.useful_charge = worker["useful_charge"].as_f64().unwrap_or(0.0);
        // The driver's telemetry is more frequent than the node's own record.
        if shown.telemetry_ms.is_none_or(|body| body < node.last_contact_ms) {
            if let Ok(pose) = serde_json::from_value::<Pose>(worker["pose"].clone()) {
                (shown.x, shown.y, shown.yaw) = (round(pose.x), round(pose.y), round(pose.yaw));
            }
            text(worker, "place").unwrap_or("").clone_into(&mut shown.place);
            shown.battery = round(worker["battery"].as_f64().unwrap_or(0.0));
            shown.can_move = true;
        }
        let availability = &worker["availability"];
        let (word, holding, problem) = match (availability.get("holding"), availability.get("out_of_service")) {
            (Some(holding), _) if flag(holding, "suspended") => ("suspended", Some(holding), None),
            (Some(holding), _) => ("holding", Some(holding), None),
            (None, Some(out)) => ("out_of_service", None, text(out, "problem").map(str::to_owned)),
            (None, None) => ("free", None, None),
        };
        let of = |key: &str| holding.and_then(|holding| text(holding, key)).map(str::to_owned);
        word.clone_into(&mut shown.availability);
        shown.problem = problem;
        let before = std::mem::replace(&mut shown.mission, of("mission"));
        shown.role = of("role");
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

    fn take_world(&mut self, view: &Value) {
        let mut people = BTreeMap::new();
        for person in list(&view["people"]).take(bounds::NODES) {
            let (Some(name), Some(place)) = (text(person, "name"), text(person, "place")) else { continue };
            let pose = self.plan.pose_of(place);
            let shown = PersonModel {
                role: text(person, "role").unwrap_or("").to_owned(),
                place: place.to_owned(),
                away: flag(person, "away"),
                samples: texts(&person["samples"]),
                x: pose.map(|pose| pose.x),
                y: pose.map(|pose| pose.y),
            };
            people.insert(name.to_owned(), shown);
        }
        self.people.replace(people);
        let doors = list(&view["doors"]).filter_map(|door| Some((text(door, "name")?, text(door, "state")?)));
        self.doors
            .replace(doors.take(bounds::NODES).map(|(name, state)| (name.to_owned(), state.to_owned())).collect());
    }

    fn take_health(&mut self, view: &Value) {
        let own = |finding: &Value, key: &str| text(finding, key).unwrap_or("").to_owned();
        let shown = |finding: &Value| HealthFinding {
            level: own(finding, "level"),
            about: own(finding, "about"),
            name: text(finding, "name").map(str::to_owned),
            // Recordings of earlier releases use the name `says`.
            text: text(finding, "text").or_else(|| text(finding, "says")).unwrap_or("").to_owned(),
        };
        self.health = list(&view["findings"]).take(bounds::FINDINGS).map(shown).collect();
    }

    /// Updates the destination of a robot, and its route.
    pub(super) fn update_route(&mut self, robot: &str) {
        let Some(shown) = self.robots.get(robot) else { return };
        let destination = shown.mission.as_ref().zip(shown.task.as_ref()).and_then(|(mission, task)| {
            let tasks = self.missions.get(mission)?.tasks.as_ref()?;
            destination(tasks, task).map(str::to_owned)
        });
        let pose = Pose::new(shown.x, shown.y, shown.yaw);
        let route = destination.as_ref().map_or(vec![], |to| self.plan.route(&shown.place, pose, to));
        if (&shown.destination, &shown.route) != (&destination, &route)
            && let Some(shown) = self.robots.get_mut(&robot.to_owned())
        {
            (shown.destination, shown.route) = (destination, route);
        }
    }
}

/// Returns the destination of a navigation task in a mission's tree.
fn destination<'a>(tasks: &'a Value, task: &str) -> Option<&'a str> {
    let node = list(tasks).find(|node| text(node, "id") == Some(task))?;
    let spec = node.pointer("/body/Elementary")?;
    if text(spec, "type") != Some("navigation") {
        return None;
    }
    spec.pointer("/parameters/to").and_then(Value::as_str)
}

/// Rounds to a tenth of a millimetre, or of a thousandth: finer digits are noise, and cost bytes.
fn round(number: f64) -> f64 {
    (number * 1e4).round() / 1e4
}

pub(super) fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

pub(super) fn text<'a>(value: &'a Value, key: &str) -> Option<&'a str> {
    value.get(key).and_then(Value::as_str)
}

pub(super) fn texts(value: &Value) -> Vec<String> {
    list(value).filter_map(Value::as_str).map(str::to_owned).collect()
}

pub(super) fn number(value: &Value, key: &str) -> Option<u64> {
    value.get(key).and_then(Value::as_u64)
}

pub(super) fn flag(value: &Value, key: &str) -> bool {
    value.get(key).and_then(Value::as_bool).unwrap_or(false)
}
