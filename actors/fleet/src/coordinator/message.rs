//! Messages of the coordinator actor.

use super::status::CoordinatorStatus;
use crate::autopilot::ActionResult;
use crate::robot_driver::PersonRequestState;
use consort_bus::tasks::Forwarded;
use consort_bus::{Author, Query, Sample};
use consort_protocol::auction::{AuctionId, Bid, BidResponse, CallForBids, Candidates, Invitation, RoleReply};
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{CommandOutcome, MissionEntry, RoleAssignment, TaskQuestion};
use consort_protocol::message::AwardReply;
use consort_raft::ProposeError;
use consort_skills::actions::GoalId;
use std::collections::BTreeSet;
use tokio::sync::oneshot;

/// Message for the coordinator actor.
pub(crate) enum CoordinatorMessage {
    /// The leader of the ledger has changed, or this actor starts.
    Leadership(Option<Forwarded<()>>),
    /// The ledger has changed.
    Ledger(Forwarded<()>),
    /// Periodic timer: perform all periodic work.
    Tick,
    /// All bids have arrived, or the bid window has closed.
    BidsCollected(Box<CollectedBids>),
    /// The ledger has committed or refused an award or a deferral.
    AuctionRecorded {
        auction: AuctionId,
        /// Outcome of the proposal.
        outcome: Result<CommandOutcome, ProposeError>,
    },
    /// A robot has replied to an award notice.
    NoticeReplied(AwardedRole, AwardReply),
    /// A robot has acknowledged the orders of people, as of this position in the ledger.
    OrdersAcknowledged { robot: RobotId, as_of: Epoch },
    /// A voter change has ended, with or without success.
    VotersChanged {
        /// Term of the leader session that started the change.
        term: u64,
        result: ActionResult,
    },
    /// A robot reports a question that the ledger lacks, or no longer asks.
    Question { mission: MissionId, role: RoleId, epoch: Epoch, question: TaskQuestion },
    /// Event of the host of simulated people.
    PersonEvent(Forwarded<Sample>),
    /// State of a request to a simulated person, in reply to a command, and the author of the reply.
    PersonReplied(GoalId, PersonRequestState, Author),
    /// A voter has returned the time of its clock, in milliseconds since 1970.
    ClockRead { voter: NodeId, wall_ms: u64 },
    /// Beacon of a coordinator.
    Beacon(Forwarded<Sample>),
    /// Request of a client.
    Api(Query),
    /// Request of a client that arrived while another node was the coordinator, to be checked
    /// again.
    ApiRecheck(Query),
    /// Query for the status of this node's session. Without a session the query is dropped.
    QueryStatus(oneshot::Sender<CoordinatorStatus>),
}

/// Bids for the roles of a mission.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CollectedBids {
    pub(super) call: CallForBids,
    pub(super) invitation: Invitation,
    pub(super) responses: Vec<BidResponse>,
    /// Set if the role is promised to a robot, and may pass to another.
    pub(super) again: Option<Reauction>,
    /// Robots that were not asked. The invitation does not contain them.
    pub(super) candidates: Candidates,
    /// Robots of the latest call; `None` if it went to all.
    pub(super) called: Option<BTreeSet<RobotId>>,
}

impl CollectedBids {
    /// Returns the bids for a call to all robots, before any has replied.
    pub(super) fn of_all(call: CallForBids, invitation: Invitation, again: Option<Reauction>) -> CollectedBids {
        CollectedBids { call, invitation, responses: vec![], again, candidates: Candidates::default(), called: None }
    }

    /// Invites candidates to the next call.
    pub(super) fn invite(&mut self, robots: BTreeSet<RobotId>) {
        self.candidates.remove(&robots);
        self.invitation.robots.extend(robots.iter().cloned());
        self.called = Some(robots);
    }

    /// Returns the replies to the latest call.
    pub(super) fn latest_responses(&self) -> impl Iterator<Item = &BidResponse> {
        let is_latest =
            move |response: &&BidResponse| self.called.as_ref().is_none_or(|it| it.contains(&response.robot));
        self.responses.iter().filter(is_latest)
    }

    /// Returns the reply of a robot for a role.
    pub(super) fn reply_of(&self, role: &RoleId, robot: &RobotId) -> Option<&RoleReply> {
        let response = self.responses.iter().find(|response| response.robot == *robot)?;
        response.replies.iter().find(|reply| match reply {
            RoleReply::Bid(bid) => bid.role == *role,
            RoleReply::Refusal(refusal) => refusal.role == *role,
        })
    }

    /// Returns the bid of a robot for a role.
    pub(super) fn bid_of(&self, role: &RoleId, robot: &RobotId) -> Option<&Bid> {
        match self.reply_of(role, robot)? {
            RoleReply::Bid(bid) => Some(bid),
            RoleReply::Refusal(_) => None,
        }
    }
}

/// Further auction of a promised role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Reauction {
    pub(super) promised: AwardedRole,
    /// The role could have started for too long.
    pub(super) is_late: bool,
    /// Number of robots that have lost the role before they began it.
    pub(super) changes: u32,
}

/// A role that was awarded or promised to a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct AwardedRole {
    pub(super) mission: MissionId,
    pub(super) role: RoleId,
    pub(super) robot: RobotId,
    /// Epoch of the award or the promise.
    pub(super) epoch: Epoch,
}

impl AwardedRole {
    /// Returns a held role of a mission.
    pub(super) fn of(entry: &MissionEntry, role: &RoleId, holder: &RoleAssignment) -> AwardedRole {
        let (mission, role, robot) = (entry.id.clone(), role.clone(), holder.robot.clone());
        AwardedRole { mission, role, robot, epoch: holder.epoch }
    }
}
