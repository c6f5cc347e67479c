use super::*;

fn at(ms: u64) -> NodeTime {
    NodeTime::at(Duration::from_millis(ms))
}

fn award(index: u64) -> Award {
    let role = RoleId::new("r1").unwrap();
    Award {
        mission: MissionId::new("m1").unwrap(),
        role: role.clone(),
        robot: RobotId::new("ada").unwrap(),
        epoch: Epoch { term: 1, index },
        plan: LocalPlan::of(role, vec![]),
        holders: BTreeMap::new(),
    }
}

fn tenure() -> RoleLease {
    RoleLease::new(RobotId::new("ada").unwrap(), LeaseTerms::default())
}

fn renewed(index: u64, sent: u64) -> Event {
    Event::Renewed { epoch: Epoch { term: 1, index }, sent: at(sent), ended: BTreeSet::new() }
}

#[test]
fn an_award_begins_only_once_the_coordinator_has_confirmed_it() {
    let mut ada = tenure();
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(5))), at(0)), [Action::Report]);
    assert!(!ada.may_act(at(1)));
    assert_eq!(ada.handle(renewed(5, 10), at(20)), [Action::Start(Box::new(award(5)), BTreeSet::new())]);
    assert!(ada.may_act(at(20)));
}

#[test]
fn the_lease_counts_from_when_the_report_was_sent() {
    let mut ada = tenure();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    ada.handle(renewed(5, 10), at(3000));
    assert!(ada.may_act(at(4009)));
    assert!(!ada.may_act(at(4010)));
    assert_eq!(ada.handle(Event::Tick, at(4010)), [Action::Suspend]);
    assert_eq!(ada.handle(Event::Tick, at(5000)), []);
    assert_eq!(ada.handle(renewed(5, 4900), at(5000)), [Action::Resume]);
}

#[test]
fn an_answer_that_took_longer_than_the_lease_renews_nothing() {
    let mut ada = tenure();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    assert_eq!(ada.handle(renewed(5, 10), at(4010)), []);
    assert!(!ada.may_act(at(4010)));
}

#[test]
fn an_older_epoch_is_somebody_elses_role_by_now() {
    let mut ada = tenure();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    assert_eq!(ada.check_award(&award(4)), Err(DeclineReason::Stale { known: Epoch { term: 1, index: 5 } }));
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(4))), at(1)), []);
    assert_eq!(ada.handle(renewed(4, 0), at(1)), []);
}

#[test]
fn what_comes_under_an_older_epoch_changes_nothing() {
    let old = Epoch { term: 1, index: 4 };
    let acting = || {
        let mut ada = tenure();
        ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
        ada.handle(renewed(5, 0), at(1));
        ada
    };
    let suspended = || {
        let mut ada = acting();
        assert_eq!(ada.handle(Event::Tick, at(4000)), [Action::Suspend]);
        ada
    };
    let recalled = || RoleLease::restore(RobotId::new("ada").unwrap(), LeaseTerms::default(), award(5));
    for (name, make) in
        [("acting", &acting as &dyn Fn() -> RoleLease), ("suspended", &suspended), ("recalled", &recalled)]
    {
        let events = [
            Event::AwardReceived(Box::new(award(4))),
            renewed(4, 4000),
            Event::Revoked { epoch: old, reason: EndReason::Released },
            Event::Settled { epoch: old },
        ];
        for event in events {
            let mut ada = make();
            let (acts, held_up, until) = (ada.may_act(at(2000)), ada.is_suspended(), ada.expires_at());
            assert_eq!(ada.handle(event.clone(), at(4001)), [], "{name}: {event:?}");
            assert_eq!(ada.award().map(|award| award.epoch.index), Some(5), "{name}: {event:?}");
            assert_eq!((ada.may_act(at(2000)), ada.is_suspended(), ada.expires_at()), (acts, held_up, until), "{name}");
        }
    }
}

#[test]
fn a_robot_that_never_acted_has_nothing_to_halt() {
    let mut ada = tenure();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    assert_eq!(
        ada.handle(Event::Revoked { epoch: Epoch { term: 1, index: 5 }, reason: EndReason::Canceled }, at(1)),
        []
    );
    assert_eq!(ada.award(), None);
    assert_eq!(ada.handle(renewed(5, 0), at(2)), [], "the word that it no longer holds it was faster");
}

/// Whether, at any instant, the old holder may act while a later coordinator finds its lease over. The robot and the
/// coordinator that answered it have the slowest clocks; the other's counts `1 + drift` times as fast, and it took over
/// as early as it could. A robot is at rest `reaction` after the end of its lease.
fn overlaps(terms: LeaseTerms, drift: f64, reaction: Duration) -> bool {
    let (epoch, robot) = (Epoch { term: 1, index: 5 }, RobotId::new("ada").unwrap());
    let (mut ada, mut watch) = (RoleLease::new(robot.clone(), terms), LeaseMonitor::new(terms));
    let slow = |us: u64| NodeTime::at(Duration::from_micros(us));
    let fast = |us: u64| NodeTime::at(Duration::from_micros(us).mul_f64(1.0 + drift));
    let answered = u64::try_from(terms.leadership_age_max().as_micros()).unwrap();
    watch.track(epoch, &robot, fast(0));
    ada.handle(Event::AwardReceived(Box::new(award(5))), slow(answered));
    ada.handle(Event::Renewed { epoch, sent: slow(answered), ended: BTreeSet::new() }, slow(answered));
    let reaction = u64::try_from(reaction.as_micros()).unwrap();
    let instants = (0..20_000_000).step_by(1_000);
    let mut both =
        instants.filter(|us| ada.may_act(slow(us - reaction.min(*us))) && watch.has_expired(epoch, &robot, fast(*us)));
    both.next().is_some()
}

#[test]
fn clocks_that_drift_within_the_bound_never_let_two_act_and_beyond_it_they_do() {
    let seconds = Duration::from_secs_f64;
    let default = LeaseTerms::default();
    assert!((default.drift_max(seconds(0.5)) - 1.0 / 11.0).abs() < 1e-12);
    for terms in [default, LeaseTerms { lease: seconds(10.0), grace: seconds(3.0) }] {
        for reaction in [0.0, 0.25, 0.5].map(seconds) {
            let bound = terms.drift_max(reaction);
            assert!(!overlaps(terms, bound, reaction), "{terms:?} {bound}");
            assert!(overlaps(terms, bound + 0.01, reaction), "{terms:?}: the bound is tight");
            assert!(overlaps(terms, 1.0, reaction), "{terms:?}");
        }
    }
    assert_eq!(default.drift_max(seconds(1.5)), 0.0, "the grace does not even cover the reaction");
}

#[test]
fn a_newer_award_of_the_same_role_replaces_the_old_one() {
    let mut ada = tenure();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    ada.handle(renewed(5, 0), at(1));
    let actions = ada.handle(Event::AwardReceived(Box::new(award(6))), at(2));
    assert_eq!(actions, [Action::Halt(EndReason::Replaced), Action::Report]);
    assert!(!ada.may_act(at(2)));
}

#[test]
fn an_echo_of_a_settled_award_is_not_begun_again() {
    let mut ada = tenure();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    ada.handle(renewed(5, 0), at(1));
    ada.handle(Event::Settled { epoch: Epoch { term: 1, index: 5 } }, at(2));
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(5))), at(3)), []);
    assert_eq!(ada.award(), None);
}

#[test]
fn an_award_of_a_former_life_waits_for_the_coordinators_word_however_long_that_takes() {
    let recalled = || RoleLease::restore(RobotId::new("ada").unwrap(), LeaseTerms::default(), award(5));
    let mut ada = recalled();
    assert_eq!(ada.handle(Event::Tick, at(60_000)), []);
    assert!(!ada.may_act(at(0)) && ada.expires_at().is_none());
    assert_eq!(ada.award().map(|award| award.epoch), Some(Epoch { term: 1, index: 5 }));
    let actions = ada.handle(renewed(5, 60_000), at(60_010));
    assert_eq!(actions, [Action::Start(Box::new(award(5)), BTreeSet::new())]);
    assert!(ada.may_act(at(60_010)));

    let mut ada = recalled();
    let revoked = Event::Revoked { epoch: Epoch { term: 1, index: 5 }, reason: EndReason::Released };
    assert_eq!(ada.handle(revoked, at(10)), [Action::Halt(EndReason::Released)]);
    assert_eq!(ada.award(), None);

    let mut ada = recalled();
    assert!(matches!(ada.check_award(&award(4)), Err(DeclineReason::Stale { .. })));
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(5))), at(1)), [Action::Report]);
    let actions = ada.handle(Event::AwardReceived(Box::new(award(6))), at(2));
    assert_eq!(actions, [Action::Halt(EndReason::Replaced), Action::Report]);
}

#[test]
fn the_role_goes_to_another_only_after_the_holder_has_suspended() {
    let epoch = Epoch { term: 1, index: 5 };
    let robot = RobotId::new("ada").unwrap();
    let mut watch = LeaseMonitor::new(LeaseTerms::default());
    assert!(!watch.has_expired(epoch, &robot, at(9_000_000)), "an award that has only just been made");
    watch.track(epoch, &robot, at(0));
    watch.track(epoch, &robot, at(3000));
    assert!(!watch.has_expired(epoch, &robot, at(6000)), "it may have been renewed just before the takeover");
    assert!(watch.has_expired(epoch, &robot, at(6001)));
    assert!(watch.renew(epoch, &robot, at(6000)));
    assert!(!watch.has_expired(epoch, &robot, at(12_000)));
    assert!(watch.has_expired(epoch, &robot, at(12_001)));
}

#[test]
fn an_award_that_is_let_go_of_is_renewed_no_more() {
    let (epoch, robot) = (Epoch { term: 1, index: 5 }, RobotId::new("ada").unwrap());
    let mut watch = LeaseMonitor::new(LeaseTerms::default());
    watch.track(epoch, &robot, at(0));
    assert!(watch.renew(epoch, &robot, at(1000)));
    watch.stop_renewing(epoch, &robot, at(1500));
    assert!(!watch.renew(epoch, &robot, at(2000)));
    assert!(!watch.has_expired(epoch, &robot, at(7000)), "its last lease counts from before");
    assert!(watch.has_expired(epoch, &robot, at(7001)));
    // A report that was read before the release was carried out is answered after it.
    watch.retain(&BTreeSet::new(), at(8000));
    assert!(!watch.renew(epoch, &robot, at(8000)));
    watch.retain(&BTreeSet::new(), at(61_500));
    assert!(watch.releasing.is_empty());
}

#[test]
fn an_award_that_nobody_confirmed_in_time_may_be_told_again_and_an_older_one_never() {
    let mut ada = tenure();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    ada.handle(Event::Tick, at(4000));
    assert_eq!(ada.award(), None);
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(5))), at(5000)), [Action::Report]);
    assert_eq!(ada.handle(renewed(5, 5000), at(5010)).len(), 1);
    assert!(matches!(ada.check_award(&award(4)), Err(DeclineReason::Stale { .. })));
}

#[test]
fn of_a_long_life_the_latest_awards_are_remembered() {
    let mut ada = tenure();
    for index in 0..2 * LATEST_KEPT as u64 {
        let award = Award { mission: MissionId::new(format!("m{index}")).unwrap(), ..award(index) };
        let epoch = award.epoch;
        ada.handle(Event::AwardReceived(Box::new(award)), at(index));
        ada.handle(Event::Settled { epoch }, at(index));
    }
    assert_eq!(ada.latest.len(), LATEST_KEPT);
    assert!(ada.latest.values().all(|epoch| epoch.index >= LATEST_KEPT as u64));
    ada.clear_latest_epochs();
    assert!(ada.latest.is_empty());
}
