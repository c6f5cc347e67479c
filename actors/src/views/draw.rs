//! The fleet as one node sees it, in JSON.

use super::Views;
use super::cluster_status::ClusterStatus;
use super::health::{HealthInputs, findings};
use super::mission::{auctions, mission, missions};
use crate::gossip::MemberStatus;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::knowledge::{Availability, KnownRecord};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Ledger, MissionState};
use consort_protocol::units::NodeTime;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// What views are drawn from, at one moment.
pub(super) struct ViewContext<'a> {
    pub(super) views: &'a Views,
    pub(super) status: ClusterStatus,
    pub(super) now: NodeTime,
}

impl ViewContext<'_> {
    /// Every view that this node can draw by itself, of those that are `wanted`.
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
            let robots = base.iter().filter(|(_, heard)| heard.record.knowledge.robot.is_some());
            let keys = robots.map(|(node, heard)| (Key::ViewRobot(RobotId::from(node.clone())), node, heard));
            let wanted = keys.filter(|(key, ..)| wanted(key));
            wanted.map(|(key, node, heard)| (key, self.node(node, heard, &statuses))).collect::<Vec<_>>()
        }));
        views.extend(self.of_ledger(wanted));
        views.into_iter().map(|(key, value)| (key, self.with_provenance(value))).collect()
    }

    /// The views of the ledger, if this node keeps it.
    fn of_ledger(&self, wanted: &impl Fn(&Key) -> bool) -> Vec<(Key, Value)> {
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

    /// Looks into the ledger, if this node keeps it.
    fn ledger<T>(&self, look: impl FnOnce(&Ledger) -> T) -> Option<T> {
        let replica = self.views.replica.as_ref().filter(|_| self.status.has_ledger)?;
        Some(replica.read(look))
    }

    /// A view with who has it, and how old what it knows may be. What a view says of itself under these names stays.
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
            .read(|base| base.iter().map(|(node, heard)| self.node(node, heard, &statuses)).collect());
        json!({ "cluster": self.views.membership.cluster(), "nodes": nodes, "ensembles": [self.ensemble()] })
    }

    /// The ensemble: what it asks for, and of whom it holds.
    fn ensemble(&self) -> Value {
        let statuses = self.views.knowledge.statuses();
        let spec = self.views.ensemble.spec();
        // As its coordinator would judge, from what this node has heard.
        let head = self.status.coordinator.as_ref().unwrap_or(&self.views.node);
        let mut not_members = Map::new();
        let mut members = vec![];
        let nodes: Vec<Value> = self.views.knowledge.read(|base| {
            let judge = |(node, _): (&NodeId, &KnownRecord)| {
                let verdict = self.views.ensemble.membership_of(node, head, base, self.now);
                // Whoever is judged down is asked for no bids, however fresh the last that was heard of it.
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

    /// One node. The statuses come from outside: knowledge is locked while its records are looked at.
    fn node(&self, node: &NodeId, heard: &KnownRecord, statuses: &BTreeMap<NodeId, MemberStatus>) -> Value {
        let record = &heard.record;
        let alive = statuses.get(node).is_some_and(MemberStatus::is_alive);
        let by_ledger = self.ledger(|ledger| {
            let held = ledger.held_by(&RobotId::from(node.clone()));
            held.map(|(entry, role, epoch)| (entry.id.clone(), role.clone(), Some(epoch)))
        });
        let mut worker = record.knowledge.robot.clone();
        if let (false, Some(worker)) = (alive, &mut worker) {
            worker.availability = since_down(&worker.availability, by_ledger.as_ref().and_then(Option::as_ref));
        }
        // Without the ledger, what the robot says of itself.
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
            "age_ms": heard.age(self.now).as_millis(),
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

    /// The fleet's map, if this node was given it.
    fn map(&self) -> Value {
        match self.views.map.as_deref() {
            Some(map) => map.clone(),
            None => json!({ "error": format!("{} was given no map", self.views.node) }),
        }
    }

    fn health(&self) -> Value {
        let findings = findings(&self.signs());
        json!({ "level": findings.first().map(|worst| worst.level), "findings": findings })
    }

    fn signs(&self) -> HealthInputs {
        let statuses = self.views.knowledge.statuses();
        let alive = |node: &NodeId| *node == self.views.node || statuses.get(node).is_some_and(MemberStatus::is_alive);
        let mut signs = HealthInputs {
            coordinator: self.status.coordinator.clone().map(|node| (node, self.status.term)),
            coordinator_age_ms: self.status.age_ms,
            foreign: self.foreign(),
            alive: statuses.values().filter(|status| status.is_alive()).count(),
            knows_missions: self.status.has_ledger,
            ..HealthInputs::default()
        };
        let lost = |node: &NodeId| self.status.voters_lost.contains(node);
        signs.voters = self.status.voters.iter().map(|node| (node.clone(), alive(node) && !lost(node))).collect();
        self.views.knowledge.read(|base| {
            for (node, heard) in base.iter() {
                let status = statuses.get(node).copied().unwrap_or(MemberStatus::Unknown);
                let age_ms = u64::try_from(heard.age(self.now).as_millis()).unwrap_or(u64::MAX);
                if matches!(status, MemberStatus::Down { .. } | MemberStatus::Suspect { .. })
                    && !heard.record.knowledge.leaving
                {
                    signs.unreachable.push((node.clone(), status.as_str(), age_ms));
                }
                match heard.record.knowledge.robot.as_ref().map(|worker| &worker.availability) {
                    Some(Availability::OutOfService { problem }) => {
                        signs.out_of_service.push((node.clone(), problem.clone()));
                    }
                    Some(Availability::Holding { mission, role, suspended: true }) if alive(node) => {
                        signs.suspended.push((node.clone(), format!("{role} of {mission}")));
                    }
                    Some(Availability::Holding { .. } | Availability::Free) | None => {}
                }
            }
        });
        self.ledger(|ledger| {
            for entry in ledger.missions() {
                match (&entry.state, &entry.auction) {
                    (MissionState::NeedsRescue { cause, .. }, _) => {
                        signs.needs_intervention.push((entry.id.to_string(), cause.clone()));
                    }
                    (MissionState::Pending, Some(auction)) => {
                        let why = auction.failure.clone().map(|why| (entry.id.to_string(), why));
                        signs.pending.extend(why);
                    }
                    _ => {}
                }
            }
        });
        signs
    }
}

/// A role that a robot holds, as the ledger says.
type Held = (MissionId, RoleId, Option<Epoch>);

/// Whether a robot that is down could take a role, if it were there. It hears of nothing any more, so that it last said to hold
/// a role means nothing: it holds what the ledger says, and nothing that is known where there is no ledger.
fn since_down(said: &Availability, held: Option<&Held>) -> Availability {
    match (said, held) {
        (Availability::OutOfService { .. }, _) => said.clone(),
        (_, Some((mission, role, _))) => {
            let suspended = matches!(said, Availability::Holding { suspended: true, .. });
            Availability::Holding { mission: mission.clone(), role: role.clone(), suspended }
        }
        (_, None) => Availability::Free,
    }
}
