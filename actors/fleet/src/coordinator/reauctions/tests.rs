use super::super::rounds::{AuctionRound, RoundPhase};
use super::super::test_ledger::Log;
use super::*;
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::{MissionChange, OrderRequest};

/// A session with promises, at a time.
#[derive(Default)]
struct Session {
    reauctions: Reauctions,
    rounds: Rounds,
    now: NodeTime,
}

impl Session {
    /// Returns the mission of the call that is due after this number of seconds, and whether its promise is late. The time
    /// of day is the time of the session.
    fn due_after(&mut self, seconds: u64, ledger: &Ledger) -> Option<(MissionId, bool)> {
        self.now = self.now + Duration::from_secs(seconds);
        let terms = PromiseTerms { late_max: Seconds::new(100.0).unwrap(), ..PromiseTerms::default() };
        let confirmed_ms = Some(self.now.as_millis());
        let due = self.reauctions.due(ledger, &self.rounds, &terms, self.now, confirmed_ms)?;
        Some((due.promised.mission, due.is_late))
    }
}

/// Promises the arm of two missions. The arm holds a role of a third.
fn promises() -> (Log, MissionId, MissionId) {
    let mut log = Log::default();
    let held = log.add_mission("cyd");
    log.end_cart(&held);
    let role: RoleId = "arm".parse().unwrap();
    let epoch = log.0.mission(&held).unwrap().role_robots()[&role].epoch;
    log.apply(Command::AwardPromised { mission: held, role, epoch });
    let (first, second) = (log.add_mission("ada"), log.add_mission("bob"));
    (log, first, second)
}

#[test]
fn promises_are_auctioned_again_one_by_one() {
    let (log, first, second) = promises();
    let mut session = Session::default();
    assert_eq!(session.due_after(0, &log.0), None);
    assert_eq!(session.due_after(29, &log.0), None);
    assert_eq!(session.due_after(1, &log.0), Some((first.clone(), false)));
    assert_eq!(session.due_after(0, &log.0), None, "one call a second");
    assert_eq!(session.due_after(1, &log.0), Some((second, false)));
    assert_eq!(session.due_after(1, &log.0), None);
    assert_eq!(session.due_after(28, &log.0), None, "the interval doubles");
    assert_eq!(session.due_after(30, &log.0), Some((first, false)));
}

#[test]
fn a_role_that_could_have_started_for_too_long_is_late_and_comes_first() {
    let (mut log, first, second) = promises();
    let mut session = Session::default();
    assert_eq!(session.due_after(0, &log.0), None);
    log.end_cart(&second);
    assert_eq!(session.due_after(60, &log.0), Some((second.clone(), false)), "it can start");
    assert_eq!(session.due_after(1, &log.0), Some((first, false)));
    assert_eq!(session.due_after(98, &log.0).map(|(_, is_late)| is_late), Some(false));
    assert_eq!(session.due_after(31, &log.0), Some((second, true)));
}

#[test]
fn only_late_promises_are_auctioned_beside_other_roles_of_the_mission() {
    let (mut log, first, second) = promises();
    log.end_cart(&second);
    let round = AuctionRound::first(RoundPhase::BackingOff { until: NodeTime::ZERO, since: NodeTime::ZERO });
    let rounds = [first, second.clone()].map(|mission| (mission, round.clone())).into_iter().collect();
    let mut session = Session { rounds, ..Session::default() };
    assert_eq!([0, 99].map(|seconds| session.due_after(seconds, &log.0)), [None, None]);
    assert_eq!(session.due_after(1, &log.0), Some((second, true)));
}

#[test]
fn a_free_robot_shortens_the_intervals_of_roles_that_others_could_get() {
    let (log, first, second) = promises();
    let mut session = Session::default();
    assert_eq!(session.due_after(0, &log.0), None);
    for seconds in [30, 60] {
        assert_eq!(session.due_after(seconds, &log.0), Some((first.clone(), false)));
        assert_eq!(session.due_after(1, &log.0), Some((second.clone(), false)));
    }
    let (entry, role, promise) = log.0.promises_in_order().remove(1);
    session.reauctions.note_rival(&AwardedRole::of(entry, role, promise), true);
    session.reauctions.shorten_intervals();
    assert_eq!(session.due_after(29, &log.0), None);
    assert_eq!(session.due_after(1, &log.0), Some((second, false)));
    assert_eq!(session.due_after(1, &log.0), None, "only the arm could do the other role");
}

#[test]
fn late_promises_leave_calls_to_others() {
    let (mut log, first, second) = promises();
    log.end_cart(&second);
    let mut session = Session::default();
    assert_eq!(session.due_after(0, &log.0), None);
    let called = [100, 1, 29, 31].map(|seconds| session.due_after(seconds, &log.0));
    let (late, other) = (Some((second, true)), Some((first, false)));
    assert_eq!(called, [late.clone(), other.clone(), late, other]);
}

#[test]
fn the_roles_of_a_free_robot_are_auctioned_again_while_it_charges() {
    let mut log = Log::default();
    let usual = log.add_mission("ada");
    log.end_cart(&usual);
    let called = |log: &Log| {
        let mut session = Session::default();
        [0, 30, 1].map(|seconds| session.due_after(seconds, &log.0))
    };
    assert_eq!(called(&log), [None, None, None], "the robot is about to get it");
    let charging = log.add_mission_after_charging("bob", 0.8);
    log.end_cart(&charging);
    let both = [None, Some((usual, false)), Some((charging, false))];
    assert_eq!(called(&log), both, "another robot may do them now");
}

#[test]
fn each_change_of_a_role_makes_the_next_harder() {
    let (mut log, first, second) = promises();
    for robot in ["lab-arm-2", "lab-arm"] {
        log.pass_arm(&first, robot);
    }
    let mut session = Session::default();
    assert_eq!(session.due_after(0, &log.0), None);
    for seconds in [30, 60] {
        assert_eq!(session.due_after(seconds, &log.0), Some((second.clone(), false)));
    }
    assert_eq!(session.due_after(29, &log.0), None);
    assert_eq!(session.due_after(1, &log.0), Some((first.clone(), false)), "the interval was doubled twice");
    log.end_cart(&first);
    assert_eq!(session.due_after(0, &log.0), None);
    assert_eq!(session.due_after(90, &log.0), Some((second, false)));
    assert_eq!(session.due_after(150, &log.0), Some((first.clone(), false)), "240 s are less than 3 times 100 s");
    assert_eq!(session.due_after(60, &log.0), Some((first, true)));
}

#[test]
fn a_role_passes_for_a_gain_that_rises_with_each_change() {
    let promised = AwardedRole {
        mission: "bring-1".parse().unwrap(),
        role: "arm".parse().unwrap(),
        robot: "lab-arm".parse().unwrap(),
        epoch: Epoch::default(),
    };
    let passes_to = |changes, is_late, standing| {
        let (reauction, start) = (Reauction { promised: promised.clone(), is_late, changes }, Seconds::ZERO);
        cause_of_change(&reauction, &"lab-arm-2".parse().unwrap(), standing, start, &PromiseTerms::default())
    };
    let passes = |changes, is_late, gain_s: Option<f64>| {
        let standing = gain_s.map_or(FormerStanding::Unknown, |gain_s| FormerStanding::Costs { gain_s });
        passes_to(changes, is_late, standing).is_some()
    };
    assert!(passes(0, false, Some(60.0)) && !passes(0, false, Some(59.0)) && !passes(0, false, None));
    assert!(!passes(2, false, Some(179.0)) && passes(2, false, Some(180.0)));
    assert!(passes(2, true, None) && passes(2, true, Some(-10.0)), "it is late");
    let unsuited = RefusalReason::MissingSkills { skills: vec!["wait".parse().unwrap()] };
    let cause = passes_to(2, false, FormerStanding::Unsuited(&unsuited));
    assert_eq!(cause.as_deref(), Some("lab-arm: lacks wait"));
}

#[test]
fn the_promise_of_a_free_robot_that_can_start_is_not_auctioned() {
    let mut log = Log::default();
    let mission = log.add_mission("ada");
    log.end_cart(&mission);
    let mut session = Session::default();
    assert_eq!([0, 60].map(|seconds| session.due_after(seconds, &log.0)), [None, None]);
}

#[test]
fn the_promise_of_a_pinned_role_is_not_auctioned() {
    let (mut log, first, second) = promises();
    log.apply(Command::first_wire_version(3));
    let change = MissionChange::Pin { role: "arm".parse().unwrap(), robot: Some("lab-arm".parse().unwrap()) };
    let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 1, request: None };
    log.apply(Command::ChangeMission { mission: first, order });
    let mut session = Session::default();
    assert_eq!(session.due_after(0, &log.0), None);
    assert_eq!(session.due_after(30, &log.0), Some((second, false)));
    assert_eq!(session.due_after(1, &log.0), None);
}
