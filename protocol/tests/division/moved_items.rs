//! Random missions that hand items on: an item moves only when the ledger knows enough to tell that it may have.

use crate::properties::{SeededRng, run_from, small_trees, trees};
use crate::support::{Event, Explored, Team, Tree, explore_from, mission, reference_order};
use consort_protocol::auction::{AuctionId, AuctionRecord};
use consort_protocol::ids::{ItemId, RequestId, RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Branch, Command, Ledger, RolePhase, Submission};
use consort_protocol::mission::{Domain, Mission, RoleKind, TaskBody};
use consort_protocol::plan::{
    Division, DivisionError, DivisionViolation, check_division, divide_and_check, item_moves,
};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// The mission of a tree, in which up to two items are moved, by tasks in order, to roles and out of the mission.
fn moving(tree: &Tree, seed: u64) -> Mission {
    let mut dice = SeededRng(seed);
    let before = reference_order(tree);
    let mut mission = mission(tree);
    let roles: Vec<_> = mission.roles.keys().cloned().collect();
    for item in ["sample", "tray"] {
        let item = ItemId::new(item).unwrap();
        let (mut task, mut last) = (0, None::<usize>);
        for node in &mut mission.tasks {
            let TaskBody::Elementary(spec) = &mut node.body else { continue };
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

const AWARD: Epoch = Epoch { term: 1, index: 2 };

/// A ledger with the mission, of which every managed role is held and confirmed by a robot of its name.
fn held(mission: &Mission, division: &Division) -> Ledger {
    let mut ledger = Ledger::default();
    let submission = Submission::of(RequestId::new("a").unwrap(), mission.clone(), division.clone());
    ledger.apply(Epoch { term: 1, index: 1 }, Command::Submit(Box::new(submission)));
    let mission = ledger.missions().next().unwrap().id.clone();
    let auction = AuctionId { mission: mission.clone(), term: 1, round: 1 };
    let auction =
        AuctionRecord { auction, at_ms: 0, entries: vec![], omitted: 0, chosen: BTreeMap::new(), failure: None };
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
    fn no_item_moves_before_the_ledger_knows_that_it_may(tree in trees(6, 30), seed: u64) {
        let before = reference_order(&tree);
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
        let before = reference_order(&tree);
        let mission = moving(&tree, seed);
        let division = divide_and_check(&mission).unwrap();
        let moves: Vec<_> = item_moves(&mission, &division).unwrap().into_values().flatten().collect();
        let explored = explore_from(Team::of(&division, &before).watching(&moves), 3_000);
        prop_assert!(!matches!(explored, Explored::Wrong(_)), "{:?}", explored);
    }

    /// Whatever was reported so far: whoever may really have an item is among those of whom the ledger says so, and of whom
    /// the ledger is certain nobody else can have it.
    #[test]
    fn the_ledger_is_never_wrong_about_who_has_what(tree in trees(5, 20), seed: u64) {
        let before = reference_order(&tree);
        let mission = moving(&tree, seed);
        let division = divide_and_check(&mission).unwrap();
        let moves = item_moves(&mission, &division).unwrap();
        let mut ledger = held(&mission, &division);
        let id = ledger.missions().next().unwrap().id.clone();
        let mut dice = SeededRng(seed);
        let mut team = Team::of(&division, &before);
        loop {
            let events = team.events();
            if events.is_empty() {
                break;
            }
            let event = events[dice.below(events.len())];
            team.apply(event).map_err(TestCaseError::fail)?;
            if let Event::Report(robot) = event {
                let role = division.plans.keys().nth(robot).unwrap().clone();
                let epoch = if mission.roles[&role].kind == RoleKind::Managed { AWARD } else { Epoch::default() };
                let ended = team.known(robot).clone();
                let (mission, branch) = (id.clone(), Branch::Main);
                ledger.apply(AWARD, Command::Progress { mission, role, epoch, branch, ended });
            }
            let entry = ledger.mission(&id).unwrap();
            if entry.state.is_final() {
                break; // robots have no more to do
            }
            let said = entry.custody();
            for (item, moves) in &moves {
                let mut keepers: BTreeSet<Option<&RoleId>> = [None].into();
                let mut delivered = false;
                for (index, moved) in moves.iter().enumerate() {
                    let (begun, ended) = team.begun_and_ended(&moved.task);
                    if ended {
                        keepers.clear();
                    }
                    if begun {
                        keepers.insert(moved.receiver.as_ref());
                    }
                    let over = |role: &RoleId| entry.roles[role].phase == RolePhase::Ended;
                    delivered = index + 1 == moves.len() && ended && moved.receiver.as_ref().is_some_and(over);
                }
                let said: Vec<_> = said.iter().filter(|kept| kept.item == *item).collect();
                for keeper in keepers.iter().flatten().filter(|_| !delivered) {
                    let managed = mission.roles[*keeper].kind == RoleKind::Managed;
                    prop_assert!(!managed || said.iter().any(|kept| kept.role == **keeper), "{} {:?}", keeper, said);
                }
                for certain in said.iter().filter(|kept| kept.certain) {
                    prop_assert_eq!(&keepers, &[Some(&certain.role)].into(), "{:?}", said);
                }
            }
        }
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
                let guards = |fault: &DivisionViolation| matches!(fault, DivisionViolation::GuardMismatch { .. });
                prop_assert!(faults.violations.iter().all(guards), "{}", faults);
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
        if let TaskBody::Elementary(spec) = &mut node.body {
            spec.releases.insert(ItemId::new("sample").unwrap());
        }
    }
    let problems = mission.check(&Domain::hospital()).unwrap_err().diagnostics;
    let said: Vec<String> = problems.iter().map(ToString::to_string).collect();
    assert_eq!(said, ["t1: touches the item `sample`, as does t0, and neither must come first; put them in sequence"]);
}
