//! What many stories are told with.

use consort_protocol::event::Happening;
use consort_tests::{Fleet, Member};

/// Two carriers and three stations, of which `aster` coordinates.
pub(crate) async fn fleet(seed: u64, room: &'static str) -> Fleet {
    let robots = vec![Member::carrier("fern", "Dock"), Member::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[room]).await;
    assert_eq!(fleet.coordinator().await.as_str(), "aster", "seed {seed}: who coordinates first");
    fleet
}

/// Whether somebody began this task.
pub(crate) fn began(task: &str) -> impl Fn(&Happening) -> bool {
    move |what| matches!(what, Happening::TaskBegan { task: of, .. } if of.as_str() == task)
}

/// Whether a role was taken from its robot.
pub(crate) fn released(what: &Happening) -> bool {
    why_released(what).is_some()
}

/// Which role was taken from its robot, and why.
pub(crate) fn why_released(what: &Happening) -> Option<String> {
    match what {
        Happening::Released { role, cause, .. } => Some(format!("{role}: {cause}")),
        _ => None,
    }
}
