//! Failover time of the coordinator: stations as processes on loopback over Zenoh.
//!
//! ```text
//! cargo bench -p consort --bench takeover [-- [--kill | --leave | --freeze] [--preset lan|wifi] [TIMES]]
//! ```
//!
//! The process of the coordinator receives SIGKILL (`--kill`, the default), is stopped gracefully
//! and transfers its leadership (`--leave`), or is frozen with all its links open (`--freeze`,
//! SIGSTOP). An observer, linked with an unaffected node, measures from just before that: `elected`
//! until it receives the event of the next coordinator, `acknowledged` until a mission that it
//! submits repeatedly is acknowledged, which is after its commit. A stopped node stays away, so a
//! new fleet is started after two of five nodes.

mod support;

use consort_nodes::config::{FleetConfig, StationConfig, WorldConfig};
use consort_nodes::demo::{DemoFleet, DemoScenario};
use consort_protocol::event::EventKind;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::timing::Timing;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::process::ExitCode;
use std::time::Duration;
use support::{BenchError, Fleet, acknowledged, figures, lab_samples, ms, query_json};
use tokio::task::JoinSet;
use tokio::time::{Instant, interval, sleep};

/// Nodes of a fleet; all of them store the ledger.
const STATIONS: usize = 5;

/// Kills that such a fleet certainly survives.
const KILLS_PER_FLEET: usize = 2;

/// Time limit of a takeover; the benchmark fails after it.
const LIMIT: Duration = Duration::from_secs(10);

/// Interval of the client's requests. All of them have the same id, so only a single request
/// counts.
const TRY_EVERY: Duration = Duration::from_millis(10);

/// The event that ends the coordinator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Kill,
    Leave,
    Freeze,
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let is = |flag: &str| arguments.iter().any(|argument| argument == flag);
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
            // At a random moment between two heartbeats, after the last takeover has settled.
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
    DemoScenario { fleet: fleet.clone(), world, robots, stations, requests }.in_fleet(fleet)
}

async fn takeover(fleet: &mut Fleet, end: End, number: usize) -> Result<(f64, f64), BenchError> {
    let deadline = Instant::now() + LIMIT;
    // On a busy machine a coordinator may lose contact to its voters for a moment.
    let view = loop {
        match fleet.coordinator().await {
            Some(view) => break view,
            None if Instant::now() >= deadline => return Err("no node coordinates".to_owned()),
            None => sleep(TRY_EVERY).await,
        }
    };
    let victim: NodeId = view["node"]
        .as_str()
        .and_then(|node| node.parse().ok())
        .ok_or("the view of the coordinator has no node name")?;
    let term = view["term"].as_u64().ok_or("the view of the coordinator has no term")?;
    let killed = Instant::now();
    // The graceful stop is awaited later: the time until the next takeover counts.
    let mut leaving = JoinSet::new();
    match end {
        End::Kill => fleet.processes.kill(&victim).await.map_err(|error| error.to_string())?,
        End::Freeze => fleet.processes.freeze(&victim).await.map_err(|error| error.to_string())?,
        End::Leave => {
            if let Some(ended) = fleet.processes.request_shutdown(&victim) {
                leaving.spawn(ended);
            }
        }
    }

    let (bus, key) = (fleet.processes.bus(), fleet.keys.write(&Key::Api(ApiCall::Submit)));
    let request = lab_samples(&format!("after-kill-{number}"), "IC Room 6");
    let submitting = tokio::spawn(async move {
        let (mut tries, mut ticker) = (JoinSet::new(), interval(TRY_EVERY));
        loop {
            tokio::select! {
                Some(Ok(Some(at))) = tries.join_next() => return at,
                _ = ticker.tick() => {
                    let (bus, key, request) = (bus.clone(), key.clone(), request.clone());
                    tries.spawn(async move {
                        let answer = query_json(&bus, &key, &request, LIMIT).await;
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
    let acknowledged = acknowledged.map_err(|error| error.to_string())?;
    while leaving.join_next().await.is_some() {}
    Ok((ms(killed, elected), ms(killed, acknowledged)))
}
