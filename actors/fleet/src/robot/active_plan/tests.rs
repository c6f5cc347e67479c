use super::super::test_values::{at, award, started};
use super::*;

/// Writes the checkpoint if it is outdated.
fn write(active: &mut ActivePlan) -> Option<Checkpoint> {
    let checkpoint = active.start_checkpoint()?;
    assert!(!active.finish_checkpoint(true));
    Some(checkpoint)
}

/// Starts the next task and returns its position and its id.
fn start_task(active: &mut ActivePlan, now: NodeTime) -> (StepRef, TaskId) {
    match active.next_action(now) {
        Some(PlanAction::StartTask { step, task, .. }) => (step, task),
        other => panic!("{other:?}"),
    }
}

fn failure(kind: FailureKind) -> AttemptFailure {
    AttemptFailure::new(kind, "stuck")
}

#[test]
fn each_step_is_stored_before_it_has_an_effect() {
    let mut active = started(award(7), None);
    assert_eq!(active.next_action(at(0)), None, "no checkpoint is stored");
    assert_eq!(write(&mut active).unwrap().first_goal, GoalId(100));
    let (step, task) = start_task(&mut active, at(0));
    active.end_task(step, task, BTreeMap::new(), GoalId(103));
    assert_eq!(active.next_action(at(0)), None);
    let checkpoint = write(&mut active).unwrap();
    assert_eq!((checkpoint.own.ended, checkpoint.first_goal), (BTreeSet::from([0]), GoalId(103)));
    let Some(PlanAction::Emit(outputs)) = active.next_action(at(0)) else { panic!("the end of the task") };
    assert!(matches!(&outputs[..], [PendingOutput::Event(EventKind::TaskEnded { .. })]), "{outputs:?}");
    assert_eq!(active.next_action(at(0)), None, "the signal waits for the checkpoint");
    assert_eq!(write(&mut active).unwrap().own.ended, BTreeSet::from([0, 1]));
    let Some(PlanAction::Emit(outputs)) = active.next_action(at(0)) else { panic!("the signal") };
    assert!(matches!(&outputs[..], [PendingOutput::Signal(_)]), "{outputs:?}");
    assert_eq!(start_task(&mut active, at(0)).1.as_str(), "return");
    assert_eq!(write(&mut active), None, "the checkpoint is up to date");
}

#[test]
fn a_failed_task_is_retried_after_the_pause_and_then_released() {
    let mut active = started(award(7), None);
    write(&mut active);
    start_task(&mut active, at(0));
    let delay = Duration::from_millis(500);
    let effect = active.recover(failure(FailureKind::Task), delay, at(100));
    assert!(matches!(effect, Some(RecoveryEffect::Retry(after, _)) if after == delay), "{effect:?}");
    assert_eq!(active.next_action(at(599)), None);
    start_task(&mut active, at(600));
    let effect = active.recover(failure(FailureKind::Task), delay, at(700));
    assert!(matches!(effect, Some(RecoveryEffect::Release(EventKind::TaskFailed { .. }))), "{effect:?}");
    let driver = |is_idle| DriverActivity { is_idle, silent_for: Duration::ZERO, stop_lead: Duration::ZERO };
    let needs_report = |is_idle| active.needs_report(driver(is_idle), at(700));
    assert!(active.is_releasing() && needs_report(true) && !needs_report(false));
    assert_eq!(active.next_action(at(9_000)), None);
    assert_eq!(active.recover(failure(FailureKind::Battery), delay, at(9_000)), None, "released already");
}

fn place(name: &str) -> PlaceId {
    name.parse().unwrap()
}

/// Returns a plan in which the first task has ended and the second has started.
fn under_way(award: Award) -> ActivePlan {
    let mut active = started(award, None);
    write(&mut active);
    let (step, task) = start_task(&mut active, at(0));
    active.end_task(step, task, BTreeMap::new(), GoalId(103));
    for _ in 0..2 {
        write(&mut active);
        assert!(matches!(active.next_action(at(0)), Some(PlanAction::Emit(_))));
        let next = active.next_action(at(0));
        assert!(matches!(next, None | Some(PlanAction::StartTask { .. })), "{next:?}");
    }
    active
}

#[test]
fn a_robot_returns_to_the_place_that_it_left_before_its_plan_goes_on() {
    let mut active = under_way(award(7));
    active.suspend();
    active.leave(place("Ward"));
    active.leave(place("Dock"));
    let checkpoint = write(&mut active).unwrap();
    assert_eq!(checkpoint.left, Some(place("Ward")), "the first place");
    let tasks: Vec<String> = active.remaining_plan().tasks().map(|(_, task)| task.task_type.to_string()).collect();
    assert_eq!(tasks, ["navigation", "drive"]);
    let mut restored = started(award(7), Some(checkpoint));
    write(&mut restored);
    for active in [&mut active, &mut restored] {
        assert_eq!(active.next_action(at(0)), Some(PlanAction::ReturnTo(place("Ward"))));
        assert_eq!(active.place_left(), Some(&place("Ward")));
        active.set_returned();
        assert_eq!(active.remaining_plan().tasks().count(), 1);
        assert_eq!(active.next_action(at(0)), None, "the return is not stored yet");
        assert_eq!(write(active).map(|checkpoint| checkpoint.left), Some(None));
        assert_eq!(start_task(active, at(0)).1.as_str(), "return");
    }
}

#[test]
fn a_robot_goes_on_from_where_it_stands_with_a_drive_and_before_its_first_step() {
    let mut untouched = started(award(7), None);
    write(&mut untouched);
    start_task(&mut untouched, at(0));
    untouched.suspend();
    untouched.leave(place("Dock"));
    let mut drives = award(7);
    for step in &mut drives.plan.steps {
        if let StepAction::Task { spec, .. } = &mut step.action {
            spec.task_type = drive_to(&place("Ward")).task_type;
        }
    }
    let mut drives = under_way(drives);
    drives.suspend();
    drives.suspend();
    drives.leave(place("Dock"));
    for active in [&mut untouched, &mut drives] {
        assert_eq!(active.place_left(), None);
        assert_eq!(write(active), None, "the checkpoint is up to date");
        start_task(active, at(0));
    }
}

#[test]
fn a_robot_without_a_task_returns_to_where_it_waited() {
    let mut waits = started(award(7), None);
    write(&mut waits);
    let (step, task) = start_task(&mut waits, at(0));
    waits.end_task(step, task, BTreeMap::new(), GoalId(103));
    waits.suspend();
    waits.leave(place("Ward"));
    assert_eq!(waits.place_left(), Some(&place("Ward")));
}

#[test]
fn a_plan_that_does_not_fit_the_ledger_is_released() {
    let award = award(7);
    let recorded = BTreeSet::from([2]);
    let holders = award.holders.clone();
    let start = PlanStart { award, recorded: &recorded, holders, restored: None, next_goal: GoalId(1) };
    let (mut active, failure) = ActivePlan::start(start).unwrap();
    let event = active.release(failure.unwrap(), at(0));
    assert!(matches!(event, EventKind::GaveUp { kind: FailureKind::Plan, .. }), "{event:?}");
}

#[test]
fn a_robot_without_an_item_releases_its_role_for_lack_of_charge() {
    let mut active = started(award(7), None);
    let failure = AttemptFailure::new(FailureKind::Battery, "low");
    assert_eq!(active.handle_shortfall("low".to_owned()), ShortfallEffect::Fail(failure));
}

#[test]
fn a_robot_that_may_carry_an_item_continues_and_warns_once() {
    let mut award = award(7);
    award.plan.guarded.insert(1);
    let recorded = BTreeSet::from([0, 1]);
    let holders = award.holders.clone();
    let start = PlanStart { award, recorded: &recorded, holders, restored: None, next_goal: GoalId(1) };
    let (mut active, _) = ActivePlan::start(start).unwrap();
    let first = active.handle_shortfall("low".to_owned());
    assert!(matches!(first, ShortfallEffect::Continue(Some(EventKind::LowCharge { .. }))), "{first:?}");
    assert_eq!(active.handle_shortfall("low".to_owned()), ShortfallEffect::Continue(None));
}
