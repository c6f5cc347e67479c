use super::*;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::knowledge::{
    Attributes, Availability, Digest, DigestScope, Motion, MotionUpdate, RobotKnowledge,
};
use consort_protocol::message::RecordUpdate;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, SharePerSecond};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

fn node(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn at(ms: u64) -> NodeTime {
    NodeTime::at(Duration::from_millis(ms))
}

fn knowledge(replica: Option<u64>) -> Knowledge {
    Knowledge { may_vote: false, replica, ..Knowledge::of(None) }
}

fn settings() -> Settings {
    Settings::new(FleetId::new("ward").unwrap(), node("ada"), 1)
}

/// Returns the gossip of Ada, for which Bob and Cyd are alive.
fn ada() -> (Gossiper, GossipState) {
    ada_with(settings(), knowledge(None))
}

/// Does the same with these settings and this knowledge.
fn ada_with(settings: Settings, knowledge: Knowledge) -> (Gossiper, GossipState) {
    let mut state = GossipState::default();
    let rng = ChaCha8Rng::seed_from_u64(1);
    let start = GossiperStart { settings, knowledge, signer: None, rng };
    let (gossiper, first) = Gossiper::new(start, &mut state, NodeTime::ZERO);
    assert!(matches!(&first[..], [Action::Publish(RecordUpdate::Record(_))]));
    for other in ["bob", "cyd"] {
        state.status.insert(node(other), MemberStatus::Alive { since: NodeTime::ZERO });
    }
    (gossiper, state)
}

/// Returns the updates that Ada publishes and the requests that she sends in these milliseconds.
/// Each request gets `reply` as its reply.
fn run(
    (ada, state): (&mut Gossiper, &mut GossipState),
    span: std::ops::Range<u64>,
    reply: impl Fn() -> Option<Exchange>,
) -> (Vec<RecordUpdate>, Vec<(NodeId, Exchange)>) {
    let (mut updates, mut requests) = (vec![], vec![]);
    for ms in span.step_by(100) {
        let mut actions = ada.handle(Event::TimerFired, state, at(ms)).unwrap();
        while let Some(action) = actions.pop() {
            match action {
                Action::Publish(statement) => updates.push(statement),
                Action::SendRequest(number, peer, exchange) => {
                    requests.push((peer, exchange));
                    actions.extend(ada.handle(Event::ReplyReceived(number, reply()), state, at(ms)).unwrap());
                }
                Action::PublishMotion(_) | Action::Send(..) | Action::SendReply(_) => {}
            }
        }
    }
    (updates, requests)
}

/// Returns the reply of a peer with the same records.
fn same_records() -> Option<Exchange> {
    Some(Exchange { sums: vec![], scope: DigestScope::NONE, digest: Digest::new(), records: vec![] })
}

/// Returns the version of a refresh and the first version with the same content; `None` for a whole
/// record.
fn refresh_of(updates: &RecordUpdate) -> Option<(u64, u64)> {
    match updates {
        RecordUpdate::Refresh { stamp, since, .. } => Some((stamp.version, *since)),
        RecordUpdate::Record(_) => None,
    }
}

#[test]
fn an_unchanged_record_is_refreshed_and_a_change_is_repeated() {
    let (mut ada, mut state) = ada();
    let (full, _) = run((&mut ada, &mut state), 0..10_000, same_records);
    assert!(full.len() >= 8 && full.iter().all(|updates| refresh_of(updates).is_none()), "{full:?}");
    let (refreshes, _) = run((&mut ada, &mut state), 10_000..20_000, same_records);
    assert!(refreshes.len() >= 8, "{refreshes:?}");
    // New versions show distant nodes that she still publishes.
    assert!(
        refreshes.iter().all(|updates| refresh_of(updates).is_some_and(|(version, since)| since == 0 && version > 0)),
        "{refreshes:?}"
    );

    let change = Event::KnowledgeChanged(Box::new(|own| own.replica = Some(7)));
    let actions = ada.handle(change, &mut state, at(20_000)).unwrap();
    assert!(
        matches!(&actions[..], [Action::Publish(RecordUpdate::Record(record))] if record.knowledge == knowledge(Some(7)))
    );
    let changed = ada.core.records.own().stamp.version;
    let (full, _) = run((&mut ada, &mut state), 20_000..30_000, same_records);
    assert!(full.len() >= 8 && full.iter().all(|updates| refresh_of(updates).is_none()), "{full:?}");
    let (refreshes, _) = run((&mut ada, &mut state), 30_000..34_000, same_records);
    assert!(
        refreshes.len() >= 3
            && refreshes.iter().all(|updates| refresh_of(updates).is_some_and(|(_, since)| since == changed))
    );
}

#[test]
fn a_round_begins_with_sums_if_the_last_one_was_answered() {
    let (mut ada, mut state) = ada();
    let by_sums =
        |requests: &[(NodeId, Exchange)]| requests.iter().map(|(_, e)| !e.sums.is_empty()).collect::<Vec<_>>();
    let (_, requests) = run((&mut ada, &mut state), 0..4_000, same_records);
    assert!(requests.len() >= 3 && by_sums(&requests).iter().enumerate().all(|(round, sums)| *sums == (round > 0)));
    assert!(requests[1..].iter().all(|(_, exchange)| exchange.digest.is_empty() && exchange.records.is_empty()));
    let (_, requests) = run((&mut ada, &mut state), 4_000..8_000, || None);
    assert!(requests.len() >= 3 && by_sums(&requests).iter().enumerate().all(|(round, sums)| *sums == (round == 0)));
}

#[test]
fn a_node_that_missed_an_update_queries_its_owner() {
    for owner in ["bob", "cyd"] {
        let (mut ada, mut state) = ada();
        run((&mut ada, &mut state), 0..4_000, same_records);
        let stamp = RecordStamp { incarnation: 4, version: 9 };
        let record = Record { owner: node(owner), stamp, knowledge: knowledge(Some(3)), proof: None };
        let refresh = || Event::Published(node(owner), RecordUpdate::Refresh { stamp, since: 2, proof: None });
        ada.handle(refresh(), &mut state, at(4_000)).unwrap();
        assert_eq!(state.base.get(&node(owner)), None);
        let send_record = || {
            let digest = Digest::from([(node(owner), stamp)]);
            Some(Exchange { sums: vec![], scope: DigestScope::ALL, digest, records: vec![record.clone()] })
        };
        let (_, requests) = run((&mut ada, &mut state), 4_000..5_200, send_record);
        assert_eq!(requests[0].0, node(owner));
        assert!(requests[0].1.sums.is_empty() && requests[0].1.digest.contains_key(&node("ada")));
        assert_eq!(state.base.get(&node(owner)).unwrap().record, record);
        // After she has received the record, the same refresh only confirms it.
        ada.handle(refresh(), &mut state, at(6_000)).unwrap();
        assert_eq!(ada.core.records.next_missing_owner(&state), None);
        assert_eq!(state.base.get(&node(owner)).unwrap().last_contact, at(6_000));
    }
}

#[test]
fn a_reply_to_sums_is_the_digest_of_the_difference() {
    let (mut ada, mut state) = ada();
    let request = |exchange, ada: &mut Gossiper, state: &mut GossipState| {
        let actions = ada.handle(Event::RequestReceived(exchange), state, at(1_000)).unwrap();
        let reply = actions.into_iter().find_map(|action| match action {
            Action::SendReply(reply) => Some(reply),
            _ => None,
        });
        reply.expect("a reply")
    };
    let sums = |sums| Exchange { sums, scope: DigestScope::NONE, digest: Digest::new(), records: vec![] };
    let same = request(sums(state.base.class_sums()), &mut ada, &mut state);
    assert!(same.digest.is_empty() && same.records.is_empty() && same.sums.is_empty());
    let other = request(sums(vec![1]), &mut ada, &mut state);
    assert_eq!(other.digest, state.base.digest(DigestScope::ALL));
    assert!(other.records.is_empty());
    let next = Exchange { sums: vec![], scope: other.scope, digest: Digest::new(), records: vec![] };
    assert_eq!(request(next, &mut ada, &mut state).records, [ada.core.records.own().clone()]);
    // With more sums than allowed, everything is compared.
    assert_eq!(request(sums(vec![0; 200]), &mut ada, &mut state).digest, state.base.digest(DigestScope::ALL));
}

fn robot(place: &str) -> RobotKnowledge {
    RobotKnowledge {
        skills: BTreeSet::new(),
        attributes: Attributes::default(),
        place: place.parse().unwrap(),
        pose: Pose::default(),
        battery: BatteryShare::FULL,
        discharge: SharePerSecond::new(0.0).unwrap(),
        useful_charge: BatteryShare::new(0.0).unwrap(),
        speed: None,
        availability: Availability::Free,
        estimator: String::new(),
        charging: None,
    }
}

/// Returns the gossip of Ada in a large fleet. Her robot is at the dock.
fn ada_of_large_fleet() -> (Gossiper, GossipState) {
    ada_with(Settings { scoped: true, ..settings() }, Knowledge { robot: Some(robot("Dock")), ..knowledge(None) })
}

/// Returns the motion updates among actions.
fn motions(actions: Vec<Action>) -> Vec<MotionUpdate> {
    let motion = |action| match action {
        Action::PublishMotion(update) => Some(update),
        _ => None,
    };
    actions.into_iter().filter_map(motion).collect()
}

#[test]
fn motion_in_a_large_fleet_changes_the_record_with_its_next_version() {
    let (mut ada, mut state) = ada_of_large_fleet();
    let own = node("ada");
    let stamp = |state: &GossipState| state.base.get(&own).unwrap().record.stamp;
    let first = stamp(&state);
    let sent = motions(ada.handle(Event::MotionChanged(Motion::of(&robot("Lab"))), &mut state, at(0)).unwrap());
    assert_eq!(sent, [MotionUpdate { stamp: first, number: 1, motion: Some(Motion::of(&robot("Lab"))) }]);
    assert_eq!((stamp(&state), state.base.get(&own).unwrap().knowledge().robot.clone()), (first, Some(robot("Lab"))));
    // Heartbeats repeat the motion; neither the record nor a new version of it is sent.
    let heartbeats: Vec<MotionUpdate> = (100..9_000)
        .step_by(100)
        .flat_map(|ms| motions(ada.handle(Event::TimerFired, &mut state, at(ms)).unwrap()))
        .collect();
    assert!(heartbeats.len() >= 7, "{heartbeats:?}");
    assert!(heartbeats.iter().all(|update| update.stamp == first && update.motion == sent[0].motion), "{heartbeats:?}");

    let change = Event::KnowledgeChanged(Box::new(|own| own.leaving = true));
    let actions = ada.handle(change, &mut state, at(9_000)).unwrap();
    let [Action::Publish(RecordUpdate::Record(record))] = &actions[..] else { panic!("{actions:?}") };
    assert_eq!((record.knowledge.leaving, &record.knowledge.robot), (true, &Some(robot("Lab"))));
    let (records, _) = run((&mut ada, &mut state), 9_100..30_000, same_records);
    assert!(records.is_empty(), "a changed record is sent once: {records:?}");
}

#[test]
fn a_record_after_a_later_stamp_of_the_own_node_has_the_latest_motion() {
    let (mut ada, mut state) = ada_of_large_fleet();
    ada.handle(Event::MotionChanged(Motion::of(&robot("Lab"))), &mut state, at(0)).unwrap();
    let later = RecordStamp { incarnation: 2, version: 0 };
    let digest = Digest::from([(node("ada"), later)]);
    let request = Exchange { sums: vec![], scope: DigestScope::NONE, digest, records: vec![] };
    let actions = ada.handle(Event::RequestReceived(request), &mut state, at(100)).unwrap();
    let record = |action: &Action| match action {
        Action::Publish(RecordUpdate::Record(record)) => Some((record.stamp > later, record.knowledge.robot.clone())),
        _ => None,
    };
    // Each node drops the motion of the earlier version.
    assert_eq!(actions.iter().find_map(record), Some((true, Some(robot("Lab")))));
}

#[test]
fn a_motion_update_confirms_the_record_or_shows_that_it_was_missed() {
    let (mut ada, mut state) = ada_of_large_fleet();
    let stamp = RecordStamp { incarnation: 4, version: 9 };
    let knowledge = Knowledge { robot: Some(robot("Dock")), ..knowledge(None) };
    let record = Record { owner: node("bob"), stamp, knowledge, proof: None };
    let update = MotionUpdate { stamp, number: 3, motion: Some(Motion::of(&robot("Lab"))) };
    let published = || Event::MotionPublished(node("bob"), update.clone());
    ada.handle(published(), &mut state, at(1_000)).unwrap();
    assert_eq!(ada.core.records.next_missing_owner(&state), Some(node("bob")));
    ada.handle(Event::Published(node("bob"), RecordUpdate::Record(record.clone())), &mut state, at(2_000)).unwrap();
    ada.handle(published(), &mut state, at(3_000)).unwrap();
    let known = state.base.get(&node("bob")).unwrap();
    assert_eq!((&known.record, known.last_contact), (&record, at(3_000)));
    assert_eq!(known.knowledge().robot, Some(robot("Lab")));
}

#[test]
fn a_newcomer_to_a_large_fleet_is_greeted_later_unless_it_is_known_by_then() {
    for becomes_known in [false, true] {
        let (mut ada, mut state) = ada_of_large_fleet();
        for number in 0..100 {
            state.status.insert(node(&format!("node{number}")), MemberStatus::Alive { since: NodeTime::ZERO });
        }
        let greets = |actions: Vec<Action>| {
            actions.iter().any(|action| matches!(action, Action::Send(to, _) if *to == node("newcomer")))
        };
        let appeared = ada.handle(Event::Token(node("newcomer"), true), &mut state, at(0)).unwrap();
        assert!(!greets(appeared) && !greets(ada.handle(Event::TimerFired, &mut state, at(0)).unwrap()));
        if becomes_known {
            state.status.insert(node("newcomer"), MemberStatus::Alive { since: NodeTime::ZERO });
        }
        let greeted =
            (100..=5_200).step_by(100).any(|ms| greets(ada.handle(Event::TimerFired, &mut state, at(ms)).unwrap()));
        assert_eq!(greeted, !becomes_known);
    }
}

/// A station, which receives heartbeats, and two robots of a large fleet, which do not. They exchange messages at once.
struct LargeFleet {
    nodes: BTreeMap<NodeId, (Gossiper, GossipState)>,
    /// Pairs of nodes that receive nothing of each other.
    cut: BTreeSet<(NodeId, NodeId)>,
    /// Packets that passed, by sender and receiver.
    packets: Vec<(NodeId, NodeId)>,
}

const LARGE_FLEET: [&str; 3] = ["ada", "bob", "station"];

impl LargeFleet {
    /// Starts the nodes, which know each other after some seconds. The station probes a member in each period.
    fn start(probe_period: Duration) -> LargeFleet {
        let mut fleet = LargeFleet { nodes: BTreeMap::new(), cut: BTreeSet::new(), packets: vec![] };
        let mut first = vec![];
        for (seed, name) in (1..).zip(LARGE_FLEET) {
            let own = Settings::new(FleetId::new("ward").unwrap(), node(name), 1);
            let own = Settings { scoped: true, ..own };
            let is_station = name == "station";
            let settings = if is_station { Settings { probe_period, ..own } } else { own };
            let mut state = GossipState { receives_motion: is_station, ..GossipState::default() };
            let rng = ChaCha8Rng::seed_from_u64(seed);
            let start = GossiperStart { settings, knowledge: knowledge(None), signer: None, rng };
            let (gossiper, actions) = Gossiper::new(start, &mut state, NodeTime::ZERO);
            fleet.nodes.insert(node(name), (gossiper, state));
            first.push((name, actions));
        }
        for (name, actions) in first {
            fleet.deliver(name, actions, 0);
        }
        for (name, other) in LARGE_FLEET.iter().flat_map(|name| LARGE_FLEET.map(|other| (*name, other))) {
            fleet.handle(name, Event::Token(node(other), true), 0);
        }
        fleet.run(0..10_000);
        assert!(LARGE_FLEET.iter().all(|other| *other == "station" || fleet.status_at_station(other).is_alive()));
        fleet
    }

    fn status_at_station(&self, other: &str) -> MemberStatus {
        self.nodes[&node("station")].1.status[&node(other)]
    }

    fn cut(&mut self, one: &str, other: &str) {
        self.cut.extend([(node(one), node(other)), (node(other), node(one))]);
    }

    fn handle(&mut self, name: &str, event: Event, ms: u64) {
        let (gossiper, state) = self.nodes.get_mut(&node(name)).unwrap();
        // A packet may be invalid by now.
        let actions = gossiper.handle(event, state, at(ms)).unwrap_or_default();
        self.deliver(name, actions, ms);
    }

    fn deliver(&mut self, from: &str, actions: Vec<Action>, ms: u64) {
        for action in actions {
            let from = node(from);
            let others = LARGE_FLEET.into_iter().filter(|other| *other != from.as_str());
            let events: Vec<(&str, Event)> = match action {
                Action::Send(to, bytes) => {
                    let is_receiver = |other: &&str| *other == to.as_str();
                    let events = others.filter(is_receiver).map(|other| (other, Event::Packet(bytes.clone())));
                    events.collect()
                }
                Action::Publish(update) => {
                    others.map(|other| (other, Event::Published(from.clone(), update.clone()))).collect()
                }
                Action::PublishMotion(update) => {
                    let others = others.filter(|other| *other == "station");
                    others.map(|other| (other, Event::MotionPublished(from.clone(), update.clone()))).collect()
                }
                Action::SendRequest(..) | Action::SendReply(_) => vec![],
            };
            for (to, event) in events {
                if self.cut.contains(&(from.clone(), node(to))) {
                    continue;
                }
                if matches!(event, Event::Packet(_)) {
                    self.packets.push((from.clone(), node(to)));
                }
                self.handle(to, event, ms);
            }
        }
    }

    fn run(&mut self, span: std::ops::Range<u64>) {
        for ms in span.step_by(50) {
            for name in LARGE_FLEET {
                self.handle(name, Event::TimerFired, ms);
            }
        }
    }
}

/// Longer than any test.
const NEVER: Duration = Duration::from_secs(3600);

#[test]
fn robots_of_a_large_fleet_probe_no_others() {
    let mut fleet = LargeFleet::start(Duration::from_millis(500));
    fleet.packets.clear();
    fleet.run(10_000..20_000);
    let passed = |from: &str, to: &str| fleet.packets.iter().filter(|pair| **pair == (node(from), node(to))).count();
    for robot in ["ada", "bob"] {
        assert!(passed("station", robot) >= 5 && passed(robot, "station") >= 5, "{:?}", fleet.packets);
    }
    // A probe each half a second would be ten packets. They announce themselves now and then.
    assert!(passed("ada", "bob") + passed("bob", "ada") <= 6, "{:?}", fleet.packets);
}

#[test]
fn a_robot_with_an_ended_lease_is_declared_down() {
    let mut fleet = LargeFleet::start(NEVER);
    fleet.cut("ada", "station");
    fleet.cut("ada", "bob");
    fleet.run(10_000..12_000);
    assert!(matches!(fleet.status_at_station("ada"), MemberStatus::Alive { .. }));
    fleet.run(12_000..20_000);
    assert!(matches!(fleet.status_at_station("ada"), MemberStatus::Down { .. }));
    assert!(matches!(fleet.status_at_station("bob"), MemberStatus::Alive { .. }));
    // The other robot hears of it, and has missed an answer, too.
    let at_bob = &fleet.nodes[&node("bob")].1.status[&node("ada")];
    assert!(matches!(at_bob, MemberStatus::Down { .. }), "{at_bob:?}");
}

#[test]
fn a_robot_that_answers_through_another_keeps_its_lease() {
    let mut fleet = LargeFleet::start(NEVER);
    fleet.cut("ada", "station");
    for second in 10..40 {
        fleet.run(second * 1000..(second + 1) * 1000);
        let status = fleet.status_at_station("ada");
        assert!(matches!(status, MemberStatus::Alive { .. }), "{status:?} after {second} s");
    }
    assert!(fleet.packets.iter().filter(|pair| **pair == (node("station"), node("bob"))).count() > 5);
}
