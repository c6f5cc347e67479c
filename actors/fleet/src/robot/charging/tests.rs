use super::control::ChargeControl;
use super::policy::{
    Activity, CLAIM_AGE, ChargeThresholds, Claim, LEASE_WAIT, LeaseOffer, OtherRobot, Purpose, ReceivedLeases,
    Situation, prevails,
};
use super::reserve::ChargerReserve;
use super::{Charger, ChargingSettings, RobotCharging};
use crate::robot::test_values::at;
use consort_protocol::auction::{BidLimits, RefusalReason};
use consort_protocol::chargers::{ChargerAction, ChargerLeases, ChargerUser};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::knowledge::{Attributes, Availability, ChargerClaim, Charging, RobotKnowledge};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, MetresPerSecond, NodeTime, SharePerSecond};
use consort_protocol::versions::VersionRange;
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext, Estimator};
use consort_skills::environment::{Edge, Environment, Passages, Routes, SpeedLimits, TopologicalMap};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

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

/// Returns the charging of a robot in a fleet with these chargers.
fn control(usable: BTreeSet<PlaceId>) -> ChargeControl {
    parking_control(usable, &[])
}

fn parking_control(usable: BTreeSet<PlaceId>, parking: &[&str]) -> ChargeControl {
    let all = usable.clone();
    ChargeControl::new(RobotCharging { thresholds: thresholds(), usable, all, parking: places(parking) })
}

/// Returns what a robot publishes, without the estimate of its drive.
fn published_by(control: &ChargeControl) -> Option<Charging> {
    let mut published = control.published();
    if let Some(Charging::Bound(claim) | Charging::Connected(claim)) = &mut published {
        claim.drive_s = None;
    }
    published
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

fn any_charging() -> impl Strategy<Value = Charging> {
    (any::<bool>(), 0..4_u8, option::of(0..2_u64)).prop_map(|(connected, charge, lease)| {
        let claim = ChargerClaim { lease, ..claim("P", f64::from(charge) / 4.0) };
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
    leases: ReceivedLeases,
    /// A coordinator is in contact.
    has_coordinator: bool,
    /// Rounds for which it has driven to the charger, and those that a drive takes beyond the first.
    driven: usize,
    drive: usize,
}

impl Simulated {
    fn new(number: usize, at_place: PlaceId, battery: f64) -> Simulated {
        Simulated {
            id: robot(&format!("r{number}")),
            place: at_place,
            battery: share(battery),
            activity: Activity::Idle,
            has_charged: false,
            leases: ReceivedLeases::default(),
            has_coordinator: false,
            driven: 0,
            drive: 0,
        }
    }

    fn record(&self) -> OtherRobot {
        OtherRobot { robot: self.id.clone(), place: self.place.clone(), charging: self.activity.published() }
    }

    fn user(&self) -> ChargerUser {
        let OtherRobot { robot, place, charging } = self.record();
        ChargerUser { robot, place, battery: self.battery, charging, is_alive: true }
    }

    /// Decides by the records of all robots.
    fn decide(&mut self, records: Vec<OtherRobot>, chargers: &[PlaceId], nearest_first: Vec<PlaceId>, now: NodeTime) {
        let others: Vec<OtherRobot> = records.into_iter().filter(|other| other.robot != self.id).collect();
        let (robot, place, battery) = (&self.id, &self.place, self.battery);
        let situation = Situation { robot, place, battery, lacked_charge: false, others: &others, now };
        let (offer, all) = (self.leases.take_offer(), chargers.iter().cloned().collect());
        let next = thresholds().next(&self.activity, &situation, offer.as_ref(), &all, || nearest_first);
        self.leases.follow(&next);
        if next != self.activity {
            (self.activity, self.driven) = (next, 0);
        }
    }

    /// Returns the charger that the robot drives to or is connected to.
    fn used_charger(&self, now: NodeTime) -> Option<PlaceId> {
        let drives = |claim: &Claim| self.driven > 0 || claim.may_act(self.has_coordinator, now);
        match &self.activity {
            Activity::Claimed(claim) if drives(claim) => Some(claim.published.charger.clone()),
            Activity::Connected(claim) => Some(claim.published.charger.clone()),
            Activity::Idle | Activity::Waiting(_) | Activity::Claimed(_) | Activity::Leaving => None,
        }
    }

    /// Lets the robot act for a round: it drives, charges by a quarter of the battery, or loses a thousandth.
    fn act(&mut self, number: usize, now: NodeTime) {
        let change = if matches!(self.activity, Activity::Connected(_)) { 0.25 } else { -0.001 };
        self.battery = share((self.battery.get() + change).clamp(0.0, 1.0));
        match (self.used_charger(now), self.activity.clone()) {
            (Some(_), Activity::Claimed(_)) if self.driven < self.drive => self.driven += 1,
            (Some(charger), Activity::Claimed(claim)) => {
                (self.place, self.activity, self.has_charged) = (charger, Activity::Connected(claim), true);
                self.driven = 0;
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

fn simulated_fleet(charges: &[f64], chargers: &[PlaceId], at_charger: bool) -> Vec<Simulated> {
    let robot = |(number, battery): (usize, &f64)| {
        let at_place = if number == 0 && at_charger { chargers[0].clone() } else { place(&format!("Park {number}")) };
        Simulated::new(number, at_place, *battery)
    };
    charges.iter().enumerate().map(robot).collect()
}

fn uses_are_exclusive(fleet: &[Simulated], now: NodeTime) -> bool {
    let used: Vec<PlaceId> = fleet.iter().filter_map(|robot| robot.used_charger(now)).collect();
    used.iter().collect::<BTreeSet<_>>().len() == used.len()
}

/// Time in which a record reaches all robots: a quarter of the age of a claim on which a robot acts.
const ROUND: Duration = Duration::from_millis(500);

const UNSETTLED_ROUNDS: usize = 80;

/// Rounds within which every robot charges: the last of 4000 fleets needed 51 in all.
const SETTLED_ROUNDS: usize = 60;

/// A round with leases.
#[derive(Debug, Clone)]
struct Round {
    is_led: bool,
    /// Robots that count the coordinator as in contact.
    contact: [bool; 5],
    /// Rounds for which the notices of this round are delayed.
    delay: usize,
    /// The robots decide in turn, and not by the records of the previous round.
    in_turn: bool,
}

fn any_round() -> impl Strategy<Value = Round> {
    let delay = prop_oneof![Just(0_usize), Just(1_usize), 2..40_usize];
    (any::<bool>(), any::<[bool; 5]>(), delay, any::<bool>()).prop_map(|(is_led, contact, delay, in_turn)| Round {
        is_led,
        contact,
        delay,
        in_turn,
    })
}

/// Coordinators of a simulated fleet that follow each other, and their ledger.
struct SimulatedCoordinator {
    ledger: Ledger,
    entries: u64,
    session: ChargerLeases,
    /// Notices under way, with the rounds of their arrival.
    notices: Vec<(usize, RobotId, LeaseOffer)>,
}

impl SimulatedCoordinator {
    fn new() -> SimulatedCoordinator {
        let (ledger, session) = (Ledger::default(), ChargerLeases::default());
        let mut coordinator = SimulatedCoordinator { ledger, entries: 0, session, notices: vec![] };
        coordinator.apply(Command::first_wire_version(VersionRange::OWN.newest));
        coordinator
    }

    fn apply(&mut self, command: Command) {
        self.entries += 1;
        self.ledger.apply(Epoch { term: 1, index: self.entries }, command);
    }

    /// Performs what is due. A round without a coordinator ends the session.
    fn act(&mut self, round: &Round, users: &[ChargerUser], number: usize, now: NodeTime) {
        if !round.is_led {
            self.session = ChargerLeases::default();
            return;
        }
        for action in self.session.due(self.ledger.charger_leases(), users, now) {
            match action {
                ChargerAction::Lease { charger, robot } => {
                    self.apply(Command::LeaseCharger { charger, robot, at_ms: 0 });
                }
                ChargerAction::Free { charger, epoch, .. } => self.apply(Command::FreeCharger { charger, epoch }),
                ChargerAction::Notify { charger, robot, epoch } => {
                    self.notices.push((number + round.delay, robot, LeaseOffer { charger, lease: epoch.index }));
                }
            }
        }
    }

    /// Takes the notices that arrive in a round.
    fn take_notices(&mut self, number: usize) -> Vec<(RobotId, LeaseOffer)> {
        let (arrived, under_way) = std::mem::take(&mut self.notices).into_iter().partition(|(at, ..)| *at <= number);
        self.notices = under_way;
        let arrived: Vec<(usize, RobotId, LeaseOffer)> = arrived;
        arrived.into_iter().map(|(_, robot, offer)| (robot, offer)).collect()
    }
}

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
        let mut fleet = simulated_fleet(&charges, &chargers, at_charger);
        for (round, in_turn) in in_turn.into_iter().enumerate() {
            let now = NodeTime::ZERO + CLAIM_AGE * u32::try_from(round).unwrap();
            let before: Vec<OtherRobot> = fleet.iter().map(Simulated::record).collect();
            for number in 0..fleet.len() {
                let records = if in_turn { fleet.iter().map(Simulated::record).collect() } else { before.clone() };
                let mut nearest_first = chargers.clone();
                nearest_first.rotate_left(number % chargers.len());
                fleet[number].decide(records, &chargers, nearest_first, now);
            }
            prop_assert!(uses_are_exclusive(&fleet, now), "round {round}: {fleet:?}");
            fleet.iter_mut().enumerate().for_each(|(number, robot)| robot.act(number, now));
        }
        for (robot, charge) in fleet.iter().zip(&charges) {
            prop_assert!(robot.has_charged || *charge >= BELOW, "{robot:?} of {fleet:?}");
        }
    }

    /// Coordinators come and go, robots notice it at different times, and notices of leases are delayed. Then all robots
    /// have a coordinator, or none has.
    #[test]
    fn leases_come_and_go_and_no_two_robots_use_the_same_charger(
        charges in vec(0.05..0.95, 2..=5),
        at_charger in any::<bool>(),
        chargers in 1..=3_usize,
        unsettled in vec(any_round(), UNSETTLED_ROUNDS),
        is_led_at_last in any::<bool>(),
    ) {
        let chargers: Vec<PlaceId> = (0..chargers).map(|number| place(&format!("Charger {number}"))).collect();
        let mut fleet = simulated_fleet(&charges, &chargers, at_charger);
        fleet.iter_mut().enumerate().for_each(|(number, robot)| robot.drive = number % 3);
        let mut coordinator = SimulatedCoordinator::new();
        let contact = [is_led_at_last; 5];
        let settled = Round { is_led: is_led_at_last, contact, delay: 0, in_turn: true };
        let rounds = unsettled.into_iter().chain(std::iter::repeat_n(settled, SETTLED_ROUNDS));
        for (number, round) in rounds.enumerate() {
            let now = NodeTime::ZERO + ROUND * u32::try_from(number).unwrap();
            let before: Vec<OtherRobot> = fleet.iter().map(Simulated::record).collect();
            let users: Vec<ChargerUser> = fleet.iter().map(Simulated::user).collect();
            coordinator.act(&round, &users, number, now);
            for (robot, offer) in coordinator.take_notices(number) {
                let receiver = fleet.iter_mut().find(|known| known.id == robot).expect("a robot of the fleet");
                receiver.leases.receive(offer, &mut receiver.activity);
            }
            for own in 0..fleet.len() {
                let records = if round.in_turn { fleet.iter().map(Simulated::record).collect() } else { before.clone() };
                let mut nearest_first = chargers.clone();
                nearest_first.rotate_left(own % chargers.len());
                fleet[own].has_coordinator = round.contact[own];
                fleet[own].decide(records, &chargers, nearest_first, now);
            }
            prop_assert!(uses_are_exclusive(&fleet, now), "round {number}: {fleet:?}");
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
    let charger =
        |name: &str, eligible: Option<&str>| Charger { place: place(name), eligible: eligible.map(str::to_owned) };
    let chargers = vec![charger("A", Some("robot.attributes.plug == 'a'")), charger("B", Some("robot.name == 'bob'"))];
    let settings = ChargingSettings { thresholds: thresholds(), chargers, parking: BTreeSet::new() };
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
