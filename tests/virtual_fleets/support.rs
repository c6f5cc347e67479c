//! What many stories are told with.

use consort_protocol::event::EventKind;
use consort_tests::{Fleet, RobotSpec};

/// Two carriers and three stations, of which `aster` coordinates.
pub(crate) async fn fleet(seed: u64, room: &'static str) -> Fleet {
    let robots = vec![RobotSpec::carrier("fern", "Dock"), RobotSpec::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[room]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: who coordinates first");
    fleet
}

/// Whether somebody began this task.
pub(crate) fn task_began(task: &str) -> impl Fn(&EventKind) -> bool {
    move |what| matches!(what, EventKind::TaskBegan { task: of, .. } if of.as_str() == task)
}

/// Whether a role was taken from its robot.
pub(crate) fn released(what: &EventKind) -> bool {
    release_reason(what).is_some()
}

/// Which role was taken from its robot, and why.
pub(crate) fn release_reason(what: &EventKind) -> Option<String> {
    match what {
        EventKind::Released { role, cause, .. } => Some(format!("{role}: {cause}")),
        _ => None,
    }
}
