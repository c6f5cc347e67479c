//! A panic in a skill affects nothing else.

use consort_protocol::event::EventKind;
use consort_skills::bt::{LeafContext, NodeKind, NodeManifest, SyncLeaf};
use consort_skills::library::SkillLibrary;
use consort_skills::skill::TaskContext;
use consort_tests::{Fleet, RobotSpec, for_each_seed};
use std::cell::Cell;

const ROOM: &str = "IC Room 6";

/// Makes approaching a person panic the first two times.
fn stumbles_twice(library: &mut SkillLibrary) {
    library
        .extend(|registry| {
            registry.register(NodeManifest::new("Stumble", NodeKind::Action, []), |_: &TaskContext| {
                Box::new(SyncLeaf(|_: &mut LeafContext<'_, '_>| {
                    let left = STUMBLES.with(|stumbles| stumbles.replace(stumbles.get().saturating_sub(1)));
                    assert_eq!(left, 0, "no person is there");
                    Ok(true)
                }))
            })
        })
        .expect("a name of its own");
    let tree = r#"<root BTCPP_format="4" main_tree_to_execute="approach_person">
        <BehaviorTree ID="approach_person"><Sequence>
            <Stumble/>
            <FindPerson person_role="{person_role}" role="{role}"/>
            <approach_person role="{role}"/>
        </Sequence></BehaviorTree></root>"#;
    library.register_xml("approach_person".parse().expect("a slug"), "stumbling.xml", tree).expect("a sound tree");
}

thread_local! {
    /// State of this thread, and so of this test only.
    static STUMBLES: Cell<u32> = const { Cell::new(0) };
}

#[test]
fn a_panicking_skill_costs_only_the_role_of_its_robot() {
    for_each_seed([101, 102], async |seed| {
        STUMBLES.with(|stumbles| stumbles.set(2));
        let robots = vec![
            RobotSpec::carrier("gorse", "IC Room 4").with_library(stumbles_twice),
            RobotSpec::carrier("fern", "Dock"),
        ];
        let mut fleet = Fleet::hospital(seed, robots, &["aster"], &[ROOM, "IC Room 5"]).await;
        fleet.wait_for_coordinator().await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        let causes: Vec<String> = fleet
            .events()
            .into_iter()
            .filter_map(|what| match what {
                EventKind::Released { cause, .. } => Some(cause),
                _ => None,
            })
            .collect();
        let [cause] = &causes[..] else { panic!("seed {seed}: {causes:?}\n{}", fleet.event_log_text()) };
        for part in ["gorse as r1 could not do approach_nurse", "crashed", "no person is there"] {
            assert!(cause.contains(part), "seed {seed}: {cause:?} without {part:?}");
        }
        let failed = |what: &EventKind| matches!(what, EventKind::TaskFailed { .. });
        let retried = |what: &EventKind| matches!(what, EventKind::TaskRetried { .. });
        let counts = (fleet.event_log.count(failed), fleet.event_log.count(retried));
        assert_eq!(counts, (1, 1), "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(fleet.holder(&mission, "r1").expect("the holder").as_str(), "fern", "seed {seed}");
        fleet.assert_exclusive_roles();
        fleet.assert_sample_delivered(ROOM);

        // The node is unaffected: the same robot takes the next mission and completes it.
        let next = fleet.submit("b", "IC Room 5").await;
        fleet.assert_completes(&next).await;
        assert_eq!(fleet.holder(&next, "r1").expect("the holder").as_str(), "gorse", "seed {seed}");
        fleet.assert_each_task_once(&next);
        fleet.assert_sample_delivered("IC Room 5");
    });
}
