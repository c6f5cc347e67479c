//! Arbitrary auctions and ledger commands.

use crate::message_values::task_question;
use crate::values::*;
use consort_protocol::auction::{
    AuctionEntry, AuctionId, AuctionRecord, Bid, BidPart, BidVerdict, ChargingStop, NotAskedReason, Objective,
    PlannedRole, PresentRole, PromisedRole, RefusalReason, RoleOfMission, RoleSpan, Timelines, ViabilityError,
};
use consort_protocol::ids::{ClusterId, MissionId, PlaceId, RequestId, RobotId, RoleId};
use consort_protocol::ledger::{
    AlarmChange, AlarmPlan, AlarmResponse, AnswerContent, Branch, ClosureChange, Command, CommandError, CommandOutcome,
    HeldItem, HistoryLimits, MissedOccurrences, MissionCancelation, MissionChange, MissionState, OrderChange,
    OrderRequest, PersonAnswer, PersonRequestId, Priority, PromiseMove, RecoveryBranch, Resource, Schedule,
    SchedulePause, ScheduleRule, SpeedLimitChange, Submission,
};
use consort_protocol::mission::{NumberRange, ValueKind};
use consort_protocol::plan::Division;
use consort_protocol::units::Energy;
use proptest::collection::{btree_map, btree_set, vec};
use proptest::option;
use proptest::prelude::*;
use proptest::sample::select;
use std::collections::BTreeMap;
use std::fmt::Debug;

pub(crate) fn auction() -> impl Strategy<Value = AuctionId> {
    (name(), any::<u64>(), any::<u32>()).prop_map(|(mission, term, round)| AuctionId { mission, term, round })
}

pub(crate) fn part() -> impl Strategy<Value = BidPart> {
    (any::<u32>(), text(), name(), seconds(), 0.0..2.0).prop_map(|(step, label, skill, time, energy)| BidPart {
        step,
        label,
        skill,
        time,
        energy,
    })
}

fn role_of_mission() -> impl Strategy<Value = RoleOfMission> {
    (name(), name()).prop_map(|(mission, role)| RoleOfMission { mission, role })
}

fn span() -> impl Strategy<Value = RoleSpan> {
    (option::of(place()), option::of(place()), seconds(), 0.0..2.0).prop_map(|(from, to, time, energy)| RoleSpan {
        from,
        to,
        time,
        energy: Energy::of_share(energy),
    })
}

fn planned() -> impl Strategy<Value = PlannedRole> {
    let position = (seconds(), option::of(role_of_mission()), any::<u32>(), any::<u32>());
    let charging = (place(), seconds(), share(), share()).prop_map(|(charger, time, until, remaining)| ChargingStop {
        charger,
        time,
        until,
        remaining,
    });
    let charging = option::of(charging);
    (span(), position, seconds(), seconds(), 0.0..2.0, -1.0..1.0, charging).prop_map(
        |(span, (start, before, delayed, promised), delay, delay_max, energy, detour_energy, charging)| PlannedRole {
            span,
            start,
            before,
            delay,
            delayed,
            delay_max,
            promised,
            energy: Energy::of_share(energy),
            detour_energy,
            charging,
        },
    )
}

pub(crate) fn timelines() -> impl Strategy<Value = Timelines> {
    let objective = prop_oneof![
        Just(Objective::EarliestEnd),
        Just(Objective::LeastEnergy),
        seconds().prop_map(|battery_s| Objective::Weighted { battery_s }),
    ];
    let promised = (name(), role_of_mission(), span(), option::of(seconds()), seconds(), any::<bool>()).prop_map(
        |(robot, role, span, slack, release, charges)| PromisedRole { robot, role, span, slack, release, charges },
    );
    let releases = btree_map(name(), seconds(), 0..3);
    (objective, vec(promised, 0..3), btree_set(name(), 0..3), option::of(seconds()), releases).prop_map(
        |(objective, promised, startable, ends_within, releases)| Timelines {
            objective,
            promised,
            startable,
            ends_within,
            releases,
        },
    )
}

pub(crate) fn bid() -> impl Strategy<Value = Bid> {
    let present = (name(), name(), seconds()).prop_map(|(mission, role, time)| PresentRole { mission, role, time });
    let of_plan = (vec(part(), 0..4), option::of(present), option::of(planned().prop_map(Box::new)));
    (name(), name(), seconds(), 0.0..2.0, -1.0..1.0, share(), place(), any::<u64>(), of_plan).prop_map(
        |(robot, role, time, energy, remaining, useful_charge, from, age_ms, (parts, present, planned))| Bid {
            robot,
            role,
            time,
            energy,
            remaining,
            useful_charge,
            from,
            age_ms,
            parts,
            present,
            planned,
        },
    )
}

pub(crate) fn reason() -> impl Strategy<Value = RefusalReason> {
    prop_oneof![
        vec(name(), 0..4).prop_map(|skills| RefusalReason::MissingSkills { skills }),
        (name(), name()).prop_map(|(mission, role)| RefusalReason::Busy { mission, role }),
        (name(), text()).prop_map(|(task, problem)| RefusalReason::NotFeasible { task, problem }),
        text().prop_map(|problem| RefusalReason::OutOfService { problem }),
        text().prop_map(|why| RefusalReason::NotMember { why }),
        (text(), any::<bool>()).prop_map(|(why, permanent)| RefusalReason::NotEligible { why, permanent }),
        name().prop_map(|ensemble| RefusalReason::NotPreferred { ensemble }),
        any::<u64>().prop_map(|window_ms| RefusalReason::Silent { window_ms }),
        (name(), name()).prop_map(|(item, mission)| RefusalReason::CarriesItem { item, mission }),
        text().prop_map(|cause| RefusalReason::Excluded { cause }),
        (option::of(place()), text())
            .prop_map(|(charger, problem)| RefusalReason::ChargerOutOfReach { charger, problem }),
    ]
}

fn not_asked_reason() -> impl Strategy<Value = NotAskedReason> {
    let skills = vec(name(), 0..4).prop_map(|skills| NotAskedReason::MissingSkills { skills });
    let fixed = [
        NotAskedReason::NotNeeded,
        NotAskedReason::Busy,
        NotAskedReason::OutOfService,
        NotAskedReason::NotEligible,
        NotAskedReason::NotFeasible,
        NotAskedReason::Restricted,
    ];
    prop_oneof![skills, select(fixed.to_vec())]
}

pub(crate) fn auction_record() -> impl Strategy<Value = AuctionRecord> {
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
        (not_asked_reason(), 0.0..2.0, btree_set(name(), 0..4))
            .prop_map(|(reason, cost_min, others)| BidVerdict::NotAsked { reason, cost_min, others }),
    ];
    let entry = (name(), name(), verdict, vec(part(), 0..3)).prop_map(|(role, robot, verdict, parts)| AuctionEntry {
        role,
        robot,
        verdict,
        parts,
    });
    let (chosen, promised) = (btree_map(name(), name(), 0..3), btree_map(name(), seconds(), 0..3));
    let plans = btree_map(name(), planned(), 0..3);
    (auction(), any::<u64>(), vec(entry, 0..4), any::<u32>(), chosen, promised, option::of(text()), plans).prop_map(
        |(auction, at_ms, entries, omitted, chosen, promised, failure, planned)| AuctionRecord {
            auction,
            at_ms,
            entries,
            omitted,
            chosen,
            promised,
            failure,
            planned,
        },
    )
}

pub(crate) fn submission() -> impl Strategy<Value = Submission> {
    let division = btree_map(name(), plan(), 0..3).prop_map(|plans| Division { plans });
    let division = division.boxed();
    let recovery = (mission(), division.clone()).prop_map(|(mission, division)| RecoveryBranch { mission, division });
    let priority = (-100i64..=100).prop_map(|number| Priority::new(number).expect("a priority"));
    let kind = prop_oneof![
        Just(ValueKind::Bool),
        (-1e9..1e9).prop_map(|at| ValueKind::Number(NumberRange { minimum: Some(at), maximum: None })),
        btree_set(text(), 1..3).prop_map(ValueKind::OneOf),
    ];
    let forms = btree_map(name(), btree_map(text(), kind, 0..3), 0..2);
    let times = (option::of(any::<u64>()), option::of(any::<u64>()));
    let how = (option::of(recovery), priority, times, forms, text());
    (name::<RequestId>(), mission(), division, btree_map(text(), text(), 0..3), how, any::<u64>()).prop_map(
        |(request, mission, division, parameters, (recovery, priority, times, forms, by), at_ms)| Submission {
            request,
            mission,
            division,
            parameters,
            recovery,
            forms,
            by,
            priority,
            not_before_ms: times.0,
            deadline_ms: times.1,
            at_ms,
        },
    )
}

fn schedule() -> impl Strategy<Value = Box<Schedule>> {
    let missed =
        prop_oneof![Just(MissedOccurrences::Skip), Just(MissedOccurrences::Last), Just(MissedOccurrences::All)];
    let rule = (text(), text(), option::of(any::<u64>()), missed);
    let rule = rule.prop_map(|(cron, zone, until_ms, missed)| ScheduleRule { cron, zone, until_ms, missed });
    (name(), rule, submission(), option::of(any::<u64>())).prop_map(|(id, rule, submission, deadline_after_ms)| {
        Box::new(Schedule { id, rule, submission, deadline_after_ms })
    })
}

pub(crate) fn command() -> impl Strategy<Value = Command> {
    let held = || (name::<MissionId>(), name::<RoleId>(), epoch());
    prop_oneof![
        any::<u64>().prop_map(|cluster| Command::Bootstrap { cluster: ClusterId(cluster) }),
        submission().prop_map(|submission| Command::Submit(Box::new(submission))),
        (name(), branch(), btree_map(name(), name(), 0..3), auction_record())
            .prop_map(|(mission, branch, holders, auction)| Command::Award { mission, branch, holders, auction }),
        held().prop_map(|(mission, role, epoch)| Command::AwardPromised { mission, role, epoch }),
        held().prop_map(|(mission, role, epoch)| Command::Postpone { mission, role, epoch }),
        (held(), name(), text(), auction_record()).prop_map(|((mission, role, epoch), robot, cause, auction)| {
            Command::MovePromise(Box::new(PromiseMove { mission, role, epoch, robot, cause, auction }))
        }),
        (name(), branch(), auction_record()).prop_map(|(mission, branch, auction)| Command::Defer {
            mission,
            branch,
            auction
        }),
        (held(), any::<u64>(), any::<bool>()).prop_map(|((mission, role, epoch), incarnation, resumes)| {
            Command::Accept { mission, role, epoch, incarnation, from_checkpoint: resumes }
        }),
        (held(), branch(), btree_set(any::<u32>(), 0..5), outcomes()).prop_map(|(held, branch, ended, outcomes)| {
            let (mission, role, epoch) = held;
            Command::Progress { mission, role, epoch, branch, ended, outcomes }
        }),
        (held(), text(), option::of(cause_class()), any::<[bool; 2]>(), option::of(place())).prop_map(
            |((mission, role, epoch), cause, class, [moved_nothing, gave_way], place)| Command::Release {
                mission,
                role,
                epoch,
                cause,
                class,
                moved_nothing,
                place,
                gave_way
            }
        ),
        (name(), text(), option::of(branch()), places(), cause_class()).prop_map(
            |(mission, cause, branch, places, class)| Command::Fail { mission, cause, branch, places, class }
        ),
        (name(), text(), places(), any::<u64>()).prop_map(|(mission, by, places, at_ms)| Command::Cancel {
            mission,
            by,
            places,
            at_ms
        }),
        (name(), text(), any::<u64>()).prop_map(|(mission, by, at_ms)| Command::Resolve { mission, by, at_ms }),
        (name(), branch(), name(), any::<u32>(), any::<u64>()).prop_map(|(mission, branch, role, step, asked_ms)| {
            Command::AskPerson { mission, branch, role, step, asked_ms }
        }),
        (name(), name(), epoch(), task_question(), any::<u64>()).prop_map(
            |(mission, role, epoch, question, asked_ms)| Command::SetQuestion {
                mission,
                role,
                epoch,
                question,
                asked_ms
            }
        ),
        (person_request(), answer(), places()).prop_map(|(request, answer, places)| Command::AnswerPerson {
            request,
            answer,
            places
        }),
        (person_request(), any::<u64>(), places()).prop_map(|(request, now_ms, places)| Command::ExpirePersonRequest {
            request,
            now_ms,
            places
        }),
        (schedule(), any::<u64>()).prop_map(|(schedule, from_ms)| Command::AddSchedule { schedule, from_ms }),
        (name(), text(), any::<u64>()).prop_map(|(schedule, by, at_ms)| Command::RemoveSchedule {
            schedule,
            by,
            at_ms
        }),
        (name(), text(), any::<u64>()).prop_map(|(schedule, by, since_ms)| {
            Command::PauseSchedule { schedule, pause: SchedulePause { by, since_ms } }
        }),
        (name(), any::<u64>(), text()).prop_map(|(schedule, at_ms, by)| Command::ResumeSchedule {
            schedule,
            at_ms,
            by
        }),
        (name(), any::<[u64; 3]>()).prop_map(|(schedule, [after_ms, due_ms, at_ms])| {
            Command::SubmitOccurrence { schedule, after_ms, due_ms, at_ms }
        }),
        (name(), any::<[u64; 2]>())
            .prop_map(|(schedule, [after_ms, until_ms])| { Command::SkipOccurrences { schedule, after_ms, until_ms } }),
        (person_request(), any::<u64>())
            .prop_map(|(request, now_ms)| Command::EscalatePersonRequest { request, now_ms }),
        (btree_set(name(), 0..3), order_request(order_change()))
            .prop_map(|(robots, order)| Command::OrderRobots { robots, order }),
        any::<u64>().prop_map(|now_ms| Command::ExpireOrders { now_ms }),
        btree_set(name(), 0..3).prop_map(|robots| Command::EndOrders { robots }),
        (place(), name(), any::<u64>()).prop_map(|(charger, robot, at_ms)| Command::LeaseResource {
            resource: Resource::Charger(charger),
            robot,
            at_ms
        }),
        (name(), epoch())
            .prop_map(|(device, epoch)| Command::FreeResource { resource: Resource::Device(device), epoch }),
        order_request(btree_map(name(), places(), 0..3).prop_map(|missions| MissionCancelation { missions }))
            .prop_map(|order| Command::CancelMissions { order }),
        (name(), order_request(mission_change()))
            .prop_map(|(mission, order)| Command::ChangeMission { mission, order }),
        (btree_set(map_part(), 0..3), order_request(closure_change()))
            .prop_map(|(parts, order)| Command::ChangeClosures { parts, order }),
        (btree_set(map_part(), 0..3), order_request(speed_limit_change()))
            .prop_map(|(parts, order)| Command::ChangeSpeedLimits { parts, order }),
        order_request(alarm_change()).prop_map(|order| Command::ChangeAlarms { order }),
        (any::<u8>(), text(), any::<u64>()).prop_map(|(wire, by, at_ms)| Command::RaiseWireVersion { wire, by, at_ms }),
        (any::<u32>(), any::<u64>(), any::<u64>()).prop_map(|(missions_max, outcome_age_max_ms, outcome_bytes_max)| {
            Command::SetHistoryLimits(HistoryLimits { missions_max, outcome_age_max_ms, outcome_bytes_max })
        }),
    ]
}

fn order_request<Change: Debug>(change: impl Strategy<Value = Change>) -> impl Strategy<Value = OrderRequest<Change>> {
    (change, text(), any::<u64>(), option::of(name())).prop_map(|(change, by, at_ms, request)| OrderRequest {
        change,
        by,
        at_ms,
        request,
    })
}

fn mission_change() -> impl Strategy<Value = MissionChange> {
    prop_oneof![
        (-100i64..=100).prop_map(|number| MissionChange::SetPriority(Priority::new(number).unwrap())),
        (name(), option::of(name()), any::<bool>()).prop_map(|(role, to, repeat)| MissionChange::Reassign {
            role,
            to,
            repeat
        }),
        (name(), option::of(name())).prop_map(|(role, robot)| MissionChange::Pin { role, robot }),
    ]
}

fn closure_change() -> impl Strategy<Value = ClosureChange> {
    prop_oneof![
        (any::<Option<u64>>(), text()).prop_map(|(until_ms, reason)| ClosureChange::Close { until_ms, reason }),
        Just(ClosureChange::Open),
    ]
}

fn speed_limit_change() -> impl Strategy<Value = SpeedLimitChange> {
    prop_oneof![
        (speed(), any::<Option<u64>>(), text()).prop_map(|(speed, until_ms, reason)| SpeedLimitChange::Set {
            speed,
            until_ms,
            reason
        }),
        Just(SpeedLimitChange::Clear),
    ]
}

fn alarm_change() -> impl Strategy<Value = AlarmChange> {
    let response = prop_oneof![Just(AlarmResponse::Stop), Just(AlarmResponse::Assemble)];
    let plan = (response, btree_set(place(), 0..3), btree_set(map_part(), 0..3))
        .prop_map(|(robots, places, closes)| AlarmPlan { robots, places, closes });
    prop_oneof![
        (name(), plan, text()).prop_map(|(alarm, plan, reason)| AlarmChange::Raise { alarm, plan, reason }),
        option::of(name()).prop_map(|alarm| AlarmChange::Clear { alarm }),
    ]
}

fn order_change() -> impl Strategy<Value = OrderChange> {
    prop_oneof![
        (any::<u64>(), text()).prop_map(|(until_ms, reason)| OrderChange::Hold { until_ms, reason }),
        Just(OrderChange::Release),
        (any::<Option<u64>>(), text()).prop_map(|(until_ms, reason)| OrderChange::Maintain { until_ms, reason }),
        Just(OrderChange::EndMaintenance),
    ]
}

fn person_request() -> impl Strategy<Value = PersonRequestId> {
    (name(), 1u32..).prop_map(|(mission, number)| PersonRequestId { mission, number })
}

fn answer() -> impl Strategy<Value = PersonAnswer> {
    let results = outcomes()
        .prop_map(|outcomes| outcomes.into_values().find_map(|outcome| outcome.results().cloned()).unwrap_or_default());
    let content = prop_oneof![
        results.prop_map(AnswerContent::Done),
        Just(AnswerContent::Declined),
        Just(AnswerContent::Cannot),
        any::<u64>().prop_map(AnswerContent::Later),
    ];
    (text(), content, text(), any::<u64>()).prop_map(|(by, content, note, at_ms)| PersonAnswer {
        by,
        content,
        note,
        at_ms,
    })
}

pub(crate) fn branch() -> impl Strategy<Value = Branch> {
    prop_oneof![Just(Branch::Main), Just(Branch::Recovery)]
}

pub(crate) fn places() -> impl Strategy<Value = BTreeMap<RobotId, PlaceId>> {
    btree_map(name(), place(), 0..3)
}

pub(crate) fn stranded() -> impl Strategy<Value = HeldItem> {
    (name(), name(), name(), option::of(place()), any::<bool>())
        .prop_map(|(item, role, robot, place, certain)| HeldItem { item, role, robot, place, certain })
}

pub(crate) fn outcome() -> impl Strategy<Value = CommandOutcome> {
    prop_oneof![
        (name(), any::<bool>()).prop_map(|(mission, again)| CommandOutcome::Submitted { mission, again }),
        epoch().prop_map(|epoch| CommandOutcome::Awarded { epoch }),
        Just(CommandOutcome::Done),
        (name(), text(), cause_class()).prop_map(|(mission, cause, class)| {
            let state = MissionState::Failed { cause, class };
            CommandOutcome::Refused(CommandError::MissionEnded { mission, state })
        }),
        (name(), text(), vec(stranded(), 0..3), cause_class()).prop_map(|(mission, cause, items, class)| {
            let state = MissionState::NeedsIntervention { cause, items, class };
            CommandOutcome::Refused(CommandError::MissionEnded { mission, state })
        }),
        (name(), name(), name()).prop_map(|(robot, item, mission)| CommandOutcome::Refused(
            CommandError::CarriesItem { robot, item, mission }
        )),
        (name(), text()).prop_map(|(mission, state)| CommandOutcome::Refused(CommandError::NoInterventionNeeded {
            mission,
            state
        })),
        (person_request(), text())
            .prop_map(|(request, phase)| CommandOutcome::Refused(CommandError::PersonRequestClosed { request, phase })),
        (name(), name(), option::of(epoch())).prop_map(|(mission, role, held)| CommandOutcome::Refused(
            CommandError::StaleEpoch { mission, role, held }
        )),
    ]
}
