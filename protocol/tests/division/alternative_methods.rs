//! Random missions with alternatives: other roles are not affected.

use crate::domain;
use crate::properties::{run_from, small_trees, trees};
use crate::team::{Explored, Team, explore_from};
use crate::trees::{Tree, mission, reference_order};
use consort_protocol::ids::{RoleId, TaskId};
use consort_protocol::mission::{AlternativeMethod, Mission, RoleKind, TaskBody};
use consort_protocol::plan::{DivisionError, DivisionViolation, check_division, divide_and_check};
use proptest::prelude::*;

/// Creates the mission of a tree, with two alternatives for every method that is local to a single
/// managed role.
fn with_alternatives(tree: &Tree) -> Mission {
    let mut mission = mission(tree);
    for index in 0..mission.tasks.len() {
        let below: Vec<_> = mission.elementary_below(index).into_iter().map(|(_, spec)| spec.clone()).collect();
        let first = below[0].clone();
        let local = first.roles.len() == 1 && below.iter().all(|spec| spec.roles == first.roles);
        let managed = mission.roles[&first.roles[0]].kind == RoleKind::Managed;
        let id = mission.tasks[index].id.clone();
        if let TaskBody::Abstract(method) = &mut mission.tasks[index].body
            && local
            && managed
        {
            let other = |number: usize| AlternativeMethod {
                tasks: vec![(TaskId::new(format!("{id}-other-{number}")).unwrap(), first.clone())],
            };
            method.alternatives = vec![other(1), other(2)];
        }
    }
    mission
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_role_that_switches_to_an_alternative_blocks_no_role(tree in trees(3, 30), seed: u64) {
        let before = reference_order(&tree);
        let division = divide_and_check(&with_alternatives(&tree))
            .map_err(|error| TestCaseError::fail(error.to_string()))?;
        for walk in 0..4 {
            prop_assert_eq!(run_from(Team::of(&division, &before), seed ^ walk, walk % 2 == 1), Ok(()));
        }
    }

    #[test]
    fn every_interleaving_with_alternatives_ends_in_order(tree in small_trees()) {
        let before = reference_order(&tree);
        let division = divide_and_check(&with_alternatives(&tree)).unwrap();
        let explored = explore_from(Team::of(&division, &before), 3_000);
        prop_assert!(!matches!(explored, Explored::Wrong(_)), "{:?}", explored);
    }

    #[test]
    fn inner_alternatives_come_before_outer_ones(tree in trees(2, 30)) {
        for plan in divide_and_check(&with_alternatives(&tree)).unwrap().plans.values() {
            for (index, outer) in plan.alternatives.iter().enumerate() {
                for later in &plan.alternatives[index + 1..] {
                    let inside = later.replaces.len() < outer.replaces.len() && later.replaces.is_subset(&outer.replaces);
                    prop_assert!(!inside, "{:?} before {:?}", outer.replaces, later.replaces);
                }
            }
        }
    }
}

#[test]
fn alternatives_that_differ_from_the_mission_are_rejected() {
    let tree =
        Tree::Sequence(vec![Tree::Sequence(vec![Tree::Task(vec![1]), Tree::Task(vec![1])]), Tree::Task(vec![2])]);
    let mission = with_alternatives(&tree);
    let role = RoleId::new("r1").unwrap();
    let mut division = divide_and_check(&mission).unwrap();
    assert_eq!(division.plans[&role].alternatives.len(), 2);
    division.plans.get_mut(&role).unwrap().alternatives[0].replaces.clear();
    let Err(DivisionError::Unsound(violations)) = check_division(&mission, &division) else {
        panic!("the check must fail")
    };
    assert_eq!(violations.violations, [DivisionViolation::AlternativeMismatch { role }]);
}

#[test]
fn only_local_methods_may_have_alternatives() {
    let tree = Tree::Sequence(vec![Tree::Task(vec![1]), Tree::Task(vec![2])]);
    let mut mission = mission(&tree);
    let TaskBody::Elementary(other) = mission.tasks[1].body.clone() else { panic!("a task") };
    let TaskBody::Abstract(method) = &mut mission.tasks[0].body else { panic!("the root") };
    method.alternatives = vec![AlternativeMethod { tasks: vec![(TaskId::new("other").unwrap(), other)] }];
    let diagnostic = mission.check(&domain()).unwrap_err().diagnostics[0].to_string();
    assert_eq!(
        diagnostic,
        "root: has alternatives, so a single managed role must execute its tasks and theirs, and none may touch an item; but t1 is \
         executed by r2, and the first task by r1"
    );
}
