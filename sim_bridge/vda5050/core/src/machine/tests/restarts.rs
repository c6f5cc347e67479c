//! Restarts of the driver, of the node and of the vehicle while an order is under way.

use super::*;
use crate::incoming::ConnectionState;

#[test]
fn a_new_process_continues_an_action_without_repeating_it() {
    for is_instant in [false, true] {
        let mut vehicle = FakeVehicle::at("a");
        let mut killed = machine(1);
        exchange(&mut killed, &mut vehicle, 1);
        let sent = killed.step(goal(7, pick(is_instant)), seconds(2));
        vehicle.receive(&sent[0]);
        drop(killed);

        let mut next = machine(1);
        let commands = next.step(resumed(7, pick(is_instant)), seconds(1));
        assert_eq!(orders(&commands), []);
        exchange(&mut next, &mut vehicle, 2);
        vehicle.finish_actions();
        assert!(matches!(result(&exchange(&mut next, &mut vehicle, 3)), Some(GoalStatus::Succeeded(_))));
        assert_eq!(vehicle.executed.iter().filter(|executed| *executed != "stateRequest").count(), 1, "{vehicle:?}");
    }
}

#[test]
fn a_resumed_action_that_the_vehicle_has_lost_is_not_repeated() {
    for is_instant in [false, true] {
        // The vehicle and the driver have restarted during the action.
        let (mut next, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        next.step(resumed(7, pick(is_instant)), seconds(1));
        let early = exchange(&mut next, &mut vehicle, 2);
        assert_eq!(result(&early), None, "the state may be older than the action");
        let Some(GoalStatus::Aborted(cause)) = result(&exchange(&mut next, &mut vehicle, 4)) else {
            panic!("{vehicle:?}");
        };
        assert!(cause.message.contains("not repeated"), "{cause:?}");
        assert!(vehicle.order.is_empty() && !vehicle.executed.contains(&"pick".to_owned()), "{vehicle:?}");
    }
    // A drive starts again.
    let (mut next, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    next.step(resumed(7, drive("b")), seconds(1));
    assert_eq!(orders(&exchange(&mut next, &mut vehicle, 2)).len(), 1);
}

#[test]
fn an_order_of_an_earlier_life_is_continued_for_the_same_work_only() {
    let under_way = || {
        let (mut machine, mut vehicle) = (machine(3), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, drive("d")), seconds(2));
        vehicle.receive(&sent[0]);
        vehicle.step();
        vehicle
    };
    // The node restarted: its goals have larger ids.
    let (mut next, mut vehicle) = (machine(3), under_way());
    next.step(goal(1 << 20, drive("d")), seconds(1));
    assert_eq!(orders(&exchange(&mut next, &mut vehicle, 2)), []);
    (0..3).for_each(|_| vehicle.step());
    assert!(matches!(result(&exchange(&mut next, &mut vehicle, 3)), Some(GoalStatus::Succeeded(_))));

    // Other work: the old order is cancelled first.
    let (mut next, mut vehicle) = (machine(3), under_way());
    next.step(goal(1 << 20, drive("a")), seconds(1));
    assert_eq!(cancels(&exchange(&mut next, &mut vehicle, 2)), 1);
    let order = orders(&exchange(&mut next, &mut vehicle, 3)).remove(0);
    assert_eq!((order.nodes[0].id.as_str(), order.nodes[1].id.as_str()), ("b", "a"));

    // A goal of an adapter that has been replaced does not touch the order of the later one.
    let (mut stale, mut vehicle) = (machine(3), under_way());
    stale.step(goal(6, drive("a")), seconds(1));
    let commands = exchange(&mut stale, &mut vehicle, 2);
    assert!(matches!(result(&commands), Some(GoalStatus::Aborted(cause)) if cause.code == "busy"));

    // Without a goal the order ends with the longest permission.
    let (mut idle, mut vehicle) = (machine(3), under_way());
    assert_eq!(cancels(&exchange(&mut idle, &mut vehicle, 1)), 0);
    assert_eq!(cancels(&idle.step(Event::Tick, seconds(5))), 1);
}

#[test]
fn a_continued_drive_keeps_the_limit_of_its_speed() {
    let limited = || Work::Drive { to: "d".to_owned(), speed_max_mps: Some(0.5) };
    let under_way = || {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, limited()), seconds(2));
        vehicle.receive(&sent[0]);
        vehicle.step();
        vehicle
    };
    let (mut next, mut vehicle) = (machine(1), under_way());
    next.step(resumed(7, limited()), seconds(1));
    exchange(&mut next, &mut vehicle, 2);
    let update = orders(&exchange(&mut next, &mut vehicle, 3)).remove(0);
    assert_eq!(Vec::from_iter(update.edges.iter().map(|edge| edge.speed_max_mps)), [Some(0.5), Some(0.5)]);
    // The limit of an earlier goal may have been higher.
    let (mut next, mut vehicle) = (machine(1), under_way());
    next.step(goal(1 << 20, limited()), seconds(1));
    assert_eq!(cancels(&exchange(&mut next, &mut vehicle, 2)), 1);
}

#[test]
fn a_restarted_vehicle_drives_again_but_does_not_repeat_an_action() {
    let restarted = |work: Work| {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, work), seconds(2));
        vehicle.receive(&sent[0]);
        exchange(&mut machine, &mut vehicle, 3);
        machine.step(Event::Connection(ConnectionState::Broken), seconds(4));
        vehicle.restart();
        machine.step(Event::Connection(ConnectionState::Online), seconds(6));
        let lost = exchange(&mut machine, &mut vehicle, 7);
        let next = exchange(&mut machine, &mut vehicle, 8);
        ([lost, next].concat(), sent)
    };
    let (commands, sent) = restarted(drive("d"));
    let again = orders(&commands).remove(0);
    let id = |order: &Order| order.id.parse::<OrderId>().unwrap();
    assert_eq!(id(&again), OrderId { attempt: 1, ..id(&orders(&sent)[0]) });
    for is_instant in [false, true] {
        let (commands, _) = restarted(pick(is_instant));
        assert_eq!(orders(&commands), []);
        let Some(GoalStatus::Aborted(cause)) = result(&commands) else { panic!("{commands:?}") };
        assert!(cause.message.contains("not repeated"), "{cause:?}");
    }
}

#[test]
fn a_vehicle_that_restarts_before_an_update_drives_again() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    vehicle.receive(&sent[0]);
    vehicle.step();
    let update = orders(&machine.step(Event::State(Box::new(vehicle.state())), seconds(3)));
    assert_eq!(update[0].update, 1, "the vehicle does not receive it");
    vehicle.restart();
    machine.step(Event::Connection(ConnectionState::Online), seconds(4));
    let commands = [exchange(&mut machine, &mut vehicle, 5), exchange(&mut machine, &mut vehicle, 6)].concat();
    let again = orders(&commands).remove(0);
    assert_eq!((again.id.parse::<OrderId>().unwrap().attempt, again.update), (1, 0));
}

#[test]
fn an_action_that_the_stop_of_the_node_has_cancelled_is_executed_again() {
    let stopped = || {
        let (mut stopped, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut stopped, &mut vehicle, 1);
        send(&mut stopped, &mut vehicle, goal(7, pick(false)), 2);
        exchange(&mut stopped, &mut vehicle, 3);
        let stop = stopped.step(Event::Shutdown, seconds(4));
        assert_eq!(cancels(&stop), 1);
        (vehicle, stop)
    };
    // The vehicle executes the cancel before the goal of the next process, or during it.
    for is_late in [false, true] {
        let ((mut vehicle, stop), mut next) = (stopped(), machine(1));
        let cancel = |vehicle: &mut FakeVehicle| stop.iter().for_each(|command| vehicle.receive(command));
        if !is_late {
            cancel(&mut vehicle);
        }
        exchange(&mut next, &mut vehicle, 1);
        let begun = send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(false)), 2);
        if is_late {
            cancel(&mut vehicle);
        }
        let commands = [3, 4, 5].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
        assert_eq!((result(&begun), result(&commands), acted(&vehicle)), (None, None, 2), "{vehicle:?}");
        vehicle.finish_actions();
        assert!(matches!(result(&exchange(&mut next, &mut vehicle, 6)), Some(GoalStatus::Succeeded(_))));
    }
    // The next process has driven before.
    let ((mut vehicle, stop), mut next) = (stopped(), machine(3));
    stop.iter().for_each(|command| vehicle.receive(command));
    exchange(&mut next, &mut vehicle, 1);
    send(&mut next, &mut vehicle, goal(NEXT, drive("b")), 2);
    (0..3).for_each(|_| vehicle.step());
    assert!(result(&exchange(&mut next, &mut vehicle, 3)).is_some());
    send(&mut next, &mut vehicle, begun_since(7, NEXT + 1, pick(false)), 4);
    let commands = [5, 6].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
    assert_eq!((result(&commands), acted(&vehicle)), (None, 2), "{vehicle:?}");
    // The action has ended before the vehicle could cancel it.
    let ((mut vehicle, stop), mut next) = (stopped(), machine(1));
    vehicle.finish_actions();
    stop.iter().for_each(|command| vehicle.receive(command));
    send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(false)), 1);
    let commands = [2, 3].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
    assert!(matches!(result(&commands), Some(GoalStatus::Succeeded(_))), "{commands:?}");
    assert_eq!(acted(&vehicle), 1, "{vehicle:?}");
}
