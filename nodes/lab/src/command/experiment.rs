//! `consort-lab experiment`: runs the published evaluation and others on whole fleets.

use super::named_value::named;
use super::workload_flags::WorkloadFlags;
use super::{energy, legs, shift};
use crate::design_file::DesignFile;
use crate::evaluation::{Evaluation, InputOverrides};
use clap::{Args as ClapArgs, Subcommand};
use consort_evaluation::calibration::{self, DEFAULT_QUANTILE, Observation};
use consort_evaluation::design::{self, Design};
use consort_evaluation::outcome::EndState;
use consort_evaluation::policy::Policy;
use consort_evaluation::report::{CalibrationGain, ReportFile, ReportHeader, report, tallies};
use consort_evaluation::results::{self, Treatment, TrialRow};
use consort_evaluation::seeds::derive;
use consort_evaluation::stats::Summary;
use consort_nodes::command::flag_values::InvalidValue;
use consort_nodes::config;
use consort_nodes::diagnostic::{Diagnostic, Diagnostics};
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use consort_protocol::mission::Domain;
use consort_skills::descriptor::Calibration;
use consort_skills::extensions::Extensions;
use consort_tests::experiment::{ExperimentSetup, TrialOutcome, run as run_trials, trials};
use consort_text::count;
use indicatif::{ProgressBar, ProgressStyle};
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Runs evaluations: scenarios by factors, policies against each other, on whole fleets
///
/// Each trial is a fleet in this process on virtual time: robots bid, the coordinator awards, and
/// robots carry out their plans in a simulated world. The policy selects the winner of the award;
/// everything else is the same for all policies. The same design gives the same rows, to the byte,
/// on any machine and with any number of jobs.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab experiment run published --out results
  consort-lab experiment calibrate published --out calibrated
  consort-lab experiment energy monday.mcap --out calibration.toml
  consort-lab experiment legs nav_legs.csv
  consort-lab experiment shift")]
pub(crate) struct Args {
    /// The command
    #[command(subcommand)]
    what: ExperimentCommand,
}

#[derive(Debug, Subcommand)]
enum ExperimentCommand {
    Run(RunArgs),
    Calibrate(CalibrateArgs),
    Energy(energy::Args),
    Legs(legs::Args),
    Shift(shift::Args),
}

/// Runs a design and writes rows (CSV), a report (Markdown, SVG) and statistics (JSON)
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab experiment run published --out results          # the published design: 1296 trials
  consort-lab experiment run published --out all --policies consort,mission-control,random,optimal --treatments calm,coordinator-killed
  consort-lab experiment run food --out food --jobs 4 --repetitions 2
  consort-lab experiment run my-design.toml --out results --legs legs.csv
  consort-lab experiment run my-design.toml --out results --domain domain.yaml --mission mission.yaml
  consort-lab experiment run published --out repeated --scenarios scenarios_81.json --map hospital_map.json --legs nav_legs.csv

Bundled designs: published, food, rounds (in sim_bridge/evaluation/designs/ of the source). A design file is TOML; an unknown key is
rejected with a list of the allowed keys.

Output: rows.csv, a row for each trial; tasks.csv, the estimated and actual cost of each task; report.md, for people, with
its figures; statistics.json, the same for programs.

Exit codes: 0 success; 1 a file could not be written; 2 the flags or the files are wrong.")]
struct RunArgs {
    #[command(flatten)]
    common: Common,
    /// The compared policies, in place of the design's; the first is compared with each other
    /// policy
    #[arg(long, value_name = "POLICY,…", value_delimiter = ',', value_parser = policy)]
    policies: Option<Vec<Policy>>,
    /// The disturbances of the fleet, in place of the design's: calm, coordinator-killed
    #[arg(long, value_name = "TREATMENT,…", value_delimiter = ',', value_parser = treatment)]
    treatments: Option<Vec<Treatment>>,
    /// Corrections to estimates, as written by `calibrate`
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
}

/// Learns the errors of estimates, and shows the gain of correcting them
///
/// Runs the design's scenarios to compare predicted with actual time and energy, by skill and by
/// leg. Writes the corrections to calibration.toml. Then runs the design twice, with the original
/// estimates and with the corrections (mean times, and an upper quantile for the battery), and
/// reports both.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab experiment calibrate published --out calibrated
  consort-lab experiment run published --out results --calibration calibrated/calibration.toml")]
struct CalibrateArgs {
    #[command(flatten)]
    common: Common,
    /// The share of drives for which the battery is to last
    #[arg(long, default_value_t = DEFAULT_QUANTILE, value_parser = share)]
    quantile: f64,
}

#[derive(Debug, ClapArgs)]
struct Common {
    /// The design: a file, or a bundled design
    #[arg(value_name = "DESIGN")]
    design: String,
    /// The output folder; created if it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    workload: WorkloadFlags,
    /// Repetitions of each scenario under each policy, in place of the design's
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    repetitions: Option<u32>,
    /// Seed of all random numbers, in place of the design's
    #[arg(long)]
    seed: Option<u64>,
    /// Parallel trials [default: the number of cores]
    #[arg(long)]
    jobs: Option<usize>,
    /// Scenarios in the published format (JSON), in place of the generated scenarios
    #[arg(long, value_name = "FILE")]
    scenarios: Option<PathBuf>,
    /// A map in Consort's format or the published format, in place of the design's
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Measured drives (CSV with origin, dest, duration_s, estimate_s) from which durations are
    /// drawn
    #[arg(long, value_name = "FILE")]
    legs: Option<PathBuf>,
}

fn policy(text: &str) -> Result<Policy, InvalidValue> {
    named(text, &Policy::ALL, Policy::as_str)
}

fn treatment(text: &str) -> Result<Treatment, InvalidValue> {
    named(text, &Treatment::ALL, Treatment::as_str)
}

fn share(text: &str) -> Result<f64, InvalidValue> {
    let share: f64 = text.parse().map_err(|_| InvalidValue::new(format_args!("{text:?} is not a number")))?;
    if (0.5..1.0).contains(&share) { Ok(share) } else { Err(InvalidValue::new("from 0.5 to below 1")) }
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong flags or files; [`Failure::Unsuccessful`] if a file cannot be
/// written.
pub(crate) fn run(args: &Args, extensions: Extensions) -> Result<(), Failure> {
    match &args.what {
        ExperimentCommand::Run(args) => run_design(args, extensions),
        ExperimentCommand::Calibrate(args) => calibrate(args, extensions),
        ExperimentCommand::Energy(args) => energy::run(args, extensions),
        ExperimentCommand::Legs(args) => legs::run(args),
        ExperimentCommand::Shift(args) => shift::run(args),
    }
}

impl Common {
    fn evaluation(&self, extensions: Extensions) -> Result<Evaluation, Failure> {
        let workload = self.workload.workload(extensions)?;
        let mut design = self.design(&workload.extensions.domain())?;
        design.repetitions = self.repetitions.unwrap_or(design.repetitions);
        design.seed = self.seed.unwrap_or(design.seed);
        let instead = InputOverrides {
            scenarios: self.scenarios.as_deref(),
            map: self.map.as_deref(),
            legs: self.legs.as_deref(),
        };
        let evaluation = Evaluation::load(design, &instead, workload);
        Ok(evaluation.map_err(|problems| problems.with_file(&self.design))?)
    }

    fn design(&self, domain: &Domain) -> Result<Design, Failure> {
        let path = Path::new(&self.design);
        let shipped = design::SHIPPED.iter().find(|(name, _)| *name == self.design);
        match shipped {
            Some((name, text)) if !path.is_file() => Ok(config::from_text::<DesignFile>(text, name, domain)?.0),
            _ if path.exists() => Ok(config::load::<DesignFile>(path, domain)?.0),
            _ => {
                let known: Vec<&str> = design::SHIPPED.iter().map(|(name, _)| *name).collect();
                let what = format!("no such file; give the path of a file, or a bundled design: {}", known.join(", "));
                Err(Diagnostics::from(Diagnostic::for_file(&self.design, what)).into())
            }
        }
    }

    fn jobs(&self) -> usize {
        self.jobs.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, Into::into)).max(1)
    }

    fn folder(&self) -> Result<(), Failure> {
        std::fs::create_dir_all(&self.out).map_err(|problem| write_error(&self.out, problem))
    }
}

fn heading(evaluation: &Evaluation) -> ReportHeader {
    ReportHeader {
        design: evaluation.design.name.clone(),
        seed: evaluation.design.seed,
        map: evaluation.map.name().to_owned(),
        travel: evaluation.travel.describe(),
        world_speed: evaluation.design.world_speed,
        phases: evaluation.design.mission.phases.clone(),
    }
}

/// Computes the report. Its tests of significance permute the rows many thousand times.
fn build_report(heading: &ReportHeader, rows: &[TrialRow], gain: Option<&CalibrationGain>) -> Vec<ReportFile> {
    let mut waiting = Progress::on_terminal();
    waiting.show("computing the report");
    report(heading, rows, gain)
}

fn run_design(args: &RunArgs, extensions: Extensions) -> Result<(), Failure> {
    let evaluation = args.common.evaluation(extensions)?;
    let domain = evaluation.workload.extensions.domain();
    let calibration = args.calibration.as_ref().map(|file| config::load::<Calibration>(file, &domain)).transpose()?;
    let mut design = evaluation.design.clone();
    design.policies = args.policies.clone().unwrap_or(design.policies);
    design.treatments = args.treatments.clone().unwrap_or(design.treatments);
    let stage = evaluation.trial_fixture(design, calibration.map(Arc::new))?;
    args.common.folder()?;
    let began = Instant::now();
    let outcomes = with_progress(&stage, args.common.jobs(), "");
    let seconds = began.elapsed().as_secs_f64();
    let (rows, observations) = split_outcomes(outcomes);
    let out = &args.common.out;
    write_rows(out, "rows.csv", &rows)?;
    write_observations(out, &observations)?;
    write_report(out, &build_report(&heading(&evaluation), &rows, None))?;
    output::line(summary(&rows))?;
    let trials = count(rows.len(), "trial", "trials");
    output::line(format_args!("{trials} in {seconds:.1} s; see {}", out.join("report.md").display()))
}

fn calibrate(args: &CalibrateArgs, extensions: Extensions) -> Result<(), Failure> {
    let evaluation = args.common.evaluation(extensions)?;
    let jobs = args.common.jobs();
    args.common.folder()?;
    let one = |design: &Design, policies: Vec<Policy>| Design {
        policies,
        treatments: vec![Treatment::Calm],
        ..design.clone()
    };
    // The learning trials use other random numbers than the trials that measure the gain. Random
    // assignments send robots to places that the coordinator would not choose.
    let seed = derive(evaluation.design.seed, &["calibrate"]);
    let learning = Design { seed, ..one(&evaluation.design, vec![Policy::Consort, Policy::Random]) };
    let stage = evaluation.trial_fixture(learning, None)?;
    let outcomes = with_progress(&stage, jobs, "learning ");
    let trials = outcomes.len();
    let (_, observations) = split_outcomes(outcomes);
    let calibration = Arc::new(calibration::calibrate(&observations, args.quantile));
    let judged = one(&evaluation.design, vec![Policy::Consort]);
    let stage = evaluation.trial_fixture(judged.clone(), None)?;
    let (before, observed_before) = split_outcomes(with_progress(&stage, jobs, "as they were "));
    let stage = evaluation.trial_fixture(judged, Some(Arc::clone(&calibration)))?;
    let (after, observed_after) = split_outcomes(with_progress(&stage, jobs, "calibrated "));
    let out = &args.common.out;
    write(&out.join("calibration.toml"), &config::to_toml(&*calibration))?;
    write_observations(out, &observations)?;
    write_rows(out, "rows-before.csv", &before)?;
    write_rows(out, "rows-after.csv", &after)?;
    let calibration = (*calibration).clone();
    let gain = CalibrationGain { calibration, trials, before, after, observed_before, observed_after };
    write_report(out, &build_report(&heading(&evaluation), &gain.before, Some(&gain)))?;
    output::line(format_args!("as they were:\n{}\ncalibrated:\n{}", summary(&gain.before), summary(&gain.after)))?;
    let trials = count(trials, "trial", "trials");
    output::line(format_args!("learned from {trials}; see {}", out.join("report.md").display()))
}

fn with_progress(stage: &ExperimentSetup, jobs: usize, what: &'static str) -> Vec<TrialOutcome> {
    let all = trials(stage);
    let bar = ProgressBar::new(all.len() as u64);
    bar.set_style(
        ProgressStyle::with_template("{prefix}{bar:40} {pos}/{len} trials, {elapsed} so far, {eta} left")
            .expect("the template is sound"),
    );
    bar.set_prefix(what);
    let (mut done, total) = (0, all.len());
    let outcomes = run_trials(stage, &all, jobs, |_| {
        bar.inc(1);
        done += 1;
        // Without a terminal, prints a line for each tenth.
        if bar.is_hidden() && done * 10 / total > (done - 1) * 10 / total {
            output::note(format_args!("{what}{done} of {total} trials"));
        }
    });
    bar.finish_and_clear();
    outcomes
}

fn split_outcomes(outcomes: Vec<TrialOutcome>) -> (Vec<TrialRow>, Vec<Observation>) {
    let (mut rows, mut observations) = (vec![], vec![]);
    for outcome in outcomes {
        rows.push(outcome.row);
        observations.extend(outcome.observations);
    }
    (rows, observations)
}

/// Returns a table of the trials' results.
fn summary(rows: &[TrialRow]) -> String {
    let head = ["policy", "treatment", "trials"].into_iter().chain(EndState::ALL.map(EndState::as_str));
    let mut table = vec![head.chain(["success", "mean TTC"]).map(str::to_owned).collect::<Vec<_>>()];
    for tally in tallies(rows) {
        let mut line = vec![tally.policy.to_string(), tally.treatment.as_str().to_owned(), tally.trials.to_string()];
        line.extend(tally.ended.iter().map(ToString::to_string));
        line.push(format!("{:.1} %", tally.successes() as f64 * 100.0 / tally.trials.max(1) as f64));
        line.push(Summary::of(&tally.ttc_s).map_or(String::new(), |times| format!("{:.1} s", times.mean)));
        table.push(line);
    }
    output::table(&table)
}

fn write_error(file: &Path, problem: impl Display) -> Failure {
    Failure::Unsuccessful(format!("{} cannot be written: {problem}", file.display()))
}

fn write(file: &Path, text: &str) -> Result<(), Failure> {
    std::fs::write(file, text).map_err(|problem| write_error(file, problem))
}

fn write_rows(out: &Path, name: &str, rows: &[TrialRow]) -> Result<(), Failure> {
    let mut text = vec![];
    let file = out.join(name);
    results::write(rows, &mut text).map_err(|problem| write_error(&file, problem))?;
    std::fs::write(&file, text).map_err(|problem| write_error(&file, problem))
}

fn write_observations(out: &Path, observations: &[Observation]) -> Result<(), Failure> {
    let mut text = vec![];
    let file = out.join("tasks.csv");
    results::write_observations(observations, &mut text).map_err(|problem| write_error(&file, problem))?;
    std::fs::write(&file, text).map_err(|problem| write_error(&file, problem))
}

fn write_report(out: &Path, files: &[ReportFile]) -> Result<(), Failure> {
    files.iter().try_for_each(|file| write(&out.join(&file.name), &file.text))
}
