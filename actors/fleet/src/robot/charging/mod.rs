//! Charging: a free robot drives to a charger by itself, with or without a coordinator.
//!
//! ```text
//!         less than `below`             drives once it may act on the claim, and docks
//!  Idle ───┬───────────────▶ Claimed ─────────────────────────────────────────────▶ Connected
//!          │                  ▲   │ another claim prevails                             │ `until` is reached
//!          │ all are taken    │   ▼                                                    ▼
//!          └───────────────▶ Waiting                       Idle, or Leaving if another robot waits for the charger
//! ```
//!
//! A robot that waits publishes the chargers that it may use. A robot that stands at one of them makes room if it needs no
//! charge, or may not use that charger itself: it drives to the nearest place to which no other robot leaves. A robot
//! whose charge does not rise at a charger tries another. A robot that has been idle for some seconds elsewhere than at a
//! parking place drives to one in the same way; a robot that leaves a charger drives to a parking place if any is free.
//! A robot that would charge again after the drive to a parking place stays at its charger until another waits for it.
//!
//! An award, a hold, an alarm and maintenance end each of these activities. After a start of its node a robot begins
//! only when it has received its orders, or after 10 s. A robot bids at any charge that suffices for the role
//! and for the way to a charger afterwards ([`ChargerReserve`]). With less charge it bids for the time after a stop at a
//! charger, if the power of the chargers and its capacity are known. It charges once it is free.
//!
//! Robots exclude each other by *claims* in their knowledge records: a robot claims a charger that no
//! other robot claims or occupies, publishes the claim, and drives once the claim is old enough to have
//! reached the others. A claim ends when the way to the charger is closed. If two robots claim a charger
//! at the same time, the claim with less charge prevails, then the first name. A partition can hide a
//! claim; the robots then meet at the charger, and one of them gives way once they receive each other's
//! records.
//!
//! A coordinator leases the chargers by these records, to the robots with less charge first. A robot that has a lease adds
//! it to its claim, which then prevails over all claims without, and over those with an earlier lease. While a coordinator
//! is in contact, a robot acts on a claim without a lease only if the coordinator does not answer for 6 s. So the loss of
//! the coordinator changes how long a robot waits, and not how robots exclude each other: each acts on a claim that the
//! others have had 2 s to receive, and that prevails over all claims that it has received.
//!
//! The decisions are in `policy`, and the state of the robot in `control`. The actor performs them.

mod control;
mod policy;
mod reserve;
#[cfg(test)]
mod tests;

pub(super) use control::ChargeControl;
pub use policy::ChargeThresholds;
pub(super) use policy::{OtherRobot, Situation};
pub(super) use reserve::BeforeStop;
pub use reserve::ChargerReserve;

use consort_protocol::charging_curve::ChargingCurve;
use consort_protocol::ensemble::Eligibility;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::units::{BatteryShare, Seconds, SharePerSecond, WattHours, Watts};
use consort_protocol::view::ChargingView;
use std::collections::{BTreeMap, BTreeSet};

/// Charging in a fleet.
#[derive(Debug, Clone, PartialEq)]
pub struct ChargingSettings {
    /// Charges at which a robot begins and ends to charge.
    pub thresholds: ChargeThresholds,
    /// Chargers.
    pub chargers: Vec<Charger>,
    /// Places to which free robots with enough charge drive.
    pub parking: BTreeSet<PlaceId>,
    /// Charging curve of the robots' batteries.
    pub curve: ChargingCurve,
    /// Measured gain of a battery at its full power, for chargers of unknown power and robots of unknown capacity.
    pub gain: Option<SharePerSecond>,
    /// Swaps of batteries by people; `None` without any.
    pub swap: Option<BatterySwap>,
}

/// Swaps of batteries by people. The robots do not charge at chargers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BatterySwap {
    /// Name of the mission that brings a robot, its parameter `robot`, to a person who swaps its battery.
    pub mission: String,
    /// Condition on the robots whose batteries are swapped, in CEL; `None` for all robots.
    pub eligible: Option<String>,
}

impl ChargingSettings {
    /// Checks whether people swap the battery of a robot with this record.
    pub(crate) fn swaps(&self, robot: &RobotId, worker: &RobotKnowledge) -> bool {
        let meets = |swap: &BatterySwap| {
            let condition = swap.eligible.as_ref();
            condition.is_none_or(|text| Eligibility::check_text(text, robot, worker).is_ok())
        };
        drives_on_battery(worker) && self.swap.as_ref().is_some_and(meets)
    }
}

fn drives_on_battery(worker: &RobotKnowledge) -> bool {
    worker.speed.is_some() && worker.discharge.get() > 0.0
}

impl ChargingSettings {
    /// Returns all chargers and places for parking. Each robot leaves those at which others stand.
    pub(crate) fn places(&self) -> BTreeSet<PlaceId> {
        self.chargers.iter().map(|charger| &charger.place).chain(&self.parking).cloned().collect()
    }
}

impl From<&ChargingSettings> for ChargingView {
    fn from(settings: &ChargingSettings) -> ChargingView {
        let ChargeThresholds { below, until, opportunistic } = settings.thresholds;
        let chargers = settings.chargers.iter().map(|charger| charger.place.clone()).collect();
        ChargingView { below, until, opportunistic, chargers }
    }
}

/// A charger.
#[derive(Debug, Clone, PartialEq)]
pub struct Charger {
    /// Its place.
    pub place: PlaceId,
    /// Condition on the robots that may use it, in CEL; `None` for all robots.
    pub eligible: Option<String>,
    /// Its power, if it is known.
    pub power: Option<Watts>,
}

/// Charging of a single robot.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RobotCharging {
    pub(super) thresholds: ChargeThresholds,
    /// Chargers that the robot may use.
    pub(super) usable: BTreeSet<PlaceId>,
    /// All chargers of the fleet.
    pub(super) all: BTreeSet<PlaceId>,
    /// Places for parking.
    pub(super) parking: BTreeSet<PlaceId>,
    pub(super) forecast: ChargingForecast,
}

/// Forecast of the time for which a robot charges.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct ChargingForecast {
    /// Gain of the battery at each usable charger with full power; empty if a gain is unknown.
    gains: BTreeMap<PlaceId, SharePerSecond>,
    curve: ChargingCurve,
}

impl ChargingForecast {
    /// Returns the time for which the robot charges at a charger. All chargers count as equal if a gain is unknown.
    pub(super) fn time(&self, charger: &PlaceId, from: f64, to: BatteryShare) -> Seconds {
        self.known_time(charger, from, to).unwrap_or(Seconds::ZERO)
    }

    /// Checks whether the gains are known.
    pub(super) fn is_known(&self) -> bool {
        !self.gains.is_empty()
    }

    /// Returns the time for which the robot charges at a charger, if the gains are known.
    pub(super) fn known_time(&self, charger: &PlaceId, from: f64, to: BatteryShare) -> Option<Seconds> {
        self.gains.get(charger).map(|gain| self.curve.time(from, to.get(), *gain))
    }
}

impl RobotCharging {
    /// Returns the charging of a robot with this record, and with a battery of this capacity, if it is known. Returns
    /// `None` for a robot that has no battery, does not drive, may use no charger, or has its battery swapped by people.
    pub(crate) fn of(
        settings: &ChargingSettings,
        robot: &RobotId,
        worker: &RobotKnowledge,
        capacity: Option<WattHours>,
    ) -> Option<RobotCharging> {
        if !drives_on_battery(worker) || settings.swaps(robot, worker) {
            return None;
        }
        let may_use = |charger: &&Charger| {
            let condition = charger.eligible.as_ref();
            condition.is_none_or(|text| Eligibility::check_text(text, robot, worker).is_ok())
        };
        let place = |charger: &Charger| charger.place.clone();
        let usable: Vec<&Charger> = settings.chargers.iter().filter(may_use).collect();
        let gain = |charger: &&Charger| {
            let by_power = charger.power.zip(capacity).map(|(power, capacity)| power.fills(capacity));
            Some((charger.place.clone(), by_power.or(settings.gain)?))
        };
        let gains = usable.iter().map(gain).collect::<Option<_>>().unwrap_or_default();
        let forecast = ChargingForecast { gains, curve: settings.curve.clone() };
        let usable: BTreeSet<PlaceId> = usable.into_iter().map(place).collect();
        let all = settings.chargers.iter().map(place).collect();
        let (thresholds, parking) = (settings.thresholds, settings.parking.clone());
        (!usable.is_empty()).then_some(RobotCharging { thresholds, usable, all, parking, forecast })
    }
}
