//! `consort watch`: shows the fleet on a terminal.

use crate::client::ClientFlags;
use crate::exit::Failure;
use crate::tui::{ColorMode, KeyOutcome, Tui};
use consort_bus::clock::Clock;
use consort_dashboard::fleet_model::{FleetModel, FloorPlan};
use consort_dashboard::server::FramePublisher;
use consort_dashboard::subscriber::subscribe_fleet;
use ratatui::crossterm::event::{Event, read};
use std::io::IsTerminal;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::task::JoinSet;

/// Watch a fleet on the terminal: robots, missions, auctions and events
///
/// The data comes from the nearest node; outdated data is marked as old. Colours are left out if
/// NO_COLOR is set.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Keys: q quits; Tab selects the next panel; the arrows, PgUp and PgDn move in it. The auction is that of the selected mission.

Examples:
  consort watch
  consort watch --fleet demo --connect tcp/192.0.2.7:7447")]
pub struct Args {
    #[command(flatten)]
    client: ClientFlags,
}

/// Time between two drawings while no key is pressed.
const FRAME: Duration = Duration::from_millis(200);

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] without a terminal; see [`Client::open`](crate::client::Client::open).
pub fn run(args: Args) -> Result<(), Failure> {
    if !std::io::stdout().is_terminal() || !std::io::stdin().is_terminal() {
        return Err(Failure::Usage(
            "consort watch needs a terminal; `consort missions --watch` and `consort fleet --json` \
             write lines"
                .to_owned(),
        ));
    }
    args.client.with_client(async |client| {
        let clock = Clock::real();
        let model = FleetModel::new(client.fleet().to_string(), "watch", FloorPlan::default(), clock.wall_ms());
        let publisher = Arc::new(FramePublisher::new(model, clock));
        let mut tasks = JoinSet::new();
        subscribe_fleet(&mut tasks, client.bus(), client.keys().clone(), Arc::<FramePublisher>::clone(&publisher));
        let mut terminal = ratatui::try_init().map_err(|problem| terminal_error(&problem))?;
        let ended = show(&mut terminal, &publisher, keys()).await;
        ratatui::restore();
        ended
    })
}

async fn show(
    terminal: &mut ratatui::DefaultTerminal,
    publisher: &FramePublisher,
    mut keys: UnboundedReceiver<Event>,
) -> Result<(), Failure> {
    let plain = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let mut screen = Tui::new(if plain { ColorMode::Plain } else { ColorMode::Color });
    loop {
        let drawn =
            publisher.with_model(|model, now_ms| terminal.draw(|frame| screen.draw(frame, model, now_ms)).map(drop));
        drawn.map_err(|problem| terminal_error(&problem))?;
        match tokio::time::timeout(FRAME, keys.recv()).await {
            Ok(Some(Event::Key(key))) if screen.handle_key(key) == KeyOutcome::Quit => return Ok(()),
            Ok(None) => return Ok(()), // the terminal is closed
            Ok(Some(_)) | Err(_) => {}
        }
    }
}

/// Starts a thread that reads key events. The thread still waits for a key when the command ends,
/// and ends with the process.
fn keys() -> UnboundedReceiver<Event> {
    let (to, pressed) = unbounded_channel();
    std::thread::spawn(move || {
        while let Ok(event) = read() {
            if to.send(event).is_err() {
                return;
            }
        }
    });
    pressed
}

fn terminal_error(problem: &std::io::Error) -> Failure {
    Failure::Unsuccessful(format!("the terminal cannot be used: {problem}"))
}
