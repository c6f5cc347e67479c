//! Conformance suite of the bus: the same test cases run on the virtual bus and on Zenoh.
//!
//! Each case gets three nodes in a chain (on the virtual bus fully connected), and keys of its own. On Zenoh
//! all three are routers, or the first and the last are clients of the second.

use bytes::Bytes;
use consort_bus::zenoh_bus::Mode;
use consort_bus::{
    Author, Bus, BusError, Delivery, Encoding, LinkModel, MESSAGE_MAX, Presence, Query, Reply, Sample,
    ServiceSelection, Stream, VirtualNetwork, ZenohBus, ZenohSettings,
};
use consort_protocol::ids::NodeId;
use std::time::Duration;
use tokio::sync::{Mutex, MutexGuard};
use tokio::time::{Instant, sleep, timeout};

/// Longest wait for an expected event.
const WAIT_MAX: Duration = Duration::from_secs(20);
/// Wait for an event that must not happen.
const SILENCE: Duration = Duration::from_millis(200);
/// Query timeout that no case reaches unless something is wrong.
const NEVER: Duration = Duration::from_secs(60);

type Nodes<'a> = [&'a dyn Bus; 3];

fn bytes(text: &str) -> Bytes {
    Bytes::copy_from_slice(text.as_bytes())
}

async fn next<T: 'static>(stream: &mut Stream<T>, awaited: &str) -> T {
    let next = timeout(WAIT_MAX, stream.recv()).await;
    next.unwrap_or_else(|_| panic!("still waiting for {awaited}"))
        .unwrap_or_else(|| panic!("the stream ended before {awaited}"))
}

async fn ended<T: 'static>(stream: &mut Stream<T>, awaited: &str) {
    let next = timeout(WAIT_MAX, stream.recv()).await;
    assert!(next.unwrap_or_else(|_| panic!("still waiting for the end of {awaited}")).is_none(), "more {awaited}");
}

async fn silent<T: 'static>(stream: &mut Stream<T>, awaited: &str) {
    assert!(timeout(SILENCE, stream.recv()).await.is_err(), "{awaited} arrived, or the stream ended");
}

async fn put(bus: &dyn Bus, key: &str, text: &str) {
    bus.publish(key, bytes(text), Encoding::Wire, Delivery::Block).await.unwrap();
}

/// Publishes until each subscriber receives it, since on a real bus a subscription needs time to
/// propagate.
async fn wait_subscribed(bus: &dyn Bus, key: &str, streams: &mut [&mut Stream<Sample>]) {
    let end = Instant::now() + WAIT_MAX;
    for (number, stream) in streams.iter_mut().enumerate() {
        loop {
            put(bus, key, "probe").await;
            match timeout(Duration::from_millis(20), stream.recv()).await {
                Ok(Some(_)) => break,
                _ => assert!(Instant::now() < end, "subscriber {number} never received {key}"),
            }
        }
    }
    put(bus, key, "ready").await;
    for stream in streams.iter_mut() {
        while next(stream, "the first sample").await.payload != "ready" {}
    }
}

/// Waits until a query reaches this number of services. The services must be replying already.
async fn wait_served(bus: &dyn Bus, key: &str, services: usize) {
    let end = Instant::now() + WAIT_MAX;
    while collect(bus, key, Duration::from_secs(5)).await.0.len() != services {
        assert!(Instant::now() < end, "{key} never had {services} services");
        sleep(Duration::from_millis(20)).await;
    }
}

/// Returns all replies by key, and the duration of the query.
async fn collect(bus: &dyn Bus, key: &str, limit: Duration) -> (Vec<Reply>, Duration) {
    let started = Instant::now();
    let mut stream = bus.query(key, Bytes::new(), limit).await.unwrap();
    let mut replies = Vec::new();
    while let Some(reply) = stream.recv().await {
        replies.push(reply);
    }
    replies.sort_by(|one, other| one.key.cmp(&other.key));
    (replies, started.elapsed())
}

/// Handles every query with `answer`, until the stream ends.
fn handle_all<F>(
    mut queries: Stream<Query>,
    handler: impl Fn(Query) -> F + Send + 'static,
) -> tokio::task::JoinHandle<()>
where
    F: Future<Output = ()> + Send + 'static,
{
    tokio::spawn(async move {
        while let Some(query) = queries.recv().await {
            handler(query).await;
        }
    })
}

async fn echo_service(bus: &dyn Bus, key: &str) -> tokio::task::JoinHandle<()> {
    let own = key.to_owned();
    handle_all(bus.serve(key).await.unwrap(), move |query| {
        let own = own.clone();
        async move { query.replier.reply(&own, query.payload.clone(), Encoding::Wire).await.unwrap() }
    })
}

fn text(reply: &Reply) -> (&str, Result<&str, &str>) {
    let payload = match &reply.payload {
        Ok(payload) => Ok(std::str::from_utf8(payload).unwrap()),
        Err(refused) => Err(refused.0.as_str()),
    };
    (&reply.key, payload)
}

// Test cases.

async fn subscribers_receive_matching_samples([a, b, c]: Nodes<'_>) {
    let mut exact = a.subscribe("t1/ada/state").await.unwrap();
    let mut single = b.subscribe("t1/*/state").await.unwrap();
    let mut deep = c.subscribe("t1/**").await.unwrap();
    let mut part = c.subscribe("t1/ad$*/state").await.unwrap();
    wait_subscribed(a, "t1/ada/state", &mut [&mut exact, &mut single, &mut deep, &mut part]).await;
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
        let mut received = Vec::new();
        for _ in &expected {
            let sample = next(stream, "sample").await;
            received.push(format!("{} {}", sample.key, std::str::from_utf8(&sample.payload).unwrap()));
        }
        received.sort();
        let mut expected = expected;
        expected.sort_unstable();
        assert_eq!(received, expected);
        silent(stream, "another sample").await;
    }
}

async fn samples_on_a_key_keep_their_order([a, _, c]: Nodes<'_>) {
    let mut stream = c.subscribe("order/*").await.unwrap();
    wait_subscribed(a, "order/a", &mut [&mut stream]).await;
    for number in 0..500 {
        put(a, "order/a", &number.to_string()).await;
    }
    for number in 0..500 {
        assert_eq!(next(&mut stream, "number").await.payload, number.to_string());
    }
}

async fn encodings_are_preserved([a, _, c]: Nodes<'_>) {
    let mut stream = c.subscribe("encoded").await.unwrap();
    wait_subscribed(a, "encoded", &mut [&mut stream]).await;
    for encoding in [Encoding::Json, Encoding::Wire] {
        a.publish("encoded", bytes("{}"), encoding, Delivery::Block).await.unwrap();
        let sample = next(&mut stream, "sample").await;
        assert_eq!(
            sample,
            Sample {
                key: "encoded".to_owned(),
                payload: bytes("{}"),
                encoding,
                attachment: Bytes::new(),
                author: Author::UNKNOWN
            }
        );
    }
}

async fn attachments_are_delivered([a, _, c]: Nodes<'_>) {
    let mut stream = c.subscribe("attached/sample").await.unwrap();
    wait_subscribed(a, "attached/sample", &mut [&mut stream]).await;
    let handling = handle_all(c.serve("attached/cyd").await.unwrap(), |query| async move {
        let received = query.attachment.clone();
        query
            .replier
            .reply_with_attachment("attached/cyd", query.payload.clone(), received, Encoding::Json)
            .await
            .unwrap();
    });
    wait_served(a, "attached/cyd", 1).await;
    for attachment in ["", "a text"] {
        a.publish_with_attachment("attached/sample", bytes("{}"), bytes(attachment), Encoding::Json, Delivery::Block)
            .await
            .unwrap();
        let sample = next(&mut stream, "sample").await;
        assert_eq!((sample.payload, sample.attachment), (bytes("{}"), bytes(attachment)));
        for target in [ServiceSelection::All, ServiceSelection::Nearest] {
            let mut replies = a.query_with("attached/*", bytes("?"), bytes(attachment), NEVER, target).await.unwrap();
            let reply = next(&mut replies, "reply").await;
            assert_eq!((reply.payload, reply.attachment), (Ok(bytes("?")), bytes(attachment)));
        }
    }
    handling.abort();
}

async fn all_matching_services_reply_on_their_keys([a, b, c]: Nodes<'_>) {
    let mut services = Vec::new();
    for (bus, key) in [(a, "bid/ada"), (b, "bid/bob"), (b, "bid/bob2"), (c, "bid/cyd"), (c, "price/cyd")] {
        services.push(echo_service(bus, key).await);
    }
    wait_served(a, "bid/*", 4).await;
    let mut stream = a.query("bid/*", bytes("price?"), NEVER).await.unwrap();
    let mut keys = Vec::new();
    while let Some(reply) = timeout(WAIT_MAX, stream.recv()).await.expect("the query ends with its last reply") {
        assert_eq!(reply.payload.unwrap(), "price?");
        keys.push(reply.key);
    }
    keys.sort();
    assert_eq!(keys, ["bid/ada", "bid/bob", "bid/bob2", "bid/cyd"]);
}

async fn replies_do_not_wait_for_the_slowest_service([a, b, c]: Nodes<'_>) {
    let quick = echo_service(b, "stream/quick").await;
    let mut slow = c.serve("stream/slow").await.unwrap();
    wait_served(a, "stream/quick", 1).await;
    let (mut replies, held) = query_until_held(a, "stream/*", &mut slow).await;
    assert_eq!(next(&mut replies, "quick reply").await.key, "stream/quick");
    for part in ["one", "two"] {
        held.replier.reply("stream/slow", bytes(part), Encoding::Wire).await.unwrap();
        assert_eq!(text(&next(&mut replies, "part").await), ("stream/slow", Ok(part)));
    }
    silent(&mut replies, "another reply").await;
    drop(held);
    ended(&mut replies, "replies").await;
    quick.abort();
}

/// Queries until `service` receives the query. Returns the replies and the held query.
async fn query_until_held(bus: &dyn Bus, key: &str, service: &mut Stream<Query>) -> (Stream<Reply>, Query) {
    let end = Instant::now() + WAIT_MAX;
    loop {
        let replies = bus.query(key, bytes("?"), NEVER).await.unwrap();
        if let Ok(Some(held)) = timeout(Duration::from_millis(100), service.recv()).await {
            return (replies, held);
        }
        assert!(Instant::now() < end, "the service was never asked for {key}");
    }
}

async fn a_query_without_services_ends_at_once([a, ..]: Nodes<'_>) {
    let mut stream = a.query("unserved/*", Bytes::new(), NEVER).await.unwrap();
    ended(&mut stream, "replies").await;
}

async fn a_silent_service_delays_a_query_to_its_timeout([a, b, c]: Nodes<'_>) {
    let mut silent_service = c.serve("limit/silent").await.unwrap();
    let lively = echo_service(b, "limit/lively").await;
    wait_served(a, "limit/lively", 1).await;
    let (_replies, _held) = query_until_held(a, "limit/*", &mut silent_service).await;
    let limit = Duration::from_millis(300);
    let (replies, took) = collect(a, "limit/*", limit).await;
    assert_eq!(replies.iter().map(|reply| reply.key.as_str()).collect::<Vec<_>>(), ["limit/lively"]);
    assert!((limit..limit + Duration::from_secs(5)).contains(&took), "it took {took:?}");
    lively.abort();
}

async fn an_error_reply_has_its_reason([a, _, c]: Nodes<'_>) {
    let refusing = handle_all(c.serve("refuse/cyd").await.unwrap(), |query| async move {
        query.replier.refuse("battery too low").await.unwrap();
    });
    wait_served(a, "refuse/*", 1).await;
    let (replies, _) = collect(a, "refuse/*?x=1", NEVER).await;
    assert_eq!(replies.iter().map(text).collect::<Vec<_>>(), [("refuse/*", Err("battery too low"))]);
    refusing.abort();
}

async fn a_busy_service_refuses_queries([a, _, c]: Nodes<'_>) {
    let large = MESSAGE_MAX - 64 * 1024;
    let by_payload = ("busy/payload", String::new(), Bytes::from(vec![0; large]));
    let by_parameters = ("busy/parameters", "x".repeat(large), Bytes::new());
    for (key, parameters, payload) in [by_payload, by_parameters] {
        let mut service = c.serve(key).await.unwrap();
        query_until_held(a, key, &mut service).await;
        let selector = format!("{key}?{parameters}");
        let mut open = Vec::new();
        let refusal = loop {
            assert!(open.len() < 8, "the service of {key} is never busy");
            let mut replies = a.query(&selector, payload.clone(), NEVER).await.unwrap();
            let arrived = tokio::select! {
                query = next(&mut service, "a query") => Ok(query),
                reply = next(&mut replies, "a refusal") => Err(reply),
            };
            match arrived {
                Ok(query) => open.push((replies, query)),
                Err(refusal) => break refusal,
            }
        };
        assert_eq!(text(&refusal), (key, Err("busy: too many open queries; repeat the query later")));
        assert!(open.len() > 1, "the service of {key} is busy too early");
        drop(open);
        query_until_held(a, key, &mut service).await;
    }
}

async fn a_selector_has_parameters([a, _, c]: Nodes<'_>) {
    let describing = handle_all(c.serve("select/cyd").await.unwrap(), |query| async move {
        let received = format!("{} | {} | {}", query.key, query.parameters, query.payload.len());
        query.replier.reply("select/cyd", Bytes::from(received), Encoding::Json).await.unwrap();
    });
    wait_served(a, "select/*", 1).await;
    for (selector, expected) in [
        ("select/*?a=1;b=x", "select/* | a=1;b=x | 0"),
        ("select/cyd?", "select/cyd |  | 0"),
        ("select/*", "select/* |  | 0"),
    ] {
        let (replies, _) = collect(a, selector, NEVER).await;
        assert_eq!(replies.iter().map(text).collect::<Vec<_>>(), [("select/cyd", Ok(expected))]);
    }
    describing.abort();
}

async fn a_service_replies_only_on_matching_keys([a, _, c]: Nodes<'_>) {
    let mut service = c.serve("strict/**").await.unwrap();
    let (mut replies, held) = query_until_held(a, "strict/a", &mut service).await;
    let error = held.replier.reply("strict/b", Bytes::new(), Encoding::Wire).await.unwrap_err().to_string();
    assert_eq!(error, "\"strict/b\" is not a valid key: it does not match the query `strict/a`");
    assert!(matches!(held.replier.reply("strict/*", Bytes::new(), Encoding::Wire).await, Err(BusError::Key { .. })));
    held.replier.reply("strict/a", bytes("yes"), Encoding::Wire).await.unwrap();
    drop(held);
    assert_eq!(text(&next(&mut replies, "reply").await), ("strict/a", Ok("yes")));
    ended(&mut replies, "replies").await;
}

/// Returns all replies to a query of the nearest service, in order.
async fn nearest(bus: &dyn Bus, key: &str) -> Vec<(String, String)> {
    let mut stream = bus.query_nearest(key, Bytes::new(), Duration::from_secs(5)).await.unwrap();
    let mut replies = Vec::new();
    while let Some(reply) = timeout(WAIT_MAX, stream.recv()).await.expect("the query ends") {
        replies.push((reply.key, String::from_utf8(reply.payload.unwrap().to_vec()).unwrap()));
    }
    replies.sort();
    replies
}

/// Replies on two keys with its name, on each after so many milliseconds.
async fn complete_service(
    bus: &dyn Bus,
    below: &'static str,
    name: &'static str,
    after_ms: [u64; 2],
) -> tokio::task::JoinHandle<()> {
    let stream = bus.serve_complete(&format!("{below}/**")).await.unwrap();
    handle_all(stream, move |query| async move {
        let (query_key, began) = (zenoh_keyexpr::keyexpr::new(query.key.as_str()).unwrap(), Instant::now());
        for (key, after_ms) in ["one", "two"].map(|key| format!("{below}/{key}")).into_iter().zip(after_ms) {
            if query_key.intersects(zenoh_keyexpr::keyexpr::new(key.as_str()).unwrap()) {
                tokio::time::sleep_until(began + Duration::from_millis(after_ms)).await;
                query.replier.reply(&key, bytes(name), Encoding::Wire).await.unwrap();
            }
        }
    })
}

async fn a_single_complete_service_replies([a, b, c]: Nodes<'_>) {
    let (at_b, at_c) =
        (complete_service(b, "whole", "bob", [0, 0]).await, complete_service(c, "whole", "cyd", [0, 0]).await);
    for bus in [a, b, c] {
        wait_served(bus, "whole/one", 2).await;
    }
    for bus in [a, b, c] {
        for (query_key, keys) in [("whole/one", &["whole/one"][..]), ("whole/**", &["whole/one", "whole/two"])] {
            let replies = nearest(bus, query_key).await;
            assert_eq!(
                replies.iter().map(|(key, _)| key.as_str()).collect::<Vec<_>>(),
                keys,
                "each key has a single reply"
            );
            assert!(replies.iter().all(|(_, name)| ["bob", "cyd"].contains(&name.as_str())), "{replies:?}");
        }
    }
    // A query beyond the complete services reaches all, and still gets a single reply per key.
    assert_eq!(nearest(a, "*/one").await.len(), 1);
    // The other service takes over.
    at_b.abort();
    let end = Instant::now() + WAIT_MAX;
    while nearest(a, "whole/one").await != [("whole/one".to_owned(), "cyd".to_owned())] {
        assert!(Instant::now() < end, "no other service took over");
        sleep(Duration::from_millis(20)).await;
    }
    at_c.abort();
}

/// On Zenoh both the querying node's own service and a remote service are queried. Their latest
/// replies per key would be a mixture.
async fn all_replies_to_a_query_come_from_a_single_node([a, b, c]: Nodes<'_>) {
    let at_b = complete_service(b, "mixed", "bob", [0, 300]).await;
    let at_c = complete_service(c, "mixed", "cyd", [100, 200]).await;
    wait_served(a, "mixed/one", 2).await;
    for bus in [a, b, c, b, c] {
        let replies = nearest(bus, "mixed/**").await;
        let [(one, by), (two, also_by)] = &replies[..] else { panic!("expected two replies: {replies:?}") };
        assert_eq!((one.as_str(), two.as_str(), by), ("mixed/one", "mixed/two", also_by));
    }
    at_b.abort();
    at_c.abort();
}

async fn incomplete_services_yield_a_single_reply_per_key([a, b, c]: Nodes<'_>) {
    let at_b = echo_service(b, "alike/key").await;
    let at_c = echo_service(c, "alike/key").await;
    wait_served(a, "alike/key", 2).await;
    let replies = nearest(a, "alike/*").await;
    assert_eq!(replies.iter().map(|(key, _)| key.as_str()).collect::<Vec<_>>(), ["alike/key"]);
    assert!(nearest(a, "unserved/*").await.is_empty());
    at_b.abort();
    at_c.abort();
}

async fn dropped_declarations_end([a, b, c]: Nodes<'_>) {
    // A subscription: the remaining subscription shows that the samples have arrived.
    let gone = c.subscribe("drop/*").await.unwrap();
    let mut stays = c.subscribe("drop/**").await.unwrap();
    drop(gone);
    wait_subscribed(a, "drop/a", &mut [&mut stays]).await;

    // A service with a query in its mailbox: the query ends with the service.
    let mut service = c.serve("dropped/cyd").await.unwrap();
    let (mut replies, held) = query_until_held(a, "dropped/*", &mut service).await;
    let mut more = a.query("dropped/*", Bytes::new(), NEVER).await.unwrap();
    silent(&mut more, "a reply").await;
    drop(service);
    ended(&mut more, "replies of a service that is gone").await;
    held.replier.reply("dropped/cyd", bytes("late"), Encoding::Wire).await.unwrap();
    drop(held);
    assert_eq!(text(&next(&mut replies, "late reply").await), ("dropped/cyd", Ok("late")));
    ended(&mut replies, "replies").await;
    assert_eq!(collect(b, "dropped/*", NEVER).await.0, [], "no service remains");

    // A query: replies to a dropped query are lost without harm.
    let mut service = c.serve("unqueried/cyd").await.unwrap();
    let (replies, held) = query_until_held(a, "unqueried/*", &mut service).await;
    drop(replies);
    held.replier.reply("unqueried/cyd", bytes("?"), Encoding::Wire).await.unwrap();
}

async fn a_watch_reports_present_tokens_then_changes([a, b, c]: Nodes<'_>) {
    let presence = |key: &str, alive| Presence { key: key.to_owned(), alive };
    let ada = a.announce("presence/ada").await.unwrap();
    let _other = a.announce("other/ada").await.unwrap();
    let mut early = c.watch("presence/*").await.unwrap();
    assert_eq!(next(&mut early, "the present token of ada").await, presence("presence/ada", true));
    let bob = b.announce("presence/bob").await.unwrap();
    assert_eq!(next(&mut early, "the new token of bob").await, presence("presence/bob", true));

    let mut late = c.watch("presence/*").await.unwrap();
    let mut present = vec![next(&mut late, "a token").await, next(&mut late, "another token").await];
    present.sort_by(|one, other| one.key.cmp(&other.key));
    assert_eq!(present, [presence("presence/ada", true), presence("presence/bob", true)]);

    let mut own = a.watch("presence/*").await.unwrap();
    let mut present = vec![next(&mut own, "its own token").await, next(&mut own, "bob").await];
    present.sort_by(|one, other| one.key.cmp(&other.key));
    assert_eq!(present, [presence("presence/ada", true), presence("presence/bob", true)]);

    drop(ada);
    for stream in [&mut early, &mut late, &mut own] {
        assert_eq!(next(stream, "ada's end").await, presence("presence/ada", false));
    }
    let _ada = a.announce("presence/ada").await.unwrap();
    assert_eq!(next(&mut early, "ada's return").await, presence("presence/ada", true));
    drop(bob);
    assert_eq!(next(&mut early, "bob's end").await, presence("presence/bob", false));
    silent(&mut early, "another change").await;
}

async fn a_token_announced_twice_lasts_until_both_end([a, b, c]: Nodes<'_>) {
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

async fn an_invalid_key_is_the_same_error_everywhere([a, ..]: Nodes<'_>) {
    for key in ["", "/a", "a/", "a//b", "a/**/**", "a#b", "a/b*c"] {
        let problem = |error: BusError| match error {
            BusError::Key { key: named, problem } => {
                assert_eq!(named, key);
                problem
            }
            other => panic!("{key:?}: {other}"),
        };
        let problems = [
            problem(a.publish(key, Bytes::new(), Encoding::Wire, Delivery::Drop).await.unwrap_err()),
            problem(a.subscribe(key).await.err().unwrap()),
            problem(a.query(key, Bytes::new(), NEVER).await.err().unwrap()),
            problem(a.serve(key).await.err().unwrap()),
            problem(a.announce(key).await.err().unwrap()),
            problem(a.watch(key).await.err().unwrap()),
        ];
        assert!(problems.iter().all(|one| *one == problems[0]), "{problems:?}");
    }
    for refused in
        [a.publish("a/*", Bytes::new(), Encoding::Wire, Delivery::Drop).await, a.announce("a/*").await.map(drop)]
    {
        let error = refused.unwrap_err().to_string();
        assert_eq!(error, "\"a/*\" is not a valid key: a key without wildcards is required");
    }
}

async fn an_oversized_payload_is_rejected([a, _, c]: Nodes<'_>) {
    let mut stream = c.subscribe("large").await.unwrap();
    wait_subscribed(a, "large", &mut [&mut stream]).await;
    let payload: Bytes = (0..1024 * 1024).map(|n: u32| n.to_le_bytes()[n as usize % 3]).collect();
    a.publish("large", payload.clone(), Encoding::Wire, Delivery::Block).await.unwrap();
    assert!(next(&mut stream, "large sample").await.payload == payload, "the payload changed");
    let refused = a.publish("large", vec![0; MESSAGE_MAX].into(), Encoding::Wire, Delivery::Block).await;
    let error = refused.unwrap_err().to_string();
    assert_eq!(error, "the bus failed to publish: a payload of 4194304 bytes exceeds the limit of 4190208");
    let service = echo_service(c, "large/echo").await;
    wait_served(a, "large/echo", 1).await;
    let mut replies = a.query("large/echo", payload.clone(), NEVER).await.unwrap();
    assert!(next(&mut replies, "large reply").await.payload.unwrap() == payload, "the payload changed");
    service.abort();
}

macro_rules! test_cases {
    ($($case:ident),* $(,)?) => {
        mod on_the_virtual_bus {
            use super::*;
            $(#[tokio::test(start_paused = true)]
            async fn $case() {
                let network = VirtualNetwork::new(7, LinkModel::LAN);
                let [a, b, c] = ["ada", "bob", "cyd"].map(|name| network.bus(NodeId::new(name).unwrap()));
                super::$case([&a, &b, &c]).await;
            })*
        }

        mod on_zenoh {
            use super::*;
            $(#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn $case() {
                let _turn = turn(stringify!($case)).await;
                let chain = router_chain().await;
                super::$case([&chain[0], &chain[1], &chain[2]]).await;
                for bus in chain {
                    bus.close().await.unwrap();
                }
            })*
        }

        mod on_clients_of_a_relay {
            use super::*;
            $(#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn $case() {
                let _turn = turn(stringify!($case)).await;
                let relay = router(vec![]).await;
                let [one, other] = [node_client(&relay).await, node_client(&relay).await];
                super::$case([&one, &relay, &other]).await;
                for bus in [one, other, relay] {
                    bus.close().await.unwrap();
                }
            })*
        }
    };
}

test_cases! {
    subscribers_receive_matching_samples,
    samples_on_a_key_keep_their_order,
    encodings_are_preserved,
    attachments_are_delivered,
    all_matching_services_reply_on_their_keys,
    replies_do_not_wait_for_the_slowest_service,
    a_query_without_services_ends_at_once,
    a_silent_service_delays_a_query_to_its_timeout,
    an_error_reply_has_its_reason,
    a_busy_service_refuses_queries,
    a_selector_has_parameters,
    a_service_replies_only_on_matching_keys,
    a_single_complete_service_replies,
    all_replies_to_a_query_come_from_a_single_node,
    incomplete_services_yield_a_single_reply_per_key,
    dropped_declarations_end,
    a_watch_reports_present_tokens_then_changes,
    a_token_announced_twice_lasts_until_both_end,
    an_invalid_key_is_the_same_error_everywhere,
    an_oversized_payload_is_rejected,
}

// Zenoh only.

/// Cases with messages of several MB.
const LARGE: [&str; 2] = ["a_busy_service_refuses_queries", "an_oversized_payload_is_rejected"];

/// Waits until no other case with large messages runs on Zenoh. All sessions of a process share two threads that receive.
/// A relay waits on such a thread while the queue of the next link is full. With two such relays in a process, no thread
/// is left for the nodes that empty the queues.
async fn turn(case: &str) -> Option<MutexGuard<'static, ()>> {
    static TURN: Mutex<()> = Mutex::const_new(());
    if LARGE.contains(&case) { Some(TURN.lock().await) } else { None }
}

async fn router(connect: Vec<String>) -> ZenohBus {
    ZenohBus::open(ZenohSettings { connect, ..ZenohSettings::default() }).await.unwrap()
}

/// A node that does not relay, linked with its relay.
async fn node_client(relay: &ZenohBus) -> ZenohBus {
    let connect = relay.listen_addresses().await;
    let settings = ZenohSettings { mode: Mode::NodeClient, connect, ..ZenohSettings::default() };
    let bus = ZenohBus::open(settings).await.unwrap();
    assert!(!bus.wait_connected(WAIT_MAX).await.is_empty(), "a client found no relay");
    bus
}

/// Three routers over TCP on loopback, each linked with the next only.
async fn router_chain() -> [ZenohBus; 3] {
    let first = router(vec![]).await;
    let second = router(first.listen_addresses().await).await;
    let third = router(second.listen_addresses().await).await;
    for bus in [&first, &second, &third] {
        assert!(!bus.wait_connected(WAIT_MAX).await.is_empty(), "a router found no neighbour");
    }
    [first, second, third]
}

#[tokio::test]
async fn zenoh_rejects_a_current_thread_runtime() {
    let error = ZenohBus::open(ZenohSettings::default()).await.err().unwrap().to_string();
    assert_eq!(error, "the bus failed to open: Zenoh needs a multi-threaded tokio runtime");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn zenoh_reports_the_occupied_address() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp/{}", taken.local_addr().unwrap());
    let settings = ZenohSettings { listen: vec![address.clone()], ..ZenohSettings::default() };
    let error = ZenohBus::open(settings).await.err().unwrap().to_string();
    assert!(error.starts_with(&format!("the bus failed to listen on {address}: the port is taken")), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn zenoh_opens_alone_and_connects_later() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let address = format!("tcp/{free}");
    let early = router(vec![address.clone()]).await;
    assert_eq!(early.wait_connected(Duration::ZERO).await, []);
    let late = ZenohBus::open(ZenohSettings { listen: vec![address], ..ZenohSettings::default() }).await.unwrap();
    let links = early.wait_connected(WAIT_MAX).await;
    assert_eq!(
        links.iter().map(|link| (link.peer.clone(), link.kind.as_str())).collect::<Vec<_>>(),
        [(late.id(), "router")]
    );
    late.close().await.unwrap();
    early.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_needs_a_router() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let client = |connect| ZenohSettings { mode: Mode::Client, connect, ..ZenohSettings::default() };
    let error = ZenohBus::open(client(vec![format!("tcp/{free}")])).await.err().unwrap().to_string();
    assert!(error.starts_with(&format!("the bus failed to reach a router at tcp/{free}: ")), "{error}");

    let chain = router_chain().await;
    let bus = ZenohBus::open(client(chain[0].listen_addresses().await)).await.unwrap();
    let service = echo_service(&chain[2], "client/echo").await;
    wait_served(&bus, "client/*", 1).await;
    assert_eq!(bus.links().await.len(), 1);
    service.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn closing_ends_all_streams() {
    let chain = router_chain().await;
    let mut watch = chain[0].watch("closing/*").await.unwrap();
    let _token = chain[2].announce("closing/cyd").await.unwrap();
    assert!(next(&mut watch, "cyd").await.alive);
    let mut stream = chain[2].subscribe("closing").await.unwrap();
    chain[2].close().await.unwrap();
    assert!(!next(&mut watch, "cyd's end").await.alive);
    ended(&mut stream, "samples on a closed bus").await;
    let refused = chain[2].publish("closing", Bytes::new(), Encoding::Wire, Delivery::Drop).await;
    assert!(matches!(refused, Err(BusError::Failed { .. })));
}
