//! `consort replay`: a recording in the dashboard.

use crate::address::BoundAddress;
use crate::config::LogFormat;
use crate::dashboard::Dashboard;
use crate::exit::Failure;
use crate::node_runtime::{build_runtime, rust_log, start_log};
use crate::output;
use crate::recording::{Player, RecordingReader};
use crate::shutdown_signals::ShutdownSignals;
use consort_protocol::count::count;
use std::net::SocketAddr;
use std::path::PathBuf;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Show a recording of `consort record` in the dashboard
///
/// The dashboard has a bar then: to stop and go on, to go faster, and to go to any time of the recording; the coordinator's changes
/// and the ends of missions are marked on it. Everybody who looks sees the same instant. It runs until Ctrl-C.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort replay run.mcap
  consort replay run.mcap --speed 8 --dashboard 127.0.0.1:8088

Keys on the page: space stops and goes on; the left and right arrows go 5 s back and on, with Shift 1 s; Home and End go to the
beginning and the end; , and . go to the mark before and the next.

For programs: GET /api/replay says what is shown, and POST /api/replay takes {\"at_ms\": …, \"playing\": true, \"speed\": 2}, each of
which may be left out. All other paths are those of a live dashboard, as of the instant that is shown; missions can be neither
submitted nor canceled, nor closed after a rescue.")]
pub struct Args {
    /// The recording
    #[arg(value_name = "FILE.mcap")]
    file: PathBuf,
    /// Serve the dashboard at this address; port 0 for any free one. The address is printed
    #[arg(long, env = "CONSORT_DASHBOARD", value_name = "HOST:PORT", default_value = "127.0.0.1:0")]
    dashboard: SocketAddr,
    /// How many seconds of the recording pass in one second, from 0.1 to 100; the page can change it
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    speed: f64,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if the file cannot be shown, the address not be had, or the speed is not allowed.
pub fn run(args: Args) -> Result<(), Failure> {
    start_log(rust_log().as_deref().unwrap_or("off"), LogFormat::Human)?;
    build_runtime()?.block_on(async {
        let address = BoundAddress::bind("--dashboard", args.dashboard).await.map_err(Failure::Usage)?;
        let reel = RecordingReader::open(&args.file).map_err(|problem| Failure::Usage(problem.to_string()))?;
        let player = Player::new(reel.from_ms(), reel.to_ms(), args.speed);
        let player = player.map_err(|problem| Failure::Usage(format!("--speed: {problem}")))?;
        let seconds = (reel.to_ms() - reel.from_ms()) as f64 / 1000.0;
        let (file, fleet, began) = (args.file.display(), reel.fleet().to_owned(), date(reel.from_ms()));
        if let Some(problem) = reel.damage() {
            output::note(format_args!(
                "{file}: {problem}; what can be read of it is shown, up to {}",
                date(reel.to_ms())
            ));
        }
        let marks = count(reel.marks().len(), "mark", "marks");
        let about = format!("{file}: {fleet} from {began} on, {seconds:.0} s, {marks}");
        let mut signals = ShutdownSignals::open()?;
        let dashboard = Dashboard::replay(address, reel, player);
        output::line(about)?;
        output::line(format_args!("dashboard: {}", dashboard.url()))?;
        signals.wait().await;
        Ok(())
    })
}

/// An instant in words, in universal time.
fn date(ms: u64) -> String {
    let at = i64::try_from(ms / 1000).ok().and_then(|seconds| OffsetDateTime::from_unix_timestamp(seconds).ok());
    at.and_then(|at| at.format(&Rfc3339).ok()).unwrap_or_else(|| format!("{ms} ms after 1970"))
}
