//! Messages for the robot actor.

use crate::robot::leader_poll::LeaderPoll;
use crate::robot::signals::ReceivedSignals;
use crate::robot::skill_runner::SkillOutcome;
use consort_bus::tasks::Forwarded;
use consort_bus::{Query, Sample};
use consort_protocol::ids::NodeId;
use consort_protocol::lease::Epoch;
use consort_protocol::message::ReportReply;
use consort_protocol::units::NodeTime;
use ractor::RpcReplyPort;
use std::io;
use std::time::Duration;

/// Message for the robot actor.
pub(crate) enum RobotMessage {
    /// Periodic timer: update the knowledge record, the lease and the task.
    Tick,
    /// Beacon of the coordinator.
    Beacon(Forwarded<Sample>),
    /// Call for bids of the coordinator.
    CallForBids(Query),
    /// Award of a role, or its end, from the coordinator.
    AwardNotice(Query),
    /// The query of a report has ended, with or without a reply.
    ReportReplied(EndedReport),
    /// A poll of the voters about their leader has ended.
    LeaderPolled(LeaderPoll),
    /// A skill has ended.
    SkillEnded {
        /// Number of the skill run.
        run: u64,
        /// Its outcome.
        outcome: SkillOutcome,
    },
    /// Signal of another role of the mission.
    Signal(Forwarded<Sample>),
    /// Signal history of another role, in reply to a query.
    SignalHistory(ReceivedSignals),
    /// Result of writing the checkpoint.
    CheckpointWritten(io::Result<()>),
    /// Decommission: the robot takes no new role and releases the role it holds. The reply is true
    /// once it holds no role, and false when the timeout has passed. The caller then ends the node.
    /// A node that only stops for a while does not send this: its robot continues its role if it is
    /// back in time.
    Decommission {
        /// Time for the coordinator to confirm the release. Lease plus grace time is enough.
        timeout: Duration,
        /// Reply port: true if the robot holds no role.
        done: RpcReplyPort<bool>,
    },
    /// The time for the decommission has passed.
    DecommissionTimeout,
}

/// Report with the result of its query.
pub(crate) struct EndedReport {
    /// Node that the report was sent to.
    pub(super) recipient: NodeId,
    /// Time at which the report was sent.
    pub(super) sent: NodeTime,
    /// Reply of the coordinator; `None` without a reply.
    pub(super) reply: Option<ReportReply>,
}

impl EndedReport {
    /// Returns the position in the ledger that the reply states; the default if it states none.
    pub(super) fn position(&self) -> Epoch {
        match &self.reply {
            Some(ReportReply::Renewed { orders, .. }) => orders.as_of,
            Some(ReportReply::Ended { .. } | ReportReply::NotCoordinator { .. }) | None => Epoch::default(),
        }
    }

    /// Checks whether the reply can change the lease or the role.
    pub(super) fn has_effect(&self) -> bool {
        matches!(self.reply, Some(ReportReply::Renewed { .. } | ReportReply::Ended { .. }))
    }
}
