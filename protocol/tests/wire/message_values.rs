//! Arbitrary messages of robots and the coordinator.

use crate::values::*;
use consort_protocol::ids::{RobotId, RoleId, TaskId};
use consort_protocol::lease::{Award, DeclineReason, EndReason, RoleHolder};
use consort_protocol::ledger::{PersonQuestion, Resource, TaskQuestion};
use consort_protocol::message::{
    AlarmNotice, AwardNotice, AwardReply, ClosureNotice, FailureKind, OrderNotice, OrdersNotice, QuestionAnswer,
    Report, ReportReply, SpeedLimitNotice, TaskFailure,
};
use proptest::collection::{btree_map, btree_set, vec};
use proptest::option;
use proptest::prelude::*;
use std::collections::BTreeMap;

pub(crate) fn ending() -> impl Strategy<Value = EndReason> {
    prop_oneof![
        Just(EndReason::Canceled),
        Just(EndReason::Failed),
        Just(EndReason::Over),
        Just(EndReason::Replaced),
        Just(EndReason::Released),
        Just(EndReason::NeedsIntervention),
    ]
}

pub(crate) fn holders() -> impl Strategy<Value = BTreeMap<RoleId, RoleHolder>> {
    btree_map(name(), (name(), epoch()).prop_map(|(robot, epoch)| RoleHolder { robot, epoch }), 0..3)
}

pub(crate) fn notice() -> impl Strategy<Value = AwardNotice> {
    let award = (name(), name(), name(), epoch(), plan(), holders())
        .prop_map(|(mission, role, robot, epoch, plan, holders)| Award { mission, role, robot, epoch, plan, holders });
    prop_oneof![
        award.prop_map(|award| AwardNotice::Awarded(Box::new(award))),
        (epoch(), ending()).prop_map(|(epoch, reason)| AwardNotice::Revoked { epoch, reason }),
        (epoch(), name(), any::<bool>()).prop_map(|(epoch, to, for_now)| AwardNotice::GiveWay { epoch, to, for_now }),
        orders().prop_map(|orders| AwardNotice::Orders(Box::new(orders))),
        (epoch(), any::<bool>(), text()).prop_map(|(epoch, repeat, cause)| AwardNotice::Return {
            epoch,
            repeat,
            cause
        }),
        (place(), epoch())
            .prop_map(|(charger, epoch)| AwardNotice::Leased { resource: Resource::Charger(charger), epoch }),
    ]
}

fn orders() -> impl Strategy<Value = OrdersNotice> {
    let order = || (text(), any::<Option<u64>>()).prop_map(|(text, remaining_ms)| OrderNotice { text, remaining_ms });
    let closure = (map_part(), order(), any::<Option<u64>>()).prop_map(|(part, order, until_ms)| ClosureNotice {
        part,
        order,
        until_ms,
    });
    let limit = (map_part(), speed(), any::<Option<u64>>()).prop_map(|(part, speed, remaining_ms)| SpeedLimitNotice {
        part,
        speed,
        remaining_ms,
    });
    let alarm = (order(), btree_set(place(), 0..3), btree_set(map_part(), 0..3))
        .prop_map(|(order, places, closes)| AlarmNotice { order, places, closes });
    let of_robot = (option::of(order()), option::of(order()), option::of(order()));
    (epoch(), of_robot, vec(closure, 0..3), vec(limit, 0..3), option::of(alarm)).prop_map(
        |(as_of, (hold, maintenance, stay), closures, speed_limits, alarm)| OrdersNotice {
            as_of,
            hold,
            maintenance,
            closures,
            stay,
            speed_limits,
            alarm,
        },
    )
}

pub(crate) fn award_answer() -> impl Strategy<Value = AwardReply> {
    prop_oneof![
        Just(AwardReply::Acknowledged),
        (name(), name()).prop_map(|(mission, role)| AwardReply::Declined(DeclineReason::Busy { mission, role })),
        epoch().prop_map(|known| AwardReply::Declined(DeclineReason::Stale { known })),
        name().prop_map(|robot| AwardReply::Declined(DeclineReason::WrongRobot { robot })),
    ]
}

pub(crate) fn report() -> impl Strategy<Value = Report> {
    let kind = prop_oneof![
        Just(FailureKind::Task),
        Just(FailureKind::Crash),
        Just(FailureKind::NoProgress),
        Just(FailureKind::Battery),
        Just(FailureKind::Leaving),
        Just(FailureKind::Plan),
        Just(FailureKind::GaveWay),
        Just(FailureKind::UnknownResult),
        Just(FailureKind::Postponed),
        Just(FailureKind::Reassigned),
    ];
    let failure = (option::of(name()), text(), kind, cause_class(), any::<bool>())
        .prop_map(|(task, cause, kind, class, moved_nothing)| TaskFailure { task, cause, kind, class, moved_nothing });
    let who = (name::<RobotId>(), any::<u64>(), name(), name(), epoch());
    let how = (option::of(place()), any::<bool>(), option::of(failure), option::of(task_question()));
    (who, btree_set(any::<u32>(), 0..5), outcomes(), option::of(name::<TaskId>()), how).prop_map(
        |((robot, incarnation, mission, role, epoch), ended, outcomes, at, (place, resumes, failure, question))| {
            Report {
                robot,
                incarnation,
                mission,
                role,
                epoch,
                ended,
                outcomes,
                current_task: at,
                place,
                from_checkpoint: resumes,
                failure,
                question,
            }
        },
    )
}

pub(crate) fn task_question() -> impl Strategy<Value = TaskQuestion> {
    let question = (name(), text(), option::of(place()), option::of(any::<u32>()), option::of(escalation())).prop_map(
        |(to, message, at, patience_s, escalation)| PersonQuestion { to, message, at, patience_s, escalation },
    );
    (name(), any::<u32>(), question, any::<bool>()).prop_map(|(task, number, question, is_open)| TaskQuestion {
        task,
        number,
        question,
        is_open,
    })
}

fn question_answer() -> impl Strategy<Value = QuestionAnswer> {
    (name(), any::<u32>(), any::<bool>(), text()).prop_map(|(task, number, is_answered, text)| QuestionAnswer {
        task,
        number,
        is_answered,
        text,
    })
}

pub(crate) fn report_answer() -> impl Strategy<Value = ReportReply> {
    prop_oneof![
        (
            epoch(),
            btree_set(any::<u32>(), 0..5),
            holders(),
            btree_set(signal(), 0..4),
            outcomes(),
            option::of(question_answer()),
            orders().prop_map(Box::new)
        )
            .prop_map(|(epoch, ended, holders, signals, outcomes, answer, orders)| ReportReply::Renewed {
                epoch,
                ended,
                holders,
                signals,
                outcomes,
                answer,
                orders
            }),
        (epoch(), ending(), option::of(epoch())).prop_map(|(epoch, reason, current)| ReportReply::Ended {
            epoch,
            reason,
            current
        }),
        option::of(name()).prop_map(|coordinator| ReportReply::NotCoordinator { coordinator }),
    ]
}
