//! Events in JSON, published as they happen, for people and programs to follow. Each node publishes
//! them on its own key, `consort/{fleet}/events/{node}`.

use crate::auction::{AuctionRecord, Bid};
use crate::cause::CauseClass;
use crate::ids::{
    AlarmId, ClusterId, DeviceId, EnsembleId, MissionId, NodeId, PlaceId, RobotId, RoleId, ScheduleId, TaskId,
};
use crate::lease::{EndReason, Epoch};
use crate::ledger::{Alarm, MapPart, MissionState, Priority, RobotOrder, RobotOrders};
use crate::message::FailureKind;
use crate::plan::Signal;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Event of a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Event {
    /// Node where it happened.
    pub node: NodeId,
    /// Number of the event since the node's start, from 1: a gap means loss.
    pub sequence: u64,
    /// Time on the node's wall clock, in milliseconds.
    pub at_ms: u64,
    /// Kind of event with its fields.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// Kinds of events.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum EventKind {
    /// A node became coordinator.
    Elected {
        /// Term of the coordinator.
        term: u64,
        /// Voters of the ledger.
        voters: Vec<NodeId>,
    },
    /// A node is no longer coordinator, or can no longer confirm that it is.
    SteppedDown {
        /// Term in which it was coordinator.
        term: u64,
    },
    /// A node coordinates another cluster under this fleet's name: two clusters were created
    /// separately. They do not merge.
    Foreign {
        /// Cluster of the reporting node.
        cluster: ClusterId,
        /// The other cluster.
        foreign: ClusterId,
        /// A node of the other cluster.
        member: NodeId,
    },
    /// The coordinator changed the voters of the ledger.
    Voters {
        /// Voters from now on.
        voters: Vec<NodeId>,
        /// Change and its reason.
        reason: String,
    },
    /// The coordinator counts a node among an ensemble's members.
    Joined {
        /// The ensemble.
        ensemble: EnsembleId,
        /// The node.
        member: NodeId,
    },
    /// The coordinator no longer counts a node among an ensemble's members.
    Left {
        /// The ensemble.
        ensemble: EnsembleId,
        /// The node.
        member: NodeId,
        /// Reason.
        reason: String,
    },
    /// A mission request was committed and acknowledged.
    Submitted {
        /// The mission.
        mission: MissionId,
        /// Its parameters.
        parameters: BTreeMap<String, String>,
    },
    /// A person added, paused, resumed or removed a schedule.
    ScheduleChanged {
        /// The schedule.
        schedule: ScheduleId,
        /// The change.
        change: ScheduleChange,
        /// The responsible person; in a closed fleet with the signer.
        by: String,
    },
    /// A person changed the priority of a mission.
    PriorityChanged {
        /// The mission.
        mission: MissionId,
        /// Its priority from now on.
        priority: Priority,
    },
    /// The order of a person about a role has changed: it was given, followed or ended.
    RoleOrdered {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The order as text, such as `pinned to amber`; null if it has ended.
        order: Option<String>,
    },
    /// The orders of people to a robot have changed: a person gave or ended an order, or its time has passed.
    RobotOrders {
        /// The robot.
        robot: RobotId,
        /// Its orders from now on.
        orders: RobotOrders,
    },
    /// A person raised or cleared an alarm.
    AlarmChanged {
        /// The alarm.
        alarm: AlarmId,
        /// The alarm in force from now on; null once it is cleared.
        raised: Option<Alarm>,
    },
    /// The closure of a zone, place or lane has changed: a person closed or opened it, or its time has passed.
    ClosureChanged {
        /// The zone, place or lane.
        part: MapPart,
        /// Who closed it, why, and until when; null if it is open from now on.
        order: Option<RobotOrder>,
    },
    /// The coordinator has leased a charger to a robot.
    ChargerLeased {
        /// Place of the charger.
        charger: PlaceId,
        /// The robot.
        robot: RobotId,
    },
    /// The lease of a charger has ended.
    ChargerFreed {
        /// Place of the charger.
        charger: PlaceId,
        /// The robot that had the lease.
        robot: RobotId,
        /// Cause.
        cause: String,
    },
    /// The coordinator has leased a device of the building to a robot.
    DeviceLeased {
        /// The device.
        device: DeviceId,
        /// The robot.
        robot: RobotId,
    },
    /// The lease of a device has ended.
    DeviceFreed {
        /// The device.
        device: DeviceId,
        /// The robot that had the lease.
        robot: RobotId,
        /// Cause.
        cause: String,
    },
    /// An occurrence of a schedule was submitted.
    OccurrenceSubmitted {
        /// The schedule.
        schedule: ScheduleId,
        /// Time at which it was due, in milliseconds since 1970.
        due_ms: u64,
        /// Its mission.
        mission: MissionId,
    },
    /// The coordinator sent a call for bids to the members.
    #[serde(alias = "called")]
    BidsRequested {
        /// The mission.
        mission: MissionId,
        /// Open roles of the mission.
        roles: Vec<RoleId>,
        /// Round of the auction.
        round: u32,
        /// Number of robots that received the first call. An auction in a large fleet may call others later.
        asked: usize,
    },
    /// A robot sent a bid.
    Bid {
        /// The mission.
        mission: MissionId,
        /// Bid of the robot, with its parts.
        bid: Bid,
    },
    /// An auction was closed; the record contains every reply.
    Closed {
        /// The mission.
        mission: MissionId,
        /// Replies received and decision.
        record: AuctionRecord,
    },
    /// Roles were awarded.
    Awarded {
        /// The mission.
        mission: MissionId,
        /// Robot of each awarded role.
        holders: BTreeMap<RoleId, RobotId>,
        /// Robot of each promised role. Another award follows.
        #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
        promised: BTreeMap<RoleId, RobotId>,
        /// Epoch of the award.
        epoch: Epoch,
        /// Time from the commit of the request to the commit of the award, in milliseconds.
        after_ms: Option<f64>,
    },
    /// A role was released from its holder.
    Released {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Reason.
        cause: String,
    },
    /// A mission's state changed.
    Mission {
        /// The mission.
        mission: MissionId,
        /// State of the mission.
        state: MissionState,
        /// Time of the request, in milliseconds of the wall clock of the coordinator at that time.
        submitted_at_ms: u64,
    },
    /// A role's steps have ended.
    Progress {
        /// The mission.
        mission: MissionId,
        /// Steps ended, over all managed roles.
        done: usize,
        /// Total number of steps.
        steps: usize,
    },
    /// A robot started its plan.
    Started {
        /// The mission.
        mission: MissionId,
        /// Role of the robot.
        role: RoleId,
        /// Epoch of the award.
        epoch: Epoch,
    },
    /// A task began.
    TaskBegan {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task.
        task: TaskId,
    },
    /// A task succeeded.
    TaskEnded {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task.
        task: TaskId,
    },
    /// A task was skipped: its condition does not hold.
    TaskSkipped {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task.
        task: TaskId,
    },
    /// Nobody has answered the request for a task, or a robot's question: people with another role
    /// are asked, too.
    Escalated {
        /// The mission.
        mission: MissionId,
        /// Role of the people that were asked first.
        role: RoleId,
        /// The task; for a question, the task in which the robot asks.
        task: TaskId,
        /// Role of the other people.
        to: RoleId,
    },
    /// A robot asks people a question.
    QuestionAsked {
        /// The mission.
        mission: MissionId,
        /// Role of the people.
        role: RoleId,
        /// Task in which the robot asks.
        task: TaskId,
        /// The question.
        message: String,
    },
    /// A person has answered the question of a robot.
    QuestionAnswered {
        /// The mission.
        mission: MissionId,
        /// Role of the people that were asked first.
        role: RoleId,
        /// Task in which the robot asks.
        task: TaskId,
    },
    /// A question was declined, has expired or was withdrawn. The robot decides how to go on.
    QuestionClosed {
        /// The mission.
        mission: MissionId,
        /// Role of the people that were asked first.
        role: RoleId,
        /// Task in which the robot asks.
        task: TaskId,
        /// Reason.
        cause: String,
    },
    /// A task failed permanently.
    TaskFailed {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task.
        task: TaskId,
        /// Reason.
        cause: String,
        /// Class of the reason.
        class: CauseClass,
    },
    /// A role sent a signal to another role.
    Sent {
        /// The mission.
        mission: MissionId,
        /// Signal.
        signal: Signal,
    },
    /// A role received a signal that it waited for.
    #[serde(alias = "heard")]
    Received {
        /// The mission.
        mission: MissionId,
        /// Signal.
        signal: Signal,
    },
    /// A robot stopped safely because its lease was not renewed.
    Suspended {
        /// The mission.
        mission: MissionId,
        /// Role of the robot.
        role: RoleId,
        /// Time until the lease ends, in milliseconds: above 0 if the robot stops early, since its goal may stop slowly.
        #[serde(default)]
        lease_left_ms: u64,
    },
    /// A robot resumed its plan after its lease was renewed.
    Resumed {
        /// The mission.
        mission: MissionId,
        /// Role of the robot.
        role: RoleId,
    },
    /// A robot stopped executing its role.
    Halted {
        /// The mission.
        mission: MissionId,
        /// Role of the robot.
        role: RoleId,
        /// Reason.
        reason: EndReason,
    },
    /// An attempt at a task failed; the robot retries it.
    TaskRetried {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task.
        task: TaskId,
        /// Number of attempts so far.
        attempt: u8,
        /// Cause of the failure.
        cause: String,
    },
    /// A task failed permanently; the robot executes an alternative of the mission.
    Alternative {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task that failed.
        task: TaskId,
        /// Number of the alternative in the role's plan, from 0.
        alternative: usize,
        /// Tasks executed instead.
        tasks: Vec<TaskId>,
        /// Cause of the failure.
        cause: String,
    },
    /// A robot cannot complete its role and asks for a replacement.
    GaveUp {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Kind of failure.
        kind: FailureKind,
        /// Cause, as text.
        cause: String,
    },
    /// The battery will not last for the rest of the plan, and the robot continues nevertheless: it
    /// may carry an item, and stopping on the way would not help.
    #[serde(alias = "charge_short")]
    LowCharge {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Forecast, as text.
        cause: String,
    },
    /// A signal was ignored, since it was sent under an award that is no longer in force.
    #[serde(alias = "outdated")]
    StaleSignal {
        /// The mission.
        mission: MissionId,
        /// Signal ignored.
        signal: Signal,
        /// Epoch under which it was sent.
        epoch: Epoch,
        /// Latest epoch of that role at the receiver.
        known: Epoch,
        /// Number of such signals at this node since its start.
        count: u64,
    },
}

/// Change of a schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScheduleChange {
    /// It was added.
    Added,
    /// It was paused.
    Paused,
    /// It was resumed.
    Resumed,
    /// It was removed.
    Removed,
}

impl ScheduleChange {
    /// Returns the name.
    pub fn as_str(self) -> &'static str {
        match self {
            ScheduleChange::Added => "added",
            ScheduleChange::Paused => "paused",
            ScheduleChange::Resumed => "resumed",
            ScheduleChange::Removed => "removed",
        }
    }
}

impl EventKind {
    /// Returns the name of the kind: the field `event` of its JSON.
    pub fn as_str(&self) -> &'static str {
        match self {
            EventKind::Elected { .. } => "elected",
            EventKind::SteppedDown { .. } => "stepped_down",
            EventKind::Foreign { .. } => "foreign",
            EventKind::Voters { .. } => "voters",
            EventKind::Joined { .. } => "joined",
            EventKind::Left { .. } => "left",
            EventKind::Submitted { .. } => "submitted",
            EventKind::ScheduleChanged { .. } => "schedule_changed",
            EventKind::PriorityChanged { .. } => "priority_changed",
            EventKind::RoleOrdered { .. } => "role_ordered",
            EventKind::RobotOrders { .. } => "robot_orders",
            EventKind::AlarmChanged { .. } => "alarm_changed",
            EventKind::ClosureChanged { .. } => "closure_changed",
            EventKind::ChargerLeased { .. } => "charger_leased",
            EventKind::ChargerFreed { .. } => "charger_freed",
            EventKind::DeviceLeased { .. } => "device_leased",
            EventKind::DeviceFreed { .. } => "device_freed",
            EventKind::OccurrenceSubmitted { .. } => "occurrence_submitted",
            EventKind::BidsRequested { .. } => "bids_requested",
            EventKind::Bid { .. } => "bid",
            EventKind::Closed { .. } => "closed",
            EventKind::Awarded { .. } => "awarded",
            EventKind::Released { .. } => "released",
            EventKind::Mission { .. } => "mission",
            EventKind::Progress { .. } => "progress",
            EventKind::Started { .. } => "started",
            EventKind::TaskBegan { .. } => "task_began",
            EventKind::TaskEnded { .. } => "task_ended",
            EventKind::TaskSkipped { .. } => "task_skipped",
            EventKind::Escalated { .. } => "escalated",
            EventKind::QuestionAsked { .. } => "question_asked",
            EventKind::QuestionAnswered { .. } => "question_answered",
            EventKind::QuestionClosed { .. } => "question_closed",
            EventKind::TaskFailed { .. } => "task_failed",
            EventKind::Sent { .. } => "sent",
            EventKind::Received { .. } => "received",
            EventKind::Suspended { .. } => "suspended",
            EventKind::Resumed { .. } => "resumed",
            EventKind::Halted { .. } => "halted",
            EventKind::TaskRetried { .. } => "task_retried",
            EventKind::Alternative { .. } => "alternative",
            EventKind::GaveUp { .. } => "gave_up",
            EventKind::LowCharge { .. } => "low_charge",
            EventKind::StaleSignal { .. } => "stale_signal",
        }
    }

    /// Returns the mission of the event, if any.
    pub fn mission(&self) -> Option<&MissionId> {
        match self {
            EventKind::Submitted { mission, .. }
            | EventKind::PriorityChanged { mission, .. }
            | EventKind::RoleOrdered { mission, .. }
            | EventKind::OccurrenceSubmitted { mission, .. }
            | EventKind::BidsRequested { mission, .. }
            | EventKind::Bid { mission, .. }
            | EventKind::Closed { mission, .. }
            | EventKind::Awarded { mission, .. }
            | EventKind::Released { mission, .. }
            | EventKind::Mission { mission, .. }
            | EventKind::Progress { mission, .. }
            | EventKind::Started { mission, .. }
            | EventKind::TaskBegan { mission, .. }
            | EventKind::TaskEnded { mission, .. }
            | EventKind::TaskSkipped { mission, .. }
            | EventKind::Escalated { mission, .. }
            | EventKind::QuestionAsked { mission, .. }
            | EventKind::QuestionAnswered { mission, .. }
            | EventKind::QuestionClosed { mission, .. }
            | EventKind::TaskFailed { mission, .. }
            | EventKind::Sent { mission, .. }
            | EventKind::Received { mission, .. }
            | EventKind::Suspended { mission, .. }
            | EventKind::Resumed { mission, .. }
            | EventKind::Halted { mission, .. }
            | EventKind::TaskRetried { mission, .. }
            | EventKind::Alternative { mission, .. }
            | EventKind::GaveUp { mission, .. }
            | EventKind::LowCharge { mission, .. }
            | EventKind::StaleSignal { mission, .. } => Some(mission),
            EventKind::Elected { .. }
            | EventKind::SteppedDown { .. }
            | EventKind::Foreign { .. }
            | EventKind::Voters { .. }
            | EventKind::ScheduleChanged { .. }
            | EventKind::RobotOrders { .. }
            | EventKind::AlarmChanged { .. }
            | EventKind::ClosureChanged { .. }
            | EventKind::ChargerLeased { .. }
            | EventKind::ChargerFreed { .. }
            | EventKind::DeviceLeased { .. }
            | EventKind::DeviceFreed { .. }
            | EventKind::Joined { .. }
            | EventKind::Left { .. } => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_an_event_kind_equals_its_json_name() {
        let mission: MissionId = "vital-signs-1".parse().unwrap();
        let schedule: ScheduleId = "rounds".parse().unwrap();
        let (role, task): (RoleId, TaskId) = ("r1".parse().unwrap(), "go".parse().unwrap());
        let kinds = [
            EventKind::SteppedDown { term: 1 },
            EventKind::TaskBegan { mission: mission.clone(), role: role.clone(), task: task.clone() },
            EventKind::QuestionAnswered { mission: mission.clone(), role: role.clone(), task },
            EventKind::OccurrenceSubmitted { schedule: schedule.clone(), due_ms: 1, mission: mission.clone() },
            EventKind::ScheduleChanged { schedule, change: ScheduleChange::Added, by: String::new() },
            EventKind::RobotOrders { robot: "ada".parse().unwrap(), orders: RobotOrders::default() },
            EventKind::AlarmChanged { alarm: "fire".parse().unwrap(), raised: None },
            EventKind::ClosureChanged { part: MapPart::Place("Ward".parse().unwrap()), order: None },
            EventKind::PriorityChanged { mission: mission.clone(), priority: Priority::default() },
            EventKind::RoleOrdered { mission: mission.clone(), role: role.clone(), order: None },
            EventKind::ChargerLeased { charger: "Dock".parse().unwrap(), robot: "ada".parse().unwrap() },
            EventKind::ChargerFreed {
                charger: "Dock".parse().unwrap(),
                robot: "ada".parse().unwrap(),
                cause: String::new(),
            },
            EventKind::DeviceLeased { device: "lift".parse().unwrap(), robot: "ada".parse().unwrap() },
            EventKind::DeviceFreed {
                device: "lift".parse().unwrap(),
                robot: "ada".parse().unwrap(),
                cause: String::new(),
            },
            EventKind::LowCharge { mission, role, cause: String::new() },
        ];
        for kind in kinds {
            assert_eq!(serde_json::to_value(&kind).unwrap()["event"], kind.as_str());
        }
    }
}
