//! Views of missions and their auctions, from the ledger.

use crate::recurrence::schedule_view;
use consort_protocol::auction::{AuctionRecord, Explanation, explain};
use consort_protocol::ids::{MissionId, RoleId, TaskId};
use consort_protocol::ledger::{Branch, HeldItem, Ledger, MissionEntry, MissionState, RoleEntry, RolePhase, Tombstone};
use consort_protocol::mission::{Mission, RoleKind, TaskBody, TaskIndex, TaskOutcome, TaskSpec};
use consort_protocol::plan::{LocalPlan, Step, StepAction, StepIndex};
use consort_protocol::view::{
    AuctionView, AuctionsView, MissionBrief, MissionProgress, MissionStatus, MissionSummary, MissionView, MissionsView,
    PromiseView, RequestTerms, RoleView, SchedulesView, StepView, TaskParticipant, TaskProgress, TaskView,
};
use std::collections::{BTreeMap, BTreeSet};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Maximum number of auctions in a view.
const AUCTIONS_SHOWN: usize = 20;

/// Returns a summary of all missions in the order of submission.
pub(super) fn missions(ledger: &Ledger) -> MissionsView {
    let mut entries: Vec<&MissionEntry> = ledger.missions().collect();
    entries.sort_by_key(|entry| entry.number);
    let summary = |entry: &MissionEntry| MissionSummary { brief: brief(entry), pending_reason: pending_reason(entry) };
    MissionsView { missions: entries.into_iter().map(summary).collect() }
}

/// Returns the reason for which a mission has no robots, if one is known: its start, or the failure of its
/// latest auction.
fn pending_reason(entry: &MissionEntry) -> Option<String> {
    let Some(auction) = &entry.auction else {
        return Some(format!("it may not start before {}", time_text(entry.submission.not_before_ms?)?));
    };
    auction.failure.clone()
}

/// Returns a time in milliseconds since 1970 as text, to the second.
pub(super) fn time_text(at_ms: u64) -> Option<String> {
    let seconds = i64::try_from(at_ms / 1000).ok()?;
    OffsetDateTime::from_unix_timestamp(seconds).ok()?.format(&Rfc3339).ok()
}

/// Returns a single mission with the plans and the progress of its roles.
pub(super) fn mission(ledger: &Ledger, entry: &MissionEntry) -> MissionView {
    MissionView {
        brief: brief(entry),
        request: Some(entry.submission.request.clone()),
        released: entry.release_count,
        releases: entry.releases.clone(),
        ensembles: entry.mission().ensembles.clone(),
        tasks: entry.mission().tasks.clone(),
        tree: task_tree(entry, entry.mission(), 0).map(|(_, tree)| tree),
        roles: entry.roles.iter().map(|(id, role)| role_view(ledger, entry, (id, role))).collect(),
        auction: entry.auction.clone(),
        explanation: entry.auction.as_ref().map(explanation_of),
    }
}

/// Returns the remainder of a mission that ended long ago: its state and its request.
pub(super) fn ended_mission(mission: MissionId, ended: &Tombstone) -> MissionView {
    let brief = MissionBrief {
        mission,
        number: ended.number,
        status: MissionStatus::from((&ended.state, Branch::Main)),
        terms: RequestTerms { submitted_at_ms: ended.submitted_ms, ..RequestTerms::default() },
        progress: MissionProgress::default(),
        result: BTreeMap::new(),
    };
    MissionView {
        brief,
        request: Some(ended.request.clone()),
        released: 0,
        releases: vec![],
        ensembles: vec![],
        tasks: vec![],
        tree: None,
        roles: vec![],
        auction: None,
        explanation: None,
    }
}

fn brief(entry: &MissionEntry) -> MissionBrief {
    let (done, steps) = entry.progress();
    MissionBrief {
        mission: entry.id.clone(),
        number: entry.number,
        status: MissionStatus::from((&entry.state, entry.branch)),
        terms: RequestTerms {
            parameters: entry.submission.parameters.clone(),
            priority: entry.submission.priority,
            not_before_at_ms: entry.submission.not_before_ms,
            deadline_at_ms: entry.submission.deadline_ms,
            energy_max: entry.energy_max(),
            submitted_at_ms: entry.submission.at_ms,
            by: entry.submission.by.clone(),
        },
        progress: MissionProgress {
            holders: entry.holders(),
            promised: entry.promised_roles().map(|(role, robot)| (role.clone(), robot.robot.clone())).collect(),
            orders: entry.role_orders().iter().map(|(role, order)| (role.clone(), order.to_string())).collect(),
            items: items(entry),
            done,
            steps,
            energy: entry.estimated_energy(),
        },
        result: entry.results(),
    }
}

fn role_view(ledger: &Ledger, entry: &MissionEntry, (id, role): (&RoleId, &RoleEntry)) -> RoleView {
    let promise = role.holder.as_deref().filter(|_| role.phase == RolePhase::Promised);
    RoleView {
        role: id.clone(),
        kind: role.kind,
        eligible: entry.mission().roles.get(id).and_then(|role| role.eligible.clone()),
        phase: role.phase,
        holder: role.holder.as_ref().map(|holder| holder.robot.clone()),
        epoch: role
            .holder
            .as_ref()
            .filter(|_| role.phase != RolePhase::Promised)
            .map(|holder| holder.epoch.to_string()),
        steps: entry.plan(id).map(|plan| steps(plan, &role.ended)),
        promise: promise.map(|promise| PromiseView {
            planned_at_ms: promise.planned_ms,
            delayed_s: promise.delayed,
            can_start: entry.can_proceed(id),
            after: ledger.roles_before(&entry.id, id, promise),
            charging: promise.charging.clone(),
        }),
    }
}

/// Returns the schedules.
pub(super) fn schedules(ledger: &Ledger) -> SchedulesView {
    SchedulesView { schedules: ledger.schedules().map(schedule_view).collect() }
}

/// Returns the latest auctions, latest first, at most one of each mission.
pub(super) fn auctions_shown(ledger: &Ledger) -> Vec<AuctionRecord> {
    let mut records: Vec<&AuctionRecord> = ledger.missions().filter_map(|entry| entry.auction.as_ref()).collect();
    records.sort_by_key(|record| std::cmp::Reverse((record.at_ms, record.auction.clone())));
    records.truncate(AUCTIONS_SHOWN);
    records.into_iter().cloned().collect()
}

/// Returns auctions with their explanations.
pub(super) fn auctions(records: Vec<AuctionRecord>) -> AuctionsView {
    let shown = |record: AuctionRecord| AuctionView { explanation: explanation_of(&record), record };
    AuctionsView { auctions: records.into_iter().map(shown).collect() }
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

fn steps(plan: &LocalPlan, ended: &BTreeSet<StepIndex>) -> Vec<StepView> {
    let view = |(index, step): (usize, &Step)| {
        let (step_type, label) = match &step.action {
            StepAction::Task { id, spec } => (spec.task_type.to_string(), id.to_string()),
            StepAction::Send(signal) => ("send_message".to_owned(), signal.to_string()),
            StepAction::Wait(signal) => ("wait_message".to_owned(), signal.to_string()),
        };
        let done = u32::try_from(index).is_ok_and(|index| ended.contains(&index));
        StepView { step: index, step_type, label, after: step.after.clone(), done }
    };
    plan.steps.iter().enumerate().map(view).collect()
}

/// Returns a task with all its subtasks, and its progress. Children have larger indices than their
/// parents, so the recursion ends.
fn task_tree(entry: &MissionEntry, mission: &Mission, index: TaskIndex) -> Option<(TaskProgress, TaskView)> {
    let node = mission.tasks.get(index as usize)?;
    let task = node.id.clone();
    Some(match &node.body {
        TaskBody::Abstract(method) => {
            let subtasks = method.children.iter().filter_map(|child| task_tree(entry, mission, *child));
            let (parts, children): (Vec<TaskProgress>, Vec<TaskView>) = subtasks.unzip();
            let state = TaskProgress::of_all(&parts);
            (state, TaskView::Abstract { task, order: method.order, state, children })
        }
        TaskBody::Elementary(spec) => {
            let state = elementary(entry, &node.id, spec);
            let (task_type, parameters) = (spec.task_type.clone(), spec.parameters.clone());
            let roles = spec.roles.iter().map(|role| participant(entry, role)).collect();
            let outcome = entry.outcomes.get(&task);
            let state = if outcome == Some(&TaskOutcome::Skipped) { TaskProgress::Skipped } else { state };
            let results = outcome.and_then(TaskOutcome::results).cloned().unwrap_or_default();
            (state, TaskView::Elementary { task, task_type, parameters, state, roles, results })
        }
    })
}

fn participant(entry: &MissionEntry, role: &RoleId) -> TaskParticipant {
    let holder = entry.roles.get(role).and_then(|role| role.holder.as_ref());
    TaskParticipant {
        role: role.clone(),
        holder: holder.map(|holder| holder.robot.clone()),
        epoch: holder.map(|holder| holder.epoch.to_string()),
    }
}

fn elementary(entry: &MissionEntry, task: &TaskId, spec: &TaskSpec) -> TaskProgress {
    let parts: Vec<TaskProgress> = spec
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
    TaskProgress::of_all(&parts)
}

fn step_progress(entry: &MissionEntry, role: &RoleEntry, plan: &LocalPlan, index: StepIndex) -> TaskProgress {
    if role.ended.contains(&index) {
        return TaskProgress::Done;
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
    if runs && permitted { TaskProgress::UnderWay } else { TaskProgress::Waiting }
}
