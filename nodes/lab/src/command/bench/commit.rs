//! `consort-lab bench commit`: measures commits by the number of missions.

use clap::Args as ClapArgs;
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use consort_tests::scale::{CommitFigures, CommitSetup, measure_commits};
use std::cell::RefCell;
use std::time::Instant;

/// Measures how long a commit takes, and the coordinator's work for it, by the number of missions.
///
/// A fleet of three stations and a robot holds missions that may start tomorrow, or that have ended. Then 200 missions are
/// requested and canceled, one after the other, on the virtual bus with links of 0.2 to 3 ms. A voter takes a snapshot every
/// 100 entries. A fleet accepts 1399 missions at most; with more than 1000 it writes a wire version without that limit.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab bench commit                        # 100, 1000 and 10000 missions that wait, then as many that have ended
  consort-lab bench commit --missions 1000 --json | jq .commit_ms
  consort-lab bench commit --history 20000

With --json: an object for each number of missions. commit_ms is the time from a client's request to the acknowledgement
with the coordinator's computing time, coordinator_ms its computing time for a commit (median), idle_percent its computing
time without commits as a share of a core, copy_ms the time for which a snapshot locks the ledger, mission_bytes the
encoded size of a waiting mission, and mission_memory_kb its memory in each voter; measure a single number for the latter.")]
pub(super) struct Args {
    /// Number of missions that wait: a fleet for each number, from 1 to 20000
    #[arg(long, value_name = "N,…", value_delimiter = ',',
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=20_000))]
    missions: Vec<usize>,
    /// Number of missions that have ended: a fleet for each number, from 1 to 20000
    #[arg(long, value_name = "N,…", value_delimiter = ',',
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=20_000))]
    history: Vec<usize>,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print a JSON object for each number of missions
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] if the output cannot be written.
pub(super) fn run(args: Args) -> Result<(), Failure> {
    let Args { mut missions, mut history, seed, json } = args;
    if missions.is_empty() && history.is_empty() {
        (missions, history) = (NUMBERS.to_vec(), NUMBERS.to_vec());
    }
    if !json {
        output::line(HEADER)?;
    }
    let of_missions = missions.into_iter().map(|missions| CommitSetup { missions, history: 0, seed });
    let of_history = history.into_iter().map(|history| CommitSetup { missions: 0, history, seed });
    for setup in of_missions.chain(of_history) {
        let CommitSetup { missions, history, .. } = setup;
        let (began, progress) = (Instant::now(), RefCell::new(Progress::on_terminal()));
        let figures = measure_commits(setup, |step| {
            let elapsed = began.elapsed().as_secs();
            let mut progress = progress.borrow_mut();
            progress.show(format_args!("{missions} missions, {history} ended, after {elapsed} s: {step}"));
        });
        drop(progress);
        if json {
            output::json(&figures)?;
        } else {
            output::line(row(&figures))?;
        }
    }
    Ok(())
}

/// Numbers of missions that are measured unless the arguments state others.
const NUMBERS: [usize; 3] = [100, 1000, 10_000];

const HEADER: &str = "\
missions  history  commit ms              coordinator  idle      copy of the  mission
                   p50    p99    p99.9    ms/commit    % a core  ledger, ms   bytes";

fn row(figures: &CommitFigures) -> String {
    let [p50, p99, p999] = match figures.commit_ms {
        Some(commit) => [commit.p50, commit.p99, commit.p999],
        None => [f64::NAN; 3],
    };
    format!(
        "{:<9} {:<8} {p50:<6.1} {p99:<6.1} {p999:<8.1} {:<12.2} {:<9.1} {:<12.2} {:.0}",
        figures.missions,
        figures.history,
        figures.coordinator_ms.unwrap_or(f64::NAN),
        figures.idle_percent,
        figures.copy_ms,
        figures.mission_bytes,
    )
}
