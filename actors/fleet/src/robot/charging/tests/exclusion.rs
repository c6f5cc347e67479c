//! Simulated fleets: no two robots use the same charger, and all charge.

use super::{BELOW, claim, place, robot, share, thresholds};
use crate::robot::charging::policy::{
    Activity, CLAIM_AGE, Claim, LeaseOffer, OtherRobot, ReceivedLeases, Situation, prevails,
};
use consort_protocol::chargers::{ChargerLeases, ChargerUser};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::knowledge::{ChargerClaim, Charging};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger, Resource};
use consort_protocol::resource_leases::ResourceAction;
use consort_protocol::units::{BatteryShare, NodeTime};
use consort_protocol::versions::VersionRange;
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::time::Duration;

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
        let offer = self.leases.take_offer().filter(|_| self.driven == 0);
        let all = chargers.iter().cloned().collect();
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
        for action in self.session.due(&self.ledger.charger_leases(), users, now) {
            match action {
                ResourceAction::Lease { resource, robot } => {
                    self.apply(Command::LeaseResource { resource, robot, at_ms: 0 });
                }
                ResourceAction::Free { resource, epoch, .. } => {
                    self.apply(Command::FreeResource { resource, epoch });
                }
                ResourceAction::Notify { resource, robot, epoch } => {
                    let Resource::Charger(charger) = resource else { panic!("a session of chargers leases no device") };
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
