//! Missions that cannot be completed, which some requests of poison ask for in place of samples from rooms
//! without a nurse, and what each may cost the others.

use super::control_flow::FIRST_SEED;
use super::fault_kind::FaultKind;
use super::schedule::{ChaosAction, ScheduledAction};
use crate::FAILING_TASKS;
use crate::failing_domain::failure_class;
use consort_protocol::cause::CauseClass;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::iter;
use std::time::Duration;

/// First seed of runs with more faults that request [failing missions](FAILING_TASKS). Smaller seeds keep their missions.
const FIRST_SEED_WITH_FAILING: u64 = 241;

/// Missions that wait in vain: a person never answers, and a condition has no value.
pub(super) const WAITING_MISSIONS: [&str; 2] = ["unanswered-call", "unknown-reading"];

pub(super) const WAITING_FILES: [&str; WAITING_MISSIONS.len()] =
    [include_str!("missions/unanswered-call.yaml"), include_str!("missions/unknown-reading.yaml")];

/// Limit for each requested mission to keep the others waiting, if no fault but missions that cannot be
/// completed disturbs them: a drive to a room, a wait for an absent person and a drive to the laboratory, during
/// which the mission has the only arm.
pub(super) const MISSION_SHARE: Duration = Duration::from_secs(45);

/// Maximum number of times that robots give up the roles of a mission before it fails.
const RELEASES_MAX: usize = 5;

/// What a mission that cannot be completed may cost the others: it is awarded to robots at most `awards` times, and
/// each award takes a robot from other missions for at most `held`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PoisonBound {
    /// Maximum number of awards.
    pub(super) awards: usize,
    /// Longest time for which a robot acts in a role after an award.
    pub(super) held: Duration,
}

impl PoisonBound {
    /// Returns the bound of a mission in a fleet with this number of carriers. A failing task takes a quarter of a second.
    pub(super) fn of(mission: &str, carriers: usize) -> PoisonBound {
        let (awards, held) = match failure_class(mission) {
            // It fails at once, when the person does not answer or the condition is evaluated.
            None => (1, MISSION_SHARE),
            // The first failure ends the mission.
            Some(CauseClass::Task) => (1, Duration::from_secs(1)),
            // Each carrier tries once.
            Some(CauseClass::Precondition) => (carriers, Duration::from_secs(1)),
            // Each carrier tries twice, with a pause of half a second.
            Some(CauseClass::Robot) => (carriers, Duration::from_secs(2)),
            // Each award allows four attempts, with pauses of half a second, one and two seconds.
            Some(CauseClass::Transient) => (RELEASES_MAX, Duration::from_secs(6)),
        };
        PoisonBound { awards, held }
    }
}

/// Returns the names of the missions.
pub(super) fn poison_missions() -> impl Iterator<Item = &'static str> + Clone {
    WAITING_MISSIONS.into_iter().chain(FAILING_TASKS)
}

/// Returns the file of a failing mission: its only task has the same name.
pub(super) fn failing_file(task: &str) -> String {
    format!("mission: {task}\nroles: {{ r1: {{ kind: managed }} }}\nroot: {{ task: it, type: {task}, roles: [r1] }}\n")
}

/// Replaces some missions that cannot be completed by others that cannot. Runs with poison alone, and later seeds,
/// have all kinds in turn. Of runs with more faults, those of mutation checks and of the scoreboard stay comparable.
pub(super) fn replace_poison(seed: u64, kinds: &[FaultKind], steps: &mut [ScheduledAction]) {
    let is_alone = kinds == [FaultKind::Poison];
    if seed < FIRST_SEED && !is_alone {
        return;
    }
    let all_in_turn = is_alone || seed >= FIRST_SEED_WITH_FAILING;
    let all = iter::once(None).chain(poison_missions().map(Some));
    let first = usize::try_from(seed % all.clone().count() as u64).expect("a small number");
    let mut turns = all.cycle().skip(first);
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x9015_04ed);
    for step in steps.iter_mut().filter(|step| step.action.is_poison()) {
        let ChaosAction::Submit { mission, .. } = &mut step.action else { continue };
        let other = match all_in_turn {
            true => turns.next().flatten(),
            false => WAITING_MISSIONS.get(chance.random_range(0..=WAITING_MISSIONS.len())).copied(),
        };
        if let Some(other) = other {
            other.clone_into(mission);
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
    use std::ops::Range;

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
        for name in poison_missions() {
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
        let requested = |seeds: Range<u64>, names: &[&str]| {
            let schedules = seeds.map(|seed| generate(seed, &composition, 2.0, &FaultKind::FAULTS));
            let count = |schedule: Schedule| poison(&schedule).into_iter().filter(|name| names.contains(name)).count();
            schedules.map(count).sum::<usize>()
        };
        assert_eq!(requested(1..FIRST_SEED, &WAITING_MISSIONS), 0);
        assert!(requested(FIRST_SEED..FIRST_SEED + 60, &WAITING_MISSIONS) > 0);
        assert_eq!(requested(1..FIRST_SEED_WITH_FAILING, &FAILING_TASKS), 0);
        assert!(requested(FIRST_SEED_WITH_FAILING..FIRST_SEED_WITH_FAILING + 60, &FAILING_TASKS) > 0);
    }
}
