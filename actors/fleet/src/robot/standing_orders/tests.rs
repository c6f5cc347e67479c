use super::super::test_values::at;
use super::*;
use consort_protocol::ledger::Zone;

const LEASE: Duration = Duration::from_secs(1);

fn order(text: &str, remaining_ms: Option<u64>) -> Option<OrderNotice> {
    Some(OrderNotice { text: text.to_owned(), remaining_ms })
}

fn notice(index: u64, hold: Option<OrderNotice>) -> OrdersNotice {
    OrdersNotice { as_of: Epoch { term: 1, index }, hold, ..OrdersNotice::default() }
}

#[test]
fn a_hold_lasts_from_its_receipt_to_its_end() {
    let mut orders = StandingOrders::default();
    assert!(!orders.is_held(at(0)) && orders.problem(at(0)).is_none());
    orders.receive(notice(5, order("held by Nia", Some(1_000))), at(500));
    assert!(orders.is_held(at(500)) && orders.is_held(at(1_499)) && !orders.is_held(at(1_500)));
    assert_eq!((orders.problem(at(1_499)), orders.problem(at(1_500))), (Some("held by Nia"), None));
}

#[test]
fn a_restarted_robot_acts_alone_once_its_orders_are_known_or_none_arrive() {
    let mut orders = StandingOrders::new(at(0));
    assert!(!orders.may_act_alone(at(9_999)) && orders.may_act_alone(at(10_000)));
    orders.receive(notice(5, None), at(100));
    assert!(orders.may_act_alone(at(100)));
}

#[test]
fn a_robot_with_an_item_stays_until_a_person_has_it() {
    let mut orders = StandingOrders::default();
    orders.receive(notice(5, None), at(0));
    orders.await_notice(at(1_000));
    assert!(!orders.may_act_alone(at(10_999)) && orders.may_act_alone(at(11_000)), "its role has just ended");
    orders.receive(OrdersNotice { stay: order("has the parcel of fetch-1", None), ..notice(7, None) }, at(2_000));
    assert_eq!(orders.reason_to_stay(at(900_000)), Some("has the parcel of fetch-1"));
    assert!(orders.problem(at(2_000)).is_none() && !orders.is_held(at(2_000)), "its own mission may use it");
    orders.receive(notice(9, None), at(3_000));
    assert!(orders.reason_to_stay(at(3_000)).is_none() && orders.may_act_alone(at(3_000)));
}

#[test]
fn a_delayed_notice_neither_holds_nor_releases() {
    let mut orders = StandingOrders::default();
    orders.receive(notice(7, None), at(0));
    orders.receive(notice(5, order("held by Nia", Some(1_000))), at(1));
    assert!(!orders.is_held(at(1)), "it was released later");
    orders.receive(notice(8, order("held by Nia", Some(1_000))), at(2));
    orders.receive(notice(7, None), at(3));
    assert!(orders.is_held(at(3)));
    orders.receive(notice(8, None), at(4));
    assert!(!orders.is_held(at(4)), "the present state at the same position");
}

#[test]
fn an_unconfirmed_notice_holds_for_a_short_time_and_releases_nothing() {
    let mut orders = StandingOrders::default();
    let hold = || order("held by Nia", None);
    orders.receive_unconfirmed(&notice(u64::MAX, hold()), LEASE, at(0));
    assert!(orders.is_held(at(2_999)) && !orders.is_held(at(3_000)));
    orders.receive(notice(7, hold()), at(5_000));
    orders.receive_unconfirmed(&notice(u64::MAX, None), LEASE, at(5_000));
    assert!(orders.is_held(at(60_000)));
    orders.receive(notice(8, None), at(60_000));
    assert!(!orders.is_held(at(60_000)));
    orders.receive_unconfirmed(&notice(u64::MAX, hold()), Duration::from_secs(4), at(60_000));
    assert!(orders.is_held(at(63_999)) && !orders.is_held(at(64_000)), "as long as a longer lease");
}

#[test]
fn an_unconfirmed_notice_closes_for_a_short_time_and_opens_nothing() {
    let closure = |name: &str| {
        let order = OrderNotice { text: "closed by Nia".to_owned(), remaining_ms: None };
        ClosureNotice { part: MapPart::Place(name.parse().unwrap()), order, until_ms: None }
    };
    let closed = |orders: &StandingOrders, ms| orders.closure_texts(at(ms)).join(", ");
    let mut orders = StandingOrders::default();
    orders.receive(OrdersNotice { closures: vec![closure("Ward")], ..notice(7, None) }, at(0));
    let unconfirmed = OrdersNotice { closures: vec![closure("Ward"), closure("Hall")], ..notice(8, None) };
    orders.receive_unconfirmed(&unconfirmed, LEASE, at(0));
    assert_eq!(closed(&orders, 2_999), "Ward is closed by Nia, Hall is closed by Nia");
    assert_eq!(closed(&orders, 3_000), "Ward is closed by Nia");
    orders.receive_unconfirmed(&notice(9, None), LEASE, at(5_000));
    assert_eq!(closed(&orders, 5_000), "Ward is closed by Nia");
    orders.receive(OrdersNotice { closures: vec![closure("Hall")], ..notice(8, None) }, at(6_000));
    assert_eq!(closed(&orders, 60_000), "Hall is closed by Nia");
}

#[test]
fn the_next_leader_session_replaces_an_invented_position() {
    let mut orders = StandingOrders::default();
    orders.receive(notice(u64::MAX, order("held by dill", None)), at(0));
    orders.change_session();
    assert!(orders.is_held(at(1)), "until the next leader states the orders");
    orders.receive(notice(7, None), at(2));
    assert!(!orders.is_held(at(2)));
}

#[test]
fn orders_of_another_cluster_replace_those_of_the_former_one() {
    let mut orders = StandingOrders::default();
    orders.receive(notice(100, order("held by Nia", Some(1_000))), at(0));
    orders.change_cluster(at(0));
    assert!(orders.is_held(at(1)), "until the other cluster states its orders");
    orders.receive(notice(3, None), at(2));
    assert!(!orders.is_held(at(2)));
}

#[test]
fn orders_end_in_a_cluster_that_has_none() {
    let mut orders = StandingOrders::default();
    let maintenance = order("in maintenance by Nia: tyres", None);
    let part = MapPart::Place("Ward".parse().unwrap());
    let closed = OrderNotice { text: "closed by Nia".to_owned(), remaining_ms: None };
    let closures = vec![ClosureNotice { part, order: closed, until_ms: None }];
    let hold = order("held by Nia", Some(600_000));
    orders.receive(OrdersNotice { maintenance, closures, ..notice(100, hold) }, at(0));
    orders.change_cluster(at(1_000));
    assert!(orders.is_held(at(10_999)) && !orders.is_held(at(11_000)));
    assert_eq!(orders.problem(at(11_000)), None, "its maintenance had no end");
    assert_eq!([at(10_999), at(11_000)].map(|now| orders.closed(now).len()), [1, 0], "nor had the closure");
}

#[test]
fn a_closure_lasts_to_its_end_or_its_opening() {
    let place = |name: &str| -> PlaceId { name.parse().unwrap() };
    let closure = |part, remaining_ms, until_ms| {
        let order = OrderNotice { text: "closed by Nia: a spill".to_owned(), remaining_ms };
        ClosureNotice { part, order, until_ms }
    };
    let ward = closure(MapPart::Place(place("Ward")), Some(1_000), Some(1_767_225_600_000));
    let lane = closure(MapPart::of_lane(place("B"), place("A")), None, None);
    let mut orders = StandingOrders::default();
    orders.receive(OrdersNotice { closures: vec![ward, lane], ..notice(5, None) }, at(500));
    assert_eq!(orders.closed(at(1_499)), [(place("Ward"), place("Ward")), (place("A"), place("B"))]);
    let texts = ["Ward is closed by Nia: a spill, until 2026-01-01 00:00 UTC", "A – B is closed by Nia: a spill"];
    assert_eq!(orders.closure_texts(at(1_499)), texts);
    assert_eq!(orders.closed(at(1_500)), [(place("A"), place("B"))]);
    assert!(!orders.is_held(at(500)) && orders.problem(at(500)).is_none());
    orders.receive(notice(6, None), at(2_000));
    assert!(orders.closed(at(2_000)).is_empty());
}

fn alarm(places: &[&str]) -> Option<AlarmNotice> {
    let order = OrderNotice { text: "under alarm fire by Nia".to_owned(), remaining_ms: None };
    let closes = BTreeSet::from([MapPart::Place("Lift".parse().unwrap())]);
    Some(AlarmNotice { order, places: places.iter().map(|name| name.parse().unwrap()).collect(), closes })
}

#[test]
fn an_alarm_suspends_the_plan_and_closes_places_until_it_is_cleared() {
    let lift: (PlaceId, PlaceId) = ("Lift".parse().unwrap(), "Lift".parse().unwrap());
    let mut orders = StandingOrders::default();
    orders.receive(OrdersNotice { alarm: alarm(&[]), ..notice(5, None) }, at(0));
    assert!(orders.is_held(at(900_000)) && orders.assembly_places(at(0)).is_none(), "it stands still");
    assert_eq!(orders.problem(at(0)), Some("under alarm fire by Nia"));
    assert_eq!(orders.closed(at(900_000)), [lift]);
    orders.receive(OrdersNotice { alarm: alarm(&["Dock"]), ..notice(6, None) }, at(0));
    assert!(orders.is_held(at(0)) && orders.assembly_places(at(0)).is_some());
    orders.receive(notice(7, None), at(0));
    assert!(!orders.is_held(at(0)) && orders.assembly_places(at(0)).is_none());
    assert!(orders.problem(at(0)).is_none() && orders.closed(at(0)).is_empty());
}

#[test]
fn an_alarm_closes_zones_beside_closures_and_speed_limits() {
    let place = |name: &str| -> PlaceId { name.parse().unwrap() };
    let order = OrderNotice { text: "closed by Nia".to_owned(), remaining_ms: None };
    let closures = vec![ClosureNotice { part: MapPart::Place(place("Ward")), order, until_ms: None }];
    let speed = MetresPerSecond::new(0.3).unwrap();
    let limit = SpeedLimitNotice { part: MapPart::Place(place("Hall")), speed, remaining_ms: None };
    let zone = Zone { name: "icu".parse().unwrap(), places: [place("A"), place("B")].into() };
    let alarm = alarm(&["Dock"]).map(|alarm| AlarmNotice { closes: [MapPart::Zone(zone)].into(), ..alarm });
    let mut orders = StandingOrders::default();
    orders.receive(OrdersNotice { closures, speed_limits: vec![limit], alarm, ..notice(5, None) }, at(0));
    let map = orders.map_orders(at(0));
    assert_eq!(map.closed, ["Ward", "A", "B"].map(|name| (place(name), place(name))));
    assert_eq!(map.limits.on(&place("Hall"), &place("Dock")), Some(speed), "also on the way to the assembly");
    orders.change_cluster(at(0));
    let map = orders.map_orders(at(10_000));
    assert!(map.closed.is_empty() && map.limits.is_empty());
}

#[test]
fn a_hold_prevails_over_assembly_until_it_ends() {
    let mut orders = StandingOrders::default();
    orders.receive(OrdersNotice { alarm: alarm(&["Dock"]), ..notice(5, order("held by Nia", Some(1_000))) }, at(0));
    assert!(orders.assembly_places(at(999)).is_none() && orders.assembly_places(at(1_000)).is_some());
    assert!(orders.is_held(at(1_000)));
}

#[test]
fn an_unconfirmed_alarm_stops_for_a_short_time_and_moves_nothing() {
    let mut orders = StandingOrders::default();
    let unconfirmed = OrdersNotice { alarm: alarm(&["Dock"]), ..notice(u64::MAX, None) };
    orders.receive_unconfirmed(&unconfirmed, LEASE, at(0));
    assert!(orders.is_held(at(2_999)) && !orders.is_held(at(3_000)));
    assert!(orders.assembly_places(at(0)).is_none() && orders.closed(at(0)).is_empty());
    orders.receive(OrdersNotice { alarm: alarm(&["Dock"]), ..notice(5, None) }, at(4_000));
    orders.receive_unconfirmed(&unconfirmed, LEASE, at(4_000));
    assert!(orders.assembly_places(at(4_000)).is_some(), "a repetition of the confirmed alarm");
    orders.receive_unconfirmed(&OrdersNotice { alarm: alarm(&[]), ..notice(6, None) }, LEASE, at(4_000));
    assert!(orders.assembly_places(at(6_999)).is_none() && orders.is_held(at(6_999)), "another alarm stops it");
    assert!(orders.assembly_places(at(7_000)).is_some());
}

#[test]
fn an_alarm_of_another_cluster_ends() {
    let mut orders = StandingOrders::default();
    orders.receive(OrdersNotice { alarm: alarm(&["Dock"]), ..notice(100, None) }, at(0));
    orders.change_cluster(at(1_000));
    assert!(orders.is_held(at(10_999)) && !orders.is_held(at(11_000)));
}

#[test]
fn every_place_of_a_closed_zone_is_closed() {
    let place = |name: &str| -> PlaceId { name.parse().unwrap() };
    let zone = Zone { name: "icu".parse().unwrap(), places: [place("A"), place("B")].into() };
    let order = OrderNotice { text: "closed by Nia".to_owned(), remaining_ms: None };
    let closures = vec![ClosureNotice { part: MapPart::Zone(zone), order, until_ms: None }];
    let mut orders = StandingOrders::default();
    orders.receive(OrdersNotice { closures, ..notice(5, None) }, at(0));
    assert_eq!(orders.closed(at(0)), [(place("A"), place("A")), (place("B"), place("B"))]);
    assert_eq!(orders.closure_texts(at(0)), ["zone icu is closed by Nia"]);
}

#[test]
fn a_speed_limit_lasts_to_its_end_or_to_another_notice() {
    let place = |name: &str| -> PlaceId { name.parse().unwrap() };
    let limit = |part, speed, remaining_ms| SpeedLimitNotice {
        part,
        speed: MetresPerSecond::new(speed).unwrap(),
        remaining_ms,
    };
    let ward = limit(MapPart::Place(place("Ward")), 0.3, Some(1_000));
    let lane = limit(MapPart::of_lane(place("B"), place("A")), 0.5, None);
    let mut orders = StandingOrders::default();
    orders.receive(OrdersNotice { speed_limits: vec![ward, lane], ..notice(5, None) }, at(500));
    let on = |orders: &StandingOrders, from, to, ms| {
        orders.map_orders(at(ms)).limits.on(&place(from), &place(to)).map(MetresPerSecond::get)
    };
    assert_eq!(on(&orders, "Hall", "Ward", 1_499), Some(0.3));
    assert_eq!(on(&orders, "Hall", "Ward", 1_500), None);
    assert_eq!(on(&orders, "A", "B", 90_000), Some(0.5));
    orders.change_cluster(at(90_000));
    assert_eq!([99_999, 100_000].map(|ms| on(&orders, "A", "B", ms)), [Some(0.5), None], "it had no end");
    orders.receive(notice(6, None), at(90_500));
    assert!(orders.map_orders(at(90_500)).limits.is_empty());
}

#[test]
fn an_unconfirmed_notice_limits_the_speed_for_a_short_time_and_clears_nothing() {
    let ward: PlaceId = "Ward".parse().unwrap();
    let limited = |index, speed| {
        let speed = MetresPerSecond::new(speed).unwrap();
        let limit = SpeedLimitNotice { part: MapPart::Place(ward.clone()), speed, remaining_ms: None };
        OrdersNotice { speed_limits: vec![limit], ..notice(index, None) }
    };
    let on_ward =
        |orders: &StandingOrders, ms| orders.map_orders(at(ms)).limits.on(&ward, &ward).map(MetresPerSecond::get);
    let mut orders = StandingOrders::default();
    orders.receive_unconfirmed(&limited(7, 0.3), LEASE, at(0));
    assert_eq!([2_999, 3_000].map(|ms| on_ward(&orders, ms)), [Some(0.3), None]);
    orders.receive(limited(7, 0.4), at(5_000));
    orders.receive_unconfirmed(&notice(8, None), LEASE, at(5_000));
    assert_eq!(on_ward(&orders, 60_000), Some(0.4));
    orders.receive_unconfirmed(&limited(9, 0.5), LEASE, at(60_000));
    assert_eq!(on_ward(&orders, 60_000), Some(0.4), "the lowest limit counts");
    orders.receive(notice(9, None), at(61_000));
    assert_eq!(on_ward(&orders, 61_000), None);
}

#[test]
fn a_robot_in_maintenance_is_not_held_and_takes_no_role() {
    let mut orders = StandingOrders::default();
    let maintenance = order("in maintenance by Nia: tyres", None);
    orders.receive(OrdersNotice { maintenance, ..notice(5, None) }, at(0));
    assert!(!orders.is_held(at(9_000)));
    assert_eq!(orders.problem(at(9_000)), Some("in maintenance by Nia: tyres"));
}
