//! Errors, rejections and vehicles that do not answer.

use super::*;
use crate::incoming::ConnectionState;

#[test]
fn errors_of_the_vehicle_end_a_goal_with_their_cause() {
    let with_error = |kind: &str, level: ErrorLevel, is_accepted: bool| {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, drive("d")), seconds(2));
        let order = orders(&sent).remove(0);
        if is_accepted {
            vehicle.receive(&sent[0]);
        }
        let references = vec![("orderId".to_owned(), order.id)];
        vehicle.errors = vec![VehicleError { kind: kind.to_owned(), level, description: String::new(), references }];
        let first = exchange(&mut machine, &mut vehicle, 3);
        let second = exchange(&mut machine, &mut vehicle, 4);
        ([&first, &second].iter().find_map(|commands| result(commands)), cancels(&first))
    };
    let code = |status: Option<GoalStatus>| match status {
        Some(GoalStatus::Aborted(cause)) => cause.code,
        other => panic!("{other:?}"),
    };
    // The vehicle rejects the order.
    let (status, _) = with_error("noRouteError", ErrorLevel::Warning, false);
    assert_eq!(code(status), "no_route");
    // The vehicle fails in the order; the goal ends when it has stopped.
    let (status, _) = with_error("obstacle", ErrorLevel::Fatal, true);
    assert_eq!(code(status), "blocked");
    // A warning of an accepted order changes nothing.
    assert_eq!(with_error("dust", ErrorLevel::Warning, true), (None, 0));
}

#[test]
fn errors_count_for_the_order_that_they_concern() {
    let error = |kind: &str, level: ErrorLevel, references: Vec<(String, String)>| {
        vec![VehicleError { kind: kind.to_owned(), level, description: String::new(), references }]
    };
    // A critical error allows another order, a fatal one does not.
    for (level, count) in [(ErrorLevel::Critical, 1), (ErrorLevel::Fatal, 0)] {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        vehicle.errors = error("jam", level, vec![]);
        exchange(&mut machine, &mut vehicle, 1);
        assert_eq!(orders(&machine.step(goal(7, drive("d")), seconds(2))).len(), count, "{level:?}");
    }
    // The refusal of a late cancel is no rejection of the next order.
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    vehicle.errors = error("NO_ORDER_TO_CANCEL", ErrorLevel::Warning, vec![]);
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 3)), None);
    // Nor is the refusal of a message with instant actions.
    vehicle.errors =
        error("validationError", ErrorLevel::Warning, vec![("topic".to_owned(), "instantActions".to_owned())]);
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 4)), None);
    // Nor is the rejection of a late order.
    let earlier = vec![("orderId".to_owned(), "consort-1-cd741fe9-0".to_owned())];
    vehicle.errors = error("orderUpdateError", ErrorLevel::Warning, earlier);
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 5)), None);
    // A new process finds the order, and the error that the order has caused.
    vehicle.receive(&sent[0]);
    vehicle.errors = error("obstacle", ErrorLevel::Fatal, vec![("orderId".to_owned(), vehicle.order.clone())]);
    let mut next = self::machine(1);
    next.step(resumed(7, drive("d")), seconds(1));
    let commands = [exchange(&mut next, &mut vehicle, 2), exchange(&mut next, &mut vehicle, 3)].concat();
    assert_eq!(cancels(&commands), 1);
    let status = result(&exchange(&mut next, &mut vehicle, 4));
    assert!(matches!(status, Some(GoalStatus::Aborted(cause)) if cause.code == "blocked"));
}

#[test]
fn a_rejection_of_3_0_without_references_ends_the_goal() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    machine.step(goal(7, drive("d")), seconds(2));
    let references = vec![("parameter".to_owned(), "order.nodes.nodePosition.theta".to_owned())];
    let (kind, level) = ("UNSUPPORTED_PARAMETER".to_owned(), ErrorLevel::Critical);
    vehicle.errors = vec![VehicleError { kind, level, description: String::new(), references }];
    let status = result(&exchange(&mut machine, &mut vehicle, 3));
    assert!(matches!(status, Some(GoalStatus::Aborted(cause)) if cause.message.contains("UNSUPPORTED_PARAMETER")));
}

#[test]
fn an_action_that_could_be_retried_fails_the_goal() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, pick(false)), seconds(2));
    vehicle.receive(&sent[0]);
    vehicle.actions[0].status = ActionStatus::Retriable;
    let commands = exchange(&mut machine, &mut vehicle, 3);
    assert_eq!((cancels(&commands), result(&commands)), (1, None));
    assert!(matches!(result(&exchange(&mut machine, &mut vehicle, 4)), Some(GoalStatus::Aborted(_))));
}

#[test]
fn an_order_or_action_that_the_vehicle_ignores_fails_the_goal() {
    for work in [drive("d"), pick(false), pick(true)] {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        machine.step(goal(7, work), seconds(2));
        let steps = (3..40).map(|time| machine.step(Event::State(Box::new(vehicle.state())), seconds(time)));
        let commands: Vec<Command> = steps.flatten().collect();
        let Some(GoalStatus::Aborted(cause)) = result(&commands) else { panic!("{commands:?}") };
        assert_eq!(cause.code, "timed_out");
        assert!(cause.message.contains("not accepted"), "{cause:?}");
    }
}

#[test]
fn a_vehicle_that_is_offline_silent_or_in_manual_mode_is_unavailable() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    assert_eq!(machine.unavailable(seconds(1)).as_deref(), Some("it has not reported its state"));
    exchange(&mut machine, &mut vehicle, 1);
    assert_eq!(machine.unavailable(seconds(2)), None);
    for connection in [ConnectionState::Offline, ConnectionState::Broken, ConnectionState::Hibernating] {
        machine.step(Event::Connection(connection), seconds(2));
        assert!(machine.unavailable(seconds(2)).is_some(), "{connection:?}");
        machine.step(Event::Connection(ConnectionState::Online), seconds(2));
        assert_eq!(machine.unavailable(seconds(2)), None, "{connection:?}");
    }
    let manual = VehicleState { mode: "MANUAL".to_owned(), ..vehicle.state() };
    machine.step(Event::State(Box::new(manual)), seconds(3));
    assert!(machine.unavailable(seconds(3)).is_some_and(|problem| problem.contains("MANUAL")));
    exchange(&mut machine, &mut vehicle, 4);
    assert_eq!((machine.unavailable(seconds(4)), machine.unavailable(seconds(33))), (None, None));
    assert!(machine.unavailable(seconds(34)).is_some(), "a vehicle reports its state every 30 s");
    machine.step(Event::Broker { is_up: false }, seconds(5));
    assert_eq!(machine.unavailable(seconds(5)).as_deref(), Some("no connection to the broker"));
}

#[test]
fn a_silent_vehicle_fails_the_goal_and_is_stopped_when_it_returns() {
    let (mut machine, mut vehicle) = (machine(3), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    vehicle.receive(&sent[0]);
    exchange(&mut machine, &mut vehicle, 3);
    let status = result(&machine.step(Event::Tick, seconds(40)));
    assert!(matches!(status, Some(GoalStatus::Aborted(cause)) if cause.code == "timed_out"));
    let later = [exchange(&mut machine, &mut vehicle, 50), exchange(&mut machine, &mut vehicle, 54)].concat();
    assert_eq!(cancels(&later), 1);
}
