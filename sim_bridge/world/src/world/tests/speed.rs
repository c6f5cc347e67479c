//! Changes of a robot's speed from outside.

use super::steering::{all, steered, until_ended};
use super::*;
use crate::kinematics::Kinematics;

/// Returns the durations of a drive from A to B, 10 m away, and back, for a robot of 0.5 m/s with a
/// change of speed after it has left A.
fn there_and_back(body: RobotSetup, speed: f64) -> (f64, f64) {
    let text = "{name: hall, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}], \
                lanes: [{between: [A, B]}]}";
    let setup = WorldSetup::new(map::read(text, "hall").unwrap(), 1);
    let mut world = World::new(setup.robot(body)).unwrap();
    let goal = drive_goal(&world, "B");
    world.start(&robot("r1"), GoalId(1), goal);
    world.advance(at(1.0));
    world.set_speed(&robot("r1"), MetresPerSecond::new(speed).unwrap());
    world.set_speed(&robot("who"), MetresPerSecond::new(9.0).unwrap());
    assert_eq!(until_ended(&mut world, "r1", 1), GoalStatus::succeeded());
    let there = world.now().as_secs();
    let goal = drive_goal(&world, "A");
    world.start(&robot("r1"), GoalId(2), goal);
    assert_eq!(until_ended(&mut world, "r1", 2), GoalStatus::succeeded());
    (there, world.now().as_secs() - there)
}

#[test]
fn a_new_speed_applies_from_the_next_drive() {
    assert_eq!(there_and_back(carrier("r1", "A"), 0.25), (20.0, 40.0));
    assert_eq!(there_and_back(carrier("r1", "A"), 1.0), (20.0, 10.0));
}

#[test]
fn a_speed_change_affects_robots_with_kinematics() {
    for kinematics in all() {
        let (there, back) = there_and_back(steered("r1", "A", kinematics.clone()), 0.5);
        let (same, slow) = there_and_back(steered("r1", "A", kinematics.clone()), 0.25);
        assert_eq!(same, there, "{kinematics:?}");
        // Ten metres take 20 s more. Accelerating, braking and turning on the spot take the same
        // time. Turning in a curve takes longer in proportion to the length of the curve.
        let more = match kinematics {
            Kinematics::Ackermann(_) => back,
            _ => 20.0,
        };
        assert!((slow - back - more).abs() < 3.0, "{kinematics:?}: {back} s at 0.5 m/s, {slow} s at 0.25 m/s");
    }
}
