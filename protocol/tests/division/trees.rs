//! Trees of tasks: missions in their simplest form.

use consort_protocol::ids::{RoleId, TaskId, TaskType};
use consort_protocol::mission::{Method, Mission, Role, RoleKind, TaskBody, TaskIndex, TaskNode, TaskOrder, TaskSpec};
use std::collections::BTreeSet;

/// Tree of tasks: the order of a mission in its simplest form.
#[derive(Debug, Clone)]
pub(crate) enum Tree {
    /// Task of these roles, by number.
    Task(Vec<usize>),
    /// Subtrees in sequence.
    Sequence(Vec<Tree>),
    /// Unordered subtrees.
    Unordered(Vec<Tree>),
}

pub(crate) use Tree::{Sequence, Task, Unordered};

pub(crate) fn role(number: usize) -> RoleId {
    RoleId::new(format!("r{number}")).unwrap()
}

/// Creates the mission of a tree. Elementary tasks are named `t0`, `t1`, … in the order of the
/// tree. Roles with a number divisible by 3 are people, unless only people take part.
pub(crate) fn mission(tree: &Tree) -> Mission {
    fn add(tree: &Tree, tasks: &mut Vec<TaskNode>, leaves: &mut usize) -> TaskIndex {
        let index = tasks.len();
        let (order, below) = match tree {
            Task(roles) => {
                let spec = TaskSpec {
                    parameters: [("seconds".to_owned(), "1".to_owned())].into(),
                    ..TaskSpec::of(TaskType::new("wait").unwrap(), roles.iter().copied().map(role).collect())
                };
                tasks.push(TaskNode {
                    id: TaskId::new(format!("t{leaves}")).unwrap(),
                    body: TaskBody::Elementary(spec),
                });
                *leaves += 1;
                return index as TaskIndex;
            }
            Sequence(below) => (TaskOrder::Sequential, below),
            Unordered(below) => (TaskOrder::Unordered, below),
        };
        let id = TaskId::new(format!("a{index}")).unwrap();
        tasks.push(TaskNode { id, body: TaskBody::Abstract(Method::of(order, vec![])) });
        let children = below.iter().map(|tree| add(tree, tasks, leaves)).collect();
        tasks[index].body = TaskBody::Abstract(Method::of(order, children));
        index as TaskIndex
    }
    let mut tasks = Vec::new();
    add(tree, &mut tasks, &mut 0);
    let used: BTreeSet<usize> = leaves(tree).into_iter().flatten().collect();
    let people_only = used.iter().all(|number| number % 3 == 0);
    let kind = |number: &usize| match number % 3 {
        0 if !people_only => RoleKind::Unmanaged,
        _ => RoleKind::Managed,
    };
    let roles = used.iter().map(|number| (role(*number), Role::of(kind(number)))).collect();
    Mission {
        name: TaskId::new("trial").unwrap(),
        roles,
        ensembles: vec![],
        energy_max: None,
        tasks,
        results: Default::default(),
    }
}

/// Returns the roles of each elementary task.
pub(crate) fn leaves(tree: &Tree) -> Vec<Vec<usize>> {
    match tree {
        Task(roles) => vec![roles.clone()],
        Sequence(below) | Unordered(below) => below.iter().flat_map(leaves).collect(),
    }
}

/// Computes the order of tasks slowly: separating branches, then joint tasks by file order, then
/// the transitive closure.
pub(crate) fn reference_order(tree: &Tree) -> Vec<Vec<bool>> {
    fn mark(tree: &Tree, first: usize, before: &mut Vec<Vec<bool>>) -> usize {
        let (below, sequential) = match tree {
            Task(_) => return first + 1,
            Sequence(below) => (below, true),
            Unordered(below) => (below, false),
        };
        let mut next = first;
        for tree in below {
            let end = mark(tree, next, before);
            for earlier in (first..next).filter(|_| sequential) {
                before[earlier][next..end].fill(true);
            }
            next = end;
        }
        next
    }
    let roles = leaves(tree);
    let n = roles.len();
    let mut before = vec![vec![false; n]; n];
    mark(tree, 0, &mut before);
    for later in 0..n {
        for earlier in 0..later {
            let both_joint = roles[earlier].len() > 1 && roles[later].len() > 1;
            before[earlier][later] |= both_joint && roles[earlier].iter().any(|role| roles[later].contains(role));
        }
    }
    for via in 0..n {
        for from in 0..n {
            for to in 0..n {
                before[from][to] |= before[from][via] && before[via][to];
            }
        }
    }
    before
}
