use super::*;
use consort_protocol::devices::DeviceKind;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, ErrorCode, Feedback};
use std::collections::{BTreeMap, BTreeSet};

fn at(ms: u64) -> NodeTime {
    NodeTime::at(Duration::from_millis(ms))
}

fn control() -> DeviceControl {
    let device = Device {
        name: "door".parse().unwrap(),
        kind: DeviceKind::Door,
        host: "station".parse().unwrap(),
        lanes: BTreeSet::new(),
        places: BTreeSet::new(),
        silent_after: Duration::from_secs(5),
        in_alarm: AlarmPosition::Closed,
    };
    DeviceControl::new(device, 100)
}

fn input(lease: Option<u64>, is_ready: Option<bool>) -> HostInput {
    let feedback = |is_ready| Feedback {
        values: BTreeMap::from([(READY.to_owned(), Scalar::Bool(is_ready))]),
        ..Feedback::remaining(Metres::ZERO, Seconds::ZERO)
    };
    let status = is_ready.map(|is_ready| GoalStatus::Executing(feedback(is_ready)));
    let claim = lease.map(|lease| (lease, None));
    HostInput { claim, is_robot_lost: false, is_alarm: false, responds: true, status }
}

#[test]
fn a_device_serves_the_latest_lease_and_confirms_it() {
    let mut control = control();
    assert_eq!(
        control.step(&input(None, None), at(0)).1,
        DeviceReport { state: DeviceState::Idle, lease: None, place: None }
    );
    let (actions, report) = control.step(&input(Some(7), None), at(100));
    assert!(matches!(&actions[..], [HostAction::Start(GoalId(100), goal)] if goal.action.as_str() == "serve"));
    assert_eq!(report, DeviceReport { state: DeviceState::Preparing, lease: Some(7), place: None });
    assert_eq!(control.step(&input(Some(7), Some(false)), at(200)).1.state, DeviceState::Preparing);
    let (actions, report) = control.step(&input(Some(7), Some(true)), at(300));
    assert_eq!((actions, report.state), (vec![HostAction::Permit(GoalId(100))], DeviceState::Ready));
    let (actions, report) = control.step(&input(Some(9), Some(true)), at(400));
    assert_eq!(actions, [HostAction::Cancel(GoalId(100))], "it closes before it opens for another robot");
    assert_eq!(report, DeviceReport { state: DeviceState::Preparing, lease: Some(7), place: None });
    let canceled = HostInput { status: Some(GoalStatus::Canceled), ..input(Some(9), None) };
    assert!(matches!(&control.step(&canceled, at(500)).0[..], [HostAction::Start(GoalId(101), _)]));
}

#[test]
fn a_lift_is_asked_for_the_stop_that_the_robot_needs() {
    let (mut control, place) = (control(), "L1".parse::<PlaceId>().unwrap());
    let (actions, report) =
        control.step(&HostInput { claim: Some((7, Some(place.clone()))), ..input(None, None) }, at(0));
    let [HostAction::Start(_, goal)] = &actions[..] else { panic!("{actions:?}") };
    assert_eq!((&goal.parameters["place"], report.place), (&Value::from("L1"), Some(place)));
    let next = HostInput { claim: Some((7, Some("L2".parse().unwrap()))), ..input(None, Some(true)) };
    let alarm = HostInput { is_alarm: true, ..next };
    assert_eq!(control.step(&alarm, at(100)).0, [HostAction::Cancel(GoalId(100))]);
    let canceled = HostInput { status: Some(GoalStatus::Canceled), ..alarm };
    let (actions, _) = control.step(&canceled, at(200));
    let [HostAction::Start(_, goal)] = &actions[..] else { panic!("{actions:?}") };
    assert_eq!(goal.parameters["place"], Value::from("L2"), "the robot inside leaves before the alarm counts");
}

#[test]
fn a_canceled_goal_confirms_nothing_and_must_end() {
    let mut control = control();
    let at_stop = |name: &str| HostInput { claim: Some((7, name.parse().ok())), ..input(None, Some(true)) };
    control.step(&HostInput { status: None, ..at_stop("L0") }, at(0));
    assert_eq!(control.step(&at_stop("L0"), at(200)).1.state, DeviceState::Ready);
    assert_eq!(control.step(&at_stop("L1"), at(400)).0, [HostAction::Cancel(GoalId(100))]);
    let (actions, report) = control.step(&at_stop("L0"), at(600));
    assert_eq!((actions, report.state), (vec![HostAction::Cancel(GoalId(100))], DeviceState::Preparing));
    assert_eq!(control.step(&at_stop("L0"), at(60_399)).1.state, DeviceState::Preparing);
    assert_eq!(control.step(&at_stop("L0"), at(60_400)).1.state, DeviceState::Silent);
}

#[test]
fn a_driver_that_is_silent_or_does_not_confirm_is_reported() {
    let mut away = control();
    let silent = HostInput { responds: false, ..HostInput::default() };
    assert_eq!(away.step(&silent, at(0)).1.state, DeviceState::Idle);
    assert_eq!(away.step(&silent, at(5_000)).1.state, DeviceState::Silent);
    assert_eq!(away.step(&input(None, None), at(5_100)).1.state, DeviceState::Idle);
    let mut stuck = control();
    stuck.step(&input(Some(7), None), at(0));
    assert_eq!(stuck.step(&input(Some(7), Some(false)), at(4_999)).1.state, DeviceState::Preparing);
    assert_eq!(stuck.step(&input(Some(7), Some(false)), at(5_000)).1.state, DeviceState::Silent);
    assert_eq!(stuck.step(&input(None, Some(false)), at(9_999)).0, [HostAction::Permit(GoalId(100))]);
    assert_eq!(stuck.step(&input(None, Some(false)), at(10_000)).0, [HostAction::Cancel(GoalId(100))]);
    let canceled = HostInput { status: Some(GoalStatus::Canceled), ..input(None, None) };
    assert_eq!(stuck.step(&canceled, at(11_000)).1.state, DeviceState::Silent, "for a while");
    assert_eq!(stuck.step(&input(None, None), at(75_000)).1.state, DeviceState::Idle);
}

#[test]
fn a_device_that_fails_with_a_robot_inside_reports_its_lease() {
    let mut control = control();
    control.step(&input(Some(7), None), at(0));
    control.step(&input(Some(7), Some(true)), at(100));
    let jammed = ActionError::rejected(ErrorCode::Unknown, "the door is jammed".to_owned());
    let aborted = HostInput { status: Some(GoalStatus::Aborted(jammed)), ..input(Some(7), None) };
    let inside = DeviceReport { state: DeviceState::Silent, lease: Some(7), place: None };
    assert_eq!(control.step(&aborted, at(200)), (vec![], inside.clone()));
    assert_eq!(control.step(&input(Some(7), None), at(400)).1, inside);
    assert_eq!(control.step(&input(None, None), at(600)).1.lease, None, "the robot has left");
}

#[test]
fn a_device_with_a_lost_robot_is_blocked_until_it_is_safe_or_the_robot_returns() {
    let lost = |input: HostInput| HostInput { is_robot_lost: true, ..input };
    for returns in [true, false] {
        let mut control = control();
        control.step(&input(Some(7), None), at(0));
        assert_eq!(control.step(&input(Some(7), Some(true)), at(100)).1.state, DeviceState::Ready);
        let (actions, report) = control.step(&lost(input(Some(7), Some(true))), at(200));
        assert_eq!(actions, [HostAction::Permit(GoalId(100))], "it stays open");
        assert_eq!(report, DeviceReport { state: DeviceState::Blocked, lease: Some(7), place: None });
        if returns {
            assert_eq!(control.step(&input(Some(7), Some(true)), at(300)).1.state, DeviceState::Ready);
            continue;
        }
        // A person ends the lease.
        assert_eq!(control.step(&input(None, Some(true)), at(400)).1.state, DeviceState::Blocked);
        assert_eq!(control.step(&input(None, Some(true)), at(5_300)).0, [HostAction::Cancel(GoalId(100))]);
        assert_eq!(control.step(&input(Some(9), Some(false)), at(6_000)).1.state, DeviceState::Blocked);
        let canceled = HostInput { status: Some(GoalStatus::Canceled), ..input(None, None) };
        assert_eq!(control.step(&canceled, at(7_000)).1.state, DeviceState::Idle, "the driver has closed it");
    }
    // The node of the device has restarted.
    let mut control = control();
    assert_eq!(control.step(&lost(input(None, None)), at(0)).1.state, DeviceState::Blocked);
    assert_eq!(control.step(&input(None, None), at(100)).1.state, DeviceState::Idle);
}

#[test]
fn an_alarm_counts_once_the_served_robot_has_left() {
    let mut control = control();
    let alarm = |input: HostInput| HostInput { is_alarm: true, ..input };
    control.step(&input(Some(7), None), at(0));
    assert_eq!(control.step(&alarm(input(Some(7), Some(true))), at(100)).1.state, DeviceState::Ready);
    let (actions, report) = control.step(&alarm(input(None, Some(true))), at(5_000));
    assert_eq!((actions, report.state), (vec![HostAction::Permit(GoalId(100))], DeviceState::Ready), "it may return");
    assert_eq!(control.step(&alarm(input(None, Some(true))), at(5_100)).0, [HostAction::Cancel(GoalId(100))]);
    let canceled = HostInput { status: Some(GoalStatus::Canceled), ..input(Some(8), None) };
    let (actions, _) = control.step(&alarm(canceled), at(5_300));
    let [HostAction::Start(_, goal)] = &actions[..] else { panic!("{actions:?}") };
    assert_eq!((goal.action.as_str(), &goal.parameters["position"]), ("alarm", &Value::from("closed")));
    assert_eq!(control.step(&alarm(input(Some(8), Some(true))), at(5_400)).1.state, DeviceState::Alarm);
}
