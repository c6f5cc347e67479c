//! A seed determines a run.

use consort_bus::LinkModel;
use consort_protocol::event::EventKind;
use consort_tests::{Fleet, Observation, RobotSpec, for_each_seed};
use std::cell::RefCell;
use std::time::Duration;

/// Runs a mission over bad links with a takeover and a restart, in an open or a closed fleet.
async fn run(seed: u64, closed: bool) -> (Vec<(Duration, Observation)>, u64) {
    let robots = vec![
        RobotSpec::carrier("amber", "PC Room 8"),
        RobotSpec::carrier("birch", "IC Room 4"),
        RobotSpec::carrier("cedar", "Dock"),
    ];
    let mut fleet = match closed {
        true => Fleet::closed_hospital(seed, robots, &["aba", "abb"], &["IC Room 6"]).await,
        false => Fleet::hospital(seed, robots, &["aba", "abb"], &["IC Room 6"]).await,
    };
    fleet.network.set_link_model(LinkModel {
        loss: 0.01,
        duplication: 0.01,
        reordering: 0.01,
        reordering_delay: Duration::from_millis(20),
        ..LinkModel::LAN
    });
    fleet.wait_for_coordinator().await;
    let mission = fleet.submit("a", "IC Room 6").await;
    let began = |what: &EventKind| matches!(what, EventKind::TaskBegan { .. });
    fleet.wait_until("the first task", Duration::from_secs(60), |fleet| fleet.has_event(began)).await;
    fleet.kill("aba").await;
    fleet.wait_for_coordinator().await;
    fleet.start_station("aba").await;
    fleet.wait_for_end(&mission).await;
    (fleet.event_log.entries(), fleet.network.digest())
}

fn run_on_own_runtime(seed: u64, closed: bool) -> (Vec<(Duration, Observation)>, u64) {
    let runs = RefCell::new(vec![]);
    for_each_seed([seed], async |seed| {
        let outcome = run(seed, closed).await;
        runs.borrow_mut().push(outcome);
    });
    runs.into_inner().pop().expect("a single run")
}

#[test]
fn a_seed_determines_the_event_log_and_the_messages() {
    for (seed, closed) in [(1, false), (2, false), (3, false), (4, true)] {
        let (events, digest) = run_on_own_runtime(seed, closed);
        let (events_again, digest_again) = run_on_own_runtime(seed, closed);
        for (one, other) in events.iter().zip(&events_again) {
            assert_eq!(one, other, "seed {seed}: the first difference");
        }
        assert_eq!(events.len(), events_again.len(), "seed {seed}");
        assert_eq!(digest, digest_again, "seed {seed}");
    }
}

#[test]
fn another_seed_gives_another_run() {
    let runs: Vec<_> = (1..=3).map(|seed| run_on_own_runtime(seed, false)).collect();
    for (one, other) in [(0, 1), (0, 2), (1, 2)] {
        assert_ne!(runs[one].1, runs[other].1, "digests of seeds {} and {}", one + 1, other + 1);
        assert_ne!(runs[one].0, runs[other].0, "tales of seeds {} and {}", one + 1, other + 1);
    }
}
