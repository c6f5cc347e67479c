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
    /// Charge at which the robot goes on: it suffices for the role and for the way to a charger after it.
    pub until: BatteryShare,
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
    /// Charge with which the robot could do the role without the stop, from where it is; infinite if it could not at all.
    pub needed_here: f64,
    /// Charge up to which the robot charges at most.
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
/// charger, during the role, and until a charger is reached after it. The robot charges until it has enough for the role, from
/// the charger and from where it is: its coordinator awards the role by its charge alone. A robot that has nearly the charge up
/// to which it charges at most plans no stop: by its record it would have charged already. `charging_time` returns the time for
/// which the robot charges at a charger from a charge to another, if it is known.
pub fn plan_stop(
    limits: StopLimits,
    options: &[StopOption],
    charging_time: impl Fn(&PlaceId, f64, BatteryShare) -> Option<Seconds>,
) -> Option<ChargingStop> {
    let StopLimits { charge, floor, needed_here, until } = limits;
    // Its record may state the tolerance more than it has, and counts as charged the tolerance below.
    if charge >= until.get() - 2.0 * CHARGE_TOLERANCE {
        return None;
    }
    let stop = |option: &StopOption| {
        let arrival = charge - option.way_energy;
        let needed = floor.get() + option.role_energy + option.onward_energy;
        let left = until.get() - CHARGE_TOLERANCE - option.role_energy - option.onward_energy;
        let suffices = arrival > floor.get() && left > floor.get();
        // The record may overstate the charge, and the role is awarded the tolerance below.
        let enough = needed.max(needed_here) + 2.0 * CHARGE_TOLERANCE;
        let until = BatteryShare::new(enough.min(until.get())).ok().filter(|_| suffices)?;
        let time = option.way_time + charging_time(&option.charger, arrival, until)?;
        let remaining = BatteryShare::new(until.get() - CHARGE_TOLERANCE - option.role_energy).ok()?;
        Some((time + option.role_time, ChargingStop { charger: option.charger.clone(), time, until, remaining }))
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
            needed_here in 0.0_f64..1.5,
            energies in prop::collection::vec((0.0_f64..0.4, 0.0_f64..0.9, 0.0_f64..0.3), 0..5),
        ) {
            let options: Vec<StopOption> = (0..).zip(&energies)
                .map(|(number, (way, role, onward))| option(number, *way, *role, *onward)).collect();
            let limits = StopLimits { charge, floor: share(floor), needed_here, until: share(until) };
            let charging_s = |from: f64, to: f64| (to - from).max(0.0) * 1000.0;
            let found = plan_stop(limits, &options, |_, from, to| Seconds::new(charging_s(from, to.get())).ok());
            let is_possible = |option: &&StopOption| {
                charge < until - 2.0 * CHARGE_TOLERANCE
                    && charge - option.way_energy > floor
                    && until - CHARGE_TOLERANCE - option.role_energy - option.onward_energy > floor
            };
            let needed = |option: &StopOption| needed_here.max(floor + option.role_energy + option.onward_energy);
            let end_s = |option: &StopOption| {
                let to = until.min(needed(option) + 2.0 * CHARGE_TOLERANCE);
                option.way_time.get() + charging_s(charge - option.way_energy, to) + option.role_time.get()
            };
            let soonest = options.iter().filter(is_possible).map(end_s).reduce(f64::min);
            let chosen = found.as_ref().map(|stop| {
                options.iter().find(|option| option.charger == stop.charger).expect("an option")
            });
            prop_assert!(chosen.is_none_or(|option| is_possible(&option)), "{found:?}");
            prop_assert_eq!(chosen.map(end_s), soonest);
            for (stop, option) in found.iter().zip(chosen) {
                prop_assert!(stop.remaining.get() - option.onward_energy > floor);
                prop_assert!(stop.until.get() <= until);
                prop_assert!(stop.until.get() >= until.min(needed(option)), "the role can be awarded");
            }
        }
    }

    fn limits(charge: f64, needed_here: f64) -> StopLimits {
        StopLimits { charge, floor: share(0.1), needed_here, until: share(0.9) }
    }

    #[test]
    fn a_robot_goes_on_when_its_charge_suffices_for_the_role() {
        let stop = |needed_here| {
            let time = |_: &PlaceId, from: f64, to: BatteryShare| Seconds::new((to.get() - from) * 1000.0).ok();
            let stop = plan_stop(limits(0.3, needed_here), &[option(0, 0.1, 0.3, 0.1)], time).expect("a stop");
            [stop.until.get(), stop.remaining.get(), stop.time.get() / 1000.0].map(|value| (value * 100.0).round())
        };
        // From the charger the role needs 50 %. The way to the charger takes 10 s.
        assert_eq!(stop(0.45), [54.0, 22.0, 35.0]);
        assert_eq!(stop(0.6), [64.0, 32.0, 45.0], "the robot could also begin from where it is");
        assert_eq!(stop(0.95), [90.0, 58.0, 71.0]);
        assert_eq!(stop(f64::INFINITY), [90.0, 58.0, 71.0]);
    }

    #[test]
    fn a_robot_that_counts_as_charged_plans_no_stop() {
        let found = |charge| {
            plan_stop(limits(charge, 0.95), &[option(0, 0.01, 0.4, 0.1)], |_, _, _| Some(seconds(100.0))).is_some()
        };
        assert_eq!([0.3, 0.85, 0.87, 0.89, 0.95].map(found), [true, true, false, false, false]);
    }

    #[test]
    fn a_charger_whose_power_is_unknown_is_no_stop() {
        assert_eq!(plan_stop(limits(0.3, 0.6), &[option(0, 0.1, 0.4, 0.1)], |_, _, _| None), None);
    }
}
