//! Cost of signing: messages of usual sizes are signed and verified, compared with encoding and
//! decoding them.
//!
//! ```text
//! cargo bench -p consort --bench signing
//! ```
//!
//! A signature is an Ed25519 signature. Apart from the hash of the message, it takes the same time
//! for small and large messages. Verification is the work of `SigningBus` for a received message:
//! signature, permission of the signer, and replay check. Each figure is the minimum of many
//! rounds. The ratio to encoding and decoding the same message in the same round is reported as
//! well: it depends less on other load of the machine.

#[path = "support/figures.rs"]
#[expect(dead_code, reason = "other benchmarks measure durations between instants")]
mod support;

use consort_protocol::access::{Operation, authorize};
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys, RaftCall};
use consort_protocol::knowledge::{Availability, Knowledge, Record, RecordStamp, RobotKnowledge};
use consort_protocol::ledger::Command;
use consort_protocol::message::{Beacon, ClusterEnvelope, RecordUpdate};
use consort_protocol::trust::{ENVELOPE_BYTES, MessageKind, NodeRole, ReplayWindow, decode_envelope, signed_part};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_protocol::versions::VersionRange;
use consort_tests::{Credentials, Signatures};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::process::ExitCode;
use std::time::{Duration, Instant};

const ROUNDS: usize = 200;
const CALLS_PER_ROUND: u32 = 50;

fn main() -> ExitCode {
    support::main("signing", async { Ok(measure()) })
}

fn name<T: std::str::FromStr<Err: std::fmt::Debug>>(text: &str) -> T {
    text.parse().expect("a name")
}

fn measure() -> Value {
    let node: NodeId = name("ada");
    let voters = ["ada", "aster", "basil", "clove", "fern"].map(name).into();
    let beacon = Beacon { node: node.clone(), term: 7, voters, since_ms: 100_000, cluster: None, wire: Some(2) };
    let beacon = ClusterEnvelope { cluster: None, payload: codec::encode(&beacon).expect("a message") };
    let worker = RobotKnowledge {
        skills: ["navigation", "approach_person", "authenticate_person", "operate_drawer"].map(name).into(),
        attributes: Default::default(),
        pose: Default::default(),
        place: name("IC Room 6"),
        battery: BatteryShare::new(0.8).expect("a share"),
        discharge: SharePerSecond::new(0.0004).expect("a rate"),
        useful_charge: BatteryShare::new(0.08).expect("a share"),
        speed: MetresPerSecond::new(0.6).ok(),
        availability: Availability::Free,
        estimator: "1".to_owned(),
        charging: None,
    };
    let knowledge = Knowledge { replica: Some(1), ..Knowledge::of(Some(worker)) };
    let stamp = RecordStamp { incarnation: 1_800_000_000_000, version: 9 };
    let statement = RecordUpdate::Record(Record { owner: node.clone(), stamp, knowledge, proof: None });
    // Entries as in an append message: each with its position in the log.
    let entries = |count: u64| -> Vec<(u64, u64, Command)> {
        let progress = || Command::Progress {
            mission: name("lab-samples-1"),
            role: name("r1"),
            epoch: Default::default(),
            branch: Default::default(),
            ended: (0..4).collect(),
            outcomes: Default::default(),
        };
        (0..count).map(|index| (7, index, progress())).collect()
    };
    let append = Key::Raft(1, RaftCall::Append);
    json!({
        "beacon": costs(&Key::Beacon, Operation::Publish, &beacon, encode_message, decode_message::<ClusterEnvelope>),
        "statement": costs(&Key::Knowledge(node), Operation::Publish, &statement, encode_statement, decode_statement),
        "append_of_1": costs(&append, Operation::Query, &entries(1), encode_message, decode_message::<Vec<(u64, u64, Command)>>),
        "append_of_64": costs(&append, Operation::Query, &entries(64), encode_message, decode_message::<Vec<(u64, u64, Command)>>),
    })
}

/// Returns the least mean duration of a call, in microseconds.
fn least_us(mut work: impl FnMut()) -> f64 {
    let round = |work: &mut dyn FnMut()| {
        let began = Instant::now();
        (0..CALLS_PER_ROUND).for_each(|_| work());
        began.elapsed() / CALLS_PER_ROUND
    };
    let least = (0..ROUNDS).map(|_| round(&mut work)).min().unwrap_or(Duration::ZERO);
    (least.as_nanos() as f64 / 10.0).round() / 100.0
}

fn encode_message<T: Serialize>(message: &T) -> Vec<u8> {
    codec::encode(message).expect("a message")
}

fn decode_message<T: DeserializeOwned>(bytes: &[u8]) {
    std::hint::black_box(codec::decode::<T>(bytes).expect("a message"));
}

fn encode_statement(statement: &RecordUpdate) -> Vec<u8> {
    codec::encode_for_version(VersionRange::OWN.newest, statement.clone()).expect("a message")
}

fn decode_statement(bytes: &[u8]) {
    std::hint::black_box(codec::decode_any_version::<RecordUpdate>(bytes).expect("a message"));
}

fn costs<T>(
    key: &Key,
    operation: Operation,
    message: &T,
    write: impl Fn(&T) -> Vec<u8>,
    decode_message: impl Fn(&[u8]),
) -> Value {
    let credentials = Credentials::new(name("ward"), 1, Signatures::Ed25519);
    let ada = credentials.keyring_of(&name("ada"), [NodeRole::Robot, NodeRole::Voter].into(), 1);
    let keys = Keys::new(&name("ward"));
    let key = keys.write(key);
    let suffix = keys.strip_fleet(&key).expect("a key of the fleet's").to_owned();
    let kind = if operation == Operation::Publish { MessageKind::Publication } else { MessageKind::Query };
    let payload = write(message);
    let certificate = ada.certificate(ada.fingerprint()).expect("the own certificate");
    let sign = || ada.sign_envelope(kind, ada.next_number(), &key, &payload);
    let sign_us = least_us(|| {
        std::hint::black_box(sign());
    });
    let signed_message = sign();
    let verify_us = least_us(|| {
        let envelope = decode_envelope(kind, &signed_message).expect("a signed envelope");
        let signed = signed_part(kind, envelope.signer, envelope.number, &key, envelope.payload);
        assert!(certificate.verify(&signed, envelope.signature));
        authorize(&certificate.identity, operation, &suffix, envelope.payload).expect("ada is authorized");
        std::hint::black_box(ReplayWindow::default().accept(envelope.number));
    });
    let encode_and_decode_us = least_us(|| {
        decode_message(&write(message));
    });
    let ratio = |part: f64| (part / encode_and_decode_us * 10.0).round() / 10.0;
    json!({
        "bytes": payload.len(), "signed_bytes": payload.len() + ENVELOPE_BYTES,
        "encode_and_decode_us": encode_and_decode_us, "sign_us": sign_us, "verify_us": verify_us,
        "sign_ratio": ratio(sign_us), "verify_ratio": ratio(verify_us),
    })
}
