//! Messages for the human task proxy.

use crate::robot::ReceivedSignals;
use crate::robot_driver::PersonRequestState;
use consort_bus::{Author, Sample};
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::ledger::Branch;
use consort_protocol::message::{ActiveMissions, ReportReply};
use consort_skills::actions::GoalId;

/// Message for the human task proxy.
pub(crate) enum HumanTaskProxyMessage {
    /// Periodic timer: repeat queries, requests and reports.
    Tick,
    /// Beacon of the coordinator.
    Beacon(Sample),
    /// The active missions have changed.
    MissionsChanged,
    /// The query for the active missions has ended.
    ActiveMissions {
        /// Node that was queried.
        node: NodeId,
        /// Number of the query.
        query_number: u64,
        /// Active missions; `None` without a complete reply.
        active: Option<ActiveMissions>,
    },
    /// Signal of a role.
    Signal(Sample),
    /// Signal history of a role, in reply to a query.
    SignalHistory(ReceivedSignals),
    /// Event of a person.
    PersonEvent(Sample),
    /// State of a person request, in reply to a command, and the author of the reply.
    RequestReplied(GoalId, PersonRequestState, Author),
    /// Reply to a report for this branch.
    ReportReplied(MissionId, RoleId, Branch, ReportReply),
}
