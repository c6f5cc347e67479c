//! The ledger: accepted missions, awards and their results, as a state machine that consensus
//! replicates.
//!
//! A mission in the ledger has been acknowledged. A role that the ledger assigns to a robot stays
//! with that robot until it is released, also under another coordinator. [`Ledger::apply`] is a
//! pure function of the ledger and a [`Command`] at its position ([`Epoch`](crate::lease::Epoch))
//! in the log, so that all replicas agree. Commands contain the coordinator's observations. A
//! command that no longer fits the ledger is [rejected](CommandError) and changes nothing, so late
//! and repeated commands do no harm.
//!
//! ```text
//!                 award (all open roles)         all roles ended
//! submit ─▶ pending ───────────────────▶ running ───────────────▶ completed
//!             ▲  │ defer (why not yet)     │ │
//!             └──┘◀────── release ─────────┘ └── fail (cause) ─▶ failed      cancel: from pending and running
//! ```
//!
//! A role whose robot is busy, or that cannot start yet, may be promised instead of awarded; its award follows (the
//! module `promises`).
//!
//! Roles of spread loops are awarded one by one, while the mission runs (the module `spread`).
//!
//! A schedule adds its mission at certain times (the module `schedules`).
//!
//! The requests of people are recorded (the module `audit`).
//!
//! People hold robots, take them out of service for maintenance, close places and lanes, and raise alarms (the
//! module `robot_orders`).
//!
//! People cancel several missions at once, and change the priority of missions (the module `mission_orders`).
//!
//! People reassign and pin roles (the module `role_orders`).
//!
//! Chargers and devices are leased to robots (the module `resources`).
//!
//! Waiting missions are served by priority, deadline and age (the module `service_order`).
//!
//! Queries use indexes by state, rank and robot (the module `missions`), and readers on the same node ask which missions have
//! changed (the module `mission_changes`).
//!
//! A copy of the ledger, such as a snapshot that is being written, shares its large parts (the modules `shared_map` and
//! `shared_queue`).
//!
//! Ended missions are kept in the order of their ends: the latest whole, and for a day what a client
//! may still ask for (the module `history`).
//!
//! A mission that would fail or be canceled while a robot has an item changes to *needs
//! intervention* instead, and stays there until a person closes it. If it has a recovery branch, it
//! continues with that branch. The module `custody` computes which robot has which item.

mod alarm;
mod apply;
mod audit;
mod audit_trail;
mod branch;
mod closure;
mod command;
mod command_error;
mod custody;
mod entry;
mod history;
mod history_limits;
mod layout;
mod limits;
mod loss;
mod map_part;
mod mission_changes;
mod mission_filter;
mod mission_order;
mod mission_orders;
mod missions;
mod order_book;
mod people;
mod person_request;
mod promises;
mod resource_lease;
mod resources;
mod robot_order;
mod robot_orders;
mod role_orders;
mod schedule;
mod schedules;
mod service_order;
mod shared_map;
mod shared_queue;
mod speed_limit;
mod spread;
mod submission;
#[cfg(test)]
mod test_values;

pub use alarm::{Alarm, AlarmChange, AlarmPlan, AlarmResponse, alarm_size_problem};
pub use apply::Ledger;
pub use audit_trail::{AuditAction, AuditEntry};
pub use branch::Branch;
pub use closure::{Closure, ClosureChange};
pub use command::{Command, CommandOutcome, PromiseMove};
pub use command_error::CommandError;
pub use entry::{HeldItem, MissionEntry, MissionState, RoleAssignment, RoleEntry, RolePhase, RoleRelease};
pub use history::Tombstone;
pub use history_limits::HistoryLimits;
pub use map_part::{MapPart, Zone};
pub use mission_changes::{ChangeCursor, MissionChanges};
pub use mission_filter::MissionFilter;
pub use mission_order::{MissionCancelation, MissionChange, ReassignProblem, RoleOrder, RoleReturn};
pub use person_request::{
    AnswerContent, FinalAnswer, NOTE_BYTES_MAX, PersonAnswer, PersonQuestion, PersonRequestEntry, PersonRequestId,
    PersonRequestIdError, PersonRequestPhase, Postponement, RequestEscalation, RequestSubject, TaskQuestion,
};
pub use resource_lease::{Resource, ResourceLease};
pub use robot_order::{OrderChange, OrderRequest, RobotOrder, RobotOrders};
pub use schedule::{MissedOccurrences, Occurrence, Schedule, ScheduleEntry, SchedulePause, ScheduleRule};
pub use service_order::{ServiceRank, service_order};
pub use speed_limit::{SpeedLimit, SpeedLimitChange};
pub use submission::{
    DeadlineError, Priority, PriorityError, RecoveryBranch, Submission, TIME_AHEAD_MAX, time_until_deadline,
};
