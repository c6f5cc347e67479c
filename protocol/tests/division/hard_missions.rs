//! Missions that are hard to divide, or large.

use crate::removed_signals::without_signal;
use crate::team::{Explored, explore_all_states};
use crate::trees::{Sequence, Task, Unordered, mission, reference_order};
use consort_protocol::ids::TaskId;
use consort_protocol::plan::{
    DivisionError, LocalPlan, PlanProgress, Signal, SignalKind, StepAction, check_division, divide, divide_and_check,
};
use std::time::{Duration, Instant};

/// Formats the steps: `open_box`, `!done:…` for a send, `?done:…` for a wait, each with its
/// predecessors.
fn steps_text(plan: &LocalPlan) -> Vec<String> {
    let line = |step: &consort_protocol::plan::Step| match &step.action {
        StepAction::Task { id, .. } => format!("{id} {:?}", step.after),
        StepAction::Send(signal) => format!("!{signal} {:?}", step.after),
        StepAction::Wait(signal) => format!("?{signal} {:?}", step.after),
    };
    plan.steps.iter().map(line).collect()
}

#[test]
fn unordered_joint_tasks_follow_the_order_of_the_file() {
    let tree = Unordered(vec![Task(vec![0, 1]), Task(vec![1, 2]), Task(vec![2, 0])]);
    let (mission, before) = (mission(&tree), reference_order(&tree));
    let division = divide_and_check(&mission).unwrap();
    assert_eq!(explore_all_states(&division, &before, 50_000), Explored::Sound);
}

/// Example from the documentation of the check: if roles are ready before they have received the
/// end of a third role's work, four robots wait for each other although every order is kept.
#[test]
fn no_role_is_ready_while_a_third_role_is_at_work() {
    let (r, s, x, y) = (0, 1, 2, 3);
    let tree = Unordered(vec![
        Sequence(vec![Task(vec![r]), Task(vec![s, x])]),
        Sequence(vec![Task(vec![s]), Task(vec![r, y])]),
    ]);
    let (mission, before) = (mission(&tree), reference_order(&tree));
    let division = divide_and_check(&mission).unwrap();
    assert_eq!(explore_all_states(&division, &before, 50_000), Explored::Sound);

    let done = |task: &str, from: usize, to: usize| Signal {
        kind: SignalKind::Done,
        task: TaskId::new(task).unwrap(),
        from: crate::trees::role(from),
        to: crate::trees::role(to),
    };
    let without_signals = without_signal(&without_signal(&division, &done("t0", r, s)), &done("t2", s, r));
    assert!(matches!(explore_all_states(&without_signals, &before, 50_000), Explored::Wrong(_)));
    let Err(DivisionError::Unsound(error)) = check_division(&mission, &without_signals) else {
        panic!("the check must fail")
    };
    assert_eq!(
        error.to_string(),
        "the local plans of mission trial do not execute it:\n  \
         role r1 may signal `ready` for t1 before role r0 has ended t0\n  \
         role r0 may signal `ready` for t3 before role r1 has ended t2"
    );
}

#[test]
fn a_robot_that_is_ready_executes_no_other_task() {
    let tree = Unordered(vec![Task(vec![1, 2]), Task(vec![1])]);
    let division = divide_and_check(&mission(&tree)).unwrap();
    let mut progress = PlanProgress::new(division.plans[&crate::trees::role(1)].clone());
    assert_eq!(steps_text(progress.plan()), ["!ready:t0:r1:r2 []", "?ready:t0:r2:r1 [0]", "t0 [1]", "t1 []"]);
    assert_eq!(progress.permitted(), [0, 3]);
    progress.end(0).unwrap();
    assert_eq!(progress.committed().map(TaskId::as_str), Some("t0"));
    assert_eq!((progress.permitted(), progress.next()), (vec![], None));
    assert_eq!(progress.awaited_signals().iter().map(ToString::to_string).collect::<Vec<_>>(), ["ready:t0:r2:r1"]);
    let ready = progress.awaited_signals()[0].clone();
    assert!(progress.receive(&ready));
    progress.end(1).unwrap();
    progress.end(2).unwrap();
    assert_eq!((progress.committed(), progress.permitted()), (None, vec![3]));
}

#[test]
fn the_largest_missions_are_divided_in_time() {
    let all: Vec<usize> = (0..64).collect();
    let tasks_of_all_roles = || all.iter().map(|role| Task(vec![*role])).collect::<Vec<_>>();
    let trees = [
        // Rounds in which every role waits for every other role.
        Sequence((0..7).map(|_| Unordered(tasks_of_all_roles())).collect()),
        // Two halves: every task of the second half follows every task of the first half.
        Sequence((0..2).map(|_| Unordered((0..3).flat_map(|_| tasks_of_all_roles()).collect())).collect()),
        // Unordered joint tasks of 8 roles.
        Unordered((0..500).map(|n| Task((0..8).map(|k| (n * 5 + k * 8) % 64).collect())).collect()),
        Sequence((0..500).map(|n| Task(vec![n % 3])).collect()),
        Unordered((0..500).map(|n| Task(vec![n % 64])).collect()),
    ];
    for tree in trees {
        let mission = mission(&tree);
        let started = Instant::now();
        divide(&mission).unwrap();
        let divided = started.elapsed();
        divide_and_check(&mission).unwrap();
        let checked = started.elapsed() - divided;
        // Without optimisation, and with another test running in parallel.
        assert!(divided < Duration::from_secs(5) && checked < Duration::from_secs(10), "{divided:?} {checked:?}");
    }
}
