//! Messages of a fleet that carries out a mission.

use super::fleet;
use consort_fleet::robot::{Checkpoint, OwnProgress};
use consort_fleet::robot_driver::{
    DriverCommand, DriverState, GoalRequest, Permit, PersonCommand, PersonEvent, PersonRequestState, StateStamp,
};
use consort_gossip::{GossipHarness, GossipInput as How};
use consort_protocol::auction::{
    AuctionId, AuctionRecord, Bid, BidPart, BidResponse, CallForBids, ChargingStop, Objective, PlannedRole,
    PresentRole, PromisedRole, RoleOfMission, RoleReply, RoleSpan, Timelines,
};
use consort_protocol::cause::CauseClass;
use consort_protocol::codec::{encode, encode_for_version, encode_record};
use consort_protocol::ids::{ClusterId, NodeId, RoleId};
use consort_protocol::knowledge::{
    Availability, ChargerClaim, Charging, DigestScope, Knowledge, Proof, Record, RecordStamp, RobotKnowledge,
};
use consort_protocol::lease::{Award, EndReason, Epoch, RoleHolder};
use consort_protocol::ledger::{
    AlarmChange, AlarmPlan, AlarmResponse, AnswerContent, Branch, ClosureChange, Command, Ledger, MapPart,
    MissedOccurrences, MissionCancelation, MissionChange, OrderChange, OrderRequest, PersonAnswer, PersonQuestion,
    PersonRequestId, Priority, PromiseMove, Resource, Schedule, SchedulePause, ScheduleRule, SpeedLimitChange,
    TaskQuestion, Zone,
};
use consort_protocol::message::{
    AlarmNotice, AwardNotice, AwardReply, Beacon, BootstrapReply, BootstrapRequest, ClosureNotice, ClusterEnvelope,
    Exchange, FailureKind, FollowedLeader, OrderNotice, OrdersNotice, RecordUpdate, Report, ReportReply, SignalHistory,
    SpeedLimitNotice, TaskFailure,
};
use consort_protocol::mission::{DomainHash, DomainReference, Escalation, TaskOutcome, TaskOutcomes};
use consort_protocol::plan::{LocalPlan, StepAction};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::trust::{Fingerprint, MessageKind, SIGNATURE_BYTES, SignedEnvelope, encode_envelope};
use consort_protocol::units::{BatteryShare, Energy, MetresPerSecond, Seconds, SharePerSecond};
use consort_protocol::versions::VersionRange;
use consort_skills::actions::{Goal, GoalId, GoalResult, GoalStatus, NavigateToPose};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;
use std::str::FromStr;
use std::time::Duration;

const NEWEST: u8 = VersionRange::OWN.newest;
const EPOCH: Epoch = Epoch { term: 3, index: 3 };

fn slug<T: FromStr<Err: Debug>>(name: &str) -> T {
    name.parse().expect("a slug")
}

/// Encodes a frame of a composite input.
pub(super) fn frame(kind: u8, bytes: &[u8]) -> Vec<u8> {
    let length = u16::try_from(bytes.len()).expect("a small piece");
    [&[kind], &length.to_le_bytes()[..], bytes].concat()
}

fn encoded<T: Serialize>(message: &T) -> Vec<u8> {
    encode(message).expect("a small message")
}

fn encoded_statement(wire: u8, statement: RecordUpdate) -> Vec<u8> {
    encode_for_version(wire, statement).expect("a small message")
}

fn proof() -> Option<Proof> {
    Proof::new(Fingerprint([3; 16]), &[1; SIGNATURE_BYTES])
}

fn stored<T: Serialize>(record: &T) -> Vec<u8> {
    encode_record(record).expect("a small record")
}

fn plans() -> BTreeMap<RoleId, LocalPlan> {
    fleet::submission().division.plans
}

fn holders() -> BTreeMap<RoleId, RoleHolder> {
    let roles = fleet::submission().mission.roles;
    let managed = roles.into_keys().filter(|role| role.as_str().starts_with('r'));
    managed.map(|role| (role, RoleHolder { robot: slug("ada"), epoch: EPOCH })).collect()
}

fn record(owner: &str) -> Record {
    let worker = RobotKnowledge {
        skills: BTreeSet::from([slug("navigation")]),
        attributes: serde_json::from_value(serde_json::json!({ "section": "icu", "floor": 3 })).expect("attributes"),
        place: slug("Dock"),
        pose: Pose::new(1.0, 2.0, 0.5),
        battery: BatteryShare::new(0.5).expect("a share"),
        discharge: SharePerSecond::new(0.001).expect("a rate"),
        useful_charge: BatteryShare::new(0.1).expect("a share"),
        speed: None,
        availability: Availability::Free,
        estimator: "calibrated".to_owned(),
        charging: Some(Charging::Bound(ChargerClaim {
            charger: slug("Dock"),
            battery: BatteryShare::FULL,
            lease: Some(7),
            drive_s: Some(Seconds::new(30.0).expect("a time")),
        })),
    };
    let knowledge = Knowledge {
        may_vote: true,
        stationary: false,
        mains_powered: false,
        replica: Some(7),
        cluster: Some(ClusterId(1)),
        leaving: false,
        supported_versions: VersionRange { oldest: 1, newest: 1 },
        robot: Some(worker),
        devices: Default::default(),
        domains: BTreeSet::from([DomainReference { name: slug("plants"), hash: DomainHash(7) }]),
    };
    Record { owner: slug(owner), stamp: RecordStamp { incarnation: 5, version: 9 }, knowledge, proof: proof() }
}

fn bid() -> Bid {
    let seconds = |seconds: f64| Seconds::new(seconds).expect("a time");
    Bid {
        robot: slug("ada"),
        role: slug("r1"),
        time: seconds(120.0),
        energy: 0.1,
        remaining: 0.4,
        useful_charge: BatteryShare::new(0.1).expect("a share"),
        from: slug("Dock"),
        age_ms: 30,
        parts: vec![BidPart {
            step: 0,
            label: "drive".to_owned(),
            skill: slug("navigation"),
            time: seconds(120.0),
            energy: 0.1,
        }],
        present: Some(PresentRole { mission: slug("lab-samples-2"), role: slug("r1"), time: seconds(20.0) }),
        planned: Some(Box::new(planned())),
    }
}

fn promised_role() -> RoleOfMission {
    RoleOfMission { mission: slug("lab-samples-3"), role: slug("r1") }
}

fn span() -> RoleSpan {
    let time = Seconds::new(90.0).expect("a time");
    RoleSpan { from: Some(slug("Dock")), to: Some(slug("Laboratory")), time, energy: Energy::of_share(0.1) }
}

fn stop() -> ChargingStop {
    let share = |share: f64| BatteryShare::new(share).expect("a share");
    let time = Seconds::new(300.0).expect("a time");
    ChargingStop { charger: slug("Dock"), time, until: share(0.8), remaining: share(0.5) }
}

fn planned() -> PlannedRole {
    let seconds = |seconds: f64| Seconds::new(seconds).expect("a time");
    PlannedRole {
        before: Some(promised_role()),
        delay: seconds(30.0),
        delayed: 1,
        delay_max: seconds(600.0),
        promised: 1,
        energy: Energy::of_share(0.1),
        detour_energy: 0.01,
        charging: Some(stop()),
        ..PlannedRole::alone(span(), seconds(20.0))
    }
}

fn auction() -> AuctionId {
    AuctionId { mission: slug("lab-samples-1"), term: 3, round: 1 }
}

fn award(role: &str, plan: LocalPlan) -> Award {
    Award {
        mission: slug("lab-samples-1"),
        role: slug(role),
        robot: slug("ada"),
        epoch: EPOCH,
        plan,
        holders: holders(),
    }
}

fn results() -> BTreeMap<String, Scalar> {
    BTreeMap::from([("pulse_bpm".to_owned(), Scalar::Integer(70))])
}

fn outcomes() -> TaskOutcomes {
    BTreeMap::from([(slug("measure"), TaskOutcome::Done(results())), (slug("attend"), TaskOutcome::Skipped)])
}

fn report() -> Report {
    Report {
        robot: slug("ada"),
        incarnation: 5,
        mission: slug("lab-samples-1"),
        role: slug("r1"),
        epoch: EPOCH,
        ended: BTreeSet::from([0, 1]),
        outcomes: outcomes(),
        current_task: Some(slug("navto_room")),
        place: Some(slug("Dock")),
        from_checkpoint: false,
        failure: Some(TaskFailure::new(FailureKind::Task, "it fell")),
        question: None,
    }
}

fn state() -> DriverState {
    let telemetry = serde_json::json!({
        "time": 3.5, "pose": { "x_m": 1.0, "y_m": 2.5, "yaw_rad": 0.5 }, "place": "Dock", "battery": 0.75, "able": true,
        "closed": [["Dock", "IC Room 6"]],
        "readings": { "bag_full": true, "bag_g": 12.5, "brush": "worn", "passes": 3 },
    });
    let telemetry = serde_json::from_value(telemetry).expect("a report");
    let goal = Goal::from(NavigateToPose::to(Pose::new(1.0, 1.0, 0.0), None));
    DriverState {
        robot: slug("ada"),
        stamp: StateStamp { boot: 5, sequence: 4 },
        telemetry,
        goals: vec![(GoalId(1), GoalStatus::succeeded()), (GoalId(2), GoalStatus::Sent)],
        completed: vec![(GoalId(1), goal, GoalResult::default())],
    }
}

pub(super) fn body_state() -> Vec<u8> {
    encoded(&state())
}

/// Returns a message of each kind, encoded with this wire version.
pub(super) fn messages(wire: u8) -> Vec<Vec<u8>> {
    let (ada, beacon) = (slug::<NodeId>("ada"), beacon());
    let (role, plan) = plans().into_iter().next().expect("a role");
    let signals = plan.steps.iter().filter_map(|step| match &step.action {
        StepAction::Send(signal) | StepAction::Wait(signal) => Some(signal.clone()),
        StepAction::Task { .. } => None,
    });
    let signals: BTreeSet<_> = signals.collect();
    let exchange = Exchange {
        sums: vec![1, 2, 3],
        scope: DigestScope::ALL,
        digest: BTreeMap::from([(ada.clone(), RecordStamp { incarnation: 5, version: 9 })]),
        records: vec![record("bob")],
    };
    let mut all = vec![
        encode_for_version(wire, exchange).expect("a small message"),
        encoded_statement(wire, RecordUpdate::Record(record("ada"))),
        encoded_statement(wire, RecordUpdate::Refresh { stamp: RecordStamp::default(), since: 0, proof: proof() }),
        encoded(&CallForBids {
            auction: auction(),
            ensembles: vec![slug("icu"), slug("all")],
            roles: plans(),
            eligible: [(slug("r1"), r#"robot.attributes.section == "icu""#.to_owned())].into(),
            spread: [slug("r1")].into(),
            timelines: Timelines {
                objective: Objective::Weighted { battery_s: Seconds::new(3600.0).expect("a time") },
                promised: vec![PromisedRole {
                    robot: slug("ada"),
                    role: promised_role(),
                    span: span(),
                    slack: Some(Seconds::new(60.0).expect("a time")),
                    release: Seconds::new(40.0).expect("a time"),
                    charges: true,
                }],
                startable: [slug("r1")].into(),
                ends_within: Some(Seconds::new(600.0).expect("a time")),
                releases: [(slug("r1"), Seconds::new(30.0).expect("a time"))].into(),
            },
        }),
        encoded(&BidResponse { robot: slug("ada"), auction: auction(), replies: vec![RoleReply::Bid(bid())] }),
        encoded(&AwardNotice::Awarded(Box::new(award(role.as_str(), plan)))),
        encoded(&AwardNotice::Revoked { epoch: EPOCH, reason: EndReason::Over }),
        encoded(&AwardNotice::Orders(Box::new(orders()))),
        encoded(&AwardNotice::Return { epoch: EPOCH, repeat: true, cause: "reassigned by Nia".to_owned() }),
        encoded(&AwardNotice::Leased { resource: Resource::Charger(slug("Dock")), epoch: EPOCH }),
        encoded(&AwardReply::Acknowledged),
        encoded(&report()),
        encoded(&ReportReply::Ended { epoch: EPOCH, reason: EndReason::Replaced, current: Some(EPOCH) }),
        encoded(&SignalHistory { mission: slug("lab-samples-1"), epoch: EPOCH, signals }),
        encoded(&ClusterEnvelope { cluster: Some(ClusterId(1)), payload: encoded(&beacon) }),
        encoded(&beacon),
        encoded(&BootstrapRequest { node: ada.clone(), mobile: false, on_battery: false }),
        encoded(&BootstrapReply::Refused { reason: "no".to_owned() }),
        encoded(&FollowedLeader { node: ada.clone(), term: 3 }),
        encoded(&DriverCommand {
            request: Some(GoalRequest::Cancel { id: GoalId(3) }),
            permit: Permit { goals: vec![GoalId(2)], state: StateStamp { boot: 5, sequence: 7 }, keep_for_ms: 2_900 },
        }),
        body_state(),
        encoded(&PersonCommand { id: GoalId(3), request: None }),
        encoded(&PersonRequestState::Ended(Ok(results()))),
        encoded(&PersonEvent::CancelMission {
            by: "Nia".to_owned(),
            role: slug("nurse"),
            robot: slug("ada"),
            at_ms: 3,
        }),
        encoded(&fleet::submission()),
    ];
    all.extend(ledger_commands().iter().map(encoded));
    all
}

fn beacon() -> Beacon {
    let voters = BTreeSet::from([slug("ada"), slug("bob")]);
    Beacon { node: slug("ada"), term: 3, voters, since_ms: 500, cluster: Some(ClusterId(1)), wire: None }
}

fn ledger_commands() -> Vec<Command> {
    let mission = || slug("lab-samples-1");
    let roles: Vec<RoleId> = holders().into_keys().collect();
    let given = roles.iter().cloned().zip(["ada", "bob", "cyd", "dan"].map(slug)).collect();
    let record = AuctionRecord {
        auction: auction(),
        at_ms: 7,
        entries: vec![],
        omitted: 0,
        chosen: BTreeMap::clone(&given),
        promised: BTreeMap::from([(slug("r1"), Seconds::new(20.0).expect("a time"))]),
        failure: None,
        planned: BTreeMap::from([(slug("r1"), planned())]),
    };
    let (role, epoch) = (roles[0].clone(), Epoch { term: 1, index: 3 });
    let ended = BTreeSet::from([0]);
    vec![
        Command::Bootstrap { cluster: ClusterId(1) },
        Command::Submit(Box::new(fleet::submission())),
        Command::Award { mission: mission(), branch: Branch::default(), holders: given, auction: record.clone() },
        Command::MovePromise(Box::new(PromiseMove {
            mission: mission(),
            role: slug("r1"),
            epoch,
            robot: slug("bob"),
            cause: "it is late".to_owned(),
            auction: record,
        })),
        Command::AwardPromised { mission: mission(), role: slug("r1"), epoch: Epoch { term: 1, index: 5 } },
        Command::Postpone { mission: mission(), role: slug("r1"), epoch: Epoch { term: 1, index: 5 } },
        Command::Accept { mission: mission(), role: role.clone(), epoch, incarnation: 5, from_checkpoint: false },
        Command::Progress {
            mission: mission(),
            role: role.clone(),
            epoch,
            branch: Branch::default(),
            ended,
            outcomes: outcomes(),
        },
        Command::Release {
            mission: mission(),
            role,
            epoch,
            cause: "it is lost".to_owned(),
            class: Some(CauseClass::Robot),
            moved_nothing: false,
            place: Some(slug("Dock")),
            gave_way: false,
        },
        Command::AskPerson { mission: mission(), branch: Branch::default(), role: slug("nurse"), step: 1, asked_ms: 7 },
        Command::SetQuestion { mission: mission(), role: slug("r1"), epoch, question: question(), asked_ms: 7 },
        Command::AnswerPerson { request: request(), answer: answer(), places: BTreeMap::new() },
        Command::ExpirePersonRequest { request: request(), now_ms: 9, places: BTreeMap::new() },
        Command::AddSchedule { schedule: Box::new(schedule()), from_ms: 7 },
        Command::SubmitOccurrence { schedule: slug("rounds"), after_ms: 7, due_ms: 8, at_ms: 9 },
        Command::PauseSchedule { schedule: slug("rounds"), pause: SchedulePause { by: "Nia".to_owned(), since_ms: 9 } },
        Command::Cancel { mission: mission(), by: "Nia".to_owned(), places: BTreeMap::new(), at_ms: 9 },
        Command::EscalatePersonRequest { request: request(), now_ms: 8 },
        Command::OrderRobots {
            robots: BTreeSet::from([slug("ada")]),
            order: OrderRequest {
                change: OrderChange::Hold { until_ms: 9, reason: "a spill".to_owned() },
                by: "Nia".to_owned(),
                at_ms: 8,
                request: Some(slug("kim-7")),
            },
        },
        Command::ExpireOrders { now_ms: 9 },
        Command::EndOrders { robots: [slug("ada")].into() },
        Command::CancelMissions {
            order: OrderRequest {
                change: MissionCancelation {
                    missions: BTreeMap::from([(mission(), BTreeMap::from([(slug("ada"), slug("Dock"))]))]),
                },
                by: "Nia".to_owned(),
                at_ms: 9,
                request: Some(slug("kim-9")),
            },
        },
        Command::ChangeMission {
            mission: mission(),
            order: OrderRequest {
                change: MissionChange::SetPriority(Priority::new(7).expect("a priority")),
                by: "Nia".to_owned(),
                at_ms: 9,
                request: Some(slug("kim-10")),
            },
        },
        Command::ChangeMission {
            mission: mission(),
            order: OrderRequest {
                change: MissionChange::Reassign { role: slug("r1"), to: Some(slug("bob")), repeat: true },
                by: "Nia".to_owned(),
                at_ms: 9,
                request: None,
            },
        },
        Command::LeaseResource { resource: Resource::Charger(slug("Dock")), robot: slug("ada"), at_ms: 9 },
        Command::FreeResource { resource: Resource::Device(slug("lift")), epoch },
        Command::ChangeClosures {
            parts: BTreeSet::from([MapPart::Place("IC Room 6".parse().expect("a place"))]),
            order: OrderRequest {
                change: ClosureChange::Close { until_ms: Some(9), reason: "a spill".to_owned() },
                by: "Nia".to_owned(),
                at_ms: 8,
                request: Some(slug("kim-8")),
            },
        },
        Command::ChangeSpeedLimits {
            parts: BTreeSet::from([MapPart::Place("IC Room 6".parse().expect("a place"))]),
            order: OrderRequest {
                change: SpeedLimitChange::Set {
                    speed: MetresPerSecond::new(0.3).expect("a speed"),
                    until_ms: Some(9),
                    reason: "a spill".to_owned(),
                },
                by: "Nia".to_owned(),
                at_ms: 8,
                request: Some(slug("kim-9")),
            },
        },
        Command::ChangeAlarms {
            order: OrderRequest {
                change: AlarmChange::Raise {
                    alarm: slug("fire"),
                    plan: AlarmPlan {
                        robots: AlarmResponse::Assemble,
                        places: ["Dock".parse().expect("a place")].into(),
                        closes: [MapPart::Place("IC Room 6".parse().expect("a place"))].into(),
                    },
                    reason: "smoke".to_owned(),
                },
                by: "Nia".to_owned(),
                at_ms: 8,
                request: Some(slug("kim-10")),
            },
        },
    ]
}

fn orders() -> OrdersNotice {
    let hold = OrderNotice { text: "held by Nia: a spill".to_owned(), remaining_ms: Some(600_000) };
    let closures = vec![ClosureNotice {
        part: MapPart::of_lane("IC Corridor 6".parse().expect("a place"), "IC Room 6".parse().expect("a place")),
        order: OrderNotice { text: "closed by Nia: a spill".to_owned(), remaining_ms: Some(600_000) },
        until_ms: Some(700_000),
    }];
    let speed_limits = vec![SpeedLimitNotice {
        part: MapPart::Zone(Zone {
            name: "icu".parse().expect("a zone"),
            places: BTreeSet::from(["IC Room 6".parse().expect("a place")]),
        }),
        speed: MetresPerSecond::new(0.3).expect("a speed"),
        remaining_ms: None,
    }];
    let alarm = AlarmNotice {
        order: OrderNotice { text: "under alarm fire by Nia: smoke".to_owned(), remaining_ms: None },
        places: ["Dock".parse().expect("a place")].into(),
        closes: [MapPart::Place("IC Room 6".parse().expect("a place"))].into(),
    };
    OrdersNotice {
        as_of: EPOCH,
        hold: Some(hold),
        maintenance: None,
        closures,
        stay: None,
        speed_limits,
        alarm: Some(alarm),
    }
}

fn schedule() -> Schedule {
    let rule = ScheduleRule {
        cron: "0 8 * * *".to_owned(),
        zone: "Europe/Berlin".to_owned(),
        until_ms: None,
        missed: MissedOccurrences::Last,
    };
    Schedule { id: slug("rounds"), rule, submission: fleet::submission(), deadline_after_ms: Some(60_000) }
}

fn question() -> TaskQuestion {
    let (to, message) = (slug("nurse"), "may I enter?".to_owned());
    let escalation = Some(Box::new(Escalation { to: slug("doctor"), after_s: 30 }));
    let question = PersonQuestion { to, message, at: Some(slug("Dock")), patience_s: Some(60), escalation };
    TaskQuestion { task: slug("drive"), number: 1, question, is_open: true }
}

pub(super) fn commands() -> Vec<u8> {
    ledger_commands().iter().flat_map(|command| frame(0, &encoded(command))).collect()
}

pub(super) fn awards() -> Vec<Vec<u8>> {
    let notices = plans().into_iter().map(|(role, plan)| {
        let notice = AwardNotice::Awarded(Box::new(award(role.as_str(), plan)));
        let renewed = ReportReply::Renewed {
            epoch: EPOCH,
            ended: BTreeSet::from([0]),
            holders: holders(),
            signals: BTreeSet::new(),
            outcomes: outcomes(),
            answer: None,
            orders: Box::new(orders()),
        };
        [frame(0, &encoded(&notice)), frame(1, &encoded(&renewed)), frame(2, &[])].concat()
    });
    notices.collect()
}

pub(super) fn checkpoints() -> Vec<Vec<u8>> {
    let page = |(role, plan): (RoleId, LocalPlan)| {
        let own = OwnProgress { ended: BTreeSet::from([0]), outcomes: outcomes(), ..OwnProgress::default() };
        let left = Some("IC Corridor 6".parse().expect("a place"));
        Checkpoint { award: award(role.as_str(), plan), own, first_goal: GoalId(3), left }.encode()
    };
    plans().into_iter().map(page).collect()
}

pub(super) fn gossip() -> Vec<Vec<u8>> {
    let exchange = |sums, records| {
        let digest = BTreeMap::from([
            (slug("ada"), RecordStamp { incarnation: 9, version: 2 }),
            (slug("cyd"), RecordStamp::default()),
        ]);
        let exchange = Exchange { sums, scope: DigestScope::ALL, digest, records };
        encode_for_version(NEWEST, exchange).expect("a small message")
    };
    // Messages of Bob after a record of Ada, including packets of failure detection.
    let mut bob = GossipHarness::new(slug("ward"), slug("bob"));
    let ada = encoded_statement(NEWEST, RecordUpdate::Record(record("ada")));
    let mut message = bob.receive(How::Published(slug("ada")), &ada).expect("a statement");
    message.extend(bob.advance(Duration::from_secs(3)).expect("time passes"));
    let packets: Vec<u8> = message.iter().flat_map(|packet| frame(2, packet)).collect();
    vec![
        [packets, frame(255, &[])].concat(),
        [
            frame(0, &encoded_statement(NEWEST, RecordUpdate::Record(record("bob")))),
            frame(
                0,
                &encoded_statement(
                    NEWEST,
                    RecordUpdate::Refresh {
                        stamp: RecordStamp { incarnation: 5, version: 10 },
                        since: 9,
                        proof: proof(),
                    },
                ),
            ),
            frame(
                1,
                &encoded_statement(
                    NEWEST,
                    RecordUpdate::Refresh {
                        stamp: RecordStamp { incarnation: 5, version: 10 },
                        since: 9,
                        proof: proof(),
                    },
                ),
            ),
            frame(3, &exchange(vec![1, 2, 3], vec![])),
            frame(3, &exchange(vec![], vec![record("cyd")])),
            frame(255, &[]),
            frame(12, &exchange(vec![], vec![record("dan")])),
        ]
        .concat(),
    ]
}

/// Payload of a log entry, with the layout of Raft's own types.
#[derive(Serialize)]
enum Payload {
    Blank,
    Normal(Vec<Command>),
    Membership((Vec<BTreeSet<u64>>, BTreeMap<u64, NodeId>)),
}

pub(super) fn raft() -> Vec<Vec<u8>> {
    type Log = (u64, u64);
    let (cluster, vote, last): (_, _, Option<Log>) = (Some(ClusterId(1)), ((3_u64, Some(7_u64)), true), Some((3, 4)));
    let voters = || (vec![BTreeSet::from([7_u64])], BTreeMap::from([(7_u64, slug::<NodeId>("ada"))]));
    let entries = vec![
        ((3_u64, 5_u64), Payload::Blank),
        ((3, 6), Payload::Normal(ledger_commands())),
        ((3, 7), Payload::Membership(voters())),
    ];
    let meta = (last, (last, voters()), "3-7-4@0007");
    let state = stored(&Ledger::default());
    let mut all = vec![
        encoded(&(cluster, (vote, last))),
        encoded(&(cluster, (vote, last, &entries, last))),
        encoded(&(cluster, (vote, &meta, 0_u64, &state, true))),
        encoded(&(cluster, (vote, "3-7-4@0007-crc00000000", 0_u64, vec![(4096_u32, 7_u128), (9, 8)]))),
        encoded(&(0_u32, (vote, vec![true, false]))),
        encoded(&(cluster, (vote, 8_u64))),
        stored(&(meta, &state)),
    ];
    all.extend(entries.iter().map(stored));
    all
}

pub(super) fn signed_envelopes() -> Vec<Vec<u8>> {
    let seal = |kind| {
        let statement = encoded_statement(NEWEST, RecordUpdate::Record(record("ada")));
        let by = Fingerprint([3; 16]);
        encode_envelope(
            kind,
            SignedEnvelope { signer: by, number: 9, signature: &[1; SIGNATURE_BYTES], payload: &statement },
        )
    };
    let ada = b"consort://ward/node/ada?roles=robot,voter";
    let message =
        |act: u8, key: &str, payload: Vec<u8>| [frame(act, ada), frame(0, key.as_bytes()), frame(0, &payload)].concat();
    let within = |message: Vec<u8>| encoded(&ClusterEnvelope { cluster: Some(ClusterId(1)), payload: message });
    vec![
        seal(MessageKind::Publication),
        seal(MessageKind::Query),
        seal(MessageKind::Reply(Fingerprint([3; 16]), 9)),
        message(0, "wire/knowledge/ada", encoded_statement(NEWEST, RecordUpdate::Record(record("ada")))),
        message(0, "wire/beacon", within(encoded(&beacon()))),
        message(1, "wire/report/bob", within(encoded(&report()))),
        message(1, "wire/raft/0000000000abcdef/vote", vec![]),
    ]
}

fn request() -> PersonRequestId {
    PersonRequestId { mission: slug("lab-samples-1"), number: 1 }
}

fn answer() -> PersonAnswer {
    let content = AnswerContent::Done(BTreeMap::from([("dust_g".to_owned(), Scalar::Integer(3))]));
    PersonAnswer { by: "Nia".to_owned(), content, note: String::new(), at_ms: 8 }
}
