//! Changes of the voters and learners.

use super::Replica;
use crate::errors::{MemberError, ProposeError, member_error};
use crate::types::{Peer, RaftId, StateMachine};
use consort_protocol::ids::NodeId;
use openraft::ChangeMembers;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::timeout;

impl<S: StateMachine> Replica<S> {
    /// Adds a node as a learner: the ledger is replicated to it, and it does not vote. Does nothing
    /// if it is a member already.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn add_learner(&self, id: RaftId, name: NodeId, limit: Duration) -> Result<(), MemberError> {
        let node = BTreeMap::from([(id, Peer { name })]);
        self.change(ChangeMembers::AddNodes(node), true, limit).await
    }

    /// Replaces the voters by `voters`, by joint consensus. Each must be a learner or voter
    /// already; voters left out are removed from the membership. Needs a majority of the old and of
    /// the new voters: a dead voter is never removed without a quorum. A leader that is left out
    /// transfers leadership to one of the new voters.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn set_voters(&self, voters: BTreeSet<RaftId>, limit: Duration) -> Result<(), MemberError> {
        let stays = voters.contains(&self.inner.id);
        self.change(ChangeMembers::ReplaceAllVoters(voters), false, limit).await?;
        if !stays {
            // openraft makes it step down at its next tick, within three seconds. If no voter takes
            // over, that is soon enough.
            let _ = self.transfer_leadership(&BTreeSet::new(), self.inner.settings.election_max).await;
        }
        Ok(())
    }

    /// Removes a learner.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn remove_learner(&self, id: RaftId, limit: Duration) -> Result<(), MemberError> {
        self.change(ChangeMembers::RemoveNodes(BTreeSet::from([id])), true, limit).await
    }

    async fn change(
        &self,
        change: ChangeMembers<RaftId, Peer>,
        retain: bool,
        limit: Duration,
    ) -> Result<(), MemberError> {
        self.check_quorum()?;
        self.check_not_resigned()?;
        match timeout(limit, self.inner.raft.change_membership(change, retain)).await {
            Err(_) => Err(ProposeError::TimedOut { limit }.into()),
            Ok(Err(error)) => Err(member_error(error)),
            Ok(Ok(_)) => Ok(()),
        }
    }
}
