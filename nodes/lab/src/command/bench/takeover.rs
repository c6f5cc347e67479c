//! `consort-lab bench takeover`: measures takeovers of real processes, each on a host of its own.

use super::run_in_namespaces;
use crate::command::soak::fleet::{FleetKind, ProcessFleet};
use crate::command::soak::names::{ROOMS, STATIONS, WORLD};
use clap::Args as ClapArgs;
use consort_bus::{Sample, SharedBus, Stream};
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::view::{CoordinatorView, WithProvenance};
use consort_tests::chaos::UserParticipants;
use consort_tests::host_network::{INSIDE, is_inside};
use consort_tests::percentiles::Percentiles;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout};

/// Programs that the namespaces need.
const TOOLS: [&str; 1] = ["ip"];

/// Limit for a takeover, and for the fleet to be complete after it.
const LIMIT: Duration = Duration::from_secs(60);

/// Interval at which the view of the coordinator is read meanwhile.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);

/// Limit of a query.
const QUERY_LIMIT: Duration = Duration::from_secs(2);

/// Interval of the requests for a mission. All have the same id, so a single mission results.
const TRY_INTERVAL: Duration = Duration::from_millis(10);

/// Measures the time from the loss of the coordinator to its successor.
///
/// Three stations with their stores on disk, two carriers, an arm and the host of the simulated world are processes of
/// `consort` on hosts of their own. Again and again the process of the coordinator is killed with SIGKILL at a random
/// moment, or its cable is unplugged (`--cable`). A client at the host of the world waits for the event of the next
/// coordinator, and requests a mission every 10 ms until it is acknowledged, which is after its commit. Then the process
/// is started again, or the cable is plugged in, and the next loss follows when all voters are present.
///
/// It needs Linux with unprivileged user namespaces, or root, and the program ip (iproute2). Nothing is sent outside of
/// its own namespaces. The program `consort` must be beside this program.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab bench takeover --kills 100            # about five minutes
  consort-lab bench takeover --kills 20 --cable
  consort-lab bench takeover --json | jq .first_commit_ms.p99")]
pub(super) struct Args {
    /// Number of losses, from 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 20,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=1000))]
    kills: usize,
    /// Unplug the cable of the coordinator, instead of killing its process
    #[arg(long)]
    cable: bool,
    /// Print a JSON object
    #[arg(long)]
    json: bool,
}

/// Figures of all takeovers.
#[derive(Debug, Serialize)]
struct TakeoverFigures {
    kills: usize,
    cable: bool,
    voters: usize,
    /// Time until the client receives the event of the next coordinator.
    elected_ms: Option<Percentiles>,
    /// Time until a mission is acknowledged.
    first_commit_ms: Option<Percentiles>,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if there can be no namespaces here; [`Failure::Unsuccessful`] if a takeover fails.
pub(super) fn run(args: &Args) -> Result<(), Failure> {
    if !is_inside() {
        let kills = args.kills.to_string();
        let mut arguments = vec!["bench", "takeover", "--kills", &kills];
        arguments.extend(args.cable.then_some("--cable"));
        arguments.extend(args.json.then_some("--json"));
        return run_in_namespaces(&arguments, &TOOLS);
    }
    let folder = std::env::temp_dir().join(format!("consort-takeover-{}", std::env::var(INSIDE).unwrap_or_default()));
    std::fs::create_dir_all(&folder)
        .map_err(|problem| Failure::Usage(format!("{} cannot be created: {problem}", folder.display())))?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(unsuccessful)?;
    let figures = runtime.block_on(async {
        let kind = FleetKind { open: true, large: false, charging: false };
        let mut fleet = ProcessFleet::start(&folder, kind, &[], &UserParticipants::default()).await?;
        let figures = measure(&mut fleet, args).await;
        fleet.stop();
        figures
    });
    if figures.is_ok() {
        let _ = std::fs::remove_dir_all(&folder);
    } else {
        output::note(format_args!("the logs and data of the nodes are in {}", folder.display()));
    }
    let figures = figures?;
    if args.json { output::json(&figures) } else { output::line(text(&figures)) }
}

async fn measure(fleet: &mut ProcessFleet, args: &Args) -> Result<TakeoverFigures, Failure> {
    let mut progress = Progress::on_terminal();
    let mut chance = ChaCha8Rng::seed_from_u64(1);
    let bus = fleet.client(&[WORLD]).await?;
    let mut events = bus.subscribe(&fleet.keys.any_events()).await.map_err(unsuccessful)?;
    let (mut elected, mut first_commit) = (vec![], vec![]);
    for number in 0..args.kills {
        progress.show(format_args!("takeover {} of {}", number + 1, args.kills));
        let (coordinator, term) = wait_complete(fleet, &bus).await?;
        // At a random moment between two heartbeats, after the last takeover has settled.
        sleep(Duration::from_millis(chance.random_range(800..1200))).await;
        let lost_at = Instant::now();
        match args.cable {
            true => fleet.network.unplug(coordinator.as_str()),
            false => fleet.kill(coordinator.as_str()),
        }
        let request = json!({
            "mission": "lab-samples", "request": format!("takeover-{number}"),
            "parameters": { "room": ROOMS[number % ROOMS.len()] },
        });
        let takeover =
            async { tokio::join!(next_elected(&mut events, &coordinator, term), acknowledged(fleet, &bus, &request)) };
        let late = |_| unsuccessful(format_args!("{coordinator} has no successor within {LIMIT:?}"));
        let (elected_at, (acknowledged_at, mission)) = timeout(LIMIT, takeover).await.map_err(late)?;
        let ms = |at: Instant| (at - lost_at).as_secs_f64() * 1000.0;
        elected.push(ms(elected_at.ok_or_else(|| unsuccessful("the bus is closed"))?));
        first_commit.push(ms(acknowledged_at));
        match args.cable {
            true => fleet.network.plug(coordinator.as_str(), "br0"),
            false => fleet.start_node(coordinator.as_str())?,
        }
        // The fleet is measured, not its missions.
        let cancel = json!({ "mission": mission, "by": "bench" });
        query(&bus, &fleet.keys.write(&Key::Api(ApiCall::Cancel)), &cancel, is_mission).await;
    }
    Ok(TakeoverFigures {
        kills: args.kills,
        cable: args.cable,
        voters: STATIONS.len(),
        elected_ms: Percentiles::of(elected),
        first_commit_ms: Percentiles::of(first_commit),
    })
}

/// Waits until a coordinator reaches all voters, and returns it with its term.
async fn wait_complete(fleet: &mut ProcessFleet, bus: &SharedBus) -> Result<(NodeId, u64), Failure> {
    let deadline = Instant::now() + LIMIT;
    let key = fleet.keys.write(&Key::ViewCoordinator);
    loop {
        if let Some(found) = complete(bus, &key).await {
            return Ok(found);
        }
        fleet.restart_ended().map_err(unsuccessful)?;
        if Instant::now() >= deadline {
            return Err(unsuccessful(format_args!("the voters are not present within {LIMIT:?}")));
        }
        sleep(LOOK_INTERVAL).await;
    }
}

async fn complete(bus: &SharedBus, key: &str) -> Option<(NodeId, u64)> {
    let is_complete = |view: &CoordinatorView| view.voters.len() == STATIONS.len() && view.voters_lost.is_empty();
    // Only the coordinator itself reports its autopilot.
    let of_coordinator = |view: &WithProvenance<CoordinatorView>| view.content.autopilot.is_some();
    let WithProvenance { content, provenance } = query(bus, key, &Value::Null, of_coordinator).await?;
    content.node.clone().filter(|_| is_complete(&content)).map(|node| (node, provenance.term))
}

/// Waits for the event of a coordinator after `former`, and returns the time of its arrival.
async fn next_elected(events: &mut Stream<Sample>, former: &NodeId, term: u64) -> Option<Instant> {
    loop {
        let sample = events.recv().await?;
        match serde_json::from_slice::<Event>(&sample.payload) {
            Ok(Event { node, kind: EventKind::Elected { term: later, .. }, .. }) if later > term && node != *former => {
                return Some(Instant::now());
            }
            _ => {}
        }
    }
}

/// Requests a mission until it is acknowledged. Returns the time and the mission.
async fn acknowledged(fleet: &ProcessFleet, bus: &SharedBus, request: &Value) -> (Instant, MissionId) {
    let key = fleet.keys.write(&Key::Api(ApiCall::Submit));
    let mut tries = JoinSet::new();
    loop {
        let (bus, key, request) = (bus.clone(), key.clone(), request.clone());
        tries.spawn(async move {
            let reply = query(&bus, &key, &request, is_mission).await?;
            Some((Instant::now(), reply["mission"].as_str()?.parse().ok()?))
        });
        let first = async {
            loop {
                if let Some(Ok(Some(found))) = tries.join_next().await {
                    return found;
                }
                if tries.is_empty() {
                    std::future::pending::<()>().await;
                }
            }
        };
        if let Ok(found) = timeout(TRY_INTERVAL, first).await {
            return found;
        }
    }
}

/// Checks whether a reply acknowledges the request for a mission, or a change of it.
fn is_mission(reply: &Value) -> bool {
    reply["mission"].is_string()
}

/// Sends a query, and returns the first expected reply.
async fn query<T: DeserializeOwned>(
    bus: &SharedBus,
    key: &str,
    payload: &Value,
    is_expected: impl Fn(&T) -> bool,
) -> Option<T> {
    let payload = if payload.is_null() { vec![] } else { payload.to_string().into_bytes() };
    let mut replies = bus.query(key, payload.into(), QUERY_LIMIT).await.ok()?;
    while let Some(reply) = replies.recv().await {
        let value: Option<T> = reply.payload.ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
        if let Some(value) = value.filter(&is_expected) {
            return Some(value);
        }
    }
    None
}

fn text(figures: &TakeoverFigures) -> String {
    let row = |name: &str, times: &Option<Percentiles>| match times {
        Some(times) => format!("{name:<14} {:<6.0} {:<6.0} {:.0}", times.p50, times.p95, times.p99),
        None => format!("{name:<14} -"),
    };
    let [elected, commit] = [row("elected", &figures.elected_ms), row("first commit", &figures.first_commit_ms)];
    format!("ms             p50    p95    p99\n{elected}\n{commit}")
}

fn unsuccessful(problem: impl std::fmt::Display) -> Failure {
    Failure::Unsuccessful(problem.to_string())
}
