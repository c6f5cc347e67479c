//! Support for the tests of virtual fleets.

use consort_protocol::event::EventKind;
use consort_tests::{Fleet, RobotSpec};

/// Starts two carriers and three stations; `aster` coordinates.
pub(crate) async fn fleet(seed: u64, room: &'static str) -> Fleet {
    let robots = vec![RobotSpec::carrier("fern", "Dock"), RobotSpec::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[room]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the first coordinator");
    fleet
}

/// Matches the start of a task.
pub(crate) fn task_began(task: &str) -> impl Fn(&EventKind) -> bool {
    move |what| matches!(what, EventKind::TaskBegan { task: of, .. } if of.as_str() == task)
}

/// Matches the release of a role.
pub(crate) fn released(what: &EventKind) -> bool {
    release_reason(what).is_some()
}

/// Returns the released role and the cause.
pub(crate) fn release_reason(what: &EventKind) -> Option<String> {
    match what {
        EventKind::Released { role, cause, .. } => Some(format!("{role}: {cause}")),
        _ => None,
    }
}
