//! Every message survives encoding and decoding, and no bytes cause a panic.

mod ledger_values;
mod message_values;
mod values;

use consort_protocol::auction::{BidRefusal, BidResponse, CallForBids, RoleReply};
use consort_protocol::codec::{
    CodecError, MESSAGE_BYTES_MAX, VersionedMessage, decode, decode_any_version, encode, encode_for_version,
};
use consort_protocol::ensemble::MemberValues;
use consort_protocol::ids::{ClusterId, MissionId, NodeId, RobotId, RoleId};
use consort_protocol::knowledge::{Digest, DigestScope, Motion, MotionUpdate, Record};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, CommandOutcome, Ledger};
use consort_protocol::message::{
    AwardNotice, AwardReply, Beacon, BootstrapReply, BootstrapRequest, ClusterEnvelope, Exchange, FollowedLeader,
    RecordUpdate, Report, ReportReply, SignalHistory,
};
use ledger_values::*;
use message_values::*;
use proptest::collection::{btree_map, btree_set, vec};
use proptest::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Debug;
use values::*;

fn assert_round_trip<T: Serialize + DeserializeOwned + PartialEq + Debug>(message: &T) -> Result<(), TestCaseError> {
    let bytes = encode(message).expect("a small message");
    prop_assert_eq!(&decode::<T>(&bytes).expect("what was encoded"), message);
    // A truncated message is never decoded.
    prop_assert!(decode::<T>(&bytes[..bytes.len() - 1]).is_err());
    Ok(())
}

/// Checks the same for a message with a changed layout: encoded for an earlier version it loses
/// only the fields that the version lacks.
fn assert_versions<T: VersionedMessage + PartialEq + Debug + Clone>(
    message: &T,
    before: &T,
) -> Result<(), TestCaseError> {
    for (wire, expected) in [(1, before), (2, message), (3, message)] {
        let bytes = encode_for_version(wire, message.clone()).expect("a small message");
        let layout = if wire == 1 { 1 } else { T::SINCE };
        prop_assert_eq!(bytes[0], layout);
        prop_assert_eq!(&decode_any_version::<T>(&bytes).expect("what was encoded"), expected);
        prop_assert!(decode_any_version::<T>(&bytes[..bytes.len() - 1]).is_err());
    }
    let mut later = encode_for_version(T::SINCE, message.clone()).expect("a small message");
    later[0] += 1;
    let refused = matches!(decode_any_version::<T>(&later), Err(CodecError::Version { .. }));
    prop_assert!(refused);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn knowledge_survives(record in record(), digest in btree_map(name::<NodeId>(), stamp(), 0..5)) {
        let digest: Digest = digest;
        let without = Record { proof: None, ..record.clone() };
        let sums = vec![record.stamp.incarnation; 3];
        let scope = DigestScope::of_difference(&sums, &[record.stamp.version; 3]);
        let still = |proof| RecordUpdate::Refresh { stamp: record.stamp, since: record.stamp.version, proof };
        assert_versions(&still(record.proof), &still(None))?;
        assert_versions(&RecordUpdate::Record(record.clone()), &RecordUpdate::Record(without.clone()))?;
        let exchange = |record| Exchange { sums: sums.clone(), scope, digest: digest.clone(), records: vec![record] };
        assert_versions(&exchange(record.clone()), &exchange(without))?;
        let motion = record.knowledge.robot.as_ref().map(Motion::of);
        assert_round_trip(&MotionUpdate { stamp: record.stamp, number: record.stamp.version, motion })?;
    }

    #[test]
    fn auctions_survive(
        auction in auction(), roles in btree_map(name(), plan(), 0..3), ensembles in vec(name(), 0..3), bid in bid(),
        eligible in btree_map(name(), text(), 0..3), spread in btree_set(name(), 0..3), timelines in timelines(),
        robot in name::<RobotId>(), role in name::<RoleId>(), reason in reason()
    ) {
        assert_round_trip(&CallForBids { auction: auction.clone(), ensembles, roles, eligible, spread, timelines })?;
        let refusal = BidRefusal { robot: robot.clone(), role, reason };
        assert_round_trip(&BidResponse { robot, auction, replies: vec![RoleReply::Bid(bid), RoleReply::Refusal(refusal)] })?;
    }

    #[test]
    fn award_messages_survive(
        notice in notice(), award_answer in award_answer(), report in report(), report_answer in report_answer()
    ) {
        assert_round_trip(&notice)?;
        assert_round_trip(&award_answer)?;
        assert_round_trip(&report)?;
        assert_round_trip(&report_answer)?;
    }

    #[test]
    fn ledger_commands_survive(commands in vec(command(), 1..6), outcome in outcome()) {
        let mut ledger = Ledger::default();
        for (index, command) in (1..).zip(commands) {
            assert_round_trip(&command)?;
            assert_round_trip(&ledger.apply(Epoch { term: 1, index }, command))?;
        }
        assert_round_trip(&ledger)?;
        assert_round_trip(&outcome)?;
    }

    #[test]
    fn messages_of_roles_and_coordinators_survive(
        mission in name::<MissionId>(), epoch in epoch(), signals in btree_set(signal(), 0..4), node in name::<NodeId>(),
        term in any::<u64>(), voters in btree_set(name::<NodeId>(), 0..4), values in btree_map(text(), scalar(), 0..4)
    ) {
        assert_round_trip(&ClusterEnvelope { cluster: Some(ClusterId(term)), payload: vec![1, 2, 3] })?;
        assert_round_trip(&SignalHistory { mission: mission.clone(), epoch, signals: signals.clone() })?;
        assert_round_trip(&MemberValues { attributes: values.clone(), readings: values })?;
        assert_round_trip(&Beacon { node: node.clone(), term, voters, since_ms: term, cluster: (term % 2 == 0).then_some(ClusterId(term)), wire: (term % 3 == 0).then_some(2) })?;
        let founder = BootstrapRequest { mobile: term % 2 == 0, on_battery: term % 3 == 0, node: node.clone() };
        assert_round_trip(&BootstrapReply::Refused { reason: founder.node.to_string() })?;
        assert_round_trip(&founder)?;
        assert_round_trip(&Some(FollowedLeader { node, term }))?;
    }

    #[test]
    fn arbitrary_bytes_cause_no_panic(bytes in vec(any::<u8>(), 0..300), versioned in any::<bool>()) {
        let mut bytes = bytes;
        if versioned && !bytes.is_empty() {
            bytes[0] = 1;
        }
        // Undecodable bytes give an error; a decoded message encodes again.
        let _ = decode_any_version::<Exchange>(&bytes);
        let _ = decode_any_version::<RecordUpdate>(&bytes);
        assert_harmless::<MotionUpdate>(&bytes);
        assert_harmless::<CallForBids>(&bytes);
        assert_harmless::<BidResponse>(&bytes);
        assert_harmless::<AwardNotice>(&bytes);
        assert_harmless::<AwardReply>(&bytes);
        assert_harmless::<Report>(&bytes);
        assert_harmless::<ReportReply>(&bytes);
        assert_harmless::<Command>(&bytes);
        assert_harmless::<CommandOutcome>(&bytes);
        assert_harmless::<Ledger>(&bytes);
        assert_harmless::<SignalHistory>(&bytes);
        assert_harmless::<MemberValues>(&bytes);
        assert_harmless::<Beacon>(&bytes);
        assert_harmless::<BootstrapRequest>(&bytes);
        assert_harmless::<BootstrapReply>(&bytes);
        assert_harmless::<Option<FollowedLeader>>(&bytes);
    }

    #[test]
    fn a_flipped_bit_causes_no_panic(command in command(), at in any::<prop::sample::Index>(), bit in 0u8..8) {
        let mut bytes = encode(&command).expect("a small message");
        let at = at.index(bytes.len());
        bytes[at] ^= 1 << bit;
        assert_harmless::<Command>(&bytes);
        assert_harmless::<BidResponse>(&bytes);
    }
}

fn assert_harmless<T: Serialize + DeserializeOwned>(bytes: &[u8]) {
    if let Ok(message) = decode::<T>(bytes) {
        assert!(encode(&message).is_ok_and(|again| again.len() <= MESSAGE_BYTES_MAX));
    }
}

#[test]
fn a_false_length_is_rejected_before_memory_is_allocated() {
    // A set of 2^62 steps, in an otherwise valid beginning of a report.
    for false_length in [u64::MAX, 1 << 62, 1 << 40, 1 << 20] {
        let mut bytes = vec![1, 253];
        bytes.extend(false_length.to_le_bytes());
        bytes.extend([0; 64]);
        assert!(decode::<Vec<u64>>(&bytes).is_err());
        assert!(decode::<String>(&bytes).is_err());
        assert!(decode::<Report>(&bytes).is_err());
    }
}
