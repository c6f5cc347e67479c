//! `consort-lab experiment legs`: the travel factors of a file of measured drives.

use crate::evaluation::load_legs;
use consort_evaluation::travel::{FactorQuantiles, PairFactors, ViaFactors};
use consort_nodes::diagnostic::{Diagnostic, Diagnostics};
use consort_nodes::exit::Failure;
use consort_nodes::output;
use consort_protocol::ids::PlaceId;
use serde::Serialize;
use std::path::PathBuf;

/// Computes travel factors from measured drives: how many times as long as estimated they took
///
/// Prints count, median, and 5 % and 95 % quantiles of duration_s / estimate_s for each origin and
/// destination. `run --legs` draws its drives from the same factors.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort-lab experiment legs nav_legs.csv
  consort-lab experiment legs nav_legs.csv --to Laboratory     # the factors `slow` of the design `published`
  consort-lab experiment legs nav_legs.csv --json | jq '.pairs[] | select(.median > 1.5)'")]
pub(crate) struct Args {
    /// Measured drives (CSV with origin, dest, duration_s, estimate_s)
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print instead, for each place from which drives lead to PLACE, the factors of the drives to
    /// that place and from there to PLACE
    #[arg(long, value_name = "PLACE")]
    to: Option<PlaceId>,
    /// Print a JSON object
    #[arg(long)]
    json: bool,
}

/// Output of `--json`.
#[derive(Serialize)]
struct LegsReport {
    /// The factors by origin and destination; empty with `--to`.
    pairs: Vec<PairFactors>,
    /// The factors by place on the way; empty without `--to`.
    via: Vec<ViaFactors>,
    /// The factors of all drives of the file.
    all: Option<FactorQuantiles>,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for a file that cannot be read, and for a destination without drives.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let legs = load_legs(&args.file)?;
    let mut report = LegsReport { pairs: vec![], via: vec![], all: legs.all_factors() };
    match &args.to {
        Some(to) => report.via = legs.via_factors(to),
        None => report.pairs = legs.pair_factors(),
    }
    if let Some(to) = args.to.as_ref().filter(|_| report.via.is_empty()) {
        let known = legs.destinations().map(PlaceId::as_str).collect::<Vec<_>>().join(", ");
        let problem = format!("no drive ends at {to}; drives end at: {known}");
        return Err(Diagnostics::from(Diagnostic::for_file(args.file.display(), problem)).into());
    }
    if args.json { output::json(&report) } else { output::line(table(&report)) }
}

fn table(report: &LegsReport) -> String {
    let line = |from: &str, to: &str, factors: &FactorQuantiles| {
        let FactorQuantiles { count, q05, median, q95 } = factors;
        let numbers = [q05, median, q95].map(|factor| format!("{factor:.2}"));
        [from.to_owned(), to.to_owned(), count.to_string()].into_iter().chain(numbers).collect::<Vec<_>>()
    };
    let places = if report.via.is_empty() { ["from", "to"] } else { ["via", ""] };
    let head = places.into_iter().chain(["drives", "5 %", "median", "95 %"]).map(str::to_owned).collect();
    let pairs = report.pairs.iter().map(|pair| line(pair.from.as_str(), pair.to.as_str(), &pair.factors));
    let via = report.via.iter().map(|via| line(via.via.as_str(), "", &via.factors));
    let all = report.all.iter().map(|factors| line("all drives", "", factors));
    output::table(&std::iter::once(head).chain(pairs).chain(via).chain(all).collect::<Vec<_>>())
}
