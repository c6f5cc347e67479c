//! `consort chaos`: whole fleets under generated faults, watched at every step.

use crate::exit::Failure;
use crate::output::{self, Progress};
use clap::{ArgGroup, Args as ClapArgs};
use consort_protocol::count::count;
use consort_protocol::mutants::{self, Mutant};
use consort_tests::chaos::mutants::{MUTANT_CHECKS, check_mutant};
use consort_tests::chaos::scoreboard::{self, markdown};
use consort_tests::chaos::seed_sweep::percentiles;
use consort_tests::chaos::{
    ChaosFleet, FaultKind, RunConfig, RunOutcome, Schedule, SeedSweep, Violation, chaos_fleet, generate, shrink,
};
use indicatif::{ProgressBar, ProgressStyle};
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The ways of using it, each with the flags that go with it: shown whenever others were given.
const USAGE: &str = "\
consort chaos [--seeds FIRST..LAST] [--minutes MINUTES] [--nodes NODES] [--faults KIND,…] [--mutant NAME]
                     [--jobs JOBS] [--json]
       consort chaos --seed SEED [--schedule FILE | --faults KIND,…] [--minutes MINUTES] [--nodes NODES]
                     [--mutant NAME] [--verbose] [--json]
       consort chaos --scoreboard [--runs N] [--minutes MINUTES] [--save FILE] [--jobs JOBS] [--json]
       consort chaos --mutants [--jobs JOBS] [--json]";

/// Most runs that are made to cut a schedule down.
const SHRINK_TRIES: usize = 300;

/// Runs whole fleets under generated faults, and checks at every step that nothing acknowledged is lost and no role is
/// held twice.
///
/// Each seed is one run: a fleet in this process, on virtual time, with requests of clients and faults drawn from the
/// seed. Nodes crash and come back (with all of their disk, without the writes that were not acknowledged, or with an
/// empty one), stand still, are parted; links lose, repeat, reorder and delay; disks are slow, clocks drift, batteries run
/// down, skills fail, panic and hang; the coordinator is killed at any moment. After 70 % of the time all faults lift, and
/// the fleet has to come to rest: one coordinator, every mission at an end, everybody known to everybody.
///
/// It stops at the first seed for which something does not hold. It then says what, what happened before, and which of the
/// faults it takes, having left out whatever could be spared; and how to repeat it. With --json all of that is said on the
/// standard error.
#[derive(Debug, ClapArgs)]
#[command(
    override_usage = USAGE,
    group = ArgGroup::new("what").args(["seeds", "seed", "mutants", "scoreboard"]),
    after_long_help = "\
Examples:
  consort chaos --seeds 1..1000                         # the first thousand seeds, on all cores
  consort chaos --seed 4711 --verbose                   # one of them, with all that is done in it
  consort chaos --seed 4711 --schedule chaos-4711.json  # a violation again, with what was written beside it
  consort chaos --faults partition,coordinator-crash    # some kinds of faults alone
  consort chaos --scoreboard --runs 50 --save score.json  # how the fleet fares under each kind of fault

  # whether deliberate mistakes are found, and by what
  cargo run --release --features mutants -- chaos --mutants

The same seed, nodes, minutes and faults give the same run, to the byte, on any machine.

Exit codes: 0 everything held; 1 something did not; 2 the flags or the schedule are wrong."
)]
pub struct Args {
    /// Which seeds, the last included
    #[arg(long, value_name = "FIRST..LAST", value_parser = seeds, default_value = "1..100")]
    seeds: RangeInclusive<u64>,
    /// One seed alone
    #[arg(long)]
    seed: Option<u64>,
    // A flag that another one requires is let pass by clap beside what excludes that one, unless it excludes it itself.
    /// What is done, from a file (JSON), instead of what follows from the seed
    #[arg(long, value_name = "FILE", requires = "seed", conflicts_with_all = ["seeds", "mutants", "scoreboard"])]
    schedule: Option<PathBuf>,
    /// Simulated minutes of each run
    #[arg(long, default_value_t = 5.0, value_parser = minutes, conflicts_with = "mutants")]
    minutes: f64,
    /// Nodes of the fleet: an arm, and carriers and stations in equal parts; the host of the world comes on top
    #[arg(long, default_value_t = 7, value_parser = nodes, conflicts_with_all = ["mutants", "scoreboard"])]
    nodes: usize,
    /// Runs at the same time [default: one on each core]
    #[arg(long, conflicts_with = "seed")]
    jobs: Option<usize>,
    /// The kinds of faults [default: all]
    #[arg(long, value_name = "KIND,…", value_delimiter = ',', conflicts_with_all = ["schedule", "mutants", "scoreboard"])]
    faults: Vec<FaultKind>,
    /// Have the fleet make a deliberate mistake (in programs built with the feature `mutants`)
    #[arg(long, value_name = "NAME", conflicts_with_all = ["mutants", "scoreboard"])]
    mutant: Option<Mutant>,
    /// Look for every deliberate mistake, and print how many seeds it took and what found it
    #[arg(long)]
    mutants: bool,
    /// Print how the fleet fares under each kind of fault, as a table (Markdown, or JSON with --json)
    #[arg(long)]
    scoreboard: bool,
    /// Write the scoreboard to a file, too (JSON)
    #[arg(long, value_name = "FILE", requires = "scoreboard", conflicts_with_all = ["seeds", "seed", "mutants"])]
    save: Option<PathBuf>,
    /// Runs for each line of the scoreboard
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..), requires = "scoreboard", conflicts_with_all = ["seeds", "seed", "mutants"])]
    runs: u64,
    /// Print what is done in the run
    #[arg(long, requires = "seed", conflicts_with_all = ["seeds", "mutants", "scoreboard"])]
    verbose: bool,
    /// Print JSON alone on the standard output: a line for each run or each deliberate mistake, one for the scoreboard
    #[arg(long)]
    json: bool,
}

fn seeds(text: &str) -> Result<RangeInclusive<u64>, String> {
    let wrong = || format!("{text:?} is not FIRST..LAST, as in 1..1000");
    let (first, last) = text.split_once("..").ok_or_else(wrong)?;
    let number = |text: &str| text.trim_start_matches('=').parse::<u64>().map_err(|_| wrong());
    let (first, last) = (number(first)?, number(last)?);
    if first > last || last == u64::MAX { Err(wrong()) } else { Ok(first..=last) }
}

fn minutes(text: &str) -> Result<f64, String> {
    let minutes: f64 = text.parse().map_err(|_| format!("{text:?} is not a number of minutes"))?;
    if (0.5..=120.0).contains(&minutes) { Ok(minutes) } else { Err("from 0.5 to 120 minutes".to_owned()) }
}

fn nodes(text: &str) -> Result<usize, String> {
    let (least, most) = (chaos_fleet::NODES_MIN, chaos_fleet::NODES_MAX);
    let number = text.parse().ok().filter(|number| (least..=most).contains(number));
    number.ok_or_else(|| format!("from {least} to {most} nodes"))
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for a wrong schedule; [`Failure::Unsuccessful`] if something did not hold.
pub fn run(args: &Args) -> Result<(), Failure> {
    // Whether this program can make mistakes is found out here, and not on each thread.
    mutants::activate(args.mutant).map_err(|problem| Failure::Usage(problem.to_string()))?;
    match args.seed {
        _ if args.mutants => hunts(args),
        _ if args.scoreboard => score(args),
        Some(seed) => one(args, seed),
        None => many(args),
    }
}

impl Args {
    fn order(&self, seed: u64) -> RunConfig {
        RunConfig { seed, nodes: self.nodes, minutes: self.minutes, closed: false }
    }

    fn generated(&self, seed: u64) -> Schedule {
        let kinds = if self.faults.is_empty() { &FaultKind::FAULTS[..] } else { &self.faults };
        generate(seed, &ChaosFleet::of(self.nodes), self.minutes, kinds)
    }

    fn jobs(&self) -> usize {
        self.jobs.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, Into::into)).max(1)
    }

    /// The flag from which, with the seed, a schedule follows.
    fn faults_flag(&self) -> String {
        let names: Vec<_> = self.faults.iter().map(|kind| kind.name()).collect();
        if names.is_empty() { String::new() } else { format!(" --faults {}", names.join(",")) }
    }

    /// Says something to people: never between the lines of JSON, which programs read.
    fn tell(&self, text: impl Display) -> Result<(), Failure> {
        if self.json {
            output::note(text);
            return Ok(());
        }
        output::line(text)
    }

    /// Makes the chosen mistake on the current thread.
    fn make_mistakes(&self) {
        mutants::activate(self.mutant).expect("it was chosen before");
    }

    /// The flags that a run depends on besides its seed and its schedule, where they are not the default.
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
        flags
    }
}

/// Looks for every deliberate mistake.
fn hunts(args: &Args) -> Result<(), Failure> {
    let bar = ProgressBar::new_spinner();
    let mut rows = vec![["mutant", "must be found within", "found by seed", "by"].map(str::to_owned).to_vec()];
    let mut missed = vec![];
    for wanted in MUTANT_CHECKS {
        let mut runs = 0;
        let found = check_mutant(wanted, args.jobs(), || {
            runs += 1;
            bar.set_message(format!("{}: {runs} of {} seeds", wanted.mutant, wanted.seeds_max));
            bar.tick();
        })
        .map_err(|problem| Failure::Usage(problem.to_string()))?;
        if args.json {
            json(&found)?;
        }
        if found.seeds.is_none() {
            missed.push(found.mutant);
        }
        let or = |text: Option<String>| text.unwrap_or_else(|| "not found".to_owned());
        let seeds = or(found.seeds.map(|seeds| seeds.to_string()));
        rows.push(vec![found.mutant.to_owned(), found.within.to_string(), seeds, or(found.invariant)]);
    }
    bar.finish_and_clear();
    if !args.json {
        output::line(output::table(&rows))?;
    }
    if missed.is_empty() { Ok(()) } else { Err(Failure::Unsuccessful(format!("not found: {}", missed.join(", ")))) }
}

/// Fills in the scoreboard.
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
        json(&rows)?;
    } else {
        output::line(markdown(&rows).trim_end())?;
    }
    let broken: Vec<_> = rows.iter().filter(|row| !row.violations.is_empty()).map(|row| row.fault).collect();
    if broken.is_empty() {
        Ok(())
    } else {
        Err(Failure::Unsuccessful(format!("something did not hold: {}", broken.join(", "))))
    }
}

fn one(args: &Args, seed: u64) -> Result<(), Failure> {
    let schedule = match &args.schedule {
        Some(file) => read(file, &ChaosFleet::of(args.nodes))?,
        None => args.generated(seed),
    };
    if args.verbose {
        args.tell(format_args!("{schedule}"))?;
    }
    let order = args.order(seed);
    let mut waiting = Progress::on_terminal();
    waiting.show(format_args!("seed {seed}: {} minutes of a fleet's time", args.minutes));
    let outcome = in_quiet(args, &order, &schedule);
    waiting.clear();
    if args.json {
        json(&outcome)?;
    }
    match &outcome.violation {
        Some(violation) => broken(args, &order, &schedule, violation, args.schedule.is_none()),
        None if args.json => Ok(()),
        None => output::line(summary(&outcome)),
    }
}

fn many(args: &Args) -> Result<(), Failure> {
    let seeds = args.seeds.end() - args.seeds.start() + 1;
    let bar = ProgressBar::new(seeds);
    let style = "{bar:40} {pos}/{len} seeds, {per_sec}, {eta} left  {msg}";
    bar.set_style(ProgressStyle::with_template(style).expect("the template is sound"));
    let began = Instant::now();
    let mut totals = Totals::default();
    let many = SeedSweep {
        seeds: args.seeds.clone(),
        jobs: args.jobs(),
        config: &|seed| (args.order(seed), args.generated(seed)),
        prepare: &|| args.make_mistakes(),
    };
    let mut printed = Ok(());
    let found = many.run(|outcome| {
        bar.inc(1);
        totals.add(outcome);
        let missions = count(totals.acknowledged, "mission", "missions");
        bar.set_message(format!("{missions}, {}", count(totals.takeovers.len(), "takeover", "takeovers")));
        if args.json && printed.is_ok() {
            printed = json(outcome);
        }
    });
    bar.finish_and_clear();
    printed?;
    if let Some(outcome) = found
        && let Some(violation) = &outcome.violation
    {
        return broken(args, &args.order(outcome.seed), &args.generated(outcome.seed), violation, true);
    }
    let seconds = began.elapsed().as_secs_f64();
    let rate = seeds as f64 * 60.0 / seconds;
    if !args.json {
        output::line(format_args!(
            "{} held: {} acknowledged, none lost ({} completed, {} failed with a cause, {} withdrawn)\n\
             {}{}; converged{} after the last fault\n\
             {:.1} simulated hours in {seconds:.1} s, {rate:.0} seeds a minute",
            count(seeds, "seed", "seeds"),
            count(totals.acknowledged, "mission", "missions"),
            totals.completed,
            totals.failed,
            totals.canceled,
            count(totals.takeovers.len(), "takeover", "takeovers"),
            middle_and_worst(&totals.takeovers, 1.0, "ms"),
            middle_and_worst(&totals.converged, 1000.0, "s"),
            totals.simulated_ms as f64 / 3_600_000.0,
        ))?;
    }
    Ok(())
}

/// The middle of some times in milliseconds and the one that only one in a hundred exceeds, in words.
fn middle_and_worst(times_ms: &[u64], unit_ms: f64, unit: &str) -> String {
    let in_units = |ms: u64| ms as f64 / unit_ms;
    percentiles(times_ms).map_or(String::new(), |(p50, p99)| {
        format!(" p50 {:.1} {unit}, p99 {:.1} {unit}", in_units(p50), in_units(p99))
    })
}

#[derive(Default)]
struct Totals {
    acknowledged: usize,
    completed: usize,
    failed: usize,
    canceled: usize,
    takeovers: Vec<u64>,
    converged: Vec<u64>,
    simulated_ms: u64,
}

impl Totals {
    fn add(&mut self, outcome: &RunOutcome) {
        let tally = &outcome.tally;
        self.acknowledged += tally.acknowledged;
        self.completed += tally.completed;
        self.failed += tally.failed + tally.rescues;
        self.canceled += tally.canceled;
        self.takeovers.extend(&tally.takeovers_ms);
        self.converged.extend(tally.converged_ms);
        self.simulated_ms += tally.simulated_ms;
    }
}

fn summary(outcome: &RunOutcome) -> String {
    let tally = &outcome.tally;
    format!(
        "seed {} held: {} acknowledged, none lost ({} completed, {} failed with a cause, {} withdrawn); {}; \
         digest {}",
        outcome.seed,
        count(tally.acknowledged, "mission", "missions"),
        tally.completed,
        tally.failed,
        tally.canceled,
        count(tally.takeovers_ms.len(), "takeover", "takeovers"),
        outcome.digest,
    )
}

/// Says what did not hold, cuts the schedule down, and says how to repeat it.
fn broken(
    args: &Args,
    order: &RunConfig,
    schedule: &Schedule,
    violation: &Violation,
    cut_down: bool,
) -> Result<(), Failure> {
    let at = violation.at_ms as f64 / 1000.0;
    args.tell(format_args!("seed {}: {} does not hold at {at:.3} s", order.seed, violation.invariant))?;
    args.tell(format_args!("  {}\n", violation.why))?;
    let (smallest, last) = if cut_down {
        let bar = ProgressBar::new_spinner();
        let mut last = violation.clone();
        let smallest = shrink(schedule, SHRINK_TRIES, |tried| {
            bar.set_message(format!("leaving out what does not matter: {}", count(tried.steps.len(), "step", "steps")));
            bar.tick();
            let again = in_quiet(args, order, tried).violation.filter(|again| again.invariant == violation.invariant);
            let fails = again.is_some();
            last = again.unwrap_or_else(|| last.clone());
            fails
        });
        bar.finish_and_clear();
        (smallest, last)
    } else {
        (schedule.clone(), violation.clone())
    };
    args.tell(format_args!("What happened before:\n{}\n", last.tale.join("\n")))?;
    let (left, all) = (smallest.steps.len(), schedule.steps.len());
    args.tell(format_args!("What it takes ({left} of {all} steps; times in seconds):\n{smallest}"))?;
    let repeat = format!("consort chaos --seed {}{}", order.seed, args.flags());
    if cut_down {
        let file = format!("chaos-{}.json", order.seed);
        let text = serde_json::to_string_pretty(&smallest).expect("a schedule is plain data");
        match std::fs::write(&file, text) {
            Ok(()) => args.tell(format_args!("Again, with these steps alone:\n  {repeat} --schedule {file}"))?,
            Err(problem) => output::note(format_args!("{file} was not written: {problem}")),
        }
        args.tell(format_args!("Again, with all of them:\n  {repeat}{}", args.faults_flag()))?;
    }
    Err(Failure::Unsuccessful(format!("{} does not hold for seed {}", violation.invariant, order.seed)))
}

/// A run on a thread where its own panics are not printed.
fn in_quiet(args: &Args, order: &RunConfig, schedule: &Schedule) -> RunOutcome {
    let again = (order.clone(), schedule.clone());
    let many = SeedSweep {
        seeds: order.seed..=order.seed,
        jobs: 1,
        config: &move |_| again.clone(),
        prepare: &|| args.make_mistakes(),
    };
    let mut outcome = None;
    many.run(|told| outcome = Some(told.clone()));
    outcome.expect("a run has an outcome")
}

fn read(file: &Path, cast: &ChaosFleet) -> Result<Schedule, Failure> {
    let wrong = |problem: String| Failure::Usage(format!("{}: {problem}", file.display()));
    let text = std::fs::read_to_string(file).map_err(|problem| wrong(problem.to_string()))?;
    let schedule: Schedule =
        serde_json::from_str(&text).map_err(|problem| wrong(format!("not a schedule: {problem}")))?;
    schedule.check(cast).map_err(wrong)?;
    Ok(schedule.in_order())
}

fn json(value: &impl serde::Serialize) -> Result<(), Failure> {
    output::line(serde_json::to_string(value).expect("an outcome is plain data"))
}
