//! Division of a mission into local plans (Lesire et al. 2016; thesis 2.1.1.1).
//!
//! For each task `D` of a role `s`, and each task `T` that the [`GlobalOrder`] puts before it, each
//! role of `T` must have ended its part before `s` begins `D`. If `D` is joint, this must hold
//! before `s` signals that it is ready. The plan of `s` ensures this as follows:
//!
//! - for its own part, since the step of `D` comes `after` the step of `T`;
//! - for the parts of other roles, since they send `done`. A signal is omitted if another signal or
//!   a local order implies it: when the end of a task is known, the end of all tasks before it is
//!   known, too;
//! - for the parts of its partners in a joint `D`, only when the partners have signalled in turn
//!   that they are ready.
//!
//! ```text
//! sequential: open (r1), deposit (clerk), close (r1)         sequential: walk (r1), open (r2), carry (r1, r2)
//!
//!   r1                        clerk                            r1                         r2
//!   open                                                       walk ─ done ─────────────► open
//!   send done:open ─────────► wait                             send ready:carry ────────► wait ready
//!                             deposit                          wait ready ◄────────────── send ready:carry
//!   wait ◄──────────────────  send done:deposit                carry                      carry
//!   close
//! ```
//!
//! A role may not signal `ready` while the work of a third role is still awaited, although the
//! `ready` of its partner would imply that work later. A role that is ready does nothing else. The
//! third role might need it, or need a role that is waiting for it. The proof is in
//! [`check`](super::check_division).
//!
//! Unordered tasks of a role stay unordered. The steps are listed in the order of the file: waits
//! directly before the first task that needs them, sends directly after their task. So a robot that
//! takes the first permitted step in the list follows the file.

use super::alternatives::alternatives;
use super::guards::guarded_steps;
use super::local::{Division, LocalPlan, Signal, SignalKind, Step, StepAction, StepIndex};
use crate::ids::RoleId;
use crate::mission::{Bits, GlobalOrder, Mission, MissionErrors};
use std::collections::BTreeMap;

/// Divides a mission into 1 plan for each of its roles, including the unmanaged roles.
///
/// # Errors
/// [`MissionErrors`] if the mission's tree is invalid.
pub fn divide(mission: &Mission) -> Result<Division, MissionErrors> {
    let order = GlobalOrder::of(mission)?;
    let preconditions = Preconditions::of(&order);
    let mut plans: BTreeMap<RoleId, PlanDraft<'_>> =
        mission.roles.keys().map(|role| (role.clone(), PlanDraft::of(role, &order))).collect();
    for task in 0..order.len() {
        for role in &order.spec(task).roles {
            let part = (task, role);
            let draft = plans.get_mut(role).expect("a checked mission has the roles of its tasks");
            draft.add_task(
                task,
                &preconditions.of_part[&part],
                preconditions.signalled.get(&part).map_or(&[], Vec::as_slice),
            );
        }
    }
    let plans = plans.into_iter().map(|(role, draft)| (role.clone(), LocalPlan::of(role, draft.steps)));
    let mut division = Division { plans: plans.collect() };
    let mut guarded = guarded_steps(mission, &division)?;
    for (role, plan) in &mut division.plans {
        plan.alternatives = alternatives(mission, plan);
        plan.guarded = guarded.remove(role).unwrap_or_default();
    }
    Ok(division)
}

/// Part of a role in a task: task number and role.
type Part<'m> = (usize, &'m RoleId);

/// Preconditions of a part.
#[derive(Default)]
struct Precondition<'m> {
    /// Latest preceding tasks of the same role.
    own: Vec<usize>,
    /// Parts of other roles that must be signalled to this role.
    signalled: Vec<Part<'m>>,
}

struct Preconditions<'m> {
    of_part: BTreeMap<Part<'m>, Precondition<'m>>,
    /// Receivers of the `done` signal of each part, in the order in which they need it.
    signalled: BTreeMap<Part<'m>, Vec<&'m RoleId>>,
}

impl<'m> Preconditions<'m> {
    fn of(order: &GlobalOrder<'m>) -> Self {
        let mut preconditions = Preconditions { of_part: BTreeMap::new(), signalled: BTreeMap::new() };
        for task in 0..order.len() {
            for role in &order.spec(task).roles {
                let precondition = precondition_of(order, task, role);
                for part in &precondition.signalled {
                    let signalled = preconditions.signalled.entry(*part).or_default();
                    if !signalled.contains(&role) {
                        signalled.push(role);
                    }
                }
                preconditions.of_part.insert((task, role), precondition);
            }
        }
        preconditions
    }
}

/// Computes the preconditions from the latest task back, so that tasks implied by a later task are
/// skipped.
fn precondition_of<'m>(order: &GlobalOrder<'m>, task: usize, role: &'m RoleId) -> Precondition<'m> {
    let mut precondition = Precondition::default();
    let partners = &order.spec(task).roles;
    let mut known = Bits::below(order.len()); // tasks known to have ended in all roles
    let own = order.before(task).descending().filter(|earlier| order.spec(*earlier).roles.contains(role));
    for earlier in own {
        if !known.contains(earlier) {
            precondition.own.push(earlier);
            known.extend(order.before(earlier));
        }
    }
    // A preceding task of the role itself implies all tasks before it, but not the parts of its
    // partners in that same task.
    for earlier in order.before(task).descending() {
        if known.contains(earlier) {
            continue;
        }
        let others = order.spec(earlier).roles.iter().filter(|other| *other != role && !partners.contains(other));
        let count = precondition.signalled.len();
        precondition.signalled.extend(others.map(|other| (earlier, other)));
        if precondition.signalled.len() > count {
            known.extend(order.before(earlier));
        }
    }
    precondition.signalled.sort_by_key(|(earlier, _)| *earlier);
    precondition
}

/// Local plan under construction, task by task in the order of the file.
struct PlanDraft<'m> {
    role: &'m RoleId,
    order: &'m GlobalOrder<'m>,
    steps: Vec<Step>,
    tasks: BTreeMap<usize, StepIndex>,
    waits: BTreeMap<Part<'m>, StepIndex>,
}

impl<'m> PlanDraft<'m> {
    fn of(role: &'m RoleId, order: &'m GlobalOrder<'m>) -> Self {
        Self { role, order, steps: vec![], tasks: BTreeMap::new(), waits: BTreeMap::new() }
    }

    fn add_task(&mut self, task: usize, precondition: &Precondition<'m>, signalled: &[&'m RoleId]) {
        for &part in &precondition.signalled {
            self.wait_for_end(part);
        }
        let begin = self.steps_meeting(precondition);
        let (id, spec) = (self.order.id(task).clone(), self.order.spec(task).clone());
        let partners: Vec<RoleId> = spec.roles.iter().filter(|role| *role != self.role).cloned().collect();
        let signal = |kind: SignalKind, from: &RoleId, to: &RoleId| {
            let (task, from, to) = (self.order.id(task).clone(), from.clone(), to.clone());
            Signal { kind, task, from, to }
        };
        let (sends, waits): (Vec<Signal>, Vec<Signal>) = partners
            .iter()
            .map(|other| (signal(SignalKind::Ready, self.role, other), signal(SignalKind::Ready, other, self.role)))
            .unzip();
        let ends: Vec<Signal> = signalled.iter().map(|other| signal(SignalKind::Done, self.role, other)).collect();

        let ready_sent: Vec<StepIndex> =
            sends.into_iter().map(|ready| self.push(StepAction::Send(ready), begin.clone())).collect();
        let ready_received: Vec<StepIndex> =
            waits.into_iter().map(|ready| self.push(StepAction::Wait(ready), ready_sent.clone())).collect();
        let after = if partners.is_empty() { begin } else { ready_received };
        let step = self.push(StepAction::Task { id, spec }, after);
        self.tasks.insert(task, step);
        for done in ends {
            self.push(StepAction::Send(done), vec![step]);
        }
    }

    /// Adds the wait for another role's end of a task, once. The wait follows those tasks of this
    /// role that must have ended before that signal can be sent.
    fn wait_for_end(&mut self, part: Part<'m>) {
        if self.waits.contains_key(&part) {
            return;
        }
        let (task, from) = part;
        let mut after: Vec<usize> = Vec::new();
        for (&own, _) in self.tasks.iter().rev() {
            let sooner = own == task || self.order.precedes(own, task);
            if sooner && !after.iter().any(|later| self.order.precedes(own, *later)) {
                after.push(own);
            }
        }
        let mut after: Vec<StepIndex> = after.iter().map(|own| self.tasks[own]).collect();
        after.sort_unstable();
        let (task, from, to) = (self.order.id(task).clone(), from.clone(), self.role.clone());
        let step = self.push(StepAction::Wait(Signal { kind: SignalKind::Done, task, from, to }), after);
        self.waits.insert(part, step);
    }

    /// Returns the steps after which a precondition is met, without steps that are implied by
    /// others.
    fn steps_meeting(&self, precondition: &Precondition<'m>) -> Vec<StepIndex> {
        let implied =
            |own: usize| precondition.signalled.iter().any(|(task, _)| own == *task || self.order.precedes(own, *task));
        let own = precondition.own.iter().filter(|own| !implied(**own)).map(|own| self.tasks[own]);
        let mut after: Vec<StepIndex> = own.chain(precondition.signalled.iter().map(|part| self.waits[part])).collect();
        after.sort_unstable();
        after
    }

    fn push(&mut self, action: StepAction, after: Vec<StepIndex>) -> StepIndex {
        self.steps.push(Step { action, after });
        (self.steps.len() - 1) as StepIndex
    }
}
