//! Members of the ensembles and other clusters, as far as the coordinator has received their
//! records.

use super::last_known_place::foreign_clusters;
use super::session_context::SessionContext;
use super::settings::CoordinatorSettings;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{ClusterId, EnsembleId, NodeId};
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use tracing::error;

/// Members of the ensembles during a session.
#[derive(Default)]
pub(super) struct EnsembleMembers {
    members: BTreeMap<EnsembleId, BTreeSet<NodeId>>,
    /// Members that are free by their own record.
    free: BTreeSet<NodeId>,
    /// Other clusters with the name of this fleet, each with a node of it.
    foreign: BTreeMap<ClusterId, NodeId>,
}

impl EnsembleMembers {
    /// Publishes changes of the ensembles' memberships. Returns the members that have become free.
    pub(super) fn update(&mut self, context: &SessionContext, now: NodeTime) -> BTreeSet<NodeId> {
        let CoordinatorSettings { parts, auctions, .. } = &context.settings;
        let members = live_members(&context.settings, now);
        for ensemble in auctions.ensembles.iter() {
            let name = &ensemble.spec().name;
            let of = |members: &BTreeMap<_, BTreeSet<NodeId>>| members.get(name).cloned().unwrap_or_default();
            let (now_members, before) = (of(&members), of(&self.members));
            for member in now_members.difference(&before) {
                context.publish_event(EventKind::Joined { ensemble: name.clone(), member: member.clone() });
            }
            for member in before.difference(&now_members) {
                let membership = parts.knowledge.read(|base| ensemble.membership_of(member, &parts.node, base, now));
                let reason = if membership.member { "judged dead".to_owned() } else { membership.reason };
                context.publish_event(EventKind::Left { ensemble: name.clone(), member: member.clone(), reason });
            }
        }
        let free = parts.knowledge.read(|base| {
            let is_free = |node: &&NodeId| base.get(node).is_some_and(|stored| stored.record.knowledge.is_free());
            members.values().flatten().filter(is_free).cloned().collect::<BTreeSet<_>>()
        });
        let newly_free = free.difference(&self.free).cloned().collect();
        self.free = free;
        self.members = members;
        newly_free
    }

    /// Returns the number of members of all ensembles.
    pub(super) fn count(&self) -> usize {
        self.members.values().flatten().collect::<BTreeSet<_>>().len()
    }

    /// Reports each other cluster with the name of this fleet, once.
    pub(super) fn report_foreign_clusters(&mut self, context: &SessionContext) {
        let parts = &context.settings.parts;
        let Some(own) = *parts.replica.cluster().borrow() else { return };
        let foreign = foreign_clusters(&parts.knowledge, Some(own));
        for (cluster, node) in &foreign {
            if !self.foreign.contains_key(cluster) {
                error!(%own, foreign = %cluster, %node, "another cluster with this fleet's name was founded separately: \
                    they do not merge. Stop the nodes of either cluster and restart them with empty stores");
                let (cluster, foreign, member) = (own, *cluster, node.clone());
                context.publish_event(EventKind::Foreign { cluster, foreign, member });
            }
        }
        // A reported cluster is not reported again, although views show it only while its records
        // arrive.
        self.foreign.extend(foreign);
    }
}

/// Returns the members of each ensemble that are alive.
pub(super) fn live_members(settings: &CoordinatorSettings, now: NodeTime) -> BTreeMap<EnsembleId, BTreeSet<NodeId>> {
    let CoordinatorSettings { parts, auctions, .. } = settings;
    let own = *parts.replica.cluster().borrow();
    let mut members = parts.knowledge.read(|base| {
        let is_own = |node: &NodeId| {
            let cluster = base.get(node).and_then(|stored| stored.record.knowledge.cluster);
            cluster.is_none() || own.is_none() || cluster == own
        };
        let mut members = auctions.ensembles.members(&parts.node, base, now);
        members.values_mut().for_each(|nodes| nodes.retain(is_own));
        members
    });
    members.values_mut().for_each(|members| members.retain(|node| parts.knowledge.is_alive(node)));
    members
}
