//! From the end of the coordinator's process to the next coordinator: stations' processes on loopback over Zenoh.
//!
//! ```text
//! cargo bench -p consort --bench takeover [-- [--kill | --leave | --freeze] [--preset lan|wifi] [TIMES]]
//! ```
//!
//! The process gets SIGKILL (`--kill`, the default), is told to end and hands over (`--leave`), or stands still with all
//! its links open (`--freeze`, SIGSTOP). An onlooker, linked with a node to which nothing happens, takes the time from just
//! before that: `elected` until it hears the next coordinator say so, `acknowledged` until a mission that it submits again
//! and again is acknowledged, which is after its commit. A node that has ended stays away, so after two of five a new fleet is
//! started.

mod support;

use consort_actors::timing::Timing;
use consort_nodes::config::{FleetConfig, StationConfig, WorldConfig};
use consort_nodes::demo::{DemoFleet, DemoScenario};
use consort_protocol::event::EventKind;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{ApiCall, Key};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::process::ExitCode;
use std::time::Duration;
use support::{BenchError, Fleet, acknowledged, ask, figures, in_fleet, lab_samples, ms};
use tokio::task::JoinSet;
use tokio::time::{Instant, interval, sleep};

/// Nodes of a fleet; all of them keep the ledger.
const STATIONS: usize = 5;

/// Kills that such a fleet survives for certain.
const KILLS_PER_FLEET: usize = 2;

/// How long a takeover may take before the benchmark gives up.
const LIMIT: Duration = Duration::from_secs(10);

/// How often the client tries. Its requests bear one name, so only one of them counts.
const TRY_EVERY: Duration = Duration::from_millis(10);

/// What happens to the coordinator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Kill,
    Leave,
    Freeze,
}

fn main() -> ExitCode {
    let given: Vec<String> = std::env::args().collect();
    let is = |flag: &str| given.iter().any(|argument| argument == flag);
    let end = match () {
        () if is("--leave") => End::Leave,
        () if is("--freeze") => End::Freeze,
        () => End::Kill,
    };
    let timing = if is("wifi") { Timing::Wifi } else { Timing::Lan };
    support::main("takeover", measure(end, timing, support::count(60)))
}

async fn measure(end: End, timing: Timing, kills: usize) -> Result<Value, BenchError> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut elected, mut acknowledged) = (vec![], vec![]);
    while elected.len() < kills {
        let mut fleet = Fleet::start(&stations(timing)).await?;
        for _ in 0..KILLS_PER_FLEET.min(kills - elected.len()) {
            // At no fixed moment between two heartbeats, and after the last takeover has settled.
            sleep(Duration::from_millis(rng.random_range(800..1200))).await;
            let (first, second) = takeover(&mut fleet, end, elected.len()).await?;
            elected.push(first);
            acknowledged.push(second);
        }
        fleet.end().await;
    }
    let (end, timing) = (format!("{end:?}"), format!("{timing:?}"));
    let (elected, acknowledged) = (figures(elected), figures(acknowledged));
    Ok(json!({ "nodes": STATIONS, "end": end, "timing": timing, "elected": elected, "acknowledged": acknowledged }))
}

fn stations(timing: Timing) -> DemoScenario {
    let name = |number: usize| NodeId::new(format!("station-{number}")).expect("a slug");
    let stations = (1..=STATIONS).map(|number| StationConfig::new(name(number))).collect();
    let fleet = FleetConfig { bootstrap_expect: STATIONS, timing, ..FleetConfig::default() };
    let (world, robots, requests) = (WorldConfig::default(), vec![], vec![]);
    in_fleet(DemoScenario { fleet: fleet.clone(), world, robots, stations, requests }, fleet)
}

async fn takeover(fleet: &mut Fleet, end: End, number: usize) -> Result<(f64, f64), BenchError> {
    let deadline = Instant::now() + LIMIT;
    // On a busy machine a coordinator may doubt itself for a moment.
    let view = loop {
        match fleet.coordinator().await {
            Some(view) => break view,
            None if Instant::now() >= deadline => return Err("nobody coordinates".to_owned()),
            None => sleep(TRY_EVERY).await,
        }
    };
    let victim: NodeId = view["node"].as_str().and_then(|node| node.parse().ok()).ok_or("a coordinator has a name")?;
    let term = view["term"].as_u64().ok_or("a coordinator has a term")?;
    let killed = Instant::now();
    // A leaver is waited for later: what counts is when the next one takes over.
    let mut leaving = JoinSet::new();
    match end {
        End::Kill => fleet.stage.kill(&victim).await.map_err(|problem| problem.to_string())?,
        End::Freeze => fleet.stage.freeze(&victim).await.map_err(|problem| problem.to_string())?,
        End::Leave => {
            if let Some(ended) = fleet.stage.request_shutdown(&victim) {
                leaving.spawn(ended);
            }
        }
    }

    let (bus, key) = (fleet.stage.bus(), fleet.keys.write(&Key::Api(ApiCall::Submit)));
    let request = lab_samples(&format!("after-kill-{number}"), "IC Room 6");
    let submitting = tokio::spawn(async move {
        let (mut tries, mut beat) = (JoinSet::new(), interval(TRY_EVERY));
        loop {
            tokio::select! {
                Some(Ok(Some(at))) = tries.join_next() => return at,
                _ = beat.tick() => {
                    let (bus, key, request) = (bus.clone(), key.clone(), request.clone());
                    tries.spawn(async move {
                        let answer = ask(&bus, &key, &request, LIMIT).await;
                        acknowledged(answer.as_ref()).map(|_| Instant::now())
                    });
                }
            }
        }
    });
    let next = fleet.wait_for_event(format!("a coordinator after {victim}"), LIMIT, |event| match event.kind {
        EventKind::Elected { term: later, .. } if later > term && event.node != victim => Some(()),
        _ => None,
    });
    let ((), elected) = next.await?;
    let acknowledged = tokio::time::timeout(LIMIT, submitting).await;
    let acknowledged = acknowledged.map_err(|_| format!("no mission was acknowledged within {LIMIT:?}"))?;
    let acknowledged = acknowledged.map_err(|problem| problem.to_string())?;
    while leaving.join_next().await.is_some() {}
    Ok((ms(killed, elected), ms(killed, acknowledged)))
}
