//! Missions with conditions, repetitions and loops, which some runs request in place of lab samples.

use super::fault_kind::FaultKind;
use super::schedule::{ChaosAction, ScheduledAction, WAITING};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The missions.
pub(super) const CONTROL_FLOW_MISSIONS: [&str; 2] = ["measured-visit", "shared-rounds"];

pub(super) const CONTROL_FLOW_FILES: [&str; CONTROL_FLOW_MISSIONS.len()] =
    [include_str!("missions/measured-visit.yaml"), include_str!("missions/shared-rounds.yaml")];

/// First seed with such missions. The seeds of mutation checks and of the scoreboard are smaller: their
/// results, such as the seed at which a bug is found, stay comparable.
pub(super) const FIRST_SEED: u64 = 91;

/// Share of the runs with such missions, and of the requests in these runs.
const RUNS: f64 = 0.5;
const REQUESTS: f64 = 0.5;

/// Replaces some missions of a schedule, from a generator of its own. A circular wait needs lab samples. So do runs with
/// missions that cannot be completed as the only faults, which bound the time of the others.
pub(super) fn replace_missions(seed: u64, kinds: &[FaultKind], steps: &mut [ScheduledAction]) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0xc0_47f1_0e5e);
    if seed < FIRST_SEED || kinds == [FaultKind::Poison] || !chance.random_bool(RUNS) {
        return;
    }
    for step in steps.iter_mut().filter(|step| !step.action.is_poison()) {
        if let ChaosAction::Submit { request, mission, .. } = &mut step.action
            && !WAITING.contains(&request.as_str())
            && chance.random_bool(REQUESTS)
        {
            *mission = (*CONTROL_FLOW_MISSIONS.choose(&mut chance).expect("there are two")).to_owned();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::chaos_fleet::{ChaosFleet, user_missions};
    use super::super::generate::generate;
    use super::super::requested_missions::workload_with;
    use super::super::schedule::Schedule;
    use super::*;
    use consort_skills::workload::Workload;

    fn requested(schedule: &Schedule) -> Vec<&str> {
        let of = |step: &'_ ScheduledAction| match &step.action {
            ChaosAction::Submit { mission, .. } => CONTROL_FLOW_MISSIONS.into_iter().find(|name| name == mission),
            _ => None,
        };
        schedule.steps.iter().filter_map(of).collect()
    }

    #[test]
    fn some_later_runs_request_each_mission_and_can_carry_it_out() {
        let composition = ChaosFleet::of(7);
        let schedules = |seeds: std::ops::Range<u64>| {
            seeds.map(|seed| generate(seed, &composition, 2.0, &FaultKind::FAULTS)).collect::<Vec<_>>()
        };
        assert!(schedules(1..FIRST_SEED).iter().all(|schedule| requested(schedule).is_empty()));
        let later = schedules(FIRST_SEED..FIRST_SEED + 30);
        for name in CONTROL_FLOW_MISSIONS {
            assert!(later.iter().filter(|schedule| requested(schedule).contains(&name)).count() >= 3, "{name}");
        }
        assert!(later.iter().filter(|schedule| requested(schedule).is_empty()).count() >= 5);
        for schedule in later.iter().filter(|schedule| !requested(schedule).is_empty()) {
            let workload = workload_with(&Workload::default(), schedule);
            let names: Vec<_> = workload.own_missions().collect();
            assert!(requested(schedule).iter().all(|name| names.contains(name)), "{schedule}");
            let missions = user_missions(&workload).unwrap_or_else(|(name, problems)| panic!("{name}: {problems}"));
            assert_eq!(missions.len(), names.len());
            schedule.check(&composition, &Workload::default()).unwrap_or_else(|problem| panic!("{problem}"));
        }
    }

    #[test]
    fn requests_that_need_lab_samples_are_not_replaced() {
        let composition = ChaosFleet::of(7);
        let (mut replaced, mut waiting) = (0, 0);
        for seed in FIRST_SEED..FIRST_SEED + 60 {
            for step in generate(seed, &composition, 3.0, &[FaultKind::LeaseEnd, FaultKind::CircularWait]).steps {
                let ChaosAction::Submit { request, mission, .. } = &step.action else { continue };
                let is_replaced = CONTROL_FLOW_MISSIONS.contains(&mission.as_str());
                let is_waiting = WAITING.contains(&request.as_str());
                assert!(!(is_replaced && is_waiting), "seed {seed}: {step}");
                replaced += u32::from(is_replaced);
                waiting += u32::from(is_waiting);
            }
            let poison = generate(seed, &composition, 3.0, &[FaultKind::Poison]);
            assert!(requested(&poison).is_empty(), "seed {seed}: {poison}");
        }
        assert!(replaced > 10 && waiting > 10, "{replaced} {waiting}");
    }
}
