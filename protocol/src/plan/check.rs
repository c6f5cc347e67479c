//! Whether a division carries out its mission: nothing missing, nothing out of order, nobody waiting for ever.
//!
//! The check takes nothing from the way in which the division was made; it looks at the plans alone, as they might
//! have come off the wire.
//!
//! # The contract of those who carry out a plan
//!
//! 1. A robot does one task at a time, and each step once.
//! 2. It may begin any step of which all `after` have ended. A send takes no time. A wait ends when its signal has been
//!    heard and holds up only what stands after it.
//! 3. Once it has sent a `ready` for a joint task, it begins no other task, and sends no `ready` for another one, until
//!    its part in that joint task has ended. It sends a `ready` only while it does no task.
//! 4. Signals sent are heard in the end, in any order; tasks begun end in the end.
//!
//! # What is checked
//!
//! *Steps* form a graph: `after`, and each send before its wait. *Tasks* form a coarser one: all steps of a joint task
//! (its `ready` signals and its parts) are taken for one, and `T < D` if some path leads from `T` to `D` through it.
//!
//! - (a) Every role's plan has exactly the role's tasks; every wait has exactly one send, of the right role, and every
//!   send its wait; a `done` follows its task.
//! - (b) In a joint task, each role sends `ready` to each other one and hears `ready` from each before it begins.
//! - (c) Neither graph has a cycle.
//! - (d) If the mission puts `T` before `D`, each part of `T` ends before each part of `D` begins.
//! - (e) If `T < D`: the part of a role `t` in `T` ends before the part of `s` in `D` *opens*, that is, before its task
//!   begins or, if `D` is joint, before its first `ready` is sent; if `s` is `t`, or `t` takes no part in `D`.
//! - (f) The guarded steps are those of [`item_moves`](super::item_moves): a guard holds a step up until a report was
//!   answered, which ends in the end (4), so it changes nothing below.
//! - (g) The alternatives are the mission's, and nothing stands between the steps that one replaces: to all others, doing
//!   it is one of those tasks taking longer.
//!
//! Two joint tasks that share a role are always ordered by `<`: the mission's order orders them, and (d) holds.
//!
//! # Why nobody waits for ever
//!
//! Suppose a state in which nothing moves, while some step has not ended. Say that a role is *committed* to a joint task
//! if it has sent a `ready` for it and has not ended its part. Fix a sequence of all tasks which extends `<` (c).
//!
//! Signals never hold out: a `done`, or a wait for what was sent, is carried out when all before it has ended. So some
//! task has not ended, and if all before an unended task has ended, then one of its roles is held up by rule 3 alone.
//! (If it is joint and all its `ready` are sent, they are heard, and its parts begin. They are not held up, as those
//! roles are committed to it, and by rule 3 to it alone.)
//!
//! *Nobody is committed.* The first unended task in the sequence has all before it ended and is held up by nothing.
//!
//! *Somebody is committed.* Let `J` be the first in the sequence of the tasks to which some role `r` is committed, and
//! `T` the first unended task with `T < J` or `T = J`. All before `T` has ended; so some role `u` of `T`, which has not
//! opened its part, is committed to a joint `K`, and `K ≠ T`. `K` is not before `J` in the sequence.
//!
//! - If `T < K`, by (e) with `s = t = u`, `u` ended its part in `T` before it committed itself to `K`. It did not.
//! - Else, if `T` is joint, it shares `u` with `K`, and by the last remark `K < T`. So `K < J` or `K < T = J`: `K` is before `J`.
//! - Else `T` is not joint, hence `T < J`. If `u` takes no part in `J`, by (e) `T` ended before `r` committed itself to
//!   `J`. It did not. If `u` does, `J` and `K` share it; `J = K` is the first case; else either `J < K`, and so
//!   `T < K`, the first case again, or `K < J`, and `K` is before `J`.
//!
//! Every case contradicts the choice, so there is no such state. Each step ends once, so every run ends.
//!
//! Without (e) this fails. Take, in no order, first `A` (`r`) then `J` (`s`, `x`), and first `B` (`s`) then `K` (`r`, `y`).
//! If `r` may stand ready for `K` before it has heard of `B` (since `y` would wait for it), and `s` for `J`, then `r` waits
//! for `y`, `y` for `B` of `s`, `s` for `x`, `x` for `A` of `r`.

use super::alternatives::{differ, waits_inside};
use super::bits::Bits;
use super::divide::divide;
use super::guards::guarded;
use super::local::{Division, LocalPlan, Signal, SignalKind, StepAction, StepIndex};
use super::order::GlobalOrder;
use crate::ids::{RoleId, TaskId};
use crate::mission::{Mission, MissionErrors};
use petgraph::algo::{tarjan_scc, toposort};
use petgraph::graph::{DiGraph, NodeIndex};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// Divides a mission and checks the result.
///
/// # Errors
/// [`DivisionError`]: of a mission whose tree is none; a division of our own that does not pass would be our mistake, and
/// is refused all the same.
pub fn divide_and_check(mission: &Mission) -> Result<Division, DivisionError> {
    let division = divide(mission)?;
    check_division(mission, &division)?;
    Ok(division)
}

/// Checks that the division carries out the mission, whatever the order in which things happen.
///
/// # Errors
/// [`DivisionError`] lists what is wrong, up to the first kind of problem that makes the rest meaningless.
pub fn check_division(mission: &Mission, division: &Division) -> Result<(), DivisionError> {
    let order = GlobalOrder::of(mission)?;
    let unsound = |faults: Vec<DivisionFault>| match faults.is_empty() {
        true => Ok(()),
        false => Err(DivisionError::Unsound(DivisionFaults { mission: mission.name.clone(), faults })),
    };
    let survey = Survey::of(&order, division);
    unsound(survey.faults)?;
    let product = Product { order: &order, division, part_numbers: survey.parts, pairs: survey.pairs };
    unsound(product.faults())?;
    unsound(recovery_faults(mission, division)?)
}

/// Why there is no division.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DivisionError {
    /// The mission's tree is none.
    #[error(transparent)]
    Mission(#[from] MissionErrors),
    /// The plans do not carry out the mission.
    #[error(transparent)]
    Unsound(#[from] DivisionFaults),
}

/// What is wrong with a division.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DivisionFaults {
    /// The mission that was divided.
    pub mission: TaskId,
    /// Every fault found. Never empty.
    pub faults: Vec<DivisionFault>,
}

impl fmt::Display for DivisionFaults {
    /// One line for the mission, then one line a fault.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the local plans of mission {} do not carry it out:", self.mission)?;
        self.faults.iter().try_for_each(|fault| write!(f, "\n  {fault}"))
    }
}

impl std::error::Error for DivisionFaults {}

/// One thing that is wrong with a division.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say what the fields are")]
pub enum DivisionFault {
    /// A role without a plan.
    #[error("role {role} has no plan")]
    NoPlan { role: RoleId },
    /// A plan for a role that the mission does not have, or under another role's name.
    #[error("there is a plan for {role} that says it is for {says}; the mission's roles have one plan each")]
    StrangePlan { role: RoleId, says: RoleId },
    /// A task that its role's plan leaves out.
    #[error("role {role}: its plan lacks the task {task}")]
    TaskMissing { role: RoleId, task: TaskId },
    /// A task that is not the role's, or is there twice.
    #[error("role {role}: its plan has the task {task}, {problem}")]
    StrangeTask { role: RoleId, task: TaskId, problem: &'static str },
    /// A step after itself, after a later one, or after a step twice.
    #[error("role {role}: step {step} says it comes after {after:?}; these are smaller numbers, in order, each once")]
    BadAfter { role: RoleId, step: StepIndex, after: Vec<StepIndex> },
    /// A signal that cannot be.
    #[error("role {role}: the signal {signal} in its plan {problem}")]
    StrangeSignal { role: RoleId, signal: Signal, problem: &'static str },
    /// A send that nobody waits for.
    #[error("role {} sends {signal}, and role {} does not wait for it", signal.from, signal.to)]
    SendUnheard { signal: Signal },
    /// A wait for what nobody sends.
    #[error("role {} waits for {signal}, and role {} never sends it", signal.to, signal.from)]
    WaitInVain { signal: Signal },
    /// A joint task that a role may begin without its partner.
    #[error("role {role} may begin the joint task {task} before it has told {partner} and heard from it")]
    NoRendezvous { role: RoleId, task: TaskId, partner: RoleId },
    /// A `done` that is sent too early.
    #[error("role {} may send {signal} before it has ended that task", signal.from)]
    TooSoon { signal: Signal },
    /// Steps that wait for each other.
    #[error("these tasks wait for one another: {tasks}")]
    Cycle { tasks: String },
    /// An order that is not kept.
    #[error("role {role} may begin {task} before role {other} has ended {earlier}")]
    OutOfOrder { role: RoleId, task: TaskId, other: RoleId, earlier: TaskId },
    /// A role that binds itself while work is open that it does not see its partners do.
    #[error("role {role} may stand ready for {task} before it knows that role {other} has ended {earlier}")]
    ReadyTooSoon { role: RoleId, task: TaskId, other: RoleId, earlier: TaskId },
    /// Steps that the ledger should know of first, and that are not marked so, or the other way round.
    #[error("role {role}: its plan guards the steps {found:?}, and it should guard {expected:?}")]
    Guards { role: RoleId, found: BTreeSet<StepIndex>, expected: BTreeSet<StepIndex> },
    /// Alternatives that are not the mission's.
    #[error("role {role}: the alternatives of its plan are not the mission's")]
    Alternatives { role: RoleId },
    /// An alternative that others would notice.
    #[error("role {role}: step {step} stands between steps that an alternative replaces")]
    NotLocal { role: RoleId, step: StepIndex },
}

/// (f) and (g)
fn recovery_faults(mission: &Mission, division: &Division) -> Result<Vec<DivisionFault>, MissionErrors> {
    let mut expected = guarded(mission, division)?;
    let mut faults = Vec::new();
    for (role, plan) in &division.plans {
        let expected = expected.remove(role).unwrap_or_default();
        if plan.guarded != expected {
            let (role, found) = (role.clone(), plan.guarded.clone());
            faults.push(DivisionFault::Guards { role, found, expected });
        }
        if differ(mission, role, plan) {
            faults.push(DivisionFault::Alternatives { role: role.clone() });
        }
        for alternative in &plan.alternatives {
            if let Some(step) = waits_inside(plan, &alternative.replaces) {
                faults.push(DivisionFault::NotLocal { role: role.clone(), step });
            }
        }
    }
    Ok(faults)
}

/// A role's part in a task, by the task's number.
type Part<'a> = (usize, &'a RoleId);
/// A step: whose, and where in its plan.
type At<'a> = (&'a RoleId, usize);

/// First part of the check: each plan by itself, and signals in pairs.
struct Survey<'a> {
    parts: BTreeMap<Part<'a>, usize>,
    pairs: Vec<(At<'a>, At<'a>)>,
    faults: Vec<DivisionFault>,
}

impl<'a> Survey<'a> {
    fn of(order: &'a GlobalOrder<'a>, division: &'a Division) -> Self {
        let mut survey = Survey { parts: BTreeMap::new(), pairs: Vec::new(), faults: Vec::new() };
        let numbers: BTreeMap<&TaskId, usize> = (0..order.len()).map(|task| (order.id(task), task)).collect();
        for task in 0..order.len() {
            for role in &order.spec(task).roles {
                let number = survey.parts.len();
                survey.parts.insert((task, role), number);
            }
        }
        let roles: BTreeSet<&RoleId> = survey.parts.keys().map(|(_, role)| *role).collect();
        for role in roles.iter().filter(|role| !division.plans.contains_key(**role)) {
            survey.faults.push(DivisionFault::NoPlan { role: (*role).clone() });
        }
        let (mut sends, mut waits) = (BTreeMap::new(), BTreeMap::new());
        for (role, plan) in &division.plans {
            if plan.role != *role || !roles.contains(role) {
                survey.faults.push(DivisionFault::StrangePlan { role: role.clone(), says: plan.role.clone() });
                continue;
            }
            survey.plan(order, &numbers, plan);
            survey.signals(order, &numbers, plan, &mut sends, &mut waits);
        }
        for (signal, &send) in &sends {
            match waits.get(signal) {
                Some(wait) => survey.pairs.push((send, *wait)),
                None => survey.faults.push(DivisionFault::SendUnheard { signal: (*signal).clone() }),
            }
        }
        let in_vain = waits.keys().filter(|signal| !sends.contains_key(*signal));
        survey.faults.extend(in_vain.map(|signal| DivisionFault::WaitInVain { signal: (*signal).clone() }));
        survey
    }

    fn plan(&mut self, order: &GlobalOrder<'_>, numbers: &BTreeMap<&TaskId, usize>, plan: &'a LocalPlan) {
        let role = &plan.role;
        let mut seen: BTreeSet<usize> = BTreeSet::new();
        for (index, step) in plan.steps.iter().enumerate() {
            let in_order = step.after.is_sorted_by(|a, b| a < b);
            if !in_order || step.after.last().is_some_and(|last| *last as usize >= index) {
                let (step, after) = (index as StepIndex, step.after.clone());
                self.faults.push(DivisionFault::BadAfter { role: role.clone(), step, after });
            }
            let StepAction::Task { id, spec } = &step.action else { continue };
            let problem = match numbers.get(id) {
                None => "which the mission does not have",
                Some(task) if !order.spec(*task).roles.contains(role) => "which is not its own",
                Some(task) if order.spec(*task) != spec => "which differs from the mission's",
                Some(task) if !seen.insert(*task) => "a second time",
                Some(_) => continue,
            };
            self.faults.push(DivisionFault::StrangeTask { role: role.clone(), task: id.clone(), problem });
        }
        for (task, _) in self.parts.keys().filter(|(task, own)| *own == role && !seen.contains(task)) {
            self.faults.push(DivisionFault::TaskMissing { role: role.clone(), task: order.id(*task).clone() });
        }
    }

    fn signals(
        &mut self,
        order: &GlobalOrder<'_>,
        numbers: &BTreeMap<&TaskId, usize>,
        plan: &'a LocalPlan,
        sends: &mut BTreeMap<&'a Signal, At<'a>>,
        waits: &mut BTreeMap<&'a Signal, At<'a>>,
    ) {
        let role = &plan.role;
        for (index, step) in plan.steps.iter().enumerate() {
            let (signal, own, found) = match &step.action {
                StepAction::Task { .. } => continue,
                StepAction::Send(signal) => (signal, &signal.from, &mut *sends),
                StepAction::Wait(signal) => (signal, &signal.to, &mut *waits),
            };
            let roles = numbers.get(&signal.task).map_or(&[][..], |task| &order.spec(*task).roles);
            let problem = if own != role {
                "is another role's to send or to await"
            } else if signal.from == signal.to {
                "goes to its own sender"
            } else if !roles.contains(&signal.from) {
                "is of a task in which its sender takes no part"
            } else if signal.kind == SignalKind::Ready && !roles.contains(&signal.to) {
                "is for a role that takes no part in the joint task"
            } else if found.insert(signal, (role, index)).is_some() {
                "stands there twice"
            } else {
                continue;
            };
            self.faults.push(DivisionFault::StrangeSignal { role: role.clone(), signal: signal.clone(), problem });
        }
    }
}

/// Second part of the check: all plans together.
struct Product<'a> {
    order: &'a GlobalOrder<'a>,
    division: &'a Division,
    part_numbers: BTreeMap<Part<'a>, usize>,
    pairs: Vec<(At<'a>, At<'a>)>,
}

/// Where the steps of each part stand.
#[derive(Default)]
struct PartSteps<'a> {
    task: Option<usize>,
    ready: BTreeMap<&'a RoleId, usize>,
    awaits: BTreeMap<&'a RoleId, usize>,
}

impl<'a> Product<'a> {
    fn faults(&self) -> Vec<DivisionFault> {
        let mut faults = Vec::new();
        let numbers: BTreeMap<&TaskId, usize> = (0..self.order.len()).map(|task| (self.order.id(task), task)).collect();
        let parts = self.part_steps(&numbers);
        self.check_rendezvous(&parts, &mut faults);
        let (steps, nodes) = self.step_graph();
        let Ok(sequence) = toposort(&steps, None) else {
            faults.push(self.cycle(&steps, &numbers));
            return faults;
        };
        let ended = self.ended_before(&steps, &sequence, &numbers);
        self.check_done(&nodes, &ended, &numbers, &mut faults);
        let Some(before) = self.task_order(&steps, &numbers, &mut faults) else { return faults };
        self.check_order(&before, &parts, &nodes, &ended, &mut faults);
        faults
    }

    fn action(&self, (role, index): At<'a>) -> &'a StepAction {
        &self.division.plans[role].steps[index].action
    }

    fn part_steps(&self, numbers: &BTreeMap<&TaskId, usize>) -> BTreeMap<Part<'a>, PartSteps<'a>> {
        let mut parts: BTreeMap<Part<'a>, PartSteps<'a>> = BTreeMap::new();
        for (role, plan) in &self.division.plans {
            for (index, step) in plan.steps.iter().enumerate() {
                match &step.action {
                    StepAction::Task { id, .. } => parts.entry((numbers[id], role)).or_default().task = Some(index),
                    StepAction::Send(signal) if signal.kind == SignalKind::Ready => {
                        parts.entry((numbers[&signal.task], role)).or_default().ready.insert(&signal.to, index);
                    }
                    StepAction::Wait(signal) if signal.kind == SignalKind::Ready => {
                        parts.entry((numbers[&signal.task], role)).or_default().awaits.insert(&signal.from, index);
                    }
                    StepAction::Send(_) | StepAction::Wait(_) => {}
                }
            }
        }
        parts
    }

    /// (b): before the step of a joint task stand a `ready` to, and one from, each partner.
    fn check_rendezvous(&self, parts: &BTreeMap<Part<'a>, PartSteps<'a>>, faults: &mut Vec<DivisionFault>) {
        for (&(task, role), part) in parts {
            let roles = &self.order.spec(task).roles;
            let needed: Vec<usize> = part.ready.values().chain(part.awaits.values()).copied().collect();
            let Some(first) = needed.iter().min() else {
                if roles.len() > 1 {
                    let partner = roles.iter().find(|other| *other != role).expect("a joint task has two roles");
                    faults.push(self.no_rendezvous(task, role, partner));
                }
                continue;
            };
            // What stands before the task in its own plan; nothing that is looked for stands before `first`.
            let steps = &self.division.plans[role].steps;
            let mut seen: BTreeSet<usize> = BTreeSet::new();
            let mut open: Vec<usize> = part.task.into_iter().collect();
            while let Some(index) = open.pop() {
                let sooner = steps[index].after.iter().map(|step| *step as usize);
                open.extend(sooner.filter(|step| step >= first && seen.insert(*step)));
            }
            let stands = |step: Option<&usize>| step.is_some_and(|step| seen.contains(step));
            for partner in roles.iter().filter(|other| *other != role) {
                if !stands(part.ready.get(partner)) || !stands(part.awaits.get(partner)) {
                    faults.push(self.no_rendezvous(task, role, partner));
                }
            }
        }
    }

    fn no_rendezvous(&self, task: usize, role: &RoleId, partner: &RoleId) -> DivisionFault {
        let (role, partner) = (role.clone(), partner.clone());
        DivisionFault::NoRendezvous { role, task: self.order.id(task).clone(), partner }
    }

    /// All steps, with `after` and with each send before its wait.
    fn step_graph(&self) -> (DiGraph<At<'a>, ()>, BTreeMap<At<'a>, NodeIndex>) {
        let mut graph = DiGraph::new();
        let mut nodes = BTreeMap::new();
        for (role, plan) in &self.division.plans {
            for (index, step) in plan.steps.iter().enumerate() {
                let node = graph.add_node((role, index));
                nodes.insert((role, index), node);
                for sooner in &step.after {
                    graph.add_edge(nodes[&(role, *sooner as usize)], node, ());
                }
            }
        }
        for (send, wait) in &self.pairs {
            graph.add_edge(nodes[send], nodes[wait], ());
        }
        (graph, nodes)
    }

    /// For each step, the parts that have ended when it begins, its own included.
    fn ended_before(
        &self,
        steps: &DiGraph<At<'a>, ()>,
        sequence: &[NodeIndex],
        numbers: &BTreeMap<&TaskId, usize>,
    ) -> Vec<Bits> {
        let mut ended = vec![Bits::below(self.part_numbers.len()); steps.node_count()];
        for &node in sequence {
            let mut known = std::mem::replace(&mut ended[node.index()], Bits::below(0));
            for sooner in steps.neighbors_directed(node, petgraph::Direction::Incoming) {
                known.extend(&ended[sooner.index()]);
            }
            if let StepAction::Task { id, .. } = self.action(steps[node]) {
                known.insert(self.part_numbers[&(numbers[id], steps[node].0)]);
            }
            ended[node.index()] = known;
        }
        ended
    }

    fn check_done(
        &self,
        nodes: &BTreeMap<At<'a>, NodeIndex>,
        ended: &[Bits],
        numbers: &BTreeMap<&TaskId, usize>,
        faults: &mut Vec<DivisionFault>,
    ) {
        for (send, _) in &self.pairs {
            let StepAction::Send(signal) = self.action(*send) else { continue };
            let part = self.part_numbers[&(numbers[&signal.task], &signal.from)];
            if signal.kind == SignalKind::Done && !ended[nodes[send].index()].contains(part) {
                faults.push(DivisionFault::TooSoon { signal: signal.clone() });
            }
        }
    }

    /// `<`: the order of tasks in the graph where all steps of a task, and of a joint task in all roles, are one. For each
    /// task, the tasks before it; nothing if there is a cycle.
    fn task_order(
        &self,
        steps: &DiGraph<At<'a>, ()>,
        numbers: &BTreeMap<&TaskId, usize>,
        faults: &mut Vec<DivisionFault>,
    ) -> Option<Vec<Bits>> {
        let tasks = self.order.len();
        let mut graph: DiGraph<(), ()> = DiGraph::new();
        for _ in 0..tasks {
            graph.add_node(());
        }
        let merged: Vec<NodeIndex> = steps
            .node_weights()
            .map(|at| match self.action(*at) {
                StepAction::Task { id, .. } => NodeIndex::new(numbers[id]),
                StepAction::Send(signal) | StepAction::Wait(signal) => match signal.kind {
                    SignalKind::Ready => NodeIndex::new(numbers[&signal.task]),
                    SignalKind::Done => graph.add_node(()),
                },
            })
            .collect();
        for (from, to) in steps.edge_indices().filter_map(|edge| steps.edge_endpoints(edge)) {
            let (from, to) = (merged[from.index()], merged[to.index()]);
            if from != to {
                graph.add_edge(from, to, ());
            }
        }
        let Ok(sequence) = toposort(&graph, None) else {
            let around = tarjan_scc(&graph).into_iter().find(|component| component.len() > 1).unwrap_or_default();
            let ids = around.iter().filter(|node| node.index() < tasks).map(|node| self.order.id(node.index()));
            faults.push(DivisionFault::Cycle { tasks: listed(ids) });
            return None;
        };
        let mut before = vec![Bits::below(tasks); graph.node_count()];
        for node in sequence {
            let mut known = std::mem::replace(&mut before[node.index()], Bits::below(0));
            for sooner in graph.neighbors_directed(node, petgraph::Direction::Incoming) {
                known.extend(&before[sooner.index()]);
                if sooner.index() < tasks {
                    known.insert(sooner.index());
                }
            }
            before[node.index()] = known;
        }
        before.truncate(tasks);
        Some(before)
    }

    fn cycle(&self, steps: &DiGraph<At<'a>, ()>, numbers: &BTreeMap<&TaskId, usize>) -> DivisionFault {
        let around = tarjan_scc(steps).into_iter().find(|component| component.len() > 1).unwrap_or_default();
        let task = |node: NodeIndex| match self.action(steps[node]) {
            StepAction::Task { id, .. } => id,
            StepAction::Send(signal) | StepAction::Wait(signal) => &signal.task,
        };
        let tasks: BTreeSet<usize> = around.into_iter().map(|node| numbers[task(node)]).collect();
        DivisionFault::Cycle { tasks: listed(tasks.into_iter().map(|task| self.order.id(task))) }
    }

    /// (d) and (e)
    fn check_order(
        &self,
        before: &[Bits],
        parts: &BTreeMap<Part<'a>, PartSteps<'a>>,
        nodes: &BTreeMap<At<'a>, NodeIndex>,
        ended: &[Bits],
        faults: &mut Vec<DivisionFault>,
    ) {
        for (&(task, role), part) in parts {
            let at = |step: &usize| &ended[nodes[&(role, *step)].index()];
            let begins = part.task.as_ref().map(at).expect("every part has its task");
            let ready: Vec<&Bits> = part.ready.values().map(at).collect();
            let roles = &self.order.spec(task).roles;
            let wanted = self.order.before(task);
            let mut sooner = before[task].clone();
            sooner.extend(wanted);
            for earlier in sooner.descending() {
                for other in &self.order.spec(earlier).roles {
                    let number = self.part_numbers[&(earlier, other)];
                    let opens = other == role || !roles.contains(other);
                    let kept = begins.contains(number) || !(opens || wanted.contains(earlier));
                    let kept_ready = !opens || ready.iter().all(|ready| ready.contains(number));
                    // What a task between the two broke already is told there alone.
                    if kept && kept_ready || !kept && self.broken_between(earlier, task, begins) {
                        continue;
                    }
                    let (role, other) = (role.clone(), other.clone());
                    let (task, earlier) = (self.order.id(task).clone(), self.order.id(earlier).clone());
                    faults.push(match kept {
                        false => DivisionFault::OutOfOrder { role, task, other, earlier },
                        true => DivisionFault::ReadyTooSoon { role, task, other, earlier },
                    });
                }
            }
        }
    }
}

impl Product<'_> {
    /// Whether some task stands between the two and has ended before `later` begins, so that `earlier` should have ended
    /// before that one.
    fn broken_between(&self, earlier: usize, later: usize, begins: &Bits) -> bool {
        self.order.before(later).descending().filter(|between| self.order.precedes(earlier, *between)).any(|between| {
            let mut parts = self.order.spec(between).roles.iter().map(|role| self.part_numbers[&(between, role)]);
            parts.any(|part| begins.contains(part))
        })
    }
}

fn listed<'i>(ids: impl Iterator<Item = &'i TaskId>) -> String {
    ids.map(TaskId::as_str).collect::<Vec<_>>().join(", ")
}
