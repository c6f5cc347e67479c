//! Every message survives encoding and decoding, and no bytes cause a panic.

use consort_protocol::auction::{
    AuctionEntry, AuctionId, AuctionRecord, Bid, BidPart, BidRefusal, BidResponse, BidVerdict, CallForBids,
    RefusalReason, RoleReply, ViabilityError,
};
use consort_protocol::codec::{
    CodecError, MESSAGE_BYTES_MAX, VersionedMessage, decode, decode_any_version, encode, encode_for_version,
};
use consort_protocol::ids::{ClusterId, MissionId, NodeId, PlaceId, RequestId, RobotId, RoleId, TaskId, TaskType};
use consort_protocol::knowledge::{
    Availability, Digest, DigestScope, Knowledge, Proof, Record, RecordStamp, RobotKnowledge,
};
use consort_protocol::lease::{Award, DeclineReason, EndReason, Epoch, RoleHolder};
use consort_protocol::ledger::{
    Branch, Command, CommandError, CommandOutcome, HeldItem, Ledger, MissionState, Priority, RecoveryBranch, Submission,
};
use consort_protocol::message::{
    ActiveMissions, ActivePlan, AwardNotice, AwardReply, Beacon, BootstrapReply, BootstrapRequest, ClusterEnvelope,
    Exchange, FailureKind, MissionsChanged, RecordUpdate, Report, ReportReply, SignalHistory, TaskFailure,
};
use consort_protocol::mission::{
    AlternativeMethod, Method, Mission, OnLoss, Role, RoleKind, TaskBody, TaskNode, TaskOrder, TaskSpec,
};
use consort_protocol::plan::{Alternative, Division, LocalPlan, Signal, SignalKind, Step, StepAction};
use consort_protocol::pose::Pose;
use consort_protocol::trust::Fingerprint;
use consort_protocol::units::{BatteryShare, MetresPerSecond, Seconds, SharePerSecond};
use consort_protocol::versions::VersionRange;
use proptest::collection::{btree_map, btree_set, vec};
use proptest::option;
use proptest::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fmt::Debug;

fn name<T: TryFrom<String, Error: Debug> + Debug>() -> impl Strategy<Value = T> {
    "[a-zA-Z0-9_.-]{1,12}".prop_map(|text| T::try_from(text).expect("a slug"))
}

fn place() -> impl Strategy<Value = PlaceId> {
    "[A-Z][a-zäöü]{1,8} [0-9]{1,2}".prop_map(|text| PlaceId::new(text).expect("a label"))
}

fn text() -> impl Strategy<Value = String> {
    "\\PC{0,20}"
}

fn epoch() -> impl Strategy<Value = Epoch> {
    (any::<u64>(), any::<u64>()).prop_map(|(term, index)| Epoch { term, index })
}

fn stamp() -> impl Strategy<Value = RecordStamp> {
    (any::<u64>(), any::<u64>()).prop_map(|(incarnation, version)| RecordStamp { incarnation, version })
}

fn share() -> impl Strategy<Value = BatteryShare> {
    (0.0..=1.0).prop_map(|share| BatteryShare::new(share).expect("a share"))
}

fn seconds() -> impl Strategy<Value = Seconds> {
    (0.0..1e6).prop_map(|seconds| Seconds::new(seconds).expect("a time"))
}

fn spec() -> impl Strategy<Value = TaskSpec> {
    let items = (btree_map(name(), name(), 0..2), btree_set(name(), 0..2), any::<u8>());
    (name(), vec(name(), 1..3), btree_map(text(), text(), 0..3), btree_map(text(), text(), 0..2), items).prop_map(
        |(task_type, roles, parameters, reaches, (acquires, releases, attempts))| TaskSpec {
            task_type,
            roles,
            parameters,
            reaches,
            acquires,
            releases,
            attempts,
        },
    )
}

fn signal() -> impl Strategy<Value = Signal> {
    (any::<bool>(), name(), name(), name()).prop_map(|(done, task, from, to)| {
        let kind = if done { SignalKind::Done } else { SignalKind::Ready };
        Signal { kind, task, from, to }
    })
}

fn plan() -> impl Strategy<Value = LocalPlan> {
    let action = prop_oneof![
        (name(), spec()).prop_map(|(id, spec)| StepAction::Task { id, spec }),
        signal().prop_map(StepAction::Send),
        signal().prop_map(StepAction::Wait),
    ];
    let step = (action, vec(any::<u32>(), 0..3)).prop_map(|(action, after)| Step { action, after });
    let other = (btree_set(any::<u32>(), 0..3), vec((name(), spec()), 0..2))
        .prop_map(|(replaces, tasks)| Alternative { replaces, tasks });
    (name(), vec(step, 0..6), vec(other, 0..2), btree_set(any::<u32>(), 0..3))
        .prop_map(|(role, steps, alternatives, guarded)| LocalPlan { role, steps, alternatives, guarded })
}

fn mission() -> impl Strategy<Value = Mission> {
    let kind = prop_oneof![Just(RoleKind::Managed), Just(RoleKind::Unmanaged)];
    let on_loss = prop_oneof![Just(OnLoss::Fail), Just(OnLoss::Restart)];
    let order = prop_oneof![Just(TaskOrder::Sequential), Just(TaskOrder::Unordered)];
    let other = vec((name(), spec()), 0..2).prop_map(|tasks| AlternativeMethod { tasks });
    let body = prop_oneof![
        spec().prop_map(TaskBody::Elementary),
        (order, vec(any::<u32>(), 0..4), vec(other, 0..2)).prop_map(|(order, children, alternatives)| {
            TaskBody::Abstract(Method { order, children, alternatives })
        }),
    ];
    let node = (name(), body).prop_map(|(id, body)| TaskNode { id, body });
    (
        name(),
        btree_map(name(), (kind, on_loss).prop_map(|(kind, on_loss)| Role { kind, on_loss }), 0..4),
        vec(node, 0..6),
    )
        .prop_map(|(name, roles, tasks)| Mission { name, roles, tasks })
}

fn availability() -> impl Strategy<Value = Availability> {
    prop_oneof![
        Just(Availability::Free),
        (name(), name(), any::<bool>()).prop_map(|(mission, role, suspended)| Availability::Holding {
            mission,
            role,
            suspended
        }),
        text().prop_map(|problem| Availability::OutOfService { problem }),
    ]
}

fn worker() -> impl Strategy<Value = RobotKnowledge> {
    let speed = option::of((0.01..9.0).prop_map(|speed| MetresPerSecond::new(speed).expect("a speed")));
    let pose = (-1e3..1e3, -1e3..1e3, -4.0..4.0).prop_map(|(x, y, yaw)| Pose::new(x, y, yaw));
    let rate = (0.0..1.0).prop_map(|rate| SharePerSecond::new(rate).expect("a rate"));
    (btree_set(name::<TaskType>(), 0..5), place(), pose, share(), rate, share(), speed, availability(), text())
        .prop_map(|(skills, place, pose, battery, discharge, useful_charge, speed, availability, estimator)| {
            RobotKnowledge { skills, place, pose, battery, discharge, useful_charge, speed, availability, estimator }
        })
}

fn record() -> impl Strategy<Value = Record> {
    let flags = (any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>());
    let numbers = (option::of(any::<u64>()), option::of(any::<u64>().prop_map(ClusterId)));
    let speaks = (any::<u8>(), any::<u8>()).prop_map(|(oldest, newest)| VersionRange { oldest, newest });
    let proof = option::of((any::<[u8; 16]>(), any::<[u8; 32]>()));
    (name(), stamp(), flags, numbers, speaks, option::of(worker()), proof).prop_map(
        |(owner, stamp, (may_vote, stationary, mains_powered, leaving), (replica, cluster), speaks, worker, proof)| {
            Record {
                owner,
                stamp,
                knowledge: Knowledge {
                    may_vote,
                    stationary,
                    mains_powered,
                    replica,
                    cluster,
                    leaving,
                    supported_versions: speaks,
                    robot: worker,
                },
                proof: proof.and_then(|(by, half)| Proof::new(Fingerprint(by), &[half, half].concat())),
            }
        },
    )
}

fn auction() -> impl Strategy<Value = AuctionId> {
    (name(), any::<u64>(), any::<u32>()).prop_map(|(mission, term, round)| AuctionId { mission, term, round })
}

fn part() -> impl Strategy<Value = BidPart> {
    (any::<u32>(), text(), name(), seconds(), 0.0..2.0).prop_map(|(step, label, skill, time, energy)| BidPart {
        step,
        label,
        skill,
        time,
        energy,
    })
}

fn bid() -> impl Strategy<Value = Bid> {
    (name(), name(), seconds(), 0.0..2.0, -1.0..1.0, share(), place(), any::<u64>(), vec(part(), 0..4)).prop_map(
        |(robot, role, time, energy, remaining, useful_charge, from, age_ms, parts)| Bid {
            robot,
            role,
            time,
            energy,
            remaining,
            useful_charge,
            from,
            age_ms,
            parts,
        },
    )
}

fn reason() -> impl Strategy<Value = RefusalReason> {
    prop_oneof![
        vec(name(), 0..4).prop_map(|skills| RefusalReason::MissingSkills { skills }),
        (name(), name()).prop_map(|(mission, role)| RefusalReason::Busy { mission, role }),
        (name(), text()).prop_map(|(task, problem)| RefusalReason::NotFeasible { task, problem }),
        text().prop_map(|problem| RefusalReason::OutOfService { problem }),
        (name(), text()).prop_map(|(ensemble, why)| RefusalReason::NotMember { ensemble, why }),
        any::<u64>().prop_map(|window_ms| RefusalReason::Silent { window_ms }),
        (name(), name()).prop_map(|(item, mission)| RefusalReason::CarriesItem { item, mission }),
        text().prop_map(|cause| RefusalReason::Excluded { cause }),
    ]
}

fn auction_record() -> impl Strategy<Value = AuctionRecord> {
    let verdict = prop_oneof![
        (seconds(), 0.0..2.0, -1.0..1.0).prop_map(|(time, energy, remaining)| BidVerdict::Viable {
            time,
            energy,
            remaining
        }),
        (seconds(), 0.0..2.0, -1.0..1.0, share()).prop_map(|(time, energy, remaining, floor)| {
            BidVerdict::Unviable { time, energy, remaining, why: ViabilityError::LowCharge { remaining, floor } }
        }),
        reason().prop_map(|reason| BidVerdict::Refused { reason }),
    ];
    let entry = (name(), name(), verdict, vec(part(), 0..3)).prop_map(|(role, robot, verdict, parts)| AuctionEntry {
        role,
        robot,
        verdict,
        parts,
    });
    let chosen = btree_map(name(), name(), 0..3);
    (auction(), any::<u64>(), vec(entry, 0..4), any::<u32>(), chosen, option::of(text())).prop_map(
        |(auction, at_ms, entries, omitted, chosen, failure)| AuctionRecord {
            auction,
            at_ms,
            entries,
            omitted,
            chosen,
            failure,
        },
    )
}

fn submission() -> impl Strategy<Value = Submission> {
    let division = btree_map(name(), plan(), 0..3).prop_map(|plans| Division { plans });
    let division = division.boxed();
    let recovery = (mission(), division.clone()).prop_map(|(mission, division)| RecoveryBranch { mission, division });
    let priority = (-100i64..=100).prop_map(|number| Priority::new(number).expect("a priority"));
    let how = (option::of(recovery), priority, option::of(any::<u64>()));
    (name::<RequestId>(), mission(), division, btree_map(text(), text(), 0..3), how, any::<u64>()).prop_map(
        |(request, mission, division, parameters, (recovery, priority, deadline_ms), at_ms)| Submission {
            request,
            mission,
            division,
            parameters,
            recovery,
            priority,
            deadline_ms,
            at_ms,
        },
    )
}

fn command() -> impl Strategy<Value = Command> {
    let held = || (name::<MissionId>(), name::<RoleId>(), epoch());
    prop_oneof![
        any::<u64>().prop_map(|cluster| Command::Bootstrap { cluster: ClusterId(cluster) }),
        submission().prop_map(|submission| Command::Submit(Box::new(submission))),
        (name(), branch(), btree_map(name(), name(), 0..3), auction_record())
            .prop_map(|(mission, branch, holders, auction)| Command::Award { mission, branch, holders, auction }),
        (name(), branch(), auction_record()).prop_map(|(mission, branch, auction)| Command::Defer {
            mission,
            branch,
            auction
        }),
        (held(), any::<u64>(), any::<bool>()).prop_map(|((mission, role, epoch), incarnation, resumes)| {
            Command::Accept { mission, role, epoch, incarnation, from_checkpoint: resumes }
        }),
        (held(), branch(), btree_set(any::<u32>(), 0..5)).prop_map(|((mission, role, epoch), branch, ended)| {
            Command::Progress { mission, role, epoch, branch, ended }
        }),
        (held(), text(), any::<bool>(), option::of(place())).prop_map(
            |((mission, role, epoch), cause, blamed, place)| Command::Release {
                mission,
                role,
                epoch,
                cause,
                robot_failed: blamed,
                place
            }
        ),
        (name(), text(), option::of(branch()), places()).prop_map(|(mission, cause, branch, places)| Command::Fail {
            mission,
            cause,
            branch,
            places
        }),
        (name(), text(), places()).prop_map(|(mission, by, places)| Command::Cancel { mission, by, places }),
        (name(), text()).prop_map(|(mission, by)| Command::Resolve { mission, by }),
        any::<u8>().prop_map(|wire| Command::RaiseWireVersion { wire }),
    ]
}

fn branch() -> impl Strategy<Value = Branch> {
    prop_oneof![Just(Branch::Main), Just(Branch::Recovery)]
}

fn places() -> impl Strategy<Value = BTreeMap<RobotId, PlaceId>> {
    btree_map(name(), place(), 0..3)
}

fn stranded() -> impl Strategy<Value = HeldItem> {
    (name(), name(), name(), option::of(place()), any::<bool>())
        .prop_map(|(item, role, robot, place, certain)| HeldItem { item, role, robot, place, certain })
}

fn outcome() -> impl Strategy<Value = CommandOutcome> {
    prop_oneof![
        (name(), any::<bool>()).prop_map(|(mission, again)| CommandOutcome::Submitted { mission, again }),
        epoch().prop_map(|epoch| CommandOutcome::Awarded { epoch }),
        Just(CommandOutcome::Done),
        (name(), text()).prop_map(|(mission, cause)| {
            CommandOutcome::Refused(CommandError::MissionEnded { mission, state: MissionState::Failed { cause } })
        }),
        (name(), text(), vec(stranded(), 0..3)).prop_map(|(mission, cause, items)| {
            CommandOutcome::Refused(CommandError::MissionEnded {
                mission,
                state: MissionState::NeedsIntervention { cause, items },
            })
        }),
        (name(), name(), name()).prop_map(|(robot, item, mission)| CommandOutcome::Refused(
            CommandError::CarriesItem { robot, item, mission }
        )),
        (name(), text()).prop_map(|(mission, state)| CommandOutcome::Refused(CommandError::NoInterventionNeeded {
            mission,
            state
        })),
        (name(), name(), option::of(epoch())).prop_map(|(mission, role, held)| CommandOutcome::Refused(
            CommandError::StaleEpoch { mission, role, held }
        )),
    ]
}

fn ending() -> impl Strategy<Value = EndReason> {
    prop_oneof![
        Just(EndReason::Canceled),
        Just(EndReason::Failed),
        Just(EndReason::Over),
        Just(EndReason::Replaced),
        Just(EndReason::Released),
        Just(EndReason::NeedsIntervention),
    ]
}

fn holders() -> impl Strategy<Value = BTreeMap<RoleId, RoleHolder>> {
    btree_map(name(), (name(), epoch()).prop_map(|(robot, epoch)| RoleHolder { robot, epoch }), 0..3)
}

fn notice() -> impl Strategy<Value = AwardNotice> {
    let award = (name(), name(), name(), epoch(), plan(), holders())
        .prop_map(|(mission, role, robot, epoch, plan, holders)| Award { mission, role, robot, epoch, plan, holders });
    prop_oneof![
        award.prop_map(|award| AwardNotice::Awarded(Box::new(award))),
        (epoch(), ending()).prop_map(|(epoch, reason)| AwardNotice::Revoked { epoch, reason }),
    ]
}

fn award_answer() -> impl Strategy<Value = AwardReply> {
    prop_oneof![
        Just(AwardReply::Acknowledged),
        (name(), name()).prop_map(|(mission, role)| AwardReply::Declined(DeclineReason::Busy { mission, role })),
        epoch().prop_map(|known| AwardReply::Declined(DeclineReason::Stale { known })),
        name().prop_map(|robot| AwardReply::Declined(DeclineReason::WrongRobot { robot })),
    ]
}

fn report() -> impl Strategy<Value = Report> {
    let kind = prop_oneof![
        Just(FailureKind::Task),
        Just(FailureKind::Crash),
        Just(FailureKind::NoProgress),
        Just(FailureKind::Battery),
        Just(FailureKind::Leaving),
        Just(FailureKind::Plan),
    ];
    let failure = (option::of(name()), text(), kind).prop_map(|(task, cause, kind)| TaskFailure { task, cause, kind });
    let who = (name::<RobotId>(), any::<u64>(), name(), name(), epoch(), branch());
    let how = (option::of(place()), any::<bool>(), option::of(failure));
    (who, btree_set(any::<u32>(), 0..5), option::of(name::<TaskId>()), how).prop_map(
        |((robot, incarnation, mission, role, epoch, branch), ended, at, (place, resumes, failure))| Report {
            robot,
            incarnation,
            mission,
            role,
            epoch,
            branch,
            ended,
            current_task: at,
            place,
            from_checkpoint: resumes,
            failure,
        },
    )
}

fn report_answer() -> impl Strategy<Value = ReportReply> {
    prop_oneof![
        (epoch(), btree_set(any::<u32>(), 0..5), holders(), btree_set(signal(), 0..4))
            .prop_map(|(epoch, ended, holders, signals)| ReportReply::Renewed { epoch, ended, holders, signals }),
        (epoch(), ending(), option::of(epoch())).prop_map(|(epoch, reason, current)| ReportReply::Ended {
            epoch,
            reason,
            current
        }),
        option::of(name()).prop_map(|coordinator| ReportReply::NotCoordinator { coordinator }),
    ]
}

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
    }

    #[test]
    fn auctions_survive(
        auction in auction(), roles in btree_map(name(), plan(), 0..3), ensemble in name(), bid in bid(),
        robot in name::<RobotId>(), role in name::<RoleId>(), reason in reason()
    ) {
        assert_round_trip(&CallForBids { auction: auction.clone(), ensemble, roles })?;
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
        term in any::<u64>(), voters in btree_set(name::<NodeId>(), 0..4), plan in plan(),
        ended in btree_set(any::<u32>(), 0..4), holders in holders(), branch in branch(),
        vacant in btree_set(name::<RoleId>(), 0..3)
    ) {
        assert_round_trip(&ClusterEnvelope { cluster: Some(ClusterId(term)), payload: vec![1, 2, 3] })?;
        assert_round_trip(&SignalHistory { mission: mission.clone(), epoch, signals: signals.clone() })?;
        assert_round_trip(&Beacon { node: node.clone(), term, voters, since_ms: term, cluster: (term % 2 == 0).then_some(ClusterId(term)), wire: (term % 3 == 0).then_some(2) })?;
        let founder = BootstrapRequest { mobile: term % 2 == 0, on_battery: term % 3 == 0, node: node.clone() };
        assert_round_trip(&BootstrapReply::Refused { reason: founder.node.to_string() })?;
        assert_round_trip(&founder)?;
        assert_round_trip(&MissionsChanged { node, term })?;
        let live = ActivePlan { mission, branch, plan, ended, holders, vacant, signals };
        assert_round_trip(&ActiveMissions { cluster: Some(ClusterId(term)), count: 1, plans: vec![live] })?;
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
        assert_harmless::<Beacon>(&bytes);
        assert_harmless::<BootstrapRequest>(&bytes);
        assert_harmless::<BootstrapReply>(&bytes);
        assert_harmless::<MissionsChanged>(&bytes);
        assert_harmless::<ActiveMissions>(&bytes);
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
