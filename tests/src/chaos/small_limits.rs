//! Limits of the log, the history and the active missions. Those of later seeds are so small that every run reaches
//! them, together with a burst of requests.

use super::chaos_fleet::{MISSIONS, ROOMS};
use super::fault_kind::FaultKind;
use super::schedule::{ChaosAction, Schedule, ScheduledAction};
use consort_protocol::ledger::HistoryLimits;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// First seed with the smallest limits. Smaller seeds keep their schedules and limits: mutation checks, the scoreboard and
/// the sweeps use them.
pub const FIRST_SEED_WITH_SMALL_LIMITS: u64 = 5003;

/// Number of active missions from the first seed on. Fewer would exclude missions that wait for each other.
const ACTIVE_MAX: usize = 2;

/// Size of the outcomes of ended missions from the first seed on, in bytes: at most four outcomes, and the requests of the
/// smallest run end with more.
const OUTCOME_BYTES_MAX: u64 = 500;

/// Requests of the burst: one more than may be active.
const BURST: [&str; ACTIVE_MAX + 1] = ["b0", "b1", "b2"];

/// Times of the burst in milliseconds: before the first fault.
const BURST_MS: [u64; BURST.len()] = [2_800, 3_100, 3_400];

/// Limits of a fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Limits {
    /// Entries between two snapshots.
    pub(super) snapshot_every: u64,
    /// Entries kept behind a snapshot.
    pub(super) log_entries_kept: u64,
    /// Ended missions kept whole.
    pub(super) ended_missions_max: u32,
    /// Size of the outcomes of ended missions, in bytes.
    pub(super) outcome_bytes_max: u64,
    /// Missions accepted at a time.
    pub(super) active_missions_max: usize,
}

impl Limits {
    /// Returns the limits of the run with this seed and this schedule.
    pub(super) fn of(seed: u64, schedule: &Schedule) -> Limits {
        let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x5a_a95_407);
        if !schedule.small_limits {
            return Limits {
                snapshot_every: chance.random_range(5..=50),
                log_entries_kept: chance.random_range(0..=20),
                ended_missions_max: chance.random_range(0..=4),
                outcome_bytes_max: HistoryLimits::default().outcome_bytes_max,
                active_missions_max: chance.random_range(2..=6),
            };
        }
        Limits {
            snapshot_every: chance.random_range(5..=10),
            log_entries_kept: chance.random_range(0..=5),
            ended_missions_max: chance.random_range(0..=1),
            outcome_bytes_max: OUTCOME_BYTES_MAX,
            active_missions_max: ACTIVE_MAX,
        }
    }
}

/// Checks whether the run with this seed and these kinds of faults has the smallest limits. Runs with missions that cannot be
/// completed as the only faults bound the time of the others, and have the usual limits.
pub(super) fn has_small_limits(seed: u64, kinds: &[FaultKind]) -> bool {
    seed >= FIRST_SEED_WITH_SMALL_LIMITS && kinds != [FaultKind::Poison]
}

/// Adds a burst of requests, from rooms that no other request names; none if too few are left.
pub(super) fn add_burst(steps: &mut Vec<ScheduledAction>) {
    let is_used =
        |name: &str| steps.iter().any(|step| matches!(&step.action, ChaosAction::Submit { room, .. } if room == name));
    let free: Vec<&str> = ROOMS.into_iter().filter(|room| !is_used(room)).take(BURST.len()).collect();
    if free.len() < BURST.len() {
        return;
    }
    let submit = |((request, at_ms), room): ((&str, u64), &str)| ScheduledAction {
        at_ms,
        action: ChaosAction::Submit {
            request: request.to_owned(),
            unnamed: false,
            mission: MISSIONS[0].to_owned(),
            room: room.to_owned(),
            priority: 0,
            deadline_s: None,
        },
    };
    steps.extend(BURST.into_iter().zip(BURST_MS).zip(free).map(submit));
}

#[cfg(test)]
mod tests {
    use super::super::chaos_fleet::ChaosFleet;
    use super::super::generate::{assert_valid, drawn, generate};
    use super::*;

    /// Size of the smallest outcome: it has no cause, the id of its mission has 13 characters, and that of its request 20.
    const SMALLEST_OUTCOME_BYTES: u64 = 2 * 20 + 3 * 13 + 32;

    fn requests(seed: u64, kinds: &[FaultKind]) -> Vec<String> {
        drawn(seed, kinds, |step| step.action.submitted_request())
    }

    #[test]
    fn runs_with_the_smallest_limits_request_more_missions_than_are_accepted() {
        let has_burst =
            |seed| BURST.iter().all(|name| requests(seed, &FaultKind::FAULTS).contains(&(*name).to_owned()));
        let later = FIRST_SEED_WITH_SMALL_LIMITS..FIRST_SEED_WITH_SMALL_LIMITS + 30;
        assert!((1..60).all(|seed| !has_burst(seed)) && !has_burst(later.start - 1));
        for seed in later.clone() {
            assert!(has_burst(seed), "seed {seed}");
            let schedule = generate(seed, &ChaosFleet::of(7), 2.0, &FaultKind::FAULTS);
            let limits = Limits::of(seed, &schedule);
            let Limits { snapshot_every, log_entries_kept, ended_missions_max, outcome_bytes_max, active_missions_max } =
                limits;
            assert!(snapshot_every + log_entries_kept <= 15, "seed {seed}");
            let requested = requests(seed, &FaultKind::FAULTS).len();
            assert!(requested > active_missions_max && requested > ended_missions_max as usize, "seed {seed}");
            assert!(requested as u64 * SMALLEST_OUTCOME_BYTES > outcome_bytes_max, "seed {seed}: {requested} requests");
        }
        assert!(!requests(later.start, &[FaultKind::Poison]).contains(&BURST[0].to_owned()));
        assert_valid(later);
    }

    #[test]
    fn other_runs_have_the_usual_limits_whatever_their_seed() {
        let usual = Schedule::of(vec![]);
        let seeds = FIRST_SEED_WITH_SMALL_LIMITS..FIRST_SEED_WITH_SMALL_LIMITS + 1_000;
        let limits: Vec<Limits> = seeds.map(|seed| Limits::of(seed, &usual)).collect();
        let largest = |of: fn(&Limits) -> u64| limits.iter().map(of).max();
        assert_eq!(largest(|limits| limits.snapshot_every), Some(50));
        assert_eq!(largest(|limits| limits.log_entries_kept), Some(20));
        assert_eq!(largest(|limits| limits.ended_missions_max.into()), Some(4));
        assert_eq!(largest(|limits| limits.active_missions_max as u64), Some(6));
        let usual = HistoryLimits::default().outcome_bytes_max;
        assert!(limits.iter().all(|limits| limits.outcome_bytes_max == usual));
    }
}
