//! Random missions: the divided mission is executed correctly in any order of events.

use crate::removed_signals::{signals, without_signal, without_step};
use crate::team::{Explored, OrderViolation, Team, explore_all_states};
use crate::trees::{Sequence, Task, Tree, Unordered, leaves, mission, reference_order};
use consort_protocol::mission::GlobalOrder;
use consort_protocol::plan::{
    Division, DivisionError, DivisionViolation, PlanProgress, SignalKind, StepAction, StepIndex, check_division,
    divide, divide_and_check,
};
use proptest::prelude::*;
use proptest::sample::subsequence;
use std::collections::BTreeSet;

/// Generates trees of up to about `size` tasks, of `roles` roles, with joint tasks of up to 3
/// roles.
pub(crate) fn trees(roles: usize, size: u32) -> impl Strategy<Value = Tree> {
    let one = (0..roles).prop_map(|role| Task(vec![role]));
    let joint = subsequence((0..roles).collect::<Vec<_>>(), 2..=3.min(roles)).prop_shuffle().prop_map(Task);
    prop_oneof![3 => one, 2 => joint].prop_recursive(4, size, 4, |below| {
        (any::<bool>(), prop::collection::vec(below, 1..=4))
            .prop_map(|(sequential, below)| if sequential { Sequence(below) } else { Unordered(below) })
    })
}

/// Generates trees that are small enough to visit every state.
pub(crate) fn small_trees() -> impl Strategy<Value = Tree> {
    let parts = |tree: &Tree| leaves(tree).iter().map(Vec::len).sum::<usize>();
    trees(4, 6).prop_filter("few parts", move |tree| (2..=8).contains(&parts(tree)))
}

/// Pseudo-random numbers from a seed.
pub(crate) struct SeededRng(pub(crate) u64);

impl SeededRng {
    pub(crate) fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % bound
    }
}

/// Executes a run to its end; `advised` robots follow `next`.
fn run(division: &Division, before: &[Vec<bool>], seed: u64, advised: bool) -> Result<(), OrderViolation> {
    run_from(Team::of(division, before), seed, advised)
}

/// Does the same from a given state.
pub(crate) fn run_from(mut team: Team<'_>, seed: u64, advised: bool) -> Result<(), OrderViolation> {
    let mut rng = SeededRng(seed);
    loop {
        let events = if advised { team.advised() } else { team.events() };
        if events.is_empty() {
            return if team.is_complete() { Ok(()) } else { Err(OrderViolation(format!("stuck: {:?}", team.key()))) };
        }
        team.apply(events[rng.below(events.len())])?;
        if rng.below(16) == 0 {
            // The robots restart from their stored progress.
            for robot in team.robots_mut() {
                let text = serde_json::to_string(robot).unwrap();
                *robot = serde_json::from_str::<PlanProgress>(&text).map_err(OrderViolation::of)?;
            }
        }
    }
}

fn violations_of(tree: &Tree, division: &Division) -> Option<Vec<DivisionViolation>> {
    match check_division(&mission(tree), division) {
        Ok(()) => None,
        Err(DivisionError::Unsound(error)) => Some(error.violations),
        Err(DivisionError::Mission(error)) => panic!("{error}"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_global_order_equals_the_slow_order(tree in trees(5, 40)) {
        let mission = mission(&tree);
        let (order, slow) = (GlobalOrder::of(&mission).unwrap(), reference_order(&tree));
        for (first, row) in slow.iter().enumerate() {
            for (second, before) in row.iter().enumerate() {
                prop_assert_eq!(order.precedes(first, second), *before, "t{} t{}", first, second);
            }
        }
    }

    #[test]
    fn every_division_passes_its_check(tree in trees(5, 40)) {
        let mission = mission(&tree);
        let division = divide_and_check(&mission).map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert_eq!(divide(&mission).unwrap(), division.clone(), "the same mission has the same division");
        // `after` is sorted and not redundant.
        for plan in division.plans.values() {
            let mut before: Vec<BTreeSet<StepIndex>> = Vec::new();
            for step in &plan.steps {
                for sooner in &step.after {
                    prop_assert!(!step.after.iter().any(|other| before[*other as usize].contains(sooner)));
                }
                let reached = step.after.iter().flat_map(|sooner| before[*sooner as usize].iter().chain([sooner]));
                before.push(reached.copied().collect());
            }
        }
    }

    #[test]
    fn a_division_adds_no_order_to_the_mission(tree in trees(4, 20)) {
        let (mission, slow) = (mission(&tree), reference_order(&tree));
        let division = divide(&mission).unwrap();
        for plan in division.plans.values() {
            let mut before: Vec<BTreeSet<usize>> = Vec::new();
            for step in &plan.steps {
                let mut known: BTreeSet<usize> =
                    step.after.iter().flat_map(|sooner| before[*sooner as usize].clone()).collect();
                if let StepAction::Task { id, .. } = &step.action {
                    let task = crate::team::number(id);
                    prop_assert!(known.iter().all(|earlier| slow[*earlier][task]), "{}", id);
                    known.insert(task);
                }
                before.push(known);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn large_missions_end_in_order_in_every_run(tree in trees(6, 40), seed: u64) {
        let before = reference_order(&tree);
        let division = divide_and_check(&mission(&tree)).unwrap();
        for walk in 0..4 {
            let run = run(&division, &before, seed ^ walk, walk % 2 == 1);
            prop_assert_eq!(run, Ok(()));
        }
    }

    #[test]
    fn every_interleaving_of_a_small_mission_ends_in_order(tree in small_trees()) {
        let before = reference_order(&tree);
        let division = divide_and_check(&mission(&tree)).unwrap();
        let explored = explore_all_states(&division, &before, 3_000);
        prop_assert!(!matches!(explored, Explored::Wrong(_)), "{:?}", explored);
    }

    #[test]
    fn no_signal_can_be_removed(tree in trees(5, 16)) {
        let division = divide(&mission(&tree)).unwrap();
        let joint = leaves(&tree).iter().any(|roles| roles.len() > 1);
        for (signal, ..) in signals(&division) {
            let Some(violations) = violations_of(&tree, &without_signal(&division, &signal)) else {
                return Err(TestCaseError::fail(format!("{signal} is redundant")));
            };
            let violates_order = |violation: &DivisionViolation| matches!(violation, DivisionViolation::OutOfOrder { .. });
            prop_assert!(joint || violations.iter().any(violates_order), "{:?}", violations);
        }
    }

    #[test]
    fn a_send_or_wait_alone_is_rejected(tree in trees(5, 16)) {
        let division = divide(&mission(&tree)).unwrap();
        for (signal, send, wait) in signals(&division) {
            let violations = violations_of(&tree, &without_step(&division, &send.0, send.1)).unwrap();
            let signal_of_fault = DivisionViolation::UnmatchedWait { signal: signal.clone() };
            prop_assert_eq!(violations, vec![signal_of_fault]);
            let violations = violations_of(&tree, &without_step(&division, &wait.0, wait.1)).unwrap();
            prop_assert_eq!(violations, vec![DivisionViolation::UnmatchedSend { signal: signal.clone() }]);

            for other in division.plans.keys().filter(|other| **other != signal.to) {
                let mut retargeted = division.clone();
                let step = &mut retargeted.plans.get_mut(&send.0).unwrap().steps[send.1];
                step.action = StepAction::Send(consort_protocol::plan::Signal { to: other.clone(), ..signal.clone() });
                prop_assert!(violations_of(&tree, &retargeted).is_some(), "{} to {}", signal, other);
            }
        }
    }

    /// All randomly damaged plans that pass the check execute correctly.
    #[test]
    fn plans_that_pass_the_check_execute_correctly(tree in small_trees(), seed: u64) {
        let before = reference_order(&tree);
        let sound = divide(&mission(&tree)).unwrap();
        let mut rng = SeededRng(seed);
        for _ in 0..8 {
            let mut division = sound.clone();
            for _ in 0..=rng.below(2) {
                damage(&mut division, &mut rng);
            }
            if division != sound && violations_of(&tree, &division).is_none() {
                let explored = explore_all_states(&division, &before, 1_000);
                prop_assert!(!matches!(explored, Explored::Wrong(_)), "{:?}\n{:#?}", explored, division);
            }
        }
    }
}

/// Removes an order or a signal from a plan, or adds an order.
fn damage(division: &mut Division, rng: &mut SeededRng) {
    let plans = division.plans.len();
    let role = division.plans.keys().nth(rng.below(plans)).unwrap().clone();
    let plan = division.plans.get_mut(&role).unwrap();
    let index = rng.below(plan.steps.len());
    match rng.below(3) {
        0 if !plan.steps[index].after.is_empty() => {
            let removed = rng.below(plan.steps[index].after.len());
            let removed = plan.steps[index].after.remove(removed);
            if rng.below(2) == 0 {
                let mut after: BTreeSet<StepIndex> = plan.steps[index].after.iter().copied().collect();
                after.extend(&plan.steps[removed as usize].after);
                plan.steps[index].after = after.into_iter().collect();
            }
        }
        1 if index > 0 => {
            let more = rng.below(index) as StepIndex;
            if !plan.steps[index].after.contains(&more) {
                plan.steps[index].after.push(more);
                plan.steps[index].after.sort_unstable();
            }
        }
        _ => {
            let signals = signals(division);
            let done: Vec<_> = signals.iter().filter(|(signal, ..)| signal.kind == SignalKind::Done).collect();
            if !done.is_empty() {
                *division = without_signal(division, &done[rng.below(done.len())].0);
            }
        }
    }
}
