//! Decision of the autopilot: the next action on the ledger's voters, if any is due.
//!
//! Every action satisfies these rules, which are checked last: the healthy voters are a majority of
//! the former voters and of the new voters. The leader never removes itself. No healthy voter is
//! removed below the target without a more suitable voter in its place.

use consort_protocol::ids::NodeId;
use consort_raft::RaftId;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Greatest lag, in entries, of a learner that may become a voter: it catches up within a round
/// trip. A guess.
const LAG_MAX: u64 = 50;

/// Least time between two transfers of leadership to a more suitable voter, so that an intermittent
/// voter does not make the leadership alternate. A guess.
const TRANSFER_INTERVAL_MIN: Duration = Duration::from_secs(300);

/// Health of a member.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MemberHealth {
    /// The member replies.
    Healthy {
        /// Duration, as far as this leader knows.
        since: Duration,
    },
    /// The member does not reply.
    Unresponsive {
        /// Duration.
        since: Duration,
    },
    /// The node runs with another store, according to its own record: this member never comes back.
    Replaced,
}

/// Voter, learner, or node that could become a learner.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Member {
    /// Node of the member.
    pub node: NodeId,
    /// Health of the member.
    pub health: MemberHealth,
    /// The node is stationary and on mains power, so it is preferred as a voter.
    pub preferred: bool,
    /// The node is about to leave for good.
    pub leaving: bool,
    /// Replication lag in entries; `None` until the member has replied.
    pub lag: Option<u64>,
}

impl Member {
    fn is_healthy(&self) -> bool {
        matches!(self.health, MemberHealth::Healthy { .. })
    }

    /// Checks whether the member is healthy and not leaving.
    fn is_available(&self) -> bool {
        self.is_healthy() && !self.leaving
    }

    fn is_stable(&self, for_long: Duration) -> bool {
        self.is_available() && matches!(self.health, MemberHealth::Healthy { since } if since >= for_long)
    }

    /// Returns the reason to replace the member, if there is any.
    fn replacement_reason(&self, dead_after: Duration) -> Option<String> {
        match self.health {
            MemberHealth::Replaced => Some(format!("{} came back with an empty store", self.node)),
            MemberHealth::Unresponsive { since } if since >= dead_after => {
                Some(format!("{} silent for {:.1} s", self.node, since.as_secs_f64()))
            }
            _ if self.leaving => Some(format!("{} is leaving", self.node)),
            MemberHealth::Healthy { .. } | MemberHealth::Unresponsive { .. } => None,
        }
    }
}

/// Input of the decision.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AutopilotInput {
    /// Leader, which decides.
    pub me: RaftId,
    /// Target number of voters.
    pub target_voters: usize,
    /// Time without replies after which a voter counts as dead.
    pub dead_after: Duration,
    /// Time for which a more suitable candidate must be healthy, and nothing be changed, before it
    /// replaces a working voter.
    pub settle_time: Duration,
    /// Time since the last change.
    pub unchanged_for: Duration,
    /// Time since this node transferred leadership to a more suitable voter; `None` if it never
    /// did.
    pub since_transfer: Option<Duration>,
    /// Voters; while the voters are being changed, including the former voters.
    pub voters: BTreeMap<RaftId, Member>,
    /// While the voters are being changed: the voters after the change.
    pub pending_voters: Option<BTreeSet<RaftId>>,
    /// Learners: members without a vote.
    pub learners: BTreeMap<RaftId, Member>,
    /// Other nodes that may vote and belong to no other cluster.
    pub candidates: BTreeMap<RaftId, Member>,
}

/// Action of the autopilot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum AutopilotAction {
    /// Add a node as a learner.
    AddLearner {
        /// Id of the learner.
        id: RaftId,
        /// Node of the member.
        node: NodeId,
        /// Reason.
        reason: String,
    },
    /// Replace the voters; former voters that are not in the new set are removed from the
    /// membership.
    SetVoters {
        /// New set of voters.
        voters: BTreeSet<RaftId>,
        /// Reason.
        reason: String,
    },
    /// Remove a learner.
    RemoveLearner {
        /// Id of the learner.
        id: RaftId,
        /// Reason.
        reason: String,
    },
    /// Transfer leadership to a voter in a set.
    TransferLeadership {
        /// Acceptable targets.
        to: BTreeSet<NodeId>,
        /// Reason.
        reason: String,
    },
}

impl AutopilotAction {
    /// Reason.
    pub fn reason(&self) -> &str {
        match self {
            AutopilotAction::AddLearner { reason, .. }
            | AutopilotAction::SetVoters { reason, .. }
            | AutopilotAction::RemoveLearner { reason, .. }
            | AutopilotAction::TransferLeadership { reason, .. } => reason,
        }
    }
}

/// Decision rule of the autopilot: [`decide`], or a replacement of it.
pub(crate) type AutopilotRule = fn(&AutopilotInput) -> Option<AutopilotAction>;

/// Returns the next action; `None` when nothing is due, or nothing can be done safely.
pub fn decide(input: &AutopilotInput) -> Option<AutopilotAction> {
    if let Some(voters) = &input.pending_voters {
        // A former leader failed during the change.
        let reason = "an interrupted change of the voters is completed".to_owned();
        return Some(AutopilotAction::SetVoters { voters: voters.clone(), reason })
            .filter(|action| input.keeps_quorum(action));
    }
    let action = input
        .replace_dead_voter()
        .or_else(|| input.relieve_leader())
        .or_else(|| input.grow())
        .or_else(|| input.shrink())
        .or_else(|| input.prefer_stationary_voters())
        .or_else(|| input.remove_learners())
        .or_else(|| input.transfer_to_preferred_voter());
    action.filter(|action| input.keeps_quorum(action))
}

impl AutopilotInput {
    /// Checks whether the healthy voters are a majority before and after the action.
    fn keeps_quorum(&self, action: &AutopilotAction) -> bool {
        let is_healthy = |id: &RaftId| {
            let member = self.voters.get(id).or_else(|| self.learners.get(id));
            *id == self.me || member.is_some_and(Member::is_healthy)
        };
        let majority = |voters: &BTreeSet<RaftId>| voters.iter().filter(|id| is_healthy(id)).count() * 2 > voters.len();
        let now: BTreeSet<RaftId> = self.voters.keys().copied().collect();
        match action {
            AutopilotAction::AddLearner { .. }
            | AutopilotAction::RemoveLearner { .. }
            | AutopilotAction::TransferLeadership { .. } => majority(&now),
            AutopilotAction::SetVoters { voters, .. } => majority(&now) && majority(voters),
        }
    }

    /// Returns the most suitable member: a preferred member before others, then the lowest id.
    fn best<'a>(members: impl Iterator<Item = (&'a RaftId, &'a Member)>) -> Option<(RaftId, &'a Member)> {
        members.min_by_key(|(id, member)| (!member.preferred, **id)).map(|(id, member)| (*id, member))
    }

    fn ready(&self) -> impl Iterator<Item = (&RaftId, &Member)> {
        self.learners.iter().filter(|(_, member)| member.is_available() && member.lag.is_some_and(|lag| lag <= LAG_MAX))
    }

    fn catching_up(&self) -> bool {
        self.learners.values().any(|member| member.is_available() && member.lag.is_none_or(|lag| lag > LAG_MAX))
    }

    fn available_candidates(&self) -> impl Iterator<Item = (&RaftId, &Member)> {
        self.candidates.iter().filter(|(_, member)| member.is_available())
    }

    fn voter_to_replace(&self) -> Option<(RaftId, String)> {
        let others = self.voters.iter().filter(|(id, _)| **id != self.me);
        let to_replace =
            others.filter_map(|(id, member)| Some((member.leaving, *id, member.replacement_reason(self.dead_after)?)));
        // Dead members first: a leaving member still replies.
        to_replace.min_by_key(|(leaving, id, _)| (*leaving, *id)).map(|(_, id, cause)| (id, cause))
    }

    fn replace_dead_voter(&self) -> Option<AutopilotAction> {
        let (dead, cause) = self.voter_to_replace()?;
        let mut voters: BTreeSet<RaftId> = self.voters.keys().copied().filter(|id| *id != dead).collect();
        if self.voters.len() > self.target_voters {
            return Some(AutopilotAction::SetVoters { voters, reason: format!("{cause}: enough voters are left") });
        }
        if let Some((id, member)) = AutopilotInput::best(self.ready()) {
            voters.insert(id);
            return Some(AutopilotAction::SetVoters {
                voters,
                reason: format!("{cause}: {} replaces it", member.node),
            });
        }
        if let Some((id, member)) = AutopilotInput::best(self.available_candidates()).filter(|_| !self.catching_up()) {
            return Some(AutopilotAction::AddLearner {
                id,
                node: member.node.clone(),
                reason: format!("{cause}: {} is added as a learner to replace it", member.node),
            });
        }
        if self.catching_up() {
            return None; // a learner will be ready in a moment
        }
        Some(AutopilotAction::SetVoters { voters, reason: format!("{cause}, and no node can replace it") })
    }

    /// Adds a voter when the only voter is a leaving leader: it needs a voter to transfer
    /// leadership to.
    fn relieve_leader(&self) -> Option<AutopilotAction> {
        let me = self.voters.get(&self.me).filter(|me| me.leaving && self.voters.len() == 1)?;
        let cause = format!("{} is leaving and is the only voter", me.node);
        if let Some((id, member)) = AutopilotInput::best(self.ready()) {
            let voters = BTreeSet::from([self.me, id]);
            return Some(AutopilotAction::SetVoters {
                voters,
                reason: format!("{cause}: {} becomes a voter", member.node),
            });
        }
        let (id, member) = AutopilotInput::best(self.available_candidates()).filter(|_| !self.catching_up())?;
        Some(AutopilotAction::AddLearner {
            id,
            node: member.node.clone(),
            reason: format!("{cause}: {} is added as a learner", member.node),
        })
    }

    /// Returns the number of voters to add: up to the next odd number, if there are nodes for it.
    fn missing_voters(&self) -> usize {
        let next = if self.voters.len().is_multiple_of(2) { self.voters.len() + 1 } else { self.voters.len() + 2 };
        let spare =
            self.learners.values().filter(|member| member.is_available()).count() + self.available_candidates().count();
        let needed = next.saturating_sub(self.voters.len());
        // Not while a voter is leaving: it is about to be replaced.
        let stays = self.voters.values().all(|member| !member.leaving);
        if next <= self.target_voters && needed <= spare && stays { needed } else { 0 }
    }

    fn grow(&self) -> Option<AutopilotAction> {
        let missing_voters = self.missing_voters();
        if missing_voters == 0 {
            return None;
        }
        let mut ready: Vec<_> = self.ready().collect();
        ready.sort_by_key(|(id, member)| (!member.preferred, **id));
        if ready.len() >= missing_voters {
            let chosen = &ready[..missing_voters];
            let voters = self.voters.keys().copied().chain(chosen.iter().map(|(id, _)| **id)).collect();
            let names: Vec<_> = chosen.iter().map(|(_, member)| member.node.as_str()).collect();
            let reason = format!(
                "{} of {} target voters: {} become voters",
                self.voters.len(),
                self.target_voters,
                names.join(", ")
            );
            return Some(AutopilotAction::SetVoters { voters, reason });
        }
        let joining = self.learners.values().filter(|member| member.is_available()).count();
        if joining >= missing_voters {
            return None; // they are catching up
        }
        let (id, member) = AutopilotInput::best(self.available_candidates())?;
        let reason = format!(
            "{} of {} target voters: {} is added as a learner",
            self.voters.len(),
            self.target_voters,
            member.node
        );
        Some(AutopilotAction::AddLearner { id, node: member.node.clone(), reason })
    }

    /// Removes a voter if there are more than the target.
    fn shrink(&self) -> Option<AutopilotAction> {
        // A leaving leader needs a voter to transfer leadership to.
        let leaves = self.voters.get(&self.me).is_some_and(|me| me.leaving);
        if self.voters.len() <= self.target_voters + usize::from(leaves) {
            return None;
        }
        let others = self.voters.iter().filter(|(id, _)| **id != self.me);
        let (worst, member) = others.max_by_key(|(id, member)| (!member.is_healthy(), !member.preferred, **id))?;
        let voters = self.voters.keys().copied().filter(|id| id != worst).collect();
        let reason = format!(
            "{} voters exceed the target of {}: {} is removed",
            self.voters.len(),
            self.target_voters,
            member.node
        );
        Some(AutopilotAction::SetVoters { voters, reason })
    }

    /// Returns a voter that moves or runs on a battery, if there is any besides the leader.
    fn mobile(&self) -> Option<(RaftId, &Member)> {
        let mobile = self.voters.iter().filter(|(id, member)| **id != self.me && !member.preferred);
        mobile.max_by_key(|(id, _)| **id).map(|(id, member)| (*id, member))
    }

    fn prefer_stationary_voters(&self) -> Option<AutopilotAction> {
        let (mobile, former) = self.mobile().filter(|_| self.unchanged_for >= self.settle_time)?;
        let better = |(_, member): &(&RaftId, &Member)| member.preferred && member.is_stable(self.settle_time);
        if let Some((id, member)) = AutopilotInput::best(self.ready().filter(better)) {
            let voters = self.voters.keys().copied().filter(|voter| *voter != mobile).chain([id]).collect();
            let reason = format!("{} is stationary and on mains power, and {} is not", member.node, former.node);
            return Some(AutopilotAction::SetVoters { voters, reason });
        }
        if self.learners.values().any(|member| member.is_available() && member.preferred) {
            return None; // it is catching up, or has not been there for long
        }
        let (id, member) = AutopilotInput::best(self.available_candidates().filter(better))?;
        let reason = format!(
            "{} is added as a learner to replace {}: it is stationary and on mains power",
            member.node, former.node
        );
        Some(AutopilotAction::AddLearner { id, node: member.node.clone(), reason })
    }

    /// Transfers leadership from a leader that moves or runs on a battery to voters that do not,
    /// once these have been healthy for a while.
    fn transfer_to_preferred_voter(&self) -> Option<AutopilotAction> {
        let me = self.voters.get(&self.me).filter(|me| !me.preferred && !me.leaving)?;
        if self.unchanged_for < self.settle_time || self.since_transfer.is_some_and(|ago| ago < TRANSFER_INTERVAL_MIN) {
            return None;
        }
        let is_up_to_date = |member: &Member| member.lag.is_some_and(|lag| lag <= LAG_MAX);
        let better = |member: &&Member| member.preferred && member.is_stable(self.settle_time) && is_up_to_date(member);
        let to: BTreeSet<NodeId> = self.voters.values().filter(better).map(|member| member.node.clone()).collect();
        let names = to.iter().map(NodeId::as_str).collect::<Vec<_>>().join(", ");
        let reason = format!("{} moves or runs on a battery, unlike {names}: leadership is transferred", me.node);
        (!to.is_empty()).then_some(AutopilotAction::TransferLeadership { to, reason })
    }

    /// Removes a learner that is dead, or that no plan needs.
    fn remove_learners(&self) -> Option<AutopilotAction> {
        let planned = |member: &Member| {
            let replaces = member.preferred && self.mobile().is_some();
            let relieves = self.voters.get(&self.me).is_some_and(|me| me.leaving);
            member.is_available()
                && (self.voter_to_replace().is_some() || self.missing_voters() > 0 || replaces || relieves)
        };
        let unneeded = |member: &Member| match member.replacement_reason(self.dead_after) {
            Some(cause) => Some(cause),
            None if member.is_available() && !planned(member) => {
                Some(format!("{} is not needed as a learner", member.node))
            }
            None => None,
        };
        self.learners
            .iter()
            .find_map(|(id, member)| Some(AutopilotAction::RemoveLearner { id: *id, reason: unneeded(member)? }))
    }
}

#[cfg(test)]
mod tests;
