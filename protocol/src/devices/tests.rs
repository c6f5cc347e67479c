use super::*;
use crate::ids::RobotId;
use crate::knowledge::{
    DeviceClaim, DeviceKnowledge, DeviceReport, DeviceState, Knowledge, KnowledgeBase, Record, RecordStamp,
};
use crate::lease::Epoch;
use crate::ledger::{Resource, ResourceLease};
use crate::resource_leases::{EndOfLease, ResourceAction};
use crate::units::NodeTime;

fn at(ms: u64) -> NodeTime {
    NodeTime::at(Duration::from_millis(ms))
}

fn device(name: &str) -> DeviceId {
    name.parse().unwrap()
}

fn robot(name: &str) -> RobotId {
    name.parse().unwrap()
}

fn user(name: &str, claims: &[(&str, Option<u64>)]) -> DeviceUser {
    let claim = |lease: Option<u64>| DeviceClaim { lease, place: None };
    let claims = claims.iter().map(|(name, lease)| (device(name), claim(*lease))).collect();
    DeviceUser { robot: robot(name), claims: Some(claims), is_alive: true, is_in_maintenance: false }
}

fn leased(leases: &[(&str, &str, u64)]) -> BTreeMap<DeviceId, ResourceLease> {
    let lease = |(name, to, index): &(&str, &str, u64)| {
        (device(name), ResourceLease { robot: robot(to), epoch: Epoch { term: 1, index: *index }, since_ms: 0 })
    };
    leases.iter().map(lease).collect()
}

fn grant(name: &str, to: &str) -> ResourceAction {
    ResourceAction::Lease { resource: Resource::Device(device(name)), robot: robot(to) }
}

fn lift() -> Device {
    let [low, high] = ["L0", "L1"].map(|name| name.parse::<PlaceId>().unwrap());
    Device {
        name: device("lift"),
        kind: DeviceKind::Lift,
        host: "station".parse().unwrap(),
        lanes: BTreeSet::new(),
        places: [low, high].into(),
        silent_after: Duration::from_secs(10),
        in_alarm: AlarmPosition::OutOfUse,
    }
}

#[test]
fn robots_get_all_devices_that_they_need_in_the_order_of_their_claims() {
    let mut leases = DeviceLeases::default();
    let (none, served) = (BTreeMap::new(), DeviceReports::new());
    let (ada, bob) = (user("ada", &[("door", None)]), user("bob", &[("door", None), ("lift", None)]));
    assert_eq!(
        leases.due(&none, std::slice::from_ref(&bob), &served, at(0)),
        [grant("door", "bob"), grant("lift", "bob")]
    );
    let mut leases = DeviceLeases::default();
    let cleo = leased(&[("lift", "cleo", 5)]);
    let holder = user("cleo", &[("lift", Some(5))]);
    assert_eq!(leases.due(&cleo, &[bob.clone(), holder.clone()], &served, at(0)), [], "bob needs both");
    assert_eq!(leases.due(&cleo, &[ada.clone(), bob.clone(), holder], &served, at(100)), [], "ada has asked later");
    let leaving = user("cleo", &[("door", None), ("lift", Some(5))]);
    let due = leases.due(&cleo, &[ada.clone(), bob.clone(), leaving], &served, at(200));
    assert_eq!(due, [grant("door", "cleo")], "cleo leaves the lift through the door");
    assert_eq!(leases.due(&none, &[ada, bob], &served, at(1_000)), [grant("door", "bob"), grant("lift", "bob")]);
}

#[test]
fn robots_from_both_sides_of_a_door_and_a_lift_do_not_wait_for_each_other() {
    let place = |name: &str| name.parse::<PlaceId>().unwrap();
    let door = Device { name: device("door"), kind: DeviceKind::Door, places: [place("V")].into(), ..lift() };
    let devices = Devices::new([door, lift()]);
    let route = ["L0", "L1", "Ward", "Room"].map(place);
    let ways = [("V", "L0"), ("L0", "L1"), ("L1", "Ward")].map(|(from, to)| (place(from), place(to)));
    assert_eq!(devices.ways_inside(&place("V"), &route), ways);
    assert!(devices.ways_inside(&place("Ward"), &route[3..]).is_empty(), "it can wait there");
    // One robot waits before the door, and claims the lift, too. The other is in the lift, and leaves through the door.
    let (mut leases, served) = (DeviceLeases::default(), DeviceReports::new());
    let used = leased(&[("lift", "ada", 5)]);
    let outside = user("bob", &[("door", None), ("lift", None)]);
    let inside = user("ada", &[("door", None), ("lift", Some(5))]);
    assert_eq!(leases.due(&used, &[outside.clone(), inside], &served, at(0)), [grant("door", "ada")]);
    assert_eq!(
        leases.due(&BTreeMap::new(), &[outside], &served, at(60_000)),
        [grant("door", "bob"), grant("lift", "bob")]
    );
}

#[test]
fn a_robot_that_waits_for_a_stuck_lift_keeps_no_door_free() {
    let (mut leases, served) = (DeviceLeases::default(), DeviceReports::new());
    let stuck = leased(&[("lift", "cleo", 5)]);
    let robots = [
        user("ada", &[("door", None)]),
        user("bob", &[("door", None), ("lift", None)]),
        user("cleo", &[("lift", Some(5))]),
    ];
    assert_eq!(leases.due(&stuck, &robots[1..], &served, at(0)), []);
    assert_eq!(leases.due(&stuck, &robots, &served, at(119_999)), []);
    assert_eq!(leases.due(&stuck, &robots, &served, at(120_000)), [grant("door", "ada")]);
}

#[test]
fn a_lease_is_notified_until_the_claim_has_it_and_ends_with_the_claim() {
    let mut leases = DeviceLeases::default();
    let (own, served) = (leased(&[("lift", "ada", 5)]), DeviceReports::new());
    let notify = ResourceAction::Notify {
        resource: Resource::Device(device("lift")),
        robot: robot("ada"),
        epoch: Epoch { term: 1, index: 5 },
    };
    assert_eq!(leases.due(&own, &[user("ada", &[("lift", None)])], &served, at(0)), [notify]);
    assert_eq!(leases.due(&own, &[user("ada", &[("lift", Some(5))])], &served, at(900)), []);
    assert_eq!(leases.due(&own, &[user("ada", &[])], &served, at(1_000)), [], "its node may have restarted");
    assert_eq!(
        leases.due(&own, &[user("ada", &[("lift", None)])], &served, at(2_000)).len(),
        1,
        "it is notified again"
    );
    assert_eq!(leases.due(&own, &[user("ada", &[])], &served, at(2_100)), []);
    let ended = leases.due(&own, &[user("ada", &[])], &served, at(4_100));
    assert!(matches!(&ended[..], [ResourceAction::Free { cause: EndOfLease::Done, .. }]), "{ended:?}");
}

#[test]
fn a_robot_that_does_not_answer_goes_behind_the_others() {
    let (mut leases, none) = (DeviceLeases::default(), BTreeMap::new());
    let robots = [user("ada", &[("door", None)]), user("bob", &[("door", None)])];
    let idle = DeviceReport { state: DeviceState::Idle, lease: None, place: None };
    let idle = DeviceReports::from([(device("door"), idle)]);
    assert_eq!(leases.due(&none, &robots, &idle, at(0)), [grant("door", "ada")]);
    let own = leased(&[("door", "ada", 5)]);
    leases.due(&own, &robots, &idle, at(100));
    let ended = leases.due(&own, &robots, &idle, at(10_100));
    assert!(matches!(&ended[..], [ResourceAction::Free { cause: EndOfLease::NoAnswer, .. }]), "{ended:?}");
    assert_eq!(leases.due(&none, &robots, &idle, at(10_200)), [grant("door", "bob")]);
}

#[test]
fn a_lost_robot_that_may_be_inside_keeps_its_lease() {
    let own = leased(&[("lift", "ada", 5)]);
    let lost = DeviceUser { is_alive: false, ..user("ada", &[("lift", Some(5))]) };
    let end_of = |lease: Option<u64>, lost: &DeviceUser| {
        let report = DeviceReport { state: DeviceState::Ready, lease, place: None };
        let served = DeviceReports::from([(device("lift"), report)]);
        let mut leases = DeviceLeases::default();
        leases.due(&own, std::slice::from_ref(lost), &served, at(0));
        leases.due(&own, std::slice::from_ref(lost), &served, at(60_000))
    };
    assert_eq!(end_of(Some(5), &lost), []);
    let removed = DeviceUser { is_in_maintenance: true, ..lost.clone() };
    for ended in [end_of(Some(5), &removed), end_of(None, &lost)] {
        assert!(matches!(&ended[..], [ResourceAction::Free { cause: EndOfLease::Gone, .. }]), "{ended:?}");
    }
}

#[test]
fn a_robot_inside_keeps_its_lease_while_its_claims_are_unknown() {
    let own = leased(&[("lift", "ada", 5)]);
    let report = |lease: Option<u64>| {
        let report = DeviceReport { state: DeviceState::Ready, lease, place: None };
        DeviceReports::from([(device("lift"), report)])
    };
    let known = user("ada", &[("lift", Some(5))]);
    let restarted = DeviceUser { claims: None, ..known.clone() };
    let forgotten = DeviceUser { is_alive: false, ..restarted.clone() };
    let mut leases = DeviceLeases::default();
    leases.due(&own, std::slice::from_ref(&known), &report(Some(5)), at(0));
    for (ms, user) in [(100, &restarted), (60_000, &restarted), (60_100, &forgotten), (120_000, &forgotten)] {
        assert_eq!(leases.due(&own, std::slice::from_ref(user), &report(None), at(ms)), [], "{ms}");
    }
    assert_eq!(leases.due(&own, &[], &report(None), at(180_000)), [], "a new record is on its way");
    let removed = DeviceUser { is_in_maintenance: true, ..forgotten };
    let ended = leases.due(&own, &[removed], &report(None), at(180_100));
    assert!(matches!(&ended[..], [ResourceAction::Free { cause: EndOfLease::Gone, .. }]), "{ended:?}");
    // The node of the device has restarted after the loss of the robot.
    let mut leases = DeviceLeases::default();
    let lost = DeviceUser { is_alive: false, ..known };
    leases.due(&own, std::slice::from_ref(&lost), &report(Some(5)), at(0));
    assert_eq!(leases.due(&own, &[lost], &report(None), at(60_000)), []);
    // It was lost right after it had left.
    let mut leases = DeviceLeases::default();
    leases.due(&own, &[user("ada", &[("lift", Some(5))])], &report(Some(5)), at(0));
    let outside = DeviceUser { is_alive: false, ..user("ada", &[]) };
    leases.due(&own, std::slice::from_ref(&outside), &report(Some(5)), at(100));
    assert_eq!(leases.due(&own, &[outside], &report(Some(5)), at(5_100)).len(), 1);
    // The notices to a robot that has restarted inside are lost for a while.
    let mut leases = DeviceLeases::default();
    let claims = user("ada", &[("lift", None)]);
    for ms in [0, 60_000] {
        let due = leases.due(&own, std::slice::from_ref(&claims), &report(Some(5)), at(ms));
        assert!(matches!(&due[..], [ResourceAction::Notify { .. }]), "{due:?}");
    }
    let ended = leases.due(&own, &[claims], &report(None), at(60_100));
    assert!(matches!(&ended[..], [ResourceAction::Free { cause: EndOfLease::NoAnswer, .. }]), "{ended:?}");
}

#[test]
fn a_device_admits_the_robot_whose_claim_it_confirms() {
    let lift = lift();
    let place = |name: &str| name.parse::<PlaceId>().unwrap();
    for (from, to, guarded) in [("Hall", "L0", true), ("L0", "L1", true), ("L1", "Ward", true), ("Hall", "Ward", false)]
    {
        assert_eq!(lift.guards(&place(from), &place(to)), guarded, "{from} {to}");
    }
    let at = |lease, name: &str| DeviceClaim { lease, place: Some(place(name)) };
    let report = |state| DeviceReport { state, lease: Some(5), place: Some(place("L0")) };
    assert!(report(DeviceState::Ready).admits(&lift, &at(Some(5), "L0")));
    for (state, claim) in [
        (DeviceState::Ready, at(Some(4), "L0")),
        (DeviceState::Ready, at(Some(5), "L1")),
        (DeviceState::Preparing, at(Some(5), "L0")),
        (DeviceState::Blocked, at(Some(5), "L0")),
        (DeviceState::Alarm, DeviceClaim::default()),
    ] {
        assert!(!report(state).admits(&lift, &claim), "{state:?} {claim:?}");
    }
    assert_eq!(lift.place_for(&place("L0"), &place("L1")), Some(place("L1")), "it opens at the destination");
    assert_eq!(lift.place_for(&place("L1"), &place("Ward")), Some(place("L1")));
    let open = Device { in_alarm: AlarmPosition::Open, ..lift };
    assert!(report(DeviceState::Alarm).admits(&open, &DeviceClaim::default()));
}

#[test]
fn only_the_host_of_a_device_reports_it() {
    let mut base = KnowledgeBase::default();
    let report = |state| DeviceReport { state, lease: Some(5), place: None };
    let mut publish = |owner: &str, name: &str, state| {
        let devices = DeviceKnowledge { claims: None, reports: [(device(name), report(state))].into() };
        let (owner, knowledge) = (owner.parse().unwrap(), Knowledge { devices, ..Knowledge::of(None) });
        let record = Record { owner, stamp: RecordStamp::default(), knowledge, proof: None };
        base.merge(record, at(0));
        Devices::new([lift()]).reports(&base)
    };
    assert_eq!(publish("ada", "lift", DeviceState::Ready), DeviceReports::new());
    let true_report = DeviceReports::from([(device("lift"), report(DeviceState::Preparing))]);
    assert_eq!(publish("station", "lift", DeviceState::Preparing), true_report);
    assert_eq!(publish("zoe", "lift", DeviceState::Ready), true_report);
    assert_eq!(publish("zoe-2", "door", DeviceState::Ready), true_report, "a device that is not declared");
}

#[test]
fn a_device_that_no_node_reports_is_unavailable_after_a_while() {
    let devices = Devices::new([lift()]);
    let mut watch = DeviceWatch::default();
    let mut problems = |reports: &DeviceReports, ms: u64| -> Vec<String> {
        watch.unavailable(&devices, reports, at(ms)).into_iter().map(|(_, problem)| problem).collect()
    };
    let report = |state| DeviceReports::from([(device("lift"), DeviceReport { state, lease: None, place: None })]);
    assert!(problems(&DeviceReports::new(), 0).is_empty() && problems(&DeviceReports::new(), 9_999).is_empty());
    assert_eq!(problems(&DeviceReports::new(), 10_000), ["no node reports it"]);
    assert!(problems(&report(DeviceState::Idle), 10_100).is_empty());
    assert!(problems(&DeviceReports::new(), 10_200).is_empty(), "from now on");
    assert_eq!(problems(&report(DeviceState::Silent), 10_300), ["it does not confirm"]);
    assert_eq!(problems(&report(DeviceState::Alarm), 10_400), ["there is an alarm"]);
    assert_eq!(problems(&report(DeviceState::Blocked), 10_500), ["a robot that is lost may be inside"]);
}
