//! Time from the commit of a request to the commit of its award: processes of ten robots, an arm
//! and the world on loopback over Zenoh, missions one after another. Each mission is canceled once
//! it is awarded.
//!
//! ```text
//! cargo bench -p consort --bench auction [-- MISSIONS]
//! ```
//!
//! `award` is the coordinator's own measurement. `seen` is the client's measurement, from sending
//! the request to receiving the award.

mod support;

use consort_nodes::demo::{DemoFleet, DemoScenario};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::keys::{ApiCall, Key};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::process::ExitCode;
use std::time::Duration;
use support::{BenchError, Fleet, QUERY_TIMEOUT, acknowledged, figures, lab_samples, ms, query_json};
use tokio::time::Instant;

/// Mobile robots.
const ROBOTS: usize = 10;

/// Time limit of an award; the benchmark fails after it.
const LIMIT: Duration = Duration::from_secs(10);

/// Rooms of the nurse.
const ROOMS: [&str; 4] = ["IC Room 6", "PC Room 3", "IC Room 2", "PC Room 8"];

fn main() -> ExitCode {
    support::main("auction", measure(support::count(100)))
}

async fn measure(missions: usize) -> Result<Value, BenchError> {
    let scenario = DemoScenario::new(ROBOTS, 1, 1.0, 1);
    // The default ensemble: every robot with any skill. So all of them receive the call and
    // respond.
    let fleet = consort_nodes::config::FleetConfig { ensemble: vec![], ..scenario.fleet.clone() };
    let mut fleet = Fleet::start(&scenario.in_fleet(fleet)).await?;
    let measured = measure_in(&mut fleet, missions).await;
    let unexpected_exit = fleet.processes.unexpected_exit();
    fleet.end().await;
    unexpected_exit.map_or(measured, Err)
}

/// The figures of a mission, in milliseconds.
struct Sample {
    asked: usize,
    rounds: u32,
    acknowledged: f64,
    award: f64,
    seen: f64,
}

async fn measure_in(fleet: &mut Fleet, missions: usize) -> Result<Value, BenchError> {
    // Not counted: the coordinator may not have a record of every robot yet, and caches are cold.
    let mut warm = 0;
    for number in 0.. {
        let sample = award_one_mission(fleet, &format!("warm-up-{number}"), ROOMS[0]).await?;
        warm = if sample.asked > ROBOTS { warm + 1 } else { 0 };
        if warm >= 5 {
            break;
        }
        if number >= 100 {
            return Err(format!("after {number} missions the coordinator calls only {} robots", sample.asked));
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    let mut samples = vec![];
    for (number, room) in (0..missions).zip(ROOMS.into_iter().cycle()) {
        samples.push(award_one_mission(fleet, &format!("bench-{number}"), room).await?);
    }
    let of = |pick: fn(&Sample) -> f64| figures(samples.iter().map(pick).collect());
    Ok(json!({
        "robots": ROBOTS,
        "asked_min": samples.iter().map(|sample| sample.asked).min(),
        "rounds_max": samples.iter().map(|sample| sample.rounds).max(),
        "award": of(|sample| sample.award),
        "acknowledged": of(|sample| sample.acknowledged),
        "seen": of(|sample| sample.seen),
    }))
}

/// Has a mission awarded and cancels it.
async fn award_one_mission(fleet: &mut Fleet, request: &str, room: &str) -> Result<Sample, BenchError> {
    let started_at = Instant::now();
    let answer = api(fleet, ApiCall::Submit, &lab_samples(request, room)).await;
    let mission = acknowledged(answer.as_ref()).ok_or_else(|| format!("{request} was not acknowledged: {answer:?}"))?;
    let acknowledged_ms = ms(started_at, Instant::now());
    let (mut asked, mut rounds) = (0, 0);
    let awarded = fleet.wait_for_event(format!("the award of {mission}"), LIMIT, |event| match event.kind {
        EventKind::BidsRequested { mission: of, asked: number, round, .. } if of == mission => {
            (asked, rounds) = (number, round);
            None
        }
        EventKind::Awarded { mission: of, holders, after_ms, .. } if of == mission => {
            Some((holders.into_values().collect::<BTreeSet<RobotId>>(), after_ms))
        }
        _ => None,
    });
    let ((holders, after_ms), at) = awarded.await?;
    let award = after_ms.ok_or("the award event has no duration")?;
    cancel_mission(fleet, &mission, holders).await?;
    Ok(Sample { asked, rounds, acknowledged: acknowledged_ms, award, seen: ms(started_at, at) })
}

/// Cancels a mission once its robots have begun, and waits until they are free again: the next
/// mission needs the arm.
async fn cancel_mission(fleet: &mut Fleet, mission: &MissionId, holders: BTreeSet<RobotId>) -> Result<(), BenchError> {
    let started_at = |what: &EventKind| matches!(what, EventKind::Started { mission: of, .. } if of == mission);
    wait_for_all(fleet, format!("the beginning of {mission}"), holders.clone(), started_at).await?;
    let answer = api(fleet, ApiCall::Cancel, &json!({ "mission": mission, "by": "bench" })).await;
    if answer.as_ref().is_none_or(|answer| answer.get("error").is_some()) {
        return Err(format!("{mission} was not canceled: {answer:?}"));
    }
    let halted = |what: &EventKind| matches!(what, EventKind::Halted { mission: of, .. } if of == mission);
    wait_for_all(fleet, format!("the end of {mission}"), holders, halted).await
}

/// Waits until each of the robots has published a matching event.
async fn wait_for_all(
    fleet: &mut Fleet,
    what: String,
    mut robots: BTreeSet<RobotId>,
    matches_event: impl Fn(&EventKind) -> bool,
) -> Result<(), BenchError> {
    let all = fleet.wait_for_event(what, LIMIT, |event| {
        if matches_event(&event.kind) {
            robots.remove(&RobotId::from(event.node));
        }
        robots.is_empty().then_some(())
    });
    all.await.map(|_| ())
}

/// Sends a request to the coordinator.
async fn api(fleet: &Fleet, call: ApiCall, request: &Value) -> Option<Value> {
    query_json(&fleet.processes.bus(), &fleet.keys.write(&Key::Api(call)), request, QUERY_TIMEOUT).await
}
