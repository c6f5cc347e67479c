//! A failing, crashing or stalling skill is retried before the role moves to another robot.

use crate::support::task_began;
use consort_protocol::event::EventKind;
use consort_skills::bt::{Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus};
use consort_skills::library::SkillLibrary;
use consort_skills::skill::TaskContext;
use consort_tests::{Fleet, RobotSpec, for_each_seed};
use std::cell::RefCell;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// Fault of an attempt.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum SkillFault {
    /// No fault.
    Passes,
    Fails,
    Crashes,
    Stalls,
}

thread_local! {
    /// Remaining faults of this thread, and so of this test only.
    static MISHAPS: RefCell<Vec<SkillFault>> = const { RefCell::new(vec![]) };
}

/// Leaf that injects the remaining faults and succeeds afterwards.
struct Stumble {
    stalled: bool,
}

impl Leaf for Stumble {
    fn tick(&mut self, _: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if self.stalled {
            return Ok(NodeStatus::Running);
        }
        match MISHAPS.with(|mishaps| mishaps.borrow_mut().pop()) {
            None | Some(SkillFault::Passes) => Ok(NodeStatus::Success),
            Some(SkillFault::Fails) => Err(Cause::new("no person is there")),
            Some(SkillFault::Crashes) => panic!("tripped over a cable"),
            Some(SkillFault::Stalls) => {
                self.stalled = true;
                Ok(NodeStatus::Running)
            }
        }
    }

    fn halt(&mut self, _: &mut LeafContext<'_, '_>) {
        self.stalled = false;
    }
}

/// Sets the faults of the next attempts, in order.
pub(super) fn set_faults(list: &[SkillFault]) {
    MISHAPS.with(|mishaps| *mishaps.borrow_mut() = list.iter().rev().copied().collect());
}

/// Makes drives fail at their end.
pub(super) fn fails_as_listed(library: &mut SkillLibrary) {
    let leaves = r#"<PlanRoute to="{to}" legs="{legs}"/>
        <LoopString queue="{legs}" value="{leg}" if_empty="SUCCESS"><NavigateToPose place="{leg}"/></LoopString>"#;
    inject_faults_after(library, &[("navigation", leaves)]);
}

/// Makes approaching a person or a robot fail at its end.
pub(super) fn fails_with_others(library: &mut SkillLibrary) {
    let person = r#"<FindPerson person_role="{person_role}" role="{role}"/><approach_person role="{role}"/>"#;
    let robot = r#"<FindRoleHolder role="{robot_role}" robot="{robot}"/><approach_robot robot="{robot}"/>"#;
    inject_faults_after(library, &[("approach_person", person), ("approach_robot", robot)]);
}

/// Replaces the trees of these skills by these leaves, followed by a fault.
fn inject_faults_after(library: &mut SkillLibrary, skills: &[(&str, &str)]) {
    library
        .extend(|registry| {
            let manifest = NodeManifest::new("Stumble", NodeKind::Action, []);
            registry.register(manifest, |_: &TaskContext| Box::new(Stumble { stalled: false }))
        })
        .expect("a name of its own");
    for (skill, leaves) in skills {
        let tree = format!(
            r#"<root BTCPP_format="4" main_tree_to_execute="{skill}">
            <BehaviorTree ID="{skill}"><Sequence>{leaves}<Stumble/></Sequence></BehaviorTree></root>"#
        );
        library.register_xml(skill.parse().expect("a slug"), "stumbling.xml", &tree).expect("a sound tree");
    }
}

fn retried(what: &EventKind) -> Option<(String, u8, String)> {
    match what {
        EventKind::TaskRetried { task, attempt, cause, .. } => Some((task.to_string(), *attempt, cause.clone())),
        _ => None,
    }
}

/// Injects a fault into the first drive and checks the reaction of the robot.
fn assert_retried_after(fault: SkillFault, cause: &'static str) {
    for_each_seed([201, 202], async |seed| {
        set_faults(&[fault]);
        let robots = vec![RobotSpec::carrier("gorse", "IC Room 4").with_library(fails_as_listed)];
        let mut fleet = Fleet::hospital(seed, robots, &["aster"], &[ROOM]).await;
        fleet.wait_for_coordinator().await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        let retries: Vec<_> = fleet.events().iter().filter_map(retried).collect();
        let context = format!("seed {seed}: {retries:?}\n{}", fleet.event_log_text());
        assert!(matches!(&retries[..], [(task, 1, why)] if task == "navto_room" && why.contains(cause)), "{context}");
        assert_eq!(fleet.task_counts(&mission)["navto_room"], (2, 1), "{context}");
        fleet.assert_sample_delivered(ROOM);
        let unwanted = |what: &EventKind| matches!(what, EventKind::TaskFailed { .. } | EventKind::Released { .. });
        assert!(!fleet.has_event(unwanted), "{context}");
    });
}

#[test]
fn a_failing_skill_is_retried() {
    assert_retried_after(SkillFault::Fails, "no person is there");
}

#[test]
fn a_crashing_skill_is_retried() {
    assert_retried_after(SkillFault::Crashes, "tripped over a cable");
}

#[test]
fn a_task_without_an_end_is_interrupted_and_retried() {
    assert_retried_after(SkillFault::Stalls, "not completed after");
}

#[test]
fn a_crash_of_a_skill_does_not_affect_its_robot() {
    for_each_seed([203, 204], async |seed| {
        set_faults(&[SkillFault::Crashes]);
        let robots = vec![RobotSpec::carrier("gorse", "IC Room 4").with_library(fails_as_listed)];
        let mut fleet = Fleet::hospital(seed, robots, &["aster"], &[ROOM, "PC Room 1"]).await;
        fleet.wait_for_coordinator().await;
        for (request, room) in [("a", ROOM), ("b", "PC Room 1")] {
            let mission = fleet.submit(request, room).await;
            fleet.assert_completes(&mission).await;
            assert_eq!(fleet.holder(&mission, "r1").expect("the holder").as_str(), "gorse", "seed {seed}");
            fleet.assert_sample_delivered(room);
        }
    });
}

#[test]
fn a_canceled_mission_leaves_robot_and_drawer_at_rest() {
    use consort_protocol::keys::ApiCall;
    use consort_world::world::WorldEvent as InWorld;
    // The mission is canceled during each of these tasks.
    for (number, task) in (0..).zip(["navto_room", "approach_nurse", "open_drawer_for_nurse", "close_drawer_nurse"]) {
        for_each_seed([210 + number], async |seed| {
            let robots = vec![RobotSpec::carrier("gorse", "IC Room 4")];
            let mut fleet = Fleet::hospital(seed, robots, &["aster"], &[ROOM]).await;
            fleet.wait_for_coordinator().await;
            let mission = fleet.submit("a", ROOM).await;
            let at_it = task_began(task);
            fleet.wait_until(task, SOON, |fleet| fleet.has_event(&at_it)).await;
            let answer =
                fleet.request_answered(ApiCall::Cancel, &serde_json::json!({ "mission": mission, "by": "test" })).await;
            let put_down = |what: &EventKind| matches!(what, EventKind::Halted { mission: of, .. } if *of == mission);
            fleet
                .wait_until(&format!("both to halt their roles ({answer})"), SOON, |fleet| {
                    fleet.event_log.count(put_down) == 2
                })
                .await;
            // A canceled goal ends within a network latency.
            let goals = |fleet: &Fleet| {
                fleet.journal().iter().fold((0, 0), |(began, ended), entry| match entry.event {
                    InWorld::GoalStarted { .. } => (began + 1, ended),
                    InWorld::GoalEnded { .. } => (began, ended + 1),
                    _ => (began, ended),
                })
            };
            let at_rest = |fleet: &Fleet| goals(fleet).0 == goals(fleet).1;
            fleet.wait_until("the robot to be at rest", Duration::from_secs(1), at_rest).await;
            let (place, begun) = (fleet.position("gorse"), goals(&fleet).0);
            fleet.assert_never("another goal", Duration::from_secs(10), |fleet| goals(fleet).0 != begun).await;
            assert_eq!(fleet.position("gorse"), place, "seed {seed}\n{}", fleet.event_log_text());
            // A drawer is open or closed: the interrupted goal had either no effect or its whole
            // effect.
            let opened =
                fleet.journal().iter().filter(|entry| matches!(entry.event, InWorld::DrawerMoved { .. })).count();
            let least = usize::from(task == "close_drawer_nurse");
            assert!(opened == least || opened == least + 1, "seed {seed}: {opened}\n{}", fleet.event_log_text());
            // With the sample in its drawer, a person must intervene first.
            let state = if least == 0 { "canceled" } else { "needs_intervention" };
            assert_eq!(fleet.state(&mission).as_deref(), Some(state), "seed {seed}\n{}", fleet.event_log_text());

            if state == "needs_intervention" {
                return; // and until then it is given nothing else
            }
            let next = fleet.submit("b", ROOM).await;
            fleet.assert_completes(&next).await;
            assert_eq!(fleet.holder(&next, "r1").expect("held").as_str(), "gorse", "seed {seed}: it wins again");
        });
    }
}
