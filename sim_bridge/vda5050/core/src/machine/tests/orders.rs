//! The course of an order: base and horizon, repetition of lost messages, and its end.

use super::*;

#[test]
fn a_drive_is_released_node_by_node_and_stitched() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    let first = orders(&sent).remove(0);
    let nodes =
        |order: &Order| Vec::from_iter(order.nodes.iter().map(|node| (node.id.clone(), node.sequence, node.released)));
    let node = |id: &str, sequence, released| (id.to_owned(), sequence, released);
    assert_eq!(nodes(&first), [node("a", 0, true), node("b", 2, true), node("c", 4, false), node("d", 6, false)]);
    assert_eq!(
        Vec::from_iter(first.edges.iter().map(|edge| (edge.sequence, edge.released))),
        [(1, true), (3, false), (5, false)]
    );
    vehicle.receive(&sent[0]);
    vehicle.step();
    let update = orders(&exchange(&mut machine, &mut vehicle, 3)).remove(0);
    assert_eq!((update.id.as_str(), update.update), (first.id.as_str(), 1));
    assert_eq!(nodes(&update), [node("b", 2, true), node("c", 4, true), node("d", 6, false)]);
    vehicle.step();
    assert_eq!(orders(&exchange(&mut machine, &mut vehicle, 4))[0].update, 2);
    vehicle.step();
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 5)), Some(GoalStatus::Succeeded(String::new())));
    // A repeated goal repeats the result and starts nothing.
    let repeated = machine.step(goal(7, drive("d")), seconds(6));
    assert_eq!((repeated.len(), result(&repeated)), (1, Some(GoalStatus::Succeeded(String::new()))));
}

#[test]
fn a_lost_order_is_sent_again_and_executed_once() {
    for is_instant in [false, true] {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let lost = machine.step(goal(7, pick(is_instant)), seconds(2));
        let again = exchange(&mut machine, &mut vehicle, 5);
        assert_eq!(lost[0], again[0], "the same ids");
        // The first message arrives late.
        if !is_instant {
            vehicle.receive(&lost[0]);
        }
        vehicle.finish_actions();
        assert!(matches!(result(&exchange(&mut machine, &mut vehicle, 6)), Some(GoalStatus::Succeeded(_))));
        assert_eq!(vehicle.executed.len(), 1, "{:?}", vehicle.executed);
    }
}

#[test]
fn an_unanswered_order_is_not_repeated_before_a_younger_state() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    machine.step(goal(7, pick(true)), seconds(2));
    let commands = machine.step(Event::Tick, seconds(20));
    let kinds = commands.iter().filter_map(|command| match command {
        Command::SendInstant(action) => Some(action.kind.as_str()),
        _ => None,
    });
    assert_eq!(Vec::from_iter(kinds), ["stateRequest"], "the action may be under way");
}

#[test]
fn late_and_repeated_states_change_nothing() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    let late = vehicle.state();
    let sent = {
        exchange(&mut machine, &mut vehicle, 1);
        machine.step(goal(7, drive("b")), seconds(2))
    };
    vehicle.receive(&sent[0]);
    let state = vehicle.state();
    machine.step(Event::State(Box::new(state.clone())), seconds(3));
    for stale in [late, state] {
        let commands = machine.step(Event::State(Box::new(stale)), seconds(9));
        assert_eq!((orders(&commands), cancels(&commands)), (vec![], 0), "the order goes on");
    }
    vehicle.step();
    assert!(result(&exchange(&mut machine, &mut vehicle, 10)).is_some());
}

#[test]
fn a_drive_ends_when_the_vehicle_stands_still() {
    let (mut machine, mut vehicle) = (machine(usize::MAX), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("b")), seconds(2));
    assert!(orders(&sent)[0].nodes.iter().all(|node| node.released), "any number may be released");
    vehicle.receive(&sent[0]);
    vehicle.step();
    let rolling = VehicleState { is_driving: true, ..vehicle.state() };
    assert_eq!(result(&machine.step(Event::State(Box::new(rolling)), seconds(3))), None);
    assert!(matches!(result(&exchange(&mut machine, &mut vehicle, 4)), Some(GoalStatus::Succeeded(_))));
}

#[test]
fn the_last_node_of_the_order_before_releases_nothing() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    vehicle.receive(&sent[0]);
    // The vehicle has accepted the order, and has not passed its first node.
    let first = RemainingNode { id: "a".to_owned(), sequence: 0, released: true };
    let accepted = vehicle.state();
    let nodes = Vec::from_iter([first].into_iter().chain(accepted.nodes.clone()));
    let stale = VehicleState { nodes, last_node: "z".to_owned(), last_sequence: 6, ..accepted };
    assert_eq!(stale.reached(), None);
    assert_eq!(orders(&machine.step(Event::State(Box::new(stale)), seconds(3))), []);
    vehicle.step();
    assert_eq!(orders(&exchange(&mut machine, &mut vehicle, 4))[0].update, 1);
    // A vehicle on a node may keep it among the nodes to drive to.
    let here = RemainingNode { id: "b".to_owned(), sequence: 2, released: true };
    let state = vehicle.state();
    let nodes = Vec::from_iter([here].into_iter().chain(state.nodes.clone()));
    assert_eq!(VehicleState { nodes, ..state }.reached(), Some(2));
}

#[test]
fn an_order_of_another_master_is_not_touched() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    let node =
        OrderNode { id: "b".to_owned(), sequence: 2, released: true, at_m: None, yaw_rad: None, actions: vec![] };
    (vehicle.order, vehicle.ahead) = ("of-another".to_owned(), vec![node]);
    machine.step(goal(7, drive("d")), seconds(1));
    let commands = [exchange(&mut machine, &mut vehicle, 2), exchange(&mut machine, &mut vehicle, 12)].concat();
    let Some(GoalStatus::Aborted(cause)) = result(&commands) else { panic!("{commands:?}") };
    assert_eq!((cause.code.as_str(), cancels(&commands), orders(&commands).len()), ("busy", 0, 0));
    assert!(cause.message.contains("of-another"), "{cause:?}");
}

#[test]
fn ended_instant_actions_are_removed_between_goals() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    vehicle.instants = INSTANTS_MAX;
    let clears = |commands: &[Command]| {
        let is_clear = |command: &&Command| matches!(command, Command::SendInstant(action) if action.kind == "clearInstantActions");
        commands.iter().filter(is_clear).count()
    };
    assert_eq!(clears(&exchange(&mut machine, &mut vehicle, 1)), 0, "a goal of an earlier process may need them");
    let ended = machine.step(goal(7, drive("a")), seconds(2));
    assert_eq!((result(&ended), clears(&ended)), (Some(GoalStatus::Succeeded(String::new())), 1));
    assert_eq!(clears(&exchange(&mut machine, &mut vehicle, 3)), 0, "the vehicle has time to do it");
}
