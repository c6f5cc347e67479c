//! Decisions of a free robot about its charge, as a function of its state and the records of others.

use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::knowledge::{AWAITED_MAX, ChargerClaim, Charging};
use consort_protocol::units::{BatteryShare, NodeTime};
use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::time::Duration;

/// Age of a claim at which the robot acts on it, in node time. Raised: fewer drives to a charger that another robot
/// has claimed at the same time; charging begins later. A guess: a record takes some milliseconds, and a
/// lost record is repaired by anti-entropy within seconds.
pub(super) const CLAIM_AGE: Duration = Duration::from_secs(2);

/// Age of a claim without a lease at which the robot acts on it although there is a coordinator: the coordinator may lack
/// the record of the robot, or may not lease chargers. Raised: such a robot charges later, and less often uses a charger
/// out of turn. A guess.
pub(super) const LEASE_WAIT: Duration = Duration::from_secs(6);

/// Charges at which a robot begins and ends to charge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChargeThresholds {
    /// A free robot with less goes to a charger.
    pub below: BatteryShare,
    /// A robot charges until it has this much.
    pub until: BatteryShare,
    /// A free robot with less uses a charger that no other robot needs; `None`: never.
    pub opportunistic: Option<BatteryShare>,
}

/// Activity of a robot with respect to its charge.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Activity {
    /// The robot does not charge.
    Idle,
    /// The robot needs charge, and every charger that it can use is taken. These are the nearest.
    Waiting(BTreeSet<PlaceId>),
    /// The robot has claimed a charger, and drives there once it may act on the claim.
    Claimed(Claim),
    /// The robot is connected to a charger.
    Connected(Claim),
    /// The robot drives away from a charger for which another robot waits, or parks, until the drive has ended.
    Leaving,
}

/// Claim of this robot.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Claim {
    pub(super) published: ChargerClaim,
    /// Time of the claim.
    pub(super) since: NodeTime,
    pub(super) purpose: Purpose,
}

/// Lease of a charger that the coordinator offers to this robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct LeaseOffer {
    pub(super) charger: PlaceId,
    /// Position of the grant in the log.
    pub(super) lease: u64,
}

/// Leases of chargers that a robot has received.
#[derive(Debug, Clone, Default)]
pub(super) struct ReceivedLeases {
    /// Lease that the robot may claim with its next decision.
    offer: Option<LeaseOffer>,
    /// Latest lease that the robot has claimed: a delayed notice of an earlier one has no effect.
    latest: Option<u64>,
}

impl ReceivedLeases {
    /// Receives a lease. A robot that claims the charger adds it to its claim.
    pub(super) fn receive(&mut self, offer: LeaseOffer, activity: &mut Activity) {
        if self.latest >= Some(offer.lease) {
            return;
        }
        match activity {
            Activity::Claimed(claim) | Activity::Connected(claim) if claim.published.charger == offer.charger => {
                claim.published.lease = Some(offer.lease);
                self.follow(activity);
            }
            _ => self.offer = Some(offer),
        }
    }

    /// Takes the lease for the next decision.
    pub(super) fn take_offer(&mut self) -> Option<LeaseOffer> {
        self.offer.take()
    }

    /// Adopts the lease of a claim.
    pub(super) fn follow(&mut self, activity: &Activity) {
        if let Activity::Claimed(claim) | Activity::Connected(claim) = activity {
            self.latest = self.latest.max(claim.published.lease);
        }
    }
}

/// Reason to charge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// The charge is low.
    Need,
    /// The robot has no other work, or not the charge for it. It gives way to robots with low charge.
    TopUp,
}

/// Another robot, as known from its record.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::robot) struct OtherRobot {
    pub(in crate::robot) robot: RobotId,
    /// Current or last place.
    pub(in crate::robot) place: PlaceId,
    /// Charging; `None` for a robot that is down.
    pub(in crate::robot) charging: Option<Charging>,
}

/// State of the robot and of the others.
#[derive(Debug, Clone, Copy)]
pub(in crate::robot) struct Situation<'a> {
    pub(in crate::robot) robot: &'a RobotId,
    /// Current or last place.
    pub(in crate::robot) place: &'a PlaceId,
    pub(in crate::robot) battery: BatteryShare,
    /// The charge was too low for a role since the robot last had enough.
    pub(in crate::robot) lacked_charge: bool,
    pub(in crate::robot) others: &'a [OtherRobot],
    pub(in crate::robot) now: NodeTime,
}

impl Activity {
    /// Returns what the robot publishes, without the destination of a robot that leaves.
    pub(super) fn published(&self) -> Option<Charging> {
        match self {
            Activity::Idle | Activity::Leaving => None,
            Activity::Waiting(chargers) => Some(Charging::Waiting { chargers: chargers.clone() }),
            Activity::Claimed(claim) => Some(Charging::Bound(claim.published.clone())),
            Activity::Connected(claim) => Some(Charging::Connected(claim.published.clone())),
        }
    }
}

impl Claim {
    /// Checks whether the robot may act on the claim: the other robots have had time to receive it, and the coordinator,
    /// if there is one, has leased the charger to the robot or has not answered.
    pub(super) fn may_act(&self, has_coordinator: bool, now: NodeTime) -> bool {
        let waits = has_coordinator && self.published.lease.is_none();
        now.since(self.since) >= if waits { LEASE_WAIT } else { CLAIM_AGE }
    }
}

impl ChargeThresholds {
    /// Checks whether a robot has no reason to charge.
    pub(super) fn is_enough(&self, battery: BatteryShare, lacked_charge: bool) -> bool {
        let least = self.opportunistic.unwrap_or(self.below);
        battery >= if lacked_charge { self.until } else { least }
    }

    /// Returns the next activity of a free robot. `offer` is a lease that the robot has just received; a robot on its way
    /// has none. `all` are the chargers of the fleet. `nearest_first` returns the chargers that the robot can use, in the
    /// order of preference.
    pub(super) fn next(
        &self,
        activity: &Activity,
        situation: &Situation<'_>,
        offer: Option<&LeaseOffer>,
        all: &BTreeSet<PlaceId>,
        nearest_first: impl FnOnce() -> Vec<PlaceId>,
    ) -> Activity {
        let goes_on = match activity {
            Activity::Idle | Activity::Waiting(_) => false,
            Activity::Leaving => true,
            Activity::Claimed(claim) => {
                situation.keeps(activity)
                    && !situation.is_occupied(&claim.published.charger)
                    && !situation.yields(claim)
            }
            Activity::Connected(claim) => {
                let is_there = *situation.place == claim.published.charger;
                is_there && situation.battery < self.until && situation.keeps(activity) && !situation.yields(claim)
            }
        };
        match (goes_on, activity) {
            // The coordinator leases it no other charger meanwhile.
            (true, Activity::Claimed(claim)) if claim.published.lease.is_none() && offer.is_some() => {
                let leased = situation.leased_claim(offer, &nearest_first());
                let claim_of = |published| Claim { published, since: situation.now, purpose: claim.purpose };
                Activity::Claimed(leased.map_or_else(|| claim.clone(), claim_of))
            }
            (true, _) => activity.clone(),
            (false, _) => self.begin(situation, offer, all, nearest_first),
        }
    }

    fn begin(
        &self,
        situation: &Situation<'_>,
        offer: Option<&LeaseOffer>,
        all: &BTreeSet<PlaceId>,
        nearest_first: impl FnOnce() -> Vec<PlaceId>,
    ) -> Activity {
        let purpose = self.purpose(situation);
        let chargers = if purpose.is_some() { nearest_first() } else { vec![] };
        let may_claim = |charger: &PlaceId, purpose: Purpose| {
            !situation.is_taken(charger) && (purpose == Purpose::Need || !situation.is_awaited(charger))
        };
        let claim = purpose.and_then(|purpose| {
            let leased = situation.leased_claim(offer, &chargers);
            let unleased = || {
                let charger = chargers.iter().find(|charger| may_claim(charger, purpose))?;
                Some(situation.claim_of(charger, None))
            };
            Some(Claim { published: leased.or_else(unleased)?, since: situation.now, purpose })
        });
        if let Some(claim) = claim {
            return Activity::Claimed(claim);
        }
        // A robot that can use no charger does not wait: the others would leave theirs in vain.
        let waits = purpose == Some(Purpose::Need) && !chargers.is_empty();
        let waits_here = waits && chargers.contains(situation.place);
        if all.contains(situation.place) && situation.is_awaited(situation.place) && !waits_here {
            Activity::Leaving
        } else if waits {
            Activity::Waiting(chargers.into_iter().take(AWAITED_MAX).collect())
        } else {
            Activity::Idle
        }
    }

    fn purpose(&self, situation: &Situation<'_>) -> Option<Purpose> {
        if situation.battery < self.below {
            return Some(Purpose::Need);
        }
        let is_enough = self.is_enough(situation.battery, situation.lacked_charge);
        (!is_enough).then_some(Purpose::TopUp)
    }
}

impl Situation<'_> {
    /// Checks whether another robot waits for this charger.
    fn is_awaited(&self, charger: &PlaceId) -> bool {
        let awaits = |charging: &Charging| match charging {
            Charging::Waiting { chargers } => chargers.contains(charger),
            Charging::Bound(_) | Charging::Connected(_) | Charging::Leaving { .. } => false,
        };
        self.others.iter().filter_map(|other| other.charging.as_ref()).any(awaits)
    }

    fn claim_of(&self, charger: &PlaceId, lease: Option<u64>) -> ChargerClaim {
        ChargerClaim { charger: charger.clone(), battery: self.battery, lease, drive_s: None }
    }

    /// Returns the claim to the offered charger, if the robot can use the charger and the claim would prevail.
    fn leased_claim(&self, offer: Option<&LeaseOffer>, chargers: &[PlaceId]) -> Option<ChargerClaim> {
        let claim = offer.map(|offer| self.claim_of(&offer.charger, Some(offer.lease)))?;
        (chargers.contains(&claim.charger) && self.may_take(&claim)).then_some(claim)
    }

    /// Checks whether a new claim with a lease would prevail, and no other robot stands at the charger.
    fn may_take(&self, claim: &ChargerClaim) -> bool {
        let own = Charging::Bound(claim.clone());
        self.others.iter().all(|other| other.place != claim.charger)
            && self.claims_to(&claim.charger).all(|other| prevails((self.robot, &own), other))
    }

    fn yields(&self, claim: &Claim) -> bool {
        claim.purpose == Purpose::TopUp && self.is_awaited(&claim.published.charger)
    }

    /// Checks whether a robot with an earlier name also leaves a charger for this place: this robot drives elsewhere.
    pub(super) fn yields_place(&self, place: &PlaceId) -> bool {
        self.others.iter().any(|other| other.leaves_to() == Some(place) && other.robot < *self.robot)
    }

    /// Checks whether another robot claims the charger, or stands there.
    fn is_taken(&self, charger: &PlaceId) -> bool {
        self.claims_to(charger).next().is_some() || self.others.iter().any(|other| other.place == *charger)
    }

    /// Checks whether another robot stands at the charger without a claim to it.
    fn is_occupied(&self, charger: &PlaceId) -> bool {
        self.others.iter().any(|other| other.place == *charger && other.claim_to(charger).is_none())
    }

    fn claims_to(&self, charger: &PlaceId) -> impl Iterator<Item = (&RobotId, &Charging)> {
        self.others.iter().filter_map(move |other| other.claim_to(charger).map(|charging| (&other.robot, charging)))
    }

    /// Checks whether the robot's claim prevails over the claims of all others.
    fn keeps(&self, activity: &Activity) -> bool {
        let Some(own) = activity.published() else { return false };
        let Some(claim) = own.claim() else { return false };
        self.claims_to(&claim.charger).all(|other| prevails((self.robot, &own), other))
    }
}

impl OtherRobot {
    /// Returns the place to which the robot leaves a charger.
    pub(super) fn leaves_to(&self) -> Option<&PlaceId> {
        match self.charging.as_ref()? {
            Charging::Leaving { to } => Some(to),
            Charging::Waiting { .. } | Charging::Bound(_) | Charging::Connected(_) => None,
        }
    }

    fn claim_to(&self, charger: &PlaceId) -> Option<&Charging> {
        self.charging.as_ref().filter(|charging| charging.claim().is_some_and(|claim| claim.charger == *charger))
    }
}

/// Checks which of two claims to a charger prevails: that of a connected robot, then that with the later lease, then that
/// with less charge, then that of the first robot by name. Of two different robots exactly one prevails.
pub(super) fn prevails(one: (&RobotId, &Charging), other: (&RobotId, &Charging)) -> bool {
    let order = |charging: &Charging| {
        let (lease, battery) =
            charging.claim().map_or((None, BatteryShare::FULL), |claim| (claim.lease, claim.battery));
        ((!matches!(charging, Charging::Connected(_)), Reverse(lease)), battery.get())
    };
    let ((one_rank, one_charge), (other_rank, other_charge)) = (order(one.1), order(other.1));
    let by_charge = one_rank.cmp(&other_rank).then(one_charge.total_cmp(&other_charge));
    by_charge.then_with(|| one.0.cmp(other.0)).is_lt()
}
