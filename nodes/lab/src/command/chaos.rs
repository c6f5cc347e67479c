//! `consort-lab chaos`: runs whole fleets under generated faults, and checks invariants at every
//! step.

use super::workload_flags::{WorkloadFlags, missions_in_hospital};
use clap::{ArgGroup, Args as ClapArgs};
use consort_nodes::command::flag_values::InvalidValue;
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use consort_skills::extensions::Extensions;
use consort_skills::workload::Workload;
use consort_tests::chaos::mutants::Mutant;
use consort_tests::chaos::mutation_checks::{MUTANT_CHECKS, check_mutant};
use consort_tests::chaos::scoreboard::{self, markdown};
use consort_tests::chaos::{
    ChaosFleet, Coverage, FaultKind, RunConfig, RunOutcome, Schedule, SeedSweep, Violation, chaos_fleet, generate,
    shrink,
};
use consort_tests::percentiles::Percentiles;
use consort_text::count;
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The usages, each with its flags. Shown whenever other flags were given.
const USAGE: &str = "\
consort-lab chaos [--seeds FIRST..LAST] [--minutes MINUTES] [--nodes NODES] [--faults KIND,…] [--mutant NAME]
                     [--domain FILE] [--mission FILE] [--person NAME] [--jobs JOBS] [--json]
       consort-lab chaos --seed SEED [--schedule FILE | --faults KIND,…] [--minutes MINUTES] [--nodes NODES]
                     [--mutant NAME] [--domain FILE] [--mission FILE] [--person NAME] [--verbose] [--json]
       consort-lab chaos --scoreboard [--runs N] [--minutes MINUTES] [--save FILE] [--jobs JOBS] [--json]
       consort-lab chaos --mutants [--jobs JOBS] [--json]";

/// Maximum number of causes in the summary.
const CAUSES_MAX: usize = 10;

/// Maximum number of runs for shrinking a schedule.
const SHRINK_TRIES: usize = 300;

/// Runs whole fleets under generated faults. Checks at every step that no acknowledged mission is
/// lost and no role is held twice.
///
/// Each seed is a run: a fleet in this process, on virtual time, with client requests and faults
/// drawn from the seed. Nodes crash and restart (with their complete disk, without the unsynced
/// writes, or with an empty disk), pause, and are partitioned. Links lose, duplicate, reorder and
/// delay messages. Disks are slow, clocks drift, batteries run down, skills fail, panic and hang.
/// The coordinator is killed at any moment. A hostile node with a valid certificate attacks the
/// others. After 70 % of the time all faults end. The fleet must then converge: a single
/// coordinator, every mission ended, and complete membership at every node.
///
/// With --mission the clients request missions of your own, in turn, in place of the lab samples; places without a
/// default are rooms of the hospital. Carriers have the skills for them, and people on call have the roles of people.
///
/// It stops at the first seed that violates an invariant. It then prints the violation, the events
/// before it, the smallest set of faults that reproduces it, and the command that repeats it. With
/// --json all of that goes to the standard error.
#[derive(Debug, ClapArgs)]
#[command(
    override_usage = USAGE,
    group = ArgGroup::new("what").args(["seeds", "seed", "mutants", "scoreboard"]),
    after_long_help = "\
Examples:
  consort-lab chaos --seeds 1..1000                         # the first thousand seeds, on all cores
  consort-lab chaos --seed 4711 --verbose                   # a single seed, with all its steps
  consort-lab chaos --seed 4711 --schedule chaos-4711.json  # a violation again, with its written schedule
  consort-lab chaos --faults partition,coordinator-crash    # only some kinds of faults
  consort-lab chaos --scoreboard --runs 50 --save score.json  # the results under each kind of fault
  consort-lab chaos --seeds 1..20 --domain domain.yaml --mission mission.yaml  # a mission of your own

  # checks that injected bugs are found
  consort-lab chaos --mutants

The same seed, nodes, minutes and faults give the same run, to the byte, on any machine.

Exit codes: 0 all invariants held; 1 an invariant was violated; 2 the flags or the schedule are wrong."
)]
pub(crate) struct Args {
    /// The seeds, the last included
    #[arg(long, value_name = "FIRST..LAST", value_parser = seeds, default_value = "1..100")]
    seeds: RangeInclusive<u64>,
    /// A single seed
    #[arg(long)]
    seed: Option<u64>,
    // clap accepts a flag required by another flag next to a flag that excludes the latter, unless
    // it excludes that flag itself.
    /// A schedule from a file (JSON), instead of the schedule generated from the seed
    #[arg(long, value_name = "FILE", requires = "seed", conflicts_with_all = ["seeds", "mutants", "scoreboard"])]
    schedule: Option<PathBuf>,
    /// Simulated minutes of each run
    #[arg(long, default_value_t = 5.0, value_parser = minutes, conflicts_with = "mutants")]
    minutes: f64,
    /// Nodes of the fleet: an arm, and carriers and stations in equal parts; the host of the world
    /// is added
    #[arg(long, default_value_t = 7, value_parser = nodes, conflicts_with_all = ["mutants", "scoreboard"])]
    nodes: usize,
    /// Parallel runs [default: the number of cores]
    #[arg(long, conflicts_with = "seed")]
    jobs: Option<usize>,
    /// The kinds of faults [default: all]
    #[arg(long, value_name = "KIND,…", value_delimiter = ',', conflicts_with_all = ["schedule", "mutants", "scoreboard"])]
    faults: Vec<FaultKind>,
    /// Run fleets without certificates, in which the hostile node has no effect
    #[arg(long, conflicts_with_all = ["mutants", "scoreboard"])]
    open: bool,
    /// Run with an injected bug, in fleets without certificates unless the bug concerns them
    #[arg(long, value_name = "NAME", conflicts_with_all = ["mutants", "scoreboard"])]
    mutant: Option<Mutant>,
    /// Hunt every injected bug, and print the number of seeds and the invariant that found it
    #[arg(long)]
    mutants: bool,
    /// Print results for each kind of fault, as a table (Markdown, or JSON with --json)
    #[arg(long)]
    scoreboard: bool,
    /// Write the scoreboard to a file too (JSON)
    #[arg(long, value_name = "FILE", requires = "scoreboard", conflicts_with_all = ["seeds", "seed", "mutants"])]
    save: Option<PathBuf>,
    /// Runs for each line of the scoreboard
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..), requires = "scoreboard", conflicts_with_all = ["seeds", "seed", "mutants"])]
    runs: u64,
    #[command(flatten)]
    workload: WorkloadFlags,
    /// Print the steps of the run
    #[arg(long, requires = "seed", conflicts_with_all = ["seeds", "mutants", "scoreboard"])]
    verbose: bool,
    /// Print only JSON on the standard output: a line for each run or each injected bug, a single
    /// line for the scoreboard
    #[arg(long)]
    json: bool,
}

fn seeds(text: &str) -> Result<RangeInclusive<u64>, InvalidValue> {
    let wrong = || InvalidValue::new(format_args!("{text:?} is not FIRST..LAST, as in 1..1000"));
    let (first, last) = text.split_once("..").ok_or_else(wrong)?;
    let number = |text: &str| text.trim_start_matches('=').parse::<u64>().map_err(|_| wrong());
    let (first, last) = (number(first)?, number(last)?);
    if first > last || last == u64::MAX { Err(wrong()) } else { Ok(first..=last) }
}

fn minutes(text: &str) -> Result<f64, InvalidValue> {
    let minutes: f64 =
        text.parse().map_err(|_| InvalidValue::new(format_args!("{text:?} is not a number of minutes")))?;
    if (0.5..=120.0).contains(&minutes) { Ok(minutes) } else { Err(InvalidValue::new("from 0.5 to 120 minutes")) }
}

fn nodes(text: &str) -> Result<usize, InvalidValue> {
    let (least, most) = (chaos_fleet::NODES_MIN, chaos_fleet::NODES_MAX);
    let number = text.parse().ok().filter(|number| (least..=most).contains(number));
    number.ok_or_else(|| InvalidValue::new(format_args!("from {least} to {most} nodes")))
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for a wrong schedule; [`Failure::Unsuccessful`] if an invariant was violated.
pub(crate) fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    let workload = args.workload.workload(extensions)?;
    missions_in_hospital(&workload)?;
    let chaos = Chaos { args, workload };
    match chaos.args.seed {
        _ if chaos.args.mutants => run_hunts(&chaos.args),
        _ if chaos.args.scoreboard => score(&chaos.args),
        Some(seed) => one(&chaos, seed),
        None => many(&chaos),
    }
}

/// The flags, and the files that they name.
struct Chaos {
    args: Args,
    workload: Workload,
}

impl Chaos {
    fn order(&self, seed: u64) -> RunConfig {
        let args = &self.args;
        RunConfig {
            seed,
            nodes: args.nodes,
            minutes: args.minutes,
            closed: !args.open && args.mutant.is_none_or(Mutant::needs_closed_fleet),
            mutant: args.mutant,
            workload: self.workload.clone(),
        }
    }

    fn generated(&self, seed: u64) -> Schedule {
        let args = &self.args;
        let kinds = if args.faults.is_empty() { &FaultKind::FAULTS[..] } else { &args.faults };
        let schedule = generate(seed, &ChaosFleet::of(args.nodes), args.minutes, kinds);
        schedule.requesting(self.workload.own_missions())
    }
}

impl Args {
    fn jobs(&self) -> usize {
        self.jobs.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, Into::into)).max(1)
    }

    /// Returns the flag that, with the seed, reproduces the schedule.
    fn faults_flag(&self) -> String {
        let names: Vec<_> = self.faults.iter().map(|kind| kind.name()).collect();
        if names.is_empty() { String::new() } else { format!(" --faults {}", names.join(",")) }
    }

    /// Prints text for people: never between the lines of JSON, which programs read.
    fn print(&self, text: impl Display) -> Result<(), Failure> {
        if self.json {
            output::note(text);
            return Ok(());
        }
        output::line(text)
    }

    /// Returns the flags of a run besides its seed and its schedule, where they differ from the
    /// default.
    fn flags(&self) -> String {
        let mut flags = String::new();
        if self.minutes != 5.0 {
            flags.push_str(&format!(" --minutes {}", self.minutes));
        }
        if self.nodes != 7 {
            flags.push_str(&format!(" --nodes {}", self.nodes));
        }
        if let Some(mutant) = self.mutant {
            flags.push_str(&format!(" --mutant {mutant}"));
        }
        for flag in self.workload.as_given() {
            flags.push(' ');
            flags.push_str(&flag);
        }
        flags
    }
}

/// Hunts every injected bug.
fn run_hunts(args: &Args) -> Result<(), Failure> {
    let bar = ProgressBar::new_spinner();
    let mut rows = vec![["mutant", "must be found by seed", "found at seed", "by"].map(str::to_owned).to_vec()];
    let mut missed = vec![];
    for wanted in MUTANT_CHECKS {
        let mut runs = 0;
        let found = check_mutant(wanted, args.jobs(), || {
            runs += 1;
            bar.set_message(format!("{}: {runs} runs, up to seed {}", wanted.mutant, wanted.last_seed));
            bar.tick();
        });
        if args.json {
            output::json(&found)?;
        }
        if found.seed.is_none() {
            missed.push(found.mutant);
        }
        let or = |text: Option<String>| text.unwrap_or_else(|| "not found".to_owned());
        let seed = or(found.seed.map(|seed| seed.to_string()));
        rows.push(vec![found.mutant.to_owned(), found.last_seed.to_string(), seed, or(found.invariant)]);
    }
    bar.finish_and_clear();
    if !args.json {
        output::line(output::table(&rows))?;
    }
    if missed.is_empty() { Ok(()) } else { Err(Failure::Unsuccessful(format!("not found: {}", missed.join(", ")))) }
}

/// Computes the scoreboard.
fn score(args: &Args) -> Result<(), Failure> {
    let kinds = scoreboard::kinds();
    let bar = ProgressBar::new(args.runs * kinds.len() as u64);
    bar.set_style(ProgressStyle::with_template("{bar:40} {pos}/{len} runs  {msg}").expect("the template is sound"));
    let mut rows = vec![];
    for (name, kinds) in kinds {
        bar.set_message(name);
        rows.push(scoreboard::run_row(name, &kinds, args.runs, args.minutes, args.jobs(), || bar.inc(1)));
    }
    bar.finish_and_clear();
    if let Some(file) = &args.save {
        let text = serde_json::to_string_pretty(&rows).expect("a row is plain data") + "\n";
        std::fs::write(file, text)
            .map_err(|problem| Failure::Unsuccessful(format!("{} was not written: {problem}", file.display())))?;
    }
    if args.json {
        output::json(&rows)?;
    } else {
        output::line(markdown(&rows).trim_end())?;
    }
    let broken: Vec<_> = rows.iter().filter(|row| !row.violations.is_empty()).map(|row| row.fault).collect();
    if broken.is_empty() {
        Ok(())
    } else {
        Err(Failure::Unsuccessful(format!("invariants violated under: {}", broken.join(", "))))
    }
}

fn one(chaos: &Chaos, seed: u64) -> Result<(), Failure> {
    let args = &chaos.args;
    let schedule = match &args.schedule {
        Some(file) => read(file, &ChaosFleet::of(args.nodes), &chaos.workload)?,
        None => chaos.generated(seed),
    };
    if args.verbose {
        args.print(format_args!("{schedule}"))?;
    }
    let order = chaos.order(seed);
    let mut waiting = Progress::on_terminal();
    waiting.show(format_args!("seed {seed}: {} minutes of a fleet's time", args.minutes));
    let outcome = run_quietly(&order, &schedule);
    waiting.clear();
    if args.json {
        output::json(&outcome)?;
    }
    match &outcome.violation {
        Some(violation) => broken(args, &order, &schedule, violation, args.schedule.is_none()),
        None if args.json => Ok(()),
        None => output::line(summary(&outcome)),
    }
}

fn many(chaos: &Chaos) -> Result<(), Failure> {
    let args = &chaos.args;
    let seeds = args.seeds.end() - args.seeds.start() + 1;
    let bar = ProgressBar::new(seeds);
    let style = "{bar:40} {pos}/{len} seeds, {per_sec}, {eta} left  {msg}";
    bar.set_style(ProgressStyle::with_template(style).expect("the template is sound"));
    let began = Instant::now();
    let mut totals = Totals::default();
    let many = SeedSweep {
        seeds: args.seeds.clone(),
        jobs: args.jobs(),
        config: &|seed| (chaos.order(seed), chaos.generated(seed)),
    };
    let mut printed = Ok(());
    let found = many.run(|outcome| {
        bar.inc(1);
        totals.add(outcome);
        let missions = count(totals.acknowledged, "mission", "missions");
        bar.set_message(format!("{missions}, {}", count(totals.takeovers.len(), "takeover", "takeovers")));
        if args.json && printed.is_ok() {
            printed = output::json(outcome);
        }
    });
    bar.finish_and_clear();
    printed?;
    if let Some(outcome) = found
        && let Some(violation) = &outcome.violation
    {
        return broken(args, &chaos.order(outcome.seed), &chaos.generated(outcome.seed), violation, true);
    }
    let seconds = began.elapsed().as_secs_f64();
    let rate = seeds as f64 * 60.0 / seconds;
    if !args.json {
        output::line(format_args!(
            "{} held: {} acknowledged, none lost ({} completed, {} failed with a cause, {} withdrawn)\n\
             {}; {}{}; converged{} after the last fault\n\
             {}\n\
             {:.1} simulated hours in {seconds:.1} s, {rate:.0} seeds a minute",
            count(seeds, "seed", "seeds"),
            count(totals.acknowledged, "mission", "missions"),
            totals.completed,
            totals.failed,
            totals.canceled,
            count(totals.promised, "role promised", "roles promised"),
            count(totals.takeovers.len(), "takeover", "takeovers"),
            median_and_p99(&totals.takeovers, 1.0, "ms"),
            median_and_p99(&totals.converged, 1000.0, "s"),
            totals.coverage,
            totals.simulated_ms as f64 / 3_600_000.0,
        ))?;
        if chaos.workload.own_missions().next().is_some() {
            output::line(totals.causes_text())?;
        }
    }
    Ok(())
}

/// Formats the median and the 99th percentile of times in milliseconds.
fn median_and_p99(times_ms: &[u64], unit_ms: f64, unit: &str) -> String {
    Percentiles::of_ms(times_ms).map_or(String::new(), |Percentiles { p50, p99, .. }| {
        format!(" p50 {:.1} {unit}, p99 {:.1} {unit}", p50 / unit_ms, p99 / unit_ms)
    })
}

#[derive(Default)]
struct Totals {
    acknowledged: usize,
    completed: usize,
    failed: usize,
    canceled: usize,
    promised: usize,
    takeovers: Vec<u64>,
    converged: Vec<u64>,
    simulated_ms: u64,
    causes: BTreeMap<String, usize>,
    coverage: Coverage,
}

impl Totals {
    fn add(&mut self, outcome: &RunOutcome) {
        let counters = &outcome.counters;
        self.acknowledged += counters.acknowledged;
        self.completed += counters.completed;
        self.failed += counters.failed + counters.needs_intervention;
        self.canceled += counters.canceled;
        self.promised += counters.promised;
        self.takeovers.extend(&counters.takeovers_ms);
        self.converged.extend(counters.converged_ms);
        self.simulated_ms += counters.simulated_ms;
        self.coverage.merge(&counters.coverage);
        for cause in &counters.causes {
            *self.causes.entry(cause.clone()).or_default() += 1;
        }
    }

    /// Lists the causes of failed missions, the most frequent first.
    fn causes_text(&self) -> String {
        let mut causes: Vec<_> = self.causes.iter().collect();
        causes.sort_by_key(|(_, times)| std::cmp::Reverse(**times));
        let lines = causes.iter().take(CAUSES_MAX).map(|(cause, times)| format!("\n  {times} × {cause}"));
        if causes.is_empty() { "no mission failed".to_owned() } else { format!("failed:{}", lines.collect::<String>()) }
    }
}

fn summary(outcome: &RunOutcome) -> String {
    let counters = &outcome.counters;
    format!(
        "seed {} held: {} acknowledged, none lost ({} completed, {} failed with a cause, {} withdrawn); {}; \
         digest {}\n{}",
        outcome.seed,
        count(counters.acknowledged, "mission", "missions"),
        counters.completed,
        counters.failed,
        counters.canceled,
        count(counters.takeovers_ms.len(), "takeover", "takeovers"),
        outcome.digest,
        counters.coverage,
    )
}

/// Prints the violation, shrinks the schedule, and prints the command that repeats it.
fn broken(
    args: &Args,
    order: &RunConfig,
    schedule: &Schedule,
    violation: &Violation,
    cut_down: bool,
) -> Result<(), Failure> {
    let at = violation.at_ms as f64 / 1000.0;
    args.print(format_args!("seed {}: {} is violated at {at:.3} s", order.seed, violation.invariant))?;
    args.print(format_args!("  {}\n", violation.reason))?;
    let (smallest, last) = if cut_down {
        let bar = ProgressBar::new_spinner();
        let mut last = violation.clone();
        let smallest = shrink(schedule, SHRINK_TRIES, |tried| {
            bar.set_message(format!("shrinking the schedule: {}", count(tried.steps.len(), "step", "steps")));
            bar.tick();
            let again = run_quietly(order, tried).violation.filter(|again| again.invariant == violation.invariant);
            let fails = again.is_some();
            last = again.unwrap_or_else(|| last.clone());
            fails
        });
        bar.finish_and_clear();
        (smallest, last)
    } else {
        (schedule.clone(), violation.clone())
    };
    args.print(format_args!("Events before:\n{}\n", last.events_before.join("\n")))?;
    let (left, all) = (smallest.steps.len(), schedule.steps.len());
    args.print(format_args!("Smallest schedule found ({left} of {all} steps; times in seconds):\n{smallest}"))?;
    let repeat = format!("consort-lab chaos --seed {}{}", order.seed, args.flags());
    if cut_down {
        let file = format!("chaos-{}.json", order.seed);
        let text = serde_json::to_string_pretty(&smallest).expect("a schedule is plain data");
        match std::fs::write(&file, text) {
            Ok(()) => args.print(format_args!("Repeat with these steps only:\n  {repeat} --schedule {file}"))?,
            Err(problem) => output::note(format_args!("{file} was not written: {problem}")),
        }
        args.print(format_args!("Repeat with all steps:\n  {repeat}{}", args.faults_flag()))?;
    }
    Err(Failure::Unsuccessful(format!("{} is violated for seed {}", violation.invariant, order.seed)))
}

/// Runs a schedule on a thread that does not print panics.
fn run_quietly(order: &RunConfig, schedule: &Schedule) -> RunOutcome {
    let again = (order.clone(), schedule.clone());
    let many = SeedSweep { seeds: order.seed..=order.seed, jobs: 1, config: &move |_| again.clone() };
    let mut outcome = None;
    many.run(|told| outcome = Some(told.clone()));
    outcome.expect("a run has an outcome")
}

fn read(file: &Path, cast: &ChaosFleet, workload: &Workload) -> Result<Schedule, Failure> {
    let wrong = |problem: String| Failure::Usage(format!("{}: {problem}", file.display()));
    let text = std::fs::read_to_string(file).map_err(|problem| wrong(problem.to_string()))?;
    let schedule: Schedule =
        serde_json::from_str(&text).map_err(|problem| wrong(format!("not a schedule: {problem}")))?;
    schedule.check(cast, workload).map_err(|problem| wrong(problem.to_string()))?;
    Ok(schedule.in_order())
}
