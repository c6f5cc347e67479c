//! Person requests: the serving person, its conditions, and its error messages.

use super::*;
use crate::world::actions::{ApproachPerson, ApproachRobot, Deposit, OperateDrawer, PickUp};
use crate::world::samples::HolderEntity;
use consort_protocol::scalar::Scalar;
use consort_protocol::yaml;
use consort_skills::actions::PersonResult;
use consort_skills::domain_file::DomainFile;
use std::collections::{BTreeMap, BTreeSet};

fn approach() -> Goal {
    Goal::from(ApproachPerson { role: role("nurse") })
}

fn open() -> Goal {
    Goal::from(OperateDrawer { open: true })
}

/// A nurse in each of two rooms; r1 next to the second, with an open drawer.
fn ready() -> World {
    let setup = hospital(3).robot(carrier("r1", "PC Room 2")).person(nurse("Ana", "PC Room 1", "s1")).person(nurse(
        "Bea",
        "PC Room 2",
        "s2",
    ));
    let mut world = World::new(setup).unwrap();
    run_to_success(&mut world, "r1", 1, approach());
    run_to_success(&mut world, "r1", 2, open());
    world
}

fn answer(ask: u64, result: Result<(), ActionError>) -> BackendEvent {
    BackendEvent::PersonRequestEnded { request: GoalId(ask), result: result.map(|()| BTreeMap::new()) }
}

fn sample_holders(world: &World) -> Vec<SampleHolder> {
    world.samples().into_iter().map(|sample| sample.holder).collect()
}

#[test]
fn the_approached_nurse_hands_over() {
    let mut world = ready();
    world.request_person(GoalId(7), deposit("r1"));
    world.request_person(GoalId(7), deposit("r1"));
    let due = world.next_due().unwrap().as_secs() - 4.0;
    assert!((2.0..=4.0).contains(&due), "she takes 2 to 4 s, not {due}");
    assert_eq!(world.advance(at(60.0)), [answer(7, Ok(()))]);
    assert_eq!(sample_holders(&world), [SampleHolder::Person("Ana".into()), SampleHolder::Drawer(robot("r1"))]);
    world.request_person(GoalId(7), deposit("r1"));
    assert_eq!(world.advance(at(99.0)), [], "a repeated ask changes nothing");
}

const COUNTER: &str = r#"
domain: counter
actions:
  put_in: { simulate: { system: arm, as: deposit } }
  take_out: { parameters: { from: { type: robot } }, simulate: { system: arm, as: pick_up } }
tasks:
  hand_in: { action: put_in }
  lay_in: { tree: lay_in.xml, estimate: { time_s: "2.0" } }
  look_in: { tree: look_in.xml, estimate: { time_s: "2.0" } }
"#;

/// The domain declares which task types are handovers: by an action of its own, or in a tree.
#[test]
fn a_handover_has_any_name() {
    let tree = |name: &str, node: &str| {
        let text = format!(r#"<root BTCPP_format="4"><BehaviorTree ID="{name}">{node}</BehaviorTree></root>"#);
        (format!("{name}.xml"), text)
    };
    let trees = [tree("lay_in", "<deposit/>"), tree("look_in", r#"<take_out from="r2"/>"#)].into();
    let counter = DomainFile::check(yaml::parse(COUNTER).unwrap(), &trees, &[]).unwrap();
    for (task_type, moved) in [("deposit", true), ("hand_in", true), ("lay_in", true), ("look_in", false)] {
        let setup = hospital(3).domain(&counter).robot(carrier("r1", "PC Room 2"));
        let mut world = World::new(setup.person(nurse("Bea", "PC Room 2", "s2"))).unwrap();
        run_to_success(&mut world, "r1", 1, approach());
        run_to_success(&mut world, "r1", 2, open());
        let mut request = deposit("r1");
        request.task.task_type = TaskType::new(task_type).unwrap();
        world.request_person(GoalId(7), request);
        assert_eq!(world.advance(at(60.0)), [answer(7, Ok(()))], "{task_type}");
        let holder = if moved { SampleHolder::Drawer(robot("r1")) } else { SampleHolder::Person("Bea".into()) };
        assert_eq!(sample_holders(&world), [holder], "{task_type}");
    }
}

#[test]
fn a_request_waits_for_the_open_drawer() {
    let setup = hospital(3).robot(carrier("r1", "PC Room 2")).person(nurse("Bea", "PC Room 2", "s2"));
    let mut world = World::new(setup).unwrap();
    world.request_person(GoalId(7), deposit("r1"));
    assert_eq!(world.advance(at(500.0)), []);
    run_to_success(&mut world, "r1", 1, approach());
    assert_eq!(world.advance(at(600.0)), []);
    run_to_success(&mut world, "r1", 2, open());
    assert_eq!(world.advance(at(700.0)), [answer(7, Ok(()))]);
}

#[test]
fn a_departing_robot_interrupts_the_handover() {
    let mut world = ready();
    world.request_person(GoalId(7), deposit("r1"));
    let (out, back) = (drive_goal(&world, "PC Corridor 2"), drive_goal(&world, "PC Room 2"));
    run_to_success(&mut world, "r1", 3, out);
    assert_eq!(sample_holders(&world)[1], SampleHolder::Person("Bea".into()));
    run_to_success(&mut world, "r1", 4, back);
    assert_eq!(world.advance(at(100.0)), [], "it has yet to approach her again");
    run_to_success(&mut world, "r1", 5, approach());
    assert_eq!(world.advance(at(200.0)), [answer(7, Ok(()))]);
}

#[test]
fn a_canceled_request_leaves_the_sample_with_the_nurse() {
    let mut world = ready();
    world.request_person(GoalId(7), deposit("r1"));
    world.advance(at(5.0));
    assert_eq!(world.open_person_requests(), [GoalId(7)]);
    world.cancel_person_request(GoalId(7));
    assert_eq!(world.open_person_requests(), []);
    assert_eq!(world.advance(at(99.0)), []);
    assert_eq!(sample_holders(&world)[1], SampleHolder::Person("Bea".into()));
    world.request_person(GoalId(8), deposit("r1"));
    assert_eq!(world.advance(at(199.0)), [answer(8, Ok(()))]);
}

#[test]
fn the_items_are_taken_off_a_robot_once() {
    let mut world = ready();
    let take = || PersonRequest::taking_items(role("r1"), robot("r1"));
    world.request_person(GoalId(7), deposit("r1"));
    assert_eq!(world.advance(at(60.0)), [answer(7, Ok(()))]);
    world.request_person(GoalId(8), take());
    assert_eq!(world.advance(at(60.0)), [answer(8, Ok(()))]);
    let table = SampleHolder::Table(place("PC Room 2"));
    assert_eq!(sample_holders(&world), [SampleHolder::Person("Ana".into()), table]);
    // The robot gets another item. A copy of the request comes too late.
    let r1 = world.state.robots[&robot("r1")];
    world.state.create_sample("s3".into(), HolderEntity::Drawer(r1));
    world.request_person(GoalId(8), take());
    assert_eq!(world.advance(at(99.0)), []);
    assert_eq!(sample_holders(&world)[2], SampleHolder::Drawer(robot("r1")));
    // Another host may have the robot.
    world.request_person(GoalId(9), PersonRequest::taking_items(role("r1"), robot("r2")));
    let absent = ActionError::rejected(ErrorCode::Unknown, "none of the robots is here".to_owned());
    assert_eq!(world.advance(at(99.0)), [answer(9, Err(absent))]);
}

#[test]
fn a_request_canceled_before_its_arrival_is_not_served() {
    let mut world = ready();
    world.cancel_person_request(GoalId(7));
    world.request_person(GoalId(7), deposit("r1"));
    assert_eq!(world.advance(at(99.0)), []);
    assert!(world.was_person_request_canceled(GoalId(7)));
    assert_eq!(world.person_result(GoalId(7)), None);
    world.request_person(GoalId(8), deposit("r1"));
    assert_eq!(world.advance(at(199.0)), [answer(8, Ok(()))]);
    world.cancel_person_request(GoalId(8));
    assert!(!world.was_person_request_canceled(GoalId(8)), "it had ended");
    assert_eq!(world.person_result(GoalId(8)), Some(Ok(BTreeMap::new())));
}

#[test]
fn an_impossible_request_ends_with_its_reason() {
    let error = |code, message: &str| Err(ActionError::rejected(code, message.to_owned()));
    let mut world = ready();
    world.request_person(GoalId(2), PersonRequest { role: role("doctor"), ..deposit("r1") });
    world.request_person(GoalId(3), deposit("r9"));
    assert_eq!(
        world.advance(at(4.0)),
        [
            answer(2, error(ErrorCode::Unknown, "no doctor is here; roles present: nurse")),
            answer(3, error(ErrorCode::Unknown, "no robot here that has a drawer holds role r1")),
        ]
    );
    world.request_person(GoalId(4), deposit("r1"));
    world.request_person(GoalId(5), deposit("r1"));
    let full = error(ErrorCode::ContainerState, "the drawer of r1 is full: it holds s2");
    assert_eq!(world.advance(at(99.0)), [answer(4, Ok(())), answer(5, full)]);
}

/// A task that is no handover needs no robot, but a free person.
#[test]
fn a_person_does_any_task_in_its_time() {
    let mut world = ready();
    let mut dance = deposit("r1");
    dance.task.task_type = TaskType::new("dance").unwrap();
    dance.task.parameters.insert("seconds".to_owned(), "30".to_owned());
    for id in [1, 2, 3] {
        world.request_person(GoalId(id), dance.clone());
    }
    assert_eq!(world.advance(at(33.9)), []);
    assert_eq!(world.advance(at(34.1)), [answer(1, Ok(())), answer(2, Ok(()))], "two nurses");
    assert_eq!(world.advance(at(64.1)), [answer(3, Ok(()))]);
    dance.task.parameters.clear();
    world.request_person(GoalId(4), dance);
    assert_eq!(world.advance(at(69.0)), [answer(4, Ok(()))], "as long as a handover");
}

const WARD: &str = r#"
domain: ward
actions:
  count:
    results: { beds: { type: integer, minimum: 0, maximum: 9 }, free: { type: bool }, left: { type: number } }
    simulate: { duration_s: [30, 60], results: { beds: [2, 4], left: [0.5, 1.5] } }
  lift: { failures: { heavy: {} }, simulate: { duration_s: [5, 5], failures: { heavy: 1 } } }
tasks:
  count_beds: { action: count }
  glance: { action: count, results: { beds: { type: integer } } }
  lift: { action: lift }
  look: { tree: look.xml, results: { seen: { type: text, one_of: [door] } }, estimate: { time_s: "1.0" } }
"#;

const LOOK: &str =
    r#"<root BTCPP_format="4"><BehaviorTree ID="look"><Script code="seen := 'door'"/></BehaviorTree></root>"#;

/// Lets a nurse do a task. Returns its duration and its result.
fn done_by_nurse(seed: u64, task_type: &str, parameters: &[(&str, &str)]) -> (f64, PersonResult) {
    let trees = [("look.xml".to_owned(), LOOK.to_owned())].into();
    let ward = DomainFile::check(yaml::parse(WARD).unwrap(), &trees, &[]).unwrap();
    let setup = hospital(seed).domain(&ward).person(nurse("Ana", "PC Room 1", "s1"));
    let mut world = World::new(setup).unwrap();
    let parameters = parameters.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
    let task = TaskSpec { parameters, ..TaskSpec::of(TaskType::new(task_type).unwrap(), vec![role("nurse")]) };
    world.request_person(GoalId(1), PersonRequest { task, ..deposit("r1") });
    let due = world.next_due().unwrap();
    let events = world.advance(due);
    let [BackendEvent::PersonRequestEnded { result, .. }] = &events[..] else { panic!("{events:?}") };
    assert_eq!(world.person_result(GoalId(1)).as_ref(), Some(result));
    (due.as_secs(), result.clone())
}

#[test]
fn a_person_takes_the_declared_time_and_states_the_declared_results() {
    let mut seen = BTreeSet::new();
    for seed in 0..20 {
        let (time_s, result) = done_by_nurse(seed, "count_beds", &[]);
        assert!((30.0..=60.0).contains(&time_s), "{time_s} s");
        let results = result.clone().unwrap();
        assert_eq!(results.keys().map(String::as_str).collect::<Vec<_>>(), ["beds", "free", "left"]);
        assert!(matches!(results["beds"], Scalar::Integer(2..=4)), "{results:?}");
        assert!(matches!(results["free"], Scalar::Bool(_)), "{results:?}");
        assert!(matches!(results["left"], Scalar::Number(0.5..=1.5)), "{results:?}");
        assert_eq!(done_by_nurse(seed, "count_beds", &[]), (time_s, result), "same seed, same run");
        seen.insert((time_s.to_bits(), format!("{results:?}")));
    }
    assert_eq!(seen.len(), 20, "seeds differ");
    let (time_s, result) = done_by_nurse(1, "attend", &[("at", "PC Room 1")]);
    assert!((30.0..=60.0).contains(&time_s), "{time_s} s");
    assert_eq!(result, Ok(BTreeMap::new()));
    let (time_s, result) = done_by_nurse(1, "ask_person", &[("message", "ready?")]);
    assert!((10.0..=30.0).contains(&time_s), "{time_s} s");
    let answer = &result.unwrap()["answer"];
    assert!(["yes", "no"].map(|text| Scalar::Text(text.to_owned())).contains(answer), "{answer}");
}

#[test]
fn a_person_states_the_results_of_the_task_and_fails_as_declared() {
    let (_, result) = done_by_nurse(1, "glance", &[]);
    let results = result.unwrap();
    assert_eq!(results.keys().collect::<Vec<_>>(), ["beds"], "those of the task replace those of its action");
    let (time_s, result) = done_by_nurse(1, "look", &[]);
    assert!((2.0..=4.0).contains(&time_s), "a tree declares no time: {time_s} s");
    assert_eq!(result.unwrap(), [("seen".to_owned(), Scalar::Text("door".to_owned()))].into());
    let (time_s, result) = done_by_nurse(1, "lift", &[]);
    assert_eq!((time_s, result.unwrap_err().to_string()), (5.0, "failed: heavy: Ana failed at lift".to_owned()));
    let (time_s, result) = done_by_nurse(1, "count_beds", &[("seconds", "7")]);
    assert!(result.is_ok() && time_s == 7.0, "the parameter counts: {time_s} s");
}

#[test]
fn a_person_with_endless_samples_serves_any_number_of_requests() {
    let bea = PersonSetup { endless_samples: true, ..nurse("Bea", "PC Room 2", "s2") };
    let setup = hospital(3)
        .robot(carrier("r1", "PC Room 2"))
        .robot(RobotSetup { has_arm: true, ..carrier("porter", "PC Room 2") })
        .person(bea);
    let mut world = World::new(setup).unwrap();
    run_to_success(&mut world, "r1", 1, approach());
    run_to_success(&mut world, "r1", 2, open());
    run_to_success(&mut world, "porter", 1, Goal::from(ApproachRobot { robot: robot("r1") }));
    for number in 1..60 {
        world.request_person(GoalId(number), deposit("r1"));
        let until = at(world.now().as_secs() + 9.0);
        assert_eq!(world.advance(until), [answer(number, Ok(()))]);
        run_to_success(&mut world, "porter", 2 * number, Goal::from(PickUp { from: robot("r1") }));
        run_to_success(&mut world, "porter", 2 * number + 1, Goal::from(Deposit { into: None }));
    }
    assert_eq!(world.samples().len(), 21, "used samples are taken again");
}

#[test]
fn a_person_on_call_comes_to_one_robot_at_a_time() {
    let nia =
        PersonSetup { on_call: true, endless_samples: true, ..PersonSetup::new("Nia", role("nurse"), place("Dock")) };
    let setup = hospital(3)
        .robot(carrier("a", "PC Room 2"))
        .robot(carrier("b", "IC Room 6"))
        .person(nia)
        .person(nurse("Ana", "PC Room 1", "s1"));
    let mut world = World::new(setup).unwrap();
    run_to_success(&mut world, "a", 1, approach());
    let here = |world: &World| {
        let nia = world.people().into_iter().find(|person| person.name.as_str() == "Nia");
        nia.unwrap().place.to_string()
    };
    assert_eq!(here(&world), "PC Room 2");
    let busy = rejected_status(&mut world, "b", 1, approach());
    assert_eq!(busy, aborted(ErrorCode::OutOfReach, "b: no nurse is at IC Room 6"));
    run_to_success(&mut world, "a", 2, open());
    world.request_person(GoalId(7), deposit("a"));
    let until = at(world.now().as_secs() + 9.0);
    assert_eq!(world.advance(until), [answer(7, Ok(()))]);
    run_to_success(&mut world, "a", 4, Goal::from(OperateDrawer { open: false }));
    let away = drive_goal(&world, "PC Corridor 2");
    run_to_success(&mut world, "a", 5, away);
    run_to_success(&mut world, "b", 2, approach());
    assert_eq!(here(&world), "IC Room 6");
}

#[test]
fn a_nurse_serves_two_robots_in_turn() {
    let mut mia = nurse("Mia", "PC Room 2", "s1");
    mia.samples.push("s2".into());
    let setup = hospital(3).robot(carrier("a", "PC Room 2")).robot(carrier("b", "PC Room 2")).person(mia);
    let mut world = World::new(setup).unwrap();
    world.request_person(GoalId(1), deposit("b"));
    world.request_person(GoalId(2), deposit("a"));
    for goal in [(1, approach()), (2, open())] {
        world.start(&robot("a"), GoalId(goal.0), goal.1.clone());
        world.start(&robot("b"), GoalId(goal.0), goal.1);
        let now = world.now().as_secs();
        world.advance(at(now + 2.0));
    }
    let mut answers = Vec::new();
    while answers.len() < 2 {
        let due = world.next_due().unwrap();
        answers.extend(world.advance(due).into_iter().map(|event| (due.as_secs(), event)));
    }
    assert_eq!([&answers[0].1, &answers[1].1], [&answer(2, Ok(())), &answer(1, Ok(()))], "a's drawer was open first");
    assert!(answers[1].0 >= answers[0].0 + 2.0, "she has two hands and one pace: {answers:?}");
    assert_eq!(sample_holders(&world), [SampleHolder::Drawer(robot("a")), SampleHolder::Drawer(robot("b"))]);
}
