//! Messages between nodes: signature, authorization, freshness.

use crate::fixture::*;
use bytes::Bytes;
use consort_bus::{Bus, Encoding, QueryRefused, SharedBus};
use consort_protocol::codec;
use consort_protocol::keys::{DriverCall, Key};
use consort_protocol::message::BootstrapRequest;
use std::sync::Arc;
use std::time::Duration;

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_node_publishes_in_its_own_name_only() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=robot,voter").await;
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=robot").await;
    let eve = fixture.node("eve", "consort://ward/node/eve?roles=robot").await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    publish(&ada, &Key::Beacon, &beacon("bob")).await;
    assert_eq!(received(&mut at_bob).await, [] as [Bytes; 0], "ada publishes in the name of bob");
    for _ in 0..3 {
        publish(&eve, &Key::Beacon, &beacon("eve")).await;
        assert_eq!(received(&mut at_bob).await, [] as [Bytes; 0], "eve is no voter");
    }
    publish(&ada, &Key::Beacon, &beacon("ada")).await;
    assert_eq!(received(&mut at_bob).await, [beacon("ada")]);
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn messages_without_a_fleet_certificate_are_dropped() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    let mut at_ada = ada.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    let stranger = fixture.plain("stranger");
    publish(&*stranger, &Key::Beacon, &beacon("stranger")).await;
    let other = Fixture { network: fixture.network.clone(), ..Fixture::new() };
    let foreign = other.node("foreign", "consort://ward/node/foreign?roles=voter").await;
    for _ in 0..3 {
        publish(&foreign, &Key::Beacon, &beacon("foreign")).await;
        assert_eq!(received(&mut at_ada).await, [] as [Bytes; 0]);
    }
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_changed_moved_or_replayed_message_is_dropped() {
    let fixture = Fixture::new();
    let (ada, bob) = (
        fixture.node("ada", "consort://ward/node/ada?roles=host&serves=bob").await,
        fixture.node("bob", "consort://ward/node/bob?roles=robot").await,
    );
    let (own_key, other_key) = ("bob".parse().unwrap(), "cyd".parse().unwrap());
    let (own_key, other_key) = (Key::Driver(own_key, DriverCall::State), Key::Driver(other_key, DriverCall::State));
    let mut at_bob = bob.subscribe(&keys().any_driver_state()).await.unwrap();
    introduce(&mut at_bob, &ada, &own_key, b"at the dock").await;
    // A relay receives the passing messages and publishes modified copies.
    let relay = fixture.plain("relay");
    let mut intercepted = relay.subscribe(&keys().any_driver_state()).await.unwrap();
    publish(&ada, &own_key, b"at the lift").await;
    assert_eq!(received(&mut at_bob).await, ["at the lift"]);
    let intercepted_sample = received(&mut intercepted).await.pop().unwrap();
    publish(&*relay, &own_key, &intercepted_sample).await;
    publish(&*relay, &other_key, &intercepted_sample).await;
    for index in 0..intercepted_sample.len() {
        let mut changed = intercepted_sample.to_vec();
        changed[index] ^= 1;
        publish(&*relay, &own_key, &changed).await;
    }
    assert_eq!(received(&mut at_bob).await, [] as [Bytes; 0]);
    // A message with a later number is still accepted.
    publish(&ada, &own_key, b"at the ward").await;
    assert_eq!(received(&mut at_bob).await, ["at the ward"]);
}

/// Queries until the certificate of the replying node is known.
async fn query_until_known(bus: &dyn Bus, key: &str, content: &[u8]) -> Vec<Result<Bytes, QueryRefused>> {
    let mut payloads = Vec::new();
    for _ in 0..3 {
        payloads.clear();
        let mut replies = bus.query(key, Bytes::copy_from_slice(content), Duration::from_secs(1)).await.unwrap();
        while let Some(reply) = replies.recv().await {
            payloads.push(reply.payload);
        }
        tokio::time::sleep(Duration::from_secs(2)).await;
    }
    payloads
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn queries_and_replies_are_authorized() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=voter").await;
    let eve = fixture.node("eve", "consort://ward/node/eve?roles=robot").await;
    let key = keys().write(&Key::Bootstrap(node("bob")));
    for bus in [&bob, &eve] {
        // Eve replies in place of bob.
        let mut queries = bus.serve(&key).await.unwrap();
        tokio::spawn(async move {
            while let Some(query) = queries.recv().await {
                query.replier.reply(&query.key, query.payload.clone(), Encoding::Wire).await.unwrap();
            }
        });
    }
    let request_of =
        |name: &str| codec::encode(&BootstrapRequest { mobile: false, on_battery: false, node: node(name) }).unwrap();
    assert_eq!(
        query_until_known(&ada, &key, &request_of("ada")).await,
        [Ok(Bytes::from(request_of("ada")))],
        "eve's reply is rejected"
    );
    for (requester, request) in [(&eve, request_of("eve")), (&ada, request_of("bob"))] {
        let payloads = query_until_known(requester, &key, &request).await;
        assert!(payloads.iter().all(Result::is_err) && !payloads.is_empty(), "{payloads:?}");
    }
    let payloads = query_until_known(&eve, &key, &request_of("eve")).await;
    assert!(
        payloads
            .iter()
            .flat_map(|payload| payload.clone().err())
            .any(|problem| problem.0.contains("node eve (robot) may not query")),
        "{payloads:?}"
    );
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn only_the_queried_node_can_refuse() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    let bob: SharedBus = Arc::new(fixture.node("bob", "consort://ward/node/bob?roles=voter").await);
    let eve: SharedBus = Arc::new(fixture.node("eve", "consort://ward/node/eve?roles=robot").await);
    let key = keys().write(&Key::Bootstrap(node("bob")));
    // Eve refuses at once, with her own key and without one; bob after all others.
    for (bus, reason, after) in [(&eve, "no", 0), (&fixture.plain("eve"), "no", 0), (&bob, "not yet", 100)] {
        let mut queries = bus.serve(&key).await.unwrap();
        tokio::spawn(async move {
            while let Some(query) = queries.recv().await {
                tokio::time::sleep(Duration::from_millis(after)).await;
                query.replier.refuse(reason).await.unwrap();
            }
        });
    }
    let request = codec::encode(&BootstrapRequest { mobile: false, on_battery: false, node: node("ada") }).unwrap();
    for key in [&key, &key.replace("bob", "*")] {
        let refusal = Err(QueryRefused("not yet".to_owned()));
        assert_eq!(query_until_known(&ada, key, &request).await, [refusal], "{key}");
    }
    let rejections = ada.rejections();
    for reason in
        ["node eve (robot) may not refuse wire/bootstrap/bob", "wire/bootstrap/bob rejected: it is not signed"]
    {
        assert!(rejections.iter().any(|rejection| rejection.contains(reason)), "{reason}: {rejections:?}");
    }
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_message_older_than_the_window_is_rejected() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=host&serves=bob").await;
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=robot").await;
    let key = Key::Driver("bob".parse().unwrap(), DriverCall::State);
    let mut at_bob = bob.subscribe(&keys().any_driver_state()).await.unwrap();
    introduce(&mut at_bob, &ada, &key, b"at the dock").await;
    let relay = fixture.plain("relay");
    let mut intercepted = relay.subscribe(&keys().any_driver_state()).await.unwrap();
    publish(&ada, &key, b"at the lift").await;
    let intercepted_sample = intercepted.recv().await.unwrap().payload;
    for _ in 0..1100 {
        publish(&ada, &key, b"at the ward").await;
    }
    assert_eq!(received(&mut at_bob).await.len(), 1101);
    publish(&*relay, &key, &intercepted_sample).await;
    assert_eq!(received(&mut at_bob).await, [] as [Bytes; 0]);
    let rejections = bob.rejections();
    assert!(
        rejections.iter().any(|rejection| rejection.contains("it is older than earlier messages")),
        "{rejections:?}"
    );
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn every_message_has_its_verified_author() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    let bob: SharedBus = Arc::new(fixture.node("bob", "consort://ward/node/bob?roles=voter").await);
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    publish(&ada, &Key::Beacon, &beacon("ada")).await;
    let sample = at_bob.recv().await.unwrap();
    assert!(sample.author.may_be("ada") && !sample.author.may_be("bob"), "{}", sample.author);

    let key = keys().write(&Key::Bootstrap(node("bob")));
    let mut queries = bob.serve(&key).await.unwrap();
    let request = codec::encode(&BootstrapRequest { mobile: false, on_battery: false, node: node("ada") }).unwrap();
    let mut replies = ada.query(&key, request.into(), Duration::from_secs(1)).await.unwrap();
    let query = queries.recv().await.unwrap();
    assert!(query.author.may_be("ada") && !query.author.may_be("bob"), "{}", query.author);
    query.replier.reply(&query.key, query.payload.clone(), Encoding::Wire).await.unwrap();
    // The first reply is lost while bob's certificate is unknown to ada.
    drop(query);
    while replies.recv().await.is_some() {}
    let request = codec::encode(&BootstrapRequest { mobile: false, on_battery: false, node: node("ada") }).unwrap();
    let mut replies = ada.query(&key, request.into(), Duration::from_secs(1)).await.unwrap();
    let query = queries.recv().await.unwrap();
    query.replier.reply(&query.key, query.payload.clone(), Encoding::Wire).await.unwrap();
    let reply = replies.recv().await.unwrap();
    assert!(reply.author.may_be("bob") && !reply.author.may_be("ada"), "{}", reply.author);
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_driver_server_speaks_only_for_the_robots_in_its_certificate() {
    let fixture = Fixture::new();
    let world = fixture.node("world", "consort://ward/node/world?roles=host&serves=bob").await;
    let eve = fixture.node("eve", "consort://ward/node/eve?roles=robot,host&serves=eve").await;
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=robot").await;
    let state = Key::Driver("bob".parse().unwrap(), DriverCall::State);
    let mut at_bob = bob.subscribe(&keys().any_driver_state()).await.unwrap();
    introduce(&mut at_bob, &world, &state, b"at the dock").await;
    let own = Key::Driver("eve".parse().unwrap(), DriverCall::State);
    introduce(&mut at_bob, &eve, &own, b"at the lift").await;
    publish(&eve, &state, b"off the map").await;
    assert_eq!(received(&mut at_bob).await, [] as [Bytes; 0]);
    let rejections = bob.rejections();
    let expected = "node eve (robot, host) of eve may not publish on wire/driver/bob/state";
    assert!(rejections.iter().any(|rejection| rejection == expected), "{rejections:?}");
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn only_a_robot_itself_commands_its_driver_server() {
    let fixture = Fixture::new();
    let world = fixture.node("world", "consort://ward/node/world?roles=host&serves=bob").await;
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=robot").await;
    let key = keys().write(&Key::Driver("bob".parse().unwrap(), DriverCall::Command));
    let mut queries = world.serve(&key).await.unwrap();
    tokio::spawn(async move {
        while let Some(query) = queries.recv().await {
            query.replier.reply(&query.key, query.payload.clone(), Encoding::Wire).await.unwrap();
        }
    });
    assert_eq!(query_until_known(&bob, &key, b"drive").await, [Ok(Bytes::from("drive"))]);
    for roles in ["robot", "voter", "host&serves=*", "dashboard", ""] {
        let eve = fixture.node("eve", &format!("consort://ward/node/eve?roles={roles}")).await;
        let replies = query_until_known(&eve, &key, b"drive").await;
        let refusals: Vec<&str> =
            replies.iter().filter_map(|reply| reply.as_ref().err()).map(|refused| &*refused.0).collect();
        let [refusal] = refusals[..] else { panic!("{roles}: {replies:?}") };
        assert!(refusal.contains("may not query wire/driver/bob/command"), "{roles}: {refusal}");
    }
}
