//! `consort watch`: shows the fleet on a terminal, and sends the orders of its user.

use crate::client::{Client, ClientFlags, new_request_id};
use crate::exit::Failure;
use crate::tui::{ColorMode, KeyOutcome, Order, Tui};
use consort_bus::clock::Clock;
use consort_dashboard::fleet_model::{FleetModel, FloorPlan};
use consort_dashboard::server::FramePublisher;
use consort_dashboard::subscriber::subscribe_fleet;
use ratatui::crossterm::event::{Event, read};
use std::io::IsTerminal;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::JoinSet;

/// Watch a fleet on the terminal: robots, missions, auctions and events
///
/// The data comes from the nearest node; outdated data is marked as old. Colours are left out if
/// NO_COLOR is set. Keys give orders, as the commands do: each is sent after its effect has been confirmed with y.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Keys: q quits; Tab selects the next panel; the arrows, PgUp and PgDn move in it. The auction is that of the selected mission;
the schedules are in its place while they have the focus.
In the panel of robots: h holds the selected robot, r releases it, m takes it out of service, e returns it to service.
In the panel of missions: x cancels the selected mission, X cancels those with a text in their names, parameters or robots,
p changes the priority, r gives a role to another robot, n pins a role that waits to a robot, or ends the order about it.
In the panel of schedules: p pauses the selected schedule, r resumes it, x removes it.
In each panel: H holds all robots, those in a zone or those that meet a condition, R releases them; c closes a place, a zone or
a lane, o opens one; l limits the speed there, L clears a limit; a raises an alarm, A clears one.
Enter continues with the next field, Esc leaves an order.

Examples:
  consort watch
  consort watch --fleet demo --connect tcp/192.0.2.7:7447")]
pub struct Args {
    /// Name of the responsible person for orders, for the record
    #[arg(long, env = "CONSORT_BY", value_name = "NAME")]
    by: Option<String>,
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
    let Args { by, client: flags } = args;
    flags.with_client(async |client| {
        let clock = Clock::real();
        let model = FleetModel::new(client.fleet().to_string(), "watch", FloorPlan::default(), clock.wall_ms());
        let publisher = Arc::new(FramePublisher::new(model, clock));
        let mut tasks = JoinSet::new();
        subscribe_fleet(&mut tasks, client.bus(), client.keys().clone(), Arc::<FramePublisher>::clone(&publisher));
        let (to, orders) = unbounded_channel();
        let (results, from) = unbounded_channel();
        let mut terminal = ratatui::try_init().map_err(|problem| terminal_error(&problem))?;
        client.progress().mute();
        let shown = async {
            let ended = show(&mut terminal, &publisher, Input { keys: keys(), results: from }, to).await;
            ratatui::restore();
            ended
        };
        // Orders that the user has confirmed are sent, also after the last key.
        let (ended, ()) = tokio::join!(shown, send_orders(client, by, orders, results));
        ended
    })
}

/// What happens while the fleet is shown.
struct Input {
    keys: UnboundedReceiver<Event>,
    /// Results of orders, as text.
    results: UnboundedReceiver<String>,
}

/// Sends orders one after the other, until the screen has ended and all are sent.
async fn send_orders(
    client: &mut Client,
    by: Option<String>,
    mut orders: UnboundedReceiver<Order>,
    results: UnboundedSender<String>,
) {
    while let Some(order) = orders.recv().await {
        let text = order.to_string();
        let (call, request) = order.request(by.clone(), new_request_id());
        let result = match client.api(call, &request).await {
            Ok(reply) => order.done_text(&reply),
            Err(failure) => failure.to_string(),
        };
        // The user may have left.
        let _ = results.send(format!("{text}: {result}"));
    }
}

async fn show(
    terminal: &mut ratatui::DefaultTerminal,
    publisher: &FramePublisher,
    Input { mut keys, mut results }: Input,
    orders: UnboundedSender<Order>,
) -> Result<(), Failure> {
    let plain = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let mut screen = Tui::new(if plain { ColorMode::Plain } else { ColorMode::Color });
    loop {
        while let Ok(result) = results.try_recv() {
            screen.show_note(result);
        }
        let drawn =
            publisher.with_model(|model, now_ms| terminal.draw(|frame| screen.draw(frame, model, now_ms)).map(drop));
        drawn.map_err(|problem| terminal_error(&problem))?;
        match tokio::time::timeout(FRAME, keys.recv()).await {
            Ok(Some(Event::Key(key))) => match publisher.with_model(|model, _| screen.handle_key(key, model)) {
                KeyOutcome::Quit => return Ok(()),
                KeyOutcome::Order(order) => {
                    screen.show_note(format!("{order}: sent, without a reply yet"));
                    let _ = orders.send(order);
                }
                KeyOutcome::Continue => {}
            },
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
