//! Systems execute the goals of the actions whose declarations name them.

use super::docking::yard;
use super::*;
use consort_skills::domain_file::DomainFile;
use consort_skills::extensions::Extensions;
use serde_json::{Value, json};
use std::collections::BTreeMap;

const RENAMED: &str = "
domain: renamed
actions:
  open_box: { parameters: { action: { type: text, one_of: [open, close] } }, simulate: { system: drawer } }
  pause: { parameters: { time: { type: seconds } }, simulate: { system: waiting } }
  look_around: { parameters: { angle_rad: { type: number, minimum: -7, maximum: 7 } }, simulate: { system: turning } }
  plug_in: { simulate: { system: docking, as: dock } }
  unplug: { simulate: { system: docking, as: undock } }
  go:
    parameters: { pose: { type: pose }, place: { type: place } }
    simulate: { system: driving, as: navigate_to_pose }
  put_down: { simulate: { system: arm, as: deposit } }
";

fn domain(text: &str) -> DomainFile {
    DomainFile::check(consort_protocol::yaml::parse(text).unwrap(), &BTreeMap::new(), &[]).unwrap()
}

fn renamed(robot: RobotSetup) -> World {
    World::new(yard().domain(&domain(RENAMED)).robot(robot)).unwrap()
}

fn goal(action: &str, parameters: Value) -> Goal {
    serde_json::from_value(json!({ "action": action, "parameters": parameters })).unwrap()
}

fn go(world: &World, to: &str) -> Goal {
    goal("go", serde_json::to_value(drive_goal(world, to).parameters).unwrap())
}

#[test]
fn the_name_of_an_action_does_not_matter() {
    let mut world = renamed(carrier("r1", "Gate"));
    let open = goal("open_box", json!({ "action": "open" }));
    run_to_success(&mut world, "r1", 1, open.clone());
    assert_eq!(world.goal(&robot("r1"), GoalId(1)), Some(open), "clients see the name of the domain");
    assert_eq!(
        logged(&mut world, |what| matches!(what, WorldEvent::DrawerMoved { open: true, .. }).then_some(())).len(),
        1
    );
    let before = world.now().as_secs();
    run_to_success(&mut world, "r1", 2, goal("pause", json!({ "time": 7.5 })));
    assert_eq!(world.now().as_secs(), before + 7.5);
    run_to_success(&mut world, "r1", 3, goal("look_around", json!({ "angle_rad": 1.5 })));
    assert!((world.telemetry(&robot("r1")).unwrap().pose.yaw - 1.5).abs() < 1e-9);
    let far = go(&world, "Far");
    run_to_success(&mut world, "r1", 4, far);
    assert_eq!(world.telemetry(&robot("r1")).unwrap().place, place("Far"));
    let status = rejected_status(&mut world, "r1", 5, goal("put_down", json!({})));
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "r1 has no arm"));
}

#[test]
fn a_goal_of_any_name_that_moves_a_docked_robot_disconnects_it() {
    let mut world = renamed(carrier("r1", "Charger"));
    run_to_success(&mut world, "r1", 1, goal("plug_in", json!({})));
    run_to_success(&mut world, "r1", 2, goal("unplug", json!({})));
    run_to_success(&mut world, "r1", 3, goal("plug_in", json!({})));
    let gate = go(&world, "Gate");
    run_to_success(&mut world, "r1", 4, gate);
    let docked = |what: &WorldEvent| if let WorldEvent::Docked { docked, .. } = what { Some(*docked) } else { None };
    let docked: Vec<bool> = logged(&mut world, docked).into_iter().map(|(_, docked)| docked).collect();
    assert_eq!(docked, [true, false, true, false]);
}

#[test]
fn actions_that_their_system_cannot_execute_are_reported() {
    let mistakes = [
        (
            "leave: { simulate: { system: docking } }",
            "leave.simulate.as: the system docking has several kinds of goals; allowed: dock, undock",
        ),
        (
            "leave: { simulate: { system: docking, as: undok } }",
            "leave.simulate.as: the system docking has no goals undok; allowed: dock, undock; did you mean `undock`?",
        ),
        (
            "save: { simulate: { system: power } }",
            "save.simulate.system: the system power executes no goals of actions",
        ),
        ("rest: { simulate: { system: waiting } }", "rest.parameters.time: wait needs this parameter"),
        (
            "rest: { parameters: { time: { type: seconds, optional: true } }, simulate: { system: waiting } }",
            "rest.parameters.time: wait needs this parameter",
        ),
        (
            "rest: { parameters: { time: { type: text } }, simulate: { system: waiting } }",
            "rest.parameters.time: wait has this parameter with the type \"seconds\"",
        ),
        (
            "leave: { parameters: { fast: { type: bool } }, simulate: { system: docking, as: undock } }",
            "leave.parameters.fast: undock has no such parameter; no names are available",
        ),
        (
            "lid: { parameters: { action: { type: text } }, simulate: { system: drawer } }",
            "lid.parameters.action: `one_of` of this parameter of operate_drawer is [\"close\",\"open\"]",
        ),
    ];
    for (action, expected) in mistakes {
        let declared = domain(&format!("domain: d\nactions:\n  {action}"));
        let errors = check_simulated_actions(&declared, Extensions::NONE).unwrap_err().to_string();
        assert_eq!(errors, format!("actions.{expected}"));
        assert!(World::new(yard().domain(&declared)).is_err(), "{action}");
    }
    check_simulated_actions(&domain(RENAMED), Extensions::NONE).unwrap();
}
