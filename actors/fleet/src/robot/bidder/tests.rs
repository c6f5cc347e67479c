use super::*;
use crate::robot::test_values::idle_robot;
use consort_protocol::auction::{AuctionId, RoleOfMission, Timelines};
use consort_protocol::pose::Pose;
use consort_skills::descriptor::DescriptorRegistry;
use consort_skills::domain_file::DomainFile;
use consort_skills::environment::{Edge, Environment, Routes, SpeedLimits, TopologicalMap};
use serde_json::{Value, json};
use std::collections::BTreeSet;

const WATERING: &str = r#"{
    "domain": "watering",
    "actions": { "water": {} },
    "readings": { "tank_l": { "type": "number" } },
    "tasks": {
        "water": { "action": "water", "requires": "readings.tank_l >= 1.0" },
        "lift": { "action": "water", "requires": "attributes.payload_kg >= 1.0" }
    }
}"#;

/// Returns the reply of a robot that needs any of these chargers to a call for a task.
fn reply(estimator: Estimator, chargers: Option<ChargerReserve>, spec: &Value, context: &BidContext<'_>) -> RoleReply {
    reply_beside(Timelines::default(), estimator, chargers, spec, context)
}

/// Returns the reply to a call for a task in a fleet with these promised roles.
fn reply_beside(
    timelines: Timelines,
    estimator: Estimator,
    chargers: Option<ChargerReserve>,
    spec: &Value,
    context: &BidContext<'_>,
) -> RoleReply {
    let step = json!({ "action": { "Task": { "id": "it", "spec": spec } }, "after": [] });
    let plan: LocalPlan = serde_json::from_value(json!({ "role": "r1", "steps": [step] })).unwrap();
    let call = CallForBids {
        auction: AuctionId { mission: "m-9".parse().unwrap(), term: 1, round: 1 },
        ensembles: vec![],
        roles: BTreeMap::from([("r1".parse().unwrap(), plan)]),
        eligible: BTreeMap::new(),
        spread: BTreeSet::new(),
        timelines,
    };
    let bidder = Bidder::new("ada".parse().unwrap(), Arc::new(estimator)).with_chargers(chargers);
    let response = bidder.respond(&call, context);
    response.replies.into_iter().next().expect("a reply")
}

/// Returns the context of a free robot in a world without closures.
fn context<'a>(worker: &'a RobotKnowledge, readings: &'a BTreeMap<String, Scalar>) -> BidContext<'a> {
    BidContext {
        worker,
        closed_lanes: &[],
        found_closed: &[],
        closures: &[],
        speed_limits: SpeedLimits::default(),
        readings: Some(readings),
        age_ms: 0,
        membership: Membership { member: true, reason: "has the skills".to_owned(), age_ms: 0 },
        present: None,
    }
}

fn robot_with(skills: &[&str]) -> RobotKnowledge {
    RobotKnowledge { skills: skills.iter().map(|skill| skill.parse().unwrap()).collect(), ..idle_robot() }
}

/// Returns the reply of a robot with these readings to a call for a task of this type.
fn reply_to_call(task: &str, readings: &Value) -> RoleReply {
    let form = serde_json::from_str(WATERING).unwrap();
    let domain = DomainFile::check(form, &BTreeMap::new(), &[]).unwrap();
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new()).unwrap();
    let spec = json!({ "type": task, "roles": ["r1"], "attempts": 2 });
    let readings = serde_json::from_value(readings.clone()).unwrap();
    reply(estimator, None, &spec, &context(&robot_with(&["water", "lift"]), &readings))
}

fn reason_of(reply: RoleReply) -> RefusalReason {
    match reply {
        RoleReply::Refusal(refusal) => refusal.reason,
        RoleReply::Bid(bid) => panic!("{bid:?}"),
    }
}

fn refusal(task: &str, readings: &Value) -> RefusalReason {
    reason_of(reply_to_call(task, readings))
}

#[test]
fn a_robot_bids_only_while_its_readings_meet_the_condition() {
    assert!(matches!(reply_to_call("water", &json!({ "tank_l": 1 })), RoleReply::Bid(_)));
    let condition = "step 0 (it): water requires `readings.tank_l >= 1.0`, which";
    let unknown = "has no value: the reading `tank_l` is unknown: the driver has not published it";
    for (readings, problem) in [(json!({ "tank_l": 0.5 }), "is false"), (json!({}), unknown)] {
        let expected = RefusalReason::NotEligible { why: format!("{condition} {problem}"), permanent: false };
        assert_eq!(refusal("water", &readings), expected);
    }
}

#[test]
fn a_refusal_names_the_closure_of_the_destination_first_and_is_not_permanent() {
    let place = |name: &str| -> PlaceId { name.parse().unwrap() };
    let source = EstimateError::Route(RouteError::Closed { from: place("Dock"), to: place("Ward") });
    let closed = PriceError { step: 0, task: "go".parse().unwrap(), source };
    let problem = "step 0 (go): no route from Dock to Ward: the ways between them are closed";
    let (hall, ward) = ("Hall is closed by Abe", "Ward is closed by Nia: a spill, until 2026-01-01 00:00 UTC");
    let why = format!("{problem}; {ward}; {hall}");
    let reason = refusal_while_closed(&closed, &[hall, ward]);
    assert_eq!(reason, RefusalReason::NotEligible { why, permanent: false });
    let reason = refusal_while_closed(&closed, &[hall, hall, hall, hall, ward]);
    let why = format!("{problem}; {ward}; {hall}; {hall}");
    assert_eq!(reason, RefusalReason::NotEligible { why, permanent: false });
}

/// Returns the reply to a call for a drive from the dock through the hall. People have closed the ward behind the
/// hall, and the driver has found these lanes closed.
fn reply_to_drive(to: &str, found: &[(&str, &str)], chargers: Option<ChargerReserve>) -> RoleReply {
    let place = |name: &str| -> PlaceId { name.parse().unwrap() };
    let edge = |a: &str, b: &str| Edge { a: place(a), b: place(b), length_m: 10.0, one_way: false };
    let places = [("Dock", 0.0), ("Hall", 10.0), ("Ward", 20.0), ("Island", 50.0)];
    let map = TopologicalMap {
        places: places.map(|(name, x)| (place(name), Pose::new(x, 0.0, 0.0))).into(),
        edges: vec![edge("Dock", "Hall"), edge("Hall", "Ward")],
    };
    let environment = Environment::new().with(Routes::new(&map).unwrap());
    let estimator = DescriptorRegistry::standard().resolve(environment).unwrap();
    let found_closed: Vec<_> = found.iter().map(|(a, b)| (place(a), place(b))).collect();
    let closed_lanes = [found_closed.clone(), vec![(place("Ward"), place("Ward"))]].concat();
    let (worker, readings) = (robot_with(&["navigation"]), BTreeMap::new());
    let context = BidContext {
        closed_lanes: &closed_lanes,
        found_closed: &found_closed,
        closures: &["Ward is closed by Nia"],
        speed_limits: SpeedLimits::default(),
        ..context(&worker, &readings)
    };
    let spec = json!({ "type": "navigation", "roles": ["r1"], "parameters": { "to": to } });
    reply(estimator, chargers, &spec, &context)
}

#[test]
fn only_what_people_have_closed_makes_a_refusal_temporary() {
    let closed = reason_of(reply_to_drive("Ward", &[], None));
    assert!(matches!(&closed, RefusalReason::NotEligible { permanent: false, .. }), "{closed:?}");
    for (to, found) in [("Ward", vec![("Hall", "Dock")]), ("Island", vec![])] {
        let reason = reason_of(reply_to_drive(to, &found, None));
        assert!(matches!(&reason, RefusalReason::NotFeasible { .. }), "{to}: {reason:?}");
    }
}

#[test]
fn a_refusal_for_want_of_a_charger_names_the_closures() {
    let chargers = ChargerReserve::new(BTreeSet::from(["Ward".parse().unwrap()]), BidLimits::default());
    let reply = reply_to_drive("Hall", &[], Some(chargers));
    assert!(!lacks_charge(&reply, &BidLimits::default()), "more charge does not open the way");
    let problem = "there is no way to a charger from Hall; Ward is closed by Nia".to_owned();
    assert_eq!(reason_of(reply), RefusalReason::ChargerOutOfReach { charger: None, problem });
}

#[test]
fn a_missing_attribute_is_a_permanent_refusal() {
    let reason = refusal("lift", &json!({ "tank_l": 1 }));
    assert!(matches!(&reason, RefusalReason::NotFeasible { .. }), "{reason:?}");
}

/// Places in a row, 10 m apart.
fn row_of_places() -> Estimator {
    let names = ["A", "B", "C", "D"];
    let place = |name: &str| -> PlaceId { name.parse().unwrap() };
    let lane = |ends: &[&str]| Edge { a: place(ends[0]), b: place(ends[1]), length_m: 10.0, one_way: false };
    let map = TopologicalMap {
        places: names.map(|name| (place(name), Pose::default())).into(),
        edges: names.windows(2).map(lane).collect(),
    };
    let environment = Environment::new().with(Routes::new(&map).unwrap());
    DescriptorRegistry::standard().resolve(environment).unwrap()
}

/// Returns the bid for a drive by a robot at A that has promised drives to these places, at 1 m/s.
fn bid_beside(to: &str, promised: &[&str], is_startable: bool) -> Bid {
    let promise = |(number, place): (usize, &&str)| PromisedRole {
        robot: "ada".parse().unwrap(),
        role: RoleOfMission { mission: format!("m-{number}").parse().unwrap(), role: "r1".parse().unwrap() },
        span: RoleSpan {
            from: Some(place.parse().unwrap()),
            to: Some(place.parse().unwrap()),
            time: Seconds::ZERO,
            energy: Energy::ZERO,
        },
        slack: Seconds::new(5.0).ok(),
        release: Seconds::ZERO,
        charges: false,
    };
    let promised = promised.iter().enumerate().map(promise).collect();
    let startable = is_startable.then(|| "r1".parse().unwrap()).into_iter().collect();
    let timelines = Timelines { promised, startable, ..Timelines::default() };
    let worker = RobotKnowledge { place: "A".parse().unwrap(), ..robot_with(&["navigation"]) };
    let (readings, spec) =
        (BTreeMap::new(), json!({ "type": "navigation", "roles": ["r1"], "parameters": { "to": to } }));
    match reply_beside(timelines, row_of_places(), None, &spec, &context(&worker, &readings)) {
        RoleReply::Bid(bid) => bid,
        RoleReply::Refusal(refusal) => panic!("{refusal:?}"),
    }
}

#[test]
fn a_robot_bids_for_the_best_position_among_its_promised_roles() {
    let position = |bid: &Bid| {
        let planned = bid.planned.clone().unwrap();
        let before = planned.before.map(|next| next.mission.to_string());
        (bid.from.to_string(), bid.time.get(), planned.start.get(), before, planned.delay.get(), planned.promised)
    };
    let first = "m-0".to_owned();
    let bid = bid_beside("B", &["D", "A"], false);
    assert_eq!(position(&bid), ("A".to_owned(), 10.0, 0.0, Some(first), 0.0, 2), "B is on the way to D");
    let planned = bid.planned.unwrap();
    assert!((planned.energy.get() - 0.05).abs() < 1e-9, "20 m to D and 30 m back: {planned:?}");
    assert_eq!(position(&bid_beside("D", &["B"], false)), ("B".to_owned(), 20.0, 10.0, None, 0.0, 1));
    assert_eq!(position(&bid_beside("C", &[], false)), ("A".to_owned(), 20.0, 0.0, None, 0.0, 0));
    // The robot is free, and what it has promised cannot start.
    let first = Some("m-0".to_owned());
    assert_eq!(position(&bid_beside("D", &["B"], true)), ("A".to_owned(), 30.0, 0.0, first, 40.0, 1));
}
