//! The main job: a sample moves from a nurse to the laboratory.

use consort_tests::{Fleet, RobotSpec};

fn robots() -> Vec<RobotSpec> {
    vec![
        RobotSpec::carrier("amber", "PC Room 8"),
        RobotSpec::carrier("birch", "IC Room 4"),
        RobotSpec::carrier("cedar", "Dock"),
    ]
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_sample_moves_from_the_nurse_to_the_arm_in_the_laboratory() {
    let mut fleet = Fleet::hospital(1, robots(), &[], &["IC Room 6"]).await;
    fleet.wait_for_coordinator().await;
    let mission = fleet.submit("a", "IC Room 6").await;
    let end = fleet.wait_for_end(&mission).await;
    assert_eq!(end.as_str(), "completed", "{}", fleet.event_log_text());
    let samples = fleet.world.with(|world| world.samples());
    assert_eq!(samples[0].place.as_str(), "Laboratory");
    for (task, counts) in fleet.task_counts(&mission) {
        assert_eq!(counts, (1, 1), "{task} (begun, ended)\n{}", fleet.event_log_text());
    }
}
