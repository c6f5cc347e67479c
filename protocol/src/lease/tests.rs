use super::terms::STOP_LATENESS;
use super::*;
use crate::plan::LocalPlan;
use std::time::Duration;

impl RoleLease {
    /// Returns the end of the lease. `None` without an award, or if the award was restored after a
    /// restart and is not confirmed yet.
    fn expires_at(&self) -> Option<NodeTime> {
        self.held.as_ref().filter(|held| held.phase != Phase::Restored).map(|held| held.until)
    }
}

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

fn new_lease() -> RoleLease {
    RoleLease::new(RobotId::new("ada").unwrap(), LeaseTerms::default())
}

fn renewed(index: u64, sent: u64) -> Event {
    Event::Renewed { epoch: Epoch { term: 1, index }, sent: at(sent), ended: BTreeSet::new() }
}

#[test]
fn a_plan_starts_only_after_the_coordinator_has_confirmed_the_award() {
    let mut ada = new_lease();
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(5))), at(0)), [Action::Report]);
    assert!(!ada.may_act(at(1)));
    assert_eq!(ada.handle(renewed(5, 10), at(20)), [Action::Start(Box::new(award(5)), BTreeSet::new())]);
    assert!(ada.may_act(at(20)));
}

#[test]
fn the_lease_counts_from_when_the_report_was_sent() {
    let mut ada = new_lease();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    ada.handle(renewed(5, 10), at(3000));
    assert!(ada.may_act(at(4009)));
    assert!(!ada.may_act(at(4010)));
    assert_eq!(ada.handle(Event::Tick, at(4010)), [Action::Suspend { until: at(4010) }]);
    assert_eq!(ada.handle(Event::Tick, at(5000)), []);
    assert_eq!(ada.handle(renewed(5, 4900), at(5000)), [Action::Resume]);
}

/// A goal in progress stops slowly, so the robot passes a later time.
#[test]
fn a_plan_suspended_before_its_lease_ends_resumes_with_the_renewal() {
    let mut ada = new_lease();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    ada.handle(renewed(5, 10), at(20));
    let lead = stop_lead(Duration::from_secs(2));
    assert_eq!(ada.handle(Event::Tick, at(2509) + lead), []);
    assert_eq!(ada.handle(Event::Tick, at(2510) + lead), [Action::Suspend { until: at(4010) }]);
    assert_eq!(ada.handle(renewed(5, 2500), at(2600)), [Action::Resume]);
}

#[test]
fn a_reply_that_took_longer_than_the_lease_renews_nothing() {
    let mut ada = new_lease();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    assert_eq!(ada.handle(renewed(5, 10), at(4010)), []);
    assert!(!ada.may_act(at(4010)));
}

#[test]
fn an_award_with_an_older_epoch_is_declined() {
    let mut ada = new_lease();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    assert_eq!(ada.check_award(&award(4)), Err(DeclineReason::Stale { known: Epoch { term: 1, index: 5 } }));
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(4))), at(1)), []);
    assert_eq!(ada.handle(renewed(4, 0), at(1)), []);
}

#[test]
fn a_robot_with_a_role_declines_an_award_of_another() {
    let mut ada = new_lease();
    let busy = || Err(DeclineReason::Busy { mission: award(5).mission, role: award(5).role });
    for event in [Event::AwardReceived(Box::new(award(5))), renewed(5, 10)] {
        ada.handle(event, at(20));
        let other = Award { role: RoleId::new("r2").unwrap(), ..award(6) };
        assert_eq!(ada.check_award(&other), busy());
        assert_eq!(ada.handle(Event::AwardReceived(Box::new(other)), at(30)), []);
        assert_eq!(ada.award(), Some(&award(5)));
    }
}

#[test]
fn events_with_an_older_epoch_change_nothing() {
    let old = Epoch { term: 1, index: 4 };
    let acting = || {
        let mut ada = new_lease();
        ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
        ada.handle(renewed(5, 0), at(1));
        ada
    };
    let suspended = || {
        let mut ada = acting();
        assert_eq!(ada.handle(Event::Tick, at(4000)), [Action::Suspend { until: at(4000) }]);
        ada
    };
    let restored = || RoleLease::restore(RobotId::new("ada").unwrap(), LeaseTerms::default(), award(5));
    for (name, make) in
        [("acting", &acting as &dyn Fn() -> RoleLease), ("suspended", &suspended), ("restored", &restored)]
    {
        let events = [
            Event::AwardReceived(Box::new(award(4))),
            renewed(4, 4000),
            Event::Revoked { epoch: old, reason: EndReason::Released },
            Event::Settled { epoch: old },
        ];
        for event in events {
            let mut ada = make();
            let (acts, suspended_before, until) = (ada.may_act(at(2000)), ada.is_suspended(), ada.expires_at());
            assert_eq!(ada.handle(event.clone(), at(4001)), [], "{name}: {event:?}");
            assert_eq!(ada.award().map(|award| award.epoch.index), Some(5), "{name}: {event:?}");
            assert_eq!(
                (ada.may_act(at(2000)), ada.is_suspended(), ada.expires_at()),
                (acts, suspended_before, until),
                "{name}"
            );
        }
    }
}

#[test]
fn a_robot_that_never_started_has_nothing_to_halt() {
    let mut ada = new_lease();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    assert_eq!(
        ada.handle(Event::Revoked { epoch: Epoch { term: 1, index: 5 }, reason: EndReason::Canceled }, at(1)),
        []
    );
    assert_eq!(ada.award(), None);
    assert_eq!(ada.handle(renewed(5, 0), at(2)), [], "the revocation arrived first");
}

/// Checks whether there is an instant at which the old holder may act while a later coordinator
/// considers its lease expired. The robot and the coordinator that replied to it have the slowest
/// clocks. The clock of the later coordinator runs `1 + drift` times as fast, and it took over as
/// early as possible. The robot is at rest `reaction` after the end of its lease.
fn overlaps(terms: LeaseTerms, drift: f64, reaction: Duration) -> bool {
    let (epoch, robot) = (Epoch { term: 1, index: 5 }, RobotId::new("ada").unwrap());
    let (mut ada, mut monitor) = (RoleLease::new(robot.clone(), terms), LeaseMonitor::new(terms));
    let slow = |us: u64| NodeTime::at(Duration::from_micros(us));
    let fast = |us: u64| NodeTime::at(Duration::from_micros(us).mul_f64(1.0 + drift));
    let replied_at = u64::try_from(terms.leadership_age_max().as_micros()).unwrap();
    monitor.track(epoch, &robot, fast(0));
    ada.handle(Event::AwardReceived(Box::new(award(5))), slow(replied_at));
    ada.handle(Event::Renewed { epoch, sent: slow(replied_at), ended: BTreeSet::new() }, slow(replied_at));
    let reaction = u64::try_from(reaction.as_micros()).unwrap();
    let instants = (0..20_000_000).step_by(1_000);
    let mut overlap = instants
        .filter(|us| ada.may_act(slow(us - reaction.min(*us))) && monitor.has_expired(epoch, &robot, fast(*us)));
    overlap.next().is_some()
}

#[test]
fn two_robots_act_at_once_only_if_clocks_drift_beyond_the_bound() {
    let seconds = Duration::from_secs_f64;
    let default = LeaseTerms::default();
    assert!((default.drift_max(LEASE_REACTION) - 1.0 / 14.0).abs() < 1e-12);
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
fn the_smallest_grace_allows_a_drift_of_one_percent() {
    for lease_ms in [500, 1500, 4000, 60_000] {
        let lease = Duration::from_millis(lease_ms);
        let grace = LeaseTerms::grace_min(lease);
        let drift_max = |grace| LeaseTerms { lease, grace }.drift_max(LEASE_REACTION);
        assert!(
            drift_max(grace) >= CLOCK_DRIFT_MAX && drift_max(grace - Duration::from_millis(2)) < CLOCK_DRIFT_MAX,
            "{lease:?} {grace:?}"
        );
    }
    assert!(LeaseTerms::default().grace > LeaseTerms::grace_min(LeaseTerms::default().lease));
}

/// Returns the instant at which a driver server stops its robot, in seconds of the slowest clock, if
/// the robot's report was sent at 0 and its body rests `cancel_within` after a cancel. A state is sent,
/// received, and named by a command that arrives; the clocks of client and server run `rates` times as
/// fast as the slowest clock.
fn stops_at(
    terms: LeaseTerms,
    cancel_within: Duration,
    [sent, received, commanded, arrives]: [f64; 4],
    rates: [f64; 2],
) -> Option<f64> {
    let client_timeout = Duration::from_secs(3);
    let clocks = rates.map(|rate| move |at: f64| NodeTime::at(Duration::from_secs_f64(100.0 + at * rate)));
    let (client, server) = (&clocks[0], &clocks[1]);
    let lease_end = client(0.0) + terms.lease;
    let allowed_until = lease_end.earlier_by(stop_lead(cancel_within));
    let keep_for = keep_for(allowed_until, client_timeout, client(received), client(commanded))?;
    let stop = stop_at(keep_for, client_timeout, server(sent), server(arrives))?;
    Some(stop.since(server(0.0)).as_secs_f64() / rates[1])
}

/// Returns the latest instant at which a driver server stops its robot, over many delays and clocks.
fn latest_stop(terms: LeaseTerms, cancel_within: Duration) -> f64 {
    let fast = 1.0 + CLOCK_DRIFT_MAX;
    let delays = [0.0, 0.002, 0.7, 2.0, 3.9, 9.0];
    let mut latest: f64 = 0.0;
    let mut add = |times: [f64; 4]| {
        let stop = |rates| stops_at(terms, cancel_within, times, rates);
        let stops = [[1.0, 1.0], [fast, 1.0], [1.0, fast], [fast, fast]].into_iter().filter_map(stop);
        latest = stops.fold(latest, f64::max);
    };
    for sent in [0.0, 0.3, 2.5, 3.99] {
        for received in delays.map(|delay| sent + delay) {
            for commanded in delays.map(|pause| received + pause) {
                for arrives in delays.map(|delay| commanded + delay) {
                    add([sent, received, commanded, arrives]);
                }
            }
        }
    }
    latest
}

#[test]
fn no_delay_of_a_message_lets_a_driver_act_after_the_lease() {
    let terms = LeaseTerms::default();
    let (latest, lease) = (latest_stop(terms, Duration::ZERO), terms.lease.as_secs_f64());
    assert!(latest <= lease + 1e-6, "stops at {latest}");
    assert!((latest - lease).abs() < 1e-6, "without delays the lease is used up: {latest}");
    let stops_at = |times| stops_at(terms, Duration::ZERO, times, [1.0, 1.0]);
    assert_eq!(stops_at([0.0, 0.1, 4.1, 4.2]), None, "sent after the lease");
    assert_eq!(stops_at([3.0, 3.1, 3.2, 4.2]), None, "arrives after the lease");
    assert_eq!(stops_at([0.0, 0.0, 0.5, 0.5]), Some(3.5), "the client timeout");
}

#[test]
fn a_body_that_stops_slowly_rests_no_later_than_others() {
    let terms = LeaseTerms::default();
    let rests_by = (terms.lease + LEASE_REACTION).as_secs_f64();
    for cancel_within in [0.1, 0.5, 0.6, 1.5, 2.5] {
        let stop = latest_stop(terms, Duration::from_secs_f64(cancel_within));
        let rest = stop + STOP_LATENESS.as_secs_f64() + cancel_within;
        assert!(rest <= rests_by + 1e-6, "{cancel_within} s: at rest at {rest}");
    }
    let lead = |ms| stop_lead(Duration::from_millis(ms));
    assert_eq!([lead(500), lead(3_000)], [Duration::ZERO, Duration::from_millis(2_500)]);
}

#[test]
fn a_lease_leaves_a_body_that_stops_slowly_time_to_act() {
    let (ms, longest) = (Duration::from_millis, LeaseTerms::cancel_within_max);
    assert_eq!([1_000, 2_000, 4_000, 6_000].map(|lease| longest(ms(lease))), [500, 500, 1_500, 2_500].map(ms));
    assert_eq!([500, 3_000].map(|cancel| LeaseTerms::lease_min(ms(cancel))), [0, 7_000].map(ms));
    for cancel_within in [501, 1_000, 3_000, 60_000].map(ms) {
        let lease = LeaseTerms::lease_min(cancel_within);
        assert!(longest(lease) >= cancel_within && longest(lease - ms(2)) < cancel_within, "{cancel_within:?}");
    }
}

#[test]
fn a_newer_award_of_the_same_role_replaces_the_old_one() {
    let mut ada = new_lease();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    ada.handle(renewed(5, 0), at(1));
    let actions = ada.handle(Event::AwardReceived(Box::new(award(6))), at(2));
    assert_eq!(actions, [Action::Halt(EndReason::Replaced), Action::Report]);
    assert!(!ada.may_act(at(2)));
}

#[test]
fn a_duplicate_of_a_settled_award_is_not_started_again() {
    let mut ada = new_lease();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    ada.handle(renewed(5, 0), at(1));
    ada.handle(Event::Settled { epoch: Epoch { term: 1, index: 5 } }, at(2));
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(5))), at(3)), []);
    assert_eq!(ada.award(), None);
}

#[test]
fn a_restored_award_waits_for_the_coordinator_without_a_limit() {
    let restored = || RoleLease::restore(RobotId::new("ada").unwrap(), LeaseTerms::default(), award(5));
    let mut ada = restored();
    assert_eq!(ada.handle(Event::Tick, at(60_000)), []);
    assert!(!ada.may_act(at(0)) && ada.expires_at().is_none());
    assert_eq!(ada.award().map(|award| award.epoch), Some(Epoch { term: 1, index: 5 }));
    let actions = ada.handle(renewed(5, 60_000), at(60_010));
    assert_eq!(actions, [Action::Start(Box::new(award(5)), BTreeSet::new())]);
    assert!(ada.may_act(at(60_010)));

    let mut ada = restored();
    let revoked = Event::Revoked { epoch: Epoch { term: 1, index: 5 }, reason: EndReason::Released };
    assert_eq!(ada.handle(revoked, at(10)), [Action::Halt(EndReason::Released)]);
    assert_eq!(ada.award(), None);

    let mut ada = restored();
    assert!(matches!(ada.check_award(&award(4)), Err(DeclineReason::Stale { .. })));
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(5))), at(1)), [Action::Report]);
    let actions = ada.handle(Event::AwardReceived(Box::new(award(6))), at(2));
    assert_eq!(actions, [Action::Halt(EndReason::Replaced), Action::Report]);
}

#[test]
fn a_lease_expires_only_after_the_holder_has_suspended() {
    let epoch = Epoch { term: 1, index: 5 };
    let robot = RobotId::new("ada").unwrap();
    let mut monitor = LeaseMonitor::new(LeaseTerms::default());
    assert!(!monitor.has_expired(epoch, &robot, at(9_000_000)), "an award that was just made");
    monitor.track(epoch, &robot, at(0));
    monitor.track(epoch, &robot, at(3000));
    assert!(!monitor.has_expired(epoch, &robot, at(6000)), "it may have been renewed just before the takeover");
    assert!(monitor.has_expired(epoch, &robot, at(6001)));
    assert!(monitor.renew(epoch, &robot, at(6000)));
    assert!(!monitor.has_expired(epoch, &robot, at(12_000)));
    assert!(monitor.has_expired(epoch, &robot, at(12_001)));
}

#[test]
fn an_award_being_released_is_not_renewed() {
    let (epoch, robot) = (Epoch { term: 1, index: 5 }, RobotId::new("ada").unwrap());
    let mut monitor = LeaseMonitor::new(LeaseTerms::default());
    monitor.track(epoch, &robot, at(0));
    assert!(monitor.renew(epoch, &robot, at(1000)));
    monitor.stop_renewing(epoch, &robot, at(1500));
    assert!(!monitor.renew(epoch, &robot, at(2000)));
    assert!(!monitor.has_expired(epoch, &robot, at(7000)), "its lease runs from the last renewal");
    assert!(monitor.has_expired(epoch, &robot, at(7001)));
    // A report that was decoded before the release was applied is answered after it.
    monitor.retain(&BTreeSet::new(), at(8000));
    assert!(!monitor.renew(epoch, &robot, at(8000)));
    monitor.retain(&BTreeSet::new(), at(61_500));
    assert!(monitor.releasing.is_empty());
}

#[test]
fn an_unconfirmed_award_may_be_received_again_after_it_expired() {
    let mut ada = new_lease();
    ada.handle(Event::AwardReceived(Box::new(award(5))), at(0));
    ada.handle(Event::Tick, at(4000));
    assert_eq!(ada.award(), None);
    assert_eq!(ada.handle(Event::AwardReceived(Box::new(award(5))), at(5000)), [Action::Report]);
    assert_eq!(ada.handle(renewed(5, 5000), at(5010)).len(), 1);
    assert!(matches!(ada.check_award(&award(4)), Err(DeclineReason::Stale { .. })));
}

#[test]
fn the_number_of_latest_epochs_is_bounded() {
    let mut ada = new_lease();
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
