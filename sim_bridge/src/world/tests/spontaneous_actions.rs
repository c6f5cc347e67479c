//! People who change their minds, at each stage.

use super::*;

fn bea(mood: SpontaneousAction) -> PersonSetup {
    PersonSetup { mood: vec![mood], ..nurse("Bea", "PC Room 2", "s2") }
}

fn ward(seed: u64, mood: SpontaneousAction) -> World {
    World::new(hospital(seed).robot(carrier("r1", "PC Room 2")).person(bea(mood))).unwrap()
}

fn approach() -> Goal {
    Goal::ApproachPerson { role: role("nurse") }
}

fn called_off() -> BackendEvent {
    BackendEvent::MissionCanceled { by: "Bea".to_owned(), role: role("nurse"), robot: robot("r1") }
}

/// Approaches, opens the drawer, has her asked: what is said until a minute later, and when.
fn meeting(world: &mut World) -> Vec<(f64, BackendEvent)> {
    let mut said = Vec::new();
    let deeds = [approach(), Goal::AuthenticatePerson { role: role("nurse") }, Goal::OperateDrawer { open: true }];
    for (id, goal) in (1..).zip(deeds) {
        world.start(&robot("r1"), GoalId(id), goal);
        said.extend(until(world, world.now().as_secs() + 2.0));
    }
    world.request_person(GoalId(7), deposit("r1"));
    said.extend(until(world, 60.0));
    said.retain(|(_, event)| !matches!(event, BackendEvent::GoalEnded { status: GoalStatus::Succeeded, .. }));
    said
}

fn until(world: &mut World, time: f64) -> Vec<(f64, BackendEvent)> {
    let mut said = Vec::new();
    while let Some(due) = world.next_due().filter(|due| due.as_secs() <= time) {
        said.extend(world.advance(due).into_iter().map(|event| (due.as_secs(), event)));
    }
    world.advance(at(time));
    said
}

fn keeper(world: &World) -> SampleHolder {
    world.sample(&"s2".into()).unwrap().keeper
}

#[test]
fn she_calls_the_mission_off_at_each_stage() {
    let stages =
        [(PersonTrigger::Approached, 3.0), (PersonTrigger::Authenticated, 5.0), (PersonTrigger::HandingOver, 7.0)];
    for (moment, when) in stages {
        let mut world =
            ward(1, SpontaneousAction { after_s: 1.0, ..SpontaneousAction::certain(moment, PersonAction::Cancels) });
        assert_eq!(meeting(&mut world), [(when, called_off())], "{moment:?}");
        assert_eq!(keeper(&world), SampleHolder::Person("Bea".into()), "{moment:?}: she keeps it");
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
    let said = meeting(&mut world);
    let (given, off) = (&said[0], &said[1]);
    assert_eq!(
        (&given.1, &off.1),
        (&BackendEvent::PersonRequestEnded { ask: GoalId(7), result: Ok(()) }, &called_off())
    );
    assert!((off.0 - given.0 - 20.0).abs() < 1e-9 && said.len() == 2, "{said:?}");
    assert_eq!(keeper(&world), SampleHolder::Drawer(robot("r1")), "it is under way");
}

#[test]
fn a_robot_that_comes_anew_is_served() {
    let mood = SpontaneousAction {
        probability: 0.5,
        ..SpontaneousAction::certain(PersonTrigger::Approached, PersonAction::Cancels)
    };
    let served = (0..20).find(|seed| {
        let mut world = ward(*seed, mood);
        let first = meeting(&mut world) == [(2.0, called_off())];
        let (status, others) = run(&mut world, "r1", 9, approach());
        let again = status == GoalStatus::Succeeded && others.is_empty();
        let quiet =
            until(&mut world, 70.0).iter().any(|(_, event)| matches!(event, BackendEvent::PersonRequestEnded { .. }));
        first && again && quiet
    });
    assert!(served.is_some(), "of twenty seeds one has her call off once, and not twice");
}

#[test]
fn she_declines() {
    let mut world = ward(1, SpontaneousAction::certain(PersonTrigger::HandingOver, PersonAction::Declines));
    let why = ActionError { code: ErrorCode::NotAuthenticated, message: "Bea declines".to_owned() };
    assert_eq!(meeting(&mut world), [(6.0, BackendEvent::PersonRequestEnded { ask: GoalId(7), result: Err(why) })]);
    assert_eq!(keeper(&world), SampleHolder::Person("Bea".into()));
}

fn leaves(at: PersonTrigger, back_after_s: Option<f64>) -> SpontaneousAction {
    SpontaneousAction { back_after_s, ..SpontaneousAction::certain(at, PersonAction::WalksAway) }
}

fn gone(waited_s: f64) -> BackendEvent {
    let message = format!("every nurse has walked away; waited for {waited_s} s");
    BackendEvent::PersonRequestEnded {
        ask: GoalId(7),
        result: Err(ActionError { code: ErrorCode::OutOfReach, message }),
    }
}

#[test]
fn she_walks_away_and_is_waited_for_so_long_and_no_longer() {
    let mut world = ward(1, SpontaneousAction { after_s: 1.0, ..leaves(PersonTrigger::HandingOver, None) });
    assert_eq!(meeting(&mut world), []);
    assert_eq!(until(&mut world, 300.0), [(127.0, gone(120.0))], "she left at 7 s");
    assert_eq!(keeper(&world), SampleHolder::Person("Bea".into()));
    assert_eq!(world.robot_report(&robot("r1")).unwrap().beside_person, None);
    assert!(world.people()[0].away);
    // She is gone before anybody comes, and the task says how long it can wait.
    let mut world = ward(1, leaves(PersonTrigger::Waiting, None));
    world.advance(at(0.0));
    let status = rejected_status(&mut world, "r1", 1, approach());
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "r1: no nurse is at PC Room 2"));
    let mut ask = deposit("r1");
    ask.task.parameters.insert("patience".to_owned(), "30".to_owned());
    let asked_at = world.now().as_secs();
    world.request_person(GoalId(7), ask);
    assert_eq!(until(&mut world, 300.0), [(asked_at + 30.0, gone(30.0))]);
}

#[test]
fn she_comes_back_to_a_robot_that_has_stayed() {
    let mut world = ward(1, leaves(PersonTrigger::Authenticated, Some(30.0)));
    let said = meeting(&mut world);
    assert_eq!(said.len(), 1, "{said:?}");
    assert_eq!(said[0].1, BackendEvent::PersonRequestEnded { ask: GoalId(7), result: Ok(()) });
    assert!(said[0].0 > 34.0, "she was back at 34 s: {said:?}");
    assert_eq!(keeper(&world), SampleHolder::Drawer(robot("r1")));
    assert_eq!(until(&mut world, 300.0), [], "nobody gives up afterwards");
}

#[test]
fn she_comes_back_and_the_robot_has_gone() {
    let mut world = ward(1, leaves(PersonTrigger::Authenticated, Some(30.0)));
    for (id, goal) in (1..).zip([approach(), Goal::AuthenticatePerson { role: role("nurse") }]) {
        run_to_success(&mut world, "r1", id, goal);
    }
    run_to_success(&mut world, "r1", 3, Goal::OperateDrawer { open: true });
    world.request_person(GoalId(7), deposit("r1"));
    let there = world.map().place(&place("PC Corridor 2")).map(|place| place.pose);
    let there = there.expect("on the map");
    world.start(&robot("r1"), GoalId(4), Goal::NavigateToPose { pose: there, place: Some(place("PC Corridor 2")) });
    let ended = until(&mut world, 200.0);
    assert!(
        !ended.iter().any(|(_, event)| matches!(event, BackendEvent::PersonRequestEnded { .. })),
        "she waits: {ended:?}"
    );
    assert_eq!(keeper(&world), SampleHolder::Person("Bea".into()));
}

#[test]
fn she_steps_away_before_she_has_proved_who_she_is() {
    let prove = || Goal::AuthenticatePerson { role: role("nurse") };
    let mut world = ward(1, leaves(PersonTrigger::Approached, Some(10.0)));
    run_to_success(&mut world, "r1", 1, approach());
    let status = rejected_status(&mut world, "r1", 2, prove());
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "r1: Bea has walked away"));
    until(&mut world, 13.0);
    run_to_success(&mut world, "r1", 3, prove());
}

#[test]
fn she_comes_back() {
    let mut world = ward(1, leaves(PersonTrigger::Waiting, Some(10.0)));
    world.advance(at(9.0));
    let status = rejected_status(&mut world, "r1", 1, approach());
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "r1: no nurse is at PC Room 2"));
    world.advance(at(10.0));
    run_to_success(&mut world, "r1", 2, approach());
}

#[test]
fn an_ask_waits_on_while_another_may_do_it() {
    let mood = SpontaneousAction {
        after_s: 1.0,
        ..SpontaneousAction::certain(PersonTrigger::HandingOver, PersonAction::WalksAway)
    };
    let setup = hospital(1).robot(carrier("r1", "PC Room 2")).person(bea(mood)).person(nurse("Ana", "PC Room 1", "s1"));
    let mut world = World::new(setup).unwrap();
    assert_eq!(meeting(&mut world), []);
    assert_eq!(world.open_person_requests(), [GoalId(7)]);
}

#[test]
fn what_comes_over_her_is_drawn_from_the_seed() {
    let mood = SpontaneousAction {
        probability: 0.5,
        ..SpontaneousAction::certain(PersonTrigger::HandingOver, PersonAction::Declines)
    };
    let declines = |seed| {
        let answer = meeting(&mut ward(seed, mood));
        matches!(answer[..], [(_, BackendEvent::PersonRequestEnded { result: Err(_), .. })])
    };
    let often = (0..100).filter(|seed| declines(*seed)).count();
    assert!((30..=70).contains(&often), "{often} of 100");
    assert!((0..20).all(|seed| declines(seed) == declines(seed)));
    // How long she takes does not depend on what comes over her.
    let takes = |mood: Vec<SpontaneousAction>| {
        let person = PersonSetup { mood, ..nurse("Bea", "PC Room 2", "s2") };
        meeting(&mut World::new(hospital(3).robot(carrier("r1", "PC Room 2")).person(person)).unwrap())
    };
    assert_eq!(takes(vec![]), takes(vec![SpontaneousAction { probability: 0.0, ..mood }]));
}

#[test]
fn a_setup_with_moods_that_cannot_be_is_refused() {
    let mut person = bea(SpontaneousAction::certain(PersonTrigger::Waiting, PersonAction::Cancels));
    person.mood.push(SpontaneousAction::certain(PersonTrigger::Approached, PersonAction::Declines));
    person.mood.push(SpontaneousAction {
        probability: 2.0,
        after_s: -1.0,
        ..SpontaneousAction::certain(PersonTrigger::Waiting, PersonAction::WalksAway)
    });
    let errors = World::new(hospital(1).person(person)).unwrap_err().to_string();
    assert_eq!(
        errors.lines().collect::<Vec<_>>(),
        [
            "person Bea: mood: it may come over her at approached, authenticated, handing_over or handed_over, when there is a robot",
            "person Bea: mood: it may come over her at handing_over: there is nothing else to decline",
            "person Bea: mood: after_s is -1, allowed is a number of seconds, 0 or more",
            "person Bea: mood: probability is 2, allowed is a number from 0 to 1",
        ]
    );
}
