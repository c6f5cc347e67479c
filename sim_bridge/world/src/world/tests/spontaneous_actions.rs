//! Unrequested actions of people, at each trigger.

use super::*;
use crate::world::actions::{ApproachPerson, AuthenticatePerson, OperateDrawer};
use consort_skills::actions::NavigateToPose;
use std::collections::BTreeMap;

fn bea_with(action: SpontaneousAction) -> PersonSetup {
    PersonSetup { spontaneous_actions: vec![action], ..nurse("Bea", "PC Room 2", "s2") }
}

fn ward(seed: u64, action: SpontaneousAction) -> World {
    World::new(hospital(seed).robot(carrier("r1", "PC Room 2")).person(bea_with(action))).unwrap()
}

fn approach() -> Goal {
    Goal::from(ApproachPerson { role: role("nurse") })
}

fn called_off() -> BackendEvent {
    BackendEvent::MissionCanceled { by: "Bea".to_owned(), role: role("nurse"), robot: robot("r1") }
}

/// Approaches, authenticates, opens the drawer and requests a handover. Returns the events of a
/// minute with their times.
fn meet_and_wait(world: &mut World) -> Vec<(f64, BackendEvent)> {
    let mut events = Vec::new();
    let goals =
        [approach(), Goal::from(AuthenticatePerson { role: role("nurse") }), Goal::from(OperateDrawer { open: true })];
    for (id, goal) in (1..).zip(goals) {
        world.start(&robot("r1"), GoalId(id), goal);
        events.extend(until(world, world.now().as_secs() + 2.0));
    }
    world.request_person(GoalId(7), deposit("r1"));
    events.extend(until(world, 60.0));
    events.retain(|(_, event)| !matches!(event, BackendEvent::GoalEnded { status: GoalStatus::Succeeded(_), .. }));
    events
}

fn until(world: &mut World, time: f64) -> Vec<(f64, BackendEvent)> {
    let mut events = Vec::new();
    while let Some(due) = world.next_due().filter(|due| due.as_secs() <= time) {
        events.extend(world.advance(due).into_iter().map(|event| (due.as_secs(), event)));
    }
    world.advance(at(time));
    events
}

fn sample_holder(world: &World) -> SampleHolder {
    world.sample(&"s2".into()).unwrap().holder
}

#[test]
fn a_person_cancels_the_mission_at_each_trigger() {
    let stages =
        [(PersonTrigger::Approached, 3.0), (PersonTrigger::Authenticated, 5.0), (PersonTrigger::HandingOver, 7.0)];
    for (trigger, when) in stages {
        let mut world =
            ward(1, SpontaneousAction { after_s: 1.0, ..SpontaneousAction::certain(trigger, PersonAction::Cancels) });
        assert_eq!(meet_and_wait(&mut world), [(when, called_off())], "{trigger:?}");
        assert_eq!(sample_holder(&world), SampleHolder::Person("Bea".into()), "{trigger:?}: she keeps it");
        assert_eq!(world.open_person_requests(), [GoalId(7)], "until the mission is canceled");
        world.cancel_person_request(GoalId(7));
        assert_eq!(world.open_person_requests(), []);
    }
    let mut world = ward(
        1,
        SpontaneousAction {
            after_s: 20.0,
            ..SpontaneousAction::certain(PersonTrigger::HandedOver, PersonAction::Cancels)
        },
    );
    let events = meet_and_wait(&mut world);
    let (given, off) = (&events[0], &events[1]);
    assert_eq!(
        (&given.1, &off.1),
        (&BackendEvent::PersonRequestEnded { request: GoalId(7), result: Ok(BTreeMap::new()) }, &called_off())
    );
    assert!((off.0 - given.0 - 20.0).abs() < 1e-9 && events.len() == 2, "{events:?}");
    assert_eq!(sample_holder(&world), SampleHolder::Drawer(robot("r1")), "it is under way");
}

#[test]
fn a_robot_that_approaches_again_is_served() {
    let action = SpontaneousAction {
        probability: 0.5,
        ..SpontaneousAction::certain(PersonTrigger::Approached, PersonAction::Cancels)
    };
    let served = (0..20).find(|seed| {
        let mut world = ward(*seed, action);
        let first = meet_and_wait(&mut world) == [(2.0, called_off())];
        let (status, others) = run(&mut world, "r1", 9, approach());
        let again = status == GoalStatus::succeeded() && others.is_empty();
        let quiet =
            until(&mut world, 70.0).iter().any(|(_, event)| matches!(event, BackendEvent::PersonRequestEnded { .. }));
        first && again && quiet
    });
    assert!(served.is_some(), "of twenty seeds one has her call off once, and not twice");
}

#[test]
fn a_person_declines() {
    let mut world = ward(1, SpontaneousAction::certain(PersonTrigger::HandingOver, PersonAction::Declines));
    let why = ActionError::rejected(ErrorCode::NotAuthenticated, "Bea declines".to_owned());
    assert_eq!(
        meet_and_wait(&mut world),
        [(6.0, BackendEvent::PersonRequestEnded { request: GoalId(7), result: Err(why) })]
    );
    assert_eq!(sample_holder(&world), SampleHolder::Person("Bea".into()));
}

fn leaves(at: PersonTrigger, back_after_s: Option<f64>) -> SpontaneousAction {
    SpontaneousAction { back_after_s, ..SpontaneousAction::certain(at, PersonAction::WalksAway) }
}

fn gone(waited_s: f64) -> BackendEvent {
    let message = format!("every nurse has walked away; waited for {waited_s} s");
    BackendEvent::PersonRequestEnded {
        request: GoalId(7),
        result: Err(ActionError::rejected(ErrorCode::OutOfReach, message)),
    }
}

#[test]
fn a_request_for_an_absent_person_times_out() {
    let mut world = ward(1, SpontaneousAction { after_s: 1.0, ..leaves(PersonTrigger::HandingOver, None) });
    assert_eq!(meet_and_wait(&mut world), []);
    assert_eq!(until(&mut world, 300.0), [(127.0, gone(120.0))], "she left at 7 s");
    assert_eq!(sample_holder(&world), SampleHolder::Person("Bea".into()));
    assert_eq!(world.robot_report(&robot("r1")).unwrap().beside_person, None);
    assert!(world.people()[0].away);
    // The person has left before the robot comes, and the task states the timeout.
    let mut world = ward(1, leaves(PersonTrigger::Waiting, None));
    world.advance(at(0.0));
    let status = rejected_status(&mut world, "r1", 1, approach());
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "r1: no nurse is at PC Room 2"));
    let mut ask = deposit("r1");
    ask.task.parameters.insert("timeout_s".to_owned(), "30".to_owned());
    let asked_at = world.now().as_secs();
    world.request_person(GoalId(7), ask);
    assert_eq!(until(&mut world, 300.0), [(asked_at + 30.0, gone(30.0))]);
}

#[test]
fn a_returning_person_serves_a_robot_that_stayed() {
    let mut world = ward(1, leaves(PersonTrigger::Authenticated, Some(30.0)));
    let events = meet_and_wait(&mut world);
    assert_eq!(events.len(), 1, "{events:?}");
    assert_eq!(events[0].1, BackendEvent::PersonRequestEnded { request: GoalId(7), result: Ok(BTreeMap::new()) });
    assert!(events[0].0 > 34.0, "she was back at 34 s: {events:?}");
    assert_eq!(sample_holder(&world), SampleHolder::Drawer(robot("r1")));
    assert_eq!(until(&mut world, 300.0), [], "nobody gives up afterwards");
}

#[test]
fn a_request_waits_on_if_the_robot_left_before_the_return() {
    let mut world = ward(1, leaves(PersonTrigger::Authenticated, Some(30.0)));
    for (id, goal) in (1..).zip([approach(), Goal::from(AuthenticatePerson { role: role("nurse") })]) {
        run_to_success(&mut world, "r1", id, goal);
    }
    run_to_success(&mut world, "r1", 3, Goal::from(OperateDrawer { open: true }));
    world.request_person(GoalId(7), deposit("r1"));
    let there = world.map().place(&place("PC Corridor 2")).map(|place| place.pose);
    let there = there.expect("on the map");
    world.start(&robot("r1"), GoalId(4), Goal::from(NavigateToPose::to(there, Some(place("PC Corridor 2")))));
    let ended = until(&mut world, 200.0);
    assert!(
        !ended.iter().any(|(_, event)| matches!(event, BackendEvent::PersonRequestEnded { .. })),
        "she waits: {ended:?}"
    );
    assert_eq!(sample_holder(&world), SampleHolder::Person("Bea".into()));
}

#[test]
fn a_person_steps_away_before_authentication() {
    let prove = || Goal::from(AuthenticatePerson { role: role("nurse") });
    let mut world = ward(1, leaves(PersonTrigger::Approached, Some(10.0)));
    run_to_success(&mut world, "r1", 1, approach());
    let status = rejected_status(&mut world, "r1", 2, prove());
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "r1: Bea has walked away"));
    until(&mut world, 13.0);
    run_to_success(&mut world, "r1", 3, prove());
}

#[test]
fn a_person_returns() {
    let mut world = ward(1, leaves(PersonTrigger::Waiting, Some(10.0)));
    world.advance(at(9.0));
    let status = rejected_status(&mut world, "r1", 1, approach());
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "r1: no nurse is at PC Room 2"));
    world.advance(at(10.0));
    run_to_success(&mut world, "r1", 2, approach());
}

#[test]
fn a_request_waits_while_another_person_is_present() {
    let action = SpontaneousAction {
        after_s: 1.0,
        ..SpontaneousAction::certain(PersonTrigger::HandingOver, PersonAction::WalksAway)
    };
    let setup =
        hospital(1).robot(carrier("r1", "PC Room 2")).person(bea_with(action)).person(nurse("Ana", "PC Room 1", "s1"));
    let mut world = World::new(setup).unwrap();
    assert_eq!(meet_and_wait(&mut world), []);
    assert_eq!(world.open_person_requests(), [GoalId(7)]);
}

#[test]
fn spontaneous_actions_depend_on_the_seed() {
    let action = SpontaneousAction {
        probability: 0.5,
        ..SpontaneousAction::certain(PersonTrigger::HandingOver, PersonAction::Declines)
    };
    let declines = |seed| {
        let answer = meet_and_wait(&mut ward(seed, action));
        matches!(answer[..], [(_, BackendEvent::PersonRequestEnded { result: Err(_), .. })])
    };
    let often = (0..100).filter(|seed| declines(*seed)).count();
    assert!((30..=70).contains(&often), "{often} of 100");
    assert!((0..20).all(|seed| declines(seed) == declines(seed)));
    // The handover time does not depend on the actions.
    let takes = |actions: Vec<SpontaneousAction>| {
        let person = PersonSetup { spontaneous_actions: actions, ..nurse("Bea", "PC Room 2", "s2") };
        meet_and_wait(&mut World::new(hospital(3).robot(carrier("r1", "PC Room 2")).person(person)).unwrap())
    };
    assert_eq!(takes(vec![]), takes(vec![SpontaneousAction { probability: 0.0, ..action }]));
}

#[test]
fn a_setup_with_invalid_spontaneous_actions_is_rejected() {
    let mut person = bea_with(SpontaneousAction::certain(PersonTrigger::Waiting, PersonAction::Cancels));
    person.spontaneous_actions.push(SpontaneousAction::certain(PersonTrigger::Approached, PersonAction::Declines));
    person.spontaneous_actions.push(SpontaneousAction {
        probability: 2.0,
        after_s: -1.0,
        ..SpontaneousAction::certain(PersonTrigger::Waiting, PersonAction::WalksAway)
    });
    let errors = World::new(hospital(1).person(person)).unwrap_err().to_string();
    assert_eq!(
        errors.lines().collect::<Vec<_>>(),
        [
            "person Bea: spontaneous action: the trigger does not fit the action; allowed is approached, authenticated, handing_over or handed_over, which involve a robot",
            "person Bea: spontaneous action: the trigger does not fit the action; allowed is handing_over, the only action that can be declined",
            "person Bea: spontaneous action: after_s is -1, allowed is a number of seconds, 0 or more",
            "person Bea: spontaneous action: probability is 2, allowed is a number from 0 to 1",
        ]
    );
}
