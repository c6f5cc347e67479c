//! `consort driver`: checks drivers of robots.

use crate::domains;
use crate::exit::Failure;
use crate::{node_runtime, output};
use consort_driver::conformance::{self, CASES, Case, CaseReport, SampleGoal, Trial};
use consort_driver::{DriverEndpoint, DriverSetting};
use consort_skills::extensions::Extensions;
use consort_text::{AllowedNames, count};
use std::time::{SystemTime, UNIX_EPOCH};

/// Check drivers of robots
///
/// A driver is a program that a robot's node starts, and that exchanges JSON lines with the node
/// over its standard streams (`driver = ["python3", "driver.py"]` in a robot file).
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort driver check --domain examples/vacuum/domain.yaml -- python3 examples/vacuum/driver.py
  consort driver check --connect unix:driver.sock
  consort driver check --list

The messages are in docs/reference/driver.md.")]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Check(CheckArgs),
}

/// Try a driver in named cases
///
/// Starts the driver for each case, as a node does, without a fleet: it sends goals, renewals,
/// cancels, wrong lines and floods, lets permissions pass, closes streams, and kills the process.
/// With --connect it connects to a driver that listens on a socket for each case, and skips the cases
/// about the end of a process.
///
/// Prints a line for each case: `ok`, `skipped`, or `FAILED` with what the driver did. The goals are those of
/// the `example` of an offered action in the driver's hello, else a `wait` of 2 s: with a real
/// robot, it moves.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort driver check -- python3 driver.py
  consort driver check --domain domain.yaml -- ./driver --port /dev/ttyUSB0
  consort driver check --case cancel_stops_the_goal --case goal_succeeds -- python3 driver.py
  consort driver check --goal '{\"action\": \"wait\", \"parameters\": {\"time\": 2.0}}' -- python3 driver.py
  consort driver check --domain domain.yaml --connect tcp:127.0.0.1:7700
  consort driver check --json --jobs 4 -- python3 driver.py | jq 'select(.ok | not)'

A minimal driver in pseudocode; every message is a line of JSON:
  write {\"type\": \"hello\", \"protocol\": 1, \"driver\": \"mine 1.0\", \"actions\": {\"wait\": {}}}
  for each line of the input:
    goal       start it; repeated: nothing. Then write `feedback`, and a single `result`
    keep       the goal may continue for keep_for_ms from now on
    cancel     stop the robot, and write the `result` canceled
    heartbeat  write it back
    shutdown   stop the robot, and end; the end of the input means the same
  when keep_for_ms has passed: stop the robot, and write the `result` canceled

Exit codes: 0 every case is ok; 1 a case failed; 2 the flags are wrong, or there is no such program.")]
struct CheckArgs {
    /// Print a JSON object for each case
    #[arg(long)]
    json: bool,
    /// List the cases, with what a driver does in each, and exit
    #[arg(long)]
    list: bool,
    /// Run this case only; may be repeated. Default: all
    #[arg(long = "case", value_name = "NAME")]
    cases: Vec<String>,
    /// The goal to try, as JSON with `action` and `parameters`. Default: the example in the hello
    #[arg(long, value_name = "JSON", value_parser = goal)]
    goal: Option<SampleGoal>,
    /// Cases that run at the same time, each with a process of its own: for simulated robots only
    #[arg(long, value_name = "COUNT", default_value_t = 1)]
    jobs: u8,
    /// The socket on which the driver listens, in place of a program: unix:PATH or tcp:127.0.0.1:PORT
    #[arg(long, value_name = "SOCKET", conflicts_with = "program")]
    connect: Option<String>,
    /// The driver's program and its arguments, after `--`
    #[arg(last = true, required_unless_present_any = ["list", "connect"], value_name = "PROGRAM")]
    program: Vec<String>,
}

fn goal(text: &str) -> Result<SampleGoal, serde_json::Error> {
    serde_json::from_str(text)
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Unsuccessful`] if a case failed; [`Failure::Usage`] for an unknown case or program.
pub fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    let What::Check(args) = args.what;
    if args.list {
        let rows: Vec<Vec<String>> =
            CASES.iter().map(|case| vec![case.name.to_owned(), case.what.to_owned()]).collect();
        return output::line(output::table(&rows));
    }
    let cases = selected(&args.cases)?;
    let setting = match args.connect {
        Some(socket) => DriverSetting::Socket(socket),
        None => DriverSetting::Command(args.program),
    };
    let endpoint = DriverEndpoint::try_from(setting).map_err(|problem| Failure::Usage(problem.to_string()))?;
    endpoint.check_exists().map_err(|problem| Failure::Usage(problem.to_string()))?;
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let trial = Trial {
        endpoint,
        contract: domains::driver_contract(extensions),
        goal: args.goal,
        // More than a check has goals in a second.
        goals_after: since_1970.as_secs() << 12,
    };
    let runtime = node_runtime::build_runtime()?;
    let (mut failures, mut written) = (0, Ok(()));
    runtime.block_on(conformance::run(&trial, &cases, usize::from(args.jobs), |report| {
        failures += usize::from(!report.ok);
        if written.is_ok() {
            written = write_report(&report, args.json);
        }
    }));
    written?;
    match failures {
        0 => Ok(()),
        _ => Err(Failure::Unsuccessful(format!("{failures} of {} failed", count(cases.len(), "case", "cases")))),
    }
}

fn write_report(report: &CaseReport, as_json: bool) -> Result<(), Failure> {
    match &report.problem {
        _ if as_json => output::json(report),
        None if report.skipped => output::line(format_args!("skipped {}: it needs a process", report.case)),
        None => output::line(format_args!("ok      {}", report.case)),
        Some(problem) => output::line(format_args!("FAILED  {}: {problem}", report.case)),
    }
}

/// Returns the cases of these names; all without names.
fn selected(names: &[String]) -> Result<Vec<&'static Case>, Failure> {
    if names.is_empty() {
        return Ok(CASES.iter().collect());
    }
    let find = |name: &String| {
        CASES.iter().find(|case| case.name == name).ok_or_else(|| {
            let allowed = AllowedNames::suggest_for(name, CASES.iter().map(|case| case.name));
            Failure::Usage(format!("--case: there is no case {name}; {allowed}"))
        })
    };
    names.iter().map(find).collect()
}
