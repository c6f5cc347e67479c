//! The main job: a sample goes from a nurse to the laboratory.

use consort_tests::{Fleet, Member};

fn robots() -> Vec<Member> {
    vec![Member::carrier("amber", "PC Room 8"), Member::carrier("birch", "IC Room 4"), Member::carrier("cedar", "Dock")]
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_sample_is_fetched_from_the_nurse_and_ends_with_the_arm_in_the_laboratory() {
    let mut fleet = Fleet::hospital(1, robots(), &[], &["IC Room 6"]).await;
    fleet.coordinator().await;
    let mission = fleet.submit("a", "IC Room 6").await;
    let end = fleet.end_of(&mission).await;
    assert_eq!(end.word(), "completed", "{}", fleet.tale());
    let samples = fleet.world.with(|world| world.samples());
    assert_eq!(samples[0].place.as_str(), "Laboratory");
    for (task, counts) in fleet.tasks(&mission) {
        assert_eq!(counts, (1, 1), "{task} (begun, ended)\n{}", fleet.tale());
    }
}
