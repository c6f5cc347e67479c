//! `consort replay`: shows a recording in the dashboard.

use crate::config::LogFormat;
use crate::exit::Failure;
use crate::node_runtime::{build_runtime, rust_log, start_log};
use crate::output;
use crate::shutdown_signals::ShutdownSignals;
use consort_dashboard::address::BoundAddress;
use consort_dashboard::recording::{Player, RecordingReader};
use consort_dashboard::server::Dashboard;
use consort_text::count;
use std::net::SocketAddr;
use std::path::PathBuf;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Show a recording of `consort record` in the dashboard
///
/// The dashboard gets a playback bar: pause and play, change the speed, and seek to any time of the
/// recording. Changes of the coordinator and the ends of missions are marked on it. All viewers see
/// the same instant. It runs until Ctrl-C.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort replay run.mcap
  consort replay run.mcap --speed 8 --dashboard 127.0.0.1:8088

Keys on the page: space pauses and plays; the left and right arrows seek 5 s back and forward, with Shift 1 s; Home and End
seek to the beginning and the end; , and . seek to the previous and the next mark.

For programs: GET /api/replay returns the playback state, and POST /api/replay takes {\"at_ms\": …, \"playing\": true, \"speed\": 2};
each field is optional. All other paths are those of a live dashboard, at the instant that is shown; missions cannot be
submitted, canceled or resolved.")]
pub(crate) struct Args {
    /// The recording
    #[arg(value_name = "FILE.mcap")]
    file: PathBuf,
    /// Serve the dashboard at this address; port 0 selects any free port. The address is printed
    #[arg(long, env = "CONSORT_DASHBOARD", value_name = "HOST:PORT", default_value = "127.0.0.1:0")]
    dashboard: SocketAddr,
    /// Playback speed: seconds of the recording per second, from 0.1 to 100; the page can change it
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    speed: f64,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if the file cannot be shown, the address is not available, or the speed is
/// not allowed.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    start_log(rust_log().as_deref().unwrap_or("off"), LogFormat::Human)?;
    build_runtime()?.block_on(async {
        let address = BoundAddress::bind("--dashboard", args.dashboard).await?;
        let reader = RecordingReader::open(&args.file).map_err(|problem| Failure::Usage(problem.to_string()))?;
        let player = Player::new(reader.from_ms(), reader.to_ms(), args.speed);
        let player = player.map_err(|problem| Failure::Usage(format!("--speed: {problem}")))?;
        let seconds = (reader.to_ms() - reader.from_ms()) as f64 / 1000.0;
        let (file, fleet, began) = (args.file.display(), reader.fleet().to_owned(), date(reader.from_ms()));
        if let Some(problem) = reader.damage() {
            output::note(format_args!("{file}: {problem}; the readable part is shown, up to {}", date(reader.to_ms())));
        }
        let marks = count(reader.marks().len(), "mark", "marks");
        let about = format!("{file}: {fleet} from {began} on, {seconds:.0} s, {marks}");
        let mut signals = ShutdownSignals::open()?;
        let dashboard = Dashboard::replay(address, reader, player);
        output::line(about)?;
        output::line(format_args!("dashboard: {}", dashboard.url()))?;
        signals.wait().await;
        Ok(())
    })
}

/// Formats an instant in UTC.
fn date(ms: u64) -> String {
    let at = i64::try_from(ms / 1000).ok().and_then(|seconds| OffsetDateTime::from_unix_timestamp(seconds).ok());
    at.and_then(|at| at.format(&Rfc3339).ok()).unwrap_or_else(|| format!("{ms} ms after 1970"))
}
