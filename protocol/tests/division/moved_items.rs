//! Random missions that move items: an item moves only when the ledger contains enough steps to
//! show that it may have moved.

use crate::domain;
use crate::properties::{SeededRng, run_from, small_trees, trees};
use crate::team::{Event, Explored, Team, explore_from};
use crate::trees::{Tree, mission, reference_order};
use consort_protocol::auction::{AuctionId, AuctionRecord};
use consort_protocol::ids::{ItemId, RequestId, RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Branch, Command, Ledger, RolePhase, Submission};
use consort_protocol::mission::{Mission, RoleKind, TaskBody};
use consort_protocol::plan::{
    Division, DivisionError, DivisionViolation, check_division, divide_and_check, item_moves,
};
use proptest::prelude::*;
use std::collections::BTreeSet;

/// Creates the mission of a tree in which ordered tasks move up to two items, to roles and out of
/// the mission.
fn mission_with_moves(tree: &Tree, seed: u64) -> Mission {
    let mut rng = SeededRng(seed);
    let before = reference_order(tree);
    let mut mission = mission(tree);
    let roles: Vec<_> = mission.roles.keys().cloned().collect();
    for item in ["parcel", "tray"] {
        let item = ItemId::new(item).unwrap();
        let (mut task, mut last) = (0, None::<usize>);
        for node in &mut mission.tasks {
            let TaskBody::Elementary(spec) = &mut node.body else { continue };
            if rng.below(2) == 0 && last.is_none_or(|last| before[last][task]) {
                match rng.below(roles.len() + 1) {
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

const AWARD: Epoch = Epoch { term: 1, index: 2 };

/// Creates a ledger with the mission; a robot of the same name holds and has confirmed each managed
/// role.
fn ledger_with_holders(mission: &Mission, division: &Division) -> Ledger {
    let mut ledger = Ledger::default();
    let submission = Submission::of(RequestId::new("a").unwrap(), mission.clone(), division.clone());
    ledger.apply(Epoch { term: 1, index: 1 }, Command::Submit(Box::new(submission)));
    let mission = ledger.missions().next().unwrap().id.clone();
    let auction = AuctionId { mission: mission.clone(), term: 1, round: 1 };
    let auction = AuctionRecord::empty(auction);
    let roles = ledger.mission(&mission).unwrap().open_roles();
    let holders = roles.iter().map(|role| (role.clone(), RobotId::new(role.as_str()).unwrap())).collect();
    ledger.apply(AWARD, Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction });
    for role in roles {
        ledger.apply(
            AWARD,
            Command::Accept { mission: mission.clone(), role, epoch: AWARD, incarnation: 1, from_checkpoint: false },
        );
    }
    ledger
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_item_moves_before_its_guards_are_met(tree in trees(6, 30), seed: u64) {
        let before = reference_order(&tree);
        let mission = mission_with_moves(&tree, seed);
        let division = divide_and_check(&mission).map_err(|error| TestCaseError::fail(error.to_string()))?;
        let moves: Vec<_> = item_moves(&mission, &division).unwrap().into_values().flatten().collect();
        for walk in 0..4 {
            let team = Team::of(&division, &before).checking_guards(&moves);
            prop_assert_eq!(run_from(team, seed ^ walk, walk % 2 == 1), Ok(()));
        }
    }

    #[test]
    fn a_small_mission_ends_in_any_order_of_reports(tree in small_trees(), seed: u64) {
        let before = reference_order(&tree);
        let mission = mission_with_moves(&tree, seed);
        let division = divide_and_check(&mission).unwrap();
        let moves: Vec<_> = item_moves(&mission, &division).unwrap().into_values().flatten().collect();
        let explored = explore_from(Team::of(&division, &before).checking_guards(&moves), 3_000);
        prop_assert!(!matches!(explored, Explored::Wrong(_)), "{:?}", explored);
    }

    /// For any set of reports: each role that may actually have an item is listed in the custody of
    /// the ledger, and if custody is certain, no other role can have the item.
    #[test]
    fn custody_in_the_ledger_is_never_wrong(tree in trees(5, 20), seed: u64) {
        let before = reference_order(&tree);
        let mission = mission_with_moves(&tree, seed);
        let division = divide_and_check(&mission).unwrap();
        let moves = item_moves(&mission, &division).unwrap();
        let mut ledger = ledger_with_holders(&mission, &division);
        let id = ledger.missions().next().unwrap().id.clone();
        let mut rng = SeededRng(seed);
        let mut team = Team::of(&division, &before);
        loop {
            let events = team.events();
            if events.is_empty() {
                break;
            }
            let event = events[rng.below(events.len())];
            team.apply(event).map_err(|violation| TestCaseError::fail(violation.0))?;
            if let Event::Report(robot) = event {
                let role = division.plans.keys().nth(robot).unwrap().clone();
                let epoch = if mission.roles[&role].kind == RoleKind::Managed { AWARD } else { Epoch::default() };
                let ended = team.known(robot).clone();
                let (mission, branch) = (id.clone(), Branch::Main);
                ledger.apply(AWARD, Command::Progress { mission, role, epoch, branch, ended, outcomes: Default::default() });
            }
            let entry = ledger.mission(&id).unwrap();
            if entry.state.is_final() {
                break; // no robot has a task left
            }
            let custody = entry.custody();
            for (item, moves) in &moves {
                let mut possible_custodians: BTreeSet<Option<&RoleId>> = [None].into();
                let mut delivered = false;
                for (index, item_move) in moves.iter().enumerate() {
                    let (begun, ended) = team.begun_and_ended(&item_move.task);
                    if ended {
                        possible_custodians.clear();
                    }
                    if begun {
                        possible_custodians.insert(item_move.receiver.as_ref());
                    }
                    let over = |role: &RoleId| entry.roles[role].phase == RolePhase::Ended;
                    delivered = index + 1 == moves.len() && ended && item_move.receiver.as_ref().is_some_and(over);
                }
                let custody: Vec<_> = custody.iter().filter(|held| held.item == *item).collect();
                for custodian in possible_custodians.iter().flatten().filter(|_| !delivered) {
                    let managed = mission.roles[*custodian].kind == RoleKind::Managed;
                    prop_assert!(!managed || custody.iter().any(|held| held.role == **custodian), "{} {:?}", custodian, custody);
                }
                for certain in custody.iter().filter(|held| held.certain) {
                    prop_assert_eq!(&possible_custodians, &[Some(&certain.role)].into(), "{:?}", custody);
                }
            }
        }
    }

    #[test]
    fn a_missing_guard_is_detected(tree in trees(5, 16), seed: u64) {
        let mission = mission_with_moves(&tree, seed);
        let division = divide_and_check(&mission).unwrap();
        for (role, plan) in &division.plans {
            for guard in &plan.guarded {
                let mut unguarded = division.clone();
                unguarded.plans.get_mut(role).unwrap().guarded.remove(guard);
                let Err(DivisionError::Unsound(violations)) = check_division(&mission, &unguarded) else {
                    return Err(TestCaseError::fail(format!("step {guard} of {role} need not be guarded")));
                };
                let guards = |violation: &DivisionViolation| matches!(violation, DivisionViolation::GuardMismatch { .. });
                prop_assert!(violations.violations.iter().all(guards), "{}", violations);
            }
        }
    }
}

#[test]
fn unordered_moves_of_an_item_are_rejected_and_both_tasks_named() {
    let tree =
        Tree::Sequence(vec![Tree::Unordered(vec![Tree::Task(vec![1]), Tree::Task(vec![2])]), Tree::Task(vec![1])]);
    let mut mission = mission(&tree);
    for node in &mut mission.tasks {
        if let TaskBody::Elementary(spec) = &mut node.body {
            spec.releases.insert(ItemId::new("parcel").unwrap());
        }
    }
    let problems = mission.check(&domain()).unwrap_err().diagnostics;
    let custody: Vec<String> = problems.iter().map(ToString::to_string).collect();
    assert_eq!(
        custody,
        ["t1: touches the item `parcel`, as does t0, and the two tasks are unordered; put them in sequence"]
    );
}
