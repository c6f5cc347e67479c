//! The cancel of a goal, the end of its permission, and the end of the program.

use super::*;

#[test]
fn a_goal_is_canceled_when_the_vehicle_has_stopped() {
    let under_way = |keep_for: Duration| {
        let (mut machine, mut vehicle) = (machine(3), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let event = Event::Goal { id: 7, fingerprint: 1, work: drive("d"), keep_for, since: None };
        let sent = machine.step(event, seconds(2));
        vehicle.receive(&sent[0]);
        exchange(&mut machine, &mut vehicle, 3);
        (machine, vehicle)
    };
    let (mut machine, mut vehicle) = under_way(seconds(100));
    let commands = machine.step(Event::Cancel { id: 7 }, seconds(4));
    assert_eq!((cancels(&commands), result(&commands)), (1, None), "the vehicle has not confirmed");
    // The cancel is lost, and sent again.
    assert_eq!(cancels(&exchange(&mut machine, &mut vehicle, 5)), 0);
    assert_eq!(cancels(&exchange(&mut machine, &mut vehicle, 6)), 1);
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 7)), Some(GoalStatus::Canceled));
    assert!(machine.is_at_rest());
    // The end of the permission does the same.
    let (mut machine, mut vehicle) = under_way(seconds(2));
    assert_eq!(cancels(&exchange(&mut machine, &mut vehicle, 4)), 1);
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 5)), Some(GoalStatus::Canceled));
    // A goal without permission is not sent.
    let (mut machine, mut vehicle) = (self::machine(3), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let event = Event::Goal { id: 7, fingerprint: 1, work: drive("d"), keep_for: Duration::ZERO, since: None };
    let commands = machine.step(event, seconds(2));
    assert_eq!((orders(&commands), result(&commands)), (vec![], Some(GoalStatus::Canceled)));
}

#[test]
fn a_cancel_waits_for_a_state_that_is_younger_than_the_action() {
    for is_lost in [false, true] {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, pick(true)), seconds(2));
        machine.step(Event::Cancel { id: 7 }, seconds(2));
        // The vehicle has written this state before it received the action.
        let commands = machine.step(Event::State(Box::new(vehicle.state())), Duration::from_millis(2_100));
        assert_eq!(result(&commands), None);
        if is_lost {
            assert_eq!(result(&exchange(&mut machine, &mut vehicle, 4)), Some(GoalStatus::Canceled));
            continue;
        }
        vehicle.receive(&sent[0]);
        assert_eq!(result(&exchange(&mut machine, &mut vehicle, 4)), None);
        vehicle.finish_actions();
        assert!(matches!(result(&exchange(&mut machine, &mut vehicle, 5)), Some(GoalStatus::Succeeded(_))));
    }
}

#[test]
fn a_goal_after_the_shutdown_is_not_begun() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    machine.step(Event::Shutdown, seconds(2));
    let commands = machine.step(goal(7, drive("d")), seconds(3));
    assert_eq!((orders(&commands), result(&commands)), (vec![], Some(GoalStatus::Canceled)));
}
