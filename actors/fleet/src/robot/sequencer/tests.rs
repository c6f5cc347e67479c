use super::*;
use serde_json::json;
use std::sync::Arc;

fn plan(value: serde_json::Value) -> LocalPlan {
    serde_json::from_value(value).unwrap()
}

fn task(id: &str, after: &[u32]) -> serde_json::Value {
    json!({ "action": { "Task": { "id": id, "spec": { "type": id, "roles": ["r1"] } } }, "after": after })
}

fn send(task: &str, after: &[u32]) -> serde_json::Value {
    json!({ "action": { "Send": { "kind": "done", "task": task, "from": "r1", "to": "arm" } }, "after": after })
}

fn wait(task: &str, after: &[u32]) -> serde_json::Value {
    json!({ "action": { "Wait": { "kind": "done", "task": task, "from": "arm", "to": "r1" } }, "after": after })
}

fn alternative_json(replaces: &[u32], tasks: &[&str]) -> serde_json::Value {
    let tasks: Vec<_> = tasks.iter().map(|id| json!([id, { "type": id, "roles": ["r1"] }])).collect();
    json!({ "replaces": replaces, "tasks": tasks })
}

fn held(epochs: &[(&str, u64)]) -> BTreeMap<RoleId, RoleHolder> {
    let holding = |index: &u64| RoleHolder { robot: "ada".parse().unwrap(), epoch: Epoch { term: 1, index: *index } };
    epochs.iter().map(|(role, index)| (role.parse().unwrap(), holding(index))).collect()
}

fn at(index: u64) -> Epoch {
    Epoch { term: 1, index }
}

fn sequencer(plan: LocalPlan) -> Sequencer {
    Sequencer::new(plan, &BTreeSet::new(), held(&[("r1", 5), ("arm", 5)])).unwrap()
}

/// Executes until a task of `fails` is next. Returns the names of the actions performed.
fn run(sequencer: &mut Sequencer, fails: &[&str]) -> Vec<String> {
    let mut done = vec![];
    while let Some(next) = sequencer.next_action() {
        match next {
            SequencerAction::StartTask { task, .. } if fails.contains(&task.as_str()) => break,
            SequencerAction::StartTask { step, task, .. } => {
                sequencer.end_task(step, BTreeMap::new());
                done.push(task.to_string());
            }
            SequencerAction::SendSignal(signal) => done.push(format!("sent {}", signal.task)),
            SequencerAction::SignalReceived(signal) => done.push(format!("received {}", signal.task)),
            SequencerAction::TaskSkipped(task) => done.push(format!("skipped {task}")),
            SequencerAction::ResultUnknown { task, cause } => {
                done.push(format!("{task}: {cause}"));
                break;
            }
        }
    }
    done
}

#[test]
fn a_task_waits_until_the_role_it_names_has_a_holder_again() {
    let step = json!({ "action": { "Task": { "id": "meet", "spec": {
        "type": "approach_robot", "roles": ["r1"], "parameters": { "robot_role": "arm" } } } }, "after": [] });
    let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": [step] })));
    sequencer.set_holders(held(&[("r1", 5)]));
    assert_eq!(sequencer.next_action(), None);
    sequencer.set_holders(held(&[("r1", 5), ("arm", 6)]));
    assert!(matches!(sequencer.next_action(), Some(SequencerAction::StartTask { step: StepRef::Step(0), .. })));
}

#[test]
fn a_task_waits_for_the_first_holder_of_the_role_it_names() {
    let step = |named: &str| {
        let spec = json!({ "type": "deposit", "roles": ["clerk"], "parameters": { "into_role": named } });
        json!({ "action": { "Task": { "id": "deposit", "spec": spec } }, "after": [] })
    };
    let sequencer_with = |named| {
        let plan = plan(json!({ "role": "clerk", "steps": [step(named)] }));
        let mut sequencer = Sequencer::new(plan, &BTreeSet::new(), held(&[("arm", 5)])).unwrap();
        sequencer.set_vacant_roles(&BTreeSet::from(["r1".parse().unwrap()]));
        sequencer
    };
    let mut waits = sequencer_with("r1");
    assert_eq!(waits.next_action(), None);
    assert!(!waits.set_holders(held(&[("arm", 5), ("r1", 6)])), "no signal was received before");
    waits.set_vacant_roles(&BTreeSet::new());
    assert!(matches!(waits.next_action(), Some(SequencerAction::StartTask { step: StepRef::Step(0), .. })));
    let starts = |named| matches!(sequencer_with(named).next_action(), Some(SequencerAction::StartTask { .. }));
    assert!(starts("arm") && starts("r3"), "arm has a holder, and r3 is not a role of the mission");
}

#[test]
fn alternatives_are_tried_in_order_and_end_the_steps_they_replace() {
    let steps = [task("drive", &[]), task("knock", &[0]), task("enter", &[1]), send("enter", &[2])];
    let alternatives = [
        alternative_json(&[1], &["ring"]),
        alternative_json(&[1], &["call"]),
        alternative_json(&[0, 1, 2], &["lift", "descend"]),
    ];
    let plan = plan(json!({ "role": "r1", "steps": steps, "alternatives": alternatives }));
    let mut sequencer = sequencer(plan.clone());
    assert_eq!(run(&mut sequencer, &["knock"]), ["drive"]);
    assert_eq!(sequencer.switch_to_alternative(), Some(0));
    assert_eq!(run(&mut sequencer, &["ring"]), [""; 0]);
    assert_eq!(sequencer.switch_to_alternative(), Some(1));
    let second_alternative = sequencer.clone();
    assert_eq!(run(&mut sequencer, &["enter"]), ["call"]);
    assert_eq!(*sequencer.ended(), BTreeSet::from([0, 1]));
    assert_eq!(sequencer.switch_to_alternative(), Some(2), "the alternative to all steps");
    assert_eq!(run(&mut sequencer, &[]), ["lift", "descend", "sent enter"]);
    assert!(sequencer.is_complete());

    let mut stuck = second_alternative;
    run(&mut stuck, &["call"]);
    assert_eq!(stuck.switch_to_alternative(), Some(2), "the alternative of a replaced step is replaced, too");
    assert_eq!(run(&mut stuck, &["lift"]), [""; 0]);
    assert_eq!(stuck.switch_to_alternative(), None, "an alternative starts at most once");
}

#[test]
fn a_restored_alternative_continues_unless_its_steps_have_ended() {
    let alternatives = [alternative_json(&[0], &["lift", "descend"])];
    let steps = [task("drive", &[]), task("knock", &[0])];
    let plan = plan(json!({ "role": "r1", "steps": steps, "alternatives": alternatives }));
    let mut former = sequencer(plan.clone());
    run(&mut former, &["drive"]);
    former.switch_to_alternative();
    run(&mut former, &["descend"]);
    let none = BTreeSet::new();
    let resume = |recorded: &BTreeSet<u32>| {
        Sequencer::resume(plan.clone(), recorded, former.own_progress(), held(&[("r1", 5)])).unwrap()
    };
    assert_eq!(run(&mut resume(&none), &[]), ["descend", "knock"]);
    assert_eq!(run(&mut resume(&BTreeSet::from([0])), &[]), ["knock"]);
}

#[test]
fn the_remaining_plan_has_the_alternative_and_no_replaced_steps() {
    let steps = [task("drive", &[]), task("knock", &[0]), task("enter", &[1])];
    let plan =
        plan(json!({ "role": "r1", "steps": steps, "alternatives": [alternative_json(&[1], &["ring", "call"])] }));
    let mut sequencer = sequencer(plan);
    let rest =
        |sequencer: &Sequencer| sequencer.remaining_plan().tasks().map(|(id, _)| id.to_string()).collect::<Vec<_>>();
    run(&mut sequencer, &["knock"]);
    assert_eq!(rest(&sequencer), ["knock", "enter"]);
    sequencer.switch_to_alternative();
    run(&mut sequencer, &["call"]);
    assert_eq!(rest(&sequencer), ["call", "enter"]);
}

#[test]
fn a_guarded_step_waits_until_the_ledger_contains_its_predecessors() {
    let steps = [task("open", &[]), send("open", &[0]), task("close", &[1])];
    let plan = plan(json!({ "role": "r1", "steps": steps, "guarded": [1] }));
    let mut sequencer = sequencer(plan);
    assert_eq!(run(&mut sequencer, &[]), ["open"]);
    assert!(sequencer.awaits_ledger() && !sequencer.may_have_custody());
    sequencer.set_recorded(&BTreeSet::from([0]));
    assert!(!sequencer.awaits_ledger());
    assert_eq!(run(&mut sequencer, &[]), ["sent open", "close"]);
    assert!(sequencer.may_have_custody());
}

#[test]
fn a_role_can_be_restarted_until_it_has_sent_a_signal() {
    let open = json!({ "kind": "done", "task": "open", "from": "arm", "to": "r1" });
    let steps = [task("drive", &[]), wait("open", &[0]), send("drive", &[1]), wait("lift", &[2])];
    let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": steps })));
    assert_eq!(run(&mut sequencer, &[]), ["drive"]);
    assert!(!sequencer.is_untouched() && sequencer.can_be_restarted());
    let received = sequencer.receive_signal(&serde_json::from_value(open).unwrap(), at(5), &Author::UNKNOWN);
    assert_eq!(received, Ok(SignalEffect::Received));
    assert_eq!(run(&mut sequencer, &[]), ["received open", "sent drive"]);
    assert!(!sequencer.can_be_restarted());
}

#[test]
fn a_stale_signal_is_rejected_and_an_unused_signal_is_discarded() {
    let signal: Signal =
        serde_json::from_value(json!({ "kind": "done", "task": "lift", "from": "arm", "to": "r1" })).unwrap();
    let steps = [task("drive", &[]), wait("lift", &[0])];
    let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": steps })));
    let unknown = &Author::UNKNOWN;
    assert_eq!(sequencer.receive_signal(&signal, at(4), unknown), Err(StaleSignal { current: at(5) }));
    assert_eq!(sequencer.receive_signal(&signal, at(5), unknown), Ok(SignalEffect::Received));
    assert!(!sequencer.set_holders(held(&[("r1", 5)])), "the role has no new holder yet");
    assert!(sequencer.set_holders(held(&[("r1", 5), ("arm", 9)])));
    assert_eq!(run(&mut sequencer, &[]), ["drive"]);
    assert_eq!(sequencer.receive_signal(&signal, at(5), unknown), Err(StaleSignal { current: at(9) }));
    assert_eq!(sequencer.receive_signal(&signal, at(9), unknown), Ok(SignalEffect::Received));
    assert_eq!(run(&mut sequencer, &[]), ["received lift"]);
}

#[test]
fn a_signal_of_a_person_counts_once_it_is_in_the_ledger() {
    let signal: Signal =
        serde_json::from_value(json!({ "kind": "done", "task": "lift", "from": "arm", "to": "r1" })).unwrap();
    let plan = plan(json!({ "role": "r1", "steps": [wait("lift", &[])] }));
    let mut sequencer = Sequencer::new(plan, &BTreeSet::new(), held(&[("r1", 5)])).unwrap();
    // Whoever sends it: the coordinator is queried, and only its reply counts.
    for author in [author("ada", "robot"), author("world", "host&serves=arm"), author("bob", "voter")] {
        let effect = sequencer.receive_signal(&signal, Epoch::default(), &author);
        assert_eq!(effect, Ok(SignalEffect::AwaitsConfirmation), "{author}");
    }
    assert_eq!(run(&mut sequencer, &[]), [] as [&str; 0]);
    sequencer.receive_recorded(&BTreeSet::from([signal.clone()]));
    assert_eq!(sequencer.receive_signal(&signal, Epoch::default(), &author("bob", "voter")), Ok(SignalEffect::None));
    assert_eq!(run(&mut sequencer, &[]), ["received lift"]);
}

fn author(node: &str, roles: &str) -> Author {
    Author::verified(Arc::new(format!("consort://ward/node/{node}?roles={roles}").parse().unwrap()))
}

#[test]
fn only_the_holder_that_the_coordinator_has_confirmed_sends_signals_of_its_role() {
    let signal: Signal =
        serde_json::from_value(json!({ "kind": "done", "task": "lift", "from": "arm", "to": "r1" })).unwrap();
    let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": [wait("lift", &[])] })));
    let (ada, eve) = (author("ada", "robot"), author("eve", "robot,host"));
    assert_eq!(sequencer.receive_signal(&signal, at(5), &eve), Ok(SignalEffect::None), "ada holds the role");
    assert_eq!(sequencer.receive_signal(&signal, at(u64::MAX), &eve), Ok(SignalEffect::AwaitsConfirmation));
    // The claim of a later award makes the holder's signals neither outdated nor lost.
    assert_eq!(sequencer.receive_signal(&signal, at(9), &ada), Ok(SignalEffect::None), "others are parked already");
    assert_eq!(run(&mut sequencer, &[]), [] as [&str; 0]);
    assert!(!sequencer.set_holders(held(&[("r1", 5), ("arm", 9)])));
    assert_eq!(run(&mut sequencer, &[]), ["received lift"], "the parked signal of the new award counts");
}

#[test]
fn parked_signals_are_bounded_and_kept_until_their_award_is_confirmed() {
    let signal = |task: usize| -> Signal {
        serde_json::from_value(json!({ "kind": "done", "task": format!("t{task}"), "from": "arm", "to": "r1" }))
            .unwrap()
    };
    let steps = [wait("t0", &[]), wait("t99", &[])];
    let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": steps })));
    for task in 0..100 {
        sequencer.receive_signal(&signal(task), at(9), &Author::UNKNOWN).unwrap();
    }
    sequencer.set_holders(held(&[("r1", 5), ("arm", 8)]));
    assert_eq!(run(&mut sequencer, &[]), [] as [&str; 0], "another award was confirmed");
    sequencer.set_holders(held(&[("r1", 5), ("arm", 9)]));
    assert_eq!(run(&mut sequencer, &[]), ["received t99"], "the oldest were dropped");
}

#[test]
fn a_role_may_receive_an_item_once_the_steps_before_a_guard_have_ended() {
    let steps = [task("drive", &[]), task("open", &[0]), send("open", &[1]), wait("deposit", &[2])];
    let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": steps, "guarded": [2] })));
    let performed = |sequencer: &Sequencer| (sequencer.has_ended_task(), sequencer.may_receive_item());
    assert_eq!(performed(&sequencer), (false, false));
    run(&mut sequencer, &["open"]);
    assert_eq!(performed(&sequencer), (true, false));
    sequencer.abort_task();
    let Some(SequencerAction::StartTask { step, .. }) = sequencer.next_action() else { panic!("a task is next") };
    sequencer.end_task(step, BTreeMap::new());
    assert_eq!(performed(&sequencer), (true, true), "the send has not ended, and the ledger cannot tell");
    assert!(sequencer.can_be_restarted() && !sequencer.may_have_custody());
}
