//! Certificates: exchange, revocation, expiry, files.

use crate::fixture::*;
use bytes::Bytes;
use consort_bus::trust::issue::{IssuedCertificate, RevokedCertificate, Validity};
use consort_bus::trust::{ProbeError, TrustFiles};
use consort_bus::{Bus, Encoding, LinkModel, Query, Sample, Stream};
use consort_protocol::keys::Key;
use consort_protocol::trust::{
    ENVELOPE_BYTES, Fingerprint, Identity, MessageKind, SIGNATURE_BYTES, SignedEnvelope, encode_envelope,
};
use pki_types::pem::PemObject as _;
use pki_types::{CertificateDer, PrivatePkcs8KeyDer};
use rcgen::{CertificateParams, ExtendedKeyUsagePurpose, Issuer, KeyPair, PKCS_ED25519, SanType};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

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
    files.revoked.list =
        Some(fixture.folder.write("revoked.pem", &authority.revocation_list(&revoked, 1, LONG).unwrap()));
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
async fn a_list_of_revoked_certificates_is_not_rolled_back() {
    let fixture = Fixture::new();
    let (authority, foreign) = (fixture.authority(), Fixture::new());
    let issue = |name: &str| {
        authority.issue(&format!("consort://ward/node/{name}?roles=voter").parse().unwrap(), &[], LONG).unwrap()
    };
    let of_ada = issue("ada");
    let revoked = [RevokedCertificate { serial: serial(&of_ada.certificate), since: NOW }];
    let (earlier, later) =
        (authority.revocation_list(&[], 1, LONG).unwrap(), authority.revocation_list(&revoked, 2, LONG).unwrap());
    let mut files = fixture.files("bob", &issue("bob"));
    files.revoked.list = Some(fixture.folder.write("revoked.pem", &later));
    files.revoked.kept = Some(fixture.folder.0.join("kept.pem"));
    let ada = fixture.with(fixture.plain("ada"), fixture.files("ada", &of_ada), 1).await;
    let cyd = fixture.node("cyd", "consort://ward/node/cyd?roles=voter").await;
    let foreign_list = foreign.authority().revocation_list(&[], 3, LONG).unwrap();
    for (incarnation, list) in [(1, Some(&later)), (1, Some(&earlier)), (1, Some(&foreign_list)), (2, None)] {
        let bob = fixture.with(fixture.plain("bob"), files.clone(), incarnation).await;
        let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
        match list {
            Some(list) => drop(fixture.folder.write("revoked.pem", list)),
            None => std::fs::remove_file(fixture.folder.0.join("revoked.pem")).unwrap(),
        }
        tokio::time::sleep(Duration::from_secs(30)).await;
        introduce(&mut at_bob, &cyd, &Key::Beacon, &beacon("cyd")).await;
        publish(&ada, &Key::Beacon, &beacon("ada")).await;
        assert_eq!(received(&mut at_bob).await, [] as [Bytes; 0], "{incarnation} {list:?}");
        // The next start finds the file that was written during this start.
        if list == Some(&foreign_list) {
            let problem = files.open(&ward(), NOW, 1).err().map(|problem| problem.to_string()).unwrap();
            assert!(problem.contains("revoked.pem: "), "{problem}");
            fixture.folder.write("revoked.pem", &earlier);
        }
    }
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
    files.revoked.list = Some(fixture.folder.write("revoked.pem", &list(&[], 1)));
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

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_certificate_reaches_nodes_without_a_path_to_its_principal() {
    let fixture = Fixture::new();
    let ada = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
    let bob = fixture.node("bob", "consort://ward/node/bob?roles=voter").await;
    let cyd = fixture.node("cyd", "consort://ward/node/cyd?roles=voter").await;
    for (from, to) in [("ada", "cyd"), ("cyd", "ada")] {
        fixture.network.cut(node(from), node(to));
    }
    let relay = fixture.plain("bob");
    let mut at_bob = bob.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    introduce(&mut at_bob, &ada, &Key::Beacon, &beacon("ada")).await;
    let mut unopened = relay.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    let mut at_cyd = cyd.subscribe(&keys().write(&Key::Beacon)).await.unwrap();
    // Bob passes on what ada signs.
    for _ in 0..10 {
        publish(&ada, &Key::Beacon, &beacon("ada")).await;
        let signed = unopened.recv().await.unwrap().payload;
        publish(&*relay, &Key::Beacon, &signed).await;
        if received(&mut at_cyd).await == [beacon("ada")] {
            return;
        }
    }
    panic!("cyd never got the certificate of ada");
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
