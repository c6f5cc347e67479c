//! Random missions that hand items on: an item moves only when the ledger knows enough to tell that it may have.

use crate::properties::{Dice, run_from, small_trees, trees};
use crate::support::{Explored, Team, Tree, explore_from, mission, slow_order};
use consort_protocol::ids::ItemId;
use consort_protocol::mission::{Body, Domain, Mission};
use consort_protocol::plan::{DivisionError, DivisionFault, check_division, divide_and_check, item_moves};
use proptest::prelude::*;

/// The mission of a tree, in which up to two items are moved, by tasks in order, to roles and out of the mission.
fn moving(tree: &Tree, seed: u64) -> Mission {
    let mut dice = Dice(seed);
    let before = slow_order(tree);
    let mut mission = mission(tree);
    let roles: Vec<_> = mission.roles.keys().cloned().collect();
    for item in ["sample", "tray"] {
        let item = ItemId::new(item).unwrap();
        let (mut task, mut last) = (0, None::<usize>);
        for node in &mut mission.tasks {
            let Body::Elementary(spec) = &mut node.body else { continue };
            if dice.below(2) == 0 && last.is_none_or(|last| before[last][task]) {
                match dice.below(roles.len() + 1) {
                    role if role < roles.len() => drop(spec.acquires.insert(item.clone(), roles[role].clone())),
                    _ => drop(spec.releases.insert(item.clone())),
                }
                last = Some(task);
            }
            task += 1;
        }
    }
    mission
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_item_moves_before_the_ledger_knows_that_it_may(tree in trees(6, 30), seed: u64) {
        let before = slow_order(&tree);
        let mission = moving(&tree, seed);
        let division = divide_and_check(&mission).map_err(|error| TestCaseError::fail(error.to_string()))?;
        let moves: Vec<_> = item_moves(&mission, &division).unwrap().into_values().flatten().collect();
        for walk in 0..4 {
            let team = Team::of(&division, &before).watching(&moves);
            prop_assert_eq!(run_from(team, seed ^ walk, walk % 2 == 1), Ok(()));
        }
    }

    #[test]
    fn whatever_the_order_of_reports_a_small_mission_ends(tree in small_trees(), seed: u64) {
        let before = slow_order(&tree);
        let mission = moving(&tree, seed);
        let division = divide_and_check(&mission).unwrap();
        let moves: Vec<_> = item_moves(&mission, &division).unwrap().into_values().flatten().collect();
        let explored = explore_from(Team::of(&division, &before).watching(&moves), 3_000);
        prop_assert!(!matches!(explored, Explored::Wrong(_)), "{:?}", explored);
    }

    #[test]
    fn a_guard_that_is_left_out_is_missed(tree in trees(5, 16), seed: u64) {
        let mission = moving(&tree, seed);
        let division = divide_and_check(&mission).unwrap();
        for (role, plan) in &division.plans {
            for guard in &plan.guarded {
                let mut unguarded = division.clone();
                unguarded.plans.get_mut(role).unwrap().guarded.remove(guard);
                let Err(DivisionError::Unsound(faults)) = check_division(&mission, &unguarded) else {
                    return Err(TestCaseError::fail(format!("step {guard} of {role} need not be guarded")));
                };
                let guards = |fault: &DivisionFault| matches!(fault, DivisionFault::Guards { .. });
                prop_assert!(faults.faults.iter().all(guards), "{}", faults);
            }
        }
    }
}

#[test]
fn moves_of_one_item_in_no_order_are_refused_and_both_tasks_are_named() {
    let tree =
        Tree::Sequence(vec![Tree::Unordered(vec![Tree::Task(vec![1]), Tree::Task(vec![2])]), Tree::Task(vec![1])]);
    let mut mission = mission(&tree);
    for node in &mut mission.tasks {
        if let Body::Elementary(spec) = &mut node.body {
            spec.releases.insert(ItemId::new("sample").unwrap());
        }
    }
    let problems = mission.check(&Domain::hospital()).unwrap_err().problems;
    let said: Vec<String> = problems.iter().map(ToString::to_string).collect();
    assert_eq!(said, ["t1: touches the item `sample`, as does t0, and neither must come first; put them in sequence"]);
}
