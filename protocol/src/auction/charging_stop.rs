//! Charging stops: a robot whose charge does not suffice for a role charges before it.
//!
//! ```text
//!   charge    ─┐ promised roles, way          ┌─┐ role
//!               └────────────────┐ charging  ─┘  └───────┐ way to a charger
//!   floor  ┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄└──────────┘┄┄┄┄┄┄┄┄┄┄┄┄└──
//! ```

use crate::ids::PlaceId;
use crate::units::{BatteryShare, Seconds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Tolerance for the charge of a robot, as a share of a full battery: records state the charge in steps of 0.02.
pub const CHARGE_TOLERANCE: f64 = 0.02;

/// Stop at a charger before a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ChargingStop {
    /// The charger.
    pub charger: PlaceId,
    /// Time for the way to it, for connecting and for charging.
    pub time: Seconds,
    /// Charge above the minimum that a role must leave, when the robot goes on.
    pub spare: BatteryShare,
    /// Charge left after the role.
    pub remaining: BatteryShare,
}

/// Charge of a robot, and the charges that bound a stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopLimits {
    /// Charge before the stop, as a share of a full battery; negative if the battery would not last.
    pub charge: f64,
    /// Charge that must always be exceeded.
    pub floor: BatteryShare,
    /// Charge up to which the robot charges.
    pub until: BatteryShare,
}

/// A charger at which a robot may stop, with the way to it and the role from it on. Energies are shares of a full battery.
#[derive(Debug, Clone, PartialEq)]
pub struct StopOption {
    /// The charger.
    pub charger: PlaceId,
    /// Time for the way to it, and for connecting.
    pub way_time: Seconds,
    /// Energy for that.
    pub way_energy: f64,
    /// Time for the role from there.
    pub role_time: Seconds,
    /// Energy for that.
    pub role_energy: f64,
    /// Energy for the way to a charger after the role.
    pub onward_energy: f64,
}

/// Returns the stop with which the role ends first; the first of equal ones. The charge stays above the floor on the way to the
/// charger, during the role, and until a charger is reached after it. A robot that has nearly the charge up to which it charges
/// plans no stop: by its record it would have charged already. `charging_time` returns the time for which the robot charges at a
/// charger from a charge on, if it is known.
pub fn plan_stop(
    limits: StopLimits,
    options: &[StopOption],
    charging_time: impl Fn(&PlaceId, f64) -> Option<Seconds>,
) -> Option<ChargingStop> {
    let StopLimits { charge, floor, until } = limits;
    // Its record may state the tolerance more than it has, and counts as charged the tolerance below.
    if charge >= until.get() - 2.0 * CHARGE_TOLERANCE {
        return None;
    }
    let stop = |option: &StopOption| {
        let arrival = charge - option.way_energy;
        let remaining = until.get() - CHARGE_TOLERANCE - option.role_energy;
        let suffices = arrival > floor.get() && remaining - option.onward_energy > floor.get();
        let time = option.way_time + charging_time(&option.charger, arrival).filter(|_| suffices)?;
        let stop = ChargingStop {
            charger: option.charger.clone(),
            time,
            spare: BatteryShare::new(until.get() - floor.get()).ok()?,
            remaining: BatteryShare::new(remaining).ok()?,
        };
        Some((time + option.role_time, stop))
    };
    let stops = options.iter().filter_map(stop);
    stops.min_by(|one, other| one.0.get().total_cmp(&other.0.get())).map(|(_, stop)| stop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn share(value: f64) -> BatteryShare {
        BatteryShare::new(value).unwrap()
    }

    fn seconds(value: f64) -> Seconds {
        Seconds::new(value).unwrap()
    }

    fn option(number: usize, way: f64, role: f64, onward: f64) -> StopOption {
        StopOption {
            charger: format!("charger-{number}").parse().unwrap(),
            way_time: seconds(way * 100.0),
            way_energy: way,
            role_time: seconds(role * 100.0),
            role_energy: role,
            onward_energy: onward,
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn a_stop_never_leaves_a_charge_below_the_floor_and_is_the_soonest(
            charge in -0.2_f64..1.0,
            floor in 0.02_f64..0.3,
            until in 0.3_f64..1.0,
            energies in prop::collection::vec((0.0_f64..0.4, 0.0_f64..0.9, 0.0_f64..0.3), 0..5),
        ) {
            let options: Vec<StopOption> = (0..).zip(&energies)
                .map(|(number, (way, role, onward))| option(number, *way, *role, *onward)).collect();
            let limits = StopLimits { charge, floor: share(floor), until: share(until) };
            let charging_s = |from: f64| (until - from).max(0.0) * 1000.0;
            let found = plan_stop(limits, &options, |_, from| Seconds::new(charging_s(from)).ok());
            let is_possible = |option: &&StopOption| {
                charge < until - 2.0 * CHARGE_TOLERANCE
                    && charge - option.way_energy > floor
                    && until - CHARGE_TOLERANCE - option.role_energy - option.onward_energy > floor
            };
            let end_s = |option: &StopOption| {
                option.way_time.get() + charging_s(charge - option.way_energy) + option.role_time.get()
            };
            let soonest = options.iter().filter(is_possible).map(end_s).reduce(f64::min);
            let chosen = found.as_ref().map(|stop| {
                options.iter().find(|option| option.charger == stop.charger).expect("an option")
            });
            prop_assert!(chosen.is_none_or(|option| is_possible(&option)), "{found:?}");
            prop_assert_eq!(chosen.map(end_s), soonest);
            for (stop, option) in found.iter().zip(chosen) {
                prop_assert!(stop.remaining.get() - option.onward_energy > floor);
                prop_assert!(stop.spare.get() <= until - floor + 1e-9);
            }
        }
    }

    #[test]
    fn a_robot_that_counts_as_charged_plans_no_stop() {
        let found = |charge| {
            let limits = StopLimits { charge, floor: share(0.1), until: share(0.9) };
            plan_stop(limits, &[option(0, 0.01, 0.4, 0.1)], |_, _| Some(seconds(100.0))).is_some()
        };
        assert_eq!([0.3, 0.85, 0.87, 0.89, 0.95].map(found), [true, true, false, false, false]);
    }

    #[test]
    fn a_charger_whose_power_is_unknown_is_no_stop() {
        let limits = StopLimits { charge: 0.3, floor: share(0.1), until: share(0.9) };
        assert_eq!(plan_stop(limits, &[option(0, 0.1, 0.4, 0.1)], |_, _| None), None);
    }
}
