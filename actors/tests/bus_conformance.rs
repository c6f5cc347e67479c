//! What every bus promises, checked on the virtual one and on Zenoh by the same stories.
//!
//! Each story gets three nodes that are linked in a row (on the virtual bus each with each), and keys of its own.

use bytes::Bytes;
use consort_actors::bus::zenoh_bus::Mode;
use consort_actors::bus::{
    Bus, BusError, Delivery, Encoding, LinkModel, MESSAGE_MAX, Presence, Query, Reply, Sample, ServiceSelection,
    Stream, VirtualNetwork, ZenohBus, ZenohSettings,
};
use consort_protocol::ids::NodeId;
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout};

/// Longest wait for what must happen.
const PATIENCE: Duration = Duration::from_secs(20);
/// How long what must not happen is given to happen.
const SILENCE: Duration = Duration::from_millis(200);
/// A query limit that no story reaches unless something is wrong.
const NEVER: Duration = Duration::from_secs(60);

type Nodes<'a> = [&'a dyn Bus; 3];

fn bytes(text: &str) -> Bytes {
    Bytes::copy_from_slice(text.as_bytes())
}

async fn next<T: 'static>(stream: &mut Stream<T>, awaited: &str) -> T {
    let next = timeout(PATIENCE, stream.recv()).await;
    next.unwrap_or_else(|_| panic!("still waiting for {awaited}")).unwrap_or_else(|| panic!("no {awaited} will come"))
}

async fn ended<T: 'static>(stream: &mut Stream<T>, awaited: &str) {
    let next = timeout(PATIENCE, stream.recv()).await;
    assert!(next.unwrap_or_else(|_| panic!("still waiting for the end of {awaited}")).is_none(), "more {awaited}");
}

async fn silent<T: 'static>(stream: &mut Stream<T>, awaited: &str) {
    assert!(timeout(SILENCE, stream.recv()).await.is_err(), "{awaited} came, or the stream ended");
}

async fn put(bus: &dyn Bus, key: &str, text: &str) {
    bus.publish(key, bytes(text), Encoding::Wire, Delivery::Block).await.unwrap();
}

/// Publishes until a subscriber hears it, since on a real bus a subscription takes its time to become known.
async fn linked(bus: &dyn Bus, key: &str, streams: &mut [&mut Stream<Sample>]) {
    let end = Instant::now() + PATIENCE;
    for (number, stream) in streams.iter_mut().enumerate() {
        loop {
            put(bus, key, "are you there?").await;
            match timeout(Duration::from_millis(20), stream.recv()).await {
                Ok(Some(_)) => break,
                _ => assert!(Instant::now() < end, "subscriber {number} never heard {key}"),
            }
        }
    }
    put(bus, key, "now").await;
    for stream in streams.iter_mut() {
        while next(stream, "the first word").await.payload != "now" {}
    }
}

/// Waits until a query finds so many services that answer. The services must already be answering.
async fn served(bus: &dyn Bus, key: &str, services: usize) {
    let end = Instant::now() + PATIENCE;
    while collect(bus, key, Duration::from_secs(5)).await.0.len() != services {
        assert!(Instant::now() < end, "{key} never had {services} services");
        sleep(Duration::from_millis(20)).await;
    }
}

/// All replies by key, and how long the query took.
async fn collect(bus: &dyn Bus, key: &str, limit: Duration) -> (Vec<Reply>, Duration) {
    let asked = Instant::now();
    let mut stream = bus.query(key, Bytes::new(), limit).await.unwrap();
    let mut replies = Vec::new();
    while let Some(reply) = stream.recv().await {
        replies.push(reply);
    }
    replies.sort_by(|one, other| one.key.cmp(&other.key));
    (replies, asked.elapsed())
}

/// Answers every question on `key` by `answer`, until the stream ends.
fn answer_all<F>(
    mut questions: Stream<Query>,
    answer: impl Fn(Query) -> F + Send + 'static,
) -> tokio::task::JoinHandle<()>
where
    F: Future<Output = ()> + Send + 'static,
{
    tokio::spawn(async move {
        while let Some(question) = questions.recv().await {
            answer(question).await;
        }
    })
}

async fn echo_service(bus: &dyn Bus, key: &str) -> tokio::task::JoinHandle<()> {
    let own = key.to_owned();
    answer_all(bus.serve(key).await.unwrap(), move |question| {
        let own = own.clone();
        async move { question.replier.reply(&own, question.payload.clone(), Encoding::Wire).await.unwrap() }
    })
}

fn text(reply: &Reply) -> (&str, Result<&str, &str>) {
    let payload = match &reply.payload {
        Ok(payload) => Ok(std::str::from_utf8(payload).unwrap()),
        Err(reason) => Err(reason.as_str()),
    };
    (&reply.key, payload)
}

// Stories.

async fn subscribers_hear_what_matches_and_their_own_node_too([a, b, c]: Nodes<'_>) {
    let mut exact = a.subscribe("t1/ada/state").await.unwrap();
    let mut single = b.subscribe("t1/*/state").await.unwrap();
    let mut deep = c.subscribe("t1/**").await.unwrap();
    let mut part = c.subscribe("t1/ad$*/state").await.unwrap();
    linked(a, "t1/ada/state", &mut [&mut exact, &mut single, &mut deep, &mut part]).await;
    put(a, "t1/bob/state", "1").await;
    put(a, "t1/ada/pose/x", "2").await;
    put(a, "t2/ada/state", "3").await;
    put(a, "t1/ada/state", "4").await;
    for (stream, expected) in [
        (&mut exact, vec!["t1/ada/state 4"]),
        (&mut part, vec!["t1/ada/state 4"]),
        (&mut single, vec!["t1/bob/state 1", "t1/ada/state 4"]),
        (&mut deep, vec!["t1/bob/state 1", "t1/ada/pose/x 2", "t1/ada/state 4"]),
    ] {
        let mut heard = Vec::new();
        for _ in &expected {
            let sample = next(stream, "sample").await;
            heard.push(format!("{} {}", sample.key, std::str::from_utf8(&sample.payload).unwrap()));
        }
        heard.sort();
        let mut expected = expected;
        expected.sort_unstable();
        assert_eq!(heard, expected);
        silent(stream, "another sample").await;
    }
}

async fn a_key_keeps_its_order([a, _, c]: Nodes<'_>) {
    let mut stream = c.subscribe("order/*").await.unwrap();
    linked(a, "order/a", &mut [&mut stream]).await;
    for number in 0..500 {
        put(a, "order/a", &number.to_string()).await;
    }
    for number in 0..500 {
        assert_eq!(next(&mut stream, "number").await.payload, number.to_string());
    }
}

async fn encodings_arrive_as_they_were_sent([a, _, c]: Nodes<'_>) {
    let mut stream = c.subscribe("encoded").await.unwrap();
    linked(a, "encoded", &mut [&mut stream]).await;
    for encoding in [Encoding::Json, Encoding::Wire] {
        a.publish("encoded", bytes("{}"), encoding, Delivery::Block).await.unwrap();
        let sample = next(&mut stream, "sample").await;
        assert_eq!(
            sample,
            Sample { key: "encoded".to_owned(), payload: bytes("{}"), encoding, attachment: Bytes::new() }
        );
    }
}

async fn what_is_said_beside_a_payload_arrives_beside_it([a, _, c]: Nodes<'_>) {
    let mut stream = c.subscribe("beside/news").await.unwrap();
    linked(a, "beside/news", &mut [&mut stream]).await;
    let answering = answer_all(c.serve("beside/cyd").await.unwrap(), |question| async move {
        let heard = question.attachment.clone();
        question
            .replier
            .reply_with_attachment("beside/cyd", question.payload.clone(), heard, Encoding::Json)
            .await
            .unwrap();
    });
    served(a, "beside/cyd", 1).await;
    for said in ["", "a word"] {
        a.publish_with_attachment("beside/news", bytes("{}"), bytes(said), Encoding::Json, Delivery::Block)
            .await
            .unwrap();
        let sample = next(&mut stream, "sample").await;
        assert_eq!((sample.payload, sample.attachment), (bytes("{}"), bytes(said)));
        for whom in [ServiceSelection::All, ServiceSelection::Nearest] {
            let mut replies = a.query_with("beside/*", bytes("?"), bytes(said), NEVER, whom).await.unwrap();
            let reply = next(&mut replies, "reply").await;
            assert_eq!((reply.payload, reply.attachment), (Ok(bytes("?")), bytes(said)));
        }
    }
    answering.abort();
}

async fn all_matching_services_answer_on_their_own_keys([a, b, c]: Nodes<'_>) {
    let mut services = Vec::new();
    for (bus, key) in [(a, "bid/ada"), (b, "bid/bob"), (b, "bid/bob2"), (c, "bid/cyd"), (c, "price/cyd")] {
        services.push(echo_service(bus, key).await);
    }
    served(a, "bid/*", 4).await;
    let mut stream = a.query("bid/*", bytes("how much?"), NEVER).await.unwrap();
    let mut keys = Vec::new();
    while let Some(reply) = timeout(PATIENCE, stream.recv()).await.expect("the query ends with its last answer") {
        assert_eq!(reply.payload.unwrap(), "how much?");
        keys.push(reply.key);
    }
    keys.sort();
    assert_eq!(keys, ["bid/ada", "bid/bob", "bid/bob2", "bid/cyd"]);
}

async fn replies_are_there_before_the_slowest_service_is_done([a, b, c]: Nodes<'_>) {
    let quick = echo_service(b, "stream/quick").await;
    let mut slow = c.serve("stream/slow").await.unwrap();
    served(a, "stream/quick", 1).await;
    let (mut replies, held) = asked_until_held(a, "stream/*", &mut slow).await;
    assert_eq!(next(&mut replies, "quick reply").await.key, "stream/quick");
    for word in ["one", "two"] {
        held.replier.reply("stream/slow", bytes(word), Encoding::Wire).await.unwrap();
        assert_eq!(text(&next(&mut replies, "part").await), ("stream/slow", Ok(word)));
    }
    silent(&mut replies, "another reply").await;
    drop(held);
    ended(&mut replies, "replies").await;
    quick.abort();
}

/// Asks until `service` gets the question; returns the query and the question held.
async fn asked_until_held(bus: &dyn Bus, key: &str, service: &mut Stream<Query>) -> (Stream<Reply>, Query) {
    let end = Instant::now() + PATIENCE;
    loop {
        let replies = bus.query(key, bytes("?"), NEVER).await.unwrap();
        if let Ok(Some(held)) = timeout(Duration::from_millis(100), service.recv()).await {
            return (replies, held);
        }
        assert!(Instant::now() < end, "the service was never asked for {key}");
    }
}

async fn without_services_a_query_ends_at_once([a, ..]: Nodes<'_>) {
    let mut stream = a.query("nobody/*", Bytes::new(), NEVER).await.unwrap();
    ended(&mut stream, "replies").await;
}

async fn a_silent_service_holds_a_query_to_its_limit_and_no_longer([a, b, c]: Nodes<'_>) {
    let mut silent_one = c.serve("limit/silent").await.unwrap();
    let lively = echo_service(b, "limit/lively").await;
    served(a, "limit/lively", 1).await;
    let (_replies, _held) = asked_until_held(a, "limit/*", &mut silent_one).await;
    let limit = Duration::from_millis(300);
    let (replies, took) = collect(a, "limit/*", limit).await;
    assert_eq!(replies.iter().map(|reply| reply.key.as_str()).collect::<Vec<_>>(), ["limit/lively"]);
    assert!((limit..limit + Duration::from_secs(5)).contains(&took), "it took {took:?}");
    lively.abort();
}

async fn a_refusal_arrives_with_its_reason([a, _, c]: Nodes<'_>) {
    let refusing = answer_all(c.serve("refuse/cyd").await.unwrap(), |question| async move {
        question.replier.refuse("battery too low").await.unwrap();
    });
    served(a, "refuse/*", 1).await;
    let (replies, _) = collect(a, "refuse/*?x=1", NEVER).await;
    assert_eq!(replies.iter().map(text).collect::<Vec<_>>(), [("refuse/*", Err("battery too low"))]);
    refusing.abort();
}

async fn a_selector_has_parameters([a, _, c]: Nodes<'_>) {
    let telling = answer_all(c.serve("select/cyd").await.unwrap(), |question| async move {
        let heard = format!("{} | {} | {}", question.key, question.parameters, question.payload.len());
        question.replier.reply("select/cyd", Bytes::from(heard), Encoding::Json).await.unwrap();
    });
    served(a, "select/*", 1).await;
    for (selector, expected) in [
        ("select/*?a=1;b=x", "select/* | a=1;b=x | 0"),
        ("select/cyd?", "select/cyd |  | 0"),
        ("select/*", "select/* |  | 0"),
    ] {
        let (replies, _) = collect(a, selector, NEVER).await;
        assert_eq!(replies.iter().map(text).collect::<Vec<_>>(), [("select/cyd", Ok(expected))]);
    }
    telling.abort();
}

async fn a_service_answers_only_what_it_was_asked([a, _, c]: Nodes<'_>) {
    let mut service = c.serve("strict/**").await.unwrap();
    let (mut replies, held) = asked_until_held(a, "strict/a", &mut service).await;
    let error = held.replier.reply("strict/b", Bytes::new(), Encoding::Wire).await.unwrap_err().to_string();
    assert_eq!(error, "\"strict/b\" is no key expression: it answers a query for `strict/a`");
    assert!(matches!(held.replier.reply("strict/*", Bytes::new(), Encoding::Wire).await, Err(BusError::Key { .. })));
    held.replier.reply("strict/a", bytes("yes"), Encoding::Wire).await.unwrap();
    drop(held);
    assert_eq!(text(&next(&mut replies, "reply").await), ("strict/a", Ok("yes")));
    ended(&mut replies, "replies").await;
}

/// All replies to a question of the nearest, in order.
async fn nearest(bus: &dyn Bus, key: &str) -> Vec<(String, String)> {
    let mut stream = bus.query_nearest(key, Bytes::new(), Duration::from_secs(5)).await.unwrap();
    let mut replies = Vec::new();
    while let Some(reply) = timeout(PATIENCE, stream.recv()).await.expect("the query ends") {
        replies.push((reply.key, String::from_utf8(reply.payload.unwrap().to_vec()).unwrap()));
    }
    replies.sort();
    replies
}

/// Answers on two keys with its own name, on each after so many milliseconds.
async fn complete_service(
    bus: &dyn Bus,
    below: &'static str,
    name: &'static str,
    after_ms: [u64; 2],
) -> tokio::task::JoinHandle<()> {
    let stream = bus.serve_complete(&format!("{below}/**")).await.unwrap();
    answer_all(stream, move |question| async move {
        let (asked, began) = (zenoh_keyexpr::keyexpr::new(question.key.as_str()).unwrap(), Instant::now());
        for (key, after_ms) in ["one", "two"].map(|key| format!("{below}/{key}")).into_iter().zip(after_ms) {
            if asked.intersects(zenoh_keyexpr::keyexpr::new(key.as_str()).unwrap()) {
                tokio::time::sleep_until(began + Duration::from_millis(after_ms)).await;
                question.replier.reply(&key, bytes(name), Encoding::Wire).await.unwrap();
            }
        }
    })
}

async fn of_complete_services_one_answers_for_all([a, b, c]: Nodes<'_>) {
    let (at_b, at_c) =
        (complete_service(b, "whole", "bob", [0, 0]).await, complete_service(c, "whole", "cyd", [0, 0]).await);
    for bus in [a, b, c] {
        served(bus, "whole/one", 2).await;
    }
    for bus in [a, b, c] {
        for (asked, keys) in [("whole/one", &["whole/one"][..]), ("whole/**", &["whole/one", "whole/two"])] {
            let replies = nearest(bus, asked).await;
            assert_eq!(replies.iter().map(|(key, _)| key.as_str()).collect::<Vec<_>>(), keys, "each key once");
            assert!(replies.iter().all(|(_, name)| ["bob", "cyd"].contains(&name.as_str())), "{replies:?}");
        }
    }
    // What asks for more than is served whole is asked of all, and still answered once on each key.
    assert_eq!(nearest(a, "*/one").await.len(), 1);
    // The other takes over.
    at_b.abort();
    let end = Instant::now() + PATIENCE;
    while nearest(a, "whole/one").await != [("whole/one".to_owned(), "cyd".to_owned())] {
        assert!(Instant::now() < end, "nobody took over");
        sleep(Duration::from_millis(20)).await;
    }
    at_c.abort();
}

/// On Zenoh the node that asks is asked itself, and one elsewhere. Whichever comes last on each key is a mixture.
async fn all_answers_to_one_question_are_from_one_node([a, b, c]: Nodes<'_>) {
    let at_b = complete_service(b, "mixed", "bob", [0, 300]).await;
    let at_c = complete_service(c, "mixed", "cyd", [100, 200]).await;
    served(a, "mixed/one", 2).await;
    for bus in [a, b, c, b, c] {
        let replies = nearest(bus, "mixed/**").await;
        let [(one, by), (two, also_by)] = &replies[..] else { panic!("two answers: {replies:?}") };
        assert_eq!((one.as_str(), two.as_str(), by), ("mixed/one", "mixed/two", also_by));
    }
    at_b.abort();
    at_c.abort();
}

async fn of_others_all_answer_and_one_answer_on_each_key_is_given([a, b, c]: Nodes<'_>) {
    let at_b = echo_service(b, "alike/key").await;
    let at_c = echo_service(c, "alike/key").await;
    served(a, "alike/key", 2).await;
    let replies = nearest(a, "alike/*").await;
    assert_eq!(replies.iter().map(|(key, _)| key.as_str()).collect::<Vec<_>>(), ["alike/key"]);
    assert!(nearest(a, "nobody/*").await.is_empty());
    at_b.abort();
    at_c.abort();
}

async fn what_is_dropped_has_ended([a, b, c]: Nodes<'_>) {
    // A subscription: one that stays shows that what was sent has come through.
    let gone = c.subscribe("drop/*").await.unwrap();
    let mut stays = c.subscribe("drop/**").await.unwrap();
    drop(gone);
    linked(a, "drop/a", &mut [&mut stays]).await;

    // A service, with a question in its mailbox: the question ends with it.
    let mut service = c.serve("dropped/cyd").await.unwrap();
    let (mut replies, held) = asked_until_held(a, "dropped/*", &mut service).await;
    let mut more = a.query("dropped/*", Bytes::new(), NEVER).await.unwrap();
    silent(&mut more, "a reply").await;
    drop(service);
    ended(&mut more, "replies of a service that is gone").await;
    held.replier.reply("dropped/cyd", bytes("late"), Encoding::Wire).await.unwrap();
    drop(held);
    assert_eq!(text(&next(&mut replies, "late reply").await), ("dropped/cyd", Ok("late")));
    ended(&mut replies, "replies").await;
    assert_eq!(collect(b, "dropped/*", NEVER).await.0, [], "nobody is asked any more");

    // A query: what is answered to it goes nowhere and harms nobody.
    let mut service = c.serve("unasked/cyd").await.unwrap();
    let (replies, held) = asked_until_held(a, "unasked/*", &mut service).await;
    drop(replies);
    held.replier.reply("unasked/cyd", bytes("?"), Encoding::Wire).await.unwrap();
}

async fn tokens_show_first_what_is_there_and_then_each_change([a, b, c]: Nodes<'_>) {
    let presence = |key: &str, alive| Presence { key: key.to_owned(), alive };
    let ada = a.announce("who/ada").await.unwrap();
    let _other = a.announce("what/ada").await.unwrap();
    let mut early = c.watch("who/*").await.unwrap();
    assert_eq!(next(&mut early, "ada, who was there").await, presence("who/ada", true));
    let bob = b.announce("who/bob").await.unwrap();
    assert_eq!(next(&mut early, "bob, who came").await, presence("who/bob", true));

    let mut late = c.watch("who/*").await.unwrap();
    let mut there = vec![next(&mut late, "somebody").await, next(&mut late, "somebody else").await];
    there.sort_by(|one, other| one.key.cmp(&other.key));
    assert_eq!(there, [presence("who/ada", true), presence("who/bob", true)]);

    let mut own = a.watch("who/*").await.unwrap();
    let mut there = vec![next(&mut own, "a token of its own").await, next(&mut own, "bob").await];
    there.sort_by(|one, other| one.key.cmp(&other.key));
    assert_eq!(there, [presence("who/ada", true), presence("who/bob", true)]);

    drop(ada);
    for stream in [&mut early, &mut late, &mut own] {
        assert_eq!(next(stream, "ada's end").await, presence("who/ada", false));
    }
    let _ada = a.announce("who/ada").await.unwrap();
    assert_eq!(next(&mut early, "ada's return").await, presence("who/ada", true));
    drop(bob);
    assert_eq!(next(&mut early, "bob's end").await, presence("who/bob", false));
    silent(&mut early, "another change").await;
}

async fn a_token_announced_twice_is_there_until_both_have_ended([a, b, c]: Nodes<'_>) {
    let mut watch = c.watch("twice/*").await.unwrap();
    let one = a.announce("twice/x").await.unwrap();
    assert!(next(&mut watch, "x").await.alive);
    let other = b.announce("twice/x").await.unwrap();
    let (_marker, mut second) = (b.announce("twice/marker").await.unwrap(), c.watch("twice/marker").await.unwrap());
    next(&mut second, "the other's token, sent before").await;
    assert_eq!(next(&mut watch, "marker").await.key, "twice/marker");
    drop(one);
    silent(&mut watch, "a change").await;
    drop(other);
    assert_eq!(next(&mut watch, "the end of x").await, Presence { key: "twice/x".to_owned(), alive: false });
}

async fn a_wrong_key_is_an_error_in_the_same_words([a, ..]: Nodes<'_>) {
    for key in ["", "/a", "a/", "a//b", "a/**/**", "a#b", "a/b*c"] {
        let problem = |error: BusError| match error {
            BusError::Key { key: named, problem } => {
                assert_eq!(named, key);
                problem
            }
            other => panic!("{key:?}: {other}"),
        };
        let of_all = [
            problem(a.publish(key, Bytes::new(), Encoding::Wire, Delivery::Drop).await.unwrap_err()),
            problem(a.subscribe(key).await.err().unwrap()),
            problem(a.query(key, Bytes::new(), NEVER).await.err().unwrap()),
            problem(a.serve(key).await.err().unwrap()),
            problem(a.announce(key).await.err().unwrap()),
            problem(a.watch(key).await.err().unwrap()),
        ];
        assert!(of_all.iter().all(|one| *one == of_all[0]), "{of_all:?}");
    }
    for refused in
        [a.publish("a/*", Bytes::new(), Encoding::Wire, Delivery::Drop).await, a.announce("a/*").await.map(drop)]
    {
        let error = refused.unwrap_err().to_string();
        assert_eq!(error, "\"a/*\" is no key expression: it holds a wildcard where one key is needed");
    }
}

async fn a_large_payload_passes_and_too_large_a_one_is_refused([a, _, c]: Nodes<'_>) {
    let mut stream = c.subscribe("large").await.unwrap();
    linked(a, "large", &mut [&mut stream]).await;
    let payload: Bytes = (0..1024 * 1024).map(|n: u32| n.to_le_bytes()[n as usize % 3]).collect();
    a.publish("large", payload.clone(), Encoding::Wire, Delivery::Block).await.unwrap();
    assert!(next(&mut stream, "large sample").await.payload == payload, "the payload changed");
    let refused = a.publish("large", vec![0; MESSAGE_MAX].into(), Encoding::Wire, Delivery::Block).await;
    let error = refused.unwrap_err().to_string();
    assert_eq!(error, "the bus failed to publish: a payload of 4194304 bytes exceeds the limit of 4190208");
    let service = echo_service(c, "large/echo").await;
    served(a, "large/echo", 1).await;
    let mut replies = a.query("large/echo", payload.clone(), NEVER).await.unwrap();
    assert!(next(&mut replies, "large reply").await.payload.unwrap() == payload, "the payload changed");
    service.abort();
}

macro_rules! stories {
    ($($story:ident),* $(,)?) => {
        mod on_the_virtual_bus {
            use super::*;
            $(#[tokio::test(start_paused = true)]
            async fn $story() {
                let network = VirtualNetwork::new(7, LinkModel::LAN);
                let [a, b, c] = ["ada", "bob", "cyd"].map(|name| network.bus(NodeId::new(name).unwrap()));
                super::$story([&a, &b, &c]).await;
            })*
        }

        mod on_zenoh {
            use super::*;
            $(#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn $story() {
                let row = row_of_routers().await;
                super::$story([&row[0], &row[1], &row[2]]).await;
                for bus in row {
                    bus.close().await.unwrap();
                }
            })*
        }
    };
}

stories! {
    subscribers_hear_what_matches_and_their_own_node_too,
    a_key_keeps_its_order,
    encodings_arrive_as_they_were_sent,
    what_is_said_beside_a_payload_arrives_beside_it,
    all_matching_services_answer_on_their_own_keys,
    replies_are_there_before_the_slowest_service_is_done,
    without_services_a_query_ends_at_once,
    a_silent_service_holds_a_query_to_its_limit_and_no_longer,
    a_refusal_arrives_with_its_reason,
    a_selector_has_parameters,
    a_service_answers_only_what_it_was_asked,
    of_complete_services_one_answers_for_all,
    all_answers_to_one_question_are_from_one_node,
    of_others_all_answer_and_one_answer_on_each_key_is_given,
    what_is_dropped_has_ended,
    tokens_show_first_what_is_there_and_then_each_change,
    a_token_announced_twice_is_there_until_both_have_ended,
    a_wrong_key_is_an_error_in_the_same_words,
    a_large_payload_passes_and_too_large_a_one_is_refused,
}

// Zenoh alone.

async fn router(connect: Vec<String>) -> ZenohBus {
    ZenohBus::open(ZenohSettings { connect, ..ZenohSettings::default() }).await.unwrap()
}

/// Three routers over TCP on loopback, each linked with the next only.
async fn row_of_routers() -> [ZenohBus; 3] {
    let first = router(vec![]).await;
    let second = router(first.listen_addresses().await).await;
    let third = router(second.listen_addresses().await).await;
    for bus in [&first, &second, &third] {
        assert!(!bus.wait_connected(PATIENCE).await.is_empty(), "a router found no neighbour");
    }
    [first, second, third]
}

#[tokio::test]
async fn zenoh_on_a_current_thread_runtime_is_an_error_and_no_panic() {
    let error = ZenohBus::open(ZenohSettings::default()).await.err().unwrap().to_string();
    assert_eq!(error, "the bus failed to open: Zenoh needs a multi-threaded tokio runtime");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn zenoh_says_which_address_is_taken() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp/{}", taken.local_addr().unwrap());
    let settings = ZenohSettings { listen: vec![address.clone()], ..ZenohSettings::default() };
    let error = ZenohBus::open(settings).await.err().unwrap().to_string();
    assert!(error.starts_with(&format!("the bus failed to listen on {address}: the port is taken")), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn zenoh_opens_alone_and_says_so_and_finds_its_neighbour_later() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let address = format!("tcp/{free}");
    let early = router(vec![address.clone()]).await;
    assert_eq!(early.wait_connected(Duration::ZERO).await, []);
    let late = ZenohBus::open(ZenohSettings { listen: vec![address], ..ZenohSettings::default() }).await.unwrap();
    let links = early.wait_connected(PATIENCE).await;
    assert_eq!(
        links.iter().map(|link| (link.peer.clone(), link.kind.as_str())).collect::<Vec<_>>(),
        [(late.id(), "router")]
    );
    late.close().await.unwrap();
    early.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_needs_a_router_and_then_hears_the_fleet() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let client = |connect| ZenohSettings { mode: Mode::Client, connect, ..ZenohSettings::default() };
    let error = ZenohBus::open(client(vec![format!("tcp/{free}")])).await.err().unwrap().to_string();
    assert!(error.starts_with(&format!("the bus failed to reach a router at tcp/{free}: ")), "{error}");

    let row = row_of_routers().await;
    let bus = ZenohBus::open(client(row[0].listen_addresses().await)).await.unwrap();
    let service = echo_service(&row[2], "client/echo").await;
    served(&bus, "client/*", 1).await;
    assert_eq!(bus.links().await.len(), 1);
    service.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn closing_ends_all_streams_and_shows_on_the_other_side() {
    let row = row_of_routers().await;
    let mut watch = row[0].watch("closing/*").await.unwrap();
    let _token = row[2].announce("closing/cyd").await.unwrap();
    assert!(next(&mut watch, "cyd").await.alive);
    let mut stream = row[2].subscribe("closing").await.unwrap();
    row[2].close().await.unwrap();
    assert!(!next(&mut watch, "cyd's end").await.alive);
    ended(&mut stream, "samples on a closed bus").await;
    let refused = row[2].publish("closing", Bytes::new(), Encoding::Wire, Delivery::Drop).await;
    assert!(matches!(refused, Err(BusError::Failed { .. })));
}
