//! Views of missions and their auctions, from the ledger.

use consort_protocol::auction::{AuctionRecord, Explanation, explain};
use consort_protocol::ids::{RoleId, TaskId};
use consort_protocol::ledger::{HeldItem, Ledger, MissionEntry, MissionState, RoleEntry, RolePhase};
use consort_protocol::mission::{Mission, RoleKind, TaskBody, TaskIndex, TaskSpec};
use consort_protocol::plan::{LocalPlan, Step, StepAction, StepIndex};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// Maximum number of auctions in a view.
const AUCTIONS_SHOWN: usize = 20;

/// Returns a summary of all missions in the order of submission.
pub(super) fn missions(ledger: &Ledger) -> Value {
    let mut entries: Vec<&MissionEntry> = ledger.missions().collect();
    entries.sort_by_key(|entry| entry.number);
    let brief = entries.into_iter().map(|entry| {
        let (done, steps) = entry.progress();
        json!({
            "mission": entry.id,
            "number": entry.number,
            "state": entry.state.as_str(),
            "detail": entry.state,
            "priority": entry.submission.priority,
            "deadline_at_ms": entry.submission.deadline_ms,
            "branch": entry.branch,
            "items": items(entry),
            "pending_reason": entry.auction.as_ref().and_then(|auction| auction.failure.clone()),
            "parameters": entry.submission.parameters,
            "holders": entry.holders(),
            "done": done,
            "steps": steps,
            "submitted_at_ms": entry.submission.at_ms,
        })
    });
    json!({ "missions": brief.collect::<Vec<_>>() })
}

/// Returns a single mission with the plans and the progress of its roles.
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
        "state": entry.state.as_str(),
        "detail": entry.state,
        "parameters": entry.submission.parameters,
        "priority": entry.submission.priority,
        "deadline_at_ms": entry.submission.deadline_ms,
        "branch": entry.branch,
        "items": items(entry),
        "released": entry.release_count,
        "releases": entry.releases,
        "tasks": entry.mission().tasks,
        "tree": tree(entry, entry.mission(), 0),
        "roles": roles.collect::<Vec<_>>(),
        "holders": entry.holders(),
        "done": done,
        "steps": steps,
        "auction": entry.auction,
        "explanation": entry.auction.as_ref().map(explanation_of),
        "submitted_at_ms": entry.submission.at_ms,
    })
}

/// Returns the latest auction of each mission, latest first, with its explanation.
pub(super) fn auctions(ledger: &Ledger) -> Value {
    let mut records: Vec<&AuctionRecord> = ledger.missions().filter_map(|entry| entry.auction.as_ref()).collect();
    records.sort_by_key(|record| std::cmp::Reverse((record.at_ms, record.auction.clone())));
    records.truncate(AUCTIONS_SHOWN);
    let shown = records.into_iter().map(|record| {
        let mut shown = json!(record);
        shown["explanation"] = json!(explanation_of(record));
        shown
    });
    json!({ "auctions": shown.collect::<Vec<_>>() })
}

/// Returns the explanation of an auction without the bids' parts, which the record next to it
/// contains.
fn explanation_of(record: &AuctionRecord) -> Explanation {
    explain(record).without_parts()
}

/// Returns the items that robots carry, or that need intervention by a person.
fn items(entry: &MissionEntry) -> Vec<HeldItem> {
    match &entry.state {
        MissionState::NeedsIntervention { items, .. } => items.clone(),
        MissionState::Pending | MissionState::Running => entry.custody(),
        MissionState::Completed | MissionState::Failed { .. } | MissionState::Canceled { .. } => vec![],
    }
}

fn steps(plan: &LocalPlan, ended: &BTreeSet<StepIndex>) -> Vec<Value> {
    let step = |(index, step): (usize, &Step)| {
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

/// Progress of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Progress {
    /// Its predecessors have not ended.
    Waiting,
    /// It could be performed now, or a part of it is in progress.
    UnderWay,
    /// It has ended.
    Done,
}

impl Progress {
    fn as_str(self) -> &'static str {
        match self {
            Progress::Waiting => "waiting",
            Progress::UnderWay => "under_way",
            Progress::Done => "done",
        }
    }

    /// Returns the progress of an abstract task from the progress of its parts.
    fn of_all(parts: &[Progress]) -> Progress {
        match parts {
            _ if parts.iter().all(|part| *part == Progress::Done) => Progress::Done,
            _ if parts.iter().all(|part| *part == Progress::Waiting) => Progress::Waiting,
            _ => Progress::UnderWay,
        }
    }
}

/// Returns a task with all its subtasks. Children have larger indices than their parents, so the
/// recursion ends.
fn tree(entry: &MissionEntry, mission: &Mission, index: TaskIndex) -> Value {
    task_tree(entry, mission, index).1
}

fn task_tree(entry: &MissionEntry, mission: &Mission, index: TaskIndex) -> (Progress, Value) {
    let Some(node) = mission.tasks.get(index as usize) else { return (Progress::Waiting, Value::Null) };
    match &node.body {
        TaskBody::Abstract(method) => {
            let subtasks = method.children.iter().map(|child| task_tree(entry, mission, *child));
            let (parts, children): (Vec<Progress>, Vec<Value>) = subtasks.unzip();
            let progress = Progress::of_all(&parts);
            let view = json!({
                "task": node.id,
                "kind": "abstract",
                "order": method.order,
                "state": progress.as_str(),
                "children": children,
            });
            (progress, view)
        }
        TaskBody::Elementary(spec) => {
            let progress = elementary(entry, &node.id, spec);
            let holders: Vec<Value> = spec.roles.iter().map(|role| holder(entry, role)).collect();
            let view = json!({
                "task": node.id,
                "kind": "elementary",
                "type": spec.task_type,
                "parameters": spec.parameters,
                "state": progress.as_str(),
                "roles": holders,
            });
            (progress, view)
        }
    }
}

fn holder(entry: &MissionEntry, role: &RoleId) -> Value {
    let holder = entry.roles.get(role).and_then(|role| role.holder.as_ref());
    json!({
        "role": role,
        "holder": holder.map(|holder| &holder.robot),
        "epoch": holder.map(|holder| holder.epoch.to_string()),
    })
}

fn elementary(entry: &MissionEntry, task: &TaskId, spec: &TaskSpec) -> Progress {
    let parts: Vec<Progress> = spec
        .roles
        .iter()
        .filter_map(|id| {
            let (role, plan) = (entry.roles.get(id)?, entry.plan(id)?);
            let is_it = |step: &&Step| matches!(&step.action, StepAction::Task { id, .. } if id == task);
            let index = StepIndex::try_from(plan.steps.iter().position(|step| is_it(&step))?).ok()?;
            Some(step_progress(entry, role, plan, index))
        })
        .collect();
    // A joint task is in progress once the first participant performs it.
    Progress::of_all(&parts)
}

fn step_progress(entry: &MissionEntry, role: &RoleEntry, plan: &LocalPlan, index: StepIndex) -> Progress {
    if role.ended.contains(&index) {
        return Progress::Done;
    }
    let at_work = match role.kind {
        RoleKind::Managed => role.phase == RolePhase::Active,
        RoleKind::Unmanaged => true,
    };
    let runs = matches!(entry.state, MissionState::Running) && at_work;
    // A signal in the ledger counts as received, although its receiver may not have reported that
    // yet.
    let view = entry.signals_to(&plan.role);
    let is_past = |step: &StepIndex| {
        let awaited = plan.steps.get(*step as usize).is_some_and(|step| match &step.action {
            StepAction::Wait(signal) => view.contains(signal),
            StepAction::Task { .. } | StepAction::Send(_) => false,
        });
        awaited || role.ended.contains(step)
    };
    let permitted = plan.steps.get(index as usize).is_some_and(|step| step.after.iter().all(is_past));
    if runs && permitted { Progress::UnderWay } else { Progress::Waiting }
}
