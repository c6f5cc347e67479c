//! Signed messages on the virtual bus, with real certificates and signatures: valid messages are
//! delivered, and forged or unauthorized messages are rejected.

use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::trust::issue::{
    CertificateAuthority, IssuedCertificate, RevokedCertificate, Validity, create_authority,
};
use consort_bus::trust::{Keyring, ProbeError, SigningBus, TOKEN_MAX, TokenError, TrustFiles};
use consort_bus::{
    Bus, Delivery, Encoding, LinkModel, Query, Reply, Sample, ServiceSelection, SharedBus, Stream, VirtualNetwork,
};
use consort_protocol::codec;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::{ApiCall, BodyCall, Key, Keys};
use consort_protocol::message::{Beacon, BootstrapRequest, ClusterEnvelope};
use consort_protocol::trust::{
    AccessScope, ENVELOPE_BYTES, Fingerprint, Identity, MessageKind, SIGNATURE_BYTES, SignedEnvelope, encode_envelope,
};
use pki_types::pem::PemObject as _;
use pki_types::{CertificateDer, PrivatePkcs8KeyDer};
use rcgen::{CertificateParams, ExtendedKeyUsagePurpose, Issuer, KeyPair, PKCS_ED25519, SanType};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

const NOW: Duration = Duration::from_secs(1_800_000_000);
const LONG: Validity = Validity { from: Duration::from_secs(1_700_000_000), until: Duration::from_secs(1_900_000_000) };

fn ward() -> FleetId {
    FleetId::new("ward").unwrap()
}

fn keys() -> Keys {
    Keys::new(&ward())
}

/// A folder for a single test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Folder {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("consort-trust-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        Folder(folder)
    }

    fn write(&self, name: &str, text: &str) -> PathBuf {
        let file = self.0.join(name);
        std::fs::write(&file, text).unwrap();
        file
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// An authority, and a network of nodes with its certificates.
struct Fixture {
    folder: Folder,
    ca: IssuedCertificate,
    network: VirtualNetwork,
}

impl Fixture {
    fn new() -> Fixture {
        let ca = create_authority(&ward(), LONG).unwrap();
        Fixture { folder: Folder::new(), ca, network: VirtualNetwork::new(1, LinkModel::LAN) }
    }

    fn authority(&self) -> CertificateAuthority {
        CertificateAuthority::from_pem(&self.ca.certificate, &self.ca.key).unwrap()
    }

    fn files(&self, name: &str, issued: &IssuedCertificate) -> TrustFiles {
        TrustFiles {
            authority: self.folder.write("ca.pem", &self.ca.certificate),
            certificate: self.folder.write(&format!("{name}.pem"), &issued.certificate),
            key: self.folder.write(&format!("{name}.key"), &issued.key),
            revoked: None,
        }
    }

    fn plain(&self, name: &str) -> SharedBus {
        Arc::new(self.network.bus(NodeId::new(name).unwrap()))
    }

    /// Starts a node with a certificate for `identity`.
    async fn node(&self, name: &str, identity: &str) -> SigningBus {
        self.incarnation(name, identity, 1).await
    }

    async fn incarnation(&self, name: &str, identity: &str, incarnation: u64) -> SigningBus {
        let issued = self.authority().issue(&identity.parse().unwrap(), &[], LONG).unwrap();
        self.with(self.plain(name), self.files(name, &issued), incarnation).await
    }

    async fn with(&self, bus: SharedBus, files: TrustFiles, incarnation: u64) -> SigningBus {
        let keyring = Arc::new(files.open(&ward(), NOW, incarnation).unwrap());
        let clock = Clock::virtual_at(NOW.as_millis() as u64);
        SigningBus::open(bus, keys(), keyring, files.revoked, clock).await.unwrap()
    }
}

async fn publish(bus: &dyn Bus, key: &Key, content: &[u8]) {
    let payload = Bytes::copy_from_slice(content);
    bus.publish(&keys().write(key), payload, Encoding::Wire, Delivery::Block).await.unwrap();
}

/// Returns all received payloads until no more arrive.
async fn received(stream: &mut Stream<Sample>) -> Vec<Bytes> {
    let mut received = Vec::new();
    while let Ok(Some(sample)) = tokio::time::timeout(Duration::from_secs(5), stream.recv()).await {
        received.push(sample.payload);
    }
    received
}

fn node(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn beacon(of: &str) -> Vec<u8> {
    let beacon = Beacon { node: node(of), term: 3, voters: BTreeSet::new(), since_ms: 0, cluster: None, wire: None };
    codec::encode(&ClusterEnvelope { cluster: None, payload: codec::encode(&beacon).unwrap() }).unwrap()
}

/// Publishes until a message is received: messages before the certificate is known are lost.
async fn introduce(to: &mut Stream<Sample>, bus: &dyn Bus, key: &Key, content: &[u8]) {
    for _ in 0..10 {
        publish(bus, key, content).await;
        if !received(to).await.is_empty() {
            return;
        }
    }
    panic!("the message was never received");
}

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
        fixture.node("ada", "consort://ward/node/ada?roles=host").await,
        fixture.node("bob", "consort://ward/node/bob?roles=robot").await,
    );
    let (own_key, other_key) = ("bob".parse().unwrap(), "cyd".parse().unwrap());
    let (own_key, other_key) = (Key::Body(own_key, BodyCall::State), Key::Body(other_key, BodyCall::State));
    let mut at_bob = bob.subscribe(&keys().any_body_state()).await.unwrap();
    introduce(&mut at_bob, &ada, &own_key, b"at the dock").await;
    // A relay receives the passing messages and publishes modified copies.
    let relay = fixture.plain("relay");
    let mut intercepted = relay.subscribe(&keys().any_body_state()).await.unwrap();
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
async fn query_until_known(bus: &dyn Bus, key: &str, content: &[u8]) -> Vec<Result<Bytes, String>> {
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
            .any(|problem| problem.contains("node eve (robot) may not query")),
        "{payloads:?}"
    );
}

fn event(of: &str, number: u64) -> Vec<u8> {
    serde_json::json!({ "node": of, "sequence": number, "at_ms": 1, "event": "left" }).to_string().into_bytes()
}

async fn publish_with(bus: &dyn Bus, key: &Key, content: &[u8], attachment: &Bytes) {
    let payload = Bytes::copy_from_slice(content);
    let key = keys().write(key);
    bus.publish_with_attachment(&key, payload, attachment.clone(), Encoding::Json, Delivery::Block).await.unwrap();
}

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
async fn request_replies(bus: &dyn Bus, request: &'static str) -> Vec<Result<Bytes, String>> {
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

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_revoked_or_foreign_certificate_is_rejected() {
    let fixture = Fixture::new();
    let authority = fixture.authority();
    let of_ada = authority.issue(&"consort://ward/node/ada?roles=voter".parse().unwrap(), &[], LONG).unwrap();
    let ada = fixture.with(fixture.plain("ada"), fixture.files("ada", &of_ada), 1).await;
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=voter").await;
    let foreign = Fixture { network: fixture.network.clone(), ..Fixture::new() };
    let eve = foreign.node("eve", "consort://ward/node/eve?roles=voter").await;
    let of_kim = authority.issue(&"consort://ward/person/kim?scope=read".parse().unwrap(), &[], LONG).unwrap();
    let mut files = fixture.files("kim", &of_kim);
    let revoked = [RevokedCertificate { serial: serial(&of_ada.certificate), since: NOW }];
    files.revoked = Some(fixture.folder.write("revoked.pem", &authority.revocation_list(&revoked, 1, LONG).unwrap()));
    let kim = fixture.with(fixture.plain("kim"), files, 1).await;
    let mut at_kim = kim.subscribe(&keys().any_events()).await.unwrap();
    let relay = fixture.plain("relay");
    let mut intercepted = relay.subscribe(&keys().any_events()).await.unwrap();
    for (bus, name) in [(&ada, "ada"), (&bob, "bob"), (&eve, "eve")] {
        publish(bus, &Key::Events(node(name)), &event(name, 1)).await;
    }
    assert_eq!(received(&mut at_kim).await, [event("bob", 1)]);
    let rejections = kim.rejections();
    for reason in [
        "message on events/ada rejected: invalid certificate: it has been revoked",
        "message on events/eve rejected: invalid certificate: it was not signed by this fleet's authority",
    ] {
        assert!(rejections.iter().any(|rejection| rejection == reason), "{rejections:?}");
    }
    // The signature of a message with the certificate of another signer.
    let lee = fixture.node("lee", "consort://ward/person/lee?scope=read").await;
    let mut at_lee = lee.subscribe(&keys().any_events()).await.unwrap();
    let intercepted_sample: Vec<Sample> = std::iter::from_fn(|| intercepted.try_recv()).collect();
    let of = |name: &str| intercepted_sample.iter().find(|sample| sample.key.ends_with(name)).unwrap();
    let mixed = [&of("ada").attachment[..ENVELOPE_BYTES], &of("bob").attachment[ENVELOPE_BYTES..]].concat();
    publish_with(&*relay, &Key::Events(node("ada")), &of("ada").payload, &mixed.into()).await;
    assert_eq!(received(&mut at_lee).await, [] as [Bytes; 0]);
    let reason =
        "message on events/ada rejected: the attached certificate belongs to node bob (voter), not to the signer";
    assert!(lee.rejections().contains(&reason.to_owned()), "{:?}", lee.rejections());
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_revocation_ends_accepted_certificates() {
    let fixture = Fixture::new();
    let authority = fixture.authority();
    let list = |revoked: &[RevokedCertificate], number| authority.revocation_list(revoked, number, LONG).unwrap();
    let mut files = {
        let issued = authority.issue(&"consort://ward/node/bob?roles=robot".parse().unwrap(), &[], LONG).unwrap();
        fixture.files("bob", &issued)
    };
    files.revoked = Some(fixture.folder.write("revoked.pem", &list(&[], 1)));
    let bob = fixture.with(fixture.plain("bob"), files, 1).await;
    let of_ada = authority.issue(&"consort://ward/node/ada?roles=voter".parse().unwrap(), &[], LONG).unwrap();
    let serial = serial(&of_ada.certificate);
    let ada = fixture.with(fixture.plain("ada"), fixture.files("ada", &of_ada), 1).await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    let cyd = fixture.node("cyd", "consort://ward/node/cyd?roles=voter").await;
    introduce(&mut at_bob, &cyd, &Key::Beacon, &beacon("cyd")).await;
    let revoked = list(&[RevokedCertificate { serial, since: NOW }], 2);
    // Revoked certificates stay revoked even if the list can no longer be read, and other nodes are
    // unaffected.
    for then in [Some(revoked.as_str()), Some("no list"), None] {
        match then {
            Some(text) => drop(fixture.folder.write("revoked.pem", text)),
            None => std::fs::remove_file(fixture.folder.0.join("revoked.pem")).unwrap(),
        }
        tokio::time::sleep(Duration::from_secs(30)).await;
        for _ in 0..3 {
            publish(&ada, &Key::Beacon, &beacon("ada")).await;
            assert_eq!(received(&mut at_bob).await, [] as [Bytes; 0]);
        }
        publish(&cyd, &Key::Beacon, &beacon("cyd")).await;
        assert_eq!(received(&mut at_bob).await, [beacon("cyd")]);
    }
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn an_expired_certificate_is_no_longer_accepted() {
    let fixture = Fixture::new();
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=robot").await;
    let brief = Validity { from: LONG.from, until: NOW + Duration::from_secs(100) };
    let issued =
        fixture.authority().issue(&"consort://ward/node/ada?roles=voter".parse().unwrap(), &[], brief).unwrap();
    let ada = fixture.with(fixture.plain("ada"), fixture.files("ada", &issued), 1).await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    tokio::time::sleep(Duration::from_secs(120)).await;
    publish(&ada, &Key::Beacon, &beacon("ada")).await;
    assert_eq!(received(&mut at_bob).await, [] as [Bytes; 0]);
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_message_older_than_the_window_is_rejected() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=host").await;
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=robot").await;
    let key = Key::Body("bob".parse().unwrap(), BodyCall::State);
    let mut at_bob = bob.subscribe(&keys().any_body_state()).await.unwrap();
    introduce(&mut at_bob, &ada, &key, b"at the dock").await;
    let relay = fixture.plain("relay");
    let mut intercepted = relay.subscribe(&keys().any_body_state()).await.unwrap();
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

/// Receives all queries for certificates.
async fn certificate_queries(bus: &dyn Bus) -> Stream<Query> {
    bus.serve(&keys().any_certificate()).await.unwrap()
}

/// Returns an envelope of an unknown signer.
fn from_unknown_signer(number: u8) -> Vec<u8> {
    let envelope = SignedEnvelope {
        signer: Fingerprint([number; 16]),
        number: 1,
        signature: &[0; SIGNATURE_BYTES],
        payload: b"?",
    };
    encode_envelope(MessageKind::Publication, envelope)
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn invented_signers_cause_few_certificate_queries() {
    let fixture = Fixture::new();
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=robot").await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    let eve = fixture.plain("eve");
    let mut queries = certificate_queries(&*eve).await;
    let count = |queries: &mut Stream<Query>| std::iter::from_fn(|| queries.try_recv()).count();
    for _ in 0..50 {
        publish(&*eve, &Key::Beacon, &from_unknown_signer(0)).await;
    }
    assert!(tokio::time::timeout(Duration::from_millis(900), at_bob.recv()).await.is_err());
    assert_eq!(count(&mut queries), 1, "a single query per second for a signer");
    for number in 1..=200 {
        publish(&*eve, &Key::Beacon, &from_unknown_signer(number)).await;
    }
    assert!(tokio::time::timeout(Duration::from_millis(100), at_bob.recv()).await.is_err());
    let count = count(&mut queries);
    assert!((31..=32).contains(&count), "{count} concurrent queries");
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_failed_certificate_query_is_retried() {
    let fixture = Fixture::new();
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=robot").await;
    let eve = fixture.node("eve", "consort://ward/node/eve?roles=robot").await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    // Eve, known to bob, replies faster to every certificate query, with her own certificate.
    let mut own = eve.query(&keys().any_certificate(), Bytes::new(), Duration::from_secs(1)).await.unwrap();
    let certificate = loop {
        let reply = own.recv().await.unwrap();
        let certificate = reply.payload.unwrap();
        if identity_in(&fixture, &certificate).contains("node/eve") {
            break certificate;
        }
    };
    let mut queries = certificate_queries(&*fixture.plain("eve")).await;
    tokio::spawn(async move {
        while let Some(query) = queries.recv().await {
            query.replier.reply(&query.key, certificate.clone(), Encoding::Wire).await.unwrap();
        }
    });
    let slow = LinkModel {
        latency_min: Duration::from_millis(200),
        latency_max: Duration::from_millis(300),
        ..LinkModel::LAN
    };
    fixture.network.set_link_model_between(node("ada"), node("bob"), slow);
    fixture.network.cut(node("bob"), node("ada"));
    for _ in 0..3 {
        publish(&ada, &Key::Beacon, &beacon("ada")).await;
        assert_eq!(received(&mut at_bob).await, [] as [Bytes; 0], "ada cannot be queried");
    }
    fixture.network.restore(node("bob"), node("ada"));
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
}

/// Returns the identity in a certificate, as verified by a member of the fleet.
fn identity_in(fixture: &Fixture, certificate: &[u8]) -> String {
    verifier(fixture).add_certificate(certificate, NOW).unwrap().identity.to_string()
}

#[test]
fn the_number_of_stored_certificates_is_limited() {
    let fixture = Fixture::new();
    let (ada, authority) = (verifier(&fixture), fixture.authority());
    let mut certificate = (0..=4096).map(|number| {
        let identity = format!("consort://ward/node/n{number}?roles=").parse().unwrap();
        let issued = authority.issue(&identity, &[], LONG).unwrap();
        let certificate = CertificateDer::from_pem_slice(issued.certificate.as_bytes()).unwrap();
        ada.add_certificate(&certificate, NOW).unwrap().fingerprint()
    });
    let first = certificate.next().unwrap();
    assert!(ada.certificate(first).is_some());
    let last = certificate.last().unwrap();
    assert!(ada.certificate(first).is_none() && ada.certificate(last).is_some());
}

/// Returns a certificate of the fixture's authority with the given names.
fn with_names(fixture: &Fixture, names: &[&str]) -> Vec<u8> {
    let issuer = KeyPair::from_pem(&fixture.ca.key).unwrap();
    let issuer = Issuer::from_ca_cert_pem(&fixture.ca.certificate, issuer).unwrap();
    let mut params = CertificateParams::default();
    params.subject_alt_names = names.iter().map(|name| SanType::URI((*name).try_into().unwrap())).collect();
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    let key = KeyPair::generate_for(&PKCS_ED25519).unwrap();
    params.signed_by(&key, &issuer).unwrap().der().to_vec()
}

#[test]
fn a_certificate_needs_a_consort_name() {
    let fixture = Fixture::new();
    let ada = verifier(&fixture);
    let bob = with_names(&fixture, &["spiffe://ward/bob", "consort://ward/node/bob?roles=robot"]);
    assert_eq!(ada.add_certificate(&bob, NOW).unwrap().identity.to_string(), "consort://ward/node/bob?roles=robot");
    let problem = ada.add_certificate(&with_names(&fixture, &["spiffe://ward/bob"]), NOW).unwrap_err().to_string();
    assert!(problem.contains("it has no name of the form consort://"), "{problem}");
}

#[test]
fn a_persons_certificate_is_no_server_certificate() {
    let fixture = Fixture::new();
    let files_of = |name: &str, identity: &str| {
        let issued = fixture.authority().issue(&identity.parse().unwrap(), &[], LONG).unwrap();
        fixture.files(name, &issued)
    };
    let ada = files_of("ada", "consort://ward/node/ada?roles=robot");
    for (name, identity) in
        [("bob", "consort://ward/node/bob?roles=voter"), ("kim", "consort://ward/person/kim?scope=read")]
    {
        let files = files_of(name, identity);
        let certificate = CertificateDer::from_pem_file(&files.certificate).unwrap();
        let key = PrivatePkcs8KeyDer::from_pem_file(&files.key).unwrap();
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let config =
            rustls::ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
        let config = config.with_no_client_auth().with_single_cert(vec![certificate], key.into()).unwrap();
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let serving = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut tls = rustls::ServerConnection::new(Arc::new(config)).unwrap();
            // A client that rejects the certificate closes the connection.
            while tls.is_handshaking() && tls.complete_io(&mut stream).is_ok() {}
        });
        let probed = ada.probe(address, &ward(), Duration::from_secs(20));
        serving.join().unwrap();
        match name {
            "bob" => assert!(!matches!(probed, Err(ProbeError::UntrustedPeer(_))), "{probed:?}"),
            _ => assert!(matches!(probed, Err(ProbeError::UntrustedPeer(_))), "{probed:?}"),
        }
    }
}

fn serial(certificate: &str) -> Vec<u8> {
    let der = CertificateDer::from_pem_slice(certificate.as_bytes()).unwrap();
    webpki::EndEntityCert::try_from(&der).unwrap().serial().to_vec()
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_restarted_node_is_accepted_at_once() {
    let fixture = Fixture::new();
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=robot").await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    for incarnation in 1..4 {
        // With a new certificate each time, and the same name.
        let ada = fixture.incarnation("ada", "consort://ward/node/ada?roles=voter", incarnation).await;
        introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    }
    // With its previous certificate: it is known, and the numbers continue.
    let issued = fixture.authority().issue(&"consort://ward/node/ada?roles=voter".parse().unwrap(), &[], LONG).unwrap();
    let cyd = fixture.with(fixture.plain("ada"), fixture.files("ada", &issued), 4).await;
    introduce(&mut at_bob, &cyd, &Key::Beacon, &beacon("ada")).await;
    let again = fixture.with(fixture.plain("ada"), fixture.files("ada", &issued), 5).await;
    for _ in 0..5 {
        publish(&again, &Key::Beacon, &beacon("ada")).await;
        assert_eq!(received(&mut at_bob).await, [beacon("ada")]);
    }
}

#[test]
fn inconsistent_files_are_reported_by_name() {
    let fixture = Fixture::new();
    let issue = |identity: &str, validity| {
        let identity: Identity = identity.parse().unwrap();
        fixture.authority().issue(&identity, &["192.0.2.7".to_owned(), "ada.example".to_owned()], validity).unwrap()
    };
    let open_error = |files: &TrustFiles| files.open(&ward(), NOW, 1).err().map(|problem| problem.to_string());
    let ada = issue("consort://ward/node/ada?roles=robot", LONG);
    let good = fixture.files("ada", &ada);
    assert_eq!(open_error(&good), None);
    let name = |file: &Path| file.display().to_string();

    let bob = fixture.files("bob", &issue("consort://ward/node/bob?roles=robot", LONG));
    let mixed = TrustFiles { key: bob.key.clone(), ..good.clone() };
    let problem = open_error(&mixed).unwrap();
    assert!(problem.contains("the key does not belong to") && problem.contains(&name(&mixed.key)), "{problem}");

    let other = Fixture::new();
    let foreign =
        other.files("ca", &IssuedCertificate { certificate: other.ca.certificate.clone(), key: String::new() });
    let problem = open_error(&TrustFiles { authority: foreign.authority.clone(), ..good.clone() }).unwrap();
    assert!(problem.contains("it was not signed by this fleet's authority"), "{problem}");

    let past = Validity { from: Duration::from_secs(1_600_000_000), until: NOW - Duration::from_secs(3 * 86_400) };
    let problem = open_error(&fixture.files("old", &issue("consort://ward/node/old?roles=robot", past))).unwrap();
    assert!(problem.ends_with("old.pem: it expired 3 days ago"), "{problem}");

    let ahead = Validity { from: NOW + Duration::from_secs(7200), until: LONG.until };
    let problem = open_error(&fixture.files("new", &issue("consort://ward/node/new?roles=robot", ahead))).unwrap();
    assert!(problem.contains("valid only in 2 h; check the clock"), "{problem}");

    let problem = open_error(&fixture.files("far", &issue("consort://lab/node/far?roles=robot", LONG))).unwrap();
    assert!(problem.contains("it is for fleet lab, but this fleet is ward"), "{problem}");

    let none = TrustFiles { key: good.certificate.clone(), ..good.clone() };
    let problem = open_error(&none).unwrap();
    assert!(problem.contains("no private key in PKCS #8 found"), "{problem}");
    let missing = TrustFiles { certificate: fixture.folder.0.join("nowhere.pem"), ..good };
    assert!(open_error(&missing).unwrap().contains("nowhere.pem: "), "{missing:?}");
}

/// Returns the keyring of a person with this scope.
fn person(fixture: &Fixture, scope: &str) -> Keyring {
    let identity = format!("consort://ward/person/kim?scope={scope}").parse().unwrap();
    let issued = fixture.authority().issue(&identity, &[], LONG).unwrap();
    fixture.files("kim", &issued).open(&ward(), NOW, 1).unwrap()
}

/// Returns a keyring that verifies by the authority alone.
fn verifier(fixture: &Fixture) -> Keyring {
    let issued = fixture.authority().issue(&"consort://ward/node/ada?roles=".parse().unwrap(), &[], LONG).unwrap();
    fixture.files("ada", &issued).open(&ward(), NOW, 1).unwrap()
}

const HOUR: Duration = Duration::from_secs(3600);

#[test]
fn a_token_is_valid_for_its_scope_and_time() {
    let fixture = Fixture::new();
    let (kim, ada) = (person(&fixture, "submit"), verifier(&fixture));
    let token = kim.issue_token(AccessScope::Read, NOW + HOUR).unwrap();
    let claims = ada.verify_token(&token, NOW).unwrap();
    assert_eq!((claims.name.as_str(), claims.scope, claims.expires), ("kim", AccessScope::Read, NOW + HOUR));
    assert_eq!(ada.verify_token(&token, NOW + HOUR), Err(TokenError::Expired("0 s".to_owned())));
    assert!(kim.issue_token(AccessScope::Submit, NOW + HOUR).is_ok());
    assert!(matches!(kim.issue_token(AccessScope::Operate, NOW + HOUR), Err(TokenError::Scope { .. })));
    assert!(matches!(ada.issue_token(AccessScope::Read, NOW + HOUR), Err(TokenError::Node(_))));
    // The token ends with the certificate.
    let late = kim.issue_token(AccessScope::Read, LONG.until + 2 * HOUR).unwrap();
    assert!(matches!(ada.verify_token(&late, LONG.until + HOUR), Err(TokenError::Certificate(_))));
}

#[test]
fn a_changed_token_is_rejected() {
    let fixture = Fixture::new();
    let (kim, ada) = (person(&fixture, "read"), verifier(&fixture));
    let token = kim.issue_token(AccessScope::Read, NOW + HOUR).unwrap();
    for (at, was) in token.bytes().enumerate() {
        for other in [b'A', b'x', b'.', b'='] {
            let mut changed = token.clone().into_bytes();
            changed[at] = other;
            let changed = String::from_utf8(changed).unwrap();
            assert!(other == was || ada.verify_token(&changed, NOW).is_err(), "at {at}");
        }
        assert!(ada.verify_token(&token[..at], NOW).is_err(), "cut at {at}");
    }
    let longer = format!("{token}{}", "A".repeat(TOKEN_MAX));
    assert_eq!(ada.verify_token(&longer, NOW), Err(TokenError::Malformed("it is too long")));
}

#[test]
fn a_token_with_excessive_claims_is_rejected() {
    use base64::Engine as _;
    use base64::engine::general_purpose::URL_SAFE_NO_PAD;
    let fixture = Fixture::new();
    let identity = "consort://ward/person/kim?scope=read".parse().unwrap();
    let issued = fixture.authority().issue(&identity, &[], LONG).unwrap();
    let files = fixture.files("kim", &issued);
    let (kim, ada) = (files.open(&ward(), NOW, 1).unwrap(), verifier(&fixture));
    let key = PrivatePkcs8KeyDer::from_pem_file(&files.key).unwrap();
    let key = ring::signature::Ed25519KeyPair::from_pkcs8_maybe_unchecked(key.secret_pkcs8_der()).unwrap();
    let token = kim.issue_token(AccessScope::Read, NOW + HOUR).unwrap();
    let head = token.split('.').next().unwrap().to_owned();
    let forged_with = |head: &str, claims: &serde_json::Value| {
        let signed = format!("{head}.{}", URL_SAFE_NO_PAD.encode(claims.to_string()));
        format!("{signed}.{}", URL_SAFE_NO_PAD.encode(key.sign(signed.as_bytes())))
    };
    let forged = |claims: serde_json::Value| forged_with(&head, &claims);
    let until = (NOW + HOUR).as_secs();
    let valid_claims = serde_json::json!({ "aud": "ward", "exp": until, "scope": "read" });
    assert!(ada.verify_token(&forged(valid_claims.clone()), NOW).is_ok(), "the forged token is signed like a real one");
    let mut other: serde_json::Value = serde_json::from_slice(&URL_SAFE_NO_PAD.decode(&head).unwrap()).unwrap();
    other["alg"] = "HS256".into();
    let other = forged_with(&URL_SAFE_NO_PAD.encode(other.to_string()), &valid_claims);
    assert_eq!(ada.verify_token(&other, NOW), Err(TokenError::Malformed("its algorithm is not EdDSA")));
    let more = serde_json::json!({ "aud": "ward", "exp": until, "scope": "operate" });
    let refused = ada.verify_token(&forged(more), NOW).unwrap_err();
    assert_eq!(refused.to_string(), "the token claims scope operate, but kim has scope read");
    let other_fleet = serde_json::json!({ "aud": "clinic", "exp": until, "scope": "read" });
    assert_eq!(ada.verify_token(&forged(other_fleet), NOW).unwrap_err().to_string(), "the token is for fleet clinic");
}
