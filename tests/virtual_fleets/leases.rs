//! A role has one active holder at most, whatever the network does.

use crate::usual::{began, released};
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::lease::{Ending, LeaseTerms};
use consort_sim::world::{Happening as InWorld, JournalEntry};
use consort_skills::actions::Goal;
use consort_tests::{Fleet, Member, slug, tell};
use std::time::Duration;

const SEEDS: [u64; 3] = [81, 82, 83];
const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);
/// How often a robot looks after its lease.
const BEAT: Duration = Duration::from_millis(260);

fn suspended(what: &Happening) -> bool {
    matches!(what, Happening::Suspended { .. })
}

fn replaced(what: &Happening) -> bool {
    matches!(what, Happening::Halted { reason: Ending::Replaced, .. })
}

/// One of the two carriers is on its long way to the room, and has told nobody anything.
async fn under_way(seed: u64) -> (Fleet, MissionId) {
    with_clocks(seed, 1.0, [0.6, 0.7]).await
}

/// The same; the clocks of the carriers count so many seconds in one, all others are right.
async fn with_clocks(seed: u64, rate: f64, speeds: [f64; 2]) -> (Fleet, MissionId) {
    let [fern, gorse] = speeds;
    let robots =
        [Member::carrier("fern", "Dock").at_speed(fern), Member::carrier("gorse", "PC Room 8").at_speed(gorse)];
    let robots = robots.into_iter().map(|robot| robot.with_clock(rate)).collect();
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    assert_eq!(fleet.coordinator().await.as_str(), "aster", "seed {seed}: who coordinates");
    let mission = fleet.submit("a", ROOM).await;
    fleet.until("the way to the room", SOON, |fleet| fleet.happened(began("navto_room"))).await;
    (fleet, mission)
}

fn holder(fleet: &Fleet, mission: &MissionId) -> (String, String) {
    let holder = fleet.holder(mission, "r1").expect("held").to_string();
    let other = if holder == "gorse" { "fern" } else { "gorse" };
    (holder, other.to_owned())
}

/// Whether at some instant of the world both carriers drove, and when.
fn two_drove(fleet: &Fleet) -> Option<String> {
    let mut driving: Vec<(String, u64)> = vec![];
    let mut drives = 0;
    let mut clash = None;
    for JournalEntry { time, what } in fleet.journal() {
        match what {
            InWorld::GoalBegan { robot, id, goal: Goal::NavigateToPose { .. } } => {
                drives += 1;
                driving.push((robot.to_string(), id.0));
            }
            InWorld::GoalEnded { robot, id, .. } => driving.retain(|one| *one != (robot.to_string(), id.0)),
            _ => {}
        }
        let first = driving.first().map(|(robot, _)| robot);
        if driving.iter().any(|(robot, _)| Some(robot) != first) {
            clash.get_or_insert_with(|| format!("{driving:?} at {time:?}"));
        }
    }
    assert!(drives > 1, "seed {}: {drives} drives in the journal", fleet.seed);
    clash
}

/// Only the host of its body hears a robot any more, so that nothing but its own lease stops it.
fn leave_its_body_alone(fleet: &Fleet, robot: &str) {
    for node in fleet.running().iter().filter(|node| **node != robot && *node != "world") {
        let (robot, node) = (slug::<NodeId>(robot), slug::<NodeId>(node));
        fleet.network.cut(robot.clone(), node.clone());
        fleet.network.cut(node, robot);
    }
}

/// The holder suspends in time, the role goes to the other only afterwards, and only one ends the mission.
async fn replaced_in_time(fleet: &mut Fleet, mission: &MissionId, latest: Duration) {
    let seed = fleet.seed;
    let (old, new) = holder(fleet, mission);
    let cut = fleet.elapsed();
    fleet.until("the suspension", SOON, |fleet| fleet.happened(suspended)).await;
    let stopped = fleet.elapsed() - cut;
    assert!(stopped <= latest + BEAT, "seed {seed}: suspended only after {stopped:?}\n{}", fleet.tale());
    fleet.comes_to_rest(&old).await;
    let place = fleet.position(&old);
    fleet.until("the release", SOON, |fleet| fleet.happened(released)).await;
    assert!(fleet.chronicle.times(suspended) < fleet.chronicle.times(released), "seed {seed}\n{}", fleet.tale());
    fleet
        .until("the other to begin", SOON, |fleet| {
            fleet.spells_of(mission, "r1").last().is_some_and(|spell| spell.robot.as_str() == new)
        })
        .await;
    assert_eq!(fleet.position(&old), place, "seed {seed}: it stands still\n{}", fleet.tale());
    fleet.heal();
    fleet.until("the old holder to put its role down", SOON, |fleet| fleet.happened(replaced)).await;
    fleet.completes(mission).await;
    fleet.sample_delivered(ROOM);
    fleet.one_role_one_robot();
    assert_eq!(two_drove(fleet), None, "seed {seed}\n{}", fleet.tale());
    let doers = &fleet.chronicle.doers(mission)["navto_room"];
    assert_eq!(*doers, (vec![old, new.clone()], vec![new]), "seed {seed}\n{}", fleet.tale());
}

#[test]
fn a_robot_that_nobody_hears_suspends_and_is_replaced_only_then() {
    tell(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way(seed).await;
        let (old, _) = holder(&fleet, &mission);
        fleet.cut_off(&[&old]);
        replaced_in_time(&mut fleet, &mission, LeaseTerms::default().lease).await;
    });
}

#[test]
fn a_robot_that_still_reaches_its_body_stops_it_all_the_same() {
    tell(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way(seed).await;
        let (old, _) = holder(&fleet, &mission);
        leave_its_body_alone(&fleet, &old);
        replaced_in_time(&mut fleet, &mission, LeaseTerms::default().lease).await;
    });
}

#[test]
fn a_blackout_shorter_than_the_lease_is_survived_in_motion() {
    tell(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way(seed).await;
        let (old, _) = holder(&fleet, &mission);
        fleet.cut_off(&[&old]);
        fleet.never("a suspension", Duration::from_millis(2500), |fleet| fleet.happened(suspended)).await;
        fleet.heal();
        fleet.completes(&mission).await;
        fleet.each_task_once(&mission);
        fleet.sample_delivered(ROOM);
        assert!(!fleet.happened(suspended) && !fleet.happened(released), "seed {seed}\n{}", fleet.tale());
    });
}

#[test]
fn a_coordinator_cut_off_with_a_holder_stops_renewing_its_lease() {
    tell(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way(seed).await;
        let (old, _) = holder(&fleet, &mission);
        fleet.cut_off(&["aster", &old]);
        // It may renew for as long as it may believe that it leads.
        let terms = LeaseTerms::default();
        replaced_in_time(&mut fleet, &mission, terms.leadership_age_max() + terms.lease).await;
        let coordinator = fleet.coordinator().await;
        assert_ne!(coordinator.as_str(), "aster", "seed {seed}");
        let down = fleet.chronicle.count(|what| matches!(what, Happening::SteppedDown { .. }));
        assert_eq!(down, 1, "seed {seed}: the former coordinator knows\n{}", fleet.tale());
    });
}

/// How long a robot may take from the end of its lease until its body is at rest: its beat, and the crossing of the network
/// to its body.
const REACTION: Duration = Duration::from_millis(500);

#[test]
fn an_isolated_robots_body_is_at_rest_within_the_bound_on_drift_and_never_moves_before_it_was_confirmed() {
    let terms = LeaseTerms::default();
    let drift = terms.drift_max(REACTION);
    for (seed, rate) in [(84, 1.0), (85, 1.0 / (1.0 + drift)), (86, 1.0 + drift)] {
        tell([seed], async |seed| {
            let (mut fleet, mission) = with_clocks(seed, rate, [0.6, 0.7]).await;
            let (old, new) = holder(&fleet, &mission);
            leave_its_body_alone(&fleet, &old);
            let cut = fleet.elapsed();
            let at_rest = |fleet: &Fleet| fleet.goals_of(&old).0 == fleet.goals_of(&old).1;
            // Between two legs of its way it is at rest, too.
            fleet.until("the suspension", SOON, |fleet| fleet.happened(suspended)).await;
            fleet.until("its body to be at rest", SOON, at_rest).await;
            let rested = fleet.elapsed() - cut;
            let latest = terms.lease.mul_f64(1.0 + drift) + REACTION;
            assert!(rested <= latest, "seed {seed}: at rest only after {rested:?}\n{}", fleet.tale());
            assert!(!fleet.happened(released), "seed {seed}: given away before\n{}", fleet.tale());
            let goals = fleet.goals_of(&old);
            fleet
                .until("the other to be done with the room", SOON, |fleet| {
                    let done = &fleet.chronicle.doers(&mission)["navto_room"].1;
                    *done == [new.clone()]
                })
                .await;
            assert_eq!(fleet.goals_of(&old), goals, "seed {seed}: it never moved again\n{}", fleet.tale());
            assert_eq!(two_drove(&fleet), None, "seed {seed}\n{}", fleet.tale());
            fleet.heal();
            fleet.completes(&mission).await;
            fleet.sample_delivered(ROOM);
            fleet.one_role_one_robot();
        });
    }
}

#[test]
fn a_clock_far_beyond_the_bound_lets_two_drive_which_this_check_finds() {
    tell([87], async |seed| {
        let (mut fleet, mission) = with_clocks(seed, 0.3, [0.15, 0.16]).await;
        let (old, new) = holder(&fleet, &mission);
        leave_its_body_alone(&fleet, &old);
        fleet
            .until("the other to begin", SOON, |fleet| {
                fleet.spells_of(&mission, "r1").last().is_some_and(|spell| spell.robot.as_str() == new)
            })
            .await;
        fleet.until("two to drive", SOON, |fleet| two_drove(fleet).is_some()).await;
    });
}
