use super::*;
use consort_protocol::ids::FleetId;
use consort_protocol::versions::VersionRange;

fn node(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn at(ms: u64) -> NodeTime {
    NodeTime::at(Duration::from_millis(ms))
}

fn knowledge(replica: Option<u64>) -> Knowledge {
    Knowledge {
        may_vote: false,
        stationary: false,
        mains_powered: false,
        replica,
        cluster: None,
        leaving: false,
        supported_versions: VersionRange::OWN,
        robot: None,
    }
}

/// Ada, to whom Bob and Cyd are alive.
fn ada() -> (Gossiper, GossipState) {
    let mut known = GossipState::default();
    let settings = Settings::new(FleetId::new("ward").unwrap(), node("ada"), 1);
    let rng = ChaCha8Rng::seed_from_u64(1);
    let (gossiper, first) = Gossiper::new(settings, knowledge(None), None, rng, &mut known, NodeTime::ZERO);
    assert!(matches!(&first[..], [Action::Publish(RecordUpdate::Record(_))]));
    for other in ["bob", "cyd"] {
        known.status.insert(node(other), MemberStatus::Alive { since: NodeTime::ZERO });
    }
    (gossiper, known)
}

/// What she says and whom she asks in these milliseconds, while her questions are answered like that.
fn watch(
    (ada, known): (&mut Gossiper, &mut GossipState),
    span: std::ops::Range<u64>,
    answer: impl Fn() -> Option<Exchange>,
) -> (Vec<RecordUpdate>, Vec<(NodeId, Exchange)>) {
    let (mut said, mut asked) = (vec![], vec![]);
    for ms in span.step_by(100) {
        let mut actions = ada.handle(Event::TimerFired, known, at(ms)).unwrap();
        while let Some(action) = actions.pop() {
            match action {
                Action::Publish(statement) => said.push(statement),
                Action::SendRequest(number, peer, exchange) => {
                    asked.push((peer, exchange));
                    actions.extend(ada.handle(Event::ReplyReceived(number, answer()), known, at(ms)).unwrap());
                }
                Action::Send(..) | Action::SendReply(_) => {}
            }
        }
    }
    (said, asked)
}

/// The answer of one who has the same.
fn agreed() -> Option<Exchange> {
    Some(Exchange { sums: vec![], scope: DigestScope::NONE, digest: Digest::new(), records: vec![] })
}

/// Which version is said, and since which it says the same; nothing if it is said whole.
fn still(said: &RecordUpdate) -> Option<(u64, u64)> {
    match said {
        RecordUpdate::Refresh { stamp, since, .. } => Some((stamp.version, *since)),
        RecordUpdate::Record(_) => None,
    }
}

#[test]
fn who_has_nothing_new_to_say_says_so_in_few_words_and_a_change_is_repeated_whole() {
    let (mut ada, mut known) = ada();
    let (loud, _) = watch((&mut ada, &mut known), 0..10_000, agreed);
    assert!(loud.len() >= 8 && loud.iter().all(|said| still(said).is_none()), "{loud:?}");
    let (quiet, _) = watch((&mut ada, &mut known), 10_000..20_000, agreed);
    assert!(quiet.len() >= 8, "{quiet:?}");
    // A new version now and then tells those far away that she still speaks.
    assert!(
        quiet.iter().all(|said| still(said).is_some_and(|(version, since)| since == 0 && version > 0)),
        "{quiet:?}"
    );

    let change = Event::KnowledgeChanged(Box::new(|own| own.replica = Some(7)));
    let told = ada.handle(change, &mut known, at(20_000)).unwrap();
    assert!(
        matches!(&told[..], [Action::Publish(RecordUpdate::Record(record))] if record.knowledge == knowledge(Some(7)))
    );
    let changed = ada.records.own().stamp.version;
    let (loud, _) = watch((&mut ada, &mut known), 20_000..30_000, agreed);
    assert!(loud.len() >= 8 && loud.iter().all(|said| still(said).is_none()), "{loud:?}");
    let (quiet, _) = watch((&mut ada, &mut known), 30_000..34_000, agreed);
    assert!(quiet.len() >= 3 && quiet.iter().all(|said| still(said).is_some_and(|(_, since)| since == changed)));
}

#[test]
fn rounds_begin_with_sums_once_one_was_answered_and_with_the_digest_when_the_last_was_not() {
    let (mut ada, mut known) = ada();
    let by_sums = |asked: &[(NodeId, Exchange)]| asked.iter().map(|(_, e)| !e.sums.is_empty()).collect::<Vec<_>>();
    let (_, asked) = watch((&mut ada, &mut known), 0..4_000, agreed);
    assert!(asked.len() >= 3 && by_sums(&asked).iter().enumerate().all(|(round, sums)| *sums == (round > 0)));
    assert!(asked[1..].iter().all(|(_, exchange)| exchange.digest.is_empty() && exchange.records.is_empty()));
    let (_, asked) = watch((&mut ada, &mut known), 4_000..8_000, || None);
    assert!(asked.len() >= 3 && by_sums(&asked).iter().enumerate().all(|(round, sums)| *sums == (round == 0)));
}

#[test]
fn who_hears_that_it_missed_something_asks_the_one_who_said_it() {
    for owner in ["bob", "cyd"] {
        let (mut ada, mut known) = ada();
        watch((&mut ada, &mut known), 0..4_000, agreed);
        let stamp = RecordStamp { incarnation: 4, version: 9 };
        let record = Record { owner: node(owner), stamp, knowledge: knowledge(Some(3)), proof: None };
        let say_so = || Event::Published(node(owner), RecordUpdate::Refresh { stamp, since: 2, proof: None });
        ada.handle(say_so(), &mut known, at(4_000)).unwrap();
        assert_eq!(known.base.get(&node(owner)), None);
        let hand_over = || {
            let digest = Digest::from([(node(owner), stamp)]);
            Some(Exchange { sums: vec![], scope: DigestScope::ALL, digest, records: vec![record.clone()] })
        };
        let (_, asked) = watch((&mut ada, &mut known), 4_000..5_200, hand_over);
        assert_eq!(asked[0].0, node(owner));
        assert!(asked[0].1.sums.is_empty() && asked[0].1.digest.contains_key(&node("ada")));
        assert_eq!(known.base.get(&node(owner)).unwrap().record, record);
        // Now that she has heard it, the same words say no more than that it is so.
        ada.handle(say_so(), &mut known, at(6_000)).unwrap();
        assert!(ada.missing_from.is_empty());
        assert_eq!(known.base.get(&node(owner)).unwrap().last_contact, at(6_000));
    }
}

#[test]
fn sums_are_answered_with_the_digest_of_where_the_two_differ_and_then_each_hands_over() {
    let (mut ada, mut known) = ada();
    let ask = |exchange, ada: &mut Gossiper, known: &mut GossipState| {
        let actions = ada.handle(Event::RequestReceived(exchange), known, at(1_000)).unwrap();
        let answer = actions.into_iter().find_map(|action| match action {
            Action::SendReply(answer) => Some(answer),
            _ => None,
        });
        answer.expect("an answer")
    };
    let sums = |sums| Exchange { sums, scope: DigestScope::NONE, digest: Digest::new(), records: vec![] };
    let same = ask(sums(known.base.class_sums()), &mut ada, &mut known);
    assert!(same.digest.is_empty() && same.records.is_empty() && same.sums.is_empty());
    let other = ask(sums(vec![1]), &mut ada, &mut known);
    assert_eq!(other.digest, known.base.digest(DigestScope::ALL));
    assert!(other.records.is_empty());
    let then = Exchange { sums: vec![], scope: other.scope, digest: Digest::new(), records: vec![] };
    assert_eq!(ask(then, &mut ada, &mut known).records, [ada.records.own().clone()]);
    // More sums than there may be: everything is compared.
    assert_eq!(ask(sums(vec![0; 200]), &mut ada, &mut known).digest, known.base.digest(DigestScope::ALL));
}
