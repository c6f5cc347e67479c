//! `consort record`: records a fleet's messages to a file.

use super::flag_values::parse_duration;
use crate::client::{Client, ClientFlags};
use crate::exit::Failure;
use crate::file::already_exists;
use crate::output::{self, Progress};
use crate::shutdown_signals::ShutdownSignals;
use consort_bus::clock::Clock;
use consort_dashboard::fleet_model::{FleetListener, FleetModel, FloorPlan};
use consort_dashboard::recording::{Recorder, RecordingStats, RecordingWriter};
use consort_dashboard::subscriber::subscribe_fleet;
use consort_text::count;
use consort_world::record::foxglove::ExistingFile;
use indicatif::HumanBytes;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};

/// Record the events of a fleet to an MCAP file
///
/// The recorder subscribes like any client, and is not part of the fleet. It records events,
/// robots, people and doors, and all data of the dashboard. It ends with Ctrl-C, SIGTERM or after
/// `--for`; the file is complete then. `consort replay` shows it in the dashboard, and Foxglove
/// opens it.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort record --out run.mcap
  consort record --out run.mcap --for 90s --fleet demo --connect tcp/127.0.0.1:7447
  consort record --out run.mcap --force --connect tcp/192.0.2.1:7447 --connect tcp/192.0.2.2:7447
  consort replay run.mcap

With several addresses the recording continues when the linked node fails. Events missed meanwhile are noted in the file, by
their sequence numbers (topic /gaps). If the recorder is killed, the last second or two and the file's index are lost:
`consort replay` still shows the file, and `mcap recover` repairs it.")]
pub(crate) struct Args {
    /// The file; an existing file is not replaced without --force
    #[arg(long, env = "CONSORT_OUT", value_name = "FILE.mcap")]
    out: PathBuf,
    /// Recording time, as 60s, 5m, 2h or 30d. Default: until Ctrl-C
    #[arg(long = "for", env = "CONSORT_FOR", value_name = "TIME", value_parser = parse_duration)]
    length: Option<Duration>,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
    /// Print the recording's statistics as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Interval for flushing the file and updating the progress.
const LOOK: Duration = Duration::from_millis(250);

/// Name of the observing node in the fleet model.
const NAME: &str = "recorder";

/// A finished recording, as `--json` prints it.
#[derive(serde::Serialize)]
struct RecordResult<'a> {
    file: &'a Path,
    recorded: &'a RecordingStats,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if the file exists or cannot be written; [`Failure::Unsuccessful`] if it does
/// not hold all received messages; see [`Client::open`].
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    if !args.force && args.out.exists() {
        return Err(already_exists(&args.out));
    }
    let Args { out, length, force, json, client } = args;
    let existing = if force { ExistingFile::Replace } else { ExistingFile::Keep };
    let recorded = client.with_client(async |client| {
        let clock = Clock::real();
        let (fleet, began_ms) = (client.fleet().clone(), clock.wall_ms());
        let writer = RecordingWriter::create(&out, existing, &fleet, NAME, began_ms);
        let writer = writer.map_err(|problem| Failure::Usage(problem.to_string()))?;
        let model = FleetModel::new(fleet.to_string(), NAME, FloorPlan::default(), began_ms);
        let recorder = Arc::new(Recorder::new(model, writer, clock));
        let until = length.map(|length| Instant::now() + length);
        output::note(format_args!("recording {fleet} to {}; Ctrl-C ends it", out.display()));
        let ended = listen(client, &recorder, until).await;
        let recorded = recorder.finish().map_err(|problem| Failure::Unsuccessful(problem.to_string()))?;
        ended.map(|()| recorded)
    })?;
    match json {
        true => output::json(&RecordResult { file: &out, recorded: &recorded }),
        false => output::line(format_args!("{}: {}", out.display(), format_stats(&recorded))),
    }
}

/// Passes received messages to the recorder, until the recording ends.
async fn listen(client: &Client, recorder: &Arc<Recorder>, until: Option<Instant>) -> Result<(), Failure> {
    let mut signals = ShutdownSignals::open()?;
    let ear: Arc<dyn FleetListener> = Arc::<Recorder>::clone(recorder);
    let mut tasks = JoinSet::new();
    subscribe_fleet(&mut tasks, client.bus(), client.keys().clone(), ear);
    let mut progress = Progress::new();
    let end = async {
        match until {
            Some(until) => sleep_until(until).await,
            None => std::future::pending().await,
        }
    };
    tokio::pin!(end);
    loop {
        tokio::select! {
            _ = signals.wait() => return Ok(()),
            () = &mut end => return Ok(()),
            () = recorder.write_failed() => return Ok(()), // `finish` returns the reason
            () = tokio::time::sleep(LOOK) => {
                if let (Some(recorded), coordinator) = recorder.flush_due() {
                    let who = coordinator.map_or_else(|| "no coordinator".to_owned(), |now| format!("coordinator {}", now.node));
                    progress.show_on_terminal(format_args!("{}; {who}", format_stats(&recorded)));
                }
            }
        }
    }
}

/// Formats the recording's statistics.
fn format_stats(recorded: &RecordingStats) -> String {
    let RecordingStats { seconds, events, reports, views, gaps, lost, bytes, .. } = recorded;
    let gaps = match gaps {
        0 => String::new(),
        _ => format!(", {} missed in {}", count(*lost, "event", "events"), count(*gaps, "gap", "gaps")),
    };
    let events = count(*events, "event", "events");
    let reports = count(*reports, "telemetry report", "telemetry reports");
    let views = count(*views, "view", "views");
    format!("{seconds:.0} s, {events}{gaps}, {reports}, {views}, {}", HumanBytes(*bytes))
}
