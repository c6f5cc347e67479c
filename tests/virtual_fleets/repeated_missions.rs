//! Consecutive missions.

use consort_protocol::event::EventKind;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec};

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_robot_that_has_finished_wins_again_at_once() {
    for seed in 1..=5 {
        let robots = vec![RobotSpec::carrier("ada", "Dock")];
        let mut fleet = Fleet::hospital(seed, robots, &["station"], &["IC Room 1", "PC Room 1"]).await;
        for (number, room) in [(1, "IC Room 1"), (2, "PC Room 1")] {
            let mission = fleet.submit(&format!("request-{number}"), room).await;
            assert_eq!(
                fleet.wait_for_end(&mission).await,
                MissionState::Completed,
                "seed {seed}\n{}",
                fleet.event_log_text()
            );
        }
        let events = fleet.events();
        let releases = events.iter().filter(|what| matches!(what, EventKind::Released { .. })).count();
        let awards = events.iter().filter(|what| matches!(what, EventKind::Awarded { .. })).count();
        assert_eq!((awards, releases), (2, 0), "seed {seed}\n{}", fleet.event_log_text());
    }
}
