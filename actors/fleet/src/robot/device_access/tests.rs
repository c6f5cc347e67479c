use super::*;
use consort_protocol::devices::{AlarmPosition, DeviceKind};

fn place(name: &str) -> PlaceId {
    name.parse().unwrap()
}

fn door() -> DeviceId {
    "door".parse().unwrap()
}

fn access() -> DeviceAccess {
    let device = Device {
        name: door(),
        kind: DeviceKind::Door,
        host: "station".parse().unwrap(),
        lanes: [(place("A"), place("B"))].into(),
        places: BTreeSet::new(),
        silent_after: Duration::from_secs(5),
        in_alarm: AlarmPosition::Open,
    };
    DeviceAccess::new(Arc::new(Devices::new([device])))
}

/// Returns the request of a way, after which the route leads through these ways inside of devices.
fn requested(from: &str, to: &str, then: &[(&str, &str)]) -> RequestedWay {
    let way = |from: &str, to: &str| (place(from), place(to));
    RequestedWay { way: way(from, to), then: then.iter().map(|(from, to)| way(from, to)).collect() }
}

fn reports(state: DeviceState, lease: Option<u64>) -> DeviceReports {
    DeviceReports::from([(door(), DeviceReport { state, lease, place: None })])
}

/// Decides for a robot at a place, or that has left it, with the way from A to B requested or not.
fn decide(
    access: &mut DeviceAccess,
    (at, is_at_place): (&str, bool),
    requests: bool,
    reports: &DeviceReports,
    has_coordinator: bool,
) -> bool {
    let (at, request) = (place(at), requested("A", "B", &[]));
    let requested = requests.then_some(&request);
    let (now, ahead) = (NodeTime::at(Duration::from_secs(100)), [&request.way.1]);
    let x = if is_at_place { 0.0 } else { 1.0 };
    let ahead: &[&PlaceId] = if is_at_place { &[] } else { &ahead };
    let pose = Pose::new(x, 0.0, 0.0);
    let situation = AccessSituation {
        place: &at,
        is_at_place,
        is_at_rest: true,
        pose,
        requested,
        ahead,
        reports,
        has_coordinator,
        now,
    };
    access.decide(&situation).is_some()
}

#[test]
fn a_robot_enters_once_the_device_confirms_its_lease() {
    let mut access = access();
    let (idle, ready) = (reports(DeviceState::Idle, None), reports(DeviceState::Ready, Some(7)));
    assert!(!decide(&mut access, ("A", true), true, &idle, true));
    assert_eq!(access.claims(), Some(&DeviceClaims::from([(door(), DeviceClaim::default())])));
    assert!(!decide(&mut access, ("A", true), true, &ready, true), "the lease is not the robot's");
    access.receive_lease(&door(), 7);
    assert!(!decide(&mut access, ("A", true), true, &reports(DeviceState::Preparing, Some(7)), true));
    assert!(!decide(&mut access, ("A", true), true, &ready, false), "no coordinator");
    assert!(decide(&mut access, ("A", true), true, &ready, true));
    assert!(!decide(&mut access, ("A", false), false, &ready, false), "it stops between the places");
    assert_eq!(
        access.claims(),
        Some(&DeviceClaims::from([(door(), DeviceClaim { lease: Some(7), place: None })])),
        "and keeps the door"
    );
    decide(&mut access, ("B", true), false, &ready, true);
    assert!(access.claims.is_empty());
}

#[test]
fn a_silent_device_closes_its_lanes_for_robots_that_have_not_entered() {
    let mut access = access();
    let silent = reports(DeviceState::Silent, None);
    assert!(!decide(&mut access, ("A", true), true, &silent, true));
    assert_eq!(access.closed(), [(place("A"), place("B"))]);
    assert_eq!(access.problems().collect::<Vec<_>>(), ["door is unavailable: it does not confirm"]);
    assert!(access.claims.is_empty(), "the robot waits, or drives another way");
    assert!(!decide(&mut access, ("A", true), true, &reports(DeviceState::Idle, None), true));
    access.receive_lease(&door(), 7);
    assert!(decide(&mut access, ("A", true), true, &reports(DeviceState::Ready, Some(7)), true));
    assert!(!decide(&mut access, ("A", false), true, &silent, true));
    assert!(access.closed().is_empty(), "a robot on the way drives on");
    assert_eq!(access.claims.len(), 1);
}

#[test]
fn a_robot_that_starts_between_two_places_claims_the_devices_beside_it() {
    let mut access = access();
    let idle = reports(DeviceState::Idle, None);
    decide(&mut access, ("A", false), false, &idle, true);
    assert_eq!(access.claims.len(), 1);
    decide(&mut access, ("A", true), false, &idle, true);
    assert!(access.claims.is_empty());
    decide(&mut access, ("A", false), false, &idle, true);
    assert!(access.claims.is_empty(), "it drives another way");
}

#[test]
fn a_door_that_is_open_in_an_alarm_needs_no_lease() {
    let mut access = access();
    assert!(decide(&mut access, ("A", true), true, &reports(DeviceState::Alarm, None), true));
}

#[test]
fn a_robot_that_has_not_used_its_grant_leaves_a_silent_device() {
    let mut access = access();
    let (idle, silent) = (reports(DeviceState::Idle, None), reports(DeviceState::Silent, Some(7)));
    decide(&mut access, ("A", true), true, &idle, true);
    access.receive_lease(&door(), 7);
    assert!(decide(&mut access, ("A", true), true, &reports(DeviceState::Ready, Some(7)), true));
    assert!(!decide(&mut access, ("A", true), true, &silent, true));
    assert!(!decide(&mut access, ("A", true), true, &silent, true));
    assert!(access.is_waiting(), "its timers stop");
    assert_eq!(access.closed(), [(place("A"), place("B"))], "it drives another way");
}

#[test]
fn a_robot_in_a_doorway_leaves_it_when_the_door_does_not_confirm() {
    let mut access = access();
    let (idle, jammed) = (reports(DeviceState::Idle, None), reports(DeviceState::Silent, Some(7)));
    decide(&mut access, ("A", true), true, &idle, true);
    access.receive_lease(&door(), 7);
    assert!(!decide(&mut access, ("A", true), true, &jammed, true), "it has not entered");
    decide(&mut access, ("A", true), true, &idle, true);
    access.receive_lease(&door(), 7);
    assert!(decide(&mut access, ("A", true), true, &reports(DeviceState::Ready, Some(7)), true));
    decide(&mut access, ("A", false), false, &idle, true);
    assert!(!decide(&mut access, ("A", false), true, &reports(DeviceState::Preparing, Some(7)), true));
    assert!(decide(&mut access, ("A", false), true, &jammed, true));
}

#[test]
fn claims_are_published_once_the_node_knows_where_its_robot_is() {
    let (mut access, mut other, mut passing) = (access(), access(), access());
    let idle = reports(DeviceState::Idle, None);
    decide(&mut access, ("A", false), false, &idle, true);
    assert!(access.claims().is_some(), "it may be on the way to B");
    assert!(access.must_publish() && !access.must_publish());
    access.change_cluster();
    assert!(!access.must_publish(), "it has no lease");
    access.receive_lease(&door(), 7);
    assert!(access.must_publish());
    access.change_cluster();
    assert!(access.must_publish(), "the lease of another cluster");
    decide(&mut other, ("C", false), false, &idle, true);
    assert!(other.claims().is_none() && !other.must_publish());
    decide(&mut other, ("C", true), false, &idle, true);
    assert!(other.must_publish());
    assert_eq!(other.claims(), Some(&DeviceClaims::new()));
    decide(&mut passing, ("A", false), false, &idle, true);
    decide(&mut passing, ("B", false), false, &idle, true);
    assert_eq!(passing.claims(), Some(&DeviceClaims::new()), "it has passed B");
}

/// Decides for a robot that stands at the lower stop of a lift.
fn ride(access: &mut DeviceAccess, to: &str, at_stop: &str, ms: u64) -> bool {
    let (low, request) = (place("L0"), requested("L0", to, &[]));
    let report = DeviceReport { state: DeviceState::Ready, lease: Some(7), place: Some(place(at_stop)) };
    access
        .decide(&AccessSituation {
            place: &low,
            is_at_place: true,
            is_at_rest: true,
            pose: Pose::default(),
            requested: Some(&request),
            ahead: &[],
            reports: &DeviceReports::from([("lift".parse().unwrap(), report)]),
            has_coordinator: true,
            now: NodeTime::at(Duration::from_millis(ms)),
        })
        .is_some()
}

#[test]
fn a_robot_that_turns_back_trusts_no_report_from_before() {
    let lift = Device {
        name: "lift".parse().unwrap(),
        kind: DeviceKind::Lift,
        host: "station".parse().unwrap(),
        lanes: BTreeSet::new(),
        places: [place("L0"), place("L1")].into(),
        silent_after: Duration::from_secs(10),
        in_alarm: AlarmPosition::OutOfUse,
    };
    let mut access = DeviceAccess::new(Arc::new(Devices::new([lift])));
    assert!(!ride(&mut access, "Hall", "L0", 0));
    access.receive_lease(&"lift".parse().unwrap(), 7);
    assert!(ride(&mut access, "Hall", "L0", 100));
    assert!(!ride(&mut access, "L1", "L0", 200));
    assert!(!ride(&mut access, "Hall", "L0", 400), "the lift may just leave for L1");
    assert!(ride(&mut access, "Hall", "L0", 3_400), "it has not left");
    assert!(!ride(&mut access, "L1", "L0", 3_500));
    assert!(ride(&mut access, "L1", "L1", 3_600), "it has arrived");
}

/// A door to the place V, and a lift behind it with the stops L0 and L1.
fn door_before_lift() -> DeviceAccess {
    let device = |name: &str, kind, places: &[&str]| Device {
        name: name.parse().unwrap(),
        kind,
        host: "station".parse().unwrap(),
        lanes: BTreeSet::new(),
        places: places.iter().map(|name| place(name)).collect(),
        silent_after: Duration::from_secs(10),
        in_alarm: AlarmPosition::OutOfUse,
    };
    let devices = [device("door", DeviceKind::Door, &["V"]), device("lift", DeviceKind::Lift, &["L0", "L1"])];
    DeviceAccess::new(Arc::new(Devices::new(devices)))
}

/// Decides for a robot at C, which requests the way through the door to the upper stop of the lift.
fn enter(access: &mut DeviceAccess, states: [(&str, DeviceState, Option<u64>, &str); 2]) -> bool {
    let (at, request) = (place("C"), requested("C", "V", &[("V", "L0"), ("L0", "L1")]));
    let report = |(name, state, lease, stop): (&str, _, _, &str)| {
        (name.parse::<DeviceId>().unwrap(), DeviceReport { state, lease, place: Some(place(stop)) })
    };
    let granted = access.decide(&AccessSituation {
        place: &at,
        is_at_place: true,
        is_at_rest: true,
        pose: Pose::default(),
        requested: Some(&request),
        ahead: &[],
        reports: &states.map(report).into(),
        has_coordinator: true,
        now: NodeTime::at(Duration::from_secs(100)),
    });
    granted.is_some()
}

#[test]
fn a_robot_enters_a_door_once_the_lift_behind_it_is_its_own() {
    let mut access = door_before_lift();
    let idle = [("door", DeviceState::Idle, None, "V"), ("lift", DeviceState::Idle, None, "L0")];
    assert!(!enter(&mut access, idle));
    let claim =
        |name: &str, stop| (name.parse::<DeviceId>().unwrap(), DeviceClaim { lease: None, place: Some(place(stop)) });
    let both = DeviceClaims::from([claim("door", "V"), claim("lift", "L0")]);
    assert_eq!(access.claims(), Some(&both));
    let open = [("door", DeviceState::Ready, Some(7), "V"), ("lift", DeviceState::Preparing, Some(8), "L0")];
    access.receive_lease(&door(), 7);
    assert!(!enter(&mut access, open), "a robot in the lift may need the door");
    access.receive_lease(&"lift".parse().unwrap(), 8);
    assert!(enter(&mut access, open), "the lift may still come");
}

#[test]
fn a_robot_claims_no_door_before_a_silent_lift() {
    let mut access = door_before_lift();
    let silent = [("door", DeviceState::Idle, None, "V"), ("lift", DeviceState::Silent, None, "L0")];
    assert!(!enter(&mut access, silent));
    assert_eq!(access.claims(), Some(&DeviceClaims::new()));
}

/// Decides about the claims of a robot at rest. It states the place A, but its pose is elsewhere.
fn rest(access: &mut DeviceAccess, x: f64, ahead: &[&PlaceId], reports: &DeviceReports, seconds: u64) {
    access.decide(&AccessSituation {
        place: &place("A"),
        is_at_place: false,
        is_at_rest: true,
        pose: Pose::new(x, 0.0, 0.0),
        requested: None,
        ahead,
        reports,
        has_coordinator: true,
        now: NodeTime::at(Duration::from_secs(seconds)),
    });
}

#[test]
fn a_robot_whose_pose_is_far_from_its_place_claims_no_door() {
    let (mut access, idle) = (access(), reports(DeviceState::Idle, None));
    rest(&mut access, 50.0, &[], &idle, 0);
    assert_eq!(access.claims(), None, "its earlier claims count until it knows its way");
    rest(&mut access, 50.0, &[], &idle, 119);
    assert_eq!(access.claims(), None);
    rest(&mut access, 50.0, &[], &idle, 120);
    assert_eq!(access.claims(), Some(&DeviceClaims::new()), "not for ever");
}

#[test]
fn a_robot_that_does_not_pass_gives_the_door_back() {
    let let_in = || {
        let (mut access, idle) = (access(), reports(DeviceState::Idle, None));
        decide(&mut access, ("C", false), false, &idle, true);
        decide(&mut access, ("A", false), true, &idle, true);
        access.receive_lease(&door(), 7);
        assert!(decide(&mut access, ("A", false), true, &reports(DeviceState::Ready, Some(7)), true));
        (access, reports(DeviceState::Ready, Some(7)))
    };
    let b = place("B");
    let (mut waiting, ready) = let_in();
    rest(&mut waiting, 1.2, &[&b], &ready, 101);
    assert_eq!(waiting.claims(), Some(&DeviceClaims::new()), "it is where it was let in, and asks no longer");
    let (mut inside, ready) = let_in();
    rest(&mut inside, 1.5, &[&b], &ready, 1_000);
    assert_eq!(inside.claims.len(), 1, "it may be in the door");
    let (mut elsewhere, ready) = let_in();
    rest(&mut elsewhere, 50.0, &[], &ready, 1_000);
    assert_eq!(elsewhere.claims.len(), 1);
    rest(&mut elsewhere, 50.0, &[], &ready, 1_120);
    assert_eq!(elsewhere.claims(), Some(&DeviceClaims::new()));
}
