//! `consort-lab experiment shift`: many missions at a time.

use super::named_value::named;
use clap::Args as ClapArgs;
use consort_evaluation::shift::{PolicyFigures, ShiftFigures, ShiftPolicy};
use consort_evaluation::stats::MeanEstimate;
use consort_nodes::command::flag_values::InvalidValue;
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use consort_tests::chaos::{SHIFT_ARMS, SHIFT_CARRIERS, Violation, run_shift as run_shift_under_faults};
use consort_tests::shift::{CHARGERS, ShiftSetup, requests_per_hour, run as run_shift};
use consort_text::count;
use serde::Serialize;
use std::cell::RefCell;

/// Least speed with faults: the limits of invariants assume that a robot drives to a charger within a minute of node
/// time.
const SPEED_MIN_WITH_FAULTS: u32 = 2;

/// What `--hours` and `--faults` lack: all requests at once leave no time for faults.
const NEEDS_RATE: &str = "needs a rate of requests: --per-hour or --load";

/// Measures a fleet during a shift, under policies of allocation: many missions at a time, on virtual time
///
/// Robots carry lab samples from nurses in random rooms of the hospital to the arms in the laboratory. The policies run
/// with the same requests.
///
/// Policies: with `instantaneous` a mission starts when all its robots are free. With `consort`, the policy of this
/// project, it starts with a free carrier; the arm is promised to it, and gets the role when the sample has arrived.
/// The other policies assign carriers in advance: `tessi` inserts each request at once in the timeline of the carrier
/// that ends first with it, and `oracle` plans all requests before the first (regret insertion and a large
/// neighbourhood search). The oracle is as good as its method and its estimates: it is no bound.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab experiment shift                                # 12 robots, one arm, 48 missions at once
  consort-lab experiment shift --missions 100 --per-hour 60 --json
  consort-lab experiment shift --robots 20 --arms 2 --policies consort
  consort-lab experiment shift --robots 6 --arms 3 --chargers 3 --hours 24 --per-hour 84 --repetitions 5 \\
    --policies instantaneous,tessi,consort,oracle             # a day, with confidence intervals
  consort-lab experiment shift --robots 20 --arms 3 --chargers 6 --hours 24 --load 0.7 --speed 10 --policies consort
  consort-lab experiment shift --robots 20 --arms 3 --chargers 6 --hours 24 --load 0.7 --speed 10 --policies consort --faults

With --json: an object for each policy, with its runs, the means of the runs with confidence intervals of 95 %, and the mean
differences to the first policy. Times are in seconds of world time; wall_s is the duration of the run. A mission is late if it
is completed more than half an hour after its request. energy is the discharge of all carriers, in full batteries.

Missions that are not completed are in no mean: compare the times of policies only if each completes all missions. Auctions,
leases and the terms of promises last for seconds of node time, so compare policies at --speed 1.

The load is the time that the requested missions take their carriers, as a share of the time that the carriers have and do not
charge, by the estimates of the robots.

With --faults the object has the number of faults and the violation, too.

The same seed gives the same figures on any machine, except wall_s.

Exit codes: 0 success, even if missions are not completed; 1 an invariant is violated; 2 the flags are wrong.")]
pub(super) struct Args {
    /// Number of robots that carry samples
    #[arg(long, value_name = "N", default_value_t = 12,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=200))]
    robots: usize,
    /// Number of arms in the laboratory
    #[arg(long, value_name = "N", default_value_t = 1,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=20))]
    arms: usize,
    /// Number of chargers, which the carriers use by themselves; without chargers no battery is charged
    #[arg(long, value_name = "N", default_value_t = 0,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(0..=CHARGERS.len() as u64))]
    chargers: usize,
    /// Number of missions
    #[arg(long, value_name = "N", default_value_t = 48, conflicts_with = "hours",
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=10_000))]
    missions: usize,
    /// Mean number of requests per hour, as a Poisson process [default: all requests at once]
    #[arg(long, value_name = "N", value_parser = rate)]
    per_hour: Option<f64>,
    /// Offered work, as a share of the carriers' time, in place of a number of requests per hour
    #[arg(long, value_name = "SHARE", value_parser = load, conflicts_with = "per_hour")]
    load: Option<f64>,
    /// Hours of requests at this rate, in place of a number of missions
    #[arg(long, value_name = "HOURS", value_parser = hours)]
    hours: Option<f64>,
    /// Policies: instantaneous, tessi, consort, oracle. The first is compared with each other policy
    #[arg(long, value_name = "POLICY,…", value_delimiter = ',', default_values = ["instantaneous", "consort"],
        value_parser = policy)]
    policies: Vec<ShiftPolicy>,
    /// Runs of each policy, each with another seed
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1000))]
    repetitions: u64,
    /// World seconds per second of node time
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=60))]
    speed: u32,
    /// Seed of all random numbers of the first run
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Inject the faults of chaos while missions are requested, and check all invariants; with `consort` only
    #[arg(long)]
    faults: bool,
    /// Print a JSON object for each policy
    #[arg(long)]
    json: bool,
}

fn within(text: &str, least: f64, most: f64) -> Result<f64, InvalidValue> {
    let number = text.parse().ok().filter(|number: &f64| (least..=most).contains(number));
    number.ok_or_else(|| InvalidValue::new(format_args!("{text:?}, allowed is a number from {least} to {most}")))
}

fn rate(text: &str) -> Result<f64, InvalidValue> {
    within(text, 0.1, 100_000.0)
}

fn load(text: &str) -> Result<f64, InvalidValue> {
    within(text, 0.01, 2.0)
}

fn hours(text: &str) -> Result<f64, InvalidValue> {
    within(text, 0.1, 168.0)
}

fn policy(text: &str) -> Result<ShiftPolicy, InvalidValue> {
    named(text, &ShiftPolicy::ALL, ShiftPolicy::as_str)
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for hours without a rate, or for flags with which there are no faults;
/// [`Failure::Unsuccessful`] if an invariant is violated, or if the output cannot be written.
pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let setup = args.setup()?;
    if args.faults {
        args.check_faults()?;
    }
    if !args.json {
        output::line(HEADER)?;
    }
    if args.faults { run_with_faults(args, setup) } else { run_policies(args, setup) }
}

/// Figures of a policy under faults.
#[derive(Serialize)]
struct FiguresUnderFaults<'a> {
    #[serde(flatten)]
    figures: &'a PolicyFigures,
    /// Number of faults of all runs.
    faults: usize,
    /// The violated invariant, if any.
    violation: Option<&'a Violation>,
}

/// Runs shifts under faults until an invariant is violated.
fn run_with_faults(args: &Args, setup: ShiftSetup) -> Result<(), Failure> {
    let mut progress = Progress::on_terminal();
    let (mut runs, mut faults, mut violated) = (vec![], 0, None);
    for repetition in 0..args.repetitions {
        let seed = setup.seed.wrapping_add(repetition);
        progress.show(format_args!("seed {seed}: {} missions under faults", setup.missions));
        let shift = run_shift_under_faults(&ShiftSetup { seed, ..setup });
        faults += shift.faults;
        runs.push(shift.figures);
        if let Some(violation) = shift.violation {
            violated = Some((seed, violation));
            break;
        }
    }
    progress.clear();
    let figures = PolicyFigures::of(setup.policy, setup.per_hour, runs, None);
    let violation = violated.as_ref().map(|(_, violation)| violation);
    if args.json {
        output::json(&FiguresUnderFaults { figures: &figures, faults, violation })?;
    } else {
        output::line(row(&figures))?;
        let outcome = if violation.is_some() { "an invariant was violated" } else { "all invariants held" };
        output::line(format_args!("{}; {outcome}", count(faults, "fault", "faults")))?;
    }
    match violated {
        None => Ok(()),
        Some((seed, Violation { invariant, at_ms, reason, events_before })) => Err(Failure::Unsuccessful(format!(
            "seed {seed}: {invariant} was violated after {:.3} s: {reason}\n{}",
            at_ms as f64 / 1000.0,
            events_before.join("\n")
        ))),
    }
}

fn run_policies(args: &Args, setup: ShiftSetup) -> Result<(), Failure> {
    let mut first: Option<PolicyFigures> = None;
    for &policy in &args.policies {
        let progress = RefCell::new(Progress::on_terminal());
        let run = |repetition: u64| {
            let seed = setup.seed.wrapping_add(repetition);
            run_shift(ShiftSetup { policy, seed, ..setup }, |ended| {
                let (policy, missions) = (policy.as_str(), setup.missions);
                progress.borrow_mut().show(format_args!("{policy}, seed {seed}: {ended} of {missions} missions ended"));
            })
        };
        let runs = (0..args.repetitions).map(run).collect();
        drop(progress);
        let figures = PolicyFigures::of(policy, setup.per_hour, runs, first.as_ref());
        if args.json {
            output::json(&figures)?;
        } else {
            output::line(row(&figures))?;
        }
        first.get_or_insert(figures);
    }
    Ok(())
}

impl Args {
    /// Checks that a shift with these flags can have faults.
    fn check_faults(&self) -> Result<(), Failure> {
        let wrong = |what: String| Err(Failure::Usage(what));
        if self.policies != [ShiftPolicy::Consort] {
            return wrong("--faults needs --policies consort".to_owned());
        }
        if self.speed < SPEED_MIN_WITH_FAULTS {
            return wrong(format!("--speed {} with --faults; at least {SPEED_MIN_WITH_FAULTS} is needed", self.speed));
        }
        let most = [("--robots", self.robots, SHIFT_CARRIERS.len()), ("--arms", self.arms, SHIFT_ARMS.len())];
        match most.into_iter().find(|(_, count, most)| count > most) {
            Some((flag, count, most)) => wrong(format!("{flag} {count} with --faults; at most {most} are allowed")),
            None if self.per_hour.or(self.load).is_none() => wrong(format!("--faults {NEEDS_RATE}")),
            None => Ok(()),
        }
    }

    fn setup(&self) -> Result<ShiftSetup, Failure> {
        let &Args { robots, arms, chargers, missions, seed, .. } = self;
        let of_load = self.load.map(|load| requests_per_hour(robots, chargers, load));
        let per_hour = self.per_hour.or(of_load);
        let missions = match (self.hours, per_hour) {
            (None, _) => missions,
            (Some(hours), Some(per_hour)) => ((hours * per_hour).round() as usize).max(1),
            (Some(_), None) => {
                return Err(Failure::Usage(format!("--hours {NEEDS_RATE}")));
            }
        };
        let world_speed = f64::from(self.speed);
        Ok(ShiftSetup { robots, arms, chargers, missions, per_hour, world_speed, seed, ..ShiftSetup::default() })
    }
}

const HEADER: &str = "\
policy         missions        missions      start s                  completed after s        distance       energy      late  stranded  least   messages    wall
               completed       per hour      mean          p95        mean          p95        km             batteries                   charge              s";

fn row(figures: &PolicyFigures) -> String {
    let means = &figures.means;
    let sum = |of: fn(&ShiftFigures) -> usize| figures.runs.iter().map(of).sum::<usize>();
    let charge_min = figures.runs.iter().map(|run| run.charge_min).fold(1.0, f64::min);
    format!(
        "{:<14} {:<15} {:<13} {:<13} {:<10} {:<13} {:<10} {:<14} {:<11} {:<5} {:<9} {:<7} {:<11} {:.0}",
        figures.policy.as_str(),
        format!("{} of {}", figures.completed(), figures.missions()),
        text(means.per_hour, 1.0, 1),
        text(means.waiting_s, 1.0, 0),
        text(means.waiting_p95_s, 1.0, 0),
        text(means.completion_s, 1.0, 0),
        text(means.completion_p95_s, 1.0, 0),
        text(means.distance_m, 1e-3, 2),
        text(means.energy, 1.0, 1),
        sum(|run| run.late),
        sum(|run| run.stranded),
        format!("{:.0} %", charge_min * 100.0),
        format!("{:.0}", means.messages.mean),
        means.wall_s.mean,
    )
}

/// Returns a mean, and half of the width of its confidence interval.
fn text(of: MeanEstimate, scale: f64, decimals: usize) -> String {
    let mean = of.mean * scale;
    match of.interval {
        Some(interval) => format!("{mean:.decimals$} ±{:.decimals$}", (interval.high - interval.low) / 2.0 * scale),
        None => format!("{mean:.decimals$}"),
    }
}
