//! Nodes that seal what they say, and what becomes of those who say what they may not: on the virtual bus, with real
//! certificates and signatures.

use bytes::Bytes;
use consort_actors::bus::{
    Bus, Delivery, Encoding, LinkModel, Query, Reply, Sample, ServiceSelection, SharedBus, Stream, VirtualNetwork,
};
use consort_actors::clock::Clock;
use consort_actors::trust::issue::{
    CertificateAuthority, IssuedCertificate, RevokedCertificate, Validity, create_authority,
};
use consort_actors::trust::{Keyring, ProbeError, SigningBus, TOKEN_MAX, TokenError, TrustFiles};
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

/// A folder of its own for each test, gone with it.
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

/// An authority, and a network whose nodes have certificates of it.
struct Stage {
    folder: Folder,
    ca: IssuedCertificate,
    network: VirtualNetwork,
}

impl Stage {
    fn new() -> Stage {
        let ca = create_authority(&ward(), LONG).unwrap();
        Stage { folder: Folder::new(), ca, network: VirtualNetwork::new(1, LinkModel::LAN) }
    }

    fn authority(&self) -> CertificateAuthority {
        CertificateAuthority::from_pem(&self.ca.certificate, &self.ca.key).unwrap()
    }

    fn files(&self, who: &str, issued: &IssuedCertificate) -> TrustFiles {
        TrustFiles {
            authority: self.folder.write("ca.pem", &self.ca.certificate),
            certificate: self.folder.write(&format!("{who}.pem"), &issued.certificate),
            key: self.folder.write(&format!("{who}.key"), &issued.key),
            revoked: None,
        }
    }

    fn plain(&self, who: &str) -> SharedBus {
        Arc::new(self.network.bus(NodeId::new(who).unwrap()))
    }

    /// A node with a certificate for what `identity` says.
    async fn node(&self, who: &str, identity: &str) -> SigningBus {
        self.life(who, identity, 1).await
    }

    async fn life(&self, who: &str, identity: &str, life: u64) -> SigningBus {
        let issued = self.authority().issue(&identity.parse().unwrap(), &[], LONG).unwrap();
        self.with(self.plain(who), self.files(who, &issued), life).await
    }

    async fn with(&self, bus: SharedBus, files: TrustFiles, life: u64) -> SigningBus {
        let keyring = Arc::new(files.open(&ward(), NOW, life).unwrap());
        let clock = Clock::virtual_at(NOW.as_millis() as u64);
        SigningBus::open(bus, keys(), keyring, files.revoked, clock).await.unwrap()
    }
}

async fn say(bus: &dyn Bus, key: &Key, what: &[u8]) {
    let payload = Bytes::copy_from_slice(what);
    bus.publish(&keys().write(key), payload, Encoding::Wire, Delivery::Block).await.unwrap();
}

/// All that is heard until nothing more comes.
async fn heard(stream: &mut Stream<Sample>) -> Vec<Bytes> {
    let mut heard = Vec::new();
    while let Ok(Some(sample)) = tokio::time::timeout(Duration::from_secs(5), stream.recv()).await {
        heard.push(sample.payload);
    }
    heard
}

fn node(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn beacon(of: &str) -> Vec<u8> {
    let beacon = Beacon { node: node(of), term: 3, voters: BTreeSet::new(), since_ms: 0, cluster: None, wire: None };
    codec::encode(&ClusterEnvelope { cluster: None, payload: codec::encode(&beacon).unwrap() }).unwrap()
}

/// Says something until it is heard: what is said before the certificate is known is lost.
async fn introduce(to: &mut Stream<Sample>, bus: &dyn Bus, key: &Key, what: &[u8]) {
    for _ in 0..10 {
        say(bus, key, what).await;
        if !heard(to).await.is_empty() {
            return;
        }
    }
    panic!("never heard");
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn what_a_node_says_in_its_own_name_is_heard_and_what_it_says_in_anothers_is_not() {
    let stage = Stage::new();
    let ada = stage.node("ada", "consort://ward/node/ada?roles=robot,voter").await;
    let bob = stage.node("bob", "consort://ward/node/bob?roles=robot").await;
    let eve = stage.node("eve", "consort://ward/node/eve?roles=robot").await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    say(&ada, &Key::Beacon, &beacon("bob")).await;
    assert_eq!(heard(&mut at_bob).await, [] as [Bytes; 0], "ada speaks in the name of bob");
    for _ in 0..3 {
        say(&eve, &Key::Beacon, &beacon("eve")).await;
        assert_eq!(heard(&mut at_bob).await, [] as [Bytes; 0], "eve is no voter");
    }
    say(&ada, &Key::Beacon, &beacon("ada")).await;
    assert_eq!(heard(&mut at_bob).await, [beacon("ada")]);
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn who_has_no_certificate_of_the_fleet_is_not_heard_and_hears_nothing_it_can_use() {
    let stage = Stage::new();
    let ada = stage.node("ada", "consort://ward/node/ada?roles=voter").await;
    let mut at_ada = ada.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    let stranger = stage.plain("stranger");
    say(&*stranger, &Key::Beacon, &beacon("stranger")).await;
    let other = Stage { network: stage.network.clone(), ..Stage::new() };
    let foreign = other.node("foreign", "consort://ward/node/foreign?roles=voter").await;
    for _ in 0..3 {
        say(&foreign, &Key::Beacon, &beacon("foreign")).await;
        assert_eq!(heard(&mut at_ada).await, [] as [Bytes; 0]);
    }
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_message_that_is_changed_moved_or_repeated_on_the_way_is_not_heard() {
    let stage = Stage::new();
    let (ada, bob) = (
        stage.node("ada", "consort://ward/node/ada?roles=host").await,
        stage.node("bob", "consort://ward/node/bob?roles=robot").await,
    );
    let (here, there) = ("bob".parse().unwrap(), "cyd".parse().unwrap());
    let (here, there) = (Key::Body(here, BodyCall::State), Key::Body(there, BodyCall::State));
    let mut at_bob = bob.subscribe(&keys().any_body_state()).await.unwrap();
    introduce(&mut at_bob, &ada, &here, b"at the dock").await;
    // A relay sees what passes, and sends it on as it likes.
    let relay = stage.plain("relay");
    let mut passing = relay.subscribe(&keys().any_body_state()).await.unwrap();
    say(&ada, &here, b"at the lift").await;
    assert_eq!(heard(&mut at_bob).await, ["at the lift"]);
    let seen = heard(&mut passing).await.pop().unwrap();
    say(&*relay, &here, &seen).await;
    say(&*relay, &there, &seen).await;
    for place in 0..seen.len() {
        let mut changed = seen.to_vec();
        changed[place] ^= 1;
        say(&*relay, &here, &changed).await;
    }
    assert_eq!(heard(&mut at_bob).await, [] as [Bytes; 0]);
    // What was kept back all the while still counts when it comes.
    say(&ada, &here, b"at the ward").await;
    assert_eq!(heard(&mut at_bob).await, ["at the ward"]);
}

/// Asks until the one who answers is known.
async fn ask(bus: &dyn Bus, key: &str, what: &[u8]) -> Vec<Result<Bytes, String>> {
    let mut answers = Vec::new();
    for _ in 0..3 {
        answers.clear();
        let mut replies = bus.query(key, Bytes::copy_from_slice(what), Duration::from_secs(1)).await.unwrap();
        while let Some(reply) = replies.recv().await {
            answers.push(reply.payload);
        }
        tokio::time::sleep(Duration::from_secs(2)).await;
    }
    answers
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_question_is_answered_by_who_may_and_to_who_may_ask() {
    let stage = Stage::new();
    let ada = stage.node("ada", "consort://ward/node/ada?roles=voter").await;
    let bob = stage.node("bob", "consort://ward/node/bob?roles=voter").await;
    let eve = stage.node("eve", "consort://ward/node/eve?roles=robot").await;
    let key = keys().write(&Key::Bootstrap(node("bob")));
    for bus in [&bob, &eve] {
        // Eve answers in the place of bob.
        let mut asked = bus.serve(&key).await.unwrap();
        tokio::spawn(async move {
            while let Some(query) = asked.recv().await {
                query.replier.reply(&query.key, query.payload.clone(), Encoding::Wire).await.unwrap();
            }
        });
    }
    let founder =
        |name: &str| codec::encode(&BootstrapRequest { mobile: false, on_battery: false, node: node(name) }).unwrap();
    assert_eq!(ask(&ada, &key, &founder("ada")).await, [Ok(Bytes::from(founder("ada")))], "one answer: eve's is none");
    for (asker, question) in [(&eve, founder("eve")), (&ada, founder("bob"))] {
        let answers = ask(asker, &key, &question).await;
        assert!(answers.iter().all(Result::is_err) && !answers.is_empty(), "{answers:?}");
    }
    let said = ask(&eve, &key, &founder("eve")).await;
    assert!(
        said.iter().flat_map(|answer| answer.clone().err()).any(|why| why.contains("node eve (robot) may not ask")),
        "{said:?}"
    );
}

fn event(of: &str, number: u64) -> Vec<u8> {
    serde_json::json!({ "node": of, "sequence": number, "at_ms": 1, "event": "left" }).to_string().into_bytes()
}

async fn tell(bus: &dyn Bus, key: &Key, what: &[u8], beside: &Bytes) {
    let payload = Bytes::copy_from_slice(what);
    let key = keys().write(key);
    bus.publish_with_attachment(&key, payload, beside.clone(), Encoding::Json, Delivery::Block).await.unwrap();
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn what_anybodys_clients_read_is_plain_and_bears_its_seal_beside_it() {
    let stage = Stage::new();
    let ada = stage.node("ada", "consort://ward/node/ada?roles=voter").await;
    let client = stage.plain("client");
    let events = Key::Events(node("ada"));
    let mut at_client = client.subscribe(&keys().write(&events)).await.unwrap();
    say(&ada, &events, &event("ada", 1)).await;
    let sample = at_client.recv().await.unwrap();
    assert_eq!(sample.payload, event("ada", 1));
    assert!(!sample.attachment.is_empty());
    // Who asks as everybody does gets the bare answer.
    let view = keys().write(&Key::ViewFleet);
    answering(ada.serve_complete(&view).await.unwrap(), |_| Some("{}".into()));
    let replies = all(client.query_nearest(&view, Bytes::new(), Duration::from_secs(1)).await.unwrap()).await;
    assert_eq!(
        replies.iter().map(|reply| (reply.payload.clone(), reply.attachment.len())).collect::<Vec<_>>(),
        [(Ok("{}".into()), 0)]
    );
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn an_event_is_heard_the_first_time_and_a_forged_one_never() {
    let stage = Stage::new();
    let ada = stage.node("ada", "consort://ward/node/ada?roles=voter").await;
    let eve = stage.node("eve", "consort://ward/node/eve?roles=robot,voter,host").await;
    let kim = stage.node("kim", "consort://ward/person/kim?scope=read").await;
    let (of_ada, of_eve) = (Key::Events(node("ada")), Key::Events(node("eve")));
    let mut at_kim = kim.subscribe(&keys().any_events()).await.unwrap();
    let relay = stage.plain("relay");
    let mut passing = relay.subscribe(&keys().any_events()).await.unwrap();
    say(&ada, &of_ada, &event("ada", 1)).await;
    assert_eq!(heard(&mut at_kim).await, [event("ada", 1)], "nobody need know ada");
    let seen = passing.recv().await.unwrap();
    let nothing = [] as [Bytes; 0];
    tell(&*relay, &of_ada, &seen.payload, &seen.attachment).await;
    assert_eq!(heard(&mut at_kim).await, nothing, "repeated");
    tell(&*relay, &of_eve, &seen.payload, &seen.attachment).await;
    assert_eq!(heard(&mut at_kim).await, nothing, "moved");
    tell(&*relay, &of_ada, &seen.payload, &Bytes::new()).await;
    assert_eq!(heard(&mut at_kim).await, nothing, "without a seal");
    assert!(
        kim.rejections().contains(&"somebody on events/ada: it bears no seal".to_owned()),
        "{:?}",
        kim.rejections()
    );
    say(&eve, &of_ada, &event("ada", 2)).await;
    say(&eve, &of_eve, &event("ada", 2)).await;
    assert_eq!(heard(&mut at_kim).await, nothing, "in another's name");
    for told in [
        "node eve (robot, voter, host) may not publish on events/ada",
        "node eve (robot, voter, host) speaks on events/eve in the name of ada",
    ] {
        assert!(kim.rejections().contains(&told.to_owned()), "{:?}", kim.rejections());
    }
    say(&ada, &of_ada, &event("ada", 3)).await;
    assert_eq!(heard(&mut at_kim).await, [event("ada", 3)]);
    // One that was not heard yet, each byte of it changed.
    let held = loop {
        let held = passing.recv().await.unwrap();
        if held.payload == event("ada", 3) {
            break held;
        }
    };
    let lee = stage.node("lee", "consort://ward/person/lee?scope=read").await;
    let mut at_lee = lee.subscribe(&keys().any_events()).await.unwrap();
    // The certificate first: who knows it already does not look at it.
    for place in (0..held.attachment.len()).rev() {
        let mut changed = held.attachment.to_vec();
        changed[place] ^= 1;
        tell(&*relay, &of_ada, &held.payload, &changed.into()).await;
    }
    for place in 0..held.payload.len() {
        let mut changed = held.payload.to_vec();
        changed[place] ^= 1;
        tell(&*relay, &of_ada, &changed, &held.attachment).await;
    }
    assert_eq!(heard(&mut at_lee).await, nothing, "changed");
    tell(&*relay, &of_ada, &held.payload, &held.attachment).await;
    assert_eq!(heard(&mut at_lee).await, [event("ada", 3)], "and as it was");
}

/// Answers each question with what is given for it, if anything, for as long as the test lasts.
fn answering(mut questions: Stream<Query>, with: impl Fn(&Query) -> Option<Bytes> + Send + 'static) {
    tokio::spawn(async move {
        while let Some(query) = questions.recv().await {
            if let Some(answer) = with(&query) {
                query.replier.reply(&query.key, answer, Encoding::Json).await.unwrap();
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

/// The answers to a request that are believed.
async fn requested(bus: &dyn Bus, request: &'static str) -> Vec<Result<Bytes, String>> {
    let key = keys().write(&Key::Api(ApiCall::Submit));
    let replies = bus.query(&key, request.into(), Duration::from_secs(1)).await.unwrap();
    all(replies).await.into_iter().map(|reply| reply.payload).collect()
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn who_answers_in_the_coordinators_stead_is_not_believed_and_is_told_about() {
    let stage = Stage::new();
    let ada = stage.node("ada", "consort://ward/node/ada?roles=voter").await;
    let eve = stage.node("eve", "consort://ward/node/eve?roles=robot,host").await;
    let kim = stage.node("kim", "consort://ward/person/kim?scope=submit").await;
    let key = keys().write(&Key::Api(ApiCall::Submit));
    answering(ada.serve(&key).await.unwrap(), |_| Some("acknowledged".into()));
    answering(eve.serve(&key).await.unwrap(), |_| Some("eve's".into()));
    // One who has nothing to sign with, and one who refuses in everybody's name.
    answering(stage.plain("mallory").serve(&key).await.unwrap(), |_| Some("mallory's".into()));
    let mut refusing = stage.plain("trudy").serve(&key).await.unwrap();
    tokio::spawn(async move {
        while let Some(query) = refusing.recv().await {
            query.replier.refuse("nobody coordinates").await.unwrap();
        }
    });
    assert_eq!(requested(&kim, "one").await, [Ok("acknowledged".into())], "at once: the certificate comes along");
    let told = kim.rejections();
    for reason in ["node eve (robot, host) may not answer on api/submit", "somebody on api/submit: it bears no seal"] {
        assert!(told.contains(&reason.to_owned()), "{told:?}");
    }
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn an_answer_to_another_question_is_none() {
    let stage = Stage::new();
    let ada = stage.node("ada", "consort://ward/node/ada?roles=voter").await;
    let kim = stage.node("kim", "consort://ward/person/kim?scope=submit").await;
    let key = keys().write(&Key::Api(ApiCall::Submit));
    answering(ada.serve(&key).await.unwrap(), |query| Some([b"taken: ", &query.payload[..]].concat().into()));
    // A relay, between kim and ada: it hears kim's question, and asks ada what it likes in kim's name.
    let between = Arc::new(stage.network.bus(node("between")));
    let mut asked = between.serve(&key).await.unwrap();
    let (relay, at_ada) = (Arc::clone(&between), key.clone());
    let (swap, mut swaps) = tokio::sync::mpsc::unbounded_channel::<Option<Bytes>>();
    tokio::spawn(async move {
        let mut kept: Option<Reply> = None;
        while let Some(query) = asked.recv().await {
            let Ok(instead) = swaps.try_recv() else { continue };
            let reply = match instead {
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
                None => kept.take().unwrap(),
            };
            let payload = reply.payload.clone().unwrap();
            query
                .replier
                .reply_with_attachment(&query.key, payload, reply.attachment.clone(), Encoding::Json)
                .await
                .unwrap();
            kept = Some(reply);
        }
    });
    stage.network.cut(node("kim"), node("ada"));
    let ask = |what| requested(&kim, what);
    // As it was asked, it is an answer, whoever carried it.
    swap.send(Some("one".into())).unwrap();
    assert_eq!(ask("one").await, [Ok("taken: one".into())]);
    swap.send(None).unwrap();
    assert_eq!(ask("one").await, [], "the answer to the question before");
    swap.send(Some("two".into())).unwrap();
    assert_eq!(ask("one").await, [], "the answer to a question that was changed");
    let told = kim.rejections();
    let reason = "somebody on api/submit says to be node ada (voter), whose signature it is not";
    assert!(told.contains(&reason.to_owned()), "{told:?}");
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn who_shows_a_certificate_that_is_revoked_or_anothers_is_not_believed() {
    let stage = Stage::new();
    let authority = stage.authority();
    let of_ada = authority.issue(&"consort://ward/node/ada?roles=voter".parse().unwrap(), &[], LONG).unwrap();
    let ada = stage.with(stage.plain("ada"), stage.files("ada", &of_ada), 1).await;
    let bob = stage.node("bob", "consort://ward/node/bob?roles=voter").await;
    let foreign = Stage { network: stage.network.clone(), ..Stage::new() };
    let eve = foreign.node("eve", "consort://ward/node/eve?roles=voter").await;
    let of_kim = authority.issue(&"consort://ward/person/kim?scope=read".parse().unwrap(), &[], LONG).unwrap();
    let mut files = stage.files("kim", &of_kim);
    let revoked = [RevokedCertificate { serial: serial(&of_ada.certificate), since: NOW }];
    files.revoked = Some(stage.folder.write("revoked.pem", &authority.revocation_list(&revoked, 1, LONG).unwrap()));
    let kim = stage.with(stage.plain("kim"), files, 1).await;
    let mut at_kim = kim.subscribe(&keys().any_events()).await.unwrap();
    let relay = stage.plain("relay");
    let mut passing = relay.subscribe(&keys().any_events()).await.unwrap();
    for (bus, name) in [(&ada, "ada"), (&bob, "bob"), (&eve, "eve")] {
        say(bus, &Key::Events(node(name)), &event(name, 1)).await;
    }
    assert_eq!(heard(&mut at_kim).await, [event("bob", 1)]);
    let told = kim.rejections();
    for reason in [
        "somebody on events/ada whose certificate is not believed: it has been revoked",
        "somebody on events/eve whose certificate is not believed: it was not signed by this fleet's authority",
    ] {
        assert!(told.iter().any(|told| told == reason), "{told:?}");
    }
    // The head of one seal with the certificate of another.
    let lee = stage.node("lee", "consort://ward/person/lee?scope=read").await;
    let mut at_lee = lee.subscribe(&keys().any_events()).await.unwrap();
    let seen: Vec<Sample> = std::iter::from_fn(|| passing.try_recv()).collect();
    let of = |name: &str| seen.iter().find(|sample| sample.key.ends_with(name)).unwrap();
    let mixed = [&of("ada").attachment[..ENVELOPE_BYTES], &of("bob").attachment[ENVELOPE_BYTES..]].concat();
    tell(&*relay, &Key::Events(node("ada")), &of("ada").payload, &mixed.into()).await;
    assert_eq!(heard(&mut at_lee).await, [] as [Bytes; 0]);
    let reason = "somebody on events/ada shows the certificate of node bob (voter) for another";
    assert!(lee.rejections().contains(&reason.to_owned()), "{:?}", lee.rejections());
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_revoked_bearer_is_no_longer_heard_though_it_was_believed() {
    let stage = Stage::new();
    let authority = stage.authority();
    let list = |revoked: &[RevokedCertificate], number| authority.revocation_list(revoked, number, LONG).unwrap();
    let mut files = {
        let issued = authority.issue(&"consort://ward/node/bob?roles=robot".parse().unwrap(), &[], LONG).unwrap();
        stage.files("bob", &issued)
    };
    files.revoked = Some(stage.folder.write("revoked.pem", &list(&[], 1)));
    let bob = stage.with(stage.plain("bob"), files, 1).await;
    let of_ada = authority.issue(&"consort://ward/node/ada?roles=voter".parse().unwrap(), &[], LONG).unwrap();
    let serial = serial(&of_ada.certificate);
    let ada = stage.with(stage.plain("ada"), stage.files("ada", &of_ada), 1).await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    let cyd = stage.node("cyd", "consort://ward/node/cyd?roles=voter").await;
    introduce(&mut at_bob, &cyd, &Key::Beacon, &beacon("cyd")).await;
    let revoked = list(&[RevokedCertificate { serial, since: NOW }], 2);
    // What was revoked stays so, though the list cannot be read any more; and nobody else comes to harm.
    for then in [Some(revoked.as_str()), Some("no list"), None] {
        match then {
            Some(text) => drop(stage.folder.write("revoked.pem", text)),
            None => std::fs::remove_file(stage.folder.0.join("revoked.pem")).unwrap(),
        }
        tokio::time::sleep(Duration::from_secs(30)).await;
        for _ in 0..3 {
            say(&ada, &Key::Beacon, &beacon("ada")).await;
            assert_eq!(heard(&mut at_bob).await, [] as [Bytes; 0]);
        }
        say(&cyd, &Key::Beacon, &beacon("cyd")).await;
        assert_eq!(heard(&mut at_bob).await, [beacon("cyd")]);
    }
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn who_was_believed_is_not_once_the_certificate_has_ended() {
    let stage = Stage::new();
    let bob = stage.node("bob", "consort://ward/node/bob?roles=robot").await;
    let brief = Validity { from: LONG.from, until: NOW + Duration::from_secs(100) };
    let issued = stage.authority().issue(&"consort://ward/node/ada?roles=voter".parse().unwrap(), &[], brief).unwrap();
    let ada = stage.with(stage.plain("ada"), stage.files("ada", &issued), 1).await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    tokio::time::sleep(Duration::from_secs(120)).await;
    say(&ada, &Key::Beacon, &beacon("ada")).await;
    assert_eq!(heard(&mut at_bob).await, [] as [Bytes; 0]);
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn what_is_far_behind_is_not_heard_though_nobody_remembers_it() {
    let stage = Stage::new();
    let ada = stage.node("ada", "consort://ward/node/ada?roles=host").await;
    let bob = stage.node("bob", "consort://ward/node/bob?roles=robot").await;
    let key = Key::Body("bob".parse().unwrap(), BodyCall::State);
    let mut at_bob = bob.subscribe(&keys().any_body_state()).await.unwrap();
    introduce(&mut at_bob, &ada, &key, b"at the dock").await;
    let relay = stage.plain("relay");
    let mut passing = relay.subscribe(&keys().any_body_state()).await.unwrap();
    say(&ada, &key, b"at the lift").await;
    let seen = passing.recv().await.unwrap().payload;
    for _ in 0..1100 {
        say(&ada, &key, b"at the ward").await;
    }
    assert_eq!(heard(&mut at_bob).await.len(), 1101);
    say(&*relay, &key, &seen).await;
    assert_eq!(heard(&mut at_bob).await, [] as [Bytes; 0]);
    let told = bob.rejections();
    assert!(told.iter().any(|told| told.contains("is older than what it said before")), "{told:?}");
}

/// Which certificates are asked for, by whoever.
async fn asked_for(bus: &dyn Bus) -> Stream<Query> {
    bus.serve(&keys().any_certificate()).await.unwrap()
}

/// Bytes that look like a message of somebody nobody knows.
fn of_nobody(number: u8) -> Vec<u8> {
    let sealed = SignedEnvelope {
        signer: Fingerprint([number; 16]),
        number: 1,
        signature: &[0; SIGNATURE_BYTES],
        payload: b"?",
    };
    encode_envelope(MessageKind::Publication, sealed)
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn who_makes_up_authors_has_few_of_them_asked_for() {
    let stage = Stage::new();
    let bob = stage.node("bob", "consort://ward/node/bob?roles=robot").await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    let eve = stage.plain("eve");
    let mut asked = asked_for(&*eve).await;
    let count = |asked: &mut Stream<Query>| std::iter::from_fn(|| asked.try_recv()).count();
    for _ in 0..50 {
        say(&*eve, &Key::Beacon, &of_nobody(0)).await;
    }
    assert!(tokio::time::timeout(Duration::from_millis(900), at_bob.recv()).await.is_err());
    assert_eq!(count(&mut asked), 1, "one author, once in a second");
    for number in 1..=200 {
        say(&*eve, &Key::Beacon, &of_nobody(number)).await;
    }
    assert!(tokio::time::timeout(Duration::from_millis(100), at_bob.recv()).await.is_err());
    let others = count(&mut asked);
    assert!((31..=32).contains(&others), "{others}: so many at once");
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn who_could_not_be_asked_is_asked_again_and_whatever_else_is_shown_does_not_matter() {
    let stage = Stage::new();
    let bob = stage.node("bob", "consort://ward/node/bob?roles=robot").await;
    let eve = stage.node("eve", "consort://ward/node/eve?roles=robot").await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    let ada = stage.node("ada", "consort://ward/node/ada?roles=voter").await;
    // Eve, whom bob knows, shows her own certificate for everybody's, and is the quicker.
    let mut own = eve.query(&keys().any_certificate(), Bytes::new(), Duration::from_secs(1)).await.unwrap();
    let shown = loop {
        let reply = own.recv().await.unwrap();
        let shown = reply.payload.unwrap();
        if bob_knows(&stage, &shown).contains("node/eve") {
            break shown;
        }
    };
    let mut asked = asked_for(&*stage.plain("eve")).await;
    tokio::spawn(async move {
        while let Some(query) = asked.recv().await {
            query.replier.reply(&query.key, shown.clone(), Encoding::Wire).await.unwrap();
        }
    });
    let slow = LinkModel {
        latency_min: Duration::from_millis(200),
        latency_max: Duration::from_millis(300),
        ..LinkModel::LAN
    };
    stage.network.set_link_model_between(node("ada"), node("bob"), slow);
    stage.network.cut(node("bob"), node("ada"));
    for _ in 0..3 {
        say(&ada, &Key::Beacon, &beacon("ada")).await;
        assert_eq!(heard(&mut at_bob).await, [] as [Bytes; 0], "she cannot be asked");
    }
    stage.network.restore(node("bob"), node("ada"));
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
}

/// Whose certificate it is, as somebody of the fleet judges it.
fn bob_knows(stage: &Stage, certificate: &[u8]) -> String {
    judge(stage).add_certificate(certificate, NOW).unwrap().identity.to_string()
}

#[test]
fn no_more_certificates_are_remembered_than_so_many() {
    let stage = Stage::new();
    let (ada, authority) = (judge(&stage), stage.authority());
    let mut shown = (0..=4096).map(|number| {
        let identity = format!("consort://ward/node/n{number}?roles=").parse().unwrap();
        let issued = authority.issue(&identity, &[], LONG).unwrap();
        let certificate = CertificateDer::from_pem_slice(issued.certificate.as_bytes()).unwrap();
        ada.add_certificate(&certificate, NOW).unwrap().fingerprint()
    });
    let first = shown.next().unwrap();
    assert!(ada.certificate(first).is_some());
    let last = shown.last().unwrap();
    assert!(ada.certificate(first).is_none() && ada.certificate(last).is_some());
}

/// A certificate of the stage's authority, with whatever names.
fn with_names(stage: &Stage, names: &[&str]) -> Vec<u8> {
    let issuer = KeyPair::from_pem(&stage.ca.key).unwrap();
    let issuer = Issuer::from_ca_cert_pem(&stage.ca.certificate, issuer).unwrap();
    let mut params = CertificateParams::default();
    params.subject_alt_names = names.iter().map(|name| SanType::URI((*name).try_into().unwrap())).collect();
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    let key = KeyPair::generate_for(&PKCS_ED25519).unwrap();
    params.signed_by(&key, &issuer).unwrap().der().to_vec()
}

#[test]
fn a_certificate_may_have_further_names_and_needs_one_of_ours() {
    let stage = Stage::new();
    let ada = judge(&stage);
    let bob = with_names(&stage, &["spiffe://ward/bob", "consort://ward/node/bob?roles=robot"]);
    assert_eq!(ada.add_certificate(&bob, NOW).unwrap().identity.to_string(), "consort://ward/node/bob?roles=robot");
    let why = ada.add_certificate(&with_names(&stage, &["spiffe://ward/bob"]), NOW).unwrap_err().to_string();
    assert!(why.contains("there is no name of the form consort://"), "{why}");
}

#[test]
fn a_persons_certificate_does_not_serve_to_be_connected_to() {
    let stage = Stage::new();
    let files_of = |who: &str, identity: &str| {
        let issued = stage.authority().issue(&identity.parse().unwrap(), &[], LONG).unwrap();
        stage.files(who, &issued)
    };
    let ada = files_of("ada", "consort://ward/node/ada?roles=robot");
    for (who, identity) in
        [("bob", "consort://ward/node/bob?roles=voter"), ("kim", "consort://ward/person/kim?scope=read")]
    {
        let files = files_of(who, identity);
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
            // Whoever does not believe it hangs up.
            while tls.is_handshaking() && tls.complete_io(&mut stream).is_ok() {}
        });
        let probed = ada.probe(address, &ward(), Duration::from_secs(20));
        serving.join().unwrap();
        match who {
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
async fn a_node_that_starts_anew_is_heard_at_once() {
    let stage = Stage::new();
    let bob = stage.node("bob", "consort://ward/node/bob?roles=robot").await;
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    for life in 1..4 {
        // With a certificate of its own each time, and with the same name.
        let ada = stage.life("ada", "consort://ward/node/ada?roles=voter", life).await;
        introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    }
    // And with the one it had: it is known, and goes on counting.
    let issued = stage.authority().issue(&"consort://ward/node/ada?roles=voter".parse().unwrap(), &[], LONG).unwrap();
    let cyd = stage.with(stage.plain("ada"), stage.files("ada", &issued), 4).await;
    introduce(&mut at_bob, &cyd, &Key::Beacon, &beacon("ada")).await;
    let again = stage.with(stage.plain("ada"), stage.files("ada", &issued), 5).await;
    for _ in 0..5 {
        say(&again, &Key::Beacon, &beacon("ada")).await;
        assert_eq!(heard(&mut at_bob).await, [beacon("ada")]);
    }
}

#[test]
fn files_that_do_not_belong_together_are_told_by_name() {
    let stage = Stage::new();
    let issue = |identity: &str, validity| {
        let identity: Identity = identity.parse().unwrap();
        stage.authority().issue(&identity, &["192.0.2.7".to_owned(), "ada.example".to_owned()], validity).unwrap()
    };
    let said = |files: &TrustFiles| files.open(&ward(), NOW, 1).err().map(|problem| problem.to_string());
    let ada = issue("consort://ward/node/ada?roles=robot", LONG);
    let good = stage.files("ada", &ada);
    assert_eq!(said(&good), None);
    let name = |file: &Path| file.display().to_string();

    let bob = stage.files("bob", &issue("consort://ward/node/bob?roles=robot", LONG));
    let mixed = TrustFiles { key: bob.key.clone(), ..good.clone() };
    let why = said(&mixed).unwrap();
    assert!(why.contains("it is not the key of") && why.contains(&name(&mixed.key)), "{why}");

    let other = Stage::new();
    let foreign =
        other.files("ca", &IssuedCertificate { certificate: other.ca.certificate.clone(), key: String::new() });
    let why = said(&TrustFiles { authority: foreign.authority.clone(), ..good.clone() }).unwrap();
    assert!(why.contains("it was not signed by this fleet's authority"), "{why}");

    let past = Validity { from: Duration::from_secs(1_600_000_000), until: NOW - Duration::from_secs(3 * 86_400) };
    let why = said(&stage.files("old", &issue("consort://ward/node/old?roles=robot", past))).unwrap();
    assert!(why.ends_with("old.pem: it expired 3 days ago"), "{why}");

    let ahead = Validity { from: NOW + Duration::from_secs(7200), until: LONG.until };
    let why = said(&stage.files("new", &issue("consort://ward/node/new?roles=robot", ahead))).unwrap();
    assert!(why.contains("valid only in 2 h: is the clock right?"), "{why}");

    let why = said(&stage.files("far", &issue("consort://lab/node/far?roles=robot", LONG))).unwrap();
    assert!(why.contains("it is for fleet lab, where this is ward"), "{why}");

    let none = TrustFiles { key: good.certificate.clone(), ..good.clone() };
    let why = said(&none).unwrap();
    assert!(why.contains("there is no private key in PKCS #8 in it"), "{why}");
    let missing = TrustFiles { certificate: stage.folder.0.join("nowhere.pem"), ..good };
    assert!(said(&missing).unwrap().contains("nowhere.pem: "), "{missing:?}");
}

/// What a person of this scope proves herself with.
fn person(stage: &Stage, scope: &str) -> Keyring {
    let identity = format!("consort://ward/person/kim?scope={scope}").parse().unwrap();
    let issued = stage.authority().issue(&identity, &[], LONG).unwrap();
    stage.files("kim", &issued).open(&ward(), NOW, 1).unwrap()
}

/// Somebody who judges by the authority alone.
fn judge(stage: &Stage) -> Keyring {
    let issued = stage.authority().issue(&"consort://ward/node/ada?roles=".parse().unwrap(), &[], LONG).unwrap();
    stage.files("ada", &issued).open(&ward(), NOW, 1).unwrap()
}

const HOUR: Duration = Duration::from_secs(3600);

#[test]
fn a_token_is_good_for_its_scope_and_time() {
    let stage = Stage::new();
    let (kim, ada) = (person(&stage, "submit"), judge(&stage));
    let token = kim.issue_token(AccessScope::Read, NOW + HOUR).unwrap();
    let visitor = ada.verify_token(&token, NOW).unwrap();
    assert_eq!((visitor.name.as_str(), visitor.scope, visitor.expires), ("kim", AccessScope::Read, NOW + HOUR));
    assert_eq!(ada.verify_token(&token, NOW + HOUR), Err(TokenError::Expired("0 s".to_owned())));
    assert!(kim.issue_token(AccessScope::Submit, NOW + HOUR).is_ok());
    assert!(matches!(kim.issue_token(AccessScope::Operate, NOW + HOUR), Err(TokenError::Scope { .. })));
    assert!(matches!(ada.issue_token(AccessScope::Read, NOW + HOUR), Err(TokenError::Node(_))));
    // The certificate's end is the token's.
    let late = kim.issue_token(AccessScope::Read, LONG.until + 2 * HOUR).unwrap();
    assert!(matches!(ada.verify_token(&late, LONG.until + HOUR), Err(TokenError::Certificate(_))));
}

#[test]
fn whatever_is_changed_of_a_token_makes_it_none() {
    let stage = Stage::new();
    let (kim, ada) = (person(&stage, "read"), judge(&stage));
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
fn a_token_that_claims_more_than_its_certificate_is_refused_though_it_is_signed() {
    use base64::Engine as _;
    use base64::engine::general_purpose::URL_SAFE_NO_PAD;
    let stage = Stage::new();
    let identity = "consort://ward/person/kim?scope=read".parse().unwrap();
    let issued = stage.authority().issue(&identity, &[], LONG).unwrap();
    let files = stage.files("kim", &issued);
    let (kim, ada) = (files.open(&ward(), NOW, 1).unwrap(), judge(&stage));
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
    let as_made = serde_json::json!({ "aud": "ward", "exp": until, "scope": "read" });
    assert!(ada.verify_token(&forged(as_made.clone()), NOW).is_ok(), "the forger signs as the keyring does");
    let mut other: serde_json::Value = serde_json::from_slice(&URL_SAFE_NO_PAD.decode(&head).unwrap()).unwrap();
    other["alg"] = "HS256".into();
    let other = forged_with(&URL_SAFE_NO_PAD.encode(other.to_string()), &as_made);
    assert_eq!(ada.verify_token(&other, NOW), Err(TokenError::Malformed("it is signed by another algorithm")));
    let more = serde_json::json!({ "aud": "ward", "exp": until, "scope": "operate" });
    let refused = ada.verify_token(&forged(more), NOW).unwrap_err();
    assert_eq!(refused.to_string(), "it claims scope operate, where kim has scope read");
    let elsewhere = serde_json::json!({ "aud": "clinic", "exp": until, "scope": "read" });
    assert_eq!(ada.verify_token(&forged(elsewhere), NOW).unwrap_err().to_string(), "it is for fleet clinic");
}
