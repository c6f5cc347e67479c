//! Outcomes of trials.

use consort_evaluation::design::{Design, FactorLevels, scenarios, shipped};
use consort_evaluation::outcome::EndState;
use consort_evaluation::policy::Policy;
use consort_evaluation::results::{Treatment, TrialRow, write};
use consort_evaluation::travel::TravelModel;
use consort_skills::workload::Workload;
use consort_tests::experiment::{ExperimentSetup, run, trials};
use std::collections::{BTreeMap, BTreeSet};

/// Returns a shipped design reduced to a few scenarios.
pub(crate) fn reduced_setup(name: &str, scenarios_max: usize, change: impl FnOnce(&mut Design)) -> ExperimentSetup {
    let mut design = shipped(name).unwrap().unwrap();
    change(&mut design);
    let mut chosen = scenarios(&design);
    // Scenarios at equal distances, so that all levels occur.
    let step = (chosen.len() / scenarios_max).max(1);
    chosen = chosen.into_iter().step_by(step).take(scenarios_max).collect();
    let map = consort_world::map::shipped(&design.map).unwrap();
    let travel = TravelModel::Kinematic(design.travel.clone());
    ExperimentSetup::new(design, chosen, map, travel, None, Workload::default()).unwrap()
}

pub(crate) fn rows(setup: &ExperimentSetup, jobs: usize) -> Vec<TrialRow> {
    run(setup, &trials(setup), jobs, |_| ()).into_iter().map(|outcome| outcome.row).collect()
}

fn text(rows: &[TrialRow]) -> String {
    let mut text = vec![];
    write(rows, &mut text).unwrap();
    String::from_utf8(text).unwrap()
}

#[test]
fn the_same_seed_gives_identical_rows_with_any_number_of_jobs() {
    let setup = reduced_setup("published", 2, |design| {
        design.repetitions = 2;
        design.treatments = vec![Treatment::Calm, Treatment::CoordinatorKilled];
    });
    let one = text(&rows(&setup, 1));
    assert_eq!(one.lines().count(), 1 + 2 * 2 * 2 * 2);
    assert_eq!(text(&rows(&setup, 2)), one);
    let other = reduced_setup("published", 2, |design| {
        design.repetitions = 2;
        design.treatments = vec![Treatment::Calm, Treatment::CoordinatorKilled];
        design.seed = 7;
    });
    assert_ne!(text(&rows(&other, 2)), one);
}

#[test]
fn repetitions_differ_and_equal_assignments_end_equally() {
    let setup = reduced_setup("published", 3, |design| {
        design.repetitions = 3;
        design.policies = vec![Policy::Consort, Policy::MissionControl];
    });
    let rows = rows(&setup, 2);
    let mut times: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    for row in rows.iter().filter(|row| row.policy == Policy::Consort) {
        times.entry(&row.scenario).or_default().insert(format!("{:?}", row.ttc_s));
        let other = rows.iter().find(|other| {
            other.policy == Policy::MissionControl
                && (&other.scenario, other.repetition) == (&row.scenario, row.repetition)
        });
        let other = other.unwrap();
        // With a single mobile role and equal estimates, both rules choose the same robot.
        assert_eq!(other.robots, row.robots);
        assert_eq!((other.end_state, other.ttc_s, &other.note), (row.end_state, row.ttc_s, &row.note));
    }
    assert!(times.values().any(|times| times.len() == 3), "{times:?}");
}

#[test]
fn only_the_random_policy_assigns_robots_without_the_skill() {
    let setup = reduced_setup("published", 9, |design| design.repetitions = 1);
    let rows = rows(&setup, 2);
    let unskilled = |policy| {
        let of = rows.iter().filter(|row| row.policy == policy && row.end_state == EndState::NoSkill);
        of.map(|row| row.note.as_str()).collect::<Vec<_>>()
    };
    assert_eq!(unskilled(Policy::Consort), Vec::<&str>::new());
    assert!(unskilled(Policy::Random).iter().all(|note| note.contains(" lacks ")), "{rows:?}");
    assert!(!unskilled(Policy::Random).is_empty());
    for row in &rows {
        assert_eq!(row.ttc_s.is_some(), row.end_state == EndState::Success, "{row:?}");
        assert!(row.robots.contains("r1=r") && row.robots.contains("lab_arm=lab-arm"), "{row:?}");
    }
    assert!(rows.iter().any(|row| row.end_state == EndState::Success));
}

#[test]
fn a_mission_continues_when_its_coordinator_is_killed() {
    let setup = reduced_setup("published", 3, |design| {
        design.repetitions = 2;
        design.policies = vec![Policy::Consort];
        design.treatments = vec![Treatment::Calm, Treatment::CoordinatorKilled];
    });
    let rows = rows(&setup, 2);
    let ends = |treatment| {
        let of = rows.iter().filter(|row| row.treatment == treatment);
        of.map(|row| (row.scenario.as_str(), row.repetition, row.end_state)).collect::<Vec<_>>()
    };
    assert_eq!(ends(Treatment::Calm), ends(Treatment::CoordinatorKilled));
    let killed = rows.iter().filter(|row| row.note.contains("coordinator killed after ")).count();
    assert!(killed > 0, "{rows:?}");
}

#[test]
fn an_empty_battery_is_a_failure_even_if_the_role_is_released() {
    let mut setup = reduced_setup("published", 81, |design| {
        design.repetitions = 3;
        design.policies = vec![Policy::Consort];
    });
    // The battery of this robot is just sufficient by its own estimates, but drives take half as
    // long again.
    setup.scenarios.retain(|scenario| scenario.code == "aacbc");
    let rows = rows(&setup, 2);
    let empty: Vec<&TrialRow> = rows.iter().filter(|row| row.note.contains("battery low: the battery of r")).collect();
    assert!(!empty.is_empty(), "{rows:?}");
    assert!(empty.iter().all(|row| row.end_state == EndState::LowBattery), "{empty:?}");
    assert!(empty.iter().all(|row| row.lowest_share.is_some_and(|share| share < 0.051)), "{empty:?}");
}

#[test]
fn missions_with_several_managed_roles_complete() {
    for (name, roles) in [("food", ["porter=", "server="]), ("rounds", ["left=", "right="])] {
        let setup = reduced_setup(name, 6, |design| {
            design.repetitions = 1;
            design.policies = vec![Policy::Consort, Policy::Optimal];
            design.treatments = vec![Treatment::Calm];
        });
        let rows = rows(&setup, 2);
        let successes = rows.iter().filter(|row| row.end_state == EndState::Success).count();
        assert!(successes >= rows.len() / 2, "{name}: {rows:#?}");
        assert!(rows.iter().all(|row| row.robots.is_empty() || roles.iter().all(|role| row.robots.contains(role))));
        assert!(rows.iter().all(|row| row.end_state != EndState::NoSkill));
    }
}

#[test]
fn an_unknown_place_is_reported_before_any_trial() {
    let design = shipped("published").unwrap().unwrap();
    let mut chosen = scenarios(&design);
    chosen.truncate(1);
    chosen[0].robots[0].place = "IC Rom 1".parse().unwrap();
    chosen[0].levels = FactorLevels::default();
    let map = consort_world::map::shipped("hospital").unwrap();
    let travel = TravelModel::Kinematic(design.travel.clone());
    let violations = ExperimentSetup::new(design, chosen, map, travel, None, Workload::default()).err().unwrap();
    assert_eq!(
        violations.0,
        ["scenario aaaaa, r1: there is no place \"IC Rom 1\" on map hospital; did you mean \"IC Room 1\"?"]
    );
}
