//! Following a path, and the small skills for chargers and tables.

use super::*;
use consort_protocol::units::{MetresPerSecond, SharePerSecond};
use consort_skills::actions::{Dock, FollowWaypoints, Undock, Waypoint};
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext};

fn follow(waypoints: &str) -> TaskSpec {
    task("follow_path", &[("waypoints", waypoints)])
}

#[test]
fn a_path_is_a_single_goal_with_poses_facing_along_the_path() {
    let mut driver = ScriptedDriver::at("A");
    assert_eq!(run(&mut skill(&follow("0,5; 3,5;3,1")), &mut driver), succeeded());
    let pose = |x, y, yaw| Waypoint { pose: Pose::new(x, y, yaw), place: None };
    let quarter = std::f64::consts::FRAC_PI_2;
    let waypoints = vec![pose(0.0, 5.0, 0.0), pose(3.0, 5.0, -quarter), pose(3.0, 1.0, -quarter)];
    assert_eq!(driver.goals(), [Goal::from(FollowWaypoints { waypoints })]);
    // A single point keeps the direction of arrival: north, from A at the origin.
    let mut driver = ScriptedDriver::at("A");
    assert_eq!(run(&mut skill(&follow("0,5")), &mut driver), succeeded());
    assert_eq!(driver.goals(), [Goal::from(FollowWaypoints { waypoints: vec![pose(0.0, 5.0, quarter)] })]);
}

#[test]
fn an_invalid_path_fails_before_a_goal_is_sent() {
    for (waypoints, cause) in [
        ("", "ComputePathHeadings: there are no waypoints to follow"),
        ("1,2; 3", "ComputePathHeadings: \" 3\" is not a point: allowed is `x,y` in metres"),
        ("1,2; 3,inf", "ComputePathHeadings: \" 3,inf\" is not a point: allowed is `x,y` in metres"),
    ] {
        let mut driver = ScriptedDriver::at("A");
        assert_eq!(run(&mut skill(&follow(waypoints)), &mut driver), failed(cause));
        assert!(driver.goals().is_empty());
    }
}

#[test]
fn a_halted_path_is_canceled_and_starts_again() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = skill(&follow("0,5;3,5"));
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    skill.halt(&mut driver);
    assert!(driver.is_canceling());
    driver.complete_cancel();
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["follow 2 waypoints", "follow 2 waypoints"]);
}

#[test]
fn a_path_is_priced_by_its_length_from_where_the_robot_is() {
    let estimator = DescriptorRegistry::standard().resolve(environment()).unwrap();
    let (speed, discharge) = (MetresPerSecond::new(0.5).unwrap(), SharePerSecond::new(0.001).unwrap());
    let robot = EstimateContext::at(place("A"), speed, discharge);
    let estimate = estimator.estimate(&follow("0,5;3,5;3,1"), &robot).unwrap();
    assert_eq!((estimate.time.get(), estimate.ends_at.as_str()), (24.0, "A"), "5 + 3 + 4 m");
    let away = EstimateContext { pose: Some(Pose::new(0.0, 4.0, 0.0)), ..robot.clone() };
    assert_eq!(estimator.estimate(&follow("0,5;3,5;3,1"), &away).unwrap().time.get(), 16.0);
    let error = estimator.estimate(&follow("here"), &robot).unwrap_err().to_string();
    assert!(error.starts_with("the follow_path task has `waypoints` = \"here\": \"here\" is not a point"), "{error}");
}

#[test]
fn docking_and_grasping_send_the_goals_of_the_task() {
    let charger = Some(place("A"));
    for (task, goal) in [
        (task("dock", &[]), Goal::from(Dock { charger: None })),
        (task("dock", &[("charger", "A")]), Goal::from(Dock { charger })),
        (task("undock", &[]), Goal::from(Undock {})),
        (task("grasp", &[("object", "tray-1")]), goal("grasp", json!({ "object": "tray-1" }), false)),
    ] {
        let mut driver = ScriptedDriver::at("A");
        assert_eq!(run(&mut skill(&task), &mut driver), succeeded());
        assert_eq!(driver.goals(), [goal]);
    }
    // An object is taken once.
    let object = "tray-1".to_owned();
    let mut driver = ScriptedDriver::at("A").with_completed(goal("grasp", json!({ "object": object }), false));
    assert_eq!(run(&mut skill(&task("grasp", &[("object", "tray-1")])), &mut driver), succeeded());
    assert!(driver.goals().is_empty());
}
