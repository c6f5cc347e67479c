//! Local plans of the shipped and published missions, and of missions that are hard to divide.

use crate::support::{
    Explored, Sequence, Task, Unordered, explore_all_states, mission, reference_order, without_signal,
};
use consort_protocol::codec;
use consort_protocol::ids::{RoleId, TaskId, TaskType};
use consort_protocol::mission::{Domain, IhtnOptions, Mission, TaskSchema, ValueKind, import_ihtn, shipped};
use consort_protocol::plan::{
    Division, DivisionError, GlobalOrder, LocalPlan, PlanProgress, Signal, SignalKind, StepAction, check_division,
    divide, divide_and_check,
};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

fn instance(name: &str, given: &[(&str, &str)]) -> Mission {
    let given = given.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    shipped()[name].instantiate(&given, &Domain::hospital()).unwrap()
}

fn role(name: &str) -> RoleId {
    RoleId::new(name).unwrap()
}

/// Formats the steps: `open_drawer`, `!done:…` for a send, `?done:…` for a wait, each with its
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
        from: crate::support::role(from),
        to: crate::support::role(to),
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

#[test]
fn missions_and_plans_survive_encoding_and_decoding() {
    for name in shipped().keys() {
        let mission = instance(name, &[]);
        let bytes = codec::encode(&mission).unwrap();
        let received: Mission = codec::decode(&bytes).unwrap();
        assert_eq!(received, mission);
        received.check(&Domain::hospital()).unwrap();
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

#[test]
fn a_robot_that_is_ready_executes_no_other_task() {
    let tree = Unordered(vec![Task(vec![1, 2]), Task(vec![1])]);
    let division = divide_and_check(&mission(&tree)).unwrap();
    let mut progress = PlanProgress::new(division.plans[&crate::support::role(1)].clone());
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

/// Reads a published iHTN from outside the repository; `None`, with a message, if the file is
/// missing.
#[expect(clippy::print_stderr, reason = "a skipped check must be visible")]
fn published(file: &str) -> Option<String> {
    let default_folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/reference");
    let folder = std::env::var_os("CONSORT_REFERENCE").map_or(default_folder, PathBuf::from);
    let path = folder.join("mission_control").join(file);
    let text = std::fs::read_to_string(&path).ok();
    if text.is_none() {
        eprintln!("skipped: there is no {}; set CONSORT_REFERENCE to the folder that contains it", path.display());
    }
    text
}

fn options(unmanaged: &[&str], aliases: &[(&str, &str)]) -> IhtnOptions {
    IhtnOptions {
        name: TaskId::new("published").unwrap(),
        unmanaged: unmanaged.iter().map(|name| role(name)).collect(),
        aliases: aliases.iter().map(|(k, v)| ((*k).to_owned(), TaskType::new(*v).unwrap())).collect(),
    }
}

#[test]
fn the_published_lab_samples_give_the_robot_the_same_plan_as_ours() {
    let Some(text) = published("ihtn_lsl.json") else { return };
    let theirs = import_ihtn(&text, &options(&["nurse"], &[]), &Domain::hospital()).unwrap();
    let ours = instance("lab-samples", &[("room", "PC Room 2")]);
    let plan = |mission: &Mission| -> Vec<String> {
        let types: BTreeMap<String, String> =
            mission.elementary().iter().map(|(id, spec)| (id.to_string(), spec.task_type.to_string())).collect();
        let plans = divide_and_check(mission).unwrap().plans;
        let signal_text = |signal: &Signal| {
            format!("{:?} {} {} {}", signal.kind, types[signal.task.as_str()], signal.from, signal.to)
        };
        let steps = plans[&role("r1")].steps.iter();
        steps
            .map(|step| match &step.action {
                StepAction::Task { spec, .. } => format!("{} {:?} {:?}", spec.task_type, spec.parameters, step.after),
                StepAction::Send(signal) => format!("send {} {:?}", signal_text(signal), step.after),
                StepAction::Wait(signal) => format!("wait {} {:?}", signal_text(signal), step.after),
            })
            .collect()
    };
    let expected = plan(&ours);
    assert_eq!(expected.len(), 13);
    assert_eq!(plan(&theirs), expected);
}

#[test]
fn the_other_published_missions_can_be_divided() {
    let domain = ["wait-for-food", "wait-for-human-to-fetch", "approach-human", "approach-door", "open-door"]
        .into_iter()
        .chain(["pick-patient-dishes", "load-dishes", "retrieve-dishes"])
        .fold(Domain::hospital(), |domain, name| {
            domain.with(TaskType::new(name).unwrap(), TaskSchema::default().optional("at", ValueKind::Place))
        });
    let people: &[&[&str]] = &[&["Delivery1", "Patient1"], &["Patient1"]];
    for (file, people) in ["ihtn_fld.json", "ihtn_flp.json"].into_iter().zip(people) {
        let Some(text) = published(file) else { return };
        let options = options(people, &[("navto", "navigation")]);
        let mission = import_ihtn(&text, &options, &domain).unwrap_or_else(|error| panic!("{file}: {error}"));
        let division = divide_and_check(&mission).unwrap();
        if file == "ihtn_flp.json" {
            let plan = steps_text(&division.plans[&role("r1")]);
            assert_eq!(
                plan,
                [
                    "navto []",
                    "!done:navto:r1:r2 [0]",
                    "?done:navto-2:r2:r1 [0]",
                    "approach-door [2]",
                    "!done:approach-door:r1:r2 [3]",
                    "!ready:open-door:r1:r2 [3]",
                    "?ready:open-door:r2:r1 [5]",
                    "open-door [6]",
                    "!done:open-door:r1:r2 [7]",
                    "!done:open-door:r1:Patient1 [7]",
                    "?done:pick-patient-dishes:Patient1:r1 [7]",
                    "!ready:load-dishes:r1:r2 [10]",
                    "?ready:load-dishes:r2:r1 [11]",
                    "load-dishes [12]",
                    "?done:load-dishes:r2:r1 [13]",
                    "navto-3 [14]",
                    "retrieve-dishes [15]",
                ]
            );
        }
    }
}
