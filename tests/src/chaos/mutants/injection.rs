//! Injection of a bug into the nodes of a run.

use super::Mutant;
use super::bus::FaultyBus;
use super::gossip::NoVerification;
use super::known_ledger::KnownLedger;
use super::log_store::FaultyLogStore;
use super::refusals::{RefusalPassage, RefusalTap};
use consort_bus::SharedBus;
use consort_bus::record_signer::SharedRecordSigner;
use consort_fleet::autopilot::{AutopilotAction, AutopilotInput, decide};
use consort_fleet::node::NodeSettings;
use consort_fleet::observe::SharedObserver;
use consort_protocol::ids::NodeId;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::HistoryLimits;
use consort_raft::StoreIdentity;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Injection of a bug into all nodes of a run. In a closed fleet the bug is above the signatures: a
/// node signs the messages that its bug has changed.
#[derive(Clone)]
pub(in crate::chaos) struct MutantInjection {
    mutant: Mutant,
    ledger: KnownLedger,
    /// Identity of the first store of each node.
    identities: Arc<Mutex<BTreeMap<NodeId, StoreIdentity>>>,
    /// Passages for refusals without a signature, by node.
    passages: Arc<Mutex<BTreeMap<NodeId, RefusalPassage>>>,
}

impl MutantInjection {
    /// Creates the injection for a new run.
    pub(in crate::chaos) fn new(mutant: Mutant) -> MutantInjection {
        MutantInjection { mutant, ledger: KnownLedger::default(), identities: Arc::default(), passages: Arc::default() }
    }

    /// Changes the settings of a node before it starts.
    pub(in crate::chaos) fn equip(&self, settings: &mut NodeSettings) {
        let known: SharedObserver = Arc::new(self.ledger.clone());
        let observers: Vec<SharedObserver> = settings.observer.take().into_iter().chain([known]).collect();
        settings.observer = Some(Arc::new(observers));
        match self.mutant {
            Mutant::SkipFsync | Mutant::DoubleVote | Mutant::IdentityKept => {
                let inner = Arc::clone(&settings.store.log_store);
                let mut identities = self.identities.lock().unwrap_or_else(PoisonError::into_inner);
                let first = *identities.entry(settings.node.clone()).or_insert_with(|| inner.identity());
                settings.store.log_store = Arc::new(FaultyLogStore { mutant: self.mutant, first, inner });
            }
            Mutant::GraceTooSmall => settings.fleet.lease_terms.grace = Duration::from_millis(20),
            Mutant::OutcomesForgotten => {
                settings.fleet.history_limits.missions_max = 0;
                settings.fleet.history_limits.outcome_bytes_max = 0;
            }
            // Another number than the ledger's default, so that the coordinator writes it into the ledger.
            Mutant::HistoryKept => settings.fleet.history_limits.missions_max = HistoryLimits::LARGEST.missions_max - 1,
            // The lease of a robot must not change with the wait of the coordinator.
            Mutant::EarlyRelease if settings.robot.is_none() => {
                let LeaseTerms { lease, grace } = settings.fleet.lease_terms;
                settings.fleet.lease_terms = LeaseTerms { lease: lease / 3, grace: grace / 3 };
            }
            Mutant::TwoRemoved => settings.fleet.autopilot_rule = remove_two_voters,
            _ => {}
        }
    }

    /// Wraps the bus of a node, above its signatures.
    pub(in crate::chaos) fn wrap_bus(&self, settings: &NodeSettings, bus: SharedBus) -> SharedBus {
        Arc::new(FaultyBus::new(self.mutant, settings, self.ledger.clone(), self.passage(&settings.node), bus))
    }

    /// Wraps the bus of a node below its signatures.
    pub(in crate::chaos) fn wrap_network(&self, settings: &NodeSettings, inner: SharedBus) -> SharedBus {
        match self.mutant {
            Mutant::RefusalsUnsigned => Arc::new(RefusalTap { passage: self.passage(&settings.node), inner }),
            _ => inner,
        }
    }

    /// Wraps the signer of a node's records.
    pub(in crate::chaos) fn wrap_signer(&self, inner: SharedRecordSigner) -> SharedRecordSigner {
        match self.mutant {
            Mutant::RecordsUnverified => Arc::new(NoVerification(inner)),
            _ => inner,
        }
    }

    fn passage(&self, node: &NodeId) -> RefusalPassage {
        self.passages.lock().unwrap_or_else(PoisonError::into_inner).entry(node.clone()).or_default().clone()
    }
}

/// Decides as [`decide`] does, but removes a second voter together with each removed voter.
fn remove_two_voters(input: &AutopilotInput) -> Option<AutopilotAction> {
    match decide(input)? {
        AutopilotAction::SetVoters { mut voters, reason } if !input.voters.keys().all(|id| voters.contains(id)) => {
            let second = voters.iter().copied().find(|id| *id != input.me && input.voters.contains_key(id));
            second.map(|id| voters.remove(&id));
            Some(AutopilotAction::SetVoters { voters, reason })
        }
        action => Some(action),
    }
}
