//! Arbitrary missions, plans and records.

use consort_protocol::cause::CauseClass;
use consort_protocol::ids::{ClusterId, PlaceId, TaskType};
use consort_protocol::knowledge::{
    Attributes, Availability, ChargerClaim, Charging, Knowledge, Proof, Record, RecordStamp, RobotKnowledge,
};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{MapPart, Zone};
use consort_protocol::mission::{
    AlternativeMethod, DomainHash, DomainReference, Escalation, Method, Mission, OnLoss, ResultReference, Role,
    RoleKind, TaskBody, TaskNode, TaskOrder, TaskOutcome, TaskOutcomes, TaskSpec,
};
use consort_protocol::plan::{Alternative, LocalPlan, Signal, SignalKind, Step, StepAction};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::trust::Fingerprint;
use consort_protocol::units::{BatteryShare, EnergyLimit, MetresPerSecond, Seconds, SharePerSecond};
use consort_protocol::versions::VersionRange;
use proptest::collection::{btree_map, btree_set, vec};
use proptest::option;
use proptest::prelude::*;
use std::fmt::Debug;

pub(crate) fn name<T: TryFrom<String, Error: Debug> + Debug>() -> impl Strategy<Value = T> {
    "[a-zA-Z0-9_.-]{1,12}".prop_map(|text| T::try_from(text).expect("a slug"))
}

pub(crate) fn place() -> impl Strategy<Value = PlaceId> {
    "[A-Z][a-zäöü]{1,8} [0-9]{1,2}".prop_map(|text| PlaceId::new(text).expect("a label"))
}

pub(crate) fn cause_class() -> impl Strategy<Value = CauseClass> {
    prop_oneof![
        Just(CauseClass::Robot),
        Just(CauseClass::Task),
        Just(CauseClass::Transient),
        Just(CauseClass::Precondition),
    ]
}

pub(crate) fn speed() -> impl Strategy<Value = MetresPerSecond> {
    (0.01..9.0).prop_map(|speed| MetresPerSecond::new(speed).expect("a speed"))
}

pub(crate) fn map_part() -> impl Strategy<Value = MapPart> {
    prop_oneof![
        (place(), btree_set(place(), 0..3))
            .prop_map(|(name, places)| MapPart::Zone(Zone { name: name.into(), places })),
        place().prop_map(MapPart::Place),
        (place(), place()).prop_map(|(a, b)| MapPart::of_lane(a, b)),
    ]
}

pub(crate) fn text() -> impl Strategy<Value = String> {
    "\\PC{0,20}"
}

pub(crate) fn epoch() -> impl Strategy<Value = Epoch> {
    (any::<u64>(), any::<u64>()).prop_map(|(term, index)| Epoch { term, index })
}

pub(crate) fn stamp() -> impl Strategy<Value = RecordStamp> {
    (any::<u64>(), any::<u64>()).prop_map(|(incarnation, version)| RecordStamp { incarnation, version })
}

pub(crate) fn share() -> impl Strategy<Value = BatteryShare> {
    (0.0..=1.0).prop_map(|share| BatteryShare::new(share).expect("a share"))
}

pub(crate) fn seconds() -> impl Strategy<Value = Seconds> {
    (0.0..1e6).prop_map(|seconds| Seconds::new(seconds).expect("a time"))
}

fn domain() -> impl Strategy<Value = DomainReference> {
    let hash = any::<u64>().prop_map(DomainHash);
    (name(), hash).prop_map(|(name, hash)| DomainReference { name, hash })
}

pub(crate) fn spec() -> impl Strategy<Value = TaskSpec> {
    let items = (btree_map(name(), name(), 0..2), btree_set(name(), 0..2), any::<u8>());
    let input = (name(), text()).prop_map(|(task, result)| ResultReference { task, result });
    let used = (
        btree_map(text(), input, 0..2),
        vec(text(), 0..2),
        option::of(domain()),
        option::of(any::<u32>()),
        option::of(escalation()),
    );
    let entries = (btree_map(text(), text(), 0..3), btree_map(text(), text(), 0..2));
    (name(), vec(name(), 1..3), entries, items, used).prop_map(
        |(
            task_type,
            roles,
            (parameters, reaches),
            (acquires, releases, attempts),
            (inputs, conditions, domain, patience_s, escalation),
        )| {
            TaskSpec {
                task_type,
                roles,
                parameters,
                reaches,
                acquires,
                releases,
                attempts,
                patience_s,
                escalation,
                inputs,
                conditions,
                domain,
            }
        },
    )
}

pub(crate) fn escalation() -> impl Strategy<Value = Box<Escalation>> {
    (name(), any::<u32>()).prop_map(|(to, after_s)| Box::new(Escalation { to, after_s }))
}

pub(crate) fn scalar() -> impl Strategy<Value = Scalar> {
    prop_oneof![
        any::<bool>().prop_map(Scalar::Bool),
        any::<i64>().prop_map(Scalar::Integer),
        (-1e9..1e9).prop_map(Scalar::Number),
        text().prop_map(Scalar::Text),
    ]
}

pub(crate) fn outcomes() -> impl Strategy<Value = TaskOutcomes> {
    let done = btree_map(text(), scalar(), 0..3).prop_map(TaskOutcome::Done);
    btree_map(name(), prop_oneof![Just(TaskOutcome::Skipped), done], 0..3)
}

pub(crate) fn signal() -> impl Strategy<Value = Signal> {
    (any::<bool>(), name(), name(), name()).prop_map(|(done, task, from, to)| {
        let kind = if done { SignalKind::Done } else { SignalKind::Ready };
        Signal { kind, task, from, to }
    })
}

pub(crate) fn plan() -> impl Strategy<Value = LocalPlan> {
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

pub(crate) fn mission() -> impl Strategy<Value = Mission> {
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
    let role = (kind, on_loss, option::of(text()), any::<bool>());
    let role = role.prop_map(|(kind, on_loss, eligible, spread)| Role { kind, on_loss, eligible, spread });
    let energy_max = option::of((0.01..9.0).prop_map(|limit| EnergyLimit::new(limit).expect("a bound on energy")));
    let results = btree_map(text(), text(), 0..2);
    (name(), btree_map(name(), role, 0..4), vec(name(), 0..3), energy_max, vec(node, 0..6), results).prop_map(
        |(name, roles, ensembles, energy_max, tasks, results)| Mission {
            name,
            roles,
            ensembles,
            energy_max,
            tasks,
            results,
        },
    )
}

pub(crate) fn availability() -> impl Strategy<Value = Availability> {
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

fn charging() -> impl Strategy<Value = Charging> {
    let claim = || {
        (place(), share(), any::<Option<u64>>(), option::of(seconds()))
            .prop_map(|(charger, battery, lease, drive_s)| ChargerClaim { charger, battery, lease, drive_s })
    };
    prop_oneof![
        btree_set(place(), 0..3).prop_map(|chargers| Charging::Waiting { chargers }),
        claim().prop_map(Charging::Bound),
        claim().prop_map(Charging::Connected),
        place().prop_map(|to| Charging::Leaving { to }),
    ]
}

pub(crate) fn worker() -> impl Strategy<Value = RobotKnowledge> {
    let speed = option::of(speed());
    let pose = (-1e3..1e3, -1e3..1e3, -4.0..4.0).prop_map(|(x, y, yaw)| Pose::new(x, y, yaw));
    let rate = (0.0..1.0).prop_map(|rate| SharePerSecond::new(rate).expect("a rate"));
    let attributes = btree_map("[a-z_][a-z0-9_]{0,8}", scalar(), 0..3)
        .prop_map(|attributes| Attributes::try_from(attributes).expect("valid attributes"));
    let abilities = (btree_set(name::<TaskType>(), 0..5), attributes, speed, text());
    let state = (availability(), option::of(charging()));
    (abilities, place(), pose, share(), rate, share(), state).prop_map(
        |((skills, attributes, speed, estimator), place, pose, battery, discharge, useful_charge, state)| {
            let (availability, charging) = state;
            RobotKnowledge {
                skills,
                attributes,
                place,
                pose,
                battery,
                discharge,
                useful_charge,
                speed,
                availability,
                estimator,
                charging,
            }
        },
    )
}

pub(crate) fn record() -> impl Strategy<Value = Record> {
    let flags = (any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>());
    let numbers = (option::of(any::<u64>()), option::of(any::<u64>().prop_map(ClusterId)));
    let speaks = (any::<u8>(), any::<u8>()).prop_map(|(oldest, newest)| VersionRange { oldest, newest });
    let proof = option::of((any::<[u8; 16]>(), any::<[u8; 32]>()));
    let domains = btree_set(domain(), 0..3);
    (name(), stamp(), flags, numbers, speaks, option::of(worker()), domains, proof).prop_map(
        |(
            owner,
            stamp,
            (may_vote, stationary, mains_powered, leaving),
            (replica, cluster),
            speaks,
            worker,
            domains,
            proof,
        )| {
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
                    devices: Default::default(),
                    domains,
                },
                proof: proof.and_then(|(by, half)| Proof::new(Fingerprint(by), &[half, half].concat())),
            }
        },
    )
}
