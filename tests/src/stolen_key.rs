//! Attacks on a closed fleet with the key of one of its nodes.

use crate::{Fleet, slug};
use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_bus::cluster_membership::{ClusterBus, ClusterMembership};
use consort_bus::trust::SigningBus;
use consort_protocol::ids::{NodeId, RobotId, RoleId};
use consort_protocol::ledger::{MissionEntry, PersonQuestion, TaskQuestion};
use consort_protocol::message::Report;
use consort_protocol::plan::{LocalPlan, Signal, StepAction};
use consort_protocol::trust::NodeRole;
use std::sync::Arc;

/// Incarnation of the attacker: later than any that the node itself has in a test.
const INCARNATION: u64 = 1_000;

/// Buses of an attacker with the key of a node.
pub struct StolenKey {
    /// Bus that signs with the key.
    pub signing: Arc<SigningBus>,
    /// The bus below, which signs nothing.
    pub plain: SharedBus,
}

impl StolenKey {
    /// Joins the network of a closed fleet with a certificate of this name and role; a host serves
    /// itself alone. Returns `None` in an open fleet.
    pub async fn of(fleet: &Fleet, name: &str, role: Option<NodeRole>, date_ms: u64) -> Option<StolenKey> {
        let credentials = fleet.credentials.as_ref()?;
        let node: NodeId = slug(name);
        let plain: SharedBus = Arc::new(fleet.network.bus(node.clone()));
        let (roles, incarnation) = (role.into_iter().collect(), date_ms.max(INCARNATION));
        let keyring = credentials.keyring_serving(&node, roles, slug(name), incarnation);
        let signing = credentials.signing_bus(Arc::clone(&plain), keyring, Clock::virtual_at(date_ms)).await;
        Some(StolenKey { signing, plain })
    }

    /// Returns the signing bus with the envelopes of the fleet's cluster.
    pub fn in_cluster(&self, fleet: &Fleet) -> SharedBus {
        let membership = ClusterMembership::default();
        let cluster = fleet.ledger(|ledger| ledger.cluster()).flatten();
        cluster.into_iter().for_each(|cluster| membership.set_from_ledger(cluster));
        let signing = Arc::clone(&self.signing) as SharedBus;
        Arc::new(ClusterBus::new(signing, fleet.keys().clone(), membership))
    }
}

/// Returns a report by `robot` that all steps of a role have ended, under the award of its holder, with a
/// question to a person in which `robot` is named. `None` if the role has no plan.
pub fn report_of_all_steps(robot: RobotId, entry: &MissionEntry, role: &RoleId) -> Option<Report> {
    let plan = entry.plan(role)?;
    let holder = entry.roles.get(role)?.holder.as_ref();
    let (to, message) = (slug("nurse"), format!("may {robot} enter?"));
    let question = PersonQuestion { to, message, at: None, patience_s: None, escalation: None };
    Some(Report {
        robot,
        incarnation: 1,
        mission: entry.id.clone(),
        role: role.clone(),
        epoch: holder.map(|holder| holder.epoch).unwrap_or_default(),
        ended: (0..).take(plan.steps.len()).collect(),
        outcomes: Default::default(),
        current_task: None,
        place: None,
        from_checkpoint: false,
        failure: None,
        question: Some(TaskQuestion { task: slug("visit"), number: 1, question, is_open: true }),
    })
}

/// Returns the signals that a plan sends.
pub fn signals_sent(plan: &LocalPlan) -> impl Iterator<Item = &Signal> {
    plan.steps.iter().filter_map(|step| match &step.action {
        StepAction::Send(signal) => Some(signal),
        StepAction::Task { .. } | StepAction::Wait(_) => None,
    })
}
