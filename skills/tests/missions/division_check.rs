//! Divisions of shipped missions with an error, and the violations that the check reports.

use crate::{instance, role};
use consort_protocol::plan::{Division, DivisionError, check_division, divide};

#[test]
fn the_checker_names_mission_task_and_role() {
    let mission = instance("lab-samples", &[]);
    let sound = divide(&mission).unwrap();
    let violations = |change: &dyn Fn(&mut Division)| {
        let mut division = sound.clone();
        change(&mut division);
        match check_division(&mission, &division) {
            Err(DivisionError::Unsound(error)) => error.violations.iter().map(ToString::to_string).collect::<Vec<_>>(),
            other => panic!("{other:?}"),
        }
    };
    let r1 = |division: &mut Division| division.plans.remove(&role("r1")).unwrap();
    assert_eq!(violations(&|division| drop(r1(division)))[0], "role r1 has no plan",);
    assert_eq!(
        violations(&|division| drop(division.plans.get_mut(&role("nurse")).unwrap().steps.pop())),
        ["role r1 waits for done:deposit:nurse:r1, and role nurse never sends it"]
    );
    assert_eq!(
        violations(&|division| division.plans.get_mut(&role("r1")).unwrap().steps[1].after.clear()),
        ["role r1 may begin approach_nurse before role r1 has ended navto_room"]
    );
    assert_eq!(
        violations(&|division| division.plans.get_mut(&role("r1")).unwrap().steps[1].after = vec![7]),
        ["role r1: step 1 lists the predecessors [7]; they must be smaller numbers, in order, without repetition"]
    );
    assert_eq!(
        violations(&|division| drop(division.plans.get_mut(&role("r1")).unwrap().steps.pop())),
        ["role r1: its plan lacks the task close_drawer_lab"]
    );
    assert_eq!(
        violations(&|division| division.plans.get_mut(&role("nurse")).unwrap().steps[2].after.clear()),
        [
            "role nurse may send done:deposit:nurse:r1 before it has ended that task",
            "role r1 may begin close_drawer_nurse before role nurse has ended deposit",
        ]
    );
    // The nurse waits for the open drawer, and the robot opens it after it has received the
    // deposit.
    assert_eq!(
        violations(&|division| {
            let plan = division.plans.get_mut(&role("r1")).unwrap();
            let wait = plan.steps.remove(5);
            plan.steps.insert(3, wait);
            plan.steps[3].after = vec![2];
            plan.steps[4].after = vec![3];
            plan.steps[5].after = vec![4];
            plan.steps[6].after = vec![4];
        }),
        ["these tasks wait for each other: open_drawer_for_nurse, deposit"]
    );
}

#[test]
fn a_joint_task_without_its_rendezvous_is_rejected() {
    let mission = instance("bed-transfer", &[]);
    let mut division = divide(&mission).unwrap();
    // The foot end would lift as soon as it has sent `ready` to the head end, without having
    // received `ready`.
    division.plans.get_mut(&role("foot")).unwrap().steps[5].after = vec![3];
    assert_eq!(
        check_division(&mission, &division).unwrap_err().to_string(),
        "the local plans of mission bed-transfer do not execute it:\n  role foot may begin the joint task carry_bed \
         before it has exchanged `ready` with head"
    );
}
