//! Reception of records, published by their owners or forwarded by peers.

use super::context::Context;
use super::event::GossipError;
use super::membership::Membership;
use crate::record_store::{MergeOutcome, Refresh};
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Digest, MotionUpdate, Record, RecordStamp};
use consort_protocol::message::RecordUpdate;

/// Maximum lead of an earlier incarnation over this one, in milliseconds: a century, for clocks
/// that were set wrongly. A larger stamp is forged, and would exhaust the node's own stamps.
const INCARNATION_LEAD_MAX: u64 = 100 * 366 * 24 * 3600 * 1000;

/// Handles an update that a node published of its own record.
pub(super) fn receive_update(
    owner: NodeId,
    update: RecordUpdate,
    membership: &mut Membership,
    context: &mut Context<'_>,
) -> Result<(), GossipError> {
    match update {
        RecordUpdate::Record(record) => {
            let stamp = record.stamp;
            receive_record(record, membership, context)?;
            context.state.base.confirm(&owner, stamp, context.now);
        }
        RecordUpdate::Refresh { stamp, since, proof } => {
            receive_refresh(Refresh { owner: &owner, stamp, since, proof }, membership, context)?;
        }
    }
    // A publisher deserves an announcement. Receiving from it is no proof that it receives from
    // this node.
    membership.schedule_announcement(owner, context);
    Ok(())
}

/// Handles the motion that a node published of its robot, which also confirms its record.
pub(super) fn receive_motion(
    owner: NodeId,
    update: &MotionUpdate,
    membership: &mut Membership,
    context: &mut Context<'_>,
) -> Result<(), GossipError> {
    let refresh = Refresh { owner: &owner, stamp: update.stamp, since: update.stamp.version, proof: None };
    receive_refresh(refresh, membership, context)?;
    let is_own = owner == context.core.settings.node;
    context.core.changed |= !is_own && context.state.base.receive_motion(&owner, update);
    membership.schedule_announcement(owner, context);
    Ok(())
}

fn receive_refresh(
    refresh: Refresh<'_>,
    membership: &mut Membership,
    context: &mut Context<'_>,
) -> Result<(), GossipError> {
    let owner = refresh.owner;
    match context.core.records.receive_refresh(refresh, context.state, context.now) {
        MergeOutcome::Own(stamp) => overtake(stamp, membership, context),
        MergeOutcome::Renewed | MergeOutcome::Changed => membership.confirm(owner, context),
        MergeOutcome::Missing | MergeOutcome::Stale => Ok(()),
    }
}

/// Merges the records from a peer. Returns true if any of them was new.
pub(super) fn merge_records(
    records: Vec<Record>,
    digest: &Digest,
    membership: &mut Membership,
    context: &mut Context<'_>,
) -> Result<bool, GossipError> {
    let mut any_new = false;
    for record in records {
        any_new |= receive_record(record, membership, context)?;
    }
    // Records of dead nodes are not forwarded, and this node is dead for peers that store its
    // later incarnation. Their digest contains the stamp.
    let own = context.core.records.own();
    if let Some(stamp) = digest.get(&own.owner).filter(|stamp| **stamp > own.stamp) {
        overtake(*stamp, membership, context)?;
    }
    Ok(any_new)
}

fn receive_record(record: Record, membership: &mut Membership, context: &mut Context<'_>) -> Result<bool, GossipError> {
    let owner = record.owner.clone();
    match context.core.records.receive(record, context.state, context.now) {
        MergeOutcome::Stale => return Ok(false),
        MergeOutcome::Renewed | MergeOutcome::Missing => {}
        MergeOutcome::Changed => context.core.changed = true,
        MergeOutcome::Own(stamp) => {
            overtake(stamp, membership, context)?;
            return Ok(false);
        }
    }
    membership.confirm(&owner, context)?;
    membership.schedule_announcement(owner, context);
    Ok(true)
}

/// Handles a stamp of this node that is later than its own.
fn overtake(stamp: RecordStamp, membership: &mut Membership, context: &mut Context<'_>) -> Result<(), GossipError> {
    let settings = &context.core.settings;
    if stamp.incarnation > settings.incarnation.saturating_add(INCARNATION_LEAD_MAX) {
        return Err(GossipError::ImpossibleIncarnation(stamp.incarnation));
    }
    tracing::warn!(node = %settings.node, ?stamp, "other nodes have a later record of this node than it wrote: an \
        earlier incarnation was higher, or another node has the same name");
    context.core.records.overtake(stamp, context.state, context.now);
    context.publish();
    membership.adopt_incarnation(stamp.incarnation, context)
}
