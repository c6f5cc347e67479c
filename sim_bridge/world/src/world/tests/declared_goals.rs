//! Goals of declared actions: their feedback, the items that they move, and their cancels.

use super::*;
use crate::world::actions::{ApproachPerson, ApproachRobot, OperateDrawer};
use consort_protocol::cause::CauseClass;
use consort_protocol::yaml;
use consort_skills::domain_file::{DomainFile, ItemHolder};
use serde_json::{Value, json};
use std::collections::BTreeMap;

const LOADING: &str = r#"
domain: loading
actions:
  load: { simulate: { duration_s: [2, 2], moves: { from: table, to: container } } }
  load_thing:
    parameters: { thing: { type: text } }
    failures: { not_there: { class: task, moved_nothing: true } }
    simulate: { duration_s: [2, 2], moves: { from: table, to: container, item: thing, otherwise: not_there } }
  unload: { simulate: { duration_s: [2, 2], moves: { from: container, to: table } } }
  lift: { parameters: { thing: { type: text } }, simulate: { moves: { from: table, to: arm, item: thing } } }
  pass_on:
    parameters: { to: { type: robot } }
    simulate: { moves: { from: container, to: other_container, robot: to } }
  spill: { simulate: { failure_rate: 1, moves: { from: table, to: container } } }
  cook: { simulate: { duration_s: [2, 2], moves: { from: nothing, to: container } } }
  print:
    parameters: { thing: { type: text } }
    failures: { no_paper: { class: task, moved_nothing: true } }
    simulate: { duration_s: [2, 2], moves: { from: nothing, to: table, item: thing, otherwise: no_paper } }
  eat: { simulate: { duration_s: [2, 2], moves: { from: container, to: nothing } } }
  burn: { parameters: { thing: { type: text } }, simulate: { moves: { from: table, to: nothing, item: thing } } }
  bake:
    results: { heat: { type: integer, minimum: 0, maximum: 90 } }
    simulate:
      duration_s: { normal: { mean: 8, deviation: 2, minimum: 5, maximum: 10 } }
      results: { heat: { exponential: { mean: 20, maximum: 90 } } }
  press: { cancel: { within_s: 3 }, simulate: { duration_s: [10, 10] } }
  wash:
    cancel: { within_s: 2 }
    feedback:
      water_l: { type: number, minimum: 0, maximum: 4 }
      turns: { type: integer }
      phase: { type: text, one_of: [fill, rinse, wash] }
      hot: { type: bool }
    simulate: { duration_s: [10, 10], feedback: { turns: [0, 100], phase: [fill, wash], hot: true } }
"#;

fn thing(name: &str, weight_kg: f64) -> ObjectSetup {
    ObjectSetup { name: name.into(), place: place("Laboratory"), weight_kg, distance_m: 0.5 }
}

/// Two robots at a table with a tray, a cup and a crate. Only r1 has an arm.
fn store(drawer_slots: usize) -> World {
    World::new(store_setup(drawer_slots)).unwrap()
}

fn store_setup(drawer_slots: usize) -> WorldSetup {
    let domain = DomainFile::check(yaml::parse(LOADING).unwrap(), &BTreeMap::new(), &[]).unwrap();
    let setup = hospital(1).domain(&domain);
    let porter = RobotSetup { has_arm: true, ..carrier("r1", "Laboratory") };
    let mut setup = setup.robot(porter).robot(carrier("r2", "Laboratory"));
    setup.objects = vec![thing("tray", 1.5), thing("cup", 0.5), thing("crate", 2.5)];
    setup.limits.drawer_slots = drawer_slots;
    setup
}

fn goal(action: &str, parameters: Value) -> Goal {
    serde_json::from_value(json!({ "action": action, "parameters": parameters })).unwrap()
}

fn holder(world: &World, object: &str) -> SampleHolder {
    world.sample(&object.into()).unwrap().holder
}

#[test]
fn a_declared_goal_moves_an_item() {
    let mut world = store(2);
    let (table, drawer) = (SampleHolder::Table(place("Laboratory")), SampleHolder::Drawer(robot("r1")));
    run_to_success(&mut world, "r1", 1, goal("load", json!({})));
    assert_eq!(holder(&world, "tray"), drawer, "the first on the table");
    run_to_success(&mut world, "r1", 2, goal("load_thing", json!({ "thing": "crate" })));
    assert_eq!((holder(&world, "cup"), holder(&world, "crate")), (table.clone(), drawer), "the named item");
    run_to_success(&mut world, "r1", 3, goal("unload", json!({})));
    assert_eq!(holder(&world, "tray"), table, "the item that came first leaves first");
    run_to_success(&mut world, "r1", 4, goal("lift", json!({ "thing": "tray" })));
    assert_eq!(holder(&world, "tray"), SampleHolder::Arm(robot("r1")));
}

#[test]
fn a_declared_goal_without_its_preconditions_is_rejected_with_a_class() {
    let mut world = store(1);
    let status = rejected_status(&mut world, "r1", 1, goal("load_thing", json!({ "thing": "jug" })));
    let message = "not_there: no \"jug\" is on the table at Laboratory; objects there: tray, cup, crate";
    let declared = ActionError { class: CauseClass::Task, ..ActionError::rejected(ErrorCode::Failed, message) };
    assert_eq!(status, GoalStatus::Aborted(declared), "the declared failure");
    for (id, name, action, parameters, code, message) in [
        (2, "r1", "lift", json!({ "thing": "crate" }), ErrorCode::TooHeavy, "crate weighs 2.5 kg, r1 lifts 2 kg"),
        (3, "r2", "lift", json!({ "thing": "cup" }), ErrorCode::OutOfReach, "r2 has no arm"),
        (
            4,
            "r1",
            "unload",
            json!({}),
            ErrorCode::ContainerState,
            "no object is in the drawer of r1; objects there: nothing",
        ),
        (5, "r1", "pass_on", json!({ "to": "r3" }), ErrorCode::Unknown, "there is no robot r3 here"),
    ] {
        let ActionError { code: found, message: text, .. } =
            match rejected_status(&mut world, name, id, goal(action, parameters)) {
                GoalStatus::Aborted(error) => error,
                other => panic!("{action}: {other:?}"),
            };
        assert!(found == code && text.starts_with(message), "{action}: {found}: {text}");
    }
    run_to_success(&mut world, "r1", 6, goal("load", json!({})));
    let full = aborted(ErrorCode::ContainerState, "the drawer of r1 is full: it holds tray");
    assert_eq!(rejected_status(&mut world, "r1", 7, goal("load", json!({}))), full);
}

#[test]
fn an_item_goes_into_the_open_drawer_of_another_robot() {
    let mut world = store(2);
    let pass_on = || goal("pass_on", json!({ "to": "r2" }));
    run_to_success(&mut world, "r1", 1, goal("load", json!({})));
    let far = aborted(ErrorCode::OutOfReach, "neither of r1 and r2 has approached the other");
    assert_eq!(rejected_status(&mut world, "r1", 2, pass_on()), far);
    run_to_success(&mut world, "r1", 3, Goal::from(ApproachRobot { robot: robot("r2") }));
    let closed = aborted(ErrorCode::ContainerState, "the drawer of r2 is closed");
    assert_eq!(rejected_status(&mut world, "r1", 4, pass_on()), closed);
    run_to_success(&mut world, "r2", 1, Goal::from(OperateDrawer { open: true }));
    run_to_success(&mut world, "r1", 5, pass_on());
    assert_eq!(holder(&world, "tray"), SampleHolder::Drawer(robot("r2")));
}

#[test]
fn a_declared_goal_that_fails_moves_nothing() {
    let mut world = store(2);
    let table = SampleHolder::Table(place("Laboratory"));
    assert!(matches!(run(&mut world, "r1", 1, goal("spill", json!({}))).0, GoalStatus::Aborted(_)));
    world.start(&robot("r1"), GoalId(2), goal("load", json!({})));
    world.cancel(&robot("r1"), GoalId(2));
    world.advance(at(world.now().as_secs() + 9.0));
    assert_eq!(world.status(&robot("r1"), GoalId(2)), Some(GoalStatus::Canceled));
    assert_eq!(holder(&world, "tray"), table);
    // Both robots want the first item. The later one finds the next item at its end.
    world.start(&robot("r1"), GoalId(3), goal("load_thing", json!({ "thing": "tray" })));
    world.start(&robot("r2"), GoalId(1), goal("load_thing", json!({ "thing": "tray" })));
    world.advance(at(world.now().as_secs() + 9.0));
    assert_eq!(world.status(&robot("r1"), GoalId(3)), Some(GoalStatus::succeeded()));
    let Some(GoalStatus::Aborted(error)) = world.status(&robot("r2"), GoalId(1)) else {
        panic!("it has the tray, too")
    };
    assert_eq!(error.class, CauseClass::Task, "the precondition is checked at the end, too");
}

fn names(world: &World) -> Vec<String> {
    world.samples().into_iter().map(|sample| sample.id.to_string()).collect()
}

#[test]
fn a_declared_goal_creates_and_consumes_items() {
    let mut world = store(1);
    let (table, drawer) = (SampleHolder::Table(place("Laboratory")), SampleHolder::Drawer(robot("r1")));
    run_to_success(&mut world, "r1", 1, goal("cook", json!({})));
    assert_eq!(holder(&world, "cook 1"), drawer, "it has the name of its action");
    let full = aborted(ErrorCode::ContainerState, "the drawer of r1 is full: it holds cook 1");
    assert_eq!(rejected_status(&mut world, "r1", 2, goal("cook", json!({}))), full);
    run_to_success(&mut world, "r1", 3, goal("eat", json!({})));
    assert_eq!(names(&world), ["crate", "cup", "tray"], "it is used up");
    let empty = aborted(ErrorCode::ContainerState, "no object is in the drawer of r1; objects there: nothing");
    assert_eq!(rejected_status(&mut world, "r1", 4, goal("eat", json!({}))), empty);
    run_to_success(&mut world, "r1", 5, goal("print", json!({ "thing": "label" })));
    assert_eq!(holder(&world, "label"), table);
    run_to_success(&mut world, "r2", 1, goal("load_thing", json!({ "thing": "label" })));
    assert_eq!(holder(&world, "label"), SampleHolder::Drawer(robot("r2")), "it moves like any item");
    run_to_success(&mut world, "r1", 6, goal("burn", json!({ "thing": "cup" })));
    assert_eq!(names(&world), ["crate", "label", "tray"]);
    let changes = logged(&mut world, |event| match event {
        WorldEvent::SampleCreated { sample, holder } => Some((sample.to_string(), true, holder.clone())),
        WorldEvent::SampleConsumed { sample, from } => Some((sample.to_string(), false, from.clone())),
        _ => None,
    });
    let changes: Vec<_> = changes.into_iter().map(|(_, change)| change).collect();
    let expected = [
        ("cook 1", true, drawer.clone()),
        ("cook 1", false, drawer),
        ("label", true, table.clone()),
        ("cup", false, table),
    ];
    assert_eq!(changes, expected.map(|(name, created, holder)| (name.to_owned(), created, holder)));
}

#[test]
fn the_name_of_a_new_item_is_shortened() {
    let long = "c".repeat(64);
    let text = format!("{LOADING}  {long}: {{ simulate: {{ moves: {{ from: nothing, to: container }} }} }}\n");
    let domain = DomainFile::check(yaml::parse(&text).unwrap(), &BTreeMap::new(), &[]).unwrap();
    let mut world = World::new(store_setup(2).domain(&domain)).unwrap();
    for id in [1, 2] {
        run_to_success(&mut world, "r1", id, goal(&long, json!({})));
    }
    let expected = [1, 2].map(|number| format!("{} {number}", &long[..62]));
    assert_eq!(names(&world)[..2], expected);
}

/// A setup of a library user may contain actions that no domain file may declare.
#[test]
fn an_action_that_moves_nothing_to_nothing_is_rejected() {
    let mut setup = store_setup(1);
    for moves in setup.actions.values_mut().filter_map(|action| action.simulate.moves.as_mut()) {
        (moves.from, moves.to) = (ItemHolder::Nothing, ItemHolder::Nothing);
    }
    let mut world = World::new(setup).unwrap();
    let nothing = aborted(ErrorCode::Failed, "the action cook moves an item from nothing to nothing");
    assert_eq!(rejected_status(&mut world, "r1", 1, goal("cook", json!({}))), nothing);
}

#[test]
fn a_new_item_has_a_free_name_and_space_in_the_world() {
    let mut setup = store_setup(1);
    setup.limits.entities_max = 4;
    let mut world = World::new(setup).unwrap();
    let mut refused = |id: u64, name: &str, problem: &str| {
        let status = rejected_status(&mut world, "r1", id, goal("print", json!({ "thing": name })));
        let declared = ActionError::rejected(ErrorCode::Failed, format!("no_paper: {problem}"));
        assert_eq!(status, GoalStatus::Aborted(ActionError { class: CauseClass::Task, ..declared }), "{name:?}");
    };
    refused(1, "tray", "the name \"tray\" is that of another item; allowed is any other name");
    let allowed = "is invalid; allowed are 1 to 64 characters, without control characters";
    refused(2, "", &format!("the name \"\" {allowed}"));
    // Two robots print the same label. The later robot fails, since the label exists.
    world.start(&robot("r1"), GoalId(3), goal("print", json!({ "thing": "label" })));
    world.start(&robot("r2"), GoalId(1), goal("print", json!({ "thing": "label" })));
    world.advance(at(world.now().as_secs() + 9.0));
    assert_eq!(world.status(&robot("r1"), GoalId(3)), Some(GoalStatus::succeeded()));
    assert!(matches!(world.status(&robot("r2"), GoalId(1)), Some(GoalStatus::Aborted(_))));
    let many = aborted(ErrorCode::Busy, "the world has 4 items; at most 4 are allowed");
    assert_eq!(rejected_status(&mut world, "r1", 4, goal("cook", json!({}))), many);
    run_to_success(&mut world, "r1", 5, goal("burn", json!({ "thing": "label" })));
    world.start(&robot("r1"), GoalId(6), goal("cook", json!({})));
    world.cancel(&robot("r1"), GoalId(6));
    world.advance(at(world.now().as_secs() + 9.0));
    assert_eq!(names(&world), ["crate", "cup", "tray"], "a canceled goal creates nothing");
}

/// The samples that such a person makes are bounded, and a consumed sample is replaced.
#[test]
fn a_person_with_endless_samples_replaces_consumed_ones() {
    let person = PersonSetup { samples: vec![], endless_samples: true, ..nurse("Ana", "Laboratory", "s1") };
    let mut world = World::new(store_setup(1).person(person)).unwrap();
    run_to_success(&mut world, "r1", 1, Goal::from(ApproachPerson { role: role("nurse") }));
    run_to_success(&mut world, "r1", 2, Goal::from(OperateDrawer { open: true }));
    for turn in 3..30 {
        world.request_person(GoalId(turn), deposit("r1"));
        world.advance(at(world.now().as_secs() + 9.0));
        assert_eq!(world.person_result(GoalId(turn)), Some(Ok(BTreeMap::new())), "turn {turn}");
        assert_eq!(names(&world), ["Ana 1", "crate", "cup", "tray"], "turn {turn}");
        run_to_success(&mut world, "r1", turn, goal("eat", json!({})));
    }
    assert_eq!(names(&world), ["crate", "cup", "tray"]);
}

#[test]
fn declared_feedback_passes_from_its_first_to_its_last_value() {
    let mut world = store(2);
    world.start(&robot("r1"), GoalId(1), goal("wash", json!({})));
    let feedback = |world: &mut World, time_s: f64| {
        world.advance(at(time_s));
        match world.status(&robot("r1"), GoalId(1)) {
            Some(GoalStatus::Executing(feedback)) => json!(feedback.values),
            other => panic!("after {time_s} s: {other:?}"),
        }
    };
    for (time_s, water_l, turns, phase) in [(0.0, 0.0, 0, "fill"), (2.5, 1.0, 25, "fill"), (7.5, 3.0, 75, "wash")] {
        let expected = json!({ "water_l": water_l, "turns": turns, "phase": phase, "hot": true });
        assert_eq!(feedback(&mut world, time_s), expected, "after {time_s} s");
    }
    // A cancel does not change the plan of the goal.
    world.cancel(&robot("r1"), GoalId(1));
    assert_eq!(feedback(&mut world, 9.0)["turns"], json!(90));
    // An action without a declaration has none.
    world.advance(at(20.0));
    world.start(&robot("r1"), GoalId(2), goal("press", json!({})));
    let Some(GoalStatus::Executing(plain)) = world.status(&robot("r1"), GoalId(2)) else { panic!("it is active") };
    assert!(plain.values.is_empty(), "{plain:?}");
}

#[test]
fn durations_and_results_have_their_declared_distributions() {
    const GOALS: u32 = 50;
    let bake = || {
        let mut world = store(2);
        let baked = (1..=GOALS).map(|id| {
            let began = world.now().as_secs();
            let (status, _) = run(&mut world, "r1", id.into(), goal("bake", json!({})));
            let GoalStatus::Succeeded(results) = status else { panic!("goal {id}") };
            (world.now().as_secs() - began, results.0["heat"].as_f64().unwrap())
        });
        baked.collect::<Vec<_>>()
    };
    let baked = bake();
    assert_eq!(baked, bake(), "the seed determines the numbers");
    let is_within = |(time_s, heat): &(f64, f64)| (4.999..=10.001).contains(time_s) && (0.0..=90.0).contains(heat);
    assert!(baked.iter().all(is_within), "{baked:?}");
    assert!(baked.iter().all(|(_, heat)| heat.fract() == 0.0), "the results are whole numbers: {baked:?}");
    let mean = |of: fn(&(f64, f64)) -> f64| baked.iter().map(of).sum::<f64>() / f64::from(GOALS);
    let (time_s, heat) = (mean(|(time_s, _)| *time_s), mean(|(_, heat)| *heat));
    assert!((7.0..9.0).contains(&time_s) && (10.0..30.0).contains(&heat), "{time_s} {heat}");
}

#[test]
fn a_canceled_goal_ends_after_the_declared_time() {
    let mut world = store(2);
    let press = |world: &mut World, id: u64, cancel_after_s: f64| {
        let began = world.now().as_secs();
        world.start(&robot("r1"), GoalId(id), goal("press", json!({})));
        world.advance(at(began + cancel_after_s));
        world.cancel(&robot("r1"), GoalId(id));
        world.advance(at(began + cancel_after_s + 1.0));
        world.cancel(&robot("r1"), GoalId(id));
        let events = world.advance(at(began + 60.0));
        let ends = logged(world, |event| matches!(event, WorldEvent::GoalEnded { .. }).then_some(()));
        (events, ends[0].0 - began)
    };
    let canceled = vec![ended("r1", 1, GoalStatus::Canceled)];
    assert_eq!(press(&mut world, 1, 2.0), (canceled, 5.0), "3 s after the first cancel");
    let succeeded = vec![ended("r1", 2, GoalStatus::succeeded())];
    assert_eq!(press(&mut world, 2, 8.0), (succeeded, 10.0), "it reaches its end before");
}
