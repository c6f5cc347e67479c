//! Setups: all mistakes are reported at once.

use super::*;
use crate::world::actions::OperateDrawer;
use consort_skills::actions::Wait;

#[test]
fn all_mistakes_are_reported() {
    let mut lame = carrier("r2", "Dock");
    lame.idle_factor = 1.5;
    let mut setup = hospital(1)
        .robot(carrier("r1", "PC Rom 3"))
        .robot(carrier("r1", "Dock"))
        .robot(lame)
        .person(nurse("Ana", "Kitchen", "s1"))
        .person(nurse("Ana", "PC Room 1", "s1"))
        .person(nurse("", "PC Room 1", "s2"));
    setup.durations.pick_up_s = f64::NAN;
    setup.limits.drawer_slots = 0;
    setup.systems.extend(["powr".to_owned(), "arm".to_owned()]);
    let errors = World::new(setup).unwrap_err().to_string();
    assert_eq!(
        errors.lines().collect::<Vec<_>>(),
        [
            "durations: pick_up_s is NaN, allowed is a number of seconds from 0 to 86400",
            "limits: drawer_slots is 0, allowed is 1 or more",
            "there is no system \"powr\"; did you mean \"power\"?; there are: steering, driving, doors, lifts, obstacles, turning, waiting, declared_actions, co_presence, drawer, arm, docking, power, spontaneous_actions, people, collisions, wind",
            "system arm is defined more than once",
            "robot r1: there is no place \"PC Rom 3\" on map hospital; did you mean \"PC Room 3\"?",
            "robot r1 is defined more than once",
            "robot r2: idle_factor is 1.5, allowed is a number from 0 to 1",
            "person Ana: there is no place \"Kitchen\" on map hospital",
            "person Ana is defined more than once",
            "person \"\": a name has 1 to 64 characters, none of them a control character",
            "sample s1 is defined more than once",
        ]
    );
}

#[test]
fn a_setup_that_is_too_large_is_rejected() {
    let mut setup = hospital(1).robot(carrier("r1", "Dock")).robot(carrier("r2", "Dock"));
    setup.limits.entities_max = 1;
    assert_eq!(World::new(setup).unwrap_err().to_string(), "2 robots are more than the 1 allowed");
}

#[test]
fn robots_and_people_are_read_from_files() {
    let text = "{id: r1, place: Dock, speed_mps: 0.15, battery: 0.6, discharge_share_per_s: 0.0004, has_drawer: true}";
    let body: RobotSetup = serde_saphyr::from_str(text).unwrap();
    let (speed, discharge) = (MetresPerSecond::new(0.15).unwrap(), SharePerSecond::new(0.0004).unwrap());
    let battery = BatteryShare::new(0.6).unwrap();
    assert_eq!(body, RobotSetup::carrier(robot("r1"), place("Dock"), speed, battery, discharge));
    let person: PersonSetup =
        serde_saphyr::from_str("{name: Ana, role: nurse, place: PC Room 1, samples: [s1]}").unwrap();
    assert_eq!(person, nurse("Ana", "PC Room 1", "s1"));
    assert!(
        serde_saphyr::from_str::<PersonSetup>("{name: Ana, role: nurse, place: PC Room 1, spontaneous_actions: shy}")
            .is_err()
    );
}

#[test]
fn a_world_has_the_systems_that_its_setup_names() {
    let mut setup = hospital(1).robot(carrier("r1", "Dock")).person(nurse("Ana", "PC Room 1", "s1"));
    setup.systems = vec!["waiting".to_owned()];
    let mut world = World::new(setup).unwrap();
    run_to_success(&mut world, "r1", 1, Goal::from(Wait { time: Seconds::new(1e6).unwrap() }));
    assert_eq!(world.telemetry(&robot("r1")).unwrap().battery, BatteryShare::FULL, "nothing drains it");
    let status = rejected_status(&mut world, "r1", 2, Goal::from(OperateDrawer { open: true }));
    assert_eq!(status, aborted(ErrorCode::Unknown, "no system of this world executes operate_drawer"));
    world.request_person(GoalId(3), deposit("r1"));
    let nobody = ActionError::rejected(ErrorCode::Unknown, "there are no people in this world".to_owned());
    let now = world.now();
    assert_eq!(world.advance(now), [BackendEvent::PersonRequestEnded { request: GoalId(3), result: Err(nobody) }]);
    assert_eq!((world.people(), world.samples()), (vec![], vec![]));
}
