//! What the virtual network promises beside what every bus does.

use super::*;
use tokio::time::{Instant, sleep, timeout};

fn node(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn network(model: LinkModel) -> VirtualNetwork {
    VirtualNetwork::new(7, model)
}

const STEADY: Duration = Duration::from_millis(2);

async fn say(bus: &VirtualBus, key: &str, word: &str) {
    bus.publish(key, Bytes::copy_from_slice(word.as_bytes()), Encoding::Wire, Delivery::Drop).await.unwrap();
}

/// What has arrived, after everything under way had time to.
async fn heard(stream: &mut Stream<Sample>) -> Vec<String> {
    sleep(Duration::from_millis(100)).await;
    let mut words = Vec::new();
    while let Some(sample) = stream.try_recv() {
        words.push(String::from_utf8(sample.payload.to_vec()).unwrap());
    }
    words
}

async fn changes(stream: &mut Stream<Presence>) -> Vec<(String, bool)> {
    let mut changes = Vec::new();
    while let Some(presence) = stream.try_recv() {
        changes.push((presence.key, presence.alive));
    }
    changes
}

/// A service on `key` that answers each question with its own name, until its bus ends.
async fn echo(bus: &VirtualBus, key: &str) {
    let mut questions = bus.serve(key).await.unwrap();
    let (name, key) = (bus.node().to_string(), key.to_owned());
    tokio::spawn(async move {
        while let Some(question) = questions.recv().await {
            let _ = question.replier.reply(&key, Bytes::from(name.clone()), Encoding::Wire).await;
        }
    });
}

/// All answers, and how long it took until the query had ended.
async fn ask(bus: &VirtualBus, key: &str, limit: Duration) -> (Vec<Reply>, Duration) {
    let asked = Instant::now();
    let mut stream = bus.query(key, Bytes::new(), limit).await.unwrap();
    let mut replies = Vec::new();
    while let Some(reply) = stream.recv().await {
        replies.push(reply);
    }
    (replies, asked.elapsed())
}

#[tokio::test(start_paused = true)]
async fn a_publication_takes_the_time_of_its_link_and_none_at_home() {
    let network = network(LinkModel::steady(Duration::from_millis(20)));
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let (mut at_ada, mut at_bob) = (ada.subscribe("a").await.unwrap(), bob.subscribe("a").await.unwrap());
    let sent = Instant::now();
    say(&ada, "a", "x").await;
    assert!(at_ada.try_recv().is_none(), "delivery is never part of the sending");
    at_ada.recv().await.unwrap();
    assert_eq!(sent.elapsed(), Duration::ZERO);
    at_bob.recv().await.unwrap();
    assert_eq!(sent.elapsed(), Duration::from_millis(20));
    assert_eq!(network.counters(), NetworkCounters { sent: 2, delivered: 2, ..NetworkCounters::default() });
}

#[tokio::test(start_paused = true)]
async fn order_on_a_key_survives_changing_latency() {
    let network =
        network(LinkModel { latency_min: Duration::ZERO, latency_max: Duration::from_millis(50), ..LinkModel::LAN });
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let mut stream = bob.subscribe("*").await.unwrap();
    let words: Vec<String> = (0..200).map(|n| n.to_string()).collect();
    for word in &words {
        say(&ada, "a", word).await;
        sleep(Duration::from_millis(1)).await;
    }
    assert_eq!(heard(&mut stream).await, words);
}

#[tokio::test(start_paused = true)]
async fn reordering_breaks_the_order_and_loses_nothing() {
    let model = LinkModel { reordering: 0.2, reordering_delay: Duration::from_millis(20), ..LinkModel::LAN };
    let network = network(model);
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let mut stream = bob.subscribe("*").await.unwrap();
    let words: Vec<String> = (100..300).map(|n| n.to_string()).collect();
    for word in &words {
        say(&ada, "a", word).await;
        sleep(Duration::from_millis(1)).await;
    }
    let mut arrived = heard(&mut stream).await;
    assert_ne!(arrived, words);
    arrived.sort();
    assert_eq!(arrived, words);
}

#[tokio::test(start_paused = true)]
async fn loss_and_duplication_keep_their_shares() {
    let network = network(LinkModel { loss: 0.3, duplication: 0.1, ..LinkModel::LAN });
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let _stream = bob.subscribe("*").await.unwrap();
    for _ in 0..10_000 {
        say(&ada, "a", "x").await;
    }
    sleep(Duration::from_secs(1)).await;
    let counted = network.counters();
    assert_eq!(counted.sent, 10_000);
    assert!((2_800..3_200).contains(&counted.dropped), "{counted:?}");
    assert!((600..800).contains(&counted.duplicated), "{counted:?}");
    assert_eq!(counted.sent + counted.duplicated, counted.delivered + counted.dropped);
}

/// A small fleet which talks through all kinds of faults; returns what one node heard and the network's digest.
async fn eventful_run(seed: u64) -> (Vec<(Duration, Sample)>, u64) {
    let model = LinkModel {
        loss: 0.05,
        duplication: 0.05,
        reordering: 0.05,
        reordering_delay: Duration::from_millis(9),
        ..LinkModel::LAN
    };
    let network = VirtualNetwork::new(seed, model);
    let start = Instant::now();
    let buses: Vec<VirtualBus> = ["ada", "bob", "cyd", "dot"].into_iter().map(|name| network.bus(node(name))).collect();
    for bus in &buses {
        echo(bus, &format!("ask/{}", bus.node())).await;
    }
    let mut stream = buses[0].subscribe("say/**").await.unwrap();
    let mut record = Vec::new();
    for round in 0..100 {
        match round {
            20 => network.partition([[node("ada"), node("bob")], [node("cyd"), node("dot")]]),
            30 => network.cut(node("bob"), node("ada")),
            40 => network.heal(),
            50 => network.pause(&node("cyd")),
            60 => network.resume(&node("cyd")),
            70 => network.crash(&node("dot")),
            _ => {}
        }
        for bus in &buses {
            let key = format!("say/{}", bus.node());
            let _ = bus.publish(&key, Bytes::from(round.to_string()), Encoding::Wire, Delivery::Drop).await;
        }
        let _ = ask(&buses[1], "ask/*", Duration::from_millis(7)).await;
        sleep(Duration::from_millis(1)).await;
        while let Some(sample) = stream.try_recv() {
            record.push((start.elapsed(), sample));
        }
    }
    (record, network.digest())
}

#[test]
fn one_seed_gives_one_run() {
    let run = |seed| {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap();
        runtime.block_on(eventful_run(seed))
    };
    assert_eq!(run(3), run(3));
    assert_ne!(run(3).1, run(4).1);
}

#[tokio::test(start_paused = true)]
async fn a_partition_separates_groups_until_it_heals() {
    let network = network(LinkModel::LAN);
    let [ada, bob, cyd] = ["ada", "bob", "cyd"].map(|name| network.bus(node(name)));
    let (mut at_bob, mut at_cyd) = (bob.subscribe("a").await.unwrap(), cyd.subscribe("a").await.unwrap());
    network.partition([[node("ada"), node("bob")]]);
    say(&ada, "a", "apart").await;
    assert_eq!((heard(&mut at_bob).await, heard(&mut at_cyd).await), (vec!["apart".to_owned()], vec![]));
    let dot = network.bus(node("dot"));
    say(&dot, "a", "newcomer").await;
    assert_eq!((heard(&mut at_bob).await, heard(&mut at_cyd).await), (vec![], vec!["newcomer".to_owned()]));
    network.heal();
    say(&ada, "a", "whole").await;
    assert_eq!(
        (heard(&mut at_bob).await, heard(&mut at_cyd).await),
        (vec!["whole".to_owned()], vec!["whole".to_owned()])
    );
}

#[tokio::test(start_paused = true)]
async fn a_cut_is_one_way() {
    let network = network(LinkModel::LAN);
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let (mut at_ada, mut at_bob) = (ada.subscribe("b").await.unwrap(), bob.subscribe("a").await.unwrap());
    network.cut(node("ada"), node("bob"));
    say(&ada, "a", "unheard").await;
    say(&bob, "b", "heard").await;
    assert_eq!((heard(&mut at_ada).await, heard(&mut at_bob).await), (vec!["heard".to_owned()], vec![]));
    network.restore(node("ada"), node("bob"));
    say(&ada, "a", "mended").await;
    assert_eq!(heard(&mut at_bob).await, ["mended"]);
}

#[tokio::test(start_paused = true)]
async fn an_isolated_node_hears_only_itself() {
    let network = network(LinkModel::LAN);
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let (mut at_ada, mut at_bob) = (ada.subscribe("a").await.unwrap(), bob.subscribe("a").await.unwrap());
    network.isolate(node("ada"));
    say(&ada, "a", "from ada").await;
    say(&bob, "a", "from bob").await;
    assert_eq!(heard(&mut at_ada).await, ["from ada"]);
    assert_eq!(heard(&mut at_bob).await, ["from bob"]);
}

#[tokio::test(start_paused = true)]
async fn a_paused_node_hears_and_says_all_of_it_later_and_in_order() {
    let network = network(LinkModel::LAN);
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let (mut at_ada, mut at_bob) = (ada.subscribe("b").await.unwrap(), bob.subscribe("a").await.unwrap());
    network.pause(&node("bob"));
    for word in ["1", "2", "3"] {
        say(&ada, "a", word).await;
        say(&bob, "b", word).await;
        sleep(Duration::from_millis(1)).await;
    }
    assert_eq!((heard(&mut at_ada).await, heard(&mut at_bob).await), (vec![], vec![]));
    network.resume(&node("bob"));
    say(&ada, "a", "4").await;
    assert_eq!(heard(&mut at_bob).await, ["1", "2", "3", "4"]);
    assert_eq!(heard(&mut at_ada).await, ["1", "2", "3"]);
}

#[tokio::test(start_paused = true)]
async fn a_crash_ends_all_that_a_node_declared_and_a_new_life_starts_afresh() {
    let network = network(LinkModel::steady(STEADY));
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let mut stream = bob.subscribe("a").await.unwrap();
    let mut watch = ada.watch("who/*").await.unwrap();
    let token = bob.announce("who/bob").await.unwrap();
    echo(&bob, "ask/bob").await;
    sleep(Duration::from_millis(10)).await;
    assert_eq!(changes(&mut watch).await, [("who/bob".to_owned(), true)]);

    network.crash(&node("bob"));
    assert!(stream.recv().await.is_none());
    let error = bob.publish("a", Bytes::new(), Encoding::Wire, Delivery::Drop).await.unwrap_err().to_string();
    assert_eq!(error, "the bus failed to publish: node bob has crashed");
    let crashed = Instant::now();
    assert_eq!(watch.recv().await.unwrap(), Presence { key: "who/bob".to_owned(), alive: false });
    assert_eq!(crashed.elapsed(), STEADY);
    assert_eq!(ada.links().await, []);
    assert_eq!(ask(&ada, "ask/*", Duration::from_secs(9)).await, (vec![], Duration::ZERO));

    let bob_again = network.bus(node("bob"));
    drop(token); // the old life's: it no longer means anything
    let _token = bob_again.announce("who/bob").await.unwrap();
    assert_eq!(watch.recv().await.unwrap(), Presence { key: "who/bob".to_owned(), alive: true });
    assert_eq!(ada.links().await, [Link { peer: "bob".to_owned(), kind: "router".to_owned() }]);
    assert!(bob.subscribe("a").await.is_err(), "the old life's bus stays dead");
}

#[tokio::test(start_paused = true)]
async fn a_query_to_a_node_that_crashes_ends_with_it() {
    let network = network(LinkModel::steady(STEADY));
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let mut questions = bob.serve("ask").await.unwrap();
    let asked = Instant::now();
    let mut replies = ada.query("ask", Bytes::new(), Duration::from_secs(60)).await.unwrap();
    let _held = questions.recv().await.unwrap();
    network.crash(&node("bob"));
    assert!(replies.recv().await.is_none());
    assert_eq!(asked.elapsed(), 2 * STEADY);
}

#[tokio::test(start_paused = true)]
async fn tokens_outlive_a_cut_by_the_lease_and_come_back_after_it_heals() {
    let network = network(LinkModel::steady(STEADY));
    network.set_lease(Duration::from_secs(3));
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let mut watch = ada.watch("who/*").await.unwrap();
    let _token = bob.announce("who/bob").await.unwrap();
    assert!(watch.recv().await.unwrap().alive);

    network.cut(node("bob"), node("ada"));
    let cut = Instant::now();
    assert!(!watch.recv().await.unwrap().alive);
    assert_eq!(cut.elapsed(), Duration::from_secs(3));
    assert_eq!((ada.links().await.len(), bob.links().await.len()), (0, 1), "bob still hears ada");

    let _second = bob.announce("who/bob/2").await.unwrap();
    network.heal();
    assert!(watch.recv().await.unwrap().alive);
    assert_eq!(ada.links().await.len(), 1);

    network.cut(node("bob"), node("ada"));
    sleep(Duration::from_secs(2)).await;
    network.heal();
    sleep(Duration::from_secs(9)).await;
    assert_eq!(changes(&mut watch).await, [], "a cut shorter than the lease goes unnoticed");
}

#[tokio::test(start_paused = true)]
async fn a_query_into_a_cut_waits_for_the_lease_and_later_ends_at_once() {
    let network = network(LinkModel::steady(STEADY));
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    echo(&bob, "ask").await;
    sleep(Duration::from_millis(10)).await;
    network.isolate(node("bob"));
    assert_eq!(ask(&ada, "ask", Duration::from_secs(1)).await, (vec![], Duration::from_secs(1)));
    assert_eq!(ask(&ada, "ask", Duration::from_secs(60)).await, (vec![], Duration::from_secs(1)), "the lease is 2 s");
    assert_eq!(ask(&ada, "ask", Duration::from_secs(60)).await, (vec![], Duration::ZERO));
    network.heal();
    assert_eq!(ask(&ada, "ask", Duration::from_secs(60)).await.0.len(), 1);
}

#[tokio::test(start_paused = true)]
async fn a_lost_question_or_answer_holds_the_query_to_its_limit() {
    let network = network(LinkModel::steady(STEADY));
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    echo(&bob, "ask").await;
    let limit = Duration::from_millis(500);
    for (from, to) in [("ada", "bob"), ("bob", "ada")] {
        let lossy = LinkModel { loss: 1.0, ..LinkModel::LAN };
        network.set_link_model_between(node(from), node(to), lossy);
        assert_eq!(ask(&ada, "ask", limit).await, (vec![], limit), "{from} to {to}");
        network.set_link_model(LinkModel::steady(STEADY));
    }
    let (replies, took) = ask(&ada, "ask", limit).await;
    assert_eq!((replies.len(), took), (1, 2 * STEADY));
}

#[tokio::test(start_paused = true)]
async fn a_newcomer_learns_of_tokens_announced_before_it_came() {
    let network = network(LinkModel::LAN);
    let ada = network.bus(node("ada"));
    let _token = ada.announce("who/ada").await.unwrap();
    let bob = network.bus(node("bob"));
    let mut watch = bob.watch("**").await.unwrap();
    assert_eq!(watch.recv().await.unwrap().key, "who/ada");
}

#[tokio::test(start_paused = true)]
async fn a_subscription_made_between_sending_and_arrival_hears_it_too() {
    let network = network(LinkModel::LAN);
    let (ada, bob) = (network.bus(node("ada")), network.bus(node("bob")));
    let mut early = bob.subscribe("a").await.unwrap();
    say(&ada, "a", "x").await;
    let mut late = bob.subscribe("*").await.unwrap();
    assert_eq!((heard(&mut early).await.len(), heard(&mut late).await.len()), (1, 1));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn many_threads_may_share_a_network() {
    let network = network(LinkModel { latency_max: Duration::from_millis(1), ..LinkModel::LAN });
    let mut tasks = Vec::new();
    for number in 0..8 {
        let bus = network.bus(node(&format!("n{number}")));
        tasks.push(tokio::spawn(async move {
            echo(&bus, &format!("ask/{number}")).await;
            let mut stream = bus.subscribe("say/**").await.unwrap();
            for _ in 0..50 {
                say(&bus, &format!("say/{number}"), "x").await;
                ask(&bus, "ask/*", Duration::from_secs(10)).await;
            }
            while timeout(Duration::from_millis(50), stream.recv()).await.is_ok() {}
        }));
    }
    for task in tasks {
        timeout(Duration::from_secs(60), task).await.expect("no lock is held for ever").unwrap();
    }
    let counted = network.counters();
    assert_eq!(counted.sent, counted.delivered + counted.dropped);
}
