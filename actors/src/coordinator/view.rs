//! The fleet as people see it, in JSON.

use super::whereabouts::foreign;
use crate::gossip::{SharedKnowledge, Status};
use crate::replica::{Leadership, RaftId, Replica};
use consort_protocol::ensemble::Ensemble;
use consort_protocol::ids::{NodeId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::Heard;
use consort_protocol::ledger::{Ledger, MissionEntry, MissionState, Stranded};
use consort_protocol::plan::{LocalPlan, StepAction, StepIndex};
use consort_protocol::units::NodeTime;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// Auctions shown.
const AUCTIONS_SHOWN: usize = 20;

/// What views are drawn from.
pub(super) struct Window<'a> {
    pub(super) keys: &'a Keys,
    pub(super) node: &'a NodeId,
    pub(super) leadership: &'a Leadership,
    pub(super) since: NodeTime,
    pub(super) now: NodeTime,
    pub(super) knowledge: &'a SharedKnowledge,
    pub(super) ensemble: &'a Ensemble,
    pub(super) replica: &'a Replica<Ledger>,
    pub(super) autopilot: Value,
}

impl Window<'_> {
    /// Every view there is, with its key.
    pub(super) fn all(&self) -> Vec<(String, Value)> {
        let mut views = vec![
            (Key::ViewFleet, self.fleet()),
            (Key::ViewCoordinator, self.coordinator()),
            (Key::ViewMissions, self.replica.read(missions)),
            (Key::ViewAuctions, self.replica.read(auctions)),
        ];
        let statuses = self.knowledge.statuses();
        views.extend(self.knowledge.read(|base| {
            let robots = base.iter().filter(|(_, heard)| heard.record.knowledge.worker.is_some());
            robots
                .map(|(node, heard)| (Key::ViewRobot(RobotId::from(node.clone())), self.node(node, heard, &statuses)))
                .collect::<Vec<_>>()
        }));
        views.extend(self.replica.read(|ledger| {
            ledger.missions().map(|entry| (Key::ViewMission(entry.id.clone()), mission(entry))).collect::<Vec<_>>()
        }));
        views.into_iter().map(|(key, value)| (self.keys.write(&key), value)).collect()
    }

    fn coordinator(&self) -> Value {
        // A node that came back with an empty store is another member than the voter of its name.
        let lost = self.knowledge.read(|base| {
            let is_lost = |(id, node): &(&RaftId, &NodeId)| {
                base.get(node).is_none_or(|heard| heard.record.knowledge.replica != Some(id.0))
            };
            self.leadership.voters.iter().filter(is_lost).map(|(_, node)| node.clone()).collect::<Vec<_>>()
        });
        let own = *self.replica.cluster().borrow();
        let foreign = foreign(self.knowledge, own).into_iter().map(|(cluster, node)| (cluster.to_string(), node));
        let foreign: BTreeMap<String, NodeId> = foreign.collect();
        json!({
            "voters_lost": lost,
            "cluster": own,
            "foreign": foreign,
            "autopilot": self.autopilot,
            "node": self.node,
            "term": self.leadership.term,
            "since_ms": self.now.since(self.since).as_millis(),
            "quorum_age_ms": self.replica.quorum_age().map(|age| age.as_millis()),
            "voters": self.leadership.voters.values().collect::<Vec<_>>(),
            "observers": self.leadership.observers.values().collect::<Vec<_>>(),
        })
    }

    fn fleet(&self) -> Value {
        let statuses = self.knowledge.statuses();
        self.knowledge.read(|base| {
            let nodes: Vec<Value> = base.iter().map(|(node, heard)| self.node(node, heard, &statuses)).collect();
            let members = base.iter().map(|(node, _)| {
                let verdict = self.ensemble.judge(node, self.node, base, self.now);
                // Whoever is judged down is asked for no bids, however fresh the last that was heard of it.
                let down = verdict.member && !statuses.get(node).is_some_and(Status::is_alive);
                let reason = if down { "judged down" } else { &verdict.reason };
                json!({ "node": node, "member": verdict.member && !down, "reason": reason, "age_ms": verdict.age_ms })
            });
            json!({
                "seen_by": self.node,
                "cluster": *self.replica.cluster().borrow(),
                "coordinator": self.node,
                "term": self.leadership.term,
                "nodes": nodes,
                "ensembles": [{ "name": self.ensemble.spec().name, "nodes": members.collect::<Vec<_>>() }],
            })
        })
    }

    /// One node. The statuses come from outside: knowledge is locked while its records are looked at.
    fn node(&self, node: &NodeId, heard: &Heard, statuses: &BTreeMap<NodeId, Status>) -> Value {
        let record = &heard.record;
        let held = self.replica.read(|ledger| {
            let held = ledger.held_by(&RobotId::from(node.clone()));
            held.map(|(entry, role, epoch)| json!({ "mission": entry.id, "role": role, "epoch": epoch.to_string() }))
        });
        json!({
            "node": node,
            "alive": statuses.get(node).is_some_and(Status::is_alive),
            "status": statuses.get(node).unwrap_or(&Status::Unknown).word(),
            "age_ms": heard.age(self.now).as_millis(),
            "seen_by": self.node,
            "incarnation": record.stamp.incarnation,
            "version": record.stamp.version,
            "may_vote": record.knowledge.may_vote,
            "stationary": record.knowledge.stationary,
            "mains_powered": record.knowledge.mains_powered,
            "cluster": record.knowledge.cluster,
            "leaving": record.knowledge.leaving,
            "robot": record.knowledge.worker,
            "holds": held,
        })
    }
}

/// All missions, briefly, in the order in which they were submitted.
pub(super) fn missions(ledger: &Ledger) -> Value {
    let mut entries: Vec<&MissionEntry> = ledger.missions().collect();
    entries.sort_by_key(|entry| entry.number);
    let brief = entries.into_iter().map(|entry| {
        let (done, steps) = entry.progress();
        json!({
            "mission": entry.id,
            "state": entry.state.word(),
            "detail": entry.state,
            "priority": entry.submission.priority,
            "deadline_at_ms": entry.submission.deadline_ms,
            "branch": entry.branch,
            "items": items(entry),
            "why_pending": entry.auction.as_ref().and_then(|auction| auction.failure.clone()),
            "parameters": entry.submission.parameters,
            "holders": entry.holders(),
            "done": done,
            "steps": steps,
            "submitted_at_ms": entry.submission.at_ms,
        })
    });
    json!({ "missions": brief.collect::<Vec<_>>() })
}

/// One mission, with the plans of its roles and how far they have come.
pub(super) fn mission(entry: &MissionEntry) -> Value {
    let roles = entry.roles.iter().map(|(id, role)| {
        let plan = entry.plan(id).map(|plan| steps(plan, &role.ended));
        json!({
            "role": id,
            "kind": role.kind,
            "phase": role.phase,
            "holder": role.holder.as_ref().map(|holder| &holder.robot),
            "epoch": role.holder.as_ref().map(|holder| holder.epoch.to_string()),
            "steps": plan,
        })
    });
    let (done, steps) = entry.progress();
    json!({
        "mission": entry.id,
        "number": entry.number,
        "request": entry.submission.request,
        "state": entry.state.word(),
        "detail": entry.state,
        "parameters": entry.submission.parameters,
        "priority": entry.submission.priority,
        "deadline_at_ms": entry.submission.deadline_ms,
        "branch": entry.branch,
        "items": items(entry),
        "released": entry.released,
        "releases": entry.releases,
        "tasks": entry.mission().tasks,
        "roles": roles.collect::<Vec<_>>(),
        "done": done,
        "steps": steps,
        "auction": entry.auction,
        "submitted_at_ms": entry.submission.at_ms,
    })
}

/// What is in robots' keeping, or waits for a person.
fn items(entry: &MissionEntry) -> Vec<Stranded> {
    match &entry.state {
        MissionState::NeedsRescue { items, .. } => items.clone(),
        MissionState::Pending | MissionState::Running => entry.custody(),
        MissionState::Completed | MissionState::Failed { .. } | MissionState::Canceled { .. } => vec![],
    }
}

fn steps(plan: &LocalPlan, ended: &BTreeSet<StepIndex>) -> Vec<Value> {
    let step = |(index, step): (usize, &consort_protocol::plan::Step)| {
        let done = u32::try_from(index).is_ok_and(|index| ended.contains(&index));
        let (kind, label) = match &step.action {
            StepAction::Task { id, spec } => (spec.task_type.to_string(), id.to_string()),
            StepAction::Send(signal) => ("send_message".to_owned(), signal.to_string()),
            StepAction::Wait(signal) => ("wait_message".to_owned(), signal.to_string()),
        };
        json!({ "step": index, "type": kind, "label": label, "after": step.after, "done": done })
    };
    plan.steps.iter().enumerate().map(step).collect()
}

/// The latest auction of each mission, latest first.
fn auctions(ledger: &Ledger) -> Value {
    let mut records: Vec<_> = ledger.missions().filter_map(|entry| entry.auction.as_ref()).collect();
    records.sort_by_key(|record| std::cmp::Reverse((record.at_ms, record.auction.clone())));
    records.truncate(AUCTIONS_SHOWN);
    json!({ "auctions": records })
}
