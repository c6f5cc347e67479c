use super::*;
use crate::auction::{AuctionId, AuctionRecord};
use crate::ids::{MissionId, PlaceId, RoleId};
use crate::ledger::alarm::ALARMS_BYTES_MAX;
use crate::ledger::order_book::ORDER_REQUESTS_BYTES_MAX;
use crate::ledger::test_values::{Log, rounds};
use crate::ledger::{AlarmPlan, AlarmResponse, Branch, Command, OrderChange, RobotOrder, Zone};
use crate::message::OrdersNotice;
use crate::units::MetresPerSecond;
use std::collections::BTreeMap;

fn robot(name: &str) -> RobotId {
    name.parse().unwrap()
}

impl Log {
    fn order(&mut self, robots: &[&str], change: OrderChange, at_ms: u64) -> CommandOutcome {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms, request: None };
        self.request(robots, order)
    }

    fn request(&mut self, robots: &[&str], order: OrderRequest) -> CommandOutcome {
        let robots = robots.iter().map(|name| robot(name)).collect();
        self.apply(Command::OrderRobots { robots, order })
    }

    fn close(&mut self, parts: &[MapPart], until_ms: Option<u64>) -> CommandOutcome {
        self.change_closures(parts, ClosureChange::Close { until_ms, reason: "a spill".to_owned() })
    }

    fn change_closures(&mut self, parts: &[MapPart], change: ClosureChange) -> CommandOutcome {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 100, request: None };
        self.apply(Command::ChangeClosures { parts: parts.iter().cloned().collect(), order })
    }

    fn limit(&mut self, parts: &[MapPart], speed: f64, until_ms: Option<u64>) -> CommandOutcome {
        let speed = MetresPerSecond::new(speed).unwrap();
        self.change_speed_limits(parts, SpeedLimitChange::Set { speed, until_ms, reason: "a spill".to_owned() })
    }

    fn change_speed_limits(&mut self, parts: &[MapPart], change: SpeedLimitChange) -> CommandOutcome {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 100, request: None };
        self.apply(Command::ChangeSpeedLimits { parts: parts.iter().cloned().collect(), order })
    }

    /// Returns the speed limits as text.
    fn speed_limits(&self) -> Vec<String> {
        self.0.speed_limits().map(|limit| limit.text()).collect()
    }

    fn raise(&mut self, alarm: &str, plan: &AlarmPlan) -> CommandOutcome {
        let (alarm, plan) = (alarm.parse().unwrap(), plan.clone());
        self.change_alarms(AlarmChange::Raise { alarm, plan, reason: "smoke".to_owned() })
    }

    fn clear(&mut self, alarm: Option<&str>) -> CommandOutcome {
        self.change_alarms(AlarmChange::Clear { alarm: alarm.map(|alarm| alarm.parse().unwrap()) })
    }

    fn change_alarms(&mut self, change: AlarmChange) -> CommandOutcome {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 100, request: None };
        self.apply(Command::ChangeAlarms { order })
    }

    /// Returns the closed places and lanes as text.
    fn closed(&self) -> Vec<String> {
        self.0.closures().map(|closure| closure.part.to_string()).collect()
    }

    fn hold_until(&self, name: &str) -> Option<u64> {
        self.0.orders_of(&robot(name))?.hold.as_ref()?.until_ms
    }

    fn award(&mut self, mission: &MissionId, name: &str) -> CommandOutcome {
        let role: RoleId = "r1".parse().unwrap();
        let auction = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
        let holders = BTreeMap::from([(role, robot(name))]);
        self.apply(Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction })
    }
}

fn hold(until_ms: u64) -> OrderChange {
    OrderChange::Hold { until_ms, reason: "a spill".to_owned() }
}

fn maintain(until_ms: Option<u64>) -> OrderChange {
    OrderChange::Maintain { until_ms, reason: "new tyres".to_owned() }
}

#[test]
fn a_hold_lasts_until_its_release_or_its_time() {
    let mut log = Log::new();
    assert_eq!(log.order(&["ada", "bob"], hold(500), 100), CommandOutcome::Done);
    let order = RobotOrder { by: "Nia".to_owned(), reason: "a spill".to_owned(), since_ms: 100, until_ms: Some(500) };
    let expected = RobotOrders { hold: Some(order), maintenance: None };
    assert_eq!(log.0.orders_of(&robot("ada")), Some(&expected));
    assert!(log.0.is_held(&robot("bob")) && !log.0.is_held(&robot("cyd")));
    log.order(&["ada"], OrderChange::Release, 200);
    assert_eq!((log.hold_until("ada"), log.hold_until("bob")), (None, Some(500)));
    assert!(!log.0.has_order_to_expire(499) && log.0.has_order_to_expire(500));
    log.apply(Command::ExpireOrders { now_ms: 499 });
    assert_eq!(log.hold_until("bob"), Some(500));
    log.apply(Command::ExpireOrders { now_ms: 500 });
    assert_eq!(log.0.robot_orders().count(), 0);
}

#[test]
fn the_latest_hold_counts_and_maintenance_is_independent_of_it() {
    let mut log = Log::new();
    log.order(&["ada"], maintain(None), 50);
    log.order(&["ada"], hold(500), 100);
    log.order(&["ada"], hold(300), 150);
    assert_eq!(log.hold_until("ada"), Some(300));
    let text = "held by Nia: a spill; in maintenance by Nia: new tyres";
    assert_eq!(log.0.orders_of(&robot("ada")).unwrap().problem().as_deref(), Some(text));
    log.apply(Command::ExpireOrders { now_ms: u64::MAX });
    assert!(log.0.orders_of(&robot("ada")).is_some_and(|orders| orders.maintenance.is_some()), "it has no end");
    log.order(&["ada"], OrderChange::EndMaintenance, 600);
    assert_eq!(log.0.orders_of(&robot("ada")), None);
}

#[test]
fn orders_to_a_robot_end_when_it_has_left() {
    let mut log = Log::new();
    log.order(&["ada", "bob"], maintain(None), 50);
    let ordered = log.0.orders_changed();
    let robots = BTreeSet::from([robot("ada"), robot("cyd")]);
    assert_eq!(log.apply(Command::EndOrders { robots: robots.clone() }), CommandOutcome::Done);
    let ended = log.0.orders_changed();
    assert!(log.0.robot_orders().map(|(robot, _)| robot).eq([&robot("bob")]) && ended > ordered);
    log.apply(Command::EndOrders { robots });
    assert_eq!(log.0.orders_changed(), ended, "they had none");
}

#[test]
fn a_clock_that_no_majority_confirms_ends_no_hold() {
    let mut log = Log::new();
    log.order(&["ada"], hold(500), 100);
    let remaining = |confirmed_ms| OrdersNotice::of(&log.0, &robot("ada"), confirmed_ms).hold.unwrap().remaining_ms;
    assert_eq!([remaining(Some(350)), remaining(Some(600))], [Some(150), Some(0)]);
    assert_eq!(remaining(None), Some(400), "the whole period");
}

/// A robot ignores orders of an earlier position.
#[test]
fn the_position_of_the_latest_change_grows_with_changes_only() {
    let mut log = Log::new();
    assert_eq!(log.0.orders_changed(), Epoch::default());
    log.order(&["ada"], OrderChange::Release, 50);
    assert_eq!(log.0.orders_changed(), Epoch::default(), "it was not held");
    log.order(&["ada"], hold(500), 100);
    let held = log.0.orders_changed();
    assert!(held > Epoch::default());
    log.apply(Command::ExpireOrders { now_ms: 400 });
    assert_eq!(log.0.orders_changed(), held);
    log.apply(Command::ExpireOrders { now_ms: 500 });
    assert!(log.0.orders_changed() > held);
}

/// A relay may send a copy of a signed request to the next coordinator.
#[test]
fn a_copy_of_a_signed_request_changes_nothing() {
    let mut log = Log::new();
    let signed = |number: usize, change| {
        // The longest name.
        let request = Some(format!("kim-{number:060}").parse().unwrap());
        OrderRequest { change, by: "kim".to_owned(), at_ms: 100, request }
    };
    log.request(&["ada"], signed(1, hold(500)));
    log.request(&["ada"], signed(2, OrderChange::Release));
    let released = log.0.orders_changed();
    assert_eq!(log.request(&["ada"], signed(1, hold(500))), CommandOutcome::Done);
    assert_eq!((log.hold_until("ada"), log.0.orders_changed()), (None, released));
    log.request(&["ada"], signed(3, hold(600)));
    log.request(&["ada"], signed(2, OrderChange::Release));
    assert_eq!(log.hold_until("ada"), Some(600));
    (4..1000).for_each(|number| drop(log.request(&["bob"], signed(number, hold(600)))));
    let book = log.0.order_book();
    assert!(
        book.requests.len() == ORDER_REQUESTS_MAX && codec::encoded_size(&book.requests) <= ORDER_REQUESTS_BYTES_MAX
    );
}

#[test]
fn a_robot_under_orders_gets_no_role() {
    for (change, end, problem) in [
        (hold(500), OrderChange::Release, "held by Nia: a spill"),
        (maintain(None), OrderChange::EndMaintenance, "in maintenance by Nia: new tyres"),
    ] {
        let mut log = Log::new();
        let CommandOutcome::Submitted { mission, .. } = log.apply(Command::Submit(Box::new(rounds("request")))) else {
            panic!()
        };
        log.order(&["ada"], change, 100);
        let (ada, problem) = (robot("ada"), problem.to_owned());
        let refused = CommandOutcome::Refused(CommandError::UnderOrders { robot: ada, problem });
        assert_eq!(log.award(&mission, "ada"), refused);
        log.order(&["ada"], end, 200);
        assert!(matches!(log.award(&mission, "ada"), CommandOutcome::Awarded { .. }));
    }
}

#[test]
fn the_holder_of_a_role_keeps_it_when_it_is_held() {
    let mut log = Log::new();
    let CommandOutcome::Submitted { mission, .. } = log.apply(Command::Submit(Box::new(rounds("request")))) else {
        panic!()
    };
    assert!(matches!(log.award(&mission, "ada"), CommandOutcome::Awarded { .. }));
    log.order(&["ada"], hold(500), 100);
    assert!(log.0.held_by(&robot("ada")).is_some());
}

#[test]
fn orders_are_limited_in_size_and_need_a_wire_version() {
    let mut log = Log::new();
    let reason = "x".repeat(10_000);
    let robots: Vec<String> = (0..1000).map(|number| format!("robot-{number}")).collect();
    let mut outcomes = robots
        .iter()
        .map(|name| log.order(&[name.as_str()], OrderChange::Hold { until_ms: 500, reason: reason.clone() }, 100));
    assert_eq!(outcomes.next(), Some(CommandOutcome::Done), "its reason is shortened");
    assert!(outcomes.any(|outcome| outcome == CommandOutcome::Refused(CommandError::OrdersFull)));
    let (count, bytes) = (log.0.robot_orders().count(), size(log.0.order_book().orders.robots.iter()));
    assert!(count > 300 && bytes <= ORDERS_BYTES_MAX, "{count} orders take {bytes} bytes");
    let mut before = Log(Ledger::default(), 1);
    let not_yet = CommandOutcome::Refused(CommandError::NoOrdersYet { since: HISTORY_SINCE });
    assert_eq!(before.order(&["ada"], hold(500), 100), not_yet);
}

fn ward(name: &str) -> MapPart {
    MapPart::Place(place(name))
}

fn place(name: &str) -> PlaceId {
    name.parse().unwrap()
}

#[test]
fn a_place_is_closed_until_it_is_opened_or_its_time_has_passed() {
    let mut log = Log::new();
    let lane = MapPart::of_lane(place("C"), place("B"));
    assert_eq!(lane, MapPart::of_lane(place("B"), place("C")), "a lane has no direction");
    assert_eq!(log.close(&[ward("A"), lane.clone()], Some(500)), CommandOutcome::Done);
    let order = RobotOrder { by: "Nia".to_owned(), reason: "a spill".to_owned(), since_ms: 100, until_ms: Some(500) };
    let first = Closure { part: ward("A"), order };
    assert_eq!((log.0.closures().next(), log.closed()), (Some(first), vec!["A".to_owned(), "B – C".to_owned()]));
    let closed = log.0.orders_changed();
    log.change_closures(&[ward("B")], ClosureChange::Open);
    assert_eq!(log.0.orders_changed(), closed, "a lane to it is closed, not the place");
    log.change_closures(&[lane], ClosureChange::Open);
    assert_eq!(log.closed(), ["A"]);
    assert!(log.0.orders_changed() > closed);
    assert!(!log.0.has_order_to_expire(499) && log.0.has_order_to_expire(500));
    log.apply(Command::ExpireOrders { now_ms: 499 });
    assert_eq!(log.closed(), ["A"]);
    log.apply(Command::ExpireOrders { now_ms: 500 });
    assert_eq!((log.closed(), log.0.has_order_to_expire(u64::MAX)), (vec![], false));
}

#[test]
fn the_latest_closure_of_a_place_counts() {
    let mut log = Log::new();
    log.close(&[ward("A")], Some(500));
    log.close(&[ward("A")], None);
    log.apply(Command::ExpireOrders { now_ms: u64::MAX });
    assert_eq!(log.closed(), ["A"]);
}

/// The fleet file may change while a zone is closed.
#[test]
fn a_closed_zone_is_known_by_its_name() {
    let zone = |places: &[&str]| {
        let places = places.iter().map(|name| place(name)).collect();
        MapPart::Zone(Zone { name: "icu".parse().unwrap(), places })
    };
    let mut log = Log::new();
    log.close(&[ward("A"), zone(&["A", "B"])], None);
    assert_eq!(log.closed(), ["zone icu", "A"]);
    log.close(&[zone(&["B", "C"])], None);
    let closed: Vec<_> = log.0.closures().flat_map(|closure| closure.part.pairs()).collect();
    assert_eq!(closed, ["B", "C", "A"].map(|name| (place(name), place(name))), "the latest closure counts");
    log.change_closures(&[zone(&[])], ClosureChange::Open);
    assert_eq!(log.closed(), ["A"], "the place was closed on its own, too");
}

/// A renewal of a lease has other large parts, too.
#[test]
fn a_notice_with_all_orders_takes_half_of_a_message_at_most() {
    let (mut log, now_ms) = (Log::new(), 1_767_225_600_000);
    let (until_ms, by) = (Some(now_ms + 31_622_400_000), "N".to_owned());
    let parts = |number: u64| BTreeSet::from([ward(&format!("W{number}"))]);
    let mut outcomes = (0..1000).map(|number| {
        let change = ClosureChange::Close { until_ms, reason: String::new() };
        let order = OrderRequest { change, by: by.clone(), at_ms: now_ms, request: None };
        log.apply(Command::ChangeClosures { parts: parts(number), order })
    });
    assert!(outcomes.any(|outcome| outcome == CommandOutcome::Refused(CommandError::ClosuresFull)));
    let mut outcomes = (0..1000).map(|number| {
        let speed = MetresPerSecond::new(0.3).unwrap();
        let change = SpeedLimitChange::Set { speed, until_ms, reason: String::new() };
        let order = OrderRequest { change, by: by.clone(), at_ms: now_ms, request: None };
        log.apply(Command::ChangeSpeedLimits { parts: parts(number), order })
    });
    assert!(outcomes.any(|outcome| outcome == CommandOutcome::Refused(CommandError::SpeedLimitsFull)));
    let places = (0..600).map(|number| place(&format!("W{number}"))).collect();
    let zone = MapPart::Zone(Zone { name: "all".parse().unwrap(), places });
    assert_eq!(log.raise("fire", &alarm_plan(AlarmResponse::Stop, &[], &[zone])), CommandOutcome::Done);
    let bytes = codec::encoded_size(&OrdersNotice::of(&log.0, &robot("ada"), Some(now_ms)));
    assert!((CLOSURES_BYTES_MAX..=codec::MESSAGE_BYTES_MAX / 2).contains(&bytes), "{bytes} bytes");
}

#[test]
fn closures_are_limited_in_size_and_need_a_wire_version() {
    let mut log = Log::new();
    let mut outcomes = (0..1000).map(|number| log.close(&[ward(&format!("Ward {number}"))], None));
    assert!(outcomes.any(|outcome| outcome == CommandOutcome::Refused(CommandError::ClosuresFull)));
    let (count, bytes) = (log.closed().len(), size(log.0.order_book().orders.closures.iter()));
    assert!(count > 200 && bytes <= CLOSURES_BYTES_MAX, "{count} closures take {bytes} bytes");
    let mut before = Log(Ledger::default(), 1);
    let not_yet = CommandOutcome::Refused(CommandError::NoOrdersYet { since: HISTORY_SINCE });
    assert_eq!(before.close(&[ward("A")], None), not_yet);
}

#[test]
fn a_speed_limit_holds_until_it_is_cleared_or_its_time_has_passed() {
    let mut log = Log::new();
    log.limit(&[ward("A"), ward("B")], 0.5, None);
    assert_eq!(log.limit(&[ward("A")], 0.3, Some(500)), CommandOutcome::Done);
    let [a, b] =
        [("A", 0.3), ("B", 0.5)].map(|(name, speed)| format!("{name} is limited to {speed} m/s by Nia: a spill"));
    assert_eq!(log.speed_limits(), [a, b.clone()], "the latest limit of a place counts");
    let notice = OrdersNotice::of(&log.0, &robot("ada"), Some(200));
    let sent: Vec<_> = notice.speed_limits.iter().map(|limit| (limit.speed.get(), limit.remaining_ms)).collect();
    assert_eq!(sent, [(0.3, Some(300)), (0.5, None)]);
    assert!(!notice.is_empty() && log.closed().is_empty());
    assert!(!log.0.has_order_to_expire(499) && log.0.has_order_to_expire(500));
    log.apply(Command::ExpireOrders { now_ms: 500 });
    assert_eq!(log.speed_limits(), [b]);
    let limited = log.0.orders_changed();
    log.change_speed_limits(&[ward("C")], SpeedLimitChange::Clear);
    assert_eq!(log.0.orders_changed(), limited, "it had no limit");
    log.change_speed_limits(&[ward("B")], SpeedLimitChange::Clear);
    assert!(log.speed_limits().is_empty() && log.0.orders_changed() > limited);
}

#[test]
fn speed_limits_are_limited_in_size_and_need_a_wire_version() {
    let mut log = Log::new();
    let mut outcomes = (0..1000).map(|number| log.limit(&[ward(&format!("Ward {number}"))], 0.3, None));
    assert!(outcomes.any(|outcome| outcome == CommandOutcome::Refused(CommandError::SpeedLimitsFull)));
    let (count, bytes) = (log.speed_limits().len(), size(log.0.order_book().orders.speed_limits.iter()));
    assert!(count > 50 && bytes <= SPEED_LIMITS_BYTES_MAX, "{count} limits take {bytes} bytes");
    let notice = codec::encoded_size(&OrdersNotice::of(&log.0, &robot("ada"), Some(100)));
    assert!(notice <= SPEED_LIMITS_BYTES_MAX * 2, "{notice} bytes");
    let mut before = Log(Ledger::default(), 1);
    let not_yet = CommandOutcome::Refused(CommandError::NoOrdersYet { since: HISTORY_SINCE });
    assert_eq!(before.limit(&[ward("A")], 0.3, None), not_yet);
}

fn alarm_plan(robots: AlarmResponse, places: &[&str], closes: &[MapPart]) -> AlarmPlan {
    let places = places.iter().map(|name| place(name)).collect();
    AlarmPlan { robots, places, closes: closes.iter().cloned().collect() }
}

#[test]
fn an_alarm_lasts_until_it_is_cleared_whatever_the_time() {
    let mut log = Log::new();
    let plan = alarm_plan(AlarmResponse::Assemble, &["Dock"], &[ward("Lift")]);
    assert_eq!(log.raise("fire", &plan), CommandOutcome::Done);
    let order = RobotOrder { by: "Nia".to_owned(), reason: "smoke".to_owned(), since_ms: 100, until_ms: None };
    let expected = Alarm { alarm: "fire".parse().unwrap(), plan: plan.clone(), order };
    assert_eq!(log.0.alarms().collect::<Vec<_>>(), [&expected]);
    assert!(!log.0.has_order_to_expire(u64::MAX));
    log.apply(Command::ExpireOrders { now_ms: u64::MAX });
    log.apply(Command::EndOrders { robots: [robot("ada")].into() });
    assert!(log.0.has_alarm() && log.0.is_held(&robot("ada")));
    log.raise("flood", &plan);
    let raised = log.0.orders_changed();
    log.clear(Some("fire"));
    assert!(log.0.has_alarm() && log.0.orders_changed() > raised, "the robots are notified");
    log.raise("fire", &plan);
    log.clear(None);
    assert!(!log.0.has_alarm() && !log.0.is_held(&robot("ada")));
}

#[test]
fn no_robot_gets_a_role_during_an_alarm_and_each_keeps_its_own() {
    let mut log = Log::new();
    let [first, second] = [0, 1].map(|number| {
        let submission = Box::new(rounds(&format!("request-{number}")));
        let CommandOutcome::Submitted { mission, .. } = log.apply(Command::Submit(submission)) else { panic!() };
        mission
    });
    assert!(matches!(log.award(&first, "ada"), CommandOutcome::Awarded { .. }));
    log.raise("fire", &alarm_plan(AlarmResponse::Stop, &[], &[]));
    assert!(log.0.held_by(&robot("ada")).is_some());
    let problem = "under alarm fire by Nia: smoke".to_owned();
    let refused = CommandOutcome::Refused(CommandError::UnderOrders { robot: robot("bob"), problem });
    assert_eq!(log.award(&second, "bob"), refused);
    log.clear(None);
    assert!(matches!(log.award(&second, "bob"), CommandOutcome::Awarded { .. }));
}

#[test]
fn a_notice_combines_all_alarms_and_to_stop_prevails() {
    let mut log = Log::new();
    let notice = |log: &Log| OrdersNotice::of(&log.0, &robot("ada"), Some(500));
    let names = |places: &BTreeSet<PlaceId>| places.iter().map(PlaceId::to_string).collect::<Vec<_>>();
    let closed = |parts: &BTreeSet<MapPart>| parts.iter().map(MapPart::to_string).collect::<Vec<_>>();
    assert_eq!(notice(&log).alarm, None);
    log.raise("fire", &alarm_plan(AlarmResponse::Assemble, &["Dock"], &[ward("Lift")]));
    log.raise("flood", &alarm_plan(AlarmResponse::Assemble, &["Roof"], &[ward("Cellar")]));
    let both = notice(&log);
    assert!(!both.is_empty() && both.hold.is_none());
    let both = both.alarm.unwrap();
    assert_eq!(both.order.text, "under alarm fire by Nia: smoke; under alarm flood by Nia: smoke");
    assert_eq!((both.order.remaining_ms, names(&both.places)), (None, vec!["Dock".to_owned(), "Roof".to_owned()]));
    assert_eq!(closed(&both.closes), ["Cellar", "Lift"]);
    log.raise("quake", &alarm_plan(AlarmResponse::Stop, &[], &[]));
    let stop = notice(&log).alarm.unwrap();
    assert_eq!((names(&stop.places), closed(&stop.closes)), (vec![], vec!["Cellar".to_owned(), "Lift".to_owned()]));
    log.clear(Some("quake"));
    assert_eq!(names(&notice(&log).alarm.unwrap().places), ["Dock", "Roof"]);
}

#[test]
fn alarms_are_limited_and_need_a_wire_version() {
    let mut log = Log::new();
    let plan = alarm_plan(AlarmResponse::Stop, &[], &[ward("Lift")]);
    let mut outcomes = (0..100).map(|number| log.raise(&format!("alarm-{number}"), &plan));
    assert!(outcomes.any(|outcome| matches!(outcome, CommandOutcome::Refused(CommandError::AlarmsFull { .. }))));
    assert_eq!(log.0.alarms().count(), 16);
    assert!(size(log.0.order_book().orders.alarms.iter()) <= ALARMS_BYTES_MAX);
    let mut before = Log(Ledger::default(), 1);
    let not_yet = CommandOutcome::Refused(CommandError::NoOrdersYet { since: HISTORY_SINCE });
    assert_eq!(before.raise("fire", &plan), not_yet);
}
