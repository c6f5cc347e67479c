//! Quantities that carry their unit.
//!
//! Two clocks are never mixed: [`WorldTime`] is when things happen to bodies (driving, batteries, estimates; a simulator
//! may run it faster than the wall clock), [`NodeTime`] is when things happen to processes (elections, leases,
//! windows, retries; monotonic, since the node started).

use crate::schema::inline_schema;
use schemars::json_schema;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::{Add, AddAssign, Sub};
use std::time::Duration;

/// Why a number is not the quantity it was given for.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{value} is not {what}: allowed is {allowed}")]
pub struct UnitError {
    /// The number as given.
    pub value: f64,
    /// The quantity, in words.
    pub what: &'static str,
    /// The range allowed, in words.
    pub allowed: &'static str,
}

macro_rules! quantities {
    ($($(#[$doc:meta])* $name:ident, $unit:literal, $what:literal, $allowed:literal, $ok:expr, $schema:tt;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
        #[serde(try_from = "f64", into = "f64")]
        pub struct $name(f64);

        impl $name {
            /// Checks the number and takes it as this quantity.
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

            /// The bare number.
            pub const fn get(self) -> f64 {
                self.0
            }
        }

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
    /// A length along a route.
    Metres, " m", "a length", "a finite number of metres, 0 or more", |v| v >= 0.0,
        { "type": "number", "minimum": 0 };
    /// How long something takes in the world.
    Seconds, " s", "a duration", "a finite number of seconds, 0 or more", |v| v >= 0.0,
        { "type": "number", "minimum": 0 };
    /// A driving speed.
    MetresPerSecond, " m/s", "a speed", "a finite number of metres per second above 0", |v| v > 0.0,
        { "type": "number", "exclusiveMinimum": 0 };
    /// Charge in a battery, as a share of a full one.
    BatteryShare, "", "a battery share", "a number from 0 (empty) to 1 (full)", |v| (0.0..=1.0).contains(&v),
        { "type": "number", "minimum": 0, "maximum": 1 };
    /// How fast a robot at work empties its battery, in shares of a full one per second of world time.
    SharePerSecond, " /s", "a discharge rate", "a finite share per second, 0 or more", |v| v >= 0.0,
        { "type": "number", "minimum": 0 };
}

impl Metres {
    /// No distance.
    pub const ZERO: Metres = Metres(0.0);

    /// Time to drive this far.
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
        Seconds(self.0 + other.0)
    }
}

impl AddAssign for Seconds {
    fn add_assign(&mut self, other: Seconds) {
        self.0 += other.0;
    }
}

impl BatteryShare {
    /// A full battery.
    pub const FULL: BatteryShare = BatteryShare(1.0);

    /// As a percentage, in words: `63.5 %`.
    pub fn percent(self) -> String {
        format!("{:.1} %", self.0 * 100.0)
    }
}

impl SharePerSecond {
    /// Share of a full battery used in this time. It may exceed 1: no battery lasts that long.
    pub fn over(self, time: Seconds) -> f64 {
        self.0 * time.0
    }
}

/// An instant of world time: seconds since the world began.
#[derive(Clone, Copy, PartialEq, PartialOrd, Debug, Default, Serialize, Deserialize)]
pub struct WorldTime(f64);

impl WorldTime {
    /// The beginning of the world.
    pub const ZERO: WorldTime = WorldTime(0.0);

    /// The instant this many seconds after the beginning; what is not a time at all is the beginning.
    pub fn from_secs(seconds: f64) -> WorldTime {
        WorldTime(if seconds.is_finite() { seconds.max(0.0) } else { 0.0 })
    }

    /// Seconds since the beginning.
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
    /// Time from `earlier` to `self`; nothing if `earlier` is later.
    fn sub(self, earlier: WorldTime) -> Seconds {
        Seconds((self.0 - earlier.0).max(0.0))
    }
}

/// An instant of node time: how long the node has been up when it happens. Never compared between nodes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default, Serialize, Deserialize)]
pub struct NodeTime(Duration);

impl NodeTime {
    /// The node's start.
    pub const ZERO: NodeTime = NodeTime(Duration::ZERO);

    /// The instant this long after the node's start.
    pub const fn at(since_start: Duration) -> NodeTime {
        NodeTime(since_start)
    }

    /// Milliseconds since the node's start.
    pub const fn as_millis(self) -> u64 {
        // A node is not up for 500 million years.
        self.0.as_millis() as u64
    }

    /// How long ago `earlier` was; nothing if it lies ahead.
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
    fn what_is_not_a_share_is_refused_where_it_enters() {
        for value in [-0.01, 1.01, f64::NAN, f64::INFINITY] {
            assert!(BatteryShare::new(value).is_err(), "{value}");
        }
        assert!(serde_json::from_str::<BatteryShare>("1.5").is_err());
        let error = MetresPerSecond::new(0.0).unwrap_err().to_string();
        assert_eq!(error, "0 is not a speed: allowed is a finite number of metres per second above 0");
    }

    #[test]
    fn a_route_takes_its_length_over_the_speed() {
        let time = Metres::new(26.03).unwrap().at(MetresPerSecond::new(0.15).unwrap());
        assert!((time.get() - 173.533_333).abs() < 1e-6);
    }
}
