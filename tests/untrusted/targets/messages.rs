//! What nodes say to one another.

use super::frames::frames;
use consort_actors::body::{BodyCommand, BodyState, PeopleAsk, PersonState, PersonWord};
use consort_actors::gossip::{Listener, Said as How};
use consort_actors::untrusted;
use consort_protocol::auction::{Answer, CallForBids, Circumstances, Limits, Tender, conclude, explain};
use consort_protocol::codec::{self, Evolved, LIMIT};
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::RaftCall;
use consort_protocol::ledger::{Command, Ledger, Outcome, Submission};
use consort_protocol::message::{
    AwardAnswer, AwardNotice, Beacon, Changed, Exchange, Founder, FoundingAnswer, Live, Report, ReportAnswer, Said,
    Statement, Within,
};
use consort_protocol::plan::LocalPlan;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;
use std::time::Duration;

/// What can be read can be written, and what is written reads back the same.
pub(super) fn survives<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let message: T = codec::decode(bytes).ok()?;
    let once = codec::encode(&message).expect("what was read can be sent");
    let again: T = codec::decode(&once).expect("what was written can be read");
    assert_eq!(codec::encode(&again).expect("the same"), once, "it reads back as something else");
    Some(message)
}

/// The same of what has two layouts.
fn evolves<T: Evolved + Clone>(bytes: &[u8]) -> bool {
    let Ok(message) = codec::decode_any::<T>(bytes) else { return false };
    for wire in [codec::FIRST, T::SINCE] {
        let Ok(once) = codec::encode_for(wire, message.clone()) else {
            assert_eq!(wire, T::SINCE, "what was read can be sent as it came");
            continue;
        };
        let again: T = codec::decode_any(&once).expect("what was written can be read");
        assert_eq!(codec::encode_for(wire, again).expect("the same"), once, "it reads back as something else");
    }
    true
}

pub(super) fn wire(bytes: &[u8]) -> bool {
    let mut read = 0;
    macro_rules! each {
        ($($kind:ty),*) => {$(read += u32::from(survives::<$kind>(bytes).is_some());)*};
    }
    each!(
        AwardNotice,
        AwardAnswer,
        Report,
        ReportAnswer,
        Command,
        Outcome,
        Submission,
        Ledger,
        Said,
        Beacon,
        Founder,
        FoundingAnswer,
        Changed,
        BodyCommand,
        BodyState,
        PeopleAsk,
        PersonState,
        PersonWord
    );
    read += u32::from(evolves::<Exchange>(bytes)) + u32::from(evolves::<Statement>(bytes));
    if let Some(within) = survives::<Within>(bytes) {
        read += 1;
        survives::<Beacon>(&within.said);
    }
    if let Some(live) = survives::<Live>(bytes) {
        read += 1;
        Live::whole(vec![live.clone(), live]);
    }
    let (call, tender) = (survives::<CallForBids>(bytes), survives::<Tender>(bytes));
    read += u32::from(call.is_some()) + u32::from(tender.is_some());
    auction(call, tender);
    read > 0
}

/// An auction ends with whatever is bid, and gives roles to those alone who have bid for them.
fn auction(call: Option<CallForBids>, tender: Option<Tender>) {
    let Some(tender) = tender else { return };
    let asked = tender.answers.iter().filter_map(|answer| match answer {
        Answer::Bid(bid) => Some(bid.role.clone()),
        Answer::Refusal(_) => None,
    });
    let roles = call.map(|call| call.roles).unwrap_or_default();
    let roles = asked.map(|role| (role.clone(), LocalPlan::of(role, vec![]))).chain(roles).collect();
    let call = CallForBids { auction: tender.auction.clone(), ensemble: "all".parse().expect("a slug"), roles };
    let (limits, robots) = (Limits::default(), BTreeSet::from([tender.robot.clone()]));
    let circumstances = Circumstances {
        expected: &robots,
        taken: &BTreeMap::new(),
        excluded: &BTreeMap::new(),
        limits: &limits,
        window_ms: 200,
        at_ms: 0,
    };
    let conclusion = conclude(&call, &[tender], &circumstances);
    let holders = conclusion.holders.iter().flatten();
    assert!(holders.clone().all(|(_, robot)| robots.contains(robot)), "a role for somebody who has not bid");
    explain(&conclusion.record);
}

/// What nodes say leads to messages that fit, and to a node that goes on.
pub(super) fn gossip(bytes: &[u8]) -> bool {
    let name = |name: &str| NodeId::new(name).expect("a slug");
    let mut ada = Listener::new(FleetId::new("ward").expect("a slug"), name("ada"));
    let mut heard = 0;
    for (kind, piece) in frames(bytes).take(60) {
        let said = match kind % 8 {
            0 => ada.hear(How::Published(name("bob")), piece),
            1 => ada.hear(How::Published(name("ada")), piece),
            2 => ada.hear(How::Packet, piece),
            3 => ada.hear(How::Asked, piece),
            4..=6 => ada.hear(How::Answered(u64::from(kind / 8)), piece),
            _ => ada.wait(Duration::from_millis(40 * u64::from(kind))),
        };
        match said {
            Ok(said) => {
                heard += 1;
                assert!(said.iter().all(|message| message.len() <= LIMIT), "it says more than fits a message");
            }
            Err(problem) => assert!(!problem.is_empty()),
        }
    }
    ada.wait(Duration::from_secs(90)).expect("it goes on");
    assert!(ada.knows() >= 1, "it has forgotten itself");
    heard > 0
}

fn read_twice<P: Debug>(bytes: &[u8], read: impl Fn(&[u8]) -> Result<Vec<u8>, P>) -> bool {
    let Ok(once) = read(bytes) else { return false };
    assert_eq!(read(&once).expect("what was written can be read"), once, "it reads back as something else");
    true
}

pub(super) fn raft(bytes: &[u8]) -> bool {
    let mut read = read_twice(bytes, untrusted::log_entry::<Ledger>);
    read |= read_twice(bytes, untrusted::snapshot::<Ledger>);
    for call in RaftCall::ALL {
        read |= read_twice(bytes, |bytes| untrusted::raft_question::<Ledger>(*call, bytes));
        read |= read_twice(bytes, |bytes| untrusted::raft_answer(*call, bytes));
    }
    read
}
