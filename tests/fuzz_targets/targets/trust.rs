//! Names, certificates and signed envelopes.

use super::frames::{frames, text};
use super::scratch;
use consort_bus::trust::{Keyring, RevokedFiles};
use consort_nodes::certs::{CertificateEntry, CertificateStore, unix_time};
use consort_nodes::config::trust_files;
use consort_protocol::access::{Operation, authorize};
use consort_protocol::ids::{FleetId, MissionId, NodeId, PlaceId, RobotId, RoleId, TaskType};
use consort_protocol::keys::Keys;
use consort_protocol::trust::{
    Fingerprint, Identity, MessageKind, decode_envelope, decode_requester, encode_envelope, encode_requester,
};
use std::fmt::{Debug, Display};
use std::str::FromStr;
use std::sync::OnceLock;

fn spelled_alike<T: FromStr<Err: Debug> + Display + PartialEq + Debug>(text: &str) -> bool {
    let Ok(read) = text.parse::<T>() else { return false };
    assert_eq!(read.to_string().parse::<T>().expect("what was written can be read"), read);
    true
}

pub(super) fn names(bytes: &[u8]) -> bool {
    let Some(text) = text(bytes) else { return false };
    let mut read = spelled_alike::<Identity>(text);
    read |= spelled_alike::<Fingerprint>(text);
    spelled_alike::<NodeId>(text);
    spelled_alike::<RobotId>(text);
    spelled_alike::<RoleId>(text);
    spelled_alike::<MissionId>(text);
    spelled_alike::<TaskType>(text);
    read |= spelled_alike::<PlaceId>(text);
    let keys = Keys::new(&FleetId::new("ward").expect("a slug"));
    if let Some(key) = keys.read(text) {
        let written = keys.write(&key);
        assert_eq!(keys.read(&written), Some(key), "{written} is another key");
        read = true;
    }
    keys.is_cluster_scoped(text);
    read
}

/// Frames: the identity, the key and the payload; the kind of the first frame selects the
/// operation.
pub(super) fn signed_envelope(bytes: &[u8]) -> bool {
    let mut read = false;
    let reply = MessageKind::Reply(Fingerprint([3; 16]), 9);
    for kind in [MessageKind::Publication, MessageKind::Query, reply, reply.as_refusal()] {
        if let Ok(envelope) = decode_envelope(kind, bytes) {
            assert_eq!(encode_envelope(kind, envelope), bytes, "the envelope encodes differently");
            read = true;
        }
    }
    if let Some(MessageKind::Reply(by, number)) = decode_requester(bytes) {
        assert!(bytes.starts_with(&encode_requester(by, number)), "the requester encodes differently");
        read = true;
    }
    let pieces: Vec<(u8, &[u8])> = frames(bytes).take(3).collect();
    let [(act, who), (_, key), (_, payload)] = pieces[..] else { return read };
    let Some(who) = text(who).and_then(|who| who.parse::<Identity>().ok()) else { return read };
    let act = [Operation::Publish, Operation::Query, Operation::Reply, Operation::Refuse][usize::from(act) % 4];
    let key = String::from_utf8_lossy(key);
    match authorize(&who, act, &key, payload) {
        Ok(()) => true,
        Err(denied) => {
            assert!(denied.to_string().contains(&*key), "{denied}");
            read
        }
    }
}

struct Fleet {
    keyring: Keyring,
    issued: Vec<u8>,
    pem: String,
}

/// Returns a fleet with an authority and the certificate of one of its nodes.
fn fleet() -> &'static Fleet {
    static FLEET: OnceLock<Fleet> = OnceLock::new();
    FLEET.get_or_init(|| {
        let folder = scratch::folder().join("certs");
        let fleet = FleetId::new("ward").expect("a slug");
        CertificateStore::create_authority(&folder, &fleet, 30).expect("an authority");
        let certs = CertificateStore::open(&folder).expect("the same");
        let issue = |who: &str| {
            let to: Identity = format!("consort://ward/node/{who}?roles=robot,voter").parse().expect("an identity");
            trust_files(&certs.issue(&to, &["127.0.0.1".to_owned()], 30, false).expect("a certificate"))
        };
        let keyring = issue("ada").open(&fleet, unix_time(), 1).expect("a keyring");
        let pem = std::fs::read_to_string(issue("bob").certificate).expect("a file");
        let issued = der(&pem);
        Fleet { keyring, issued, pem }
    })
}

fn der(pem: &str) -> Vec<u8> {
    use pki_types::CertificateDer;
    use pki_types::pem::PemObject as _;
    CertificateDer::from_pem_slice(pem.as_bytes()).expect("a certificate").to_vec()
}

/// After a zero byte, the input contains edits of an issued certificate; otherwise it is a
/// certificate. Only the issued certificate is accepted.
pub(super) fn certificate(bytes: &[u8]) -> bool {
    let Fleet { keyring, issued, .. } = fleet();
    let shown = match bytes.split_first() {
        Some((0, edits)) => edited(issued, edits),
        _ => bytes.to_vec(),
    };
    let admitted = keyring.add_certificate(&shown, unix_time());
    let believed = admitted.is_ok();
    match admitted {
        Ok(card) => assert!(shown == *issued, "another certificate of {} is accepted", card.identity),
        Err(problem) => assert!(shown != *issued, "the issued certificate is rejected: {problem}"),
    }
    believed
}

/// Same for certificates in files.
pub(super) fn pem(bytes: &[u8]) -> bool {
    let shown = match bytes.split_first() {
        Some((0, edits)) => edited(fleet().pem.as_bytes(), edits),
        _ => bytes.to_vec(),
    };
    let file = scratch::file("cert.pem", &shown);
    let read = match CertificateEntry::read(&file, &[]) {
        Ok(holder) => spelled_alike::<Identity>(&holder.identity.to_string()),
        Err(problem) => {
            assert!(problem.to_string().contains("cert.pem"), "{problem}");
            false
        }
    };
    let named = |problem: &dyn Display| assert!(problem.to_string().contains("cert.pem"), "{problem}");
    let files = consort_bus::trust::TrustFiles {
        authority: file.clone(),
        certificate: file.clone(),
        key: file.clone(),
        revoked: RevokedFiles { list: Some(file), kept: None },
    };
    match files.open(&FleetId::new("ward").expect("a slug"), unix_time(), 1) {
        Ok(_) => panic!("the same file was accepted as authority, certificate, key and revocation list"),
        Err(problem) => named(&problem),
    }
    read
}

fn edited(text: &[u8], edits: &[u8]) -> Vec<u8> {
    let mut text = text.to_vec();
    for (kind, piece) in frames(edits) {
        let Some((place, bytes)) = piece.split_first_chunk::<2>() else { continue };
        let place = usize::from(u16::from_le_bytes(*place)) % (text.len() + 1);
        match kind % 3 {
            0 => text.truncate(place),
            1 => text.iter_mut().skip(place).zip(bytes).for_each(|(byte, new)| *byte = *new),
            _ => drop(text.splice(place..place, bytes.iter().copied())),
        }
    }
    text
}
