use super::*;

fn at(ms: u64) -> NodeTime {
    NodeTime::at(Duration::from_millis(ms))
}

fn place(name: &str) -> PlaceId {
    name.parse().unwrap()
}

fn robot(name: &str) -> RobotId {
    name.parse().unwrap()
}

fn epoch(index: u64) -> Epoch {
    Epoch { term: 1, index }
}

fn user(name: &str, charge: f64, charging: Option<Charging>) -> ChargerUser {
    let battery = BatteryShare::new(charge).unwrap();
    ChargerUser { robot: robot(name), place: place("Hall"), battery, charging, is_alive: true }
}

fn waiting(name: &str, charge: f64, chargers: &[&str]) -> ChargerUser {
    let chargers = chargers.iter().map(|charger| place(charger)).collect();
    user(name, charge, Some(Charging::Waiting { chargers }))
}

fn claim(lease: Option<u64>) -> ChargerClaim {
    let drive_s = Some(Seconds::new(10.0).unwrap());
    ChargerClaim { charger: place("P"), battery: BatteryShare::new(0.2).unwrap(), lease, drive_s }
}

fn bound(name: &str, lease: Option<u64>) -> ChargerUser {
    user(name, 0.2, Some(Charging::Bound(claim(lease))))
}

fn connected(name: &str, lease: Option<u64>) -> ChargerUser {
    let user = user(name, 0.2, Some(Charging::Connected(claim(lease))));
    ChargerUser { place: place("P"), ..user }
}

fn lease(charger: &str, name: &str) -> ResourceAction {
    ResourceAction::Lease { resource: Resource::Charger(place(charger)), robot: robot(name) }
}

fn notify(name: &str) -> ResourceAction {
    ResourceAction::Notify { resource: Resource::Charger(place("P")), robot: robot(name), epoch: epoch(5) }
}

fn free(name: &str, cause: EndOfLease) -> ResourceAction {
    ResourceAction::Free { resource: Resource::Charger(place("P")), robot: robot(name), epoch: epoch(5), cause }
}

/// Returns the leases of a ledger in which `P` is leased to the robot.
fn leased(name: &str) -> BTreeMap<PlaceId, ResourceLease> {
    BTreeMap::from([(place("P"), ResourceLease { robot: robot(name), epoch: epoch(5), since_ms: 0 })])
}

fn granted(robots: &[ChargerUser]) -> Vec<ResourceAction> {
    ChargerLeases::default().due(&BTreeMap::new(), robots, at(0))
}

#[test]
fn a_free_charger_goes_to_the_robot_with_the_least_charge() {
    let ada = || waiting("ada", 0.2, &["P", "Q"]);
    let bob = || waiting("bob", 0.1, &["P"]);
    assert_eq!(granted(&[ada(), bob()]), [lease("P", "bob"), lease("Q", "ada")]);
    assert_eq!(granted(&[bound("cyd", None), ada()]), [lease("P", "ada")], "the first name of equal charges");
    assert_eq!(granted(&[user("dan", 0.1, None), ada()]), [lease("P", "ada")], "a robot gets one");
    let down = ChargerUser { is_alive: false, charging: None, ..bob() };
    assert_eq!(granted(&[ada(), down]), [lease("P", "ada")]);
}

#[test]
fn a_charger_at_which_another_robot_stands_is_not_leased() {
    let stands = |name: &str| ChargerUser { place: place("P"), ..user(name, 0.9, None) };
    assert_eq!(granted(&[waiting("ada", 0.2, &["P"]), stands("bob")]), []);
    let down = ChargerUser { is_alive: false, ..stands("bob") };
    assert_eq!(granted(&[waiting("ada", 0.2, &["P"]), down]), []);
    assert_eq!(granted(&[waiting("ada", 0.1, &["P"]), connected("bob", None)]), [lease("P", "bob")], "it is connected");
    assert_eq!(granted(&[ChargerUser { place: place("P"), ..waiting("ada", 0.2, &["P"]) }]), [lease("P", "ada")]);
}

#[test]
fn a_proposed_lease_is_repeated_and_no_other_is_proposed_meanwhile() {
    let mut leases = ChargerLeases::default();
    let robots = [waiting("ada", 0.2, &["P"]), waiting("bob", 0.1, &["P"])];
    let mut due = |ms| leases.due(&BTreeMap::new(), &robots, at(ms));
    assert_eq!(due(0), [lease("P", "bob")]);
    assert_eq!(due(499), []);
    assert_eq!(due(500), [lease("P", "bob")]);
}

#[test]
fn a_lease_is_kept_while_its_robot_comes_and_charges() {
    let mut leases = ChargerLeases::default();
    let mut due = |user: ChargerUser, ms| leases.due(&leased("ada"), &[user], at(ms));
    assert_eq!(due(waiting("ada", 0.2, &["P"]), 0), [notify("ada")]);
    assert_eq!(due(waiting("ada", 0.2, &["P"]), 499), []);
    assert_eq!(due(waiting("ada", 0.2, &["P"]), 500), [notify("ada")]);
    assert_eq!(due(bound("ada", Some(5)), 600), []);
    assert_eq!(due(bound("ada", Some(5)), 90_000), []);
    assert_eq!(due(connected("ada", Some(5)), 90_100), []);
    assert_eq!(due(connected("ada", Some(5)), 90_000_000), []);
    assert_eq!(due(user("ada", 0.9, None), 90_000_001), [free("ada", EndOfLease::Done)]);
}

#[test]
fn a_lease_ends_when_its_robot_does_not_answer_or_come() {
    let mut leases = ChargerLeases::default();
    let mut due = |user: ChargerUser, ms| leases.due(&leased("ada"), &[user], at(ms));
    due(bound("ada", Some(4)), 0);
    assert_eq!(due(bound("ada", Some(4)), 9_999), [notify("ada")], "the claim has an earlier lease");
    assert_eq!(due(bound("ada", Some(4)), 10_000), [free("ada", EndOfLease::NoAnswer)]);
    assert_eq!(due(bound("ada", Some(4)), 10_499), []);
    assert_eq!(due(bound("ada", Some(4)), 10_500), [free("ada", EndOfLease::NoAnswer)], "the proposal is repeated");
    let mut leases = ChargerLeases::default();
    let mut due = |ms| leases.due(&leased("ada"), &[bound("ada", Some(5))], at(ms));
    due(0);
    assert_eq!(due(99_999), [], "60 s and four times its estimate of 10 s");
    assert_eq!(due(100_000), [free("ada", EndOfLease::Late)]);
}

#[test]
fn a_robot_that_did_not_come_is_passed_over_for_a_minute() {
    let mut leases = ChargerLeases::default();
    let robots = [bound("ada", Some(5)), waiting("bob", 0.3, &["P"])];
    leases.due(&leased("ada"), &robots, at(0));
    assert_eq!(leases.due(&leased("ada"), &robots, at(100_000)), [free("ada", EndOfLease::Late)]);
    assert_eq!(leases.due(&BTreeMap::new(), &robots, at(100_100)), [lease("P", "bob")]);
    assert_eq!(leases.due(&BTreeMap::new(), &robots[..1], at(159_999)), []);
    assert_eq!(leases.due(&BTreeMap::new(), &robots[..1], at(160_000)), [lease("P", "ada")]);
}

#[test]
fn a_connected_robot_that_did_not_answer_is_passed_over_for_a_minute() {
    let mut leases = ChargerLeases::default();
    let robots = [connected("ada", None), waiting("bob", 0.1, &["P"])];
    leases.due(&leased("ada"), &robots, at(0));
    assert_eq!(leases.due(&leased("ada"), &robots, at(10_000)), [free("ada", EndOfLease::NoAnswer)]);
    let mut due = |ms| leases.due(&BTreeMap::new(), &robots, at(ms));
    assert_eq!(due(10_100), [], "no other robot can use it");
    assert_eq!(due(69_999), []);
    assert_eq!(due(70_000), [lease("P", "ada")]);
}

#[test]
fn the_lease_of_a_robot_that_is_gone_ends_after_5_s() {
    let gone = || ChargerUser { is_alive: false, charging: None, ..bound("ada", Some(5)) };
    let mut leases = ChargerLeases::default();
    assert_eq!(leases.due(&leased("ada"), &[gone()], at(0)), []);
    assert_eq!(leases.due(&leased("ada"), &[bound("ada", Some(5))], at(4_000)), [], "it is back");
    assert_eq!(leases.due(&leased("ada"), &[], at(5_000)), []);
    assert_eq!(leases.due(&leased("ada"), &[], at(9_999)), []);
    assert_eq!(leases.due(&leased("ada"), &[], at(10_000)), [free("ada", EndOfLease::Gone)]);
}

#[test]
fn a_waiting_robot_overtakes_only_with_clearly_less_charge() {
    let mut queue = ChargerQueue::default();
    let mut order = |ada, bob| {
        queue.update(&[waiting("ada", ada, &["P"]), waiting("bob", bob, &["P"])]);
        queue.robots().map(RobotId::to_string).collect::<Vec<_>>()
    };
    assert_eq!(order(0.25, 0.2), ["bob", "ada"]);
    assert_eq!(order(0.19, 0.2), ["bob", "ada"]);
    assert_eq!(order(0.17, 0.2), ["ada", "bob"]);
    assert_eq!(order(0.17, 0.16), ["ada", "bob"]);
}

#[test]
fn the_queue_of_each_charger_has_the_robots_that_wait_for_it() {
    let robots = [waiting("ada", 0.2, &["P", "Q"]), waiting("bob", 0.1, &["P"]), bound("cyd", None)];
    let expected = [(place("P"), vec![robot("bob"), robot("ada")]), (place("Q"), vec![robot("ada")])];
    assert_eq!(ChargerQueue::waiting(&robots), BTreeMap::from(expected));
}

#[test]
fn the_queue_is_bounded() {
    let robots: Vec<ChargerUser> =
        (0..300).map(|number| waiting(&format!("r{number}"), f64::from(300 - number) / 400.0, &["P"])).collect();
    let mut queue = ChargerQueue::default();
    queue.update(&robots);
    assert_eq!(queue.robots().count(), 256);
    assert_eq!(queue.robots().next(), Some(&robot("r299")));
}
