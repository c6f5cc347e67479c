//! Missions that cannot be completed, which some requests of poison ask for in place of samples from rooms
//! without a nurse.

use super::control_flow::FIRST_SEED;
use super::fault_kind::FaultKind;
use super::schedule::{ChaosAction, ScheduledAction};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The missions: a person never answers, and a condition has no value.
pub(super) const POISON_MISSIONS: [&str; 2] = ["unanswered-call", "unknown-reading"];

pub(super) const POISON_FILES: [&str; POISON_MISSIONS.len()] =
    [include_str!("missions/unanswered-call.yaml"), include_str!("missions/unknown-reading.yaml")];

/// Replaces some missions that cannot be completed by others that cannot, from a generator of its own. Of runs with
/// more faults, those of mutation checks and of the scoreboard stay comparable.
pub(super) fn replace_poison(seed: u64, kinds: &[FaultKind], steps: &mut [ScheduledAction]) {
    if seed < FIRST_SEED && kinds != [FaultKind::Poison] {
        return;
    }
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x9015_04ed);
    for step in steps.iter_mut().filter(|step| step.action.is_poison()) {
        if let ChaosAction::Submit { mission, .. } = &mut step.action
            && let Some(other) = POISON_MISSIONS.get(chance.random_range(0..=POISON_MISSIONS.len()))
        {
            (*other).clone_into(mission);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::chaos_fleet::{ABSENT, ChaosFleet, MISSIONS, user_missions};
    use super::super::generate::generate;
    use super::super::requested_missions::workload_with;
    use super::super::schedule::Schedule;
    use super::*;
    use consort_skills::workload::Workload;

    fn poison(schedule: &Schedule) -> Vec<&str> {
        let poison = schedule.steps.iter().filter(|step| step.action.is_poison());
        let missions = poison.filter_map(|step| match &step.action {
            ChaosAction::Submit { mission, .. } => Some(mission.as_str()),
            _ => None,
        });
        missions.collect()
    }

    #[test]
    fn runs_with_poison_alone_request_missions_of_each_kind() {
        let composition = ChaosFleet::of(7);
        let schedules: Vec<Schedule> =
            (1..=20).map(|seed| generate(seed, &composition, 3.0, &[FaultKind::Poison])).collect();
        let count = |is: &dyn Fn(&str) -> bool| schedules.iter().flat_map(poison).filter(|name| is(name)).count();
        assert!(count(&|name| MISSIONS.contains(&name)) >= 3);
        for name in POISON_MISSIONS {
            assert!(count(&|other| other == name) >= 3, "{name}");
        }
        for schedule in &schedules {
            let workload = workload_with(&Workload::default(), schedule);
            let missions = user_missions(&workload).unwrap_or_else(|(name, problems)| panic!("{name}: {problems}"));
            assert_eq!(missions.len(), workload.own_missions().count(), "{schedule}");
            let (_, people) = composition.participants(&workload);
            assert!(people.iter().all(|person| person.role.as_str() != ABSENT), "{schedule}");
            schedule.check(&composition, &Workload::default()).unwrap_or_else(|problem| panic!("{problem}"));
        }
    }

    #[test]
    fn runs_with_other_faults_keep_their_missions_up_to_the_first_seed() {
        let composition = ChaosFleet::of(7);
        let requested = |seed| poison_of(&generate(seed, &composition, 2.0, &FaultKind::FAULTS));
        assert_eq!((1..FIRST_SEED).map(requested).sum::<usize>(), 0);
        assert!((FIRST_SEED..FIRST_SEED + 60).map(requested).sum::<usize>() > 0);
    }

    /// Returns the number of requests for the missions of this module.
    fn poison_of(schedule: &Schedule) -> usize {
        poison(schedule).into_iter().filter(|name| POISON_MISSIONS.contains(name)).count()
    }
}
