//! Quantities with their units.
//!
//! Two clocks are never mixed. [`WorldTime`] is the time of physical events (driving, batteries,
//! estimates); a simulator may run it faster than the wall clock. [`NodeTime`] is the time of
//! processes (elections, leases, windows, retries): monotonic, since the start of the node.

use crate::schema::inline_schema;
use schemars::json_schema;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Sub};
use std::time::Duration;

/// Error: a number is outside the range of the quantity.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{value} is not {what}: allowed is {allowed}")]
pub struct UnitError {
    /// Number as given.
    pub value: f64,
    /// Quantity, as text.
    pub what: &'static str,
    /// Allowed range, as text.
    pub allowed: &'static str,
}

macro_rules! quantities {
    ($($(#[$doc:meta])* $name:ident, $unit:literal, $what:literal, $allowed:literal, $ok:expr, $schema:tt;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
        #[serde(try_from = "f64", into = "f64")]
        pub struct $name(f64);

        impl $name {
            /// Checks the number and creates the quantity.
            ///
            /// # Errors
            /// [`UnitError`] for a number outside the allowed range, infinite or not a number.
            pub fn new(value: f64) -> Result<Self, UnitError> {
                let ok: fn(f64) -> bool = $ok;
                if value.is_finite() && ok(value) {
                    Ok(Self(value))
                } else {
                    Err(UnitError { value, what: $what, allowed: $allowed })
                }
            }

            /// Returns the number without its unit.
            pub const fn get(self) -> f64 {
                self.0
            }
        }

        // The number is finite, so equality is reflexive.
        impl Eq for $name {}

        inline_schema!($name, json_schema!($schema));

        impl TryFrom<f64> for $name {
            type Error = UnitError;
            fn try_from(value: f64) -> Result<Self, UnitError> {
                Self::new(value)
            }
        }

        impl From<$name> for f64 {
            fn from(quantity: $name) -> f64 {
                quantity.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{:.*}{}", f.precision().unwrap_or(2), self.0, $unit)
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}{}", self.0, $unit)
            }
        }
    )*};
}

quantities! {
    /// Length along a route.
    Metres, " m", "a length", "a finite number of metres, 0 or more", |v| v >= 0.0,
        { "type": "number", "minimum": 0 };
    /// Duration in world time.
    Seconds, " s", "a duration", "a finite number of seconds, 0 or more", |v| v >= 0.0,
        { "type": "number", "minimum": 0 };
    /// Driving speed.
    MetresPerSecond, " m/s", "a speed", "a finite number of metres per second above 0", |v| v > 0.0,
        { "type": "number", "exclusiveMinimum": 0 };
    /// Charge of a battery, as a share of a full battery.
    BatteryShare, "", "a battery share", "a number from 0 (empty) to 1 (full)", |v| (0.0..=1.0).contains(&v),
        { "type": "number", "minimum": 0, "maximum": 1 };
    /// Energy used, in full batteries. May exceed 1: it is the sum over several robots, or an estimate of
    /// what no battery has.
    Energy, "", "an energy", "a finite number of full batteries, 0 or more", |v| v >= 0.0,
        { "type": "number", "minimum": 0 };
    /// Bound on the energy of a mission, in full batteries.
    EnergyLimit, "", "a bound on energy", "a finite number of full batteries above 0", |v| v > 0.0,
        { "type": "number", "exclusiveMinimum": 0 };
    /// Discharge rate of a working robot, in shares of a full battery per second of world time.
    SharePerSecond, " /s", "a discharge rate", "a finite share per second, 0 or more", |v| v >= 0.0,
        { "type": "number", "minimum": 0 };
    /// Power of a charger.
    Watts, " W", "a power", "a finite number of watts above 0", |v| v > 0.0,
        { "type": "number", "exclusiveMinimum": 0 };
    /// Capacity of a battery.
    WattHours, " Wh", "a capacity", "a finite number of watt-hours above 0", |v| v > 0.0,
        { "type": "number", "exclusiveMinimum": 0 };
}

/// Returns the sum of two numbers of 0 or more, at most the largest number: estimates of other nodes may be any number, and
/// no node can decode an infinite quantity.
fn finite_sum(one: f64, other: f64) -> f64 {
    (one + other).min(f64::MAX)
}

impl Metres {
    /// No distance.
    pub const ZERO: Metres = Metres(0.0);

    /// Returns the time to drive this distance.
    pub fn at(self, speed: MetresPerSecond) -> Seconds {
        Seconds(self.0 / speed.0)
    }
}

impl Add for Metres {
    type Output = Metres;
    fn add(self, other: Metres) -> Metres {
        Metres(self.0 + other.0)
    }
}

impl Seconds {
    /// No time.
    pub const ZERO: Seconds = Seconds(0.0);
}

impl Add for Seconds {
    type Output = Seconds;
    fn add(self, other: Seconds) -> Seconds {
        Seconds(finite_sum(self.0, other.0))
    }
}

impl AddAssign for Seconds {
    fn add_assign(&mut self, other: Seconds) {
        self.0 = finite_sum(self.0, other.0);
    }
}

impl Sum for Seconds {
    fn sum<I: Iterator<Item = Seconds>>(times: I) -> Seconds {
        times.fold(Seconds::ZERO, Add::add)
    }
}

impl BatteryShare {
    /// A full battery.
    pub const FULL: BatteryShare = BatteryShare(1.0);

    /// Formats as a percentage: `63.5 %`.
    pub fn percent(self) -> String {
        format!("{:.1} %", self.0 * 100.0)
    }
}

impl Energy {
    /// No energy.
    pub const ZERO: Energy = Energy(0.0);

    /// Largest energy of an estimate: sums of such energies are finite.
    const ESTIMATE_MAX: f64 = 1e9;

    /// Returns the energy of an estimate by another node, which may be any number.
    pub fn of_share(share: f64) -> Energy {
        Energy(if share.is_nan() { Self::ESTIMATE_MAX } else { share.clamp(0.0, Self::ESTIMATE_MAX) })
    }
}

impl Default for Energy {
    fn default() -> Energy {
        Energy::ZERO
    }
}

impl Add for Energy {
    type Output = Energy;
    fn add(self, other: Energy) -> Energy {
        Energy(finite_sum(self.0, other.0))
    }
}

impl AddAssign for Energy {
    fn add_assign(&mut self, other: Energy) {
        self.0 = finite_sum(self.0, other.0);
    }
}

impl Sum for Energy {
    fn sum<I: Iterator<Item = Energy>>(energies: I) -> Energy {
        energies.fold(Energy::ZERO, Add::add)
    }
}

impl SharePerSecond {
    /// Returns the share of a full battery used in this time. May exceed 1: then no battery lasts
    /// that long.
    pub fn over(self, time: Seconds) -> f64 {
        self.0 * time.0
    }
}

impl Watts {
    /// Returns the rate at which this power fills a battery; at most a full battery per second.
    pub fn fills(self, capacity: WattHours) -> SharePerSecond {
        const SECONDS_PER_HOUR: f64 = 3600.0;
        SharePerSecond((self.0 / (capacity.0 * SECONDS_PER_HOUR)).min(1.0))
    }
}

/// Instant of world time: seconds since the start of the world.
#[derive(Clone, Copy, PartialEq, PartialOrd, Debug, Default, Serialize, Deserialize)]
pub struct WorldTime(f64);

inline_schema!(WorldTime, json_schema!({ "type": "number", "minimum": 0 }));

impl WorldTime {
    /// Start of the world.
    pub const ZERO: WorldTime = WorldTime(0.0);

    /// Returns the instant this many seconds after the start; the start if the value is not a valid
    /// time.
    pub fn from_secs(seconds: f64) -> WorldTime {
        WorldTime(if seconds.is_finite() { seconds.max(0.0) } else { 0.0 })
    }

    /// Returns the seconds since the start.
    pub const fn as_secs(self) -> f64 {
        self.0
    }
}

impl Add<Seconds> for WorldTime {
    type Output = WorldTime;
    fn add(self, time: Seconds) -> WorldTime {
        WorldTime(self.0 + time.0)
    }
}

impl Sub for WorldTime {
    type Output = Seconds;
    /// Returns the time from `earlier` to `self`; zero if `earlier` is later.
    fn sub(self, earlier: WorldTime) -> Seconds {
        Seconds((self.0 - earlier.0).max(0.0))
    }
}

/// Instant of node time: the uptime of the node at that moment. Never compared between nodes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default, Serialize, Deserialize)]
pub struct NodeTime(Duration);

impl NodeTime {
    /// Start of the node.
    pub const ZERO: NodeTime = NodeTime(Duration::ZERO);

    /// Returns the instant this long after the node's start.
    pub const fn at(since_start: Duration) -> NodeTime {
        NodeTime(since_start)
    }

    /// Returns the milliseconds since the node's start.
    pub const fn as_millis(self) -> u64 {
        // A node is not up for 500 million years.
        self.0.as_millis() as u64
    }

    /// Returns the instant this long before, or the start of the node if that is later.
    pub const fn earlier_by(self, time: Duration) -> NodeTime {
        NodeTime(self.0.saturating_sub(time))
    }

    /// Returns the time since `earlier`; zero if `earlier` is later.
    pub const fn since(self, earlier: NodeTime) -> Duration {
        self.0.saturating_sub(earlier.0)
    }
}

impl Add<Duration> for NodeTime {
    type Output = NodeTime;
    fn add(self, time: Duration) -> NodeTime {
        NodeTime(self.0 + time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_outside_the_range_is_rejected() {
        for value in [-0.01, 1.01, f64::NAN, f64::INFINITY] {
            assert!(BatteryShare::new(value).is_err(), "{value}");
        }
        assert!(serde_json::from_str::<BatteryShare>("1.5").is_err());
        let error = MetresPerSecond::new(0.0).unwrap_err().to_string();
        assert_eq!(error, "0 is not a speed: allowed is a finite number of metres per second above 0");
    }

    #[test]
    fn sums_of_large_estimates_are_finite() {
        let (time, energy) = (Seconds::new(f64::MAX).unwrap(), Energy::new(f64::MAX).unwrap());
        let (mut times, mut energies) = (time + time, energy + energy);
        assert_eq!((times, energies), (time, energy));
        times += time;
        energies += energy;
        assert_eq!((times, energies), (time, energy));
        let sums: (Seconds, Energy) = ([time, time].into_iter().sum(), [energy, energy].into_iter().sum());
        assert_eq!(sums, (time, energy));
    }

    #[test]
    fn a_charger_fills_a_battery_in_its_capacity_over_the_power() {
        let (power, capacity) = (Watts::new(360.0).unwrap(), WattHours::new(100.0).unwrap());
        assert!((power.fills(capacity).get() - 0.001).abs() < 1e-15, "360 J/s of 360 kJ");
        let (lightning, tiny) = (Watts::new(1e300).unwrap(), WattHours::new(1e-300).unwrap());
        assert_eq!(lightning.fills(tiny).get(), 1.0);
        assert!(Watts::new(0.0).is_err() && WattHours::new(0.0).is_err());
    }

    #[test]
    fn a_route_takes_its_length_over_the_speed() {
        let time = Metres::new(26.03).unwrap().at(MetresPerSecond::new(0.15).unwrap());
        assert!((time.get() - 173.533_333).abs() < 1e-6);
    }
}
