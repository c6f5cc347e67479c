use super::*;
use crate::messages::NavigateResult;
use consort_skills::actions::Undock;
use tokio::sync::mpsc::unbounded_channel;

struct DriverTest {
    driver: Nav2Driver,
    sent_commands: UnboundedReceiver<Nav2Command>,
    nav2: UnboundedSender<Nav2Event>,
    now: f64,
}

fn place(name: &str) -> PlaceId {
    name.parse().unwrap()
}

fn ada() -> RobotId {
    "ada".parse().unwrap()
}

/// Returns A at (0, 0), B at (10, 0) and C at (20, 0).
fn places() -> BTreeMap<PlaceId, Pose> {
    [("A", 0.0), ("B", 10.0), ("C", 20.0)].map(|(name, x)| (place(name), Pose::new(x, 0.0, 0.0))).into()
}

/// Returns a test with these places; the robot is at A.
fn test() -> DriverTest {
    let ((commands, sent_commands), (nav2, nav2_events)) = (unbounded_channel(), unbounded_channel());
    let driver = Nav2Driver::new(ada(), place("A"), places(), commands, nav2_events).unwrap();
    DriverTest { driver, sent_commands, nav2, now: 0.0 }
}

impl DriverTest {
    fn to(&self, name: &str) -> Waypoint {
        Waypoint { pose: places()[&place(name)], place: Some(place(name)) }
    }

    fn go(&mut self, id: u64, name: &str) {
        let Waypoint { pose, place } = self.to(name);
        self.driver.start(&ada(), GoalId(id), Goal::from(NavigateToPose::to(pose, place)));
    }

    fn sent_commands(&mut self) -> Vec<Nav2Command> {
        std::iter::from_fn(|| self.sent_commands.try_recv().ok()).collect()
    }

    /// Delivers an event of Nav2 and advances time by a second; returns the goals that end
    /// meanwhile.
    fn after_event(&mut self, event: Option<Nav2Event>) -> Vec<(u64, GoalStatus)> {
        event.into_iter().for_each(|event| self.nav2.send(event).unwrap());
        self.now += 1.0;
        let events = self.driver.advance(WorldTime::from_secs(self.now));
        let ended = |event| match event {
            BackendEvent::GoalEnded { goal, status, .. } => (goal.0, status),
            other => panic!("{other:?}"),
        };
        events.into_iter().map(ended).collect()
    }

    fn telemetry(&self) -> Telemetry {
        self.driver.telemetry(&ada()).unwrap()
    }
}

fn aborted(code: ErrorCode, message: &str) -> GoalStatus {
    GoalStatus::Aborted(ActionError::new(code, message.to_owned()))
}

fn outcome(error_code: u16) -> DriveResult {
    DriveResult::Aborted(NavigateResult { error_code, error_msg: "why".to_owned() })
}

#[test]
fn a_drive_ends_with_the_result_of_nav2() {
    let mut test = test();
    assert_eq!(test.driver.next_due(), None, "no goal is in progress");
    test.go(7, "B");
    assert_eq!(test.sent_commands(), [Nav2Command::Drive(1, Pose::new(10.0, 0.0, 0.0))]);
    let progress = Nav2Event::Progress { drive: 1, pose: Pose::new(4.0, 0.1, 0.2), distance_m: 6.0, remaining_s: 12.0 };
    assert_eq!(test.after_event(Some(progress)), []);
    let feedback = Feedback::remaining(Metres::new(6.0).unwrap(), Seconds::new(12.0).unwrap());
    assert_eq!(test.driver.status(&ada(), GoalId(7)), Some(GoalStatus::Executing(feedback)));
    assert_eq!((test.telemetry().pose, test.telemetry().place), (Pose::new(4.0, 0.1, 0.2), place("A")));
    assert_eq!(test.after_event(Some(Nav2Event::Ended(1, DriveResult::Succeeded))), [(7, GoalStatus::succeeded())]);
    assert_eq!(test.telemetry().place, place("B"));
    test.go(7, "C");
    assert_eq!((test.sent_commands(), test.after_event(None)), (vec![], vec![]), "a repeated id starts nothing");
}

#[test]
fn waypoints_are_driven_to_in_order() {
    let mut test = test();
    let waypoints = vec![test.to("B"), test.to("C")];
    test.driver.start(&ada(), GoalId(1), Goal::from(FollowWaypoints { waypoints }));
    assert_eq!(test.after_event(Some(Nav2Event::Ended(1, DriveResult::Succeeded))), []);
    assert_eq!(
        test.sent_commands(),
        [Nav2Command::Drive(1, Pose::new(10.0, 0.0, 0.0)), Nav2Command::Drive(2, Pose::new(20.0, 0.0, 0.0))]
    );
    assert_eq!(test.after_event(Some(Nav2Event::Ended(1, outcome(208)))), [], "the event of an ended drive");
    let Some(GoalStatus::Executing(feedback)) = test.driver.status(&ada(), GoalId(1)) else {
        panic!("a drive is in progress")
    };
    assert_eq!(feedback.progress, GoalProgress::Waypoint(1));
    assert_eq!(test.after_event(Some(Nav2Event::Ended(2, DriveResult::Succeeded))), [(1, GoalStatus::succeeded())]);
}

#[test]
fn a_canceled_drive_ends_when_nav2_reports_it() {
    let mut test = test();
    test.go(1, "B");
    test.driver.cancel(&ada(), GoalId(1));
    test.driver.cancel(&ada(), GoalId(1));
    assert_eq!(test.sent_commands()[1..], [Nav2Command::Stop(1)], "a single command");
    assert_eq!(test.after_event(None), []);
    test.go(2, "B");
    let busy = aborted(ErrorCode::Busy, "ada has a goal in progress");
    assert_eq!(
        test.after_event(Some(Nav2Event::Ended(1, DriveResult::Canceled))),
        [(2, busy), (1, GoalStatus::Canceled)]
    );
}

#[test]
fn a_cancel_between_two_waypoints_ends_the_goal() {
    let mut test = test();
    let waypoints = vec![test.to("B"), test.to("C")];
    test.driver.start(&ada(), GoalId(1), Goal::from(FollowWaypoints { waypoints }));
    test.driver.cancel(&ada(), GoalId(1));
    assert_eq!(test.after_event(Some(Nav2Event::Ended(1, DriveResult::Succeeded))), [(1, GoalStatus::Canceled)]);
}

#[test]
fn failures_of_nav2_keep_their_kind() {
    let mut test = test();
    let mut fail = |id: u64, nav2_events: Nav2Event| {
        test.go(id, "B");
        let ended = test.after_event(Some(nav2_events));
        match ended.as_slice() {
            [(_, GoalStatus::Aborted(error))] => error.to_string(),
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(fail(1, Nav2Event::Ended(1, outcome(208))), "no route: Nav2 error 208: why");
    assert_eq!(fail(2, Nav2Event::Ended(2, DriveResult::Canceled)), "unknown: Nav2 canceled the drive");
    assert_eq!(fail(3, Nav2Event::Ended(3, DriveResult::Lost("it is gone".to_owned()))), "timed out: it is gone");
    assert_eq!(fail(4, Nav2Event::Rejected(4, "Nav2 rejected it".to_owned())), "unknown: Nav2 rejected it");
}

#[test]
fn a_blocked_connection_counts_as_closed_for_a_while() {
    let mut test = test();
    test.go(1, "B");
    let why = aborted(ErrorCode::Blocked, "Nav2 error 105: why");
    assert_eq!(test.after_event(Some(Nav2Event::Ended(1, outcome(105)))), [(1, why)]);
    assert_eq!(test.telemetry().closed, [(place("A"), place("B"))]);
    test.now += 300.0;
    test.after_event(None);
    assert_eq!(test.telemetry().closed, []);
}

#[test]
fn the_driver_waits_and_rejects_other_goals() {
    let mut test = test();
    test.driver.start(&ada(), GoalId(1), Goal::from(Wait { time: Seconds::new(1.5).unwrap() }));
    assert_eq!(test.driver.next_due(), Some(WorldTime::from_secs(1.5)));
    assert_eq!(test.after_event(None), []);
    assert_eq!(test.after_event(None), [(1, GoalStatus::succeeded())]);
    test.driver.start(&ada(), GoalId(2), Goal::from(Undock {}));
    assert_eq!(test.driver.next_due(), Some(test.driver.now()), "a rejection is reported at once");
    let cannot = aborted(ErrorCode::Unknown, "ada is driven by Nav2 and cannot perform the action undock");
    assert_eq!(test.after_event(None), [(2, cannot)]);
    test.driver.start(&ada(), GoalId(3), Goal::from(Wait { time: Seconds::new(9.0).unwrap() }));
    test.driver.cancel(&ada(), GoalId(3));
    assert_eq!(test.after_event(None), [(3, GoalStatus::Canceled)]);
    assert_eq!(test.driver.goals(&ada()), [GoalId(1), GoalId(2), GoalId(3)]);
}

#[test]
fn a_start_place_that_is_not_on_the_map_is_rejected() {
    let ((commands, _), (_, nav2_events)) = (unbounded_channel(), unbounded_channel());
    let places = [(place("A"), Pose::default())].into();
    let refused = Nav2Driver::new(ada(), place("Z"), places, commands, nav2_events).err().unwrap();
    assert_eq!(refused.message, "\"Z\" is not on the map; allowed are A");
}
