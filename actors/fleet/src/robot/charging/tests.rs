use super::control::ChargeControl;
use super::policy::{Activity, CLAIM_AGE, ChargeThresholds, Claim, OtherRobot, Purpose, Situation, prevails};
use super::reserve::ChargerReserve;
use super::{Charger, ChargingSettings, RobotCharging};
use crate::robot::test_values::at;
use consort_protocol::auction::{BidLimits, RefusalReason};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::knowledge::{Attributes, Availability, ChargerClaim, Charging, RobotKnowledge};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, MetresPerSecond, NodeTime, SharePerSecond};
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext, Estimator};
use consort_skills::environment::{Edge, Environment, Passages, Routes, SpeedLimits, TopologicalMap};
use proptest::collection::vec;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Charge below which the robots of these tests charge.
const BELOW: f64 = 0.3;

fn share(share: f64) -> BatteryShare {
    BatteryShare::new(share).unwrap()
}

fn place(name: &str) -> PlaceId {
    name.parse().unwrap()
}

fn places(names: &[&str]) -> BTreeSet<PlaceId> {
    names.iter().map(|name| place(name)).collect()
}

fn robot(name: &str) -> RobotId {
    name.parse().unwrap()
}

fn thresholds() -> ChargeThresholds {
    ChargeThresholds { below: share(BELOW), until: share(0.9), opportunistic: Some(share(0.6)) }
}

fn claim(charger: &str, battery: f64) -> ChargerClaim {
    ChargerClaim { charger: place(charger), battery: share(battery) }
}

fn own_claim(charger: &str, battery: f64, since: NodeTime, purpose: Purpose) -> Claim {
    Claim { published: claim(charger, battery), since, purpose }
}

fn other(name: &str, at: &str, charging: Option<Charging>) -> OtherRobot {
    OtherRobot { robot: robot(name), place: place(at), charging }
}

fn waiting(chargers: &[&str]) -> Charging {
    Charging::Waiting { chargers: places(chargers) }
}

/// Decides for robot `m` in a fleet with the chargers `P` and `Q`; it prefers `P`.
fn decide(activity: &Activity, battery: f64, at_place: &str, others: &[OtherRobot]) -> Activity {
    let (robot, at_place) = (robot("m"), place(at_place));
    let situation = Situation {
        robot: &robot,
        place: &at_place,
        battery: share(battery),
        lacked_charge: false,
        others,
        now: at(5_000),
    };
    thresholds().next(activity, &situation, &places(&["P", "Q"]), || vec![place("P"), place("Q")])
}

#[test]
fn a_free_robot_claims_a_charger_that_no_other_robot_uses() {
    let claimed = |charger, battery, purpose| Activity::Claimed(own_claim(charger, battery, at(5_000), purpose));
    let bound = other("a", "Hall", Some(Charging::Bound(claim("P", 0.2))));
    let stands = other("b", "Q", None);
    let waits = other("c", "Hall", Some(waiting(&["P", "Q"])));
    let waits_for_p = other("c", "Hall", Some(waiting(&["P"])));
    for (battery, others, expected) in [
        (0.29, vec![], claimed("P", 0.29, Purpose::Need)),
        (0.3, vec![], claimed("P", 0.3, Purpose::TopUp)),
        (0.6, vec![], Activity::Idle),
        (0.29, vec![bound.clone()], claimed("Q", 0.29, Purpose::Need)),
        (0.29, vec![bound.clone(), stands.clone()], Activity::Waiting(places(&["P", "Q"]))),
        (0.3, vec![bound, stands], Activity::Idle),
        (0.3, vec![waits], Activity::Idle),
        (0.3, vec![waits_for_p], claimed("Q", 0.3, Purpose::TopUp)),
    ] {
        assert_eq!(decide(&Activity::Idle, battery, "Hall", &others), expected, "{battery}, {others:?}");
    }
}

#[test]
fn a_robot_that_can_use_no_charger_does_not_wait_for_one() {
    let (robot, stands_at) = (robot("m"), ["Hall", "P"].map(place));
    let waits = [other("a", "Hall", Some(waiting(&["P"])))];
    let next = |at_place: &PlaceId, others: &[OtherRobot]| {
        let situation = Situation {
            robot: &robot,
            place: at_place,
            battery: share(0.1),
            lacked_charge: false,
            others,
            now: at(5_000),
        };
        thresholds().next(&Activity::Idle, &situation, &places(&["P"]), Vec::new)
    };
    assert_eq!(stands_at.each_ref().map(|at_place| next(at_place, &[])), [Activity::Idle, Activity::Idle]);
    assert_eq!(stands_at.each_ref().map(|at_place| next(at_place, &waits)), [Activity::Idle, Activity::Leaving]);
}

/// Each of two robots stands at the charger that only the other may use.
#[test]
fn a_robot_that_waits_makes_room_at_a_charger_that_it_may_not_use() {
    let (robot, all) = (robot("m"), places(&["P", "Q"]));
    let next = |at_place: &str, usable: &[&str], awaited: &[&str]| {
        let (others, at_place) = ([other("a", "Q", Some(waiting(awaited)))], place(at_place));
        let situation = Situation {
            robot: &robot,
            place: &at_place,
            battery: share(0.1),
            lacked_charge: false,
            others: &others,
            now: at(5_000),
        };
        let usable = usable.iter().map(|charger| place(charger)).collect();
        thresholds().next(&Activity::Idle, &situation, &all, || usable)
    };
    assert_eq!(next("P", &["Q"], &["P"]), Activity::Leaving);
    assert_eq!(next("Hall", &["Q"], &["P"]), Activity::Waiting(places(&["Q"])), "it has made room");
    assert_eq!(next("P", &["Q"], &["Q"]), Activity::Waiting(places(&["Q"])), "the other does not need its place");
}

#[test]
fn a_robot_charges_until_it_has_enough() {
    let needs = Activity::Connected(own_claim("P", 0.2, at(0), Purpose::Need));
    let tops_up = Activity::Connected(own_claim("P", 0.5, at(0), Purpose::TopUp));
    let waits = [other("c", "Hall", Some(waiting(&["P", "Q"])))];
    let waits_for_q = [other("c", "Hall", Some(waiting(&["Q"])))];
    for (activity, battery, others, expected) in [
        (&needs, 0.89, &[][..], needs.clone()),
        (&needs, 0.9, &[][..], Activity::Idle),
        (&needs, 0.89, &waits[..], needs.clone()),
        (&needs, 0.9, &waits[..], Activity::Leaving),
        (&tops_up, 0.7, &[][..], tops_up.clone()),
        (&tops_up, 0.7, &waits[..], Activity::Leaving),
        (&tops_up, 0.7, &waits_for_q[..], tops_up.clone()),
        (&Activity::Idle, 0.7, &waits_for_q[..], Activity::Idle),
        (&Activity::Idle, 0.7, &waits[..], Activity::Leaving),
        (&Activity::Leaving, 0.7, &[][..], Activity::Leaving),
    ] {
        assert_eq!(decide(activity, battery, "P", others), expected, "{activity:?}, {battery}, {others:?}");
    }
    assert_eq!(decide(&tops_up, 0.7, "Hall", &[]), Activity::Idle, "it was moved away");
}

#[test]
fn a_robot_charges_after_its_charge_was_too_low_for_a_role() {
    let usable = places(&["A"]);
    let mut control = ChargeControl::new(RobotCharging { thresholds: thresholds(), all: usable.clone(), usable });
    let (estimator, context, own, at_c) = (estimator(), context("C"), robot("m"), place("C"));
    let mut published = |battery: f64, lacks: bool| {
        if lacks {
            control.note_lack();
        }
        let (battery, lacked_charge) = (share(battery), control.lacks_charge());
        let situation = Situation { robot: &own, place: &at_c, battery, lacked_charge, others: &[], now: at(0) };
        control.decide(&situation, &estimator, &context);
        let published = control.published();
        control.stop();
        published
    };
    assert_eq!(published(0.8, false), None);
    assert_eq!(published(0.8, true), Some(Charging::Bound(claim("A", 0.8))));
    assert_eq!(published(0.9, true), None, "it has enough, and cannot do the role at all");
    assert_eq!(published(0.8, false), None, "a role or enough charge ends the lack");
}

#[test]
fn a_claim_with_less_charge_prevails() {
    let own = Activity::Claimed(own_claim("P", 0.25, at(4_000), Purpose::Need));
    let next = Activity::Claimed(own_claim("Q", 0.25, at(5_000), Purpose::Need));
    for (name, charging, keeps) in [
        ("a", Charging::Bound(claim("P", 0.26)), true),
        ("a", Charging::Bound(claim("P", 0.24)), false),
        ("a", Charging::Bound(claim("P", 0.25)), false),
        ("z", Charging::Bound(claim("P", 0.25)), true),
        ("z", Charging::Connected(claim("P", 0.8)), false),
        ("a", Charging::Bound(claim("Q", 0.24)), true),
    ] {
        let others = [other(name, "Hall", Some(charging.clone()))];
        let expected = if keeps { &own } else { &next };
        assert_eq!(&decide(&own, 0.25, "Hall", &others), expected, "{name}, {charging:?}");
    }
    let stands = [other("a", "P", None)];
    assert_eq!(decide(&own, 0.25, "Hall", &stands), next, "another robot stands at the charger");
}

fn any_charging() -> impl Strategy<Value = Charging> {
    (any::<bool>(), 0..4_u8).prop_map(|(connected, charge)| {
        let claim = claim("P", f64::from(charge) / 4.0);
        if connected { Charging::Connected(claim) } else { Charging::Bound(claim) }
    })
}

/// Robot of a simulated fleet.
#[derive(Debug, Clone)]
struct Simulated {
    id: RobotId,
    place: PlaceId,
    battery: BatteryShare,
    activity: Activity,
    has_charged: bool,
}

impl Simulated {
    fn record(&self) -> OtherRobot {
        OtherRobot { robot: self.id.clone(), place: self.place.clone(), charging: self.activity.published() }
    }

    /// Returns the charger that the robot drives to or is connected to.
    fn used_charger(&self, now: NodeTime) -> Option<PlaceId> {
        match &self.activity {
            Activity::Claimed(claim) if claim.is_settled(now) => Some(claim.published.charger.clone()),
            Activity::Connected(claim) => Some(claim.published.charger.clone()),
            Activity::Idle | Activity::Waiting(_) | Activity::Claimed(_) | Activity::Leaving => None,
        }
    }

    /// Lets the robot act for a round: it arrives, charges by a quarter of the battery, or loses a thousandth.
    fn act(&mut self, number: usize, now: NodeTime) {
        let change = if matches!(self.activity, Activity::Connected(_)) { 0.25 } else { -0.001 };
        self.battery = share((self.battery.get() + change).clamp(0.0, 1.0));
        match (self.used_charger(now), self.activity.clone()) {
            (Some(charger), Activity::Claimed(claim)) => {
                (self.place, self.activity, self.has_charged) = (charger, Activity::Connected(claim), true);
            }
            (None, Activity::Leaving) => {
                (self.place, self.activity) = (place(&format!("Park {number}")), Activity::Idle);
            }
            _ => {}
        }
    }
}

/// Rounds of a simulated fleet. Each of at most 5 robots with a single charger needs at most 4 rounds to charge, 2 to
/// leave, and 3 until the next robot has a settled claim.
const ROUNDS: usize = 5 * (4 + 2 + 3);

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn of_two_claims_exactly_one_prevails(one in any_charging(), other in any_charging()) {
        let (ada, bob) = (robot("ada"), robot("bob"));
        prop_assert_ne!(prevails((&ada, &one), (&bob, &other)), prevails((&bob, &other), (&ada, &one)));
    }

    /// In a round, the robots decide in turn, or at the same time with the records of the previous round.
    #[test]
    fn no_two_robots_use_the_same_charger_and_all_charge(
        charges in vec(0.05..0.95, 2..=5),
        at_charger in any::<bool>(),
        chargers in 1..=3_usize,
        in_turn in vec(any::<bool>(), ROUNDS),
    ) {
        let chargers: Vec<PlaceId> = (0..chargers).map(|number| place(&format!("Charger {number}"))).collect();
        let all: BTreeSet<PlaceId> = chargers.iter().cloned().collect();
        let mut fleet: Vec<Simulated> = charges.iter().enumerate().map(|(number, battery)| Simulated {
            id: robot(&format!("r{number}")),
            place: if number == 0 && at_charger { chargers[0].clone() } else { place(&format!("Park {number}")) },
            battery: share(*battery),
            activity: Activity::Idle,
            has_charged: false,
        }).collect();
        for (round, in_turn) in in_turn.into_iter().enumerate() {
            let now = NodeTime::ZERO + CLAIM_AGE * u32::try_from(round).unwrap();
            let before: Vec<OtherRobot> = fleet.iter().map(Simulated::record).collect();
            for number in 0..fleet.len() {
                let records = if in_turn { fleet.iter().map(Simulated::record).collect() } else { before.clone() };
                let own = &fleet[number];
                let others: Vec<OtherRobot> = records.into_iter().filter(|other| other.robot != own.id).collect();
                let (robot, place, battery) = (&own.id, &own.place, own.battery);
                let situation = Situation { robot, place, battery, lacked_charge: false, others: &others, now };
                let mut nearest_first = chargers.clone();
                nearest_first.rotate_left(number % chargers.len());
                let next = thresholds().next(&own.activity, &situation, &all, || nearest_first);
                fleet[number].activity = next;
            }
            let used: Vec<PlaceId> = fleet.iter().filter_map(|robot| robot.used_charger(now)).collect();
            let distinct: BTreeSet<&PlaceId> = used.iter().collect();
            prop_assert_eq!(distinct.len(), used.len(), "round {}: {:?}", round, fleet);
            fleet.iter_mut().enumerate().for_each(|(number, robot)| robot.act(number, now));
        }
        for (robot, charge) in fleet.iter().zip(&charges) {
            prop_assert!(robot.has_charged || *charge >= BELOW, "{robot:?} of {fleet:?}");
        }
    }
}

/// Returns an estimator for the places A, B at 10 m, C at another 20 m, and D without a way.
fn estimator() -> Estimator {
    let places = [("A", 0.0), ("B", 10.0), ("C", 30.0), ("D", 50.0)];
    let edge = |a: &str, b: &str, length_m| Edge { a: place(a), b: place(b), length_m, one_way: false };
    let map = TopologicalMap {
        places: places.map(|(name, x)| (place(name), Pose::new(x, 0.0, 0.0))).into(),
        edges: vec![edge("A", "B", 10.0), edge("B", "C", 20.0)],
    };
    let environment = Environment::new().with(Routes::new(&map).unwrap()).with(Passages::default());
    DescriptorRegistry::standard().resolve(environment).unwrap()
}

/// Returns a robot of 0.5 m/s that loses 0.1 % a second: a metre costs 0.2 %.
fn context(at_place: &str) -> EstimateContext {
    EstimateContext {
        place: place(at_place),
        pose: None,
        speed: MetresPerSecond::new(0.5).unwrap(),
        discharge: SharePerSecond::new(0.001).unwrap(),
        closed: vec![],
        limits: SpeedLimits::default(),
        attributes: Attributes::default(),
        readings: None,
    }
}

#[test]
fn a_bid_needs_the_charge_to_reach_the_nearest_charger() {
    let useful_charge = share(0.08);
    let reserve = |chargers: &[&str]| ChargerReserve::new(places(chargers), BidLimits::default());
    let check = |chargers: &[&str], remaining, end: &str| {
        reserve(chargers).check(remaining, useful_charge, &estimator(), &context(end))
    };
    let refusal = |charger: Option<&str>, problem: &str| {
        Err(RefusalReason::ChargerOutOfReach { charger: charger.map(place), problem: problem.to_owned() })
    };
    // From B the charger A is 2 % away, from C 6 %.
    assert_eq!(check(&["A"], 0.12, "B"), Ok(()));
    let short = "6.0 % charge left at A is not above the reserve of 8.0 %";
    assert_eq!(check(&["A"], 0.12, "C"), refusal(Some("A"), short));
    assert_eq!(check(&["A", "B"], 0.13, "C"), Ok(()), "B is 4 % away");
    assert_eq!(check(&["A"], 0.08, "C"), Ok(()), "the limit of bids rejects it");
    assert_eq!(check(&["A"], 0.9, "D"), refusal(None, "there is no way to a charger from D"));
    assert_eq!(
        refusal(Some("A"), short).unwrap_err().to_string(),
        "could not reach a charger afterwards: 6.0 % charge left at A is not above the reserve of 8.0 %"
    );
}

#[test]
fn a_robot_gives_up_a_charger_when_the_way_to_it_is_closed() {
    let usable = places(&["A", "C"]);
    let mut control = ChargeControl::new(RobotCharging { thresholds: thresholds(), all: usable.clone(), usable });
    let (estimator, open, own, at_b) = (estimator(), context("B"), robot("m"), place("B"));
    let closed = |names: &[&str]| EstimateContext {
        closed: names.iter().map(|name| (place(name), place(name))).collect(),
        ..context("B")
    };
    let situation =
        |now| Situation { robot: &own, place: &at_b, battery: share(0.2), lacked_charge: false, others: &[], now };
    let bound = |charger| Some(Charging::Bound(claim(charger, 0.2)));
    control.decide(&situation(at(0)), &estimator, &open);
    control.next_task(&[], &estimator, &open, at(2_000)).expect("the drive");
    assert!(!control.decide(&situation(at(2_000)), &estimator, &closed(&["C"])), "another place");
    let at_a = place("A");
    let arrived = Situation { place: &at_a, ..situation(at(2_500)) };
    let beside = EstimateContext { place: place("A"), pose: Some(Pose::new(0.5, 0.0, 0.0)), ..closed(&["A"]) };
    assert!(!control.decide(&arrived, &estimator, &beside), "it is there");
    assert_eq!(control.published(), bound("A"));
    assert!(control.decide(&situation(at(3_000)), &estimator, &closed(&["A"])));
    assert_eq!((control.published(), control.is_acting()), (bound("C"), false));
    assert!(control.decide(&situation(at(4_000)), &estimator, &closed(&["A", "C"])));
    assert_eq!(control.published(), None, "it keeps no other robot away");
}

fn knowledge(attributes: &[(&str, &str)]) -> RobotKnowledge {
    let attributes: BTreeMap<_, _> = attributes.iter().copied().collect();
    RobotKnowledge {
        skills: BTreeSet::new(),
        attributes: serde_json::from_value(serde_json::json!(attributes)).unwrap(),
        place: place("C"),
        pose: Pose::default(),
        battery: BatteryShare::FULL,
        discharge: SharePerSecond::new(0.001).unwrap(),
        useful_charge: share(0.08),
        speed: MetresPerSecond::new(0.5).ok(),
        availability: Availability::Free,
        estimator: String::new(),
        charging: None,
    }
}

#[test]
fn a_robot_uses_the_chargers_for_which_it_is_eligible() {
    let charger =
        |name: &str, eligible: Option<&str>| Charger { place: place(name), eligible: eligible.map(str::to_owned) };
    let chargers = vec![charger("A", Some("robot.attributes.plug == 'a'")), charger("B", Some("robot.name == 'bob'"))];
    let settings = ChargingSettings { thresholds: thresholds(), chargers };
    let usable = |name: &str, worker: RobotKnowledge| {
        RobotCharging::of(&settings, &robot(name), &worker).map(|charging| charging.usable)
    };
    assert_eq!(usable("ada", knowledge(&[("plug", "a")])), Some(places(&["A"])));
    assert_eq!(usable("bob", knowledge(&[("plug", "a")])), Some(places(&["A", "B"])));
    assert_eq!(usable("ada", knowledge(&[("plug", "b")])), None);
    let mains = SharePerSecond::new(0.0).unwrap();
    assert_eq!(usable("bob", RobotKnowledge { discharge: mains, ..knowledge(&[]) }), None);
    assert_eq!(usable("bob", RobotKnowledge { speed: None, ..knowledge(&[]) }), None);
}

#[test]
fn a_robot_drives_and_docks_once_its_claim_is_old_enough() {
    let usable = places(&["A"]);
    let mut control = ChargeControl::new(RobotCharging { thresholds: thresholds(), all: usable.clone(), usable });
    let (estimator, context, own, at_c) = (estimator(), context("C"), robot("m"), place("C"));
    let situation =
        |now| Situation { robot: &own, place: &at_c, battery: share(0.2), lacked_charge: false, others: &[], now };
    assert!(control.decide(&situation(at(0)), &estimator, &context));
    assert_eq!(control.published(), Some(Charging::Bound(claim("A", 0.2))));
    assert!(!control.decide(&situation(at(1_999)), &estimator, &context));
    assert_eq!(control.next_task(&[], &estimator, &context, at(1_999)), None);
    let mut task = || {
        let task = control.next_task(&[], &estimator, &context, at(2_000));
        control.task_succeeded();
        task.map(|task| (task.task_type.to_string(), task.parameters.into_values().collect::<Vec<_>>()))
    };
    assert_eq!(task(), Some(("navigation".to_owned(), vec!["A".to_owned()])));
    assert_eq!(task(), Some(("dock".to_owned(), vec!["A".to_owned()])));
    assert_eq!(control.published(), Some(Charging::Connected(claim("A", 0.2))));
    assert!(!control.is_acting());
}

#[test]
fn a_robot_avoids_a_charger_for_a_minute_after_a_failure() {
    let usable = places(&["A"]);
    let mut control = ChargeControl::new(RobotCharging { thresholds: thresholds(), all: usable.clone(), usable });
    let (estimator, context, own, at_c) = (estimator(), context("C"), robot("m"), place("C"));
    let situation =
        |now| Situation { robot: &own, place: &at_c, battery: share(0.2), lacked_charge: false, others: &[], now };
    control.decide(&situation(at(0)), &estimator, &context);
    control.next_task(&[], &estimator, &context, at(2_000)).expect("the drive");
    control.task_failed(at(10_000));
    control.decide(&situation(at(69_999)), &estimator, &context);
    assert_eq!(control.published(), None);
    control.decide(&situation(at(70_000)), &estimator, &context);
    assert_eq!(control.published(), Some(Charging::Bound(claim("A", 0.2))));
}

/// Robot `m` at the only charger `A`.
struct AtCharger {
    control: ChargeControl,
    estimator: Estimator,
    context: EstimateContext,
}

impl AtCharger {
    fn new() -> AtCharger {
        let usable = places(&["A"]);
        let control = ChargeControl::new(RobotCharging { thresholds: thresholds(), all: usable.clone(), usable });
        AtCharger { control, estimator: estimator(), context: context("A") }
    }

    /// Decides and begins the next task. Returns whether the activity has changed, and what the robot publishes.
    fn decide(&mut self, battery: f64, others: &[OtherRobot], now: NodeTime) -> (bool, Option<Charging>) {
        let (own, at_a, battery) = (robot("m"), place("A"), share(battery));
        let situation = Situation { robot: &own, place: &at_a, battery, lacked_charge: false, others, now };
        let changed = self.control.decide(&situation, &self.estimator, &self.context);
        self.control.next_task(others, &self.estimator, &self.context, now);
        (changed, self.control.published())
    }
}

#[test]
fn robots_leave_chargers_for_different_places() {
    let leaves = |to: &str| Some(Charging::Leaving { to: place(to) });
    let waits = other("w", "D", Some(waiting(&["A"])));
    let mut robot = AtCharger::new();
    assert_eq!(robot.decide(0.95, std::slice::from_ref(&waits), at(0)), (true, leaves("B")));
    let later = [waits.clone(), other("z", "D", leaves("B"))];
    assert_eq!(robot.decide(0.95, &later, at(0)), (false, leaves("B")), "the other drives elsewhere");
    let earlier = [waits, other("a", "D", leaves("B"))];
    assert_eq!(robot.decide(0.95, &earlier, at(0)), (true, leaves("C")));
    assert_eq!(robot.decide(0.2, &[], at(0)), (false, leaves("C")), "it ends its drive");
}

#[test]
fn a_robot_that_finds_no_place_charges_when_no_other_waits_any_more() {
    let [b, c] = ["B", "C"].map(|at_place| other(&at_place.to_lowercase(), at_place, None));
    let awaited = [b.clone(), c.clone(), other("w", "D", Some(waiting(&["A"])))];
    let mut robot = AtCharger::new();
    assert_eq!(robot.decide(0.5, &awaited, at(0)), (true, None));
    assert_eq!(robot.decide(0.5, &awaited, at(0)), (false, None));
    assert_eq!(robot.decide(0.5, &[b, c], at(0)), (true, Some(Charging::Bound(claim("A", 0.5)))));
}

#[test]
fn a_robot_leaves_a_charger_that_gives_no_current() {
    let mut robot = AtCharger::new();
    let mut published = |battery: f64, minute: u64| {
        let now = at(minute * 60_000);
        let problem = robot.control.check_current(share(battery), now);
        // The drive and the docking succeed at once.
        robot.decide(battery, &[], now);
        robot.control.task_succeeded();
        robot.decide(battery, &[], now);
        robot.control.task_succeeded();
        (problem, robot.control.published())
    };
    let connected = || (None, Some(Charging::Connected(claim("A", 0.2))));
    assert_eq!(published(0.2, 0), (None, Some(Charging::Bound(claim("A", 0.2)))));
    assert_eq!(published(0.2, 1), connected());
    assert_eq!(published(0.2, 2), connected());
    assert_eq!(published(0.21, 16), connected(), "it has risen");
    assert_eq!(published(0.208, 30), connected());
    let problem = "A gives no current: the charge has not risen for 15 minutes".to_owned();
    assert_eq!(published(0.212, 31), (Some(problem), None));
    assert_eq!(published(0.2, 45), (None, None), "it avoids the charger");
    assert_eq!(published(0.2, 46), (None, Some(Charging::Bound(claim("A", 0.2)))));
}
