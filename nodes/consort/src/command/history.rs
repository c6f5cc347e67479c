//! `consort history`: the archive of a station.

use super::flag_values::parse_duration;
use crate::archive::{ArchiveKind, ArchiveRecord, CSV_HEADER, FOLDER, read_all};
use crate::exit::Failure;
use crate::output;
use consort_bus::clock::Clock;
use consort_protocol::ids::MissionId;
use consort_text::count;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

/// Export what a station has archived
///
/// The ledger forgets ended missions after some time. A station whose file has the table [archive] keeps them in its data
/// directory, with auctions, tasks and the audit trail.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort history export --data-dir /var/lib/consort > history.csv
  consort history export --data-dir /var/lib/consort --since 7d --kind mission,audit --format json
  consort history export --data-dir /var/lib/consort --mission lab-samples-7")]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Print the records, earliest first
    ///
    /// The archive is read on the machine of the station, which may run meanwhile. Several stations have the same records.
    Export(ExportArgs),
}

#[derive(Debug, clap::Args)]
struct ExportArgs {
    /// Data directory of the station
    #[arg(long, env = "CONSORT_DATA_DIR", value_name = "DIR")]
    data_dir: PathBuf,
    /// CSV with the columns time, kind, subject, who, what and details (JSON), or a JSON object per line
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
    /// Only records within this time before now, as 12h or 7d
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    since: Option<Duration>,
    /// Only records of these kinds
    #[arg(long, value_enum, value_delimiter = ',', value_name = "KIND,…")]
    kind: Vec<ArchiveKind>,
    /// Only records of this mission
    #[arg(long)]
    mission: Option<MissionId>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Csv,
    Json,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if there is no archive; [`Failure::Unsuccessful`] if it cannot be read.
pub(crate) fn run(Args { what: What::Export(args) }: Args) -> Result<(), Failure> {
    let folder = args.data_dir.join(FOLDER);
    if !folder.is_dir() {
        let folder = folder.display();
        return Err(Failure::Usage(format!(
            "{folder}: there is no archive; a station with [archive] in its file keeps one"
        )));
    }
    if args.format == Format::Csv {
        output::line(CSV_HEADER)?;
    }
    let from_ms = args.since.map_or(0, |since| {
        let since_ms = u64::try_from(since.as_millis()).unwrap_or(u64::MAX);
        Clock::real().wall_ms().saturating_sub(since_ms)
    });
    let unreadable = read_all(&folder, |record| match (is_wanted(&record, &args, from_ms), args.format) {
        (false, _) => Ok(()),
        (true, Format::Csv) => output::line(record.csv()).map_err(ExportError::Output),
        (true, Format::Json) => output::json(&record).map_err(ExportError::Output),
    });
    match unreadable {
        Ok(0) => Ok(()),
        Ok(lines) => {
            output::note(format_args!("{} could not be read", count(lines, "line", "lines")));
            Ok(())
        }
        Err(ExportError::Output(failure)) => Err(failure),
        Err(ExportError::Io(problem)) => Err(Failure::Unsuccessful(format!("{}: {problem}", folder.display()))),
    }
}

/// Error of an export.
enum ExportError {
    /// The archive cannot be read.
    Io(io::Error),
    /// The output cannot be written.
    Output(Failure),
}

impl From<io::Error> for ExportError {
    fn from(problem: io::Error) -> ExportError {
        ExportError::Io(problem)
    }
}

fn is_wanted(record: &ArchiveRecord, args: &ExportArgs, from_ms: u64) -> bool {
    let is_of_mission = |mission: &MissionId| record.subject() == mission.as_str();
    record.at_ms >= from_ms
        && (args.kind.is_empty() || args.kind.contains(&record.kind()))
        && args.mission.as_ref().is_none_or(is_of_mission)
}
