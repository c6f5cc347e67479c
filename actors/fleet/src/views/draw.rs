//! Views of a fleet as seen by a single node, in JSON.

use super::Views;
use super::cluster_status::ClusterStatus;
use super::health::{HealthInputs, findings};
use super::mission::{auctions, mission, missions};
use consort_gossip::MemberStatus;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::knowledge::{Availability, KnownRecord};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Ledger, MissionState};
use consort_protocol::units::NodeTime;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Inputs of all views at a single moment.
pub(super) struct ViewContext<'a> {
    pub(super) views: &'a Views,
    pub(super) status: ClusterStatus,
    pub(super) now: NodeTime,
}

impl ViewContext<'_> {
    /// Returns all `wanted` views that this node can compute by itself.
    pub(super) fn draw(&self, wanted: &impl Fn(&Key) -> bool) -> Vec<(Key, Value)> {
        let mut views = vec![];
        for key in [Key::ViewFleet, Key::ViewEnsembles, Key::ViewCoordinator, Key::ViewMap, Key::ViewHealth] {
            if wanted(&key) {
                let value = match &key {
                    Key::ViewFleet => self.fleet(),
                    Key::ViewEnsembles => json!({ "ensembles": [self.ensemble()] }),
                    Key::ViewCoordinator => self.coordinator(),
                    Key::ViewMap => self.map(),
                    _ => self.health(),
                };
                views.push((key, value));
            }
        }
        let statuses = self.views.knowledge.statuses();
        views.extend(self.views.knowledge.read(|base| {
            let robots = base.iter().filter(|(_, stored)| stored.record.knowledge.robot.is_some());
            let keys = robots.map(|(node, stored)| (Key::ViewRobot(RobotId::from(node.clone())), node, stored));
            let wanted = keys.filter(|(key, ..)| wanted(key));
            wanted.map(|(key, node, stored)| (key, self.node(node, stored, &statuses))).collect::<Vec<_>>()
        }));
        views.extend(self.ledger_views(wanted));
        views.into_iter().map(|(key, value)| (key, self.with_provenance(value))).collect()
    }

    /// Returns the views of the ledger, if this node has a copy.
    fn ledger_views(&self, wanted: &impl Fn(&Key) -> bool) -> Vec<(Key, Value)> {
        let drawn = self.ledger(|ledger| {
            let mut views = vec![];
            if wanted(&Key::ViewMissions) {
                views.push((Key::ViewMissions, missions(ledger)));
            }
            if wanted(&Key::ViewAuctions) {
                views.push((Key::ViewAuctions, auctions(ledger)));
            }
            let entries = ledger.missions().map(|entry| (Key::ViewMission(entry.id.clone()), entry));
            views.extend(entries.filter(|(key, _)| wanted(key)).map(|(key, entry)| (key, mission(entry))));
            views
        });
        drawn.unwrap_or_default()
    }

    /// Reads the ledger, if this node has a copy.
    fn ledger<T>(&self, look: impl FnOnce(&Ledger) -> T) -> Option<T> {
        let replica = self.views.replica.as_ref().filter(|_| self.status.has_ledger)?;
        Some(replica.read(look))
    }

    /// Adds the provenance to a view. Fields of the same name in the view are kept.
    pub(super) fn with_provenance(&self, value: Value) -> Value {
        let Value::Object(own) = value else { return value };
        let mark = serde_json::to_value(self.status.provenance(&self.views.node, self.views.clock.wall_ms()))
            .unwrap_or_default();
        let Value::Object(mut marked) = mark else { return Value::Object(own) };
        marked.extend(own);
        Value::Object(marked)
    }

    fn coordinator(&self) -> Value {
        let ClusterStatus { term, since_ms, voters, observers, autopilot, quorum_age_ms, .. } = &self.status;
        let foreign: BTreeMap<String, NodeId> = self.foreign().into_iter().collect();
        json!({
            "voters_lost": self.status.voters_lost,
            "cluster": self.views.membership.cluster(),
            "foreign": foreign,
            "autopilot": autopilot,
            "node": self.status.coordinator,
            "term": term,
            "since_ms": since_ms,
            "quorum_age_ms": quorum_age_ms,
            "voters": voters,
            "observers": observers,
        })
    }

    fn foreign(&self) -> Vec<(String, NodeId)> {
        let own = self.views.membership.cluster();
        let foreign = crate::coordinator::foreign_clusters(&self.views.knowledge, own);
        foreign.into_iter().map(|(cluster, node)| (cluster.to_string(), node)).collect()
    }

    fn fleet(&self) -> Value {
        let statuses = self.views.knowledge.statuses();
        let nodes: Vec<Value> = self
            .views
            .knowledge
            .read(|base| base.iter().map(|(node, stored)| self.node(node, stored, &statuses)).collect());
        json!({ "cluster": self.views.membership.cluster(), "nodes": nodes, "ensembles": [self.ensemble()] })
    }

    /// Returns the ensemble: its requirements and its members.
    fn ensemble(&self) -> Value {
        let statuses = self.views.knowledge.statuses();
        let spec = self.views.ensemble.spec();
        // Evaluated like the coordinator does, from the records received here.
        let coordinator = self.status.coordinator.as_ref().unwrap_or(&self.views.node);
        let mut not_members = Map::new();
        let mut members = vec![];
        let nodes: Vec<Value> = self.views.knowledge.read(|base| {
            let judge = |(node, _): (&NodeId, &KnownRecord)| {
                let verdict = self.views.ensemble.membership_of(node, coordinator, base, self.now);
                // A node that is down gets no call for bids, however recent its last record is.
                let down = verdict.member && !statuses.get(node).is_some_and(MemberStatus::is_alive);
                let reason = if down { "judged down" } else { &verdict.reason };
                let member = verdict.member && !down;
                if member {
                    members.push(node.clone());
                } else {
                    not_members.insert(node.to_string(), json!(reason));
                }
                json!({ "node": node, "member": member, "reason": reason, "age_ms": verdict.age_ms })
            };
            base.iter().map(judge).collect()
        });
        json!({
            "name": spec.name,
            "membership": spec.membership,
            "skills": spec.skills,
            "stale_after_ms": spec.stale_after_ms,
            "nodes": nodes,
            "members": members,
            "not_members": not_members,
        })
    }

    /// Returns a single node. The caller passes the statuses, because the knowledge is locked while
    /// its records are read.
    fn node(&self, node: &NodeId, stored: &KnownRecord, statuses: &BTreeMap<NodeId, MemberStatus>) -> Value {
        let record = &stored.record;
        let alive = statuses.get(node).is_some_and(MemberStatus::is_alive);
        let by_ledger = self.ledger(|ledger| {
            let held = ledger.held_by(&RobotId::from(node.clone()));
            held.map(|(entry, role, epoch)| (entry.id.clone(), role.clone(), Some(epoch)))
        });
        let mut worker = record.knowledge.robot.clone();
        if let (false, Some(worker)) = (alive, &mut worker) {
            worker.availability =
                availability_when_down(&worker.availability, by_ledger.as_ref().and_then(Option::as_ref));
        }
        // Without the ledger, use the robot's own record.
        let held = by_ledger.unwrap_or_else(|| match worker.as_ref().map(|worker| &worker.availability) {
            Some(Availability::Holding { mission, role, .. }) => Some((mission.clone(), role.clone(), None)),
            Some(Availability::Free | Availability::OutOfService { .. }) | None => None,
        });
        let held = held.map(|(mission, role, epoch)| {
            json!({ "mission": mission, "role": role, "epoch": epoch.map(|epoch: Epoch| epoch.to_string()) })
        });
        json!({
            "node": node,
            "alive": alive,
            "status": statuses.get(node).unwrap_or(&MemberStatus::Unknown).as_str(),
            "age_ms": stored.age(self.now).as_millis(),
            "seen_by": self.views.node,
            "incarnation": record.stamp.incarnation,
            "version": record.stamp.version,
            "may_vote": record.knowledge.may_vote,
            "stationary": record.knowledge.stationary,
            "mains_powered": record.knowledge.mains_powered,
            "cluster": record.knowledge.cluster,
            "leaving": record.knowledge.leaving,
            "robot": worker,
            "holds": held,
        })
    }

    /// Returns the fleet's map, if this node has a map.
    fn map(&self) -> Value {
        match self.views.map.as_deref() {
            Some(map) => map.clone(),
            None => json!({ "error": format!("{} has no map", self.views.node) }),
        }
    }

    fn health(&self) -> Value {
        let findings = findings(&self.health_inputs());
        json!({ "level": findings.first().map(|worst| worst.level), "findings": findings })
    }

    fn health_inputs(&self) -> HealthInputs {
        let statuses = self.views.knowledge.statuses();
        let alive = |node: &NodeId| *node == self.views.node || statuses.get(node).is_some_and(MemberStatus::is_alive);
        let mut inputs = HealthInputs {
            coordinator: self.status.coordinator.clone().map(|node| (node, self.status.term)),
            coordinator_age_ms: self.status.age_ms,
            foreign: self.foreign(),
            alive: statuses.values().filter(|status| status.is_alive()).count(),
            knows_missions: self.status.has_ledger,
            ..HealthInputs::default()
        };
        let lost = |node: &NodeId| self.status.voters_lost.contains(node);
        inputs.voters = self.status.voters.iter().map(|node| (node.clone(), alive(node) && !lost(node))).collect();
        self.views.knowledge.read(|base| {
            for (node, stored) in base.iter() {
                let status = statuses.get(node).copied().unwrap_or(MemberStatus::Unknown);
                let age_ms = u64::try_from(stored.age(self.now).as_millis()).unwrap_or(u64::MAX);
                if matches!(status, MemberStatus::Down { .. } | MemberStatus::Suspect { .. })
                    && !stored.record.knowledge.leaving
                {
                    inputs.unreachable.push((node.clone(), status.as_str(), age_ms));
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
        });
        self.ledger(|ledger| {
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

/// A role held by a robot, according to the ledger.
type HeldRole = (MissionId, RoleId, Option<Epoch>);

/// Returns the availability of a robot that is down. Its last record may be outdated: the role it
/// holds is taken from the ledger, and without a ledger no role is known.
fn availability_when_down(published: &Availability, held: Option<&HeldRole>) -> Availability {
    match (published, held) {
        (Availability::OutOfService { .. }, _) => published.clone(),
        (_, Some((mission, role, _))) => {
            let suspended = matches!(published, Availability::Holding { suspended: true, .. });
            Availability::Holding { mission: mission.clone(), role: role.clone(), suspended }
        }
        (_, None) => Availability::Free,
    }
}
