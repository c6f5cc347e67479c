//! Results of the fleet under each kind of fault alone.

use super::chaos_fleet::ChaosFleet;
use super::fault_kind::FaultKind;
use super::generate::generate;
use super::run::{RunConfig, RunOutcome};
use super::seed_sweep::SeedSweep;
use crate::percentiles::Percentiles;
use consort_skills::workload::Workload;
use serde::Serialize;

/// Results for a kind of fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScoreboardRow {
    /// Its name; `all` for all kinds together.
    pub fault: &'static str,
    /// Number of runs.
    pub runs: u64,
    /// Acknowledged missions.
    pub acknowledged: usize,
    /// Acknowledged missions that no ledger contained at the end.
    pub lost_missions: usize,
    /// Runs in which two robots acted in the same role.
    pub double_holders: usize,
    /// Completed missions.
    pub completed: usize,
    /// Missions that failed with a cause, were canceled, or need intervention.
    pub not_completed: usize,
    /// Number of takeovers.
    pub takeovers: usize,
    /// Median duration from the loss of a leader to the next, in milliseconds. A leader is lost
    /// when it is killed, or when it steps down without a quorum. In the latter case the next
    /// leader follows once a majority is connected again.
    pub takeover_p50_ms: Option<u64>,
    /// 99th percentile of the same duration.
    pub takeover_p99_ms: Option<u64>,
    /// Median duration from the end of the last fault until all missions had ended and all nodes
    /// had converged.
    pub converged_p50_ms: Option<u64>,
    /// 99th percentile of the same duration.
    pub converged_p99_ms: Option<u64>,
    /// Seeds with a violation, each with the name of the invariant.
    pub violations: Vec<(u64, String)>,
    /// Command that reproduces the row.
    pub command: String,
}

/// Returns the kinds in the order of the table: each alone, then all together.
pub fn kinds() -> Vec<(&'static str, Vec<FaultKind>)> {
    let alone = [FaultKind::None].into_iter().chain(FaultKind::FAULTS).map(|kind| (kind.name(), vec![kind]));
    alone.chain([("all", FaultKind::FAULTS.to_vec())]).collect()
}

/// Runs seeds `1..=runs` under some kinds of faults; calls `each` after each run. A violation is
/// counted and does not stop the sweep.
pub fn run_row(
    name: &'static str,
    kinds: &[FaultKind],
    runs: u64,
    minutes: f64,
    jobs: usize,
    mut each: impl FnMut(),
) -> ScoreboardRow {
    const NODES: usize = 7;
    let composition = ChaosFleet::of(NODES);
    // A hostile node and a revocation have no effect in an open fleet, whose runs are ten times as fast.
    let closed = kinds.contains(&FaultKind::Hostile) || kinds.contains(&FaultKind::Revoke);
    let config = |seed| {
        (
            RunConfig { seed, nodes: NODES, minutes, closed, mutant: None, workload: Workload::default() },
            generate(seed, &composition, minutes, kinds),
        )
    };
    let mut outcomes: Vec<RunOutcome> = vec![];
    let mut next = 1;
    while next <= runs {
        let found = SeedSweep { seeds: next..=runs, jobs, config: &config }.run(|outcome| {
            outcomes.push(outcome.clone());
            each();
        });
        // Seeds beyond a violation were not begun, or are run again.
        let Some(found) = found else { break };
        outcomes.retain(|outcome| outcome.seed <= found.seed);
        next = found.seed + 1;
    }
    let sum = |count: fn(&RunOutcome) -> usize| outcomes.iter().map(count).sum::<usize>();
    let takeovers: Vec<u64> =
        outcomes.iter().flat_map(|outcome| outcome.counters.takeovers_ms.iter().copied()).collect();
    let converged: Vec<u64> = outcomes.iter().filter_map(|outcome| outcome.counters.converged_ms).collect();
    let (takeover, convergence) = (Percentiles::of_ms(&takeovers), Percentiles::of_ms(&converged));
    let mut violations: Vec<(u64, String)> =
        outcomes.iter().filter_map(|o| Some((o.seed, o.violation.as_ref()?.invariant.clone()))).collect();
    violations.sort();
    let faults = if name == "all" { String::new() } else { format!(" --faults {name}") };
    let minutes = if minutes == 5.0 { String::new() } else { format!(" --minutes {minutes}") };
    ScoreboardRow {
        fault: name,
        runs,
        acknowledged: sum(|outcome| outcome.counters.acknowledged),
        lost_missions: sum(|outcome| outcome.counters.lost),
        double_holders: violations.iter().filter(|(_, name)| name == "one_holder" || name == "under_lease").count(),
        completed: sum(|outcome| outcome.counters.completed),
        not_completed: sum(|outcome| {
            outcome.counters.failed + outcome.counters.canceled + outcome.counters.needs_intervention
        }),
        takeovers: takeovers.len(),
        takeover_p50_ms: takeover.map(|times| times.p50 as u64),
        takeover_p99_ms: takeover.map(|times| times.p99 as u64),
        converged_p50_ms: convergence.map(|times| times.p50 as u64),
        converged_p99_ms: convergence.map(|times| times.p99 as u64),
        violations,
        command: format!("consort-lab chaos --seeds 1..{runs}{faults}{minutes}"),
    }
}

/// Formats the rows as a Markdown table.
pub fn markdown(rows: &[ScoreboardRow]) -> String {
    let mut table = String::from(
        "| fault | runs | lost missions | double holders | missions completed | takeover p50 / p99 | \
         time to converge p50 / p99 | again by |\n|---|---|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let span = |p50: Option<u64>, p99: Option<u64>, unit: f64, name: &str, digits: usize| match (p50, p99) {
            (Some(p50), Some(p99)) => {
                format!("{:.digits$} / {:.digits$} {name}", p50 as f64 / unit, p99 as f64 / unit)
            }
            _ => "–".to_owned(),
        };
        let broken = if row.violations.is_empty() {
            String::new()
        } else {
            let seeds: Vec<_> = row.violations.iter().map(|(seed, name)| format!("{name} at seed {seed}")).collect();
            format!(" (**{}**)", seeds.join(", "))
        };
        table.push_str(&format!(
            "| {}{broken} | {} | {} | {} | {} of {} | {} | {} | `{}` |\n",
            row.fault,
            row.runs,
            row.lost_missions,
            row.double_holders,
            row.completed,
            row.acknowledged,
            span(row.takeover_p50_ms, row.takeover_p99_ms, 1.0, "ms", 0),
            span(row.converged_p50_ms, row.converged_p99_ms, 1000.0, "s", 1),
            row.command,
        ));
    }
    table
}
