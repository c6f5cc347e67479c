//! Messages that clients read: plain, with a detached signature.

use crate::fixture::*;
use bytes::Bytes;
use consort_bus::{Bus, Encoding, Query, QueryRefused, Reply, ServiceSelection, Stream};
use consort_protocol::keys::{ApiCall, Key};
use std::sync::Arc;
use std::time::Duration;

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn client_messages_are_plain_with_a_detached_signature() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    let client = fixture.plain("client");
    let events = Key::Events(node("ada"));
    let mut at_client = client.subscribe(&keys().write(&events)).await.unwrap();
    publish(&ada, &events, &event("ada", 1)).await;
    let sample = at_client.recv().await.unwrap();
    assert_eq!(sample.payload, event("ada", 1));
    assert!(!sample.attachment.is_empty());
    // A plain client gets a plain reply.
    let view = keys().write(&Key::ViewFleet);
    reply_with(ada.serve_complete(&view).await.unwrap(), |_| Some("{}".into()));
    let replies = all(client.query_nearest(&view, Bytes::new(), Duration::from_secs(1)).await.unwrap()).await;
    assert_eq!(
        replies.iter().map(|reply| (reply.payload.clone(), reply.attachment.len())).collect::<Vec<_>>(),
        [(Ok("{}".into()), 0)]
    );
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_forged_event_is_rejected() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    let eve = fixture.node("eve", "consort://ward/node/eve?roles=robot,voter,host").await;
    let kim = fixture.node("kim", "consort://ward/person/kim?scope=read").await;
    let (of_ada, of_eve) = (Key::Events(node("ada")), Key::Events(node("eve")));
    let mut at_kim = kim.subscribe(&keys().any_events()).await.unwrap();
    let relay = fixture.plain("relay");
    let mut intercepted = relay.subscribe(&keys().any_events()).await.unwrap();
    publish(&ada, &of_ada, &event("ada", 1)).await;
    assert_eq!(received(&mut at_kim).await, [event("ada", 1)], "the certificate is attached");
    let intercepted_sample = intercepted.recv().await.unwrap();
    let none = [] as [Bytes; 0];
    publish_with(&*relay, &of_ada, &intercepted_sample.payload, &intercepted_sample.attachment).await;
    assert_eq!(received(&mut at_kim).await, none, "replayed");
    publish_with(&*relay, &of_eve, &intercepted_sample.payload, &intercepted_sample.attachment).await;
    assert_eq!(received(&mut at_kim).await, none, "moved");
    publish_with(&*relay, &of_ada, &intercepted_sample.payload, &Bytes::new()).await;
    assert_eq!(received(&mut at_kim).await, none, "without a signature");
    assert!(
        kim.rejections().contains(&"message on events/ada rejected: it is not signed".to_owned()),
        "{:?}",
        kim.rejections()
    );
    publish(&eve, &of_ada, &event("ada", 2)).await;
    publish(&eve, &of_eve, &event("ada", 2)).await;
    assert_eq!(received(&mut at_kim).await, none, "in the name of another node");
    for reason in [
        "node eve (robot, voter, host) may not publish on events/ada",
        "node eve (robot, voter, host) may not send on events/eve in the name of ada",
    ] {
        assert!(kim.rejections().contains(&reason.to_owned()), "{:?}", kim.rejections());
    }
    publish(&ada, &of_ada, &event("ada", 3)).await;
    assert_eq!(received(&mut at_kim).await, [event("ada", 3)]);
    // A message that was not received yet, with each byte changed in turn.
    let sample = loop {
        let sample = intercepted.recv().await.unwrap();
        if sample.payload == event("ada", 3) {
            break sample;
        }
    };
    let lee = fixture.node("lee", "consort://ward/person/lee?scope=read").await;
    let mut at_lee = lee.subscribe(&keys().any_events()).await.unwrap();
    // The certificate first: a node that already has it does not read it.
    for index in (0..sample.attachment.len()).rev() {
        let mut changed = sample.attachment.to_vec();
        changed[index] ^= 1;
        publish_with(&*relay, &of_ada, &sample.payload, &changed.into()).await;
    }
    for index in 0..sample.payload.len() {
        let mut changed = sample.payload.to_vec();
        changed[index] ^= 1;
        publish_with(&*relay, &of_ada, &changed, &sample.attachment).await;
    }
    assert_eq!(received(&mut at_lee).await, none, "changed");
    publish_with(&*relay, &of_ada, &sample.payload, &sample.attachment).await;
    assert_eq!(received(&mut at_lee).await, [event("ada", 3)], "unchanged");
}

/// Replies to each query with the result of `with`, if any, for the rest of the test.
fn reply_with(mut queries: Stream<Query>, with: impl Fn(&Query) -> Option<Bytes> + Send + 'static) {
    tokio::spawn(async move {
        while let Some(query) = queries.recv().await {
            if let Some(payload) = with(&query) {
                query.replier.reply(&query.key, payload, Encoding::Json).await.unwrap();
            }
        }
    });
}

async fn all(mut replies: Stream<Reply>) -> Vec<Reply> {
    let mut all = Vec::new();
    while let Some(reply) = replies.recv().await {
        all.push(reply);
    }
    all
}

/// Returns the verified replies to a request.
async fn request_replies(bus: &dyn Bus, request: &'static str) -> Vec<Result<Bytes, QueryRefused>> {
    let key = keys().write(&Key::Api(ApiCall::Submit));
    let replies = bus.query(&key, request.into(), Duration::from_secs(1)).await.unwrap();
    all(replies).await.into_iter().map(|reply| reply.payload).collect()
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_forged_reply_of_the_coordinator_is_rejected() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    let eve = fixture.node("eve", "consort://ward/node/eve?roles=robot,host").await;
    let kim = fixture.node("kim", "consort://ward/person/kim?scope=submit").await;
    let key = keys().write(&Key::Api(ApiCall::Submit));
    reply_with(ada.serve(&key).await.unwrap(), |_| Some("acknowledged".into()));
    reply_with(eve.serve(&key).await.unwrap(), |_| Some("eve's".into()));
    // A replier without a key, and a replier that refuses.
    reply_with(fixture.plain("mallory").serve(&key).await.unwrap(), |_| Some("mallory's".into()));
    let mut refusing = fixture.plain("trudy").serve(&key).await.unwrap();
    tokio::spawn(async move {
        while let Some(query) = refusing.recv().await {
            query.replier.refuse("there is no coordinator").await.unwrap();
        }
    });
    assert_eq!(request_replies(&kim, "one").await, [Ok("acknowledged".into())], "at once: the certificate is attached");
    let rejections = kim.rejections();
    for reason in
        ["node eve (robot, host) may not reply on api/submit", "message on api/submit rejected: it is not signed"]
    {
        assert!(rejections.contains(&reason.to_owned()), "{rejections:?}");
    }
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_reply_to_another_query_is_rejected() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    let kim = fixture.node("kim", "consort://ward/person/kim?scope=submit").await;
    let key = keys().write(&Key::Api(ApiCall::Submit));
    reply_with(ada.serve(&key).await.unwrap(), |query| Some([b"taken: ", &query.payload[..]].concat().into()));
    // A relay between kim and ada: it receives kim's query, and queries ada with other payloads in
    // kim's name.
    let between = Arc::new(fixture.network.bus(node("between")));
    let mut queries = between.serve(&key).await.unwrap();
    let (relay, at_ada) = (Arc::clone(&between), key.clone());
    let (replacements, mut replacement_receiver) = tokio::sync::mpsc::unbounded_channel::<Option<Bytes>>();
    tokio::spawn(async move {
        let mut previous: Option<Reply> = None;
        while let Some(query) = queries.recv().await {
            let Ok(replacement) = replacement_receiver.try_recv() else { continue };
            let reply = match replacement {
                Some(payload) => {
                    let own = relay.query_with(
                        &at_ada,
                        payload,
                        query.attachment.clone(),
                        Duration::from_secs(1),
                        ServiceSelection::All,
                    );
                    let mut own = own.await.unwrap();
                    loop {
                        let reply = own.recv().await.unwrap();
                        if !reply.attachment.is_empty() {
                            break reply;
                        }
                    }
                }
                None => previous.take().unwrap(),
            };
            let payload = reply.payload.clone().unwrap();
            query
                .replier
                .reply_with_attachment(&query.key, payload, reply.attachment.clone(), Encoding::Json)
                .await
                .unwrap();
            previous = Some(reply);
        }
    });
    fixture.network.cut(node("kim"), node("ada"));
    let request = |payload| request_replies(&kim, payload);
    // An unchanged query gets a valid reply, whichever node relays it.
    replacements.send(Some("one".into())).unwrap();
    assert_eq!(request("one").await, [Ok("taken: one".into())]);
    replacements.send(None).unwrap();
    assert_eq!(request("one").await, [], "the reply to the previous query");
    replacements.send(Some("two".into())).unwrap();
    assert_eq!(request("one").await, [], "the reply to a changed query");
    let rejections = kim.rejections();
    let reason = "message on api/submit rejected: the signature is not by node ada (voter)";
    assert!(rejections.contains(&reason.to_owned()), "{rejections:?}");
}
