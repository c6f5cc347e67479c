//! Tests of the policy; those of the control and of the exclusion of several robots are below.

mod control;
mod exclusion;

use super::policy::{
    Activity, CLAIM_AGE, ChargeThresholds, Claim, LEASE_WAIT, LeaseOffer, OtherRobot, Purpose, ReceivedLeases,
    Situation,
};
use crate::robot::test_values::at;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::knowledge::{ChargerClaim, Charging};
use consort_protocol::units::{BatteryShare, NodeTime};
use std::collections::BTreeSet;

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
    ChargerClaim { charger: place(charger), battery: share(battery), lease: None, drive_s: None }
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
    thresholds().next(activity, &situation, None, &places(&["P", "Q"]), || vec![place("P"), place("Q")])
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
        thresholds().next(&Activity::Idle, &situation, None, &places(&["P"]), Vec::new)
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
        thresholds().next(&Activity::Idle, &situation, None, &all, || usable)
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

#[test]
fn a_claim_with_the_later_lease_prevails() {
    let leased = |lease| ChargerClaim { lease: Some(lease), ..claim("P", 0.29) };
    let keeps = |own: ChargerClaim, charging: Charging| {
        let activity = Activity::Claimed(Claim { published: own, since: at(4_000), purpose: Purpose::Need });
        decide(&activity, 0.29, "Hall", &[other("a", "Hall", Some(charging))]) == activity
    };
    assert!(keeps(leased(7), Charging::Bound(claim("P", 0.1))));
    assert!(keeps(leased(7), Charging::Bound(leased(6))));
    assert!(!keeps(leased(7), Charging::Bound(leased(8))));
    assert!(!keeps(leased(7), Charging::Connected(claim("P", 0.9))), "a connected robot stays");
    assert!(!keeps(claim("P", 0.29), Charging::Bound(ChargerClaim { lease: Some(1), ..claim("P", 0.3) })));
}

#[test]
fn a_robot_with_a_coordinator_waits_for_its_lease() {
    let unleased = own_claim("P", 0.2, at(0), Purpose::Need);
    let mut leased = unleased.clone();
    leased.published.lease = Some(7);
    let acts_from = |claim: &Claim, has_coordinator| {
        [CLAIM_AGE, LEASE_WAIT].into_iter().find(|age| claim.may_act(has_coordinator, NodeTime::ZERO + *age))
    };
    assert_eq!(acts_from(&unleased, false), Some(CLAIM_AGE));
    assert_eq!(acts_from(&unleased, true), Some(LEASE_WAIT));
    assert_eq!(acts_from(&leased, true), Some(CLAIM_AGE));
    assert!(!leased.may_act(true, at(1_999)), "the others may lack its claim");
}

#[test]
fn a_waiting_robot_claims_the_charger_that_it_is_offered() {
    let (own, hall) = (robot("m"), place("Hall"));
    let offer = LeaseOffer { charger: place("P"), lease: 7 };
    let next = |others: &[OtherRobot], battery: f64| {
        let battery = share(battery);
        let situation = Situation { robot: &own, place: &hall, battery, lacked_charge: false, others, now: at(5_000) };
        let waits = Activity::Waiting(places(&["P", "Q"]));
        thresholds().next(&waits, &situation, Some(&offer), &places(&["P", "Q"]), || vec![place("Q"), place("P")])
    };
    let mut claimed = own_claim("P", 0.2, at(5_000), Purpose::Need);
    claimed.published.lease = Some(7);
    let bound = |claim| [other("a", "Hall", Some(Charging::Bound(claim)))];
    assert_eq!(next(&[], 0.2), Activity::Claimed(claimed.clone()), "although Q is nearer");
    assert_eq!(next(&bound(claim("P", 0.1)), 0.2), Activity::Claimed(claimed));
    let unleased = Activity::Claimed(own_claim("Q", 0.2, at(5_000), Purpose::Need));
    assert_eq!(next(&bound(ChargerClaim { lease: Some(8), ..claim("P", 0.3) }), 0.2), unleased);
    assert_eq!(next(&[other("a", "P", None)], 0.2), unleased, "another robot stands there");
    assert_eq!(next(&[], 0.9), Activity::Idle, "it needs no charge any more");
}

#[test]
fn a_robot_that_waits_for_its_lease_claims_the_charger_that_it_is_offered() {
    let (own, hall) = (robot("m"), place("Hall"));
    let offer = LeaseOffer { charger: place("Q"), lease: 7 };
    let next = |claim: &Claim, others: &[OtherRobot]| {
        let battery = share(0.2);
        let situation = Situation { robot: &own, place: &hall, battery, lacked_charge: false, others, now: at(5_000) };
        let (activity, all) = (Activity::Claimed(claim.clone()), places(&["P", "Q"]));
        thresholds().next(&activity, &situation, Some(&offer), &all, || vec![place("P"), place("Q")])
    };
    let with_lease = |charger, since, lease| {
        let mut claim = own_claim(charger, 0.2, since, Purpose::Need);
        claim.published.lease = lease;
        claim
    };
    let unleased = with_lease("P", at(4_000), None);
    assert_eq!(next(&unleased, &[]), Activity::Claimed(with_lease("Q", at(5_000), Some(7))));
    assert_eq!(next(&unleased, &[other("a", "Q", None)]), Activity::Claimed(unleased), "another robot stands there");
    let leased = with_lease("P", at(4_000), Some(6));
    assert_eq!(next(&leased, &[]), Activity::Claimed(leased));
}

#[test]
fn a_delayed_notice_of_an_earlier_lease_has_no_effect() {
    let offer = |lease| LeaseOffer { charger: place("P"), lease };
    let mut leases = ReceivedLeases::default();
    let mut activity = Activity::Claimed(own_claim("P", 0.2, at(0), Purpose::Need));
    leases.receive(offer(7), &mut activity);
    let lease = |activity: &Activity| activity.published()?.claim()?.lease;
    assert_eq!(lease(&activity), Some(7));
    leases.receive(offer(6), &mut activity);
    assert_eq!(lease(&activity), Some(7));
    let mut waits = Activity::Waiting(places(&["P"]));
    leases.receive(offer(7), &mut waits);
    assert_eq!(leases.take_offer(), None, "it has used this lease");
    leases.receive(offer(8), &mut waits);
    assert_eq!(leases.take_offer(), Some(offer(8)));
}
