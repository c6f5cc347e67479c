//! Tests with estimates: the reserve of bids, and the drives of a robot.

use super::{claim, other, place, places, robot, share, thresholds, waiting};
use crate::robot::charging::control::ChargeControl;
use crate::robot::charging::policy::{OtherRobot, Situation};
use crate::robot::charging::reserve::{BeforeStop, ChargerReserve};
use crate::robot::charging::{Charger, ChargingForecast, ChargingSettings, RobotCharging};
use crate::robot::test_values::at;
use consort_protocol::auction::{BidLimits, RefusalReason};
use consort_protocol::charging_curve::{ChargingCurve, CurveStep};
use consort_protocol::ids::PlaceId;
use consort_protocol::knowledge::{Availability, ChargerClaim, Charging, RobotKnowledge};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, MetresPerSecond, NodeTime, SharePerSecond, WattHours, Watts};
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext, Estimator};
use consort_skills::environment::{Edge, Environment, Passages, Routes, TopologicalMap};
use std::collections::{BTreeMap, BTreeSet};

fn settings(chargers: Vec<Charger>) -> ChargingSettings {
    let (parking, curve) = (BTreeSet::new(), ChargingCurve::default());
    ChargingSettings { thresholds: thresholds(), chargers, parking, curve, gain: None, swap: None }
}

/// Returns the charging of a robot in a fleet with these chargers.
fn control(usable: BTreeSet<PlaceId>) -> ChargeControl {
    parking_control(usable, &[])
}

fn parking_control(usable: BTreeSet<PlaceId>, parking: &[&str]) -> ChargeControl {
    let all = usable.clone();
    let (parking, forecast) = (places(parking), ChargingForecast::default());
    ChargeControl::new(RobotCharging { thresholds: thresholds(), usable, all, parking, forecast })
}

/// Returns what a robot publishes, without the estimate of its drive.
fn published_by(control: &ChargeControl) -> Option<Charging> {
    let mut published = control.published();
    if let Some(Charging::Bound(claim) | Charging::Connected(claim)) = &mut published {
        claim.drive_s = None;
    }
    published
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
    EstimateContext::at(place(at_place), MetresPerSecond::new(0.5).unwrap(), SharePerSecond::new(0.001).unwrap())
}

#[test]
fn a_robot_charges_after_its_charge_was_too_low_for_a_role() {
    let usable = places(&["A"]);
    let mut control = control(usable);
    let (estimator, context, own, at_c) = (estimator(), context("C"), robot("m"), place("C"));
    let mut published = |battery: f64, lacks: bool| {
        if lacks {
            control.note_lack();
        }
        let (battery, lacked_charge) = (share(battery), control.lacks_charge());
        let situation = Situation { robot: &own, place: &at_c, battery, lacked_charge, others: &[], now: at(0) };
        control.decide(&situation, &estimator, &context);
        let published = published_by(&control);
        control.stop();
        published
    };
    assert_eq!(published(0.8, false), None);
    assert_eq!(published(0.8, true), Some(Charging::Bound(claim("A", 0.8))));
    assert_eq!(published(0.9, true), None, "it has enough, and cannot do the role at all");
    assert_eq!(published(0.8, false), None, "a role or enough charge ends the lack");
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
fn no_stop_is_priced_while_the_power_of_the_chargers_is_unknown() {
    let reserve = control(places(&["A", "B"])).reserve(BidLimits::default());
    let at_c = context("C");
    let before = BeforeStop { charge: 0.3, useful_charge: share(0.08), context: &at_c };
    let stop = reserve.plan_stop(before, &estimator(), |_| panic!("the role is priced"));
    assert!(stop.is_none());
}

#[test]
fn a_robot_gives_up_a_charger_when_the_way_to_it_is_closed() {
    let usable = places(&["A", "C"]);
    let mut control = control(usable);
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
    assert_eq!(published_by(&control), bound("A"));
    assert!(control.decide(&situation(at(3_000)), &estimator, &closed(&["A"])));
    assert_eq!((published_by(&control), control.is_acting()), (bound("C"), false));
    assert!(control.decide(&situation(at(4_000)), &estimator, &closed(&["A", "C"])));
    assert_eq!(published_by(&control), None, "it keeps no other robot away");
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
    let charger = |name: &str, eligible: Option<&str>| Charger {
        place: place(name),
        eligible: eligible.map(str::to_owned),
        power: None,
    };
    let chargers = vec![charger("A", Some("robot.attributes.plug == 'a'")), charger("B", Some("robot.name == 'bob'"))];
    let settings = settings(chargers);
    let usable = |name: &str, worker: RobotKnowledge| {
        RobotCharging::of(&settings, &robot(name), &worker, None).map(|charging| charging.usable)
    };
    assert_eq!(usable("ada", knowledge(&[("plug", "a")])), Some(places(&["A"])));
    assert_eq!(usable("bob", knowledge(&[("plug", "a")])), Some(places(&["A", "B"])));
    assert_eq!(usable("ada", knowledge(&[("plug", "b")])), None);
    let mains = SharePerSecond::new(0.0).unwrap();
    assert_eq!(usable("bob", RobotKnowledge { discharge: mains, ..knowledge(&[]) }), None);
    assert_eq!(usable("bob", RobotKnowledge { speed: None, ..knowledge(&[]) }), None);
}

/// At 30 % at C, the charger B is 40 s away, and A 60 s. From 80 % on a battery takes half the power.
#[test]
fn a_robot_prefers_the_charger_at_which_it_has_charged_first() {
    let step = CurveStep { above: share(0.8), power: 0.5 };
    let curve = ChargingCurve::try_from(vec![step]).unwrap();
    let claims = |powers: [Option<f64>; 2], capacity: Option<f64>, curve: ChargingCurve| {
        let charger = |(name, power): (&str, Option<f64>)| Charger {
            place: place(name),
            eligible: None,
            power: power.map(|power| Watts::new(power).unwrap()),
        };
        let chargers = ["A", "B"].into_iter().zip(powers).map(charger).collect();
        let settings = ChargingSettings { curve, ..settings(chargers) };
        let capacity = capacity.map(|capacity| WattHours::new(capacity).unwrap());
        let charging = RobotCharging::of(&settings, &robot("m"), &knowledge(&[]), capacity).unwrap();
        let (mut control, own, at_c) = (ChargeControl::new(charging), robot("m"), place("C"));
        let battery = share(0.29);
        let situation = Situation { robot: &own, place: &at_c, battery, lacked_charge: false, others: &[], now: at(0) };
        control.decide(&situation, &estimator(), &context("C"));
        control.published().and_then(|charging| charging.claim().map(|claim| claim.charger.to_string())).unwrap()
    };
    let none = ChargingCurve::default;
    assert_eq!(claims([None, None], Some(100.0), none()), "B", "the nearest");
    assert_eq!(claims([Some(720.0), Some(360.0)], Some(100.0), none()), "A");
    assert_eq!(claims([Some(720.0), Some(360.0)], None, none()), "B", "its capacity is unknown");
    assert_eq!(claims([Some(720.0), None], Some(100.0), none()), "B", "a power is unknown");
    // At A it has charged 3 s later, and 2 s earlier if the end takes twice as long.
    let [fast, slow] = [381.0, 360.0].map(Some);
    assert_eq!(claims([fast, slow], Some(100.0), none()), "B");
    assert_eq!(claims([fast, slow], Some(100.0), curve), "A");
}

/// A charger of 360 W gives a battery of 100 Wh 0.1 % per second.
#[test]
fn a_measured_gain_stands_for_an_unknown_power_or_capacity() {
    let time = |power: Option<f64>, capacity: Option<f64>, gain: Option<f64>| {
        let power = power.map(|power| Watts::new(power).unwrap());
        let charger = Charger { place: place("A"), eligible: None, power };
        let gain = gain.map(|gain| SharePerSecond::new(gain).unwrap());
        let settings = ChargingSettings { gain, ..settings(vec![charger]) };
        let capacity = capacity.map(|capacity| WattHours::new(capacity).unwrap());
        let charging = RobotCharging::of(&settings, &robot("m"), &knowledge(&[]), capacity).unwrap();
        charging.forecast.known_time(&place("A"), 0.5, share(0.75)).map(|time| time.get().round())
    };
    assert_eq!(time(None, None, None), None);
    assert_eq!(time(Some(360.0), Some(100.0), Some(0.0005)), Some(250.0), "power and capacity are of this robot");
    assert_eq!(time(None, Some(100.0), Some(0.0005)), Some(500.0));
    assert_eq!(time(Some(360.0), None, Some(0.0005)), Some(500.0));
}

#[test]
fn a_robot_drives_and_docks_once_its_claim_is_old_enough() {
    let usable = places(&["A"]);
    let mut control = control(usable);
    let (estimator, context, own, at_c) = (estimator(), context("C"), robot("m"), place("C"));
    let situation =
        |now| Situation { robot: &own, place: &at_c, battery: share(0.2), lacked_charge: false, others: &[], now };
    assert!(control.decide(&situation(at(0)), &estimator, &context));
    assert_eq!(published_by(&control), Some(Charging::Bound(claim("A", 0.2))));
    assert!(!control.decide(&situation(at(1_999)), &estimator, &context));
    assert_eq!(control.next_task(&[], &estimator, &context, at(1_999)), None);
    let mut task = || {
        let task = control.next_task(&[], &estimator, &context, at(2_000));
        control.task_succeeded();
        task.map(|task| (task.task_type.to_string(), task.parameters.into_values().collect::<Vec<_>>()))
    };
    assert_eq!(task(), Some(("navigation".to_owned(), vec!["A".to_owned()])));
    assert_eq!(task(), Some(("dock".to_owned(), vec!["A".to_owned()])));
    assert_eq!(published_by(&control), Some(Charging::Connected(claim("A", 0.2))));
    assert!(!control.is_acting());
}

#[test]
fn a_robot_on_its_way_to_a_charger_does_not_turn_back_for_another_lease() {
    let mut control = control(places(&["A", "B"]));
    let (estimator, context, own, at_c) = (estimator(), context("C"), robot("m"), place("C"));
    let situation =
        Situation { robot: &own, place: &at_c, battery: share(0.2), lacked_charge: false, others: &[], now: at(0) };
    control.decide(&situation, &estimator, &context);
    assert_eq!(published_by(&control), Some(Charging::Bound(claim("B", 0.2))));
    control.next_task(&[], &estimator, &context, at(2_000)).expect("the drive");
    control.receive_lease(place("A"), 8);
    assert!(!control.decide(&Situation { now: at(2_100), ..situation }, &estimator, &context));
}

#[test]
fn a_robot_avoids_a_charger_for_a_minute_after_a_failure() {
    let usable = places(&["A"]);
    let mut control = control(usable);
    let (estimator, context, own, at_c) = (estimator(), context("C"), robot("m"), place("C"));
    let situation =
        |now| Situation { robot: &own, place: &at_c, battery: share(0.2), lacked_charge: false, others: &[], now };
    control.decide(&situation(at(0)), &estimator, &context);
    control.next_task(&[], &estimator, &context, at(2_000)).expect("the drive");
    control.task_failed(at(10_000));
    control.decide(&situation(at(69_999)), &estimator, &context);
    assert_eq!(published_by(&control), None);
    control.decide(&situation(at(70_000)), &estimator, &context);
    assert_eq!(published_by(&control), Some(Charging::Bound(claim("A", 0.2))));
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
        let control = control(usable);
        AtCharger { control, estimator: estimator(), context: context("A") }
    }

    /// Decides and begins the next task. Returns whether the activity has changed, and what the robot publishes.
    fn decide(&mut self, battery: f64, others: &[OtherRobot], now: NodeTime) -> (bool, Option<Charging>) {
        let (own, at_a, battery) = (robot("m"), place("A"), share(battery));
        let situation = Situation { robot: &own, place: &at_a, battery, lacked_charge: false, others, now };
        let changed = self.control.decide(&situation, &self.estimator, &self.context);
        self.control.next_task(others, &self.estimator, &self.context, now);
        (changed, published_by(&self.control))
    }
}

#[test]
fn the_lease_of_a_claim_ends_with_its_cluster() {
    let mut robot = AtCharger::new();
    let mut lease_after = |lease, now| {
        robot.control.receive_lease(place("A"), lease);
        robot.decide(0.2, &[], now).1.and_then(|published| published.claim()?.lease)
    };
    assert_eq!(lease_after(90, at(0)), Some(90));
    assert_eq!(lease_after(5, at(100)), Some(90), "it is an earlier one");
    robot.control.change_cluster();
    assert_eq!(robot.decide(0.2, &[], at(200)).1, Some(Charging::Bound(claim("A", 0.2))));
    robot.control.receive_lease(place("A"), 5);
    let leased = ChargerClaim { lease: Some(5), ..claim("A", 0.2) };
    assert_eq!(robot.decide(0.2, &[], at(300)).1, Some(Charging::Bound(leased)));
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
fn an_idle_robot_parks_where_no_other_robot_is() {
    let leaves = |to: &str| Some(Charging::Leaving { to: place(to) });
    let (estimator, context, own, at_c) = (estimator(), context("C"), robot("m"), place("C"));
    let parks_with = |(charger, battery): (&str, f64), parking: &[&str], others: &[OtherRobot], ms: u64| {
        let mut control = parking_control(places(&[charger]), parking);
        let mut decide = |now| {
            let battery = share(battery);
            let situation = Situation { robot: &own, place: &at_c, battery, lacked_charge: false, others, now };
            let depends = control.depends_on_others(&situation);
            control.decide(&situation, &estimator, &context);
            let task = control.next_task(others, &estimator, &context, now);
            assert!(depends || task.is_none(), "it must know the others");
        };
        decide(at(0));
        decide(at(ms));
        published_by(&control)
    };
    let parks = |parking: &[&str], others: &[OtherRobot], ms| parks_with(("A", 0.9), parking, others, ms);
    assert_eq!(parks(&["B", "D"], &[], 9_999), None);
    assert_eq!(parks(&["B", "D"], &[], 10_000), leaves("B"), "there is no way to D");
    assert_eq!(parks(&["B", "C"], &[], 10_000), None, "it stands at a parking place");
    assert_eq!(parks(&[], &[], 10_000), None);
    assert_eq!(parks(&["B"], &[other("a", "B", None)], 10_000), None);
    assert_eq!(parks(&["B"], &[other("a", "D", leaves("B"))], 10_000), None);
    assert_eq!(parks_with(("D", 0.3), &["B"], &[], 10_000), leaves("B"));
    assert_eq!(parks_with(("D", 0.29), &["B"], &[], 10_000), None, "it has too little charge, and reaches no charger");
}

#[test]
fn a_robot_that_leaves_a_charger_parks_if_it_can() {
    let waits = other("w", "D", Some(waiting(&["A"])));
    let leaves = |parking: &[&str], others: &[OtherRobot]| {
        let control = parking_control(places(&["A"]), parking);
        let mut robot = AtCharger { control, ..AtCharger::new() };
        robot.decide(0.95, others, at(0)).1
    };
    let to = |name: &str| Some(Charging::Leaving { to: place(name) });
    assert_eq!(leaves(&["C"], std::slice::from_ref(&waits)), to("C"), "although B is nearer");
    assert_eq!(leaves(&["C"], &[waits, other("a", "C", None)]), to("B"), "parking is taken");
}

#[test]
fn a_robot_that_would_charge_again_after_parking_stays_at_its_charger() {
    let parks = |parking: &[&str], battery| {
        let control = parking_control(places(&["A"]), parking);
        let mut robot = AtCharger { control, ..AtCharger::new() };
        [at(0), at(10_000)].map(|now| robot.decide(battery, &[], now).1)
    };
    let leaves = |to: &str| [None, Some(Charging::Leaving { to: place(to) })];
    // The drive to C takes 6 %, and the robot charges below 60 %.
    assert_eq!(parks(&["C"], 0.65), [None, None]);
    assert_eq!(parks(&["C"], 0.67), leaves("C"));
    assert_eq!(parks(&["B", "C"], 0.65), [None, None], "B may be taken");
    assert_eq!(parks(&["B"], 0.65), leaves("B"));
    assert_eq!(parks(&["D"], 0.9), [None, None], "there is no way to D");
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
        (problem, published_by(&robot.control))
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
