//! The global plan: which elementary task comes before which.
//!
//! Two tasks are ordered if the method in which their branches part is sequential. To this one rule is added: of two
//! joint tasks that share a role and are in no order, the one that stands first in the file comes first. Otherwise
//! one robot could stand ready for the first and its partner for the second, and both would stand for ever.

use super::bits::Bits;
use crate::ids::{ItemId, TaskId};
use crate::mission::{Mission, MissionDiagnostic, MissionErrorKind, MissionErrors, TaskBody, TaskOrder, TaskSpec};
use std::collections::BTreeMap;

/// The strict partial order of a mission's elementary tasks. Tasks are numbered in the order of the file, which is a
/// linear extension of it.
#[derive(Debug, Clone)]
pub struct GlobalOrder<'m> {
    tasks: Vec<(&'m TaskId, &'m TaskSpec)>,
    before: Vec<Bits>,
}

impl<'m> GlobalOrder<'m> {
    /// The order of a mission's tasks.
    ///
    /// # Errors
    /// [`MissionErrors`] if the mission's tree is none, or if two tasks that touch one item are in no order.
    pub fn of(mission: &'m Mission) -> Result<Self, MissionErrors> {
        mission.check_structure()?;
        let tasks = mission.elementary();
        let mut before = vec![Bits::below(tasks.len()); tasks.len()];
        order_by_methods(mission, &mut before);
        let mut order = Self { tasks, before };
        order.close_with_joint_tasks();
        let problems = order.unordered_moves();
        if problems.is_empty() {
            Ok(order)
        } else {
            Err(MissionErrors { mission: mission.name.to_string(), diagnostics: problems })
        }
    }

    /// The tasks that move each item, in their order.
    pub fn moves(&self) -> BTreeMap<&'m ItemId, Vec<usize>> {
        let mut moves: BTreeMap<&ItemId, Vec<usize>> = BTreeMap::new();
        for (task, (_, spec)) in self.tasks.iter().enumerate() {
            for item in spec.items() {
                moves.entry(item).or_default().push(task);
            }
        }
        moves
    }

    /// Numbers extend the order, so it is enough to compare neighbours.
    fn unordered_moves(&self) -> Vec<MissionDiagnostic> {
        let mut problems = Vec::new();
        for (item, tasks) in self.moves() {
            for pair in tasks.windows(2).filter(|pair| !self.precedes(pair[0], pair[1])) {
                let fault = MissionErrorKind::ItemUnordered { item: item.clone(), other: self.id(pair[0]).clone() };
                problems.push(MissionDiagnostic { path: self.id(pair[1]).to_string(), kind: fault });
            }
        }
        problems
    }

    /// The elementary tasks by number.
    pub fn tasks(&self) -> &[(&'m TaskId, &'m TaskSpec)] {
        &self.tasks
    }

    /// Whether the task numbered `first` must have ended in all its roles before any role of `second` begins.
    ///
    /// # Panics
    /// If there is no task of such a number.
    pub fn precedes(&self, first: usize, second: usize) -> bool {
        self.before[second].contains(first)
    }

    /// The tasks before this one.
    pub(super) fn before(&self, task: usize) -> &Bits {
        &self.before[task]
    }

    pub(super) fn len(&self) -> usize {
        self.tasks.len()
    }

    pub(super) fn id(&self, task: usize) -> &'m TaskId {
        self.tasks[task].0
    }

    pub(super) fn spec(&self, task: usize) -> &'m TaskSpec {
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
            // All earlier sets are closed by now.
            for earlier in before.clone().descending() {
                before.extend(&self.before[earlier]);
            }
            self.before[later] = before;
        }
    }
}

/// Within a sequential method, all of a child comes after all of the children before it. Elementary tasks below one
/// task have consecutive numbers.
fn order_by_methods(mission: &Mission, before: &mut [Bits]) {
    enum Visit {
        Enter(usize),
        /// The sequential method whose first number is this; the child just left began at that.
        Leave {
            start: usize,
            child_at: usize,
        },
    }
    let mut next = 0;
    let mut open = vec![(Visit::Enter(0), None::<usize>)];
    // Each entry carries the first number of the sequential method it stands in, if it stands in one.
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
