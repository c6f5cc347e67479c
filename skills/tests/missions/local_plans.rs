//! Local plans of the shipped missions.

use crate::team::{Explored, explore_all_states};
use crate::{instance, role, steps_text};
use consort_protocol::codec;
use consort_protocol::ids::TaskId;
use consort_protocol::mission::{GlobalOrder, Mission};
use consort_protocol::plan::{Division, PlanProgress, Signal, SignalKind, check_division, divide, divide_and_check};
use consort_skills::domain::hospital;
use consort_skills::missions::shipped;

#[test]
fn the_robot_of_lab_samples_has_thirteen_steps() {
    let division = divide_and_check(&instance("lab-samples", &[])).unwrap();
    assert_eq!(
        steps_text(&division.plans[&role("r1")]),
        [
            "navto_room []",
            "approach_nurse [0]",
            "authenticate_nurse [1]",
            "open_drawer_for_nurse [2]",
            "!done:open_drawer_for_nurse:r1:nurse [3]",
            "?done:deposit:nurse:r1 [3]",
            "close_drawer_nurse [5]",
            "navto_lab [6]",
            "approach_arm [7]",
            "open_drawer_lab [8]",
            "!done:open_drawer_lab:r1:lab_arm [9]",
            "?done:pick_up_sample:lab_arm:r1 [9]",
            "close_drawer_lab [11]",
        ]
    );
    assert_eq!(
        steps_text(&division.plans[&role("nurse")]),
        ["?done:open_drawer_for_nurse:r1:nurse []", "deposit [0]", "!done:deposit:nurse:r1 [1]"]
    );
    assert_eq!(
        steps_text(&division.plans[&role("lab_arm")]),
        ["?done:open_drawer_lab:r1:lab_arm []", "pick_up_sample [0]", "!done:pick_up_sample:lab_arm:r1 [1]"]
    );
}

#[test]
fn lab_samples_guards_the_moves_of_the_sample() {
    let division = divide_and_check(&instance("lab-samples", &[])).unwrap();
    let guarded = |name| Vec::from_iter(division.plans[&role(name)].guarded.iter().copied());
    // Both the carrier's signal to the nurse that its drawer is open and the pick-up by the arm
    // require that the ledger contains the preceding steps.
    assert_eq!(guarded("r1"), [4]);
    assert_eq!(guarded("lab_arm"), [1]);
    assert_eq!(guarded("nurse"), [0; 0]);
}

#[test]
fn two_robots_synchronise_before_they_carry_together() {
    let division = divide_and_check(&instance("bed-transfer", &[])).unwrap();
    assert_eq!(
        steps_text(&division.plans[&role("foot")]),
        [
            "foot_navto_bed []",
            "!done:foot_navto_bed:foot:nurse [0]",
            "?done:open_door:nurse:foot [0]",
            "!ready:carry_bed:foot:head [2]",
            "?ready:carry_bed:head:foot [3]",
            "carry_bed [4]",
            "!done:carry_bed:foot:nurse [5]",
            "?done:take_over_bed:nurse:foot [5]",
            "foot_clean [7]",
        ]
    );
}

#[test]
fn unordered_tasks_of_one_robot_stay_unordered() {
    let division = divide_and_check(&instance("ward-disinfection", &[])).unwrap();
    assert_eq!(
        steps_text(&division.plans[&role("left")]),
        [
            "navto_a []",
            "disinfect_a [0]",
            "!done:disinfect_a:left:right [1]",
            "navto_b []",
            "disinfect_b [3]",
            "!done:disinfect_b:left:right [4]",
            "?done:disinfect_c:right:left []",
            "?done:disinfect_d:right:left []",
            "left_navto_corridor [1, 4, 6, 7]",
            "!ready:disinfect_corridor:left:right [8]",
            "?ready:disinfect_corridor:right:left [9]",
            "disinfect_corridor [10]",
        ]
    );
}

#[test]
fn the_shipped_missions_end_in_order_in_every_run() {
    for name in shipped().keys() {
        let mut mission = instance(name, &[]);
        let ids: Vec<TaskId> = mission.elementary().iter().map(|(id, _)| (*id).clone()).collect();
        for node in &mut mission.tasks {
            if let Some(number) = ids.iter().position(|id| *id == node.id) {
                node.id = TaskId::new(format!("t{number}")).unwrap();
            }
        }
        let order = GlobalOrder::of(&mission).unwrap();
        let row = |first| (0..ids.len()).map(|second| order.precedes(first, second)).collect();
        let before: Vec<Vec<bool>> = (0..ids.len()).map(row).collect();
        assert_eq!(
            explore_all_states(&divide_and_check(&mission).unwrap(), &before, 20_000),
            Explored::Sound,
            "{name}"
        );
    }
}

#[test]
fn missions_and_plans_survive_encoding_and_decoding() {
    for name in shipped().keys() {
        let mission = instance(name, &[]);
        let bytes = codec::encode(&mission).unwrap();
        let received: Mission = codec::decode(&bytes).unwrap();
        assert_eq!(received, mission);
        received.check(&hospital()).unwrap();
        let division = divide(&mission).unwrap();
        let received: Division = codec::decode(&codec::encode(&division).unwrap()).unwrap();
        assert_eq!(check_division(&mission, &received), Ok(()));
    }
}

#[test]
fn progress_is_stored_and_checked_when_it_is_restored() {
    let division = divide(&instance("bed-transfer", &[])).unwrap();
    let mut progress = PlanProgress::new(division.plans[&role("foot")].clone());
    progress.end(0).unwrap();
    progress.end(1).unwrap();
    assert!(progress.receive(&Signal {
        kind: SignalKind::Done,
        task: TaskId::new("open_door").unwrap(),
        from: role("nurse"),
        to: role("foot"),
    }));
    assert_eq!(codec::decode::<PlanProgress>(&codec::encode(&progress).unwrap()).unwrap(), progress);
    let text = serde_json::to_string(&progress).unwrap();
    assert_eq!(serde_json::from_str::<PlanProgress>(&text).unwrap(), progress);
    let forged = text.replace("\"ended\":[0,1]", "\"ended\":[1]");
    assert_ne!(forged, text);
    let error = serde_json::from_str::<PlanProgress>(&forged).unwrap_err().to_string();
    assert!(error.contains("step 1 is recorded as ended, but its predecessor 0 is not"), "{error}");
    assert!(progress.clone().end(5).is_err(), "the joint task needs both roles");
    assert!(progress.clone().end(0).is_err(), "a step ends once");
}
