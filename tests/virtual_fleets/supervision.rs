//! A skill that panics takes nothing down with it.

use consort_protocol::event::Happening;
use consort_protocol::ledger::MissionState;
use consort_skills::bt::{Instant, LeafContext, Manifest, NodeKind};
use consort_skills::library::SkillLibrary;
use consort_skills::skill::TaskContext;
use consort_tests::{Fleet, Member, tell};
use std::sync::atomic::{AtomicBool, Ordering};

const ROOM: &str = "IC Room 6";

/// Approaching a person panics the first time.
fn stumbles_once(library: &mut SkillLibrary) {
    library
        .extend(|registry| {
            registry.register(Manifest::new("Stumble", NodeKind::Action, []), |_: &TaskContext| {
                Box::new(Instant(|_: &mut LeafContext<'_, '_>| {
                    assert!(STUMBLED.with(|stumbled| stumbled.swap(true, Ordering::Relaxed)), "nobody stands there");
                    Ok(true)
                }))
            })
        })
        .expect("a name of its own");
    let tree = r#"<root BTCPP_format="4" main_tree_to_execute="approach_person">
        <BehaviorTree ID="approach_person"><Sequence>
            <Stumble/>
            <FindPerson person_role="{person_role}" role="{role}"/>
            <ApproachPerson role="{role}"/>
        </Sequence></BehaviorTree></root>"#;
    library.register_xml("approach_person".parse().expect("a slug"), "stumbling.xml", tree).expect("a sound tree");
}

thread_local! {
    /// Of this thread, and so of this test, alone.
    static STUMBLED: AtomicBool = const { AtomicBool::new(false) };
}

#[test]
fn a_panicking_skill_fails_its_mission_with_the_cause_and_its_robot_bids_again() {
    tell([101, 102], async |seed| {
        STUMBLED.with(|stumbled| stumbled.store(false, Ordering::Relaxed));
        let robots = vec![Member::carrier("gorse", "IC Room 4").trained(stumbles_once)];
        let mut fleet = Fleet::hospital(seed, robots, &["aster"], &[ROOM]).await;
        fleet.coordinator().await;
        let mission = fleet.submit("a", ROOM).await;
        let MissionState::Failed { cause } = fleet.end_of(&mission).await else {
            panic!("seed {seed}: it ended otherwise\n{}", fleet.tale())
        };
        for part in ["gorse as r1 could not do approach_nurse", "crashed", "nobody stands there"] {
            assert!(cause.contains(part), "seed {seed}: {cause:?} without {part:?}");
        }
        let failed = |what: &Happening| matches!(what, Happening::TaskFailed { .. });
        assert_eq!(fleet.chronicle.count(failed), 1, "seed {seed}\n{}", fleet.tale());

        // The node has not noticed: the same robot takes the next mission and carries it out.
        let next = fleet.submit("b", ROOM).await;
        fleet.completes(&next).await;
        assert_eq!(fleet.holder(&next, "r1").expect("who did it").as_str(), "gorse", "seed {seed}");
        fleet.each_task_once(&next);
        fleet.sample_delivered(ROOM);
    });
}
