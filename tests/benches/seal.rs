//! What seals cost: messages of usual sizes sealed and opened, beside what it takes to write and read them.
//!
//! ```text
//! cargo bench -p consort-tests --bench seal
//! ```
//!
//! A seal is an Ed25519 signature, which takes as long for a small message as for a large one but for the hash of it. Opening is what
//! `SealedBus` does with what it hears: signature, right to say it, and whether it was heard before. Each figure is the least of many
//! rounds, and a ratio to writing and reading the same message in the same round is beside it: what else the machine does matters less so.

#[path = "support/figures.rs"]
#[expect(dead_code, reason = "others measure spans between instants")]
mod support;

use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys, RaftCall};
use consort_protocol::knowledge::{Availability, Knowledge, Record, RecordStamp, RobotKnowledge};
use consort_protocol::ledger::Command;
use consort_protocol::message::{Beacon, ClusterEnvelope, RecordUpdate};
use consort_protocol::trust::{
    ENVELOPE_BYTES, MessageKind, NodeRole, Operation, ReplayWindow, authorize, decode_envelope, signed_part,
};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_protocol::versions::VersionRange;
use consort_tests::Credentials;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::process::ExitCode;
use std::time::{Duration, Instant};

const ROUNDS: usize = 200;
const OF_EACH: u32 = 50;

fn main() -> ExitCode {
    support::main("seal", async { Ok(measure()) })
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
        pose: Default::default(),
        place: name("IC Room 6"),
        battery: BatteryShare::new(0.8).expect("a share"),
        discharge: SharePerSecond::new(0.0004).expect("a rate"),
        useful_charge: BatteryShare::new(0.08).expect("a share"),
        speed: MetresPerSecond::new(0.6).ok(),
        availability: Availability::Free,
        estimator: "1".to_owned(),
    };
    let knowledge = Knowledge {
        may_vote: true,
        stationary: false,
        mains_powered: false,
        replica: Some(1),
        cluster: None,
        leaving: false,
        supported_versions: VersionRange::OWN,
        robot: Some(worker),
    };
    let stamp = RecordStamp { incarnation: 1_800_000_000_000, version: 9 };
    let statement = RecordUpdate::Record(Record { owner: node.clone(), stamp, knowledge, proof: None });
    // Entries as an append has them: each with its place in the log.
    let entries = |count: u64| -> Vec<(u64, u64, Command)> {
        let progress = || Command::Progress {
            mission: name("lab-samples-1"),
            role: name("r1"),
            epoch: Default::default(),
            branch: Default::default(),
            ended: (0..4).collect(),
        };
        (0..count).map(|index| (7, index, progress())).collect()
    };
    let append = Key::Raft(1, RaftCall::Append);
    json!({
        "beacon": costs(&Key::Beacon, Operation::Publish, &beacon, written, read::<ClusterEnvelope>),
        "statement": costs(&Key::Knowledge(node), Operation::Publish, &statement, stated, understood),
        "append_of_1": costs(&append, Operation::Query, &entries(1), written, read::<Vec<(u64, u64, Command)>>),
        "append_of_64": costs(&append, Operation::Query, &entries(64), written, read::<Vec<(u64, u64, Command)>>),
    })
}

/// The least time that each of many takes, in microseconds.
fn least_us(mut work: impl FnMut()) -> f64 {
    let round = |work: &mut dyn FnMut()| {
        let began = Instant::now();
        (0..OF_EACH).for_each(|_| work());
        began.elapsed() / OF_EACH
    };
    let least = (0..ROUNDS).map(|_| round(&mut work)).min().unwrap_or(Duration::ZERO);
    (least.as_nanos() as f64 / 10.0).round() / 100.0
}

fn written<T: Serialize>(message: &T) -> Vec<u8> {
    codec::encode(message).expect("a message")
}

fn read<T: DeserializeOwned>(bytes: &[u8]) {
    std::hint::black_box(codec::decode::<T>(bytes).expect("a message"));
}

fn stated(statement: &RecordUpdate) -> Vec<u8> {
    codec::encode_for_version(VersionRange::OWN.newest, statement.clone()).expect("a message")
}

fn understood(bytes: &[u8]) {
    std::hint::black_box(codec::decode_any_version::<RecordUpdate>(bytes).expect("a message"));
}

fn costs<T>(key: &Key, act: Operation, message: &T, write: impl Fn(&T) -> Vec<u8>, read: impl Fn(&[u8])) -> Value {
    let papers = Credentials::new(name("ward"), 1);
    let ada = papers.keyring_of(&name("ada"), [NodeRole::Robot, NodeRole::Voter].into(), 1);
    let keys = Keys::new(&name("ward"));
    let key = keys.write(key);
    let below = keys.strip_fleet(&key).expect("a key of the fleet's").to_owned();
    let kind = if act == Operation::Publish { MessageKind::Publication } else { MessageKind::Query };
    let payload = write(message);
    let card = ada.certificate(ada.fingerprint()).expect("its own");
    let seal = || ada.sign_envelope(kind, ada.next_number(), &key, &payload);
    let sealing = least_us(|| {
        std::hint::black_box(seal());
    });
    let sealed = seal();
    let opening = least_us(|| {
        let heard = decode_envelope(kind, &sealed).expect("a seal");
        let signed = signed_part(kind, heard.signer, heard.number, &key, heard.payload);
        assert!(card.verify(&signed, heard.signature));
        authorize(&card.identity, act, &below, heard.payload).expect("ada may");
        std::hint::black_box(ReplayWindow::default().accept(heard.number));
    });
    let plain = least_us(|| {
        read(&write(message));
    });
    let ratio = |part: f64| (part / plain * 10.0).round() / 10.0;
    json!({
        "bytes": payload.len(), "sealed": payload.len() + ENVELOPE_BYTES,
        "write_and_read_us": plain, "seal_us": sealing, "open_us": opening,
        "seal_ratio": ratio(sealing), "open_ratio": ratio(opening),
    })
}
