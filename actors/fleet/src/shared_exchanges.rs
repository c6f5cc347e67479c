//! Values that the members of ensembles exchange, as received by a node: the exchange writes them, and
//! views and the skills of the robot read them.

use consort_protocol::ensemble::{Ensemble, Ensembles, ExchangedValue, KnowledgeExchange};
use consort_protocol::ids::{EnsembleId, NodeId, RobotId};
use consort_protocol::scalar::Scalar;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Exchanges of a node, by ensemble. Copies share their state.
#[derive(Debug, Clone, Default)]
pub(crate) struct SharedExchanges(Arc<Mutex<BTreeMap<EnsembleId, KnowledgeExchange>>>);

impl SharedExchanges {
    /// Creates the exchanges of the ensembles that list values.
    pub(crate) fn of(ensembles: &Ensembles, own: &NodeId) -> SharedExchanges {
        let listing = ensembles.iter().map(Ensemble::spec).filter(|spec| !spec.exchange.is_empty());
        let exchange = |listed: &BTreeSet<_>| KnowledgeExchange::new(listed.clone(), own.clone());
        let exchanges = listing.map(|spec| (spec.name.clone(), exchange(&spec.exchange))).collect();
        SharedExchanges(Arc::new(Mutex::new(exchanges)))
    }

    /// Locks the exchanges. Each of their methods leaves them consistent.
    pub(crate) fn lock(&self) -> MutexGuard<'_, BTreeMap<EnsembleId, KnowledgeExchange>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns a value as [`KnowledgeExchange::value`] of the ensemble.
    pub(crate) fn value(
        &self,
        ensemble: &EnsembleId,
        robot: &RobotId,
        value: &ExchangedValue,
        now: NodeTime,
    ) -> Option<Scalar> {
        self.lock().get(ensemble)?.value(robot, value, now).cloned()
    }
}
