//! The decision: which one change of the ledger's keepers is due, if any.
//!
//! What holds of every change, and is checked last of all: the voters that answer are a majority of the former voters and of
//! the later ones. The leader never removes itself, and no voter that answers is removed below the target without a better
//! one in its place.

use crate::raft::RaftId;
use consort_protocol::ids::NodeId;
use consort_protocol::mutants::{self, Mutant};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// An observer this far behind, in entries, may vote: it catches up within a round trip. A guess.
const LAG_MAX: u64 = 50;

/// A leader that is better placed elsewhere hands over at most this often, so that a voter that comes and goes does not make
/// the lead go to and fro. A guess.
const YIELD_AGAIN: Duration = Duration::from_secs(300);

/// Whether a member is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MemberHealth {
    /// It answers.
    Healthy {
        /// For how long, as far as this leader knows.
        since: Duration,
    },
    /// It does not.
    Unresponsive {
        /// For how long.
        since: Duration,
    },
    /// Its node is there with another store, or says so: this member never comes back.
    Replaced,
}

/// A voter, an observer, or a node that could become one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Member {
    /// Its node.
    pub node: NodeId,
    /// Whether it is there.
    pub health: MemberHealth,
    /// Whether it stays where it is, on mains power.
    pub preferred: bool,
    /// Whether it is about to leave for good.
    pub leaving: bool,
    /// Entries it is behind; `None` until it has answered.
    pub lag: Option<u64>,
}

impl Member {
    fn well(&self) -> bool {
        matches!(self.health, MemberHealth::Healthy { .. })
    }

    /// There, and here to stay.
    fn fit(&self) -> bool {
        self.well() && !self.leaving
    }

    fn stable(&self, for_long: Duration) -> bool {
        self.fit() && matches!(self.health, MemberHealth::Healthy { since } if since >= for_long)
    }

    /// Why it is to be replaced, if it is.
    fn gone(&self, dead_after: Duration) -> Option<String> {
        match self.health {
            MemberHealth::Replaced => Some(format!("{} came back with an empty store", self.node)),
            MemberHealth::Unresponsive { since } if since >= dead_after => {
                Some(format!("{} silent for {:.1} s", self.node, since.as_secs_f64()))
            }
            _ if self.leaving => Some(format!("{} leaves", self.node)),
            MemberHealth::Healthy { .. } | MemberHealth::Unresponsive { .. } => None,
        }
    }
}

/// All that the decision rests on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AutopilotInput {
    /// The leader, which decides.
    pub me: RaftId,
    /// Voters aimed at.
    pub target_voters: usize,
    /// How long a voter must be silent to count as dead.
    pub dead_after: Duration,
    /// How long a better candidate must have been there, and nothing been changed, until it replaces a voter that does its
    /// duty.
    pub settle_time: Duration,
    /// How long nothing has been changed.
    pub unchanged_for: Duration,
    /// How long ago this node handed the lead over because another was better placed; `None` if it never did.
    pub since_transfer: Option<Duration>,
    /// Who votes; while voters are being changed, the former ones too.
    pub voters: BTreeMap<RaftId, Member>,
    /// While voters are being changed: who votes in the end.
    pub pending_voters: Option<BTreeSet<RaftId>>,
    /// Who is replicated to without a vote.
    pub learners: BTreeMap<RaftId, Member>,
    /// Others that may vote and belong to no other cluster.
    pub candidates: BTreeMap<RaftId, Member>,
}

/// One change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum AutopilotAction {
    /// Begin to replicate to a node.
    AddLearner {
        /// Which member.
        id: RaftId,
        /// Its node.
        node: NodeId,
        /// Why.
        reason: String,
    },
    /// Replace the voters by these; those left out are forgotten.
    SetVoters {
        /// All that vote from then on.
        voters: BTreeSet<RaftId>,
        /// Why.
        reason: String,
    },
    /// Forget an observer.
    RemoveLearner {
        /// Which.
        id: RaftId,
        /// Why.
        reason: String,
    },
    /// Hand the lead over to one of these voters.
    TransferLeadership {
        /// To whom.
        to: BTreeSet<NodeId>,
        /// Why.
        reason: String,
    },
}

impl AutopilotAction {
    /// Why.
    pub fn reason(&self) -> &str {
        match self {
            AutopilotAction::AddLearner { reason, .. }
            | AutopilotAction::SetVoters { reason, .. }
            | AutopilotAction::RemoveLearner { reason, .. }
            | AutopilotAction::TransferLeadership { reason, .. } => reason,
        }
    }
}

/// The change that is due; `None` when all is well, or nothing can be done safely.
pub fn decide(view: &AutopilotInput) -> Option<AutopilotAction> {
    if let Some(voters) = &view.pending_voters {
        // A former leader died in the middle of it.
        let reason = "a change that was begun is completed".to_owned();
        return Some(AutopilotAction::SetVoters { voters: voters.clone(), reason })
            .filter(|change| view.survives(change));
    }
    let change = view
        .replace_the_gone()
        .or_else(|| view.relieve_the_leader())
        .or_else(|| view.grow())
        .or_else(|| view.shrink())
        .or_else(|| view.prefer_the_fixed())
        .or_else(|| view.tidy())
        .or_else(|| view.yield_to_the_fixed());
    change.filter(|change| view.survives(change))
}

impl AutopilotInput {
    /// Whether the voters that answer are a majority before the change and after it.
    fn survives(&self, change: &AutopilotAction) -> bool {
        let well = |id: &RaftId| {
            let member = self.voters.get(id).or_else(|| self.learners.get(id));
            *id == self.me || member.is_some_and(Member::well)
        };
        let majority = |voters: &BTreeSet<RaftId>| voters.iter().filter(|id| well(id)).count() * 2 > voters.len();
        let now: BTreeSet<RaftId> = self.voters.keys().copied().collect();
        match change {
            AutopilotAction::AddLearner { .. }
            | AutopilotAction::RemoveLearner { .. }
            | AutopilotAction::TransferLeadership { .. } => majority(&now),
            AutopilotAction::SetVoters { voters, .. } => majority(&now) && majority(voters),
        }
    }

    /// The best of some members: a fixed one before others, then by its number.
    fn best<'a>(members: impl Iterator<Item = (&'a RaftId, &'a Member)>) -> Option<(RaftId, &'a Member)> {
        members.min_by_key(|(id, member)| (!member.preferred, **id)).map(|(id, member)| (*id, member))
    }

    fn ready(&self) -> impl Iterator<Item = (&RaftId, &Member)> {
        self.learners.iter().filter(|(_, member)| member.fit() && member.lag.is_some_and(|lag| lag <= LAG_MAX))
    }

    fn catching_up(&self) -> bool {
        self.learners.values().any(|member| member.fit() && member.lag.is_none_or(|lag| lag > LAG_MAX))
    }

    fn fit_candidates(&self) -> impl Iterator<Item = (&RaftId, &Member)> {
        self.candidates.iter().filter(|(_, member)| member.fit())
    }

    fn gone(&self) -> Option<(RaftId, String)> {
        let others = self.voters.iter().filter(|(id, _)| **id != self.me);
        let gone = others.filter_map(|(id, member)| Some((member.leaving, *id, member.gone(self.dead_after)?)));
        // The dead first: a leaver still answers.
        gone.min_by_key(|(leaving, id, _)| (*leaving, *id)).map(|(_, id, why)| (id, why))
    }

    fn replace_the_gone(&self) -> Option<AutopilotAction> {
        let (gone, why) = self.gone()?;
        let mut voters: BTreeSet<RaftId> = self.voters.keys().copied().filter(|id| *id != gone).collect();
        if mutants::is_active(Mutant::TwoRemoved) {
            let another = voters.iter().copied().find(|id| *id != self.me);
            another.map(|id| voters.remove(&id));
        }
        if self.voters.len() > self.target_voters {
            return Some(AutopilotAction::SetVoters { voters, reason: format!("{why}: enough are left") });
        }
        if let Some((id, by)) = AutopilotInput::best(self.ready()) {
            voters.insert(id);
            return Some(AutopilotAction::SetVoters { voters, reason: format!("{why}: {} takes its place", by.node) });
        }
        if let Some((id, by)) = AutopilotInput::best(self.fit_candidates()).filter(|_| !self.catching_up()) {
            return Some(AutopilotAction::AddLearner {
                id,
                node: by.node.clone(),
                reason: format!("{why}: {} is to take its place", by.node),
            });
        }
        if self.catching_up() {
            return None; // it will be ready in a moment
        }
        Some(AutopilotAction::SetVoters { voters, reason: format!("{why}, and there is nobody to take its place") })
    }

    /// A leader that leaves and is the only voter needs somebody to hand over to.
    fn relieve_the_leader(&self) -> Option<AutopilotAction> {
        let me = self.voters.get(&self.me).filter(|me| me.leaving && self.voters.len() == 1)?;
        let why = format!("{} leaves and is the only voter", me.node);
        if let Some((id, by)) = AutopilotInput::best(self.ready()) {
            let voters = BTreeSet::from([self.me, id]);
            return Some(AutopilotAction::SetVoters { voters, reason: format!("{why}: {} joins it", by.node) });
        }
        let (id, by) = AutopilotInput::best(self.fit_candidates()).filter(|_| !self.catching_up())?;
        Some(AutopilotAction::AddLearner {
            id,
            node: by.node.clone(),
            reason: format!("{why}: {} is to join it", by.node),
        })
    }

    /// How many more voters there should be: up to the next odd number, where there are nodes for it.
    fn wanted(&self) -> usize {
        let next = if self.voters.len().is_multiple_of(2) { self.voters.len() + 1 } else { self.voters.len() + 2 };
        let spare = self.learners.values().filter(|member| member.fit()).count() + self.fit_candidates().count();
        let needed = next.saturating_sub(self.voters.len());
        // A leaver is counted out: it is on its way.
        let stays = self.voters.values().all(|member| !member.leaving);
        if next <= self.target_voters && needed <= spare && stays { needed } else { 0 }
    }

    fn grow(&self) -> Option<AutopilotAction> {
        let wanted = self.wanted();
        if wanted == 0 {
            return None;
        }
        let mut ready: Vec<_> = self.ready().collect();
        ready.sort_by_key(|(id, member)| (!member.preferred, **id));
        if ready.len() >= wanted {
            let chosen = &ready[..wanted];
            let voters = self.voters.keys().copied().chain(chosen.iter().map(|(id, _)| **id)).collect();
            let names: Vec<_> = chosen.iter().map(|(_, member)| member.node.as_str()).collect();
            let reason =
                format!("{} of {} voters aimed at: {} join", self.voters.len(), self.target_voters, names.join(", "));
            return Some(AutopilotAction::SetVoters { voters, reason });
        }
        let coming = self.learners.values().filter(|member| member.fit()).count();
        if coming >= wanted {
            return None; // they are catching up
        }
        let (id, member) = AutopilotInput::best(self.fit_candidates())?;
        let reason =
            format!("{} of {} voters aimed at: {} is to join", self.voters.len(), self.target_voters, member.node);
        Some(AutopilotAction::AddLearner { id, node: member.node.clone(), reason })
    }

    /// A target that was lowered.
    fn shrink(&self) -> Option<AutopilotAction> {
        // A leader that leaves needs one to hand over to.
        let leaves = self.voters.get(&self.me).is_some_and(|me| me.leaving);
        if self.voters.len() <= self.target_voters + usize::from(leaves) {
            return None;
        }
        let others = self.voters.iter().filter(|(id, _)| **id != self.me);
        let (worst, member) = others.max_by_key(|(id, member)| (!member.well(), !member.preferred, **id))?;
        let voters = self.voters.keys().copied().filter(|id| id != worst).collect();
        let reason =
            format!("{} voters where {} are aimed at: {} goes", self.voters.len(), self.target_voters, member.node);
        Some(AutopilotAction::SetVoters { voters, reason })
    }

    /// A voter that moves or runs on a battery, if there is any beside the leader.
    fn mobile(&self) -> Option<(RaftId, &Member)> {
        let mobile = self.voters.iter().filter(|(id, member)| **id != self.me && !member.preferred);
        mobile.max_by_key(|(id, _)| **id).map(|(id, member)| (*id, member))
    }

    fn prefer_the_fixed(&self) -> Option<AutopilotAction> {
        let (mobile, former) = self.mobile().filter(|_| self.unchanged_for >= self.settle_time)?;
        let better = |(_, member): &(&RaftId, &Member)| member.preferred && member.stable(self.settle_time);
        if let Some((id, member)) = AutopilotInput::best(self.ready().filter(better)) {
            let voters = self.voters.keys().copied().filter(|voter| *voter != mobile).chain([id]).collect();
            let reason = format!("{} stays where it is, on mains power, and {} does not", member.node, former.node);
            return Some(AutopilotAction::SetVoters { voters, reason });
        }
        if self.learners.values().any(|member| member.fit() && member.preferred) {
            return None; // it is catching up, or has not been there for long
        }
        let (id, member) = AutopilotInput::best(self.fit_candidates().filter(better))?;
        let reason = format!("{} is to take the place of {}: it stays where it is", member.node, former.node);
        Some(AutopilotAction::AddLearner { id, node: member.node.clone(), reason })
    }

    /// A leader that moves or runs on a battery hands over to voters that do not, once they have been there for a while.
    fn yield_to_the_fixed(&self) -> Option<AutopilotAction> {
        let me = self.voters.get(&self.me).filter(|me| !me.preferred && !me.leaving)?;
        if self.unchanged_for < self.settle_time || self.since_transfer.is_some_and(|ago| ago < YIELD_AGAIN) {
            return None;
        }
        let up_to_date = |member: &Member| member.lag.is_some_and(|lag| lag <= LAG_MAX);
        let better = |member: &&Member| member.preferred && member.stable(self.settle_time) && up_to_date(member);
        let to: BTreeSet<NodeId> = self.voters.values().filter(better).map(|member| member.node.clone()).collect();
        let names = to.iter().map(NodeId::as_str).collect::<Vec<_>>().join(", ");
        let reason =
            format!("{} moves or runs on a battery, and {names} does neither: the lead is handed over", me.node);
        (!to.is_empty()).then_some(AutopilotAction::TransferLeadership { to, reason })
    }

    /// Drops an observer that is gone, or that nothing is planned with.
    fn tidy(&self) -> Option<AutopilotAction> {
        let planned = |member: &Member| {
            let replaces = member.preferred && self.mobile().is_some();
            let relieves = self.voters.get(&self.me).is_some_and(|me| me.leaving);
            member.fit() && (self.gone().is_some() || self.wanted() > 0 || replaces || relieves)
        };
        let unneeded = |member: &Member| match member.gone(self.dead_after) {
            Some(why) => Some(why),
            None if member.fit() && !planned(member) => Some(format!("{} is not needed as an observer", member.node)),
            None => None,
        };
        self.learners
            .iter()
            .find_map(|(id, member)| Some(AutopilotAction::RemoveLearner { id: *id, reason: unneeded(member)? }))
    }
}

#[cfg(test)]
mod tests;
