//! Actions that a process before a restart of the node may have begun.

use super::*;

#[test]
fn an_action_that_ended_while_no_node_ran_is_not_repeated() {
    for is_instant in [false, true] {
        let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, pick(is_instant))]));
        send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(is_instant)), 1);
        let commands = [2, 3].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
        assert!(matches!(result(&commands), Some(GoalStatus::Succeeded(_))), "{commands:?}");
        assert_eq!(acted(&vehicle), 1, "{vehicle:?}");
    }
}

#[test]
fn the_failure_of_an_action_that_ended_while_no_node_ran_is_reported_once() {
    for is_instant in [false, true] {
        let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, pick(is_instant))]));
        vehicle.actions.iter_mut().for_each(|action| action.status = ActionStatus::Failed);
        send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(is_instant)), 1);
        let commands = [2, 3].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
        assert!(matches!(result(&commands), Some(GoalStatus::Aborted(_))), "{commands:?}");
        assert_eq!(acted(&vehicle), 1, "{vehicle:?}");
        // The node has the result, and decides to try again.
        send(&mut next, &mut vehicle, begun_since(7, NEXT + 1, pick(is_instant)), 4);
        assert_eq!(acted(&vehicle), 2, "{vehicle:?}");
    }
}

#[test]
fn the_same_action_of_the_next_task_is_executed() {
    for is_instant in [false, true] {
        let (mut next, mut vehicle) = (machine(1), after_goals(&[(6, drive("b")), (7, pick(is_instant))]));
        // The node has recorded the end of the task.
        send(&mut next, &mut vehicle, goal(NEXT, pick(is_instant)), 1);
        exchange(&mut next, &mut vehicle, 2);
        assert_eq!(acted(&vehicle), 2, "{vehicle:?}");
    }
    // The task had not begun when the node ended: the latest order is older, or is the drive before the action.
    for first in [8, 9] {
        let earlier = [(6, drive("b")), (7, pick(false)), (8, drive("c"))];
        for is_instant in [false, true] {
            let (mut next, mut vehicle) = (machine(1), after_goals(&earlier));
            send(&mut next, &mut vehicle, begun_since(first, NEXT, pick(is_instant)), 1);
            let early = exchange(&mut next, &mut vehicle, 2);
            assert_eq!((result(&early), acted(&vehicle)), (None, 1), "the state may be older than the action");
            exchange(&mut next, &mut vehicle, 3);
            assert_eq!(acted(&vehicle), 2, "{vehicle:?}");
        }
    }
}

#[test]
fn an_action_after_the_drives_and_actions_of_its_task_is_executed() {
    let executed = |vehicle: &mut FakeVehicle, first: u64, id: u64, is_instant: bool| {
        let (mut next, before) = (machine(1), acted(vehicle));
        send(&mut next, vehicle, begun_since(first, id, pick(is_instant)), 1);
        let commands = [2, 3].map(|time| exchange(&mut next, vehicle, time)).concat();
        assert_eq!((result(&commands), acted(vehicle)), (None, before + 1), "{vehicle:?}");
    };
    for is_instant in [false, true] {
        // A drive is a goal for each leg. An earlier task may have had the same action.
        let legs = [(7, drive("b")), (8, drive("c"))];
        executed(&mut after_goals(&legs), 7, NEXT, is_instant);
        let earlier = [[(6, pick(is_instant))].as_slice(), &legs].concat();
        executed(&mut after_goals(&earlier), 7, NEXT, is_instant);
        // The task begins with another action.
        for undock in [act("undock", false), act("undock", true)] {
            executed(&mut after_goals(&[(7, undock), (8, drive("b"))]), 7, NEXT, is_instant);
        }
        // The node, or the driver, has restarted twice during the task.
        let mut vehicle = after_goals(&legs);
        let mut second = machine(3);
        exchange(&mut second, &mut vehicle, 1);
        send(&mut second, &mut vehicle, goal(NEXT, drive("d")), 2);
        vehicle.step();
        assert!(result(&exchange(&mut second, &mut vehicle, 3)).is_some());
        executed(&mut vehicle, 7, NEXT + 1, is_instant);
    }
}

#[test]
fn an_action_after_several_actions_of_its_task_is_executed() {
    let executed = |goals: &[(u64, Work)], is_instant: bool| {
        let (mut next, mut vehicle) = (machine(1), after_goals(goals));
        let before = acted(&vehicle);
        send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(is_instant)), 1);
        let commands = [2, 3].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
        (acted(&vehicle) - before, result(&commands).is_some())
    };
    for is_instant in [false, true] {
        let task = [(7, drive("b")), (8, act("undock", true)), (9, act("lift", false)), (10, drive("c"))];
        assert_eq!(executed(&task, is_instant), (1, false));
        let after_another = [[(6, pick(is_instant))].as_slice(), &task].concat();
        assert_eq!(executed(&after_another, is_instant), (1, false));
        // The task has begun the same action before.
        let begun = [(7, drive("b")), (8, pick(is_instant)), (9, act("lift", false)), (10, drive("c"))];
        assert_eq!(executed(&begun, is_instant), (0, true));
        // The id of the latest order does not name all actions of the task: it is that of another action, or that of a
        // drive after more actions than an id names.
        let steps = (7_u64..13).map(|id| (id, act(&format!("step {id}"), false)));
        let (steps, leg) = (Vec::from_iter(steps), [(13, drive("b"))]);
        assert_eq!(executed(&steps[..2], is_instant), (0, true));
        assert_eq!(executed(&[&steps[..], &leg].concat(), is_instant), (0, true));
        assert_eq!(executed(&[&steps[..4], &leg].concat(), is_instant), (1, false));
    }
}

#[test]
fn an_action_that_may_have_happened_is_not_repeated() {
    let refused = |next: &mut OrderMachine, vehicle: &mut FakeVehicle, id: u64, is_instant: bool, time: u64| {
        let before = acted(vehicle);
        let first = send(next, vehicle, begun_since(7, id, pick(is_instant)), time);
        let commands = [first, exchange(next, vehicle, time + 1), exchange(next, vehicle, time + 2)].concat();
        let Some(GoalStatus::Aborted(cause)) = result(&commands) else { panic!("{commands:?}") };
        assert!(cause.message.contains("not repeated"), "{cause:?}");
        assert_eq!(acted(vehicle), before, "{vehicle:?}");
    };
    for is_instant in [false, true] {
        // The next order has displaced the report of the action.
        let goals = [(6, drive("b")), (7, pick(is_instant)), (8, drive("c"))];
        let (mut next, mut vehicle) = (machine(1), after_goals(&goals));
        refused(&mut next, &mut vehicle, NEXT, is_instant, 1);
        refused(&mut next, &mut vehicle, NEXT + 1, is_instant, 5);
        // Two processes have driven since.
        let mut second = machine(3);
        exchange(&mut second, &mut vehicle, 1);
        send(&mut second, &mut vehicle, goal(NEXT + 2, drive("d")), 2);
        vehicle.step();
        assert!(result(&exchange(&mut second, &mut vehicle, 3)).is_some());
        refused(&mut machine(1), &mut vehicle, NEXT + 3, is_instant, 1);
        // The vehicle has restarted.
        refused(&mut machine(1), &mut FakeVehicle::at("a"), NEXT, is_instant, 1);
    }
    // The vehicle has its latest order, but does not report the action.
    let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, pick(false))]));
    vehicle.actions.clear();
    refused(&mut next, &mut vehicle, NEXT, false, 1);
}

#[test]
fn an_end_that_this_process_has_displaced_is_the_result_once() {
    let reported = |next: &mut OrderMachine, vehicle: &mut FakeVehicle, is_instant: bool, is_failed: bool| {
        let before = acted(vehicle);
        send(next, vehicle, begun_since(7, NEXT + 1, pick(is_instant)), 4);
        let status = result(&[5, 6].map(|time| exchange(next, vehicle, time)).concat());
        let is_end = |status: &GoalStatus| match status {
            GoalStatus::Aborted(cause) => is_failed && cause.message.contains("the action failed"),
            other => !is_failed && matches!(other, GoalStatus::Succeeded(_)),
        };
        assert!(status.as_ref().is_some_and(is_end), "{status:?}");
        assert_eq!(acted(vehicle), before, "{vehicle:?}");
        // The node has the result. A further goal is a new request.
        send(next, vehicle, begun_since(7, NEXT + 2, pick(is_instant)), 7);
        assert_eq!(acted(vehicle), before + 1, "{vehicle:?}");
    };
    for (is_instant, is_failed) in [(false, false), (false, true), (true, false), (true, true)] {
        let (mut next, mut vehicle) = (machine(3), after_goals(&[(6, drive("b")), (7, pick(is_instant))]));
        if is_failed {
            vehicle.actions.iter_mut().for_each(|action| action.status = ActionStatus::Failed);
        }
        exchange(&mut next, &mut vehicle, 1);
        send(&mut next, &mut vehicle, goal(NEXT, drive("c")), 2);
        (0..3).for_each(|_| vehicle.step());
        assert!(result(&exchange(&mut next, &mut vehicle, 3)).is_some());
        reported(&mut next, &mut vehicle, is_instant, is_failed);
    }
    // This process has let the vehicle forget ended instant actions.
    let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, drive("b")), (8, pick(true))]));
    vehicle.instants = INSTANTS_MAX;
    send(&mut next, &mut vehicle, goal(NEXT, drive("b")), 1);
    assert!(result(&exchange(&mut next, &mut vehicle, 2)).is_some());
    assert!(vehicle.executed.contains(&"clearInstantActions".to_owned()), "{vehicle:?}");
    (vehicle.instants, vehicle.actions) = (0, vec![]);
    exchange(&mut next, &mut vehicle, 3);
    reported(&mut next, &mut vehicle, true, false);
}

#[test]
fn an_old_state_does_not_show_that_an_action_was_not_begun() {
    for answers in [true, false] {
        let (mut next, mut vehicle) = (machine(1), after_goals(&[(6, drive("b"))]));
        exchange(&mut next, &mut vehicle, 1);
        send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(false)), 2);
        let waiting = send(&mut next, &mut vehicle, Event::Tick, 8);
        assert_eq!((orders(&waiting), result(&waiting)), (vec![], None), "it may be under way");
        if answers {
            assert_eq!(orders(&exchange(&mut next, &mut vehicle, 9)).len(), 1);
        } else {
            let late = send(&mut next, &mut vehicle, Event::Tick, 12);
            assert!(matches!(result(&late), Some(GoalStatus::Aborted(cause)) if cause.code == "timed_out"), "{late:?}");
        }
        assert_eq!(acted(&vehicle), usize::from(answers), "{vehicle:?}");
    }
}

#[test]
fn the_latest_of_several_earlier_attempts_at_an_action_counts() {
    let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, pick(true)), (8, pick(true))]));
    let first = vehicle.actions.iter_mut().find(|action| action.id.starts_with("consort-7-"));
    first.unwrap().status = ActionStatus::Failed;
    send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(true)), 1);
    let commands = [2, 3].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
    assert!(matches!(result(&commands), Some(GoalStatus::Succeeded(_))), "{commands:?}");
    assert_eq!(acted(&vehicle), 2, "the second attempt had succeeded");
}
