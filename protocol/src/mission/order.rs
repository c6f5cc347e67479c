//! Global plan: the partial order of the elementary tasks.
//!
//! Two tasks are ordered if the method at which their branches separate is sequential. One rule is
//! added: if two joint tasks share a role and are unordered, the task that is listed first in the
//! file comes first. Otherwise a robot could wait, ready, for the first task while its partner
//! waits for the second task: a deadlock.

use super::bits::Bits;
use super::diagnostic::{MissionDiagnostic, MissionErrorKind, MissionErrors};
use super::model::{Mission, TaskBody, TaskOrder, TaskSpec};
use crate::ids::{ItemId, TaskId};
use std::collections::BTreeMap;

/// Strict partial order of a mission's elementary tasks. Tasks are numbered in the order of the
/// file, which is a linear extension of this order.
#[derive(Debug, Clone)]
pub struct GlobalOrder<'m> {
    tasks: Vec<(&'m TaskId, &'m TaskSpec)>,
    before: Vec<Bits>,
}

impl<'m> GlobalOrder<'m> {
    /// Computes the order of a mission's tasks.
    ///
    /// # Errors
    /// [`MissionErrors`] if the mission's tree is invalid, or if two tasks that touch the same item
    /// are unordered.
    pub fn of(mission: &'m Mission) -> Result<Self, MissionErrors> {
        mission.check_structure()?;
        let tasks = mission.elementary();
        let mut before = vec![Bits::below(tasks.len()); tasks.len()];
        order_by_methods(mission, &mut before);
        let mut order = Self { tasks, before };
        order.close_with_joint_tasks();
        let diagnostics = order.unordered_moves();
        if diagnostics.is_empty() {
            Ok(order)
        } else {
            Err(MissionErrors { mission: mission.name.to_string(), diagnostics })
        }
    }

    /// Returns the tasks that move each item, in their order.
    pub(crate) fn moves(&self) -> BTreeMap<&'m ItemId, Vec<usize>> {
        let mut moves: BTreeMap<&ItemId, Vec<usize>> = BTreeMap::new();
        for (task, (_, spec)) in self.tasks.iter().enumerate() {
            for item in spec.items() {
                moves.entry(item).or_default().push(task);
            }
        }
        moves
    }

    /// Finds unordered moves. Task numbers extend the order, so comparing neighbours is sufficient.
    fn unordered_moves(&self) -> Vec<MissionDiagnostic> {
        let mut diagnostics = Vec::new();
        for (item, tasks) in self.moves() {
            for pair in tasks.windows(2).filter(|pair| !self.precedes(pair[0], pair[1])) {
                let kind = MissionErrorKind::ItemUnordered { item: item.clone(), other: self.id(pair[0]).clone() };
                diagnostics.push(MissionDiagnostic { path: self.id(pair[1]).to_string(), kind });
            }
        }
        diagnostics
    }

    /// Returns the elementary tasks by number.
    pub fn tasks(&self) -> &[(&'m TaskId, &'m TaskSpec)] {
        &self.tasks
    }

    /// Checks whether task `first` must have ended in all its roles before any role of task
    /// `second` begins.
    ///
    /// # Panics
    /// If a task number is out of range.
    pub fn precedes(&self, first: usize, second: usize) -> bool {
        self.before[second].contains(first)
    }

    /// Returns the tasks before this task.
    pub(crate) fn before(&self, task: usize) -> &Bits {
        &self.before[task]
    }

    pub(crate) fn len(&self) -> usize {
        self.tasks.len()
    }

    pub(crate) fn id(&self, task: usize) -> &'m TaskId {
        self.tasks[task].0
    }

    pub(crate) fn spec(&self, task: usize) -> &'m TaskSpec {
        self.tasks[task].1
    }

    fn close_with_joint_tasks(&mut self) {
        for later in 0..self.len() {
            let mut before = self.before[later].clone();
            if self.spec(later).is_joint() {
                let shares = |earlier: &usize| {
                    let spec = self.spec(*earlier);
                    spec.is_joint() && spec.roles.iter().any(|role| self.spec(later).roles.contains(role))
                };
                (0..later).filter(shares).for_each(|earlier| before.insert(earlier));
            }
            // The sets of all earlier tasks are already closed.
            for earlier in before.clone().descending() {
                before.extend(&self.before[earlier]);
            }
            self.before[later] = before;
        }
    }
}

/// Orders the tasks of sequential methods: all tasks of a child come after all tasks of the
/// preceding children. The elementary tasks below a task have consecutive numbers.
fn order_by_methods(mission: &Mission, before: &mut [Bits]) {
    enum Visit {
        Enter(usize),
        /// End of a child. `start` is the first task number of the sequential method, `child_at`
        /// that of the child.
        Leave {
            start: usize,
            child_at: usize,
        },
    }
    let mut next = 0;
    let mut open = vec![(Visit::Enter(0), None::<usize>)];
    // Each entry contains the first task number of the enclosing sequential method, if any.
    while let Some((visit, sequence_from)) = open.pop() {
        match visit {
            Visit::Enter(index) => {
                if let Some(start) = sequence_from {
                    open.push((Visit::Leave { start, child_at: next }, None));
                }
                match &mission.tasks[index].body {
                    TaskBody::Elementary(_) => next += 1,
                    TaskBody::Abstract(method) => {
                        let from = (method.order == TaskOrder::Sequential).then_some(next);
                        open.extend(method.children.iter().rev().map(|child| (Visit::Enter(*child as usize), from)));
                    }
                }
            }
            Visit::Leave { start, child_at } => {
                for task in &mut before[child_at..next] {
                    (start..child_at).for_each(|earlier| task.insert(earlier));
                }
            }
        }
    }
}
