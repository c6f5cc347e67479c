//! Chargers and batteries.

use crate::slug;
use consort_fleet::robot::{ChargeThresholds, Charger, ChargingSettings};
use consort_protocol::charging_curve::ChargingCurve;
use consort_protocol::units::{BatteryShare, WattHours, Watts};
use std::collections::BTreeSet;

/// Chargers of a fleet, and the batteries of its mobile robots.
#[derive(Debug, Clone)]
pub struct ChargingSetup {
    /// Chargers, and when robots use them.
    pub settings: ChargingSettings,
    /// Power of each charger.
    pub power: Watts,
    /// Capacity of each mobile robot's battery.
    pub capacity: WattHours,
}

impl ChargingSetup {
    /// Charge up to which a robot charges with [`new`](ChargingSetup::new).
    pub const UNTIL: f64 = 0.9;

    /// Capacity of a battery with [`new`](ChargingSetup::new).
    pub const CAPACITY_WH: f64 = 100.0;

    /// Returns chargers of this power at these places. A robot charges below a charge of `below`.
    ///
    /// # Panics
    /// If the charge is no share, or the power is no power.
    pub fn new(places: &[&str], below: f64, power_w: f64) -> ChargingSetup {
        let share = |share| BatteryShare::new(share).expect("a share");
        let thresholds = ChargeThresholds { below: share(below), until: share(Self::UNTIL), opportunistic: None };
        let chargers = places.iter().map(|place| Charger { place: slug(place), eligible: None, power: None }).collect();
        ChargingSetup {
            settings: ChargingSettings {
                thresholds,
                chargers,
                parking: BTreeSet::new(),
                curve: ChargingCurve::default(),
                gain: None,
                swap: None,
            },
            power: Watts::new(power_w).expect("a power"),
            capacity: WattHours::new(Self::CAPACITY_WH).expect("a capacity"),
        }
    }

    /// Tells the robots the power of the chargers: they plan stops before roles for which their charge does not suffice.
    #[must_use]
    pub fn with_known_power(mut self) -> ChargingSetup {
        let power = Some(self.power);
        self.settings.chargers.iter_mut().for_each(|charger| charger.power = power);
        self
    }
}
