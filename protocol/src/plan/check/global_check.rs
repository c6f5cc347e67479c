//! Checks (b) to (e): all plans together.

use super::local_check::{Part, StepPosition};
use super::violation::DivisionViolation;
use crate::ids::{RoleId, TaskId};
use crate::mission::{Bits, GlobalOrder};
use crate::plan::local::{Division, SignalKind, StepAction};
use petgraph::algo::{tarjan_scc, toposort};
use petgraph::graph::{DiGraph, NodeIndex};
use std::collections::{BTreeMap, BTreeSet};

/// Second part of the check: all plans together.
pub(super) struct GlobalCheck<'a> {
    pub(super) order: &'a GlobalOrder<'a>,
    pub(super) division: &'a Division,
    pub(super) part_numbers: BTreeMap<Part<'a>, usize>,
    pub(super) pairs: Vec<(StepPosition<'a>, StepPosition<'a>)>,
}

/// Step indices of a part.
#[derive(Default)]
struct PartSteps<'a> {
    task: Option<usize>,
    ready: BTreeMap<&'a RoleId, usize>,
    awaits: BTreeMap<&'a RoleId, usize>,
}

impl<'a> GlobalCheck<'a> {
    pub(super) fn violations(&self) -> Vec<DivisionViolation> {
        let mut violations = Vec::new();
        let numbers: BTreeMap<&TaskId, usize> = (0..self.order.len()).map(|task| (self.order.id(task), task)).collect();
        let parts = self.part_steps(&numbers);
        self.check_rendezvous(&parts, &mut violations);
        let (steps, nodes) = self.step_graph();
        let Ok(sequence) = toposort(&steps, None) else {
            violations.push(self.cycle(&steps, &numbers));
            return violations;
        };
        let ended = self.ended_before(&steps, &sequence, &numbers);
        self.check_done(&nodes, &ended, &numbers, &mut violations);
        let Some(before) = self.task_order(&steps, &numbers, &mut violations) else { return violations };
        self.check_order(&before, &parts, &nodes, &ended, &mut violations);
        violations
    }

    fn action(&self, (role, index): StepPosition<'a>) -> &'a StepAction {
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

    /// Checks (b): a `ready` to, and a `ready` from, each partner precede the step of a joint task.
    fn check_rendezvous(&self, parts: &BTreeMap<Part<'a>, PartSteps<'a>>, violations: &mut Vec<DivisionViolation>) {
        for (&(task, role), part) in parts {
            let roles = &self.order.spec(task).roles;
            let needed: Vec<usize> = part.ready.values().chain(part.awaits.values()).copied().collect();
            let Some(first) = needed.iter().min() else {
                if roles.len() > 1 {
                    let partner =
                        roles.iter().find(|other| *other != role).expect("a joint task has at least two roles");
                    violations.push(self.no_rendezvous(task, role, partner));
                }
                continue;
            };
            // Predecessors of the task in its own plan; no step of interest precedes `first`.
            let steps = &self.division.plans[role].steps;
            let mut seen: BTreeSet<usize> = BTreeSet::new();
            let mut open: Vec<usize> = part.task.into_iter().collect();
            while let Some(index) = open.pop() {
                let sooner = steps[index].after.iter().map(|step| *step as usize);
                open.extend(sooner.filter(|step| step >= first && seen.insert(*step)));
            }
            let precedes = |step: Option<&usize>| step.is_some_and(|step| seen.contains(step));
            for partner in roles.iter().filter(|other| *other != role) {
                if !precedes(part.ready.get(partner)) || !precedes(part.awaits.get(partner)) {
                    violations.push(self.no_rendezvous(task, role, partner));
                }
            }
        }
    }

    fn no_rendezvous(&self, task: usize, role: &RoleId, partner: &RoleId) -> DivisionViolation {
        let (role, partner) = (role.clone(), partner.clone());
        DivisionViolation::MissingRendezvous { role, task: self.order.id(task).clone(), partner }
    }

    /// Builds the graph of all steps, with `after` and with each send before its wait.
    fn step_graph(&self) -> (DiGraph<StepPosition<'a>, ()>, BTreeMap<StepPosition<'a>, NodeIndex>) {
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

    /// Computes for each step the parts that have ended when it begins, including its own part.
    fn ended_before(
        &self,
        steps: &DiGraph<StepPosition<'a>, ()>,
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
        nodes: &BTreeMap<StepPosition<'a>, NodeIndex>,
        ended: &[Bits],
        numbers: &BTreeMap<&TaskId, usize>,
        violations: &mut Vec<DivisionViolation>,
    ) {
        for (send, _) in &self.pairs {
            let StepAction::Send(signal) = self.action(*send) else { continue };
            let part = self.part_numbers[&(numbers[&signal.task], &signal.from)];
            if signal.kind == SignalKind::Done && !ended[nodes[send].index()].contains(part) {
                violations.push(DivisionViolation::DoneTooEarly { signal: signal.clone() });
            }
        }
    }

    /// Computes `<`: the order of tasks in the graph where all steps of a task are merged, for a
    /// joint task those of all roles. Returns for each task the tasks before it, or `None` if there
    /// is a cycle.
    fn task_order(
        &self,
        steps: &DiGraph<StepPosition<'a>, ()>,
        numbers: &BTreeMap<&TaskId, usize>,
        violations: &mut Vec<DivisionViolation>,
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
            violations.push(DivisionViolation::Cycle { tasks: listed(ids) });
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

    fn cycle(&self, steps: &DiGraph<StepPosition<'a>, ()>, numbers: &BTreeMap<&TaskId, usize>) -> DivisionViolation {
        let around = tarjan_scc(steps).into_iter().find(|component| component.len() > 1).unwrap_or_default();
        let task = |node: NodeIndex| match self.action(steps[node]) {
            StepAction::Task { id, .. } => id,
            StepAction::Send(signal) | StepAction::Wait(signal) => &signal.task,
        };
        let tasks: BTreeSet<usize> = around.into_iter().map(|node| numbers[task(node)]).collect();
        DivisionViolation::Cycle { tasks: listed(tasks.into_iter().map(|task| self.order.id(task))) }
    }

    /// Checks (d) and (e).
    fn check_order(
        &self,
        before: &[Bits],
        parts: &BTreeMap<Part<'a>, PartSteps<'a>>,
        nodes: &BTreeMap<StepPosition<'a>, NodeIndex>,
        ended: &[Bits],
        violations: &mut Vec<DivisionViolation>,
    ) {
        for (&(task, role), part) in parts {
            let at = |step: &usize| &ended[nodes[&(role, *step)].index()];
            let begins = part.task.as_ref().map(at).expect("every part has a task step");
            let ready: Vec<&Bits> = part.ready.values().map(at).collect();
            let roles = &self.order.spec(task).roles;
            let wanted = self.order.before(task);
            let mut sooner = before[task].clone();
            sooner.extend(wanted);
            for earlier in sooner.descending() {
                for other in &self.order.spec(earlier).roles {
                    let number = self.part_numbers[&(earlier, other)];
                    let opens = other == role || !roles.contains(other);
                    let in_order = begins.contains(number) || !(opens || wanted.contains(earlier));
                    let ready_in_order = !opens || ready.iter().all(|ready| ready.contains(number));
                    // A violation that a task between the two already caused is reported there
                    // only.
                    if in_order && ready_in_order || !in_order && self.broken_between(earlier, task, begins) {
                        continue;
                    }
                    let (role, other) = (role.clone(), other.clone());
                    let (task, earlier) = (self.order.id(task).clone(), self.order.id(earlier).clone());
                    violations.push(match in_order {
                        false => DivisionViolation::OutOfOrder { role, task, other, earlier },
                        true => DivisionViolation::ReadyTooEarly { role, task, other, earlier },
                    });
                }
            }
        }
    }
}

impl GlobalCheck<'_> {
    /// Checks whether some task between the two has ended before `later` begins. Then `earlier`
    /// should have ended before that task, and the violation is reported there.
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
