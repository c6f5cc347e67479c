//! How the fleet fares under each kind of fault alone.

use super::chaos_fleet::ChaosFleet;
use super::generate::generate;
use super::run::{RunConfig, RunOutcome};
use super::schedule::FaultKind;
use super::seed_sweep::{SeedSweep, percentiles};
use serde::Serialize;

/// One kind of fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScoreboardRow {
    /// Its name; `all` for all of them together.
    pub fault: &'static str,
    /// How many fleets it was done to.
    pub runs: u64,
    /// Missions that were acknowledged.
    pub acknowledged: usize,
    /// Those that no ledger had in the end.
    pub lost_missions: usize,
    /// Runs in which two acted in one role.
    pub double_holders: usize,
    /// Missions that were carried out.
    pub completed: usize,
    /// Missions that failed with a cause, were withdrawn, or wait for a person.
    pub otherwise_ended: usize,
    /// How many takeovers there were.
    pub takeovers: usize,
    /// From the loss of a leader to the next: the middle, in milliseconds. It is lost when it is killed, or when it ceases to
    /// count itself leader, since it hears no majority; then it is replaced once there is a majority again.
    pub takeover_p50_ms: Option<u64>,
    /// The same: all but one in a hundred were quicker.
    pub takeover_p99_ms: Option<u64>,
    /// From the lifting of the last fault until all missions had ended and all nodes were of one mind: the middle.
    pub converged_p50_ms: Option<u64>,
    /// The same: all but one in a hundred were quicker.
    pub converged_p99_ms: Option<u64>,
    /// Seeds for which an invariant did not hold, and which.
    pub violations: Vec<(u64, String)>,
    /// What repeats it.
    pub command: String,
}

/// Kinds in the order of the table, each alone, and all together.
pub fn kinds() -> Vec<(&'static str, Vec<FaultKind>)> {
    let alone = [FaultKind::None].into_iter().chain(FaultKind::FAULTS).map(|kind| (kind.name(), vec![kind]));
    alone.chain([("all", FaultKind::FAULTS.to_vec())]).collect()
}

/// Runs seeds `1..=runs` under some kinds of faults; `each` is called after each run. A violation stops nothing here: it is
/// counted.
pub fn run_row(
    name: &'static str,
    kinds: &[FaultKind],
    runs: u64,
    minutes: f64,
    jobs: usize,
    mut each: impl FnMut(),
) -> ScoreboardRow {
    const NODES: usize = 7;
    let cast = ChaosFleet::of(NODES);
    let order =
        |seed| (RunConfig { seed, nodes: NODES, minutes, closed: false }, generate(seed, &cast, minutes, kinds));
    let mut outcomes: Vec<RunOutcome> = vec![];
    let mut next = 1;
    while next <= runs {
        let found = SeedSweep { seeds: next..=runs, jobs, config: &order, prepare: &|| () }.run(|outcome| {
            outcomes.push(outcome.clone());
            each();
        });
        // Whatever is beyond a violation was not begun, or is done again.
        let Some(found) = found else { break };
        outcomes.retain(|outcome| outcome.seed <= found.seed);
        next = found.seed + 1;
    }
    let sum = |count: fn(&RunOutcome) -> usize| outcomes.iter().map(count).sum::<usize>();
    let takeovers: Vec<u64> = outcomes.iter().flat_map(|outcome| outcome.tally.takeovers_ms.iter().copied()).collect();
    let converged: Vec<u64> = outcomes.iter().filter_map(|outcome| outcome.tally.converged_ms).collect();
    let (takeover, convergence) = (percentiles(&takeovers), percentiles(&converged));
    let mut violations: Vec<(u64, String)> =
        outcomes.iter().filter_map(|o| Some((o.seed, o.violation.as_ref()?.invariant.clone()))).collect();
    violations.sort();
    let faults = if name == "all" { String::new() } else { format!(" --faults {name}") };
    let minutes = if minutes == 5.0 { String::new() } else { format!(" --minutes {minutes}") };
    ScoreboardRow {
        fault: name,
        runs,
        acknowledged: sum(|outcome| outcome.tally.acknowledged),
        lost_missions: sum(|outcome| outcome.tally.lost),
        double_holders: violations.iter().filter(|(_, name)| name == "one_holder" || name == "under_lease").count(),
        completed: sum(|outcome| outcome.tally.completed),
        otherwise_ended: sum(|outcome| outcome.tally.failed + outcome.tally.canceled + outcome.tally.rescues),
        takeovers: takeovers.len(),
        takeover_p50_ms: takeover.map(|(p50, _)| p50),
        takeover_p99_ms: takeover.map(|(_, p99)| p99),
        converged_p50_ms: convergence.map(|(p50, _)| p50),
        converged_p99_ms: convergence.map(|(_, p99)| p99),
        violations,
        command: format!("consort chaos --seeds 1..{runs}{faults}{minutes}"),
    }
}

/// The rows as a table in Markdown.
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
