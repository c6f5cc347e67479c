//! Chargers, which robots use by themselves, and small batteries. Some runs have them.

use super::fault_kind::FaultKind;
use super::orders::FIRST_SEED;
use super::schedule::{ChaosAction, Schedule};
use crate::{ChargingSetup, RobotSpec};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Places of the chargers. No robot works there, except for requests from rooms without a nurse.
const PLACES: [&str; 2] = ["Dock", "PC Room 8"];

/// Shares of the runs with chargers, and of these runs with a single one.
const RUNS: f64 = 0.5;
const SINGLE: f64 = 0.6;

/// Charge below which a robot charges.
const BELOW: f64 = 0.35;

/// Power of a charger: a battery gains 0.4 % a second.
const POWER_W: f64 = 1440.0;

/// Discharge of a carrier per second of work. A mission needs about a quarter of the charge; with the usual batteries
/// a tenth.
const DISCHARGE: f64 = 0.001;

/// Charges of the carriers at the start, in turn: some charge soon.
const CHARGES: [f64; 3] = [0.6, 0.45, 0.4];

/// Charges in runs with planned stops: a mission and the way to a charger need more.
const CHARGES_WITH_STOPS: [f64; 3] = [0.38, 0.3, 0.25];

/// First seed with planned stops. Smaller seeds keep their schedules, fleets and charges: mutation checks, the scoreboard
/// and the sweeps of closed fleets use them.
pub const FIRST_SEED_WITH_STOPS: u64 = 211;

/// Share of the later runs with planned stops, of those that may have chargers.
const STOPS: f64 = 0.8;

/// Gives some runs chargers, from generators of their own. Runs with nodes that are gone for good have none, since such a
/// robot may stand at the only charger, nor do runs with missions that cannot be completed as the only faults, which
/// bound the time of the others.
pub(super) fn add_chargers(seed: u64, kinds: &[FaultKind], schedule: Schedule) -> Schedule {
    let is_loss = |action: &ChaosAction| matches!(action, ChaosAction::Remove { .. } | ChaosAction::Revoke { .. });
    let loses_robots = schedule.steps.iter().any(|step| is_loss(&step.action));
    if seed < FIRST_SEED || kinds == [FaultKind::Poison] || loses_robots {
        return schedule;
    }
    let mut stops = ChaCha8Rng::seed_from_u64(seed ^ 0x5709_c4a2);
    let plans_stops = seed >= FIRST_SEED_WITH_STOPS && stops.random_bool(STOPS);
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0xc4a2_9e25);
    let has_chargers = chance.random_bool(RUNS) || plans_stops;
    let chargers = match has_chargers {
        true if chance.random_bool(SINGLE) => 1,
        true => PLACES.len(),
        false => 0,
    };
    Schedule { chargers, plans_stops, ..schedule }
}

/// Returns the setup of a fleet with the chargers of a schedule; `None` without any.
pub(super) fn setup(schedule: &Schedule) -> Option<ChargingSetup> {
    let places = &PLACES[..schedule.chargers.min(PLACES.len())];
    let setup = (!places.is_empty()).then(|| ChargingSetup::new(places, BELOW, POWER_W))?;
    Some(if schedule.plans_stops { setup.with_known_power() } else { setup })
}

/// Gives the carriers small batteries.
pub(super) fn with_small_batteries(carriers: Vec<RobotSpec>, schedule: &Schedule) -> Vec<RobotSpec> {
    let charges = if schedule.plans_stops { CHARGES_WITH_STOPS } else { CHARGES };
    let small = |(carrier, charge): (RobotSpec, f64)| RobotSpec { discharge: DISCHARGE, ..carrier.with_charge(charge) };
    carriers.into_iter().zip(charges.into_iter().cycle()).map(small).collect()
}

#[cfg(test)]
mod tests {
    use super::super::chaos_fleet::ChaosFleet;
    use super::super::generate::generate;
    use super::*;

    fn generated(seed: u64, kinds: &[FaultKind]) -> Schedule {
        generate(seed, &ChaosFleet::of(7), 2.0, kinds)
    }

    fn chargers(seed: u64, kinds: &[FaultKind]) -> usize {
        generated(seed, kinds).chargers
    }

    #[test]
    fn some_later_runs_have_chargers() {
        assert!((1..FIRST_SEED).all(|seed| chargers(seed, &FaultKind::FAULTS) == 0));
        let later: Vec<usize> = (FIRST_SEED..FIRST_SEED + 60).map(|seed| chargers(seed, &FaultKind::FAULTS)).collect();
        for count in 0..=PLACES.len() {
            assert!(later.iter().filter(|found| **found == count).count() >= 3, "{count}: {later:?}");
        }
        assert!((FIRST_SEED..FIRST_SEED + 60).all(|seed| chargers(seed, &[FaultKind::Poison]) == 0));
        let kinds = [FaultKind::CircularWait];
        assert!((FIRST_SEED..FIRST_SEED + 60).all(|seed| chargers(seed, &kinds) == 0), "robots are gone for good");
    }

    #[test]
    fn most_of_the_latest_runs_with_chargers_plan_stops() {
        let plans_stops = |seed: u64| generated(seed, &FaultKind::FAULTS).plans_stops;
        assert!(!(1..FIRST_SEED_WITH_STOPS).any(plans_stops));
        let latest = FIRST_SEED_WITH_STOPS..FIRST_SEED_WITH_STOPS + 60;
        let (with, without): (Vec<u64>, Vec<u64>) = latest.partition(|seed| plans_stops(*seed));
        assert!(with.len() >= 20 && without.len() >= 3, "{with:?}");
        assert!(with.iter().all(|seed| chargers(*seed, &FaultKind::FAULTS) > 0));
        assert!(without.iter().all(|seed| !generated(*seed, &[FaultKind::Poison]).plans_stops));
    }

    #[test]
    fn the_setup_has_the_chargers_of_the_map() {
        let schedule = |chargers, plans_stops| Schedule { chargers, plans_stops, ..Schedule::of(vec![]) };
        assert!(setup(&schedule(0, false)).is_none());
        let map = consort_world::map::shipped("hospital").expect("it is shipped");
        for count in 1..=PLACES.len() {
            let chargers =
                |plans_stops| setup(&schedule(count, plans_stops)).expect("there are chargers").settings.chargers;
            let (plain, with_stops) = (chargers(false), chargers(true));
            assert_eq!([plain.len(), with_stops.len()], [count; 2]);
            assert!(plain.iter().all(|charger| map.place(&charger.place).is_some() && charger.power.is_none()));
            assert!(with_stops.iter().all(|charger| charger.power.is_some_and(|power| power.get() == POWER_W)));
        }
        let small = |plans_stops| -> Vec<(f64, f64)> {
            let carriers = ["garnet", "hazel"].map(|name| RobotSpec::carrier(name, "Dock")).to_vec();
            let small = with_small_batteries(carriers, &schedule(1, plans_stops));
            small.iter().map(|carrier| (carrier.battery, carrier.discharge)).collect()
        };
        assert_eq!(small(false), [(CHARGES[0], DISCHARGE), (CHARGES[1], DISCHARGE)]);
        assert_eq!(small(true), [(CHARGES_WITH_STOPS[0], DISCHARGE), (CHARGES_WITH_STOPS[1], DISCHARGE)]);
    }
}
