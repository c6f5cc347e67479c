//! Chargers, which robots use by themselves, and small batteries. Some runs have them.

use super::fault_kind::FaultKind;
use super::orders::FIRST_SEED;
use super::schedule::{ChaosAction, ScheduledAction};
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

/// Returns the number of chargers in a run, from a generator of its own. Runs with nodes that are gone for good have none,
/// since such a robot may stand at the only charger, nor do runs with missions that cannot be completed as the only
/// faults, which bound the time of the others.
pub(super) fn charger_count(seed: u64, kinds: &[FaultKind], steps: &[ScheduledAction]) -> usize {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0xc4a2_9e25);
    let loses_robots = steps.iter().any(|step| matches!(step.action, ChaosAction::Remove { .. }));
    if seed < FIRST_SEED || kinds == [FaultKind::Poison] || loses_robots || !chance.random_bool(RUNS) {
        return 0;
    }
    if chance.random_bool(SINGLE) { 1 } else { PLACES.len() }
}

/// Returns the setup of a fleet with `count` chargers; `None` for none.
pub(super) fn setup(count: usize) -> Option<ChargingSetup> {
    (count > 0).then(|| ChargingSetup::new(&PLACES[..count.min(PLACES.len())], BELOW, POWER_W))
}

/// Gives the carriers small batteries.
pub(super) fn with_small_batteries(carriers: Vec<RobotSpec>) -> Vec<RobotSpec> {
    let small = |(carrier, charge): (RobotSpec, f64)| RobotSpec { discharge: DISCHARGE, ..carrier.with_charge(charge) };
    carriers.into_iter().zip(CHARGES.into_iter().cycle()).map(small).collect()
}

#[cfg(test)]
mod tests {
    use super::super::chaos_fleet::ChaosFleet;
    use super::super::generate::generate;
    use super::*;

    fn chargers(seed: u64, kinds: &[FaultKind]) -> usize {
        generate(seed, &ChaosFleet::of(7), 2.0, kinds).chargers
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
    fn the_setup_has_the_chargers_of_the_map() {
        assert!(setup(0).is_none());
        let map = consort_world::map::shipped("hospital").expect("it is shipped");
        for count in 1..=PLACES.len() {
            let chargers = setup(count).expect("there are chargers").settings.chargers;
            assert_eq!(chargers.len(), count);
            assert!(chargers.iter().all(|charger| map.place(&charger.place).is_some()));
        }
        let carriers = ["garnet", "hazel"].map(|name| RobotSpec::carrier(name, "Dock")).to_vec();
        let small: Vec<(f64, f64)> =
            with_small_batteries(carriers).iter().map(|carrier| (carrier.battery, carrier.discharge)).collect();
        assert_eq!(small, [(CHARGES[0], DISCHARGE), (CHARGES[1], DISCHARGE)]);
    }
}
