use super::super::bid::{AuctionId, BidLimits, CallForBids, PresentRole};
use super::super::charging_stop::ChargingStop;
use super::super::clearing::{AuctionContext, AuctionOutcome, clear_auction};
use super::super::insertion::{RoleOfMission, RoleSpan, Timelines};
use super::super::invitation::Invitation;
use super::super::record::{AuctionEntry, BidVerdict};
use super::*;
use crate::ids::MissionId;
use crate::plan::LocalPlan;
use crate::units::BatteryShare;

fn seconds(value: f64) -> Seconds {
    Seconds::new(value).unwrap()
}

fn role(name: &str) -> RoleId {
    name.parse().unwrap()
}

fn auction() -> AuctionId {
    AuctionId { mission: "bring-2".parse().unwrap(), term: 1, round: 1 }
}

/// Returns a bid of 10 s for an arm and of 100 s for a cart, of a robot that holds another role for `busy_s`, if at all.
fn bid(robot: &str, id: &str, busy_s: Option<f64>) -> BidResponse {
    let mission: MissionId = "bring-1".parse().unwrap();
    let bid = Bid {
        robot: robot.parse().unwrap(),
        role: role(id),
        time: seconds(if id == "cart" { 100.0 } else { 10.0 }),
        energy: 0.1,
        remaining: 0.5,
        useful_charge: BatteryShare::new(0.1).unwrap(),
        from: "dock".parse().unwrap(),
        age_ms: 0,
        parts: vec![],
        present: busy_s.map(|busy| PresentRole { mission, role: role("arm"), time: seconds(busy) }),
        planned: None,
    };
    BidResponse { robot: bid.robot.clone(), auction: auction(), replies: vec![RoleReply::Bid(bid)] }
}

fn queue(is_held: bool, promised: u32) -> RobotQueue {
    let held = RoleEstimate { time: seconds(40.0), energy: Energy::of_share(0.2) };
    RobotQueue {
        held: is_held.then_some(held),
        promised,
        preceding: promised,
        time: seconds(20.0 * f64::from(promised)),
        energy: Energy::of_share(0.05 * f64::from(promised)),
        yields: false,
        reason: RefusalReason::Busy { mission: "bring-1".parse().unwrap(), role: role("arm") },
    }
}

struct Case<'a> {
    queues: &'a [(&'a str, RobotQueue)],
    startable: &'a [&'a str],
    may_wait: bool,
}

/// Clears an auction of the roles `arm` and `cart`.
fn clear(case: &Case<'_>, responses: &[BidResponse]) -> AuctionOutcome {
    let plan = |id: &str| (role(id), LocalPlan::of(role(id), vec![]));
    let roles = [plan("arm"), plan("cart")].into();
    let call = CallForBids {
        auction: auction(),
        ensembles: vec![],
        roles,
        eligible: BTreeMap::new(),
        spread: BTreeSet::new(),
        timelines: Timelines::default(),
    };
    let queues: BTreeMap<RobotId, RobotQueue> =
        case.queues.iter().map(|(robot, queue)| (robot.parse().unwrap(), queue.clone())).collect();
    let busy = queues.iter().map(|(robot, queue)| (robot.clone(), queue.reason.clone())).collect();
    let startable = case.startable.iter().map(|id| role(id)).collect();
    let none = BTreeMap::new();
    let (may_wait, unavailable) = (case.may_wait, &none);
    let robots = responses.iter().map(|response| response.robot.clone()).collect();
    let context = AuctionContext {
        invitation: &Invitation { robots, preferred: vec![] },
        unavailable: &busy,
        excluded: &BTreeMap::new(),
        limits: &BidLimits::default(),
        energy: None,
        promises: Some(PromiseContext {
            queues: &queues,
            unavailable,
            startable: &startable,
            may_wait,
            terms: PromiseTerms { promises_max: 3, ..PromiseTerms::default() },
        }),
        window_ms: 200,
        at_ms: 0,
    };
    clear_auction(&call, responses, &context)
}

fn promised(outcome: &AuctionOutcome) -> Vec<(&str, f64)> {
    outcome.record.promised.iter().map(|(role, start)| (role.as_str(), start.get())).collect()
}

#[test]
fn a_busy_robot_is_promised_a_role_beside_one_that_starts() {
    let responses = [bid("arm-1", "arm", Some(30.0)), bid("ada", "cart", None)];
    let case = Case { queues: &[("arm-1", queue(true, 2))], startable: &["cart"], may_wait: false };
    let outcome = clear(&case, &responses);
    assert_eq!(outcome.holders.as_ref().map(BTreeMap::len), Some(2), "{outcome:?}");
    assert_eq!(promised(&outcome), [("arm", 70.0)], "30 s for its role, 20 s for each of two promises");
    let entry = outcome.record.entries.iter().find(|entry| entry.robot.as_str() == "arm-1").unwrap();
    let BidVerdict::Viable { time, remaining, .. } = entry.verdict else { panic!("{entry:?}") };
    assert_eq!((time.get(), (remaining * 100.0).round()), (80.0, 40.0));
}

#[test]
fn a_role_that_a_robot_got_after_its_bid_comes_before_a_promise() {
    let mut late = bid("arm-1", "arm", None);
    let Some(RoleReply::Bid(planned)) = late.replies.first_mut() else { panic!("a bid") };
    let span = RoleSpan { from: None, to: None, time: seconds(10.0), energy: Energy::of_share(0.1) };
    planned.planned = Some(Box::new(PlannedRole::alone(span, Seconds::ZERO)));
    let case = Case { queues: &[("arm-1", queue(true, 0))], startable: &["cart"], may_wait: false };
    let outcome = clear(&case, &[late, bid("ada", "cart", None)]);
    assert_eq!(promised(&outcome), [("arm", 40.0)]);
    let entry = outcome.record.entries.iter().find(|entry| entry.robot.as_str() == "arm-1").unwrap();
    let BidVerdict::Viable { remaining, .. } = entry.verdict else { panic!("{entry:?}") };
    assert_eq!((remaining * 100.0).round(), 30.0, "0.2 for the role that it got");
}

#[test]
fn a_free_robot_comes_first() {
    let responses = [bid("arm-1", "arm", Some(1.0)), bid("arm-2", "arm", None), bid("ada", "cart", None)];
    let case = Case { queues: &[("arm-1", queue(true, 0))], startable: &["cart"], may_wait: false };
    let outcome = clear(&case, &responses);
    assert_eq!(outcome.holders.as_ref().unwrap()[&role("arm")].as_str(), "arm-2");
    assert_eq!(promised(&outcome), []);
}

#[test]
fn a_mission_that_cannot_start_waits_for_whichever_robot_is_free_first() {
    let responses = [bid("arm-1", "arm", None), bid("ada", "cart", Some(60.0))];
    let queues = [("ada", queue(true, 0))];
    let no_cart = Some("no viable bid for cart");
    for may_wait in [false, true] {
        let outcome = clear(&Case { queues: &queues, startable: &["cart"], may_wait }, &responses);
        assert_eq!((outcome.record.failure.as_deref(), promised(&outcome)), (no_cart, vec![]));
    }
    // Both roles wait for others of a mission that is under way.
    let outcome = clear(&Case { queues: &queues, startable: &[], may_wait: true }, &responses);
    assert_eq!(promised(&outcome), [("arm", 0.0), ("cart", 60.0)]);
    let outcome = clear(&Case { queues: &queues, startable: &[], may_wait: false }, &responses);
    assert_eq!(promised(&outcome), []);
}

#[test]
fn no_robot_waits_for_longer_than_it_works() {
    let waits = |busy_s, may_wait| {
        let responses = [bid("arm-1", "arm", Some(busy_s)), bid("ada", "cart", None)];
        let case = Case { queues: &[("arm-1", queue(true, 0))], startable: &["cart"], may_wait };
        clear(&case, &responses).holders.is_none()
    };
    assert_eq!([99.0, 100.0, 101.0].map(|busy_s| waits(busy_s, false)), [false, false, true]);
    assert!(!waits(101.0, true), "the mission has waited for too long");
}

#[test]
fn robots_with_promises_are_promised_in_turn() {
    let responses = [bid("arm-1", "arm", None), bid("ada", "cart", Some(9.0))];
    let queues = [("ada", queue(true, 1)), ("arm-1", queue(false, 1))];
    let outcome = clear(&Case { queues: &queues, startable: &["cart"], may_wait: false }, &responses);
    assert_eq!(promised(&outcome), [("arm", 20.0), ("cart", 29.0)]);
}

#[test]
fn a_free_robot_that_has_to_charge_is_promised_the_role_after_its_stop() {
    let mut charging = bid("ada", "cart", None);
    let Some(RoleReply::Bid(planned)) = charging.replies.first_mut() else { panic!("a bid") };
    let span = RoleSpan { from: None, to: None, time: seconds(100.0), energy: Energy::ZERO };
    let share = |share| BatteryShare::new(share).unwrap();
    let (charger, time) = ("dock".parse().unwrap(), seconds(300.0));
    let stop = ChargingStop { charger, time, until: share(0.8), remaining: share(0.6) };
    planned.remaining = 0.05;
    planned.planned = Some(Box::new(PlannedRole { charging: Some(stop), ..PlannedRole::alone(span, time) }));
    let responses = [bid("arm-1", "arm", None), charging];
    let in_turn = [("arm-1", queue(false, 1))];
    let outcome = clear(&Case { queues: &in_turn, startable: &["cart"], may_wait: false }, &responses);
    assert_eq!(promised(&outcome), [("arm", 20.0), ("cart", 300.0)]);
    let is_of_cart = |entry: &&AuctionEntry| entry.role == role("cart") && entry.robot.as_str() == "ada";
    let entry = outcome.record.entries.iter().find(is_of_cart).unwrap();
    assert!(matches!(entry.verdict, BidVerdict::Viable { remaining: 0.6, .. }), "{entry:?}");
    assert_eq!(outcome.record.planned[&role("cart")].charging.as_ref().map(|stop| stop.time), Some(time));
    // The robot has promised a role that it did not consider.
    let queues = [("arm-1", queue(false, 1)), ("ada", queue(false, 1))];
    let outcome = clear(&Case { queues: &queues, startable: &["cart"], may_wait: false }, &responses);
    assert_eq!(promised(&outcome), []);
}

#[test]
fn a_long_queue_is_full() {
    let responses = [bid("arm-1", "arm", Some(9.0)), bid("ada", "cart", None)];
    let full = |queue| {
        let outcome = clear(&Case { queues: &[("arm-1", queue)], startable: &["cart"], may_wait: true }, &responses);
        outcome.record.failure
    };
    let no_arm = Some("no viable bid for arm".to_owned());
    assert_eq!(full(queue(true, 2)), None);
    assert_eq!(full(queue(true, 3)), no_arm, "at most three promises");
    assert_eq!(full(RobotQueue { preceding: 2, ..queue(true, 3) }), None, "one has a lower priority");
}

#[test]
fn a_robot_that_only_waits_in_a_role_of_a_lower_priority_yields() {
    let responses = [bid("arm-1", "arm", Some(300.0)), bid("ada", "cart", None)];
    let cleared = |yields| {
        let queues = [("arm-1", RobotQueue { yields, ..queue(true, 0) })];
        let outcome = clear(&Case { queues: &queues, startable: &["arm", "cart"], may_wait: false }, &responses);
        outcome.record.promised
    };
    assert_eq!(cleared(false), BTreeMap::new());
    assert_eq!(cleared(true), BTreeMap::from([(role("arm"), seconds(0.0))]));
}

/// Returns the bid of a robot that would insert the role before the second of two promised roles.
fn inserting_bid(robot: &str, id: &str) -> BidResponse {
    let next = RoleOfMission { mission: "bring-0".parse().unwrap(), role: role("arm") };
    let span = RoleSpan { from: None, to: None, time: seconds(10.0), energy: Energy::of_share(0.1) };
    let planned = PlannedRole {
        before: Some(next),
        delay: seconds(10.0),
        delayed: 1,
        promised: 2,
        energy: Energy::of_share(0.2),
        ..PlannedRole::alone(span, seconds(50.0))
    };
    let mut response = bid(robot, id, Some(30.0));
    let Some(RoleReply::Bid(bid)) = response.replies.first_mut() else { panic!("a bid") };
    bid.planned = Some(Box::new(planned));
    response
}

#[test]
fn a_role_is_inserted_where_its_bid_states() {
    let responses = [inserting_bid("arm-1", "arm"), bid("ada", "cart", None)];
    let promise_after = |promised| {
        let queues = [("arm-1", queue(true, promised))];
        let outcome = clear(&Case { queues: &queues, startable: &["cart"], may_wait: false }, &responses);
        let PlannedRole { before, delay_max, .. } = outcome.record.planned[&role("arm")].clone();
        let start = outcome.record.promised[&role("arm")];
        (start.get(), before.map(|next| next.mission.to_string()), delay_max.get())
    };
    assert_eq!(promise_after(2), (50.0, Some("bring-0".to_owned()), 600.0));
    // The robot has promised less since.
    assert_eq!(promise_after(1), (50.0, None, 0.0), "30 s for its role, 20 s for the promise");
}

#[test]
fn a_bid_that_delays_others_costs_more() {
    let responses = [inserting_bid("arm-1", "arm"), bid("arm-2", "arm", Some(55.0)), bid("ada", "cart", None)];
    let queues = [("arm-1", queue(true, 2)), ("arm-2", queue(true, 0))];
    let outcome = clear(&Case { queues: &queues, startable: &["cart"], may_wait: false }, &responses);
    let winner = outcome.holders.as_ref().unwrap()[&role("arm")].as_str();
    assert_eq!(winner, "arm-2", "it ends after 65 s; the other after 60 s, which delays a promise by 10 s");
}

#[test]
fn the_gain_of_another_robot_is_the_difference_of_the_costs() {
    let responses = [inserting_bid("arm-1", "arm"), bid("arm-2", "arm", Some(30.0)), bid("arm-3", "arm", None)];
    let replies = responses.iter().flat_map(|response| &response.replies);
    let bids: Vec<&Bid> =
        replies.filter_map(|reply| if let RoleReply::Bid(bid) = reply { Some(bid) } else { None }).collect();
    let queues = BTreeMap::from([("arm-1", 2), ("arm-2", 1)]);
    let queues = queues.into_iter().map(|(name, promised)| (name.parse().unwrap(), queue(true, promised))).collect();
    let (unavailable, none, startable) = (BTreeMap::new(), BTreeSet::new(), BTreeSet::from([role("arm")]));
    let gain = |startable: &BTreeSet<RoleId>, from: usize, to: usize| {
        let terms = PromiseTerms { promises_max: 1, ..PromiseTerms::default() };
        let context = PromiseContext { queues: &queues, unavailable: &unavailable, startable, may_wait: true, terms };
        context.gain(bids[from], bids[to])
    };
    for startable in [&none, &startable] {
        assert_eq!(gain(startable, 0, 1), 10.0, "60 s with a delay of 10 s, and 30 + 20 + 10 s");
        assert_eq!(gain(startable, 1, 2), 50.0);
        assert_eq!(gain(startable, 2, 0), -60.0);
    }
}
