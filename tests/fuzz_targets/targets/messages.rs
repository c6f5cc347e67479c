//! Messages between nodes.

use super::frames::frames;
use consort_fleet::fuzz_api;
use consort_fleet::robot_driver::{DriverCommand, DriverState, PersonCommand, PersonEvent, PersonRequestState};
use consort_gossip::{GossipHarness, GossipInput as How};
use consort_protocol::auction::{
    AuctionContext, BidLimits, BidResponse, CallForBids, Invitation, RoleReply, Timelines, clear_auction, explain,
};
use consort_protocol::codec::{self, MESSAGE_BYTES_MAX, VersionedMessage};
use consort_protocol::ensemble::MemberValues;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::RaftCall;
use consort_protocol::knowledge::MotionUpdate;
use consort_protocol::ledger::{Command, CommandOutcome, Ledger, Submission};
use consort_protocol::message::{
    AwardNotice, AwardReply, Beacon, BootstrapReply, BootstrapRequest, ClusterEnvelope, Exchange, FollowedLeader,
    RecordUpdate, Report, ReportReply, SignalHistory,
};
use consort_protocol::plan::LocalPlan;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;
use std::time::Duration;

/// A decoded message can be encoded, and the encoding decodes to the same message.
pub(super) fn assert_round_trip<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let message: T = codec::decode(bytes).ok()?;
    let once = codec::encode(&message).expect("what was read can be sent");
    let again: T = codec::decode(&once).expect("what was written can be read");
    assert_eq!(codec::encode(&again).expect("the same"), once, "it reads back as something else");
    Some(message)
}

/// Same, for messages with two layouts.
fn evolves<T: VersionedMessage + Clone>(bytes: &[u8]) -> bool {
    let Ok(message) = codec::decode_any_version::<T>(bytes) else { return false };
    for wire in [codec::FIRST_VERSION, T::SINCE] {
        let Ok(once) = codec::encode_for_version(wire, message.clone()) else {
            assert_eq!(wire, T::SINCE, "what was read can be sent as it came");
            continue;
        };
        let again: T = codec::decode_any_version(&once).expect("what was written can be read");
        assert_eq!(codec::encode_for_version(wire, again).expect("the same"), once, "it reads back as something else");
    }
    true
}

pub(super) fn wire(bytes: &[u8]) -> bool {
    let mut read = 0;
    macro_rules! each {
        ($($kind:ty),*) => {$(read += u32::from(assert_round_trip::<$kind>(bytes).is_some());)*};
    }
    each!(
        AwardNotice,
        AwardReply,
        Report,
        ReportReply,
        Command,
        CommandOutcome,
        Submission,
        Ledger,
        SignalHistory,
        MemberValues,
        MotionUpdate,
        Beacon,
        BootstrapRequest,
        BootstrapReply,
        FollowedLeader,
        DriverCommand,
        DriverState,
        PersonCommand,
        PersonRequestState,
        PersonEvent
    );
    read += u32::from(evolves::<Exchange>(bytes)) + u32::from(evolves::<RecordUpdate>(bytes));
    if let Some(within) = assert_round_trip::<ClusterEnvelope>(bytes) {
        read += 1;
        assert_round_trip::<Beacon>(&within.payload);
    }
    let (call, tender) = (assert_round_trip::<CallForBids>(bytes), assert_round_trip::<BidResponse>(bytes));
    read += u32::from(call.is_some()) + u32::from(tender.is_some());
    auction(call, tender);
    read > 0
}

/// An auction ends with any responses, and assigns roles only to robots with a bid for them.
fn auction(call: Option<CallForBids>, tender: Option<BidResponse>) {
    let Some(tender) = tender else { return };
    let requested = tender.replies.iter().filter_map(|answer| match answer {
        RoleReply::Bid(bid) => Some(bid.role.clone()),
        RoleReply::Refusal(_) => None,
    });
    let roles = call.map(|call| call.roles).unwrap_or_default();
    let roles = requested.map(|role| (role.clone(), LocalPlan::of(role, vec![]))).chain(roles).collect();
    let call = CallForBids {
        auction: tender.auction.clone(),
        ensembles: vec![],
        roles,
        eligible: BTreeMap::new(),
        spread: BTreeSet::new(),
        timelines: Timelines::default(),
    };
    let robots = BTreeSet::from([tender.robot.clone()]);
    let (limits, invitation) = (BidLimits::default(), Invitation { robots, preferred: vec![] });
    let circumstances = AuctionContext {
        energy: None,
        invitation: &invitation,
        unavailable: &BTreeMap::new(),
        excluded: &BTreeMap::new(),
        limits: &limits,
        promises: None,
        window_ms: 200,
        at_ms: 0,
    };
    let conclusion = clear_auction(&call, &[tender], &circumstances);
    let holders = conclusion.holders.iter().flatten();
    assert!(
        holders.clone().all(|(_, robot)| invitation.robots.contains(robot)),
        "a role was assigned to a robot without a bid"
    );
    explain(&conclusion.record);
}

/// Input from other nodes leads to messages within the size limit, and the node continues.
pub(super) fn gossip(bytes: &[u8]) -> bool {
    let name = |name: &str| NodeId::new(name).expect("a slug");
    let mut ada = GossipHarness::new(FleetId::new("ward").expect("a slug"), name("ada"));
    let mut accepted = 0;
    for (kind, piece) in frames(bytes).take(60) {
        let messages = match kind % 8 {
            0 => ada.receive(How::Published(name("bob")), piece),
            1 => ada.receive(How::Published(name("ada")), piece),
            2 => ada.receive(How::Packet, piece),
            3 => ada.receive(How::Request, piece),
            6 => ada.receive(How::Motion(name("bob")), piece),
            4..=5 => ada.receive(How::Reply(u64::from(kind / 8)), piece),
            _ => ada.advance(Duration::from_millis(40 * u64::from(kind))),
        };
        match messages {
            Ok(messages) => {
                accepted += 1;
                assert!(
                    messages.iter().all(|message| message.len() <= MESSAGE_BYTES_MAX),
                    "a message exceeds the size limit"
                );
            }
            Err(problem) => assert!(!problem.to_string().is_empty()),
        }
    }
    ada.advance(Duration::from_secs(90)).expect("it goes on");
    assert!(ada.known_nodes() >= 1, "it has forgotten itself");
    accepted > 0
}

fn read_twice<P: Debug>(bytes: &[u8], read: impl Fn(&[u8]) -> Result<Vec<u8>, P>) -> bool {
    let Ok(once) = read(bytes) else { return false };
    assert_eq!(read(&once).expect("what was written can be read"), once, "it reads back as something else");
    true
}

pub(super) fn raft(bytes: &[u8]) -> bool {
    let mut read = read_twice(bytes, fuzz_api::log_entry::<Ledger>);
    read |= read_twice(bytes, fuzz_api::snapshot::<Ledger>);
    for call in RaftCall::ALL {
        read |= read_twice(bytes, |bytes| fuzz_api::raft_request::<Ledger>(*call, bytes));
        read |= read_twice(bytes, |bytes| fuzz_api::raft_response(*call, bytes));
    }
    read
}
