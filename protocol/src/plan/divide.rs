//! Division of a mission into local plans (Lesire et al. 2016; thesis 2.1.1.1).
//!
//! For each task `D` of a role `s`, and each task `T` that the [`GlobalOrder`] puts before it, `s` must know that each
//! role of `T` has ended its part before `s` begins `D`, or, where `D` is joint, before `s` says that it stands ready.
//! It knows so
//!
//! - of its own part, since the step of `D` comes `after` the step of `T`;
//! - of the others' parts, since they send `done`: but no signal is sent of what follows from another one, or from a
//!   local order. Who has heard that a task has ended knows that all before it has.
//! - of the parts of its partners in a joint `D` only when they in turn have said that they stand ready.
//!
//! ```text
//! sequential: open (r1), deposit (nurse), close (r1)         sequential: walk (r1), open (r2), carry (r1, r2)
//!
//!   r1                        nurse                            r1                         r2
//!   open                                                       walk ─ done ─────────────► open
//!   send done:open ─────────► wait                             send ready:carry ────────► wait ready
//!                             deposit                          wait ready ◄────────────── send ready:carry
//!   wait ◄──────────────────  send done:deposit                carry                      carry
//!   close
//! ```
//!
//! Why nobody may stand ready while a third role's work is still awaited, although its partner's `ready` would imply
//! it later: a role that stands ready does nothing else, and that third role might need it, or need somebody who is
//! in turn waiting for it. The argument is in [`check`](super::check_division).
//!
//! Tasks of one role that are in no order stay in none. The steps are listed in the order of the file: waits directly
//! before the first task that needs them, sends directly after their task, so that a robot that takes whatever comes
//! first in the list follows the file.

use super::alternatives::alternatives;
use super::guards::guarded_steps;
use super::local::{Division, LocalPlan, Signal, SignalKind, Step, StepAction, StepIndex};
use super::order::GlobalOrder;
use crate::ids::RoleId;
use crate::mission::{Mission, MissionErrors};
use std::collections::BTreeMap;

/// Divides a mission into one plan for each of its roles, the unmanaged ones too.
///
/// # Errors
/// [`MissionErrors`] if the mission's tree is none.
pub fn divide(mission: &Mission) -> Result<Division, MissionErrors> {
    let order = GlobalOrder::of(mission)?;
    let needs = Needs::of(&order);
    let mut plans: BTreeMap<RoleId, Draft<'_>> =
        mission.roles.keys().map(|role| (role.clone(), Draft::of(role, &order))).collect();
    for task in 0..order.len() {
        for role in &order.spec(task).roles {
            let part = (task, role);
            let draft = plans.get_mut(role).expect("a checked mission has the roles of its tasks");
            draft.write(task, &needs.of_part[&part], needs.told.get(&part).map_or(&[], Vec::as_slice));
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

/// A role's part in a task.
type Part<'m> = (usize, &'m RoleId);

/// What a role must know before it begins a task.
#[derive(Default)]
struct Need<'m> {
    /// Its own latest tasks before it.
    own: Vec<usize>,
    /// The others' parts that it must be told of.
    told: Vec<Part<'m>>,
}

struct Needs<'m> {
    of_part: BTreeMap<Part<'m>, Need<'m>>,
    /// Whom each part's end is told to, in the order in which they need it.
    told: BTreeMap<Part<'m>, Vec<&'m RoleId>>,
}

impl<'m> Needs<'m> {
    fn of(order: &GlobalOrder<'m>) -> Self {
        let mut needs = Needs { of_part: BTreeMap::new(), told: BTreeMap::new() };
        for task in 0..order.len() {
            for role in &order.spec(task).roles {
                let need = need_of(order, task, role);
                for part in &need.told {
                    let told = needs.told.entry(*part).or_default();
                    if !told.contains(&role) {
                        told.push(role);
                    }
                }
                needs.of_part.insert((task, role), need);
            }
        }
        needs
    }
}

/// From the latest task back, so that what a later one implies is known when an earlier one is looked at.
fn need_of<'m>(order: &GlobalOrder<'m>, task: usize, role: &'m RoleId) -> Need<'m> {
    let mut need = Need::default();
    let partners = &order.spec(task).roles;
    let mut known = super::bits::Bits::below(order.len()); // tasks that have ended in all roles, as far as is known
    let own = order.before(task).descending().filter(|earlier| order.spec(*earlier).roles.contains(role));
    for earlier in own {
        if !known.contains(earlier) {
            need.own.push(earlier);
            known.extend(order.before(earlier));
        }
    }
    // A role's own last task tells of all before it, but not yet of its partners' parts in that task itself.
    for earlier in order.before(task).descending() {
        if known.contains(earlier) {
            continue;
        }
        let others = order.spec(earlier).roles.iter().filter(|other| *other != role && !partners.contains(other));
        let count = need.told.len();
        need.told.extend(others.map(|other| (earlier, other)));
        if need.told.len() > count {
            known.extend(order.before(earlier));
        }
    }
    need.told.sort_by_key(|(earlier, _)| *earlier);
    need
}

/// A local plan being written, task by task in the order of the file.
struct Draft<'m> {
    role: &'m RoleId,
    order: &'m GlobalOrder<'m>,
    steps: Vec<Step>,
    tasks: BTreeMap<usize, StepIndex>,
    waits: BTreeMap<Part<'m>, StepIndex>,
}

impl<'m> Draft<'m> {
    fn of(role: &'m RoleId, order: &'m GlobalOrder<'m>) -> Self {
        Self { role, order, steps: vec![], tasks: BTreeMap::new(), waits: BTreeMap::new() }
    }

    fn write(&mut self, task: usize, need: &Need<'m>, told: &[&'m RoleId]) {
        for &part in &need.told {
            self.wait_for_end(part);
        }
        let begin = self.known_by(need);
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
        let ends: Vec<Signal> = told.iter().map(|other| signal(SignalKind::Done, self.role, other)).collect();

        let stands_ready: Vec<StepIndex> =
            sends.into_iter().map(|ready| self.push(StepAction::Send(ready), begin.clone())).collect();
        let all_ready: Vec<StepIndex> =
            waits.into_iter().map(|ready| self.push(StepAction::Wait(ready), stands_ready.clone())).collect();
        let after = if partners.is_empty() { begin } else { all_ready };
        let step = self.push(StepAction::Task { id, spec }, after);
        self.tasks.insert(task, step);
        for done in ends {
            self.push(StepAction::Send(done), vec![step]);
        }
    }

    /// Writes the wait for another role's end of a task, once. It comes after what of this role's own must have ended
    /// before that signal can be on its way.
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

    /// The steps after which a need is met, without those that another of them implies.
    fn known_by(&self, need: &Need<'m>) -> Vec<StepIndex> {
        let implied = |own: usize| need.told.iter().any(|(task, _)| own == *task || self.order.precedes(own, *task));
        let own = need.own.iter().filter(|own| !implied(**own)).map(|own| self.tasks[own]);
        let mut after: Vec<StepIndex> = own.chain(need.told.iter().map(|part| self.waits[part])).collect();
        after.sort_unstable();
        after
    }

    fn push(&mut self, action: StepAction, after: Vec<StepIndex>) -> StepIndex {
        self.steps.push(Step { action, after });
        (self.steps.len() - 1) as StepIndex
    }
}
